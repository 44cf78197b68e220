use super::lib_view_tree::flat_groups;
use crate::executor::CpuBinding;
use crate::mega_views::{LevelParams, PassParams, tree};
use crate::paraboloid::texel_direction;
use crate::views::{ViewNode, dot};

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let [pass, level, tree, view_nodes, links, maps] = bindings else {
        unreachable!("checked against the table")
    };
    let (pass, level) = (pass.first::<PassParams>(), level.first::<LevelParams>().level as usize);
    let (tree, nodes, maps) = (tree.words(), view_nodes.slice::<ViewNode>(), maps.words_mut());
    let range = tree[tree::STARTS + level]..tree[tree::STARTS + level + 1];
    for node in range.take(flat_groups(workgroups) as usize) {
        let (node, parent) = (node as usize, links.words()[node as usize] as usize);
        let offset = [0, 1, 2].map(|i| nodes[node].center[i] - nodes[parent].center[i]);
        for texel in 0..pass.texels {
            let [parent_at, at] = [parent, node].map(|node| node * pass.texels as usize + texel as usize);
            let depth = f32::from_bits(maps[parent_at]);
            if depth < f32::INFINITY {
                let direction = texel_direction(texel, pass.resolution);
                let moved = [0, 1, 2].map(|i| direction[i] * depth - offset[i]);
                let bits = dot(moved, moved).sqrt().to_bits();
                if bits < maps[at] {
                    maps[at] = bits;
                    if pass.with_numbers == 1 {
                        maps[pass.number_at(at)] = maps[pass.number_at(parent_at)];
                    }
                }
            }
        }
    }
}
