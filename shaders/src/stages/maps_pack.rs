use super::lib_view_tree::flat_groups;
use crate::executor::CpuBinding;
use crate::mega_views::{PassParams, half_bits, tree};

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let [pass, tree, links, maps, packed] = bindings else { unreachable!("checked against the table") };
    let pass = pass.first::<PassParams>();
    let texels = pass.texels as usize;
    let leaves = tree.words()[tree::LEAVES] as usize;
    for leaf in 0..leaves.min(flat_groups(workgroups) as usize) {
        let node = links.words()[pass.node_capacity as usize + leaf] as usize;
        let map = &maps.words()[node * texels..][..texels];
        if pass.half_depths == 1 {
            let out = &mut packed.words_mut()[leaf * texels / 2..][..texels / 2];
            for (word, pair) in out.iter_mut().zip(map.chunks(2)) {
                *word = half_bits(pair[0]) | half_bits(pair[1]) << 16;
            }
        } else {
            packed.words_mut()[leaf * texels..][..texels].copy_from_slice(map);
        }
        if pass.with_numbers == 1 {
            let numbers = &maps.words()[pass.number_at(node * texels)..][..texels];
            let depth_words = if pass.half_depths == 1 { texels / 2 } else { texels };
            packed.words_mut()[leaves * depth_words + leaf * texels..][..texels].copy_from_slice(numbers);
        }
    }
}
