//! The GPU: choosing and opening a device, running stages on it, and the bake's voxel jobs.
//!
//! # Practice
//! [`GpuContext`] is a wgpu device with its pipelines, opened by [`GpuContext::open`] or taken from a caller who has
//! one. [`WgpuExecutor`] runs [`Recording`](manyview_shaders::executor::Recording)s on it; every job makes its own and
//! drops it. [`GpuDevice`] is the bake's backend. [`GpuScene`] is a bake streamed to a device.
//!
//! Nothing here asks for more than WebGPU's default limits, and nothing panics: a device that is lost, out of memory
//! or refuses a command gives a [`DeviceError`].

#[cfg(not(target_arch = "wasm32"))]
mod background;
mod context;
mod deform;
mod executor;
mod pipelines;
mod plan;
mod refine;
mod resident;
pub mod scene;
mod stream;

#[cfg(not(target_arch = "wasm32"))]
pub use background::BackgroundRefinement;
pub use context::{AdapterChoice, GpuContext, OpenError};
pub use deform::GpuDeformingRows;
pub use executor::WgpuExecutor;
pub use scene::{GpuScene, Progress, StreamError, StreamOptions};

use manyview_shaders::device::{DeviceError, PackedFragment, TriangleBatch, VoxelDevice};
use manyview_shaders::directions::DirectionFrame;
use manyview_shaders::executor::ExecutorLimits;
use manyview_shaders::jobs;
use manyview_shaders::raster::{Grid, VoxelBox};

/// The bake's voxel jobs on a GPU.
#[derive(Debug)]
pub struct GpuDevice {
    context: GpuContext,
    limits: ExecutorLimits,
}

impl GpuDevice {
    /// Opens the adapter that `choice` prefers.
    pub fn open(choice: &AdapterChoice) -> Result<Self, OpenError> {
        Ok(Self::new(GpuContext::open(choice)?))
    }

    /// The jobs on an open device.
    pub fn new(context: GpuContext) -> Self {
        Self { context, limits: ExecutorLimits::DEFAULT }
    }

    /// With smaller buffers and images than the device has, so that jobs are cut into more pieces.
    #[must_use]
    pub fn with_limits(self, limits: ExecutorLimits) -> Self {
        let most = ExecutorLimits::DEFAULT;
        let limits = ExecutorLimits {
            binding_bytes: limits.binding_bytes.min(most.binding_bytes),
            depth_side: limits.depth_side.min(most.depth_side),
        };
        Self { limits, ..self }
    }

    /// The device.
    pub fn context(&self) -> &GpuContext {
        &self.context
    }

    fn executor(&self) -> WgpuExecutor<'_> {
        WgpuExecutor::new(&self.context, self.limits)
    }
}

impl VoxelDevice for GpuDevice {
    fn name(&self) -> String {
        self.context.name().to_owned()
    }

    fn fragments(
        &self,
        grid: Grid,
        clip: &VoxelBox,
        batch: &TriangleBatch,
    ) -> Result<Vec<PackedFragment>, DeviceError> {
        jobs::fragments(&mut self.executor(), grid, clip, batch)
    }

    fn peel(&self, grid: Grid, clip: &VoxelBox, batch: &TriangleBatch) -> Result<Vec<u32>, DeviceError> {
        jobs::peel(&mut self.executor(), grid, clip, batch)
    }

    fn rotate_points(
        &self,
        bits: u32,
        frames: &[DirectionFrame],
        points: &[[i16; 3]],
    ) -> Result<Vec<u32>, DeviceError> {
        jobs::rotate_points(&mut self.executor(), bits, frames, points)
    }

    fn raster_rows(
        &self,
        bits: u32,
        frames: &[DirectionFrame],
        batch: &TriangleBatch,
        peel: bool,
    ) -> Result<Vec<u32>, DeviceError> {
        jobs::raster_rows(&mut self.executor(), bits, frames, batch, peel)
    }
}
