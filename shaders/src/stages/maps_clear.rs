use super::lib_view_tree::flat_groups;
use crate::executor::CpuBinding;
use crate::mega_views::{NO_NUMBER, PassParams, tree};

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let [pass, tree, maps] = bindings else { unreachable!("checked against the table") };
    let nodes = tree.words()[tree::NODES].min(flat_groups(workgroups));
    let pass = pass.first::<PassParams>();
    let texels = (nodes * pass.texels) as usize;
    maps.words_mut()[..texels].fill(f32::INFINITY.to_bits());
    if pass.with_numbers == 1 {
        maps.words_mut()[pass.number_at(0)..][..texels].fill(NO_NUMBER);
    }
}
