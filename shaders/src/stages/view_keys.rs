use super::lib_view_tree::flat_groups;
use crate::executor::CpuBinding;
use crate::mega_views::{SceneParams, SortParams, ViewCone};

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let [scene, sort, views, keys, order] = bindings else { unreachable!("checked against the table") };
    let (scene, sort) = (scene.first::<SceneParams>(), sort.first::<SortParams>());
    let views = views.slice::<ViewCone>();
    for index in 0..sort.count.min(flat_groups(workgroups) * 64) as usize {
        let key = scene.key(views[index].position);
        keys.words_mut()[2 * index..2 * index + 2].copy_from_slice(&key);
        order.words_mut()[index] = index as u32;
    }
}
