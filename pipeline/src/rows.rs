//! Triangles in, bit rows of every direction out.
//!
//! # Theory
//! \[WMP\] Algorithm 1 voxelizes the scene once per direction with depth peeling along three axes; Algorithm 5 rotates the
//! voxels of one voxelization into all others.
//!
//! # Differences from the paper
//! [`RowsFrom::Peel`] and [`RowsFrom::Rotate`] are the paper's two ways, in integers. [`RowsFrom::Points`] rotates
//! points on the surface ([`crate::points`]): nearly as cheap as the second, and about as near to exact rays as the
//! first (`bakes/REPORT.md`).
//!
//! # Practice
//! Directions are independent. A block of them (4 MiB of rows) is voxelized and compressed by one thread. What is
//! looked up in a store, and what is made, decides [`crate::rows_step`].

use crate::bake::BakeError;
use crate::points::{coarse_boxes, surface_points, voxel_centers};
use crate::rows_frames::fit_frames;
use crate::triangles::{Cutouts, LatticeTriangles};
use manyview_cache::archive::{CompressedChunk, MAX_CHUNK_BYTES};
use manyview_shaders::device::{VoxelDevice, grid_point};
use manyview_shaders::directions::{DirectionFrame, DirectionSet, Fit, RowLattice};
use manyview_shaders::raster::{Grid, Raster, VoxelBox};
use manyview_shaders::rotate::{SpreadPoints, rotate_points};
use manyview_shaders::sections::RowsInfo;
use std::borrow::Cow;

/// How rows are voxelized.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RowsFrom {
    /// Every direction from the triangles, along three axes (\[WMP\] Algorithm 1). On a GPU by depth peeling; on the CPU
    /// in one pass, which gives the same bits.
    Peel,
    /// One voxelization, rotated (\[WMP\] Algorithm 5).
    Rotate,
    /// A dense set of surface points, rotated.
    Points,
}

impl RowsFrom {
    /// Every way, with the name that the command line uses.
    pub const ALL: [(RowsFrom, &'static str); 3] =
        [(RowsFrom::Peel, "peel"), (RowsFrom::Rotate, "rotate"), (RowsFrom::Points, "points")];
}

impl std::fmt::Display for RowsFrom {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(Self::ALL.iter().find(|(way, _)| way == self).expect("all ways are listed").1)
    }
}

/// What rows to make.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RowsOptions {
    /// log2 of voxels a side: 5, 6, 7 or 8.
    pub bits: u32,
    /// The sampled directions.
    pub directions: DirectionSet,
    /// How each direction's grid lies around the scene.
    pub fit: Fit,
    /// How rows are voxelized.
    pub from: RowsFrom,
}

/// log2 of cells per voxel edge: a point is kept per cell of half a voxel's edge. Twice as many give no smaller error
/// against exact rays (bakes/REPORT.md), and four times the work.
pub const POINT_BITS_ABOVE_VOXELS: u32 = 1;
/// Finest grid of cells that points are kept by: Morton codes have 10 bits per axis.
const MAX_POINT_BITS: u32 = 10;

impl RowsOptions {
    /// The head of the sections of rows on a lattice.
    pub fn info(self, lattice: &RowLattice) -> RowsInfo {
        let (set_kind, set_a, set_b) = match self.directions {
            DirectionSet::LatLong { thetas, phis } => (0, thetas, phis),
            DirectionSet::Octahedral { size } => (1, size, 0),
        };
        let mut info = RowsInfo {
            bits: self.bits,
            set_kind,
            set_a,
            set_b,
            fit: match self.fit {
                Fit::Cube => 0,
                Fit::Extent => 1,
            },
            source: match self.from {
                RowsFrom::Peel => 0,
                RowsFrom::Rotate => 1,
                RowsFrom::Points => 2,
            },
            directions: self.directions.count(),
            block_directions: 0,
            center: lattice.center,
            half_extent: lattice.half_extent,
        };
        info.block_directions = (MAX_CHUNK_BYTES / info.direction_bytes()) as u32;
        info
    }
}

/// Everything that the blocks of rows are made from.
pub struct RowsPlan<'a> {
    options: RowsOptions,
    lattice: RowLattice,
    triangles: &'a LatticeTriangles,
    cutouts: &'a Cutouts,
    points: Cow<'a, [[i16; 3]]>,
    spread: SpreadPoints,
    /// One frame per direction.
    pub frames: Vec<DirectionFrame>,
}

impl<'a> RowsPlan<'a> {
    /// Samples the surface and fits the frames. `triangles` are in `lattice`'s coordinates.
    pub fn new(
        options: RowsOptions,
        lattice: RowLattice,
        triangles: &'a LatticeTriangles,
        cutouts: &'a Cutouts,
    ) -> Self {
        Self::with_density(options, lattice, triangles, cutouts, POINT_BITS_ABOVE_VOXELS)
    }

    /// Like [`RowsPlan::new`], with `2^point_bits` cells per voxel edge, each of which keeps one surface point.
    pub fn with_density(
        options: RowsOptions,
        lattice: RowLattice,
        triangles: &'a LatticeTriangles,
        cutouts: &'a Cutouts,
        point_bits: u32,
    ) -> Self {
        let surface = surface_points(triangles, cutouts, (options.bits + point_bits).min(MAX_POINT_BITS));
        let frames = fit_frames(options, &lattice, &coarse_boxes(&surface));
        let points = match options.from {
            RowsFrom::Peel => Vec::new(),
            RowsFrom::Points => surface,
            RowsFrom::Rotate => rotated_centers(options, &lattice, triangles, cutouts),
        };
        Self::with_frames(options, lattice, triangles, cutouts, points.into(), frames)
    }

    /// Takes the points that are rotated (none for [`RowsFrom::Peel`]) and the frames of all directions. Only
    /// [`RowsFrom::Peel`] looks at the triangles.
    pub fn with_frames(
        options: RowsOptions,
        lattice: RowLattice,
        triangles: &'a LatticeTriangles,
        cutouts: &'a Cutouts,
        points: Cow<'a, [[i16; 3]]>,
        frames: Vec<DirectionFrame>,
    ) -> Self {
        let spread = SpreadPoints::new(&points);
        Self { options, lattice, triangles, cutouts, points, spread, frames }
    }

    /// Number of points that are rotated; 0 where triangles are voxelized.
    pub fn point_count(&self) -> usize {
        self.points.len()
    }

    /// The points that are rotated, in row-lattice coordinates; empty where triangles are voxelized.
    pub fn points(&self) -> &[[i16; 3]] {
        &self.points
    }

    /// The head of the rows' sections.
    pub fn info(&self) -> RowsInfo {
        self.options.info(&self.lattice)
    }

    /// The rows of some directions, voxelized on the CPU; layout of `rows.bits` ([`manyview_shaders::sections`]).
    pub fn block(&self, frames: &[DirectionFrame]) -> Vec<u32> {
        let words = self.info().direction_bytes() / 4;
        let mut rows = vec![0u32; words * frames.len()];
        for (frame, out) in frames.iter().zip(rows.chunks_exact_mut(words)) {
            match self.options.from {
                RowsFrom::Peel => {
                    raster_direction(frame, self.options.bits, self.triangles, self.cutouts, out);
                }
                RowsFrom::Rotate | RowsFrom::Points => {
                    rotate_points(frame, self.options.bits, &self.spread, out);
                }
            }
        }
        rows
    }

    pub(crate) fn block_on(
        &self,
        device: &dyn VoxelDevice,
        frames: &[DirectionFrame],
    ) -> Result<Vec<u32>, BakeError> {
        let rows = match self.options.from {
            RowsFrom::Peel => {
                device.raster_rows(self.options.bits, frames, &self.triangles.batch(self.cutouts), true)
            }
            RowsFrom::Rotate | RowsFrom::Points => {
                device.rotate_points(self.options.bits, frames, &self.points)
            }
        };
        Ok(rows?)
    }

    /// Compresses a block.
    pub(crate) fn compress(&self, rows: &[u32]) -> CompressedChunk {
        // The format is little-endian; every target that the bake supports is too.
        CompressedChunk::compress_rows(bytemuck::cast_slice(rows), 1 << (self.options.bits - 3))
    }
}

/// The points per voxel edge of the rows' points, as log2 of cells a side of their whole grid.
pub(crate) fn point_bits(options: RowsOptions) -> u32 {
    (options.bits + POINT_BITS_ABOVE_VOXELS).min(MAX_POINT_BITS)
}

/// The points of [`RowsFrom::Rotate`].
pub(crate) fn rotated_centers(
    options: RowsOptions,
    lattice: &RowLattice,
    triangles: &LatticeTriangles,
    cutouts: &Cutouts,
) -> Vec<[i16; 3]> {
    let radius = lattice.half_extent.iter().map(|h| h * h).sum::<f64>().sqrt();
    let share = match options.fit {
        Fit::Cube => lattice.half_extent.map(|h| h / radius),
        Fit::Extent => [1.0; 3],
    };
    voxel_centers(triangles, cutouts, options.bits, share)
}

fn raster_direction(
    frame: &DirectionFrame,
    bits: u32,
    triangles: &LatticeTriangles,
    cutouts: &Cutouts,
    rows: &mut [u32],
) {
    let grid = Grid::new(bits);
    let clip = VoxelBox::whole(grid);
    let mut set = |[u, v, w]: [i32; 3]| {
        let bit = ((v << bits | u) << bits | w) as u32;
        rows[(bit >> 5) as usize] |= 1 << (bit & 31);
    };
    for (index, triangle) in triangles.triangles.iter().enumerate() {
        let triangle = triangle.map(|p| grid_point(frame, grid, p));
        let mask = triangles.mask(cutouts, index);
        for axis in 0..3 {
            let Some(raster) = Raster::new(grid, &triangle, axis) else { continue };
            match mask {
                None => raster.voxels(&clip, &mut set),
                Some(mask) => raster.fragments(&clip, |f| {
                    if mask.passes(&cutouts.planes, f.barycentric) {
                        set(f.voxel);
                    }
                }),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::triangles::TriangleRef;

    fn scattered(n: usize) -> LatticeTriangles {
        let mut state = 12345u32;
        let mut random = |range: i32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((i64::from(state) * i64::from(range)) >> 32) as i32
        };
        let mut all = LatticeTriangles::default();
        for _ in 0..n {
            let center = [0; 3].map(|_: i32| random(30000) - 15000);
            all.triangles.push([0; 3].map(|_: i32| center.map(|c| (c + random(2700) - 1350) as i16)));
            all.sources.push(TriangleRef { instance: 0, triangle: 0 });
        }
        all
    }

    fn plan<'a>(from: RowsFrom, triangles: &'a LatticeTriangles, cutouts: &'a Cutouts) -> RowsPlan<'a> {
        let lattice = RowLattice::new([-3.0, 0.0, -5.0], [3.0, 4.0, 5.0]);
        let directions = DirectionSet::LatLong { thetas: 4, phis: 5 };
        RowsPlan::new(
            RowsOptions { bits: 5, directions, fit: Fit::Extent, from },
            lattice,
            triangles,
            cutouts,
        )
    }

    #[test]
    fn the_kernel_sets_the_bit_of_every_point() {
        let (triangles, none) = (scattered(200), Cutouts::default());
        let plan = plan(RowsFrom::Points, &triangles, &none);
        let fast = plan.block(&plan.frames);
        let mut plain = vec![0u32; fast.len()];
        for (d, frame) in plan.frames.iter().enumerate() {
            for &p in plan.points() {
                let [u, v, w] = frame.voxel(p, 5);
                plain[d * 1024 + (v * 32 + u) as usize] |= 1 << w;
            }
        }
        assert_eq!(fast, plain);
        assert!(plan.point_count() > 300, "{}", plan.point_count());
    }

    #[test]
    fn points_miss_little_of_what_the_raster_sets() {
        let (triangles, none) = (scattered(200), Cutouts::default());
        let settings = plan(RowsFrom::Points, &triangles, &none);
        let count = |w: &mut dyn Iterator<Item = u32>| w.map(|w| u64::from(w.count_ones())).sum::<u64>();
        // Points at half a voxel's spacing, and at a quarter. Frames are fitted to the points, so each has its own.
        for (density, one_in) in [(POINT_BITS_ABOVE_VOXELS, 5), (2, 20)] {
            let [raster, points] = [RowsFrom::Peel, RowsFrom::Points].map(|from| {
                let options = RowsOptions { from, ..settings.options };
                let plan = RowsPlan::with_density(options, settings.lattice, &triangles, &none, density);
                plan.block(&plan.frames)
            });
            let missed = count(&mut raster.iter().zip(&points).map(|(a, b)| a & !b));
            let set = count(&mut raster.iter().copied());
            assert!(missed * one_in < set, "density {density}: {missed} of {set}");
        }
    }

    #[test]
    fn a_wall_across_the_rows_is_hit_in_every_row() {
        // A square through the middle, facing +Y; direction 0 of a latitude-longitude set runs along +Y.
        let mut wall = LatticeTriangles::default();
        let c = |x: i16, z: i16| [x, 0, z];
        for t in [
            [c(-16384, -16384), c(16384, -16384), c(16384, 16384)],
            [c(-16384, -16384), c(16384, 16384), c(-16384, 16384)],
        ] {
            wall.triangles.push(t);
            wall.sources.push(TriangleRef { instance: 0, triangle: 0 });
        }
        let none = Cutouts::default();
        for from in [RowsFrom::Peel, RowsFrom::Rotate, RowsFrom::Points] {
            let plan = plan(from, &wall, &none);
            let rows = plan.block(&plan.frames[..1]);
            let hit = rows.iter().filter(|&&row| row != 0).count();
            assert!(hit >= 30 * 30, "{from}: {hit} of 1024 rows");
            assert!(rows.iter().all(|row| row.count_ones() <= 1), "{from}: the wall is one voxel thick");
        }
    }
}
