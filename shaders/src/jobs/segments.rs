//! A batch of segments, by any method that is a stage.

use super::Workspace;
use super::hidden_lights::STEPS_OF_ONE;
use crate::device::DeviceError;
use crate::executor::{Binding, Executor, Recording};
use crate::stages::Stage;
use crate::types::{Segment, SegmentParams};

/// Invocations of a workgroup.
const WORKGROUP: usize = 64;
/// Segments of one dispatch.
const PIECE_SEGMENTS: u64 = 1 << 20;

/// A method of testing rays as the jobs see it.
#[derive(Debug, Clone, Copy)]
pub struct MethodStage<'a> {
    /// The stage: `lib_hidden_lights.wgsl` or `lib_segments.wgsl` with the method's own functions.
    pub stage: &'static Stage,
    /// What the method reads, from `METHOD_BINDING` of that file on.
    pub bindings: &'a [Binding],
    /// Rays of one dispatch: as many as take a small part of a second, so that no watchdog ends it.
    pub rays_per_dispatch: u64,
}

impl MethodStage<'_> {
    pub(super) fn exhausted(&self) -> DeviceError {
        DeviceError::Failed(format!(
            "a ray of `{}` needs more than {STEPS_OF_ONE} steps, which is all that some drivers do in one loop; use a \
             coarser scene or a method on the CPU",
            self.stage.name
        ))
    }
}

/// For each segment 1 where anything is between its ends, else 0.
///
/// # Panics
/// If the slices differ in length.
pub fn occluded_segments(
    executor: &mut dyn Executor,
    method: &MethodStage,
    segments: &[Segment],
    occluded: &mut [u8],
) -> Result<(), DeviceError> {
    assert_eq!(segments.len(), occluded.len(), "one answer for each segment");
    let mut rest = occluded;
    test_segments(executor, method, segments, false, &mut |results| {
        let (answers, later) = std::mem::take(&mut rest).split_at_mut(results.len());
        rest = later;
        for (answer, &result) in answers.iter_mut().zip(results) {
            *answer = result as u8;
        }
    })
}

/// For each segment the distance in metres from its origin to the first hit, +infinity where there is none.
///
/// # Panics
/// If the slices differ in length.
pub fn segment_distances(
    executor: &mut dyn Executor,
    method: &MethodStage,
    segments: &[Segment],
    distances: &mut [f32],
) -> Result<(), DeviceError> {
    assert_eq!(segments.len(), distances.len(), "one answer for each segment");
    let mut rest = distances;
    test_segments(executor, method, segments, true, &mut |results| {
        let (answers, later) = std::mem::take(&mut rest).split_at_mut(results.len());
        rest = later;
        answers.copy_from_slice(bytemuck::cast_slice(results));
    })
}

fn test_segments(
    executor: &mut dyn Executor,
    method: &MethodStage,
    segments: &[Segment],
    wants_distance: bool,
    take: &mut dyn FnMut(&[u32]),
) -> Result<(), DeviceError> {
    let limit = executor.limits().binding_bytes as usize;
    let wanted = PIECE_SEGMENTS.min(method.rays_per_dispatch).max(WORKGROUP as u64) as usize;
    let piece = wanted.min(limit / size_of::<Segment>()).min(limit / 4 - 1).clamp(1, segments.len().max(1));
    let mut work = Workspace::new(executor);
    let params = work.buffer("parameters", size_of::<SegmentParams>() as u64)?;
    let segments_buffer = work.buffer("segments", (piece * size_of::<Segment>()) as u64)?;
    let results = work.buffer("results", 4 * (piece + 1) as u64)?;
    let mut bindings: Vec<Binding> = [params, segments_buffer, results].map(Binding::from).to_vec();
    bindings.extend_from_slice(method.bindings);
    for segments in segments.chunks(piece) {
        let head = [SegmentParams {
            segments: segments.len() as u32,
            wants_distance: u32::from(wants_distance),
            steps_per_ray: STEPS_OF_ONE,
            exhausted_word: segments.len() as u32,
        }];
        let mut recording = Recording::new();
        recording.upload(params, &head);
        recording.upload(segments_buffer, segments);
        recording.clear(results);
        recording.dispatch(method.stage, [segments.len().div_ceil(WORKGROUP) as u32, 1, 1], &bindings);
        recording.download(results, segments.len() + 1);
        let found = work.executor.run(&recording)?.remove(0);
        if found[segments.len()] != 0 {
            return Err(method.exhausted());
        }
        take(&found[..segments.len()]);
    }
    Ok(())
}
