use super::lib_scan::Inputs;
use crate::executor::CpuBinding;

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let (inputs, outputs) = bindings.split_at_mut(6);
    let [queue, out] = outputs else { unreachable!("checked against the table") };
    let inputs = Inputs::new(inputs);
    inputs.scan_small(workgroups, queue.words_mut(), |triangle, _, fragment| {
        inputs.emit_fragment(out.words_mut(), triangle, fragment);
    });
}
