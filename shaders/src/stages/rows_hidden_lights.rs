use super::lib_rays;
use crate::executor::CpuBinding;
use crate::row_view::RowView;

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    lib_rays::hidden_lights(workgroups, bindings, RowView::bound, |rows, segment, _| rows.is_occluded(segment));
}
