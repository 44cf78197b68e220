use super::{Workspace, bit_words};
use crate::constants::PAIRS_PER_INVOCATION;
use crate::device::DeviceError;
use crate::directions::DirectionFrame;
use crate::executor::{Executor, Recording};
use crate::stages;
use crate::types::PointParams;

/// Points of one dispatch.
const CHUNK_POINTS: usize = 1 << 21;
/// Bytes of bits that one dispatch writes.
const BLOCK_BYTES: u64 = 64 << 20;

/// [`VoxelDevice::rotate_points`](crate::device::VoxelDevice::rotate_points) on an executor.
pub fn rotate_points(
    executor: &mut dyn Executor,
    bits: u32,
    frames: &[DirectionFrame],
    points: &[[i16; 3]],
) -> Result<Vec<u32>, DeviceError> {
    let limit = executor.limits().binding_bytes;
    let words = super::rows::words_per_direction(bits, limit)?;
    let block = (BLOCK_BYTES.min(limit) / (words * 4)).max(1).min(limit / 48).min(65_535) as usize;
    let chunk = CHUNK_POINTS.min((limit / 12 * 2) as usize).max(2);
    let mut rows = Vec::new();
    for frames in frames.chunks(block) {
        let mut work = Workspace::new(executor);
        let out_words = bit_words("rows of directions", frames.len() as u64 * words * 32, limit)?;
        let out = work.buffer("rows of directions", out_words * 4)?;
        let params_buffer = work.buffer("parameters", 16)?;
        let frames_buffer = work.buffer("direction frames", 48 * frames.len() as u64)?;
        let points_buffer = work.buffer("points", 6 * points.len().next_multiple_of(2).min(chunk) as u64)?;
        let mut recording = Recording::new();
        recording.clear(out);
        recording.upload(frames_buffer, frames);
        work.executor.run(&recording)?;
        for points in points.chunks(chunk) {
            // The last pair may need its point twice.
            let even: Vec<[i16; 3]>;
            let points = if points.len() % 2 == 0 {
                points
            } else {
                even = points.iter().chain(points.last()).copied().collect();
                &even
            };
            let pairs = (points.len() / 2) as u32;
            let params = [PointParams { pairs, grid_bits: bits, row_bits: bits, reserved: 0 }];
            let mut recording = Recording::new();
            recording.upload(params_buffer, &params);
            recording.upload(points_buffer, points);
            recording.dispatch(
                &stages::rotate_points,
                [pairs.div_ceil(64 * PAIRS_PER_INVOCATION), frames.len() as u32, 1],
                &[params_buffer.into(), frames_buffer.into(), points_buffer.into(), out.into()],
            );
            work.executor.run(&recording)?;
        }
        let mut recording = Recording::new();
        recording.download(out, out_words as usize);
        rows.append(&mut work.executor.run(&recording)?.remove(0));
    }
    Ok(rows)
}
