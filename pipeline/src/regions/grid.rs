//! Where bricks lie, what their steps' keys are, and what they will cost.

use crate::cube::SceneCube;
use crate::octree;
use crate::runs::{Cell, CellRuns, Runs};
use crate::scene::Scene;
use crate::steps::{Reader, SHAPES, Steps, step_key};
use manyview_cache::digest::Digest;
use manyview_shaders::raster::Grid;
use rayon::prelude::*;

/// log2 of voxels a side of a brick.
pub const REGION_BITS: u32 = 8;
/// How many of the deepest levels are cut into chunks by bricks.
pub const FINE_LEVELS: u32 = 3;

/// Versions of the steps: bumped when their results change.
const SHAPE_VERSION: u32 = 2;
const LOOK_VERSION: u32 = 1;

/// Where bricks lie, and what all of them share.
#[derive(Clone, Copy)]
pub struct RegionGrid {
    /// The scene cube.
    pub cube: SceneCube,
    /// Its voxels.
    pub grid: Grid,
}

impl RegionGrid {
    /// log2 of voxels a side of a brick.
    pub fn bits(self) -> u32 {
        REGION_BITS.min(self.grid.bits)
    }

    /// Whether level `local` of a brick is one of the deepest.
    pub(super) fn is_fine(self, local: u32) -> bool {
        local + FINE_LEVELS > self.bits()
    }

    pub(super) fn shift(self) -> u32 {
        self.bits() + self.grid.sub_bits
    }

    /// The bricks that the scene's runs reach into.
    pub fn cells(self, scene: &Scene, runs: &Runs) -> CellRuns {
        let snap = |p: glam::DVec3| self.cube.snap(self.grid, p.to_array());
        let cell_of = |p: glam::DVec3| snap(p).map(|c| i64::from(c) >> self.shift());
        CellRuns::new(scene, runs, cell_of, |corners, visit| {
            let corners = corners.map(|p| snap(p).map(i64::from));
            octree::cells_touched(&corners, self.shift(), octree::EVERYWHERE, visit);
        })
    }

    /// What each of some cells will cost. A run's surface is shared by its cells.
    pub fn costs(self, runs: &Runs, cells: &[Cell]) -> Vec<BrickCost> {
        let mut cells_of_run = vec![0u32; runs.runs.len()];
        cells.iter().flat_map(|cell| &cell.runs).for_each(|run| cells_of_run[*run as usize] += 1);
        let voxel = self.cube.size / f64::from(self.grid.size());
        let most = (1u64 << (3 * self.bits())) as f64;
        let cost = |cell: &Cell| {
            let add = |cost: BrickCost, run: &u32| BrickCost {
                triangles: cost.triangles + runs.runs[*run as usize].triangles.len() as u64,
                leaves: cost.leaves
                    + runs.runs[*run as usize].voxels(voxel) / f64::from(cells_of_run[*run as usize]),
            };
            let cost = cell.runs.iter().fold(BrickCost::default(), add);
            BrickCost { leaves: cost.leaves.min(most), ..cost }
        };
        cells.par_iter().map(cost).collect()
    }

    /// Whether the store says that nothing is in a brick.
    pub(crate) fn is_empty(self, steps: &Steps, keys: &RegionKeys) -> bool {
        let counts = |value: &[u8]| Reader(value).u32();
        steps.find(SHAPES, &keys.shape, counts) == Some(0)
    }

    /// The keys of a brick's two steps.
    pub fn keys(self, runs: &Runs, cell: &Cell) -> RegionKeys {
        let key = |name, version, digest: Digest| {
            let mut key = step_key(name, version);
            self.cube.origin.iter().for_each(|c| _ = key.float(*c));
            key.float(self.cube.size).unsigned(self.grid.bits.into()).unsigned(cell.code.into());
            key.digest(&digest).finish()
        };
        RegionKeys {
            shape: key("brick shape", SHAPE_VERSION, cell.digest(runs, |run| run.shape)),
            look: key("brick look", LOOK_VERSION, cell.digest(runs, |run| run.look)),
        }
    }
}

/// What making a brick takes, as far as its runs tell.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct BrickCost {
    /// Triangles of the runs that reach into it.
    pub triangles: u64,
    /// Voxels that they fill.
    pub leaves: f64,
}

impl BrickCost {
    /// Most memory while the brick is made.
    pub fn bytes(self) -> u64 {
        // 26 bytes a snapped triangle, twice while runs are joined, and a few bricks of 64³ of 8 bytes for each. 12 bytes
        // a leaf and its share of inner nodes, while bricks are joined, as planes, and compressed.
        self.triangles * 80 + (self.leaves * 40.0) as u64 + (1 << 18)
    }
}

/// Keys of the steps of a brick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RegionKeys {
    /// Of its shape.
    pub shape: Digest,
    /// Of its look.
    pub look: Digest,
}
