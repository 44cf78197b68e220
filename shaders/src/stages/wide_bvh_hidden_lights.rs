use super::lib_rays;
use crate::executor::CpuBinding;
use crate::wide_bvh::WideBvhView;

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    lib_rays::hidden_lights(workgroups, bindings, WideBvhView::bound, |tree, segment, steps| {
        tree.traverse(segment, true, steps).is_some()
    });
}
