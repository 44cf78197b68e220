use super::lib_rays;
use crate::brickmap::BrickmapView;
use crate::executor::CpuBinding;

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    lib_rays::segments(
        workgroups,
        bindings,
        BrickmapView::bound,
        |map, segment, steps| map.march(segment, steps).is_some(),
        |map, segment, steps| map.march(segment, steps).unwrap_or(-1.0),
    );
}
