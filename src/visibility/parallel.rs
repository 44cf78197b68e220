//! Batches over a function that tests one segment, on all threads.

use crate::visibility::light_words;
use manyview_shaders::testable::{is_behind, testable};
use manyview_shaders::types::{LightPoint, Receiver, Segment};
use rayon::prelude::*;

/// Sets the bits of lights that receivers do not see, of `count` lights, of which `light_of` says which they are; others keep
/// theirs. `test` is given a light's place among them.
pub(crate) fn hide_some(
    receivers: &[Receiver],
    lights: &[LightPoint],
    (count, light_of): (usize, impl Fn(usize) -> usize + Sync),
    hidden: &mut [u32],
    test: impl Fn(usize, &Segment) -> bool + Sync,
) {
    receivers.par_iter().zip(hidden.par_chunks_mut(light_words(lights.len()))).for_each(
        |(receiver, hidden)| {
            for place in 0..count {
                let light = light_of(place);
                let Some(segment) = testable(&lights[light].segment_from(receiver)) else { continue };
                let bit = u32::from(is_behind(&segment) || test(place, &segment));
                hidden[light / 32] |= bit << (light % 32);
            }
        },
    );
}

/// Segments that a thread takes at a time.
const SEGMENTS: usize = 1024;
/// Receivers that a thread takes at a time.
const RECEIVERS: usize = 16;

/// [`crate::visibility::Visibility::occluded`].
pub(crate) fn occluded(segments: &[Segment], occluded: &mut [u8], test: impl Fn(&Segment) -> bool + Sync) {
    assert_eq!(segments.len(), occluded.len(), "one answer for each segment");
    segments.par_chunks(SEGMENTS).zip(occluded.par_chunks_mut(SEGMENTS)).for_each(|(segments, occluded)| {
        for (segment, occluded) in segments.iter().zip(occluded) {
            *occluded = u8::from(testable(segment).is_some_and(|segment| test(&segment)));
        }
    });
}

/// [`crate::visibility::Visibility::distances`].
pub(crate) fn distances(
    segments: &[Segment],
    distances: &mut [f32],
    intersect: impl Fn(&Segment) -> Option<f32> + Sync,
) {
    assert_eq!(segments.len(), distances.len(), "one answer for each segment");
    segments.par_chunks(SEGMENTS).zip(distances.par_chunks_mut(SEGMENTS)).for_each(
        |(segments, distances)| {
            for (segment, distance) in segments.iter().zip(distances) {
                *distance =
                    testable(segment).and_then(|segment| intersect(&segment)).unwrap_or(f32::INFINITY);
            }
        },
    );
}

/// [`crate::visibility::Visibility::hidden_lights`].
pub(crate) fn hidden_lights(
    receivers: &[Receiver],
    lights: &[LightPoint],
    hidden: &mut [u32],
    test: impl Fn(&Segment) -> bool + Sync,
) {
    let words = light_words(lights.len());
    assert_eq!(hidden.len(), receivers.len() * words, "one bit for each receiver and light");
    if hidden.is_empty() {
        return;
    }
    let bands = receivers.par_chunks(RECEIVERS).zip(hidden.par_chunks_mut(RECEIVERS * words));
    bands.for_each(|(receivers, hidden)| {
        for (receiver, hidden) in receivers.iter().zip(hidden.chunks_mut(words)) {
            for (lights, word) in lights.chunks(32).zip(hidden) {
                *word = (0..).zip(lights).fold(0, |bits, (bit, light)| {
                    let segment = testable(&light.segment_from(receiver));
                    bits | u32::from(segment.is_some_and(|segment| is_behind(&segment) || test(&segment)))
                        << bit
                });
            }
        }
    });
}
