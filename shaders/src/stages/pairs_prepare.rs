use super::lib_view_tree::grid_of;
use crate::executor::CpuBinding;
use crate::mega_views::{PassParams, counter, flag, tree};

pub(super) fn twin(_: [u32; 3], bindings: &mut [CpuBinding]) {
    let [pass, tree, counters, arguments] = bindings else { unreachable!("checked against the table") };
    let pass = pass.first::<PassParams>();
    let counters = counters.words_mut();
    let (queued, near) = (counters[counter::QUEUED], counters[counter::NEAR]);
    counters[counter::MOST] = counters[counter::MOST].max(queued);
    counters[counter::FLAGS] |= tree.words()[tree::FLAGS]
        | if queued > pass.pair_capacity { flag::PAIRS } else { 0 }
        | if near > pass.near_capacity { flag::NEAR } else { 0 };
    let has_room = counters[counter::FLAGS] == 0;
    let [pairs, near] = if has_room { [queued, near] } else { [0, 0] };
    counters[counter::PAIRS] = pairs;
    counters[counter::QUEUED] = 0;
    let [x, y] = grid_of(pairs.div_ceil(64));
    let [near_x, near_y] = grid_of(near.div_ceil(64 / pass.near_lanes));
    arguments.words_mut()[..6].copy_from_slice(&[x, y, 1, near_x, near_y, 1]);
}
