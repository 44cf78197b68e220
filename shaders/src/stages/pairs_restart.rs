use crate::executor::CpuBinding;
use crate::mega_views::{PAIR_WHOLE, counter};

pub(super) fn twin(_: [u32; 3], bindings: &mut [CpuBinding]) {
    let [counters, pairs] = bindings else { unreachable!("checked against the table") };
    pairs.words_mut()[..2].copy_from_slice(&[0, PAIR_WHOLE]);
    let counters = counters.words_mut();
    counters[counter::QUEUED] = 1;
    counters[counter::NEAR] = 0;
}
