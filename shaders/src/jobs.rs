//! The bake's voxel jobs ([`crate::device::VoxelDevice`]) as recordings of stages, for any [`Executor`].
//!
//! # Practice
//! Every job cuts its triangles or points, its directions and its masks' textures into pieces, so that no buffer
//! exceeds what a stage can see. Setting a bit twice changes nothing and fragments may come in any order, so that
//! pieces need no care; a piece whose fragments do not fit their list is done again with more room or in halves.

mod fragments;
mod hidden_lights;
pub mod many_lods;
pub mod mega_views;
mod peel;
mod points;
mod rows;
mod segments;
mod triangles;
mod visible;

pub use fragments::fragments;
pub use hidden_lights::hidden_lights;
pub use peel::peel;
pub use points::rotate_points;
pub use rows::raster_rows;
pub use segments::{MethodStage, occluded_segments, segment_distances};
pub use visible::{VisibleBatch, visible_triangles};

use crate::device::DeviceError;
use crate::executor::{BufferId, DepthId, Executor};
use crate::raster::VoxelBox;

/// Largest side of a clip box, voxels: fragments store 10 bits per axis.
const MAX_CLIP_SIDE: i32 = 1024;

/// Words of a bit grid, or an error if it exceeds what a stage can see. `what` names it.
fn bit_words(what: &'static str, bits: u64, limit_bytes: u64) -> Result<u64, DeviceError> {
    let words = bits.div_ceil(32);
    if words * 4 > limit_bytes {
        return Err(DeviceError::TooLarge { what, needed_bytes: words * 4, limit_bytes });
    }
    Ok(words)
}

/// The sides of a clip box, or `None` if it is empty.
fn clip_size(clip: &VoxelBox) -> Result<Option<[u32; 3]>, DeviceError> {
    let mut size = [0; 3];
    for (side, (&min, &max)) in size.iter_mut().zip(clip.min.iter().zip(&clip.max)) {
        let voxels = i64::from(max) - i64::from(min);
        if voxels <= 0 {
            return Ok(None);
        }
        if voxels > i64::from(MAX_CLIP_SIDE) {
            return Err(DeviceError::Failed(format!(
                "a clip box of {voxels} voxels a side exceeds the limit of {MAX_CLIP_SIDE}; cut it into bricks"
            )));
        }
        *side = voxels as u32;
    }
    Ok(Some(size))
}

/// A job's executor, which takes back what the job allocated when it ends, also by an error.
struct Workspace<'a> {
    executor: &'a mut dyn Executor,
    buffers: Vec<BufferId>,
    images: Vec<DepthId>,
}

impl<'a> Workspace<'a> {
    fn new(executor: &'a mut dyn Executor) -> Self {
        Self { executor, buffers: Vec::new(), images: Vec::new() }
    }

    fn buffer(&mut self, what: &'static str, bytes: u64) -> Result<BufferId, DeviceError> {
        let id = self.executor.buffer(what, bytes)?;
        self.buffers.push(id);
        Ok(id)
    }

    fn release(&mut self, buffer: BufferId) {
        self.executor.release(buffer);
        self.buffers.retain(|&kept| kept != buffer);
    }

    fn depth_image(&mut self, size: [u32; 2]) -> Result<DepthId, DeviceError> {
        let id = self.executor.depth_image(size)?;
        self.images.push(id);
        Ok(id)
    }
}

impl Drop for Workspace<'_> {
    fn drop(&mut self) {
        for &id in &self.buffers {
            self.executor.release(id);
        }
        for &id in &self.images {
            self.executor.release_depth(id);
        }
    }
}
