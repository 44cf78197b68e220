use crate::constants::SCAN_CHUNK;
use crate::executor::CpuBinding;
use crate::mega_views::ScanParams;

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let [scan, offsets, values] = bindings else { unreachable!("checked against the table") };
    let values = &mut values.words_mut()[..scan.first::<ScanParams>().count as usize];
    let chunks = values.chunks_mut(SCAN_CHUNK as usize).take(workgroups[0] as usize * 64);
    for (&offset, values) in offsets.words().iter().zip(chunks) {
        let mut sum = offset;
        for value in values {
            sum += std::mem::replace(value, sum);
        }
    }
}
