//! Every receiver against every light, by any method that is a stage.

use super::Workspace;
use super::segments::MethodStage;
use crate::constants::MAX_WORKGROUPS;
use crate::device::DeviceError;
use crate::executor::{Binding, Executor, Recording};
use crate::types::{HiddenLightsParams, LightPoint, Receiver};

/// Invocations of a workgroup, all along the receivers.
const WORKGROUP: usize = 64;
/// Some drivers end a loop after 65,535 iterations of an invocation in all, whatever it had left to do; shaders notice.
/// The rays of 32 lights get 1,984 each, beside the loop over the lights;
const STEPS_OF_32: u32 = 1_984;
/// a ray that needs more is tested again in an invocation of its own.
pub(super) const STEPS_OF_ONE: u32 = 65_000;
/// Most lights of a piece: even at one light an invocation, a dispatch is no longer than its limit along y.
const PIECE_LIGHTS: usize = MAX_WORKGROUPS as usize / 32 * 32;

/// For every receiver the lights it does not see: bit `l % 32` of word `receiver * words + l / 32`, with
/// `words = lights.len().div_ceil(32)`; bits beyond the last light are 0.
///
/// # Panics
/// If `hidden` has another length than `receivers.len() * words`.
pub fn hidden_lights(
    executor: &mut dyn Executor,
    method: &MethodStage,
    receivers: &[Receiver],
    lights: &[LightPoint],
    hidden: &mut [u32],
) -> Result<(), DeviceError> {
    let all_words = lights.len().div_ceil(32);
    assert_eq!(hidden.len(), receivers.len() * all_words, "one bit for each receiver and light");
    let limit = executor.limits().binding_bytes as usize;
    let piece = PIECE_LIGHTS.min(limit / size_of::<LightPoint>() / 32 * 32).max(32);
    for (number, lights) in lights.chunks(piece).enumerate() {
        let words = lights.len().div_ceil(32);
        let wanted = (method.rays_per_dispatch / lights.len() as u64).max(WORKGROUP as u64) as usize;
        let band = wanted
            .min(limit / size_of::<Receiver>())
            .min((limit / 4 - 1) / words)
            .min(MAX_WORKGROUPS as usize * WORKGROUP)
            .clamp(1, receivers.len().max(1));
        let mut work = Workspace::new(executor);
        let params = work.buffer("parameters", size_of::<HiddenLightsParams>() as u64)?;
        let receivers_buffer = work.buffer("receivers", (band * size_of::<Receiver>()) as u64)?;
        let lights_buffer = work.buffer("lights", size_of_val(lights) as u64)?;
        let hidden_buffer = work.buffer("hidden lights", 4 * (band * words + 1) as u64)?;
        let mut recording = Recording::new();
        recording.upload(lights_buffer, lights);
        work.executor.run(&recording)?;
        let mut bindings: Vec<Binding> =
            [params, receivers_buffer, lights_buffer, hidden_buffer].map(Binding::from).to_vec();
        bindings.extend_from_slice(method.bindings);

        let bands = receivers.chunks(band).zip(hidden.chunks_mut((band * all_words).max(1)));
        for (receivers, hidden) in bands {
            let mut found = Vec::new();
            for (lights_per_invocation, steps_per_ray) in [(32, STEPS_OF_32), (1, STEPS_OF_ONE)] {
                let exhausted_word = receivers.len() * words;
                let head = [HiddenLightsParams {
                    receivers: receivers.len() as u32,
                    lights: lights.len() as u32,
                    light_words: words as u32,
                    lights_per_invocation,
                    steps_per_ray,
                    exhausted_word: exhausted_word as u32,
                    reserved: [0; 2],
                }];
                let groups = receivers.len().div_ceil(WORKGROUP) as u32;
                let mut recording = Recording::new();
                recording.upload(params, &head);
                recording.upload(receivers_buffer, receivers);
                recording.clear(hidden_buffer);
                let parts = 32 / lights_per_invocation;
                recording.dispatch(method.stage, [groups, words as u32 * parts, 1], &bindings);
                recording.download(hidden_buffer, exhausted_word + 1);
                found = work.executor.run(&recording)?.remove(0);
                if found.pop() == Some(0) {
                    break;
                }
                if lights_per_invocation == 1 {
                    return Err(method.exhausted());
                }
            }
            let first = number * piece / 32;
            for (receiver, found) in found.chunks(words).enumerate() {
                let at = receiver * all_words + first;
                hidden[at..at + words].copy_from_slice(found);
            }
        }
    }
    Ok(())
}
