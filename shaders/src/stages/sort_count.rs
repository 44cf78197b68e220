use crate::constants::SORT_CHUNK;
use crate::executor::CpuBinding;
use crate::mega_views::{SortParams, sort_digit};

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let [sort, keys, order, counts] = bindings else { unreachable!("checked against the table") };
    let (sort, keys) = (sort.first::<SortParams>(), keys.slice::<[u32; 2]>());
    for chunk in 0..sort.chunks.min(workgroups[0] * 64) {
        for i in chunk * SORT_CHUNK..((chunk + 1) * SORT_CHUNK).min(sort.count) {
            let digit = sort_digit(keys[order.words()[i as usize] as usize], sort.digit);
            counts.words_mut()[(digit * sort.chunks + chunk) as usize] += 1;
        }
    }
}
