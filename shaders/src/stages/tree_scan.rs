use super::lib_view_tree::grid_of;
use crate::constants::TREE_CHUNK;
use crate::executor::CpuBinding;
use crate::mega_views::{PassParams, flag, tree};

pub(super) fn twin(_: [u32; 3], bindings: &mut [CpuBinding]) {
    let [pass, tree, chunk_sums] = bindings else { unreachable!("checked against the table") };
    let pass = pass.first::<PassParams>();
    let tree = tree.words_mut();
    let level = tree[tree::LEVEL] as usize;
    let [start, end] = [tree[tree::STARTS + level], tree[tree::STARTS + level + 1]];
    let mut sums = [end, tree[tree::LEAVES]];
    for counts in chunk_sums.words_mut().chunks_mut(2).take((end - start).div_ceil(TREE_CHUNK) as usize) {
        for (count, sum) in counts.iter_mut().zip(&mut sums) {
            *sum += std::mem::replace(count, *sum);
        }
    }
    if sums[0] > pass.node_capacity {
        tree[tree::FLAGS] = flag::NODES;
        tree[tree::NEEDED] = sums[0];
        sums[0] = end;
    }
    let nodes = sums[0] - end;
    tree[tree::LEVEL] = level as u32 + 1;
    tree[tree::NODES] = sums[0];
    tree[tree::LEAVES] = sums[1];
    tree[tree::STARTS + level + 2] = sums[0];
    let maps_of = |count| {
        let [x, y] = grid_of(count);
        [x, y, pass.slices]
    };
    let next = tree::ARGUMENTS + tree::LEVEL_ARGUMENTS * (level + 1);
    for (at, workgroups) in [
        (next, [nodes.div_ceil(64 * TREE_CHUNK), 1, 1]),
        (next + 3, [nodes.div_ceil(64), 1, 1]),
        (next + 6, maps_of(nodes)),
        (tree::NODE_ARGUMENTS, maps_of(sums[0])),
        (tree::LEAF_ARGUMENTS, maps_of(sums[1])),
    ] {
        tree[at..at + 3].copy_from_slice(&workgroups);
    }
}
