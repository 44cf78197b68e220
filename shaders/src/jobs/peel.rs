//! Depth peeling: layer after layer, until one is empty.
//!
//! # Theory
//! \[WMP\] Algorithm 1: render the triangles along each axis, discard what is not behind the layer before, until nothing
//! is left. Depth is a voxel here, so that a layer has the nearest *voxel* behind the layer before and a column of
//! n voxels has at most n layers.
//!
//! # Differences from the paper
//! Many views (directions and axes) lie side by side in one depth image, so that small grids do not need a pass each.
//! A grid larger than the image is cut into windows.

use super::triangles::{TriangleBuffers, for_each_piece, piece_triangles};
use super::{Workspace, bit_words, clip_size};
use crate::device::{DeviceError, TriangleBatch};
use crate::executor::{BufferId, Executor, Recording};
use crate::raster::{Grid, VoxelBox};
use crate::stages;
use crate::types::{PackedTriangle, PeelParams, PeelView, RasterParams};

/// Triangles that are peeled together.
const PIECE_TRIANGLES: usize = 1 << 18;
/// Side of the depth images, if no view is larger.
const IMAGE_SIDE: u32 = 2048;
/// Layers between two looks at whether there are more.
const LAYERS_PER_RUN: usize = 4;

/// [`VoxelDevice::peel`](crate::device::VoxelDevice::peel) on an executor.
pub fn peel(
    executor: &mut dyn Executor,
    grid: Grid,
    clip: &VoxelBox,
    batch: &TriangleBatch,
) -> Result<Vec<u32>, DeviceError> {
    let Some(size) = clip_size(clip)? else { return Ok(Vec::new()) };
    let limits = executor.limits();
    let bits = size.iter().map(|&side| u64::from(side)).product();
    let words = bit_words("voxels of the clip box", bits, limits.binding_bytes)?;
    let params = RasterParams {
        clip_min: clip.min,
        grid_bits: grid.bits,
        clip_max: clip.max,
        sub_bits: grid.sub_bits,
        bit_stride: [1, size[0], size[0] * size[1]],
        direction_stride: 0,
        triangles: 0,
        directions: 0,
        capacity: 0,
        reserved: 0,
    };
    let mut work = Workspace::new(executor);
    let out = work.buffer("voxels of the clip box", words * 4)?;
    let frames = work.buffer("direction frames", 48)?;
    let mut recording = Recording::new();
    recording.clear(out);
    work.executor.run(&recording)?;
    for_each_piece(
        &mut work,
        batch,
        piece_triangles(limits, PIECE_TRIANGLES),
        &mut |work, buffers, triangles| peel_piece(work, frames, out, buffers, params, triangles),
    )?;
    let mut recording = Recording::new();
    recording.download(out, words as usize);
    Ok(work.executor.run(&recording)?.remove(0))
}

/// Peels some triangles in every direction of `params` and sets the bits of their voxels.
pub(super) fn peel_piece(
    work: &mut Workspace,
    frames: BufferId,
    out: BufferId,
    buffers: TriangleBuffers,
    params: RasterParams,
    triangles: &[PackedTriangle],
) -> Result<(), DeviceError> {
    let mut work = Workspace::new(work.executor);
    let limits = work.executor.limits();
    let size = [0, 1, 2].map(|i| (params.clip_max[i] - params.clip_min[i]) as u32);
    let side = size[0].max(size[1]).max(size[2]);
    let cell = side.min(limits.depth_side);
    let columns = (limits.depth_side.min(IMAGE_SIDE) / cell).max(1);
    let views = views(&params, cell);
    let params = [RasterParams { triangles: triangles.len() as u32, ..params }];
    let columns = columns.min(views.len() as u32);
    let rows = (views.len() as u32).div_ceil(columns).min(columns);

    let params_buffer = work.buffer("parameters", 64)?;
    let peel_buffer = work.buffer("peeling parameters", 16)?;
    let views_buffer = work.buffer("views", 16 * u64::from(columns * rows))?;
    let count_buffer = work.buffer("layer count", 4)?;
    let mut images =
        [work.depth_image([columns * cell, rows * cell])?, work.depth_image([columns * cell, rows * cell])?];
    let mut recording = Recording::new();
    recording.upload(params_buffer, &params);
    recording.upload(buffers.triangles, triangles);
    recording.clear(count_buffer);
    work.executor.run(&recording)?;

    for views in views.chunks((columns * rows) as usize) {
        let peel = [PeelParams { cell, columns, rows, views: views.len() as u32 }];
        let mut recording = Recording::new();
        recording.upload(peel_buffer, &peel);
        recording.upload(views_buffer, views);
        recording.clear_depth(images[0], 0.0);
        loop {
            for _ in 0..LAYERS_PER_RUN {
                let [previous, layer] = images;
                recording.clear_depth(layer, 1.0);
                recording.draw(
                    &stages::peel,
                    [3 * triangles.len() as u32, views.len() as u32],
                    &[
                        params_buffer.into(),
                        peel_buffer.into(),
                        frames.into(),
                        buffers.triangles.into(),
                        buffers.masks.into(),
                        buffers.planes.into(),
                        buffers.alpha.into(),
                        views_buffer.into(),
                        previous.into(),
                    ],
                    layer,
                );
                recording.dispatch(
                    &stages::peel_collect,
                    [(columns * cell).div_ceil(8), (rows * cell).div_ceil(8), 1],
                    &[
                        params_buffer.into(),
                        peel_buffer.into(),
                        views_buffer.into(),
                        layer.into(),
                        count_buffer.into(),
                        out.into(),
                    ],
                );
                recording.download(count_buffer, 1);
                images.swap(0, 1);
            }
            // The count goes on from layer to layer: one that adds nothing is empty, and so are all behind it.
            let counts = work.executor.run(&recording)?;
            if counts[LAYERS_PER_RUN - 1] == counts[LAYERS_PER_RUN - 2] {
                break;
            }
            recording = Recording::new();
        }
    }
    Ok(())
}

/// Windows of at most `cell` pixels a side that cover the pixels of every direction along three axes.
fn views(params: &RasterParams, cell: u32) -> Vec<PeelView> {
    let mut views = Vec::new();
    for direction in 0..params.directions.max(1) {
        for axis in 0..3u32 {
            let (x, y) = ((axis as usize + 1) % 3, (axis as usize + 2) % 3);
            for window_y in (params.clip_min[y]..params.clip_max[y]).step_by(cell as usize) {
                for window_x in (params.clip_min[x]..params.clip_max[x]).step_by(cell as usize) {
                    views.push(PeelView { direction, axis, window_x, window_y });
                }
            }
        }
    }
    views
}
