use super::peel::peel_piece;
use super::triangles::{TwoPass, for_each_piece, piece_triangles, queue_bytes, queue_pairs};
use super::{Workspace, bit_words};
use crate::device::{DeviceError, TriangleBatch};
use crate::directions::DirectionFrame;
use crate::executor::{Executor, Recording};
use crate::raster::{Grid, VoxelBox};
use crate::stages;
use crate::types::RasterParams;

/// Pairs of a triangle and a direction of one dispatch.
const PIECE_PAIRS: usize = 1 << 20;
/// Bytes of bits that are filled together.
const BLOCK_BYTES: u64 = 64 << 20;

/// Words of one direction's rows.
pub(super) fn words_per_direction(bits: u32, limit_bytes: u64) -> Result<u64, DeviceError> {
    if !(2..=10).contains(&bits) {
        return Err(DeviceError::Failed(format!("rows of 2^{bits} voxels: 2 to 10 bits can be done")));
    }
    bit_words("rows of a direction", 1 << (3 * bits), limit_bytes)
}

/// [`VoxelDevice::raster_rows`](crate::device::VoxelDevice::raster_rows) on an executor.
pub fn raster_rows(
    executor: &mut dyn Executor,
    bits: u32,
    frames: &[DirectionFrame],
    batch: &TriangleBatch,
    peel: bool,
) -> Result<Vec<u32>, DeviceError> {
    let limits = executor.limits();
    let words = words_per_direction(bits, limits.binding_bytes)?;
    let pairs = PIECE_PAIRS.min(queue_pairs(limits)).max(1);
    let grid = Grid::new(bits);
    let clip = VoxelBox::whole(grid);
    let block = (BLOCK_BYTES.min(limits.binding_bytes) / (words * 4)).max(1).min(limits.binding_bytes / 48);
    let mut rows = Vec::new();
    for frames in frames.chunks(pairs.min(block as usize).clamp(1, 65_535)) {
        let params = RasterParams {
            clip_min: clip.min,
            grid_bits: grid.bits,
            clip_max: clip.max,
            sub_bits: grid.sub_bits,
            // v by v, u by u, a row along w.
            bit_stride: [1 << bits, 1 << (2 * bits), 1],
            direction_stride: 1 << (3 * bits),
            triangles: 0,
            directions: frames.len() as u32,
            capacity: 0,
            reserved: 0,
        };
        let piece = piece_triangles(limits, (pairs / frames.len()).clamp(1, batch.triangles.len().max(1)));
        let mut work = Workspace::new(executor);
        let out_words = frames.len() as u64 * words;
        let pass = TwoPass {
            small: &stages::voxelize,
            large: &stages::voxelize_large,
            params: work.buffer("parameters", 64)?,
            frames: work.buffer("direction frames", 48 * frames.len() as u64)?,
            queue: work
                .buffer("large triangles", if peel { 0 } else { queue_bytes(piece * frames.len()) })?,
            out: work.buffer("rows of directions", out_words * 4)?,
        };
        let mut recording = Recording::new();
        recording.clear(pass.out);
        recording.upload(pass.frames, frames);
        work.executor.run(&recording)?;
        for_each_piece(&mut work, batch, piece, &mut |work, buffers, triangles| {
            if peel {
                peel_piece(work, pass.frames, pass.out, buffers, params, triangles)
            } else {
                pass.run(work, buffers, params, triangles, &[])
            }
        })?;
        let mut recording = Recording::new();
        recording.download(pass.out, out_words as usize);
        rows.append(&mut work.executor.run(&recording)?.remove(0));
    }
    Ok(rows)
}
