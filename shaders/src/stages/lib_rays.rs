//! What the twins of the stages that test rays share, as `lib_hidden_lights.wgsl` and `lib_segments.wgsl` do.

use crate::executor::CpuBinding;
use crate::testable::{is_behind, testable};
use crate::types::{HiddenLightsParams, LightPoint, Receiver, Segment, SegmentParams};

/// The twin of a stage with `lib_hidden_lights.wgsl`. `is_hidden` gets the method's bindings, a segment and the steps
/// that the ray has left.
pub(super) fn hidden_lights<'a, M>(
    workgroups: [u32; 3],
    bindings: &'a mut [CpuBinding],
    method: impl FnOnce(&'a [CpuBinding]) -> M,
    is_hidden: impl Fn(&M, &Segment, &mut u32) -> bool,
) {
    let [params, receivers, lights, hidden, rest @ ..] = bindings else {
        unreachable!("checked against the table")
    };
    let params = params.first::<HiddenLightsParams>();
    let receivers = receivers.slice::<Receiver>();
    let lights = &lights.slice::<LightPoint>()[..params.lights as usize];
    let hidden = hidden.words_mut();
    let method = method(rest);
    let parts = 32 / params.lights_per_invocation;
    for y in 0..workgroups[1].min(params.light_words * parts) {
        let word = y / parts;
        let first = word * 32 + y % parts * params.lights_per_invocation;
        let last = (first + params.lights_per_invocation).min(params.lights);
        for x in 0..(workgroups[0] * 64).min(params.receivers) {
            let receiver = &receivers[x as usize];
            for i in first..last {
                let segment = lights[i as usize].segment_from(receiver);
                let Some(segment) = testable(&segment) else { continue };
                let mut steps_left = params.steps_per_ray;
                let is_hidden = is_behind(&segment) || is_hidden(&method, &segment, &mut steps_left);
                let bit = u32::from(is_hidden) << (i & 31);
                hidden[(x * params.light_words + word) as usize] |= bit;
                if steps_left == 0 {
                    hidden[params.exhausted_word as usize] = 1;
                }
            }
        }
    }
}

/// The twin of a stage with `lib_segments.wgsl`. `hit_distance` is negative where nothing is hit.
pub(super) fn segments<'a, M>(
    workgroups: [u32; 3],
    bindings: &'a mut [CpuBinding],
    method: impl FnOnce(&'a [CpuBinding]) -> M,
    is_hidden: impl Fn(&M, &Segment, &mut u32) -> bool,
    hit_distance: impl Fn(&M, &Segment, &mut u32) -> f32,
) {
    let [params, segments, results, rest @ ..] = bindings else { unreachable!("checked against the table") };
    let params = params.first::<SegmentParams>();
    let segments = &segments.slice::<Segment>()[..params.segments.min(workgroups[0] * 64) as usize];
    let results = results.words_mut();
    let method = method(rest);
    for (i, segment) in segments.iter().enumerate() {
        let nothing = if params.wants_distance == 1 { f32::INFINITY.to_bits() } else { 0 };
        let mut steps_left = params.steps_per_ray;
        results[i] = match testable(segment) {
            None => nothing,
            Some(segment) if params.wants_distance == 1 => {
                let distance = hit_distance(&method, &segment, &mut steps_left);
                if distance >= 0.0 { distance.to_bits() } else { nothing }
            }
            Some(segment) => u32::from(is_hidden(&method, &segment, &mut steps_left)),
        };
        if steps_left == 0 {
            results[params.exhausted_word as usize] = 1;
        }
    }
}
