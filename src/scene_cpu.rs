//! The rows of a bake in memory: what a viewer without a GPU loads.

use std::sync::Arc;

use manyview_shaders::directions::{DirectionFrame, DirectionSet, RowLattice};
use manyview_shaders::rows_texture::{RowsImage, RowsTexture, RowsTextureError};
use manyview_shaders::sections::RowsInfo;

use crate::archive::{Archive, LoadError};
use crate::rays::paper::PaperRows;

/// All rows of a bake with what is needed to ask them, the counterpart of [`GpuScene`](crate::gpu::GpuScene) for the
/// CPU.
///
/// Loading takes the memory of the rows and one chunk a thread. Rows without voxels cost nothing while their pages stay
/// untouched. Clones share the rows.
#[derive(Debug, Clone)]
pub struct CpuScene {
    info: RowsInfo,
    directions: DirectionSet,
    frames: Arc<Vec<DirectionFrame>>,
    rows: Arc<Vec<u32>>,
}

impl CpuScene {
    /// Loads the rows, on all threads of the current rayon pool.
    pub fn load(archive: &Archive) -> Result<Self, LoadError> {
        let frames = archive.frames()?;
        let no_rows = || LoadError::NoRows { archive: archive.name().to_owned() };
        let info = *archive.rows_info().ok_or_else(no_rows)?;
        let directions = archive.direction_set().ok_or_else(no_rows)?;
        let rows = archive.rows(0..info.directions)?;
        Ok(Self { info, directions, frames: Arc::new(frames), rows: Arc::new(rows) })
    }

    /// What the rows are.
    pub fn rows_info(&self) -> &RowsInfo {
        &self.info
    }

    /// The sampled directions.
    pub fn direction_set(&self) -> DirectionSet {
        self.directions
    }

    /// Where the frames start from.
    pub fn row_lattice(&self) -> RowLattice {
        RowLattice { center: self.info.center, half_extent: self.info.half_extent }
    }

    /// The frame of every direction.
    pub fn frames(&self) -> &[DirectionFrame] {
        &self.frames
    }

    /// Direction after direction, layout of `rows.bits` ([`manyview_shaders::sections`]).
    pub fn words(&self) -> &Arc<Vec<u32>> {
        &self.rows
    }

    /// The paper's own test over these rows; [`RowTester::of`](crate::rays::RowTester::of) is ours.
    pub fn paper_rows(&self) -> PaperRows {
        let (frames, rows) = (Arc::clone(&self.frames), Arc::clone(&self.rows));
        PaperRows::new(self.directions, self.row_lattice(), self.info.bits, frames, rows)
    }

    /// The rows as a texture, for stages on the CPU
    /// ([`CpuExecutor::share_rows`](manyview_shaders::executor::CpuExecutor::share_rows)). The words are shared, not
    /// copied. An error where no texture within WebGPU's default limits holds them.
    pub fn rows_image(&self) -> Result<RowsImage, RowsTextureError> {
        let layout = RowsTexture::new(self.info.bits, self.info.directions)?;
        Ok(RowsImage::new(layout, Arc::clone(&self.rows)))
    }
}
