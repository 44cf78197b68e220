use super::lib_view_tree::flat_groups;
use crate::executor::CpuBinding;
use crate::mega_views::{PassParams, tree};

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let [pass, tree, maps] = bindings else { unreachable!("checked against the table") };
    let nodes = tree.words()[tree::NODES].min(flat_groups(workgroups));
    let texels = (nodes * pass.first::<PassParams>().texels) as usize;
    maps.words_mut()[..texels].fill(f32::INFINITY.to_bits());
}
