use super::lib_rays;
use crate::executor::CpuBinding;
use crate::wide_bvh::WideBvhView;

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    lib_rays::segments(
        workgroups,
        bindings,
        WideBvhView::bound,
        |tree, segment, steps| tree.traverse(segment, true, steps).is_some(),
        |tree, segment, steps| tree.traverse(segment, false, steps).unwrap_or(-1.0),
    );
}
