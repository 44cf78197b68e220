use crate::constants::SCAN_CHUNK;
use crate::executor::CpuBinding;
use crate::mega_views::ScanParams;

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let [scan, values, sums] = bindings else { unreachable!("checked against the table") };
    let values = &values.words()[..scan.first::<ScanParams>().count as usize];
    let chunks = values.chunks(SCAN_CHUNK as usize).take(workgroups[0] as usize * 64);
    for (sum, values) in sums.words_mut().iter_mut().zip(chunks) {
        *sum = values.iter().sum();
    }
}
