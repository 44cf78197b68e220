use super::lib_scan::Inputs;
use crate::executor::CpuBinding;

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let (inputs, outputs) = bindings.split_at_mut(6);
    let [queue, out] = outputs else { unreachable!("checked against the table") };
    let inputs = Inputs::new(inputs);
    inputs.scan_large(workgroups, queue, |_, direction, f| inputs.emit_bit(out.words_mut(), direction, f));
}
