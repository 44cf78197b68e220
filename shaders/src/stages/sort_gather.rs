use super::lib_view_tree::flat_groups;
use crate::executor::CpuBinding;
use crate::mega_views::{SortParams, ViewCone};

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let [sort, order, keys, views, sorted_keys, sorted_views] = bindings else {
        unreachable!("checked against the table")
    };
    let (sort, keys, views) = (sort.first::<SortParams>(), keys.slice::<[u32; 2]>(), views.slice::<ViewCone>());
    let sorted_keys: &mut [[u32; 2]] = bytemuck::cast_slice_mut(&mut sorted_keys.words_mut()[..2 * sort.count as usize]);
    let sorted_views: &mut [ViewCone] =
        bytemuck::cast_slice_mut(&mut sorted_views.words_mut()[..8 * sort.count as usize]);
    for place in 0..sort.count.min(flat_groups(workgroups) * 64) as usize {
        let view = order.words()[place] as usize;
        sorted_keys[place] = keys[view];
        sorted_views[place] = views[view];
    }
}
