//! What the bake asks of a backend: the four voxel jobs, the same bits from every implementation.
//!
//! The bake's CPU backend has its own fast code for these; a [`VoxelDevice`] is how it reaches a GPU without knowing
//! one. Implementations must agree bit for bit with [`crate::raster`], [`crate::masks`] and [`crate::directions`].

use crate::directions::DirectionFrame;
use crate::masks::{AlphaPlane, TriangleMask};
use crate::raster::{Fragment, Grid, VoxelBox};
use bytemuck::{Pod, Zeroable};
use thiserror::Error;

/// Why a backend could not do a job.
#[derive(Debug, Error)]
pub enum DeviceError {
    /// The device ran out of memory or a buffer exceeds its limits.
    #[error("{what} needs {needed_bytes} bytes on the device, the limit is {limit_bytes}; use --backend cpu")]
    TooLarge {
        /// What was to be allocated.
        what: &'static str,
        /// Bytes it needs.
        needed_bytes: u64,
        /// Bytes there are.
        limit_bytes: u64,
    },
    /// The device was lost or reported an error.
    #[error("the GPU failed: {0}")]
    Failed(String),
}

/// One fragment as the GPU writes it, 12 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
pub struct PackedFragment {
    /// Voxel relative to the clip box's smallest corner: x in bits 0–9, y in 10–19, z in 20–29.
    pub voxel: u32,
    /// Index of the triangle in the job.
    pub triangle: u32,
    /// Weights of vertices 1 and 2 (at most 2^15 each): bits 0–15 and 16–31.
    pub barycentric: u32,
}

impl PackedFragment {
    /// Packs a fragment of triangle `triangle` in a box whose smallest corner is `corner`.
    #[inline]
    pub fn new(fragment: Fragment, corner: [i32; 3], triangle: u32) -> Self {
        let [x, y, z] = [0, 1, 2].map(|i| (fragment.voxel[i] - corner[i]) as u32);
        let [b1, b2] = fragment.barycentric;
        Self { voxel: x | y << 10 | z << 20, triangle, barycentric: b1 | b2 << 16 }
    }
}

/// Triangles to voxelize and how they are cut.
#[derive(Debug, Clone, Copy)]
pub struct TriangleBatch<'a> {
    /// Vertices in lattice coordinates: the grid's lattice (0 ..= 32767) for octree jobs, the row lattice
    /// (−16384 ..= 16384) for row jobs.
    pub triangles: &'a [[[i16; 3]; 3]],
    /// For each triangle the index of its mask, or [`crate::masks::UNMASKED`]; empty if no triangle is cut.
    pub mask_of: &'a [u32],
    /// Masks.
    pub masks: &'a [TriangleMask],
    /// The alpha planes that masks refer to.
    pub planes: &'a [AlphaPlane],
}

/// A backend for the bake's voxel jobs. Results do not depend on the implementation, but for the order of fragments.
pub trait VoxelDevice: Sync {
    /// Name of the adapter or processor, for reports.
    fn name(&self) -> String;

    /// All fragments of the triangles along all three axes within `clip` (at most 1024 voxels a side), in any order.
    fn fragments(
        &self,
        grid: Grid,
        clip: &VoxelBox,
        batch: &TriangleBatch,
    ) -> Result<Vec<PackedFragment>, DeviceError>;

    /// The voxels of `clip` that any fragment falls in, by real depth peeling along three axes: one bit each, x
    /// fastest, then y, then z; bit i of the box is bit `i % 32` of word `i / 32`.
    fn peel(&self, grid: Grid, clip: &VoxelBox, batch: &TriangleBatch) -> Result<Vec<u32>, DeviceError>;

    /// For each frame, the grid of `2^bits` voxels a side with the bit of every point set; layout of `rows.bits`
    /// ([`crate::sections`]), `2^(3 · bits) / 32` words each.
    fn rotate_points(
        &self,
        bits: u32,
        frames: &[DirectionFrame],
        points: &[[i16; 3]],
    ) -> Result<Vec<u32>, DeviceError>;

    /// For each frame, the grid with every voxel set that a fragment of the triangles, transformed into the frame and
    /// snapped to the grid's lattice, falls in; by depth peeling if `peel`, else in one pass. Layout as above.
    fn raster_rows(
        &self,
        bits: u32,
        frames: &[DirectionFrame],
        batch: &TriangleBatch,
        peel: bool,
    ) -> Result<Vec<u32>, DeviceError>;
}

/// Lattice coordinates (of [`Grid::new`]`(bits)`) of a row-lattice point in a direction's frame, axes u, v, w.
#[inline]
pub fn grid_point(frame: &DirectionFrame, grid: Grid, point: [i16; 3]) -> [i32; 3] {
    frame.raw(point).map(|raw| raw >> (crate::directions::ROW_RAW_BITS - grid.bits - grid.sub_bits))
}
