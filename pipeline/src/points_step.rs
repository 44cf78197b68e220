//! The surface points as steps: cell by cell of a grid over the row lattice.
//!
//! A cell's points are a function of the runs that reach into it. All cells of a scene are one value of the store; the
//! next bake with the same settings starts from the last one's and samples anew only those cells whose runs differ.

use crate::points::{POINT_CELL_BITS, cell_code, coarse_cell, keyed_points, merge_points};
use crate::runs::{Cell, CellRuns, Runs};
use crate::scene::Scene;
use crate::steps::{POINTS, Reader, StepKind, Steps, step_key};
use crate::triangles::{Cutouts, LatticeTriangles};
use manyview_cache::digest::{Digest, KeyEncoder};
use manyview_shaders::directions::RowLattice;
use rayon::prelude::*;
use std::ops::Range;

/// Version of the step: bumped when its results change.
const VERSION: u32 = 1;

/// Surface points by cells.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct PointCells {
    /// Cells in ascending order of their codes.
    pub cells: Vec<PointCell>,
    /// The points of all cells, in the order of cells, in Morton order of finer cells within.
    pub points: Vec<[i16; 3]>,
}

/// One cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PointCell {
    /// Its Morton code.
    pub code: u32,
    /// Number of its points.
    pub count: u32,
    /// Identity of what reaches into it.
    pub digest: Digest,
}

impl PointCells {
    /// The identity of the points, whatever they were made from.
    pub fn digest(&self) -> Digest {
        Digest::of(bytemuck::cast_slice(&self.points))
    }

    pub(crate) fn save(&self) -> Vec<u8> {
        let mut value = Vec::with_capacity(4 + self.cells.len() * 40 + self.points.len() * 6);
        value.extend((self.cells.len() as u32).to_le_bytes());
        for cell in &self.cells {
            value.extend(cell.code.to_le_bytes());
            value.extend(cell.count.to_le_bytes());
            value.extend(cell.digest.0);
        }
        value.extend_from_slice(bytemuck::cast_slice(&self.points));
        value
    }

    fn load(value: &[u8]) -> Option<Self> {
        let mut reader = Reader(value);
        let count = reader.u32()?;
        let cells: Vec<PointCell> = (0..count)
            .map(|_| Some(PointCell { code: reader.u32()?, count: reader.u32()?, digest: reader.digest()? }))
            .collect::<Option<_>>()?;
        let total: u64 = cells.iter().map(|cell| u64::from(cell.count)).sum();
        let points = reader.0;
        (points.len() as u64 == total * 6).then_some(())?;
        let point = |bytes: &[u8]| [0, 2, 4].map(|at| i16::from_le_bytes([bytes[at], bytes[at + 1]]));
        Some(Self { cells, points: points.chunks_exact(6).map(point).collect() })
    }

    /// Each cell with the range of its points.
    pub(crate) fn ranges(&self) -> impl Iterator<Item = (&PointCell, Range<usize>)> {
        self.cells.iter().scan(0, |start, cell| {
            let range = *start..*start + cell.count as usize;
            *start = range.end;
            Some((cell, range))
        })
    }
}

/// The points of a scene: where they lie, and how densely.
#[derive(Clone, Copy)]
pub struct PointsJob<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Its runs.
    pub runs: &'a Runs,
    /// The lattice of the points.
    pub lattice: RowLattice,
    /// Points are kept one per cell of a grid of `2^bits` cells a side.
    pub bits: u32,
    /// The store.
    pub steps: &'a Steps,
}

/// Triangles that are flattened at the same time, about.
const WAVE_TRIANGLES: usize = 1 << 20;

/// Cuts pieces into waves of about [`WAVE_TRIANGLES`].
fn waves(pieces: &[(u32, Range<u32>)]) -> Vec<&[(u32, Range<u32>)]> {
    let mut waves = Vec::new();
    let (mut start, mut triangles) = (0, 0);
    for (at, (_, range)) in pieces.iter().enumerate() {
        triangles += range.len();
        if triangles >= WAVE_TRIANGLES {
            waves.push(&pieces[start..=at]);
            (start, triangles) = (at + 1, 0);
        }
    }
    waves.push(&pieces[start..]);
    waves
}

/// Adds what all keys of rows share.
pub(crate) fn lattice_key(key: &mut KeyEncoder, lattice: &RowLattice) {
    lattice.center.iter().chain(&lattice.half_extent).for_each(|c| _ = key.float(*c));
}

impl PointsJob<'_> {
    /// The cells of the scene with their digests, and no points.
    pub fn cells(&self) -> Vec<(Cell, Digest)> {
        let bits = POINT_CELL_BITS;
        let snap = |p: glam::DVec3| self.lattice.snap(p.to_array());
        let cell_of = |p: glam::DVec3| cell_code(snap(p), bits).map(i64::from);
        let cells = CellRuns::new(self.scene, self.runs, cell_of, |corners, visit| {
            // Points lie within the bounds of their triangle.
            let of = corners.map(cell_of);
            let [lo, hi] =
                [i64::min, i64::max].map(|f| [0, 1, 2].map(|i| f(f(of[0][i], of[1][i]), of[2][i])));
            for z in lo[2]..=hi[2] {
                for y in lo[1]..=hi[1] {
                    (lo[0]..=hi[0]).for_each(|x| visit([x, y, z]));
                }
            }
        });
        let digest = |cell: Cell| {
            let digest = cell.digest(self.runs, |run| run.shape);
            (cell, digest)
        };
        cells.cells.into_par_iter().map(digest).collect()
    }

    /// The key of the points.
    pub fn key(&self, cells: &[(Cell, Digest)]) -> Digest {
        let mut key = step_key("points", VERSION);
        lattice_key(&mut key, &self.lattice);
        key.unsigned(self.bits.into()).sequence(cells.len());
        for (cell, digest) in cells {
            key.unsigned(cell.code.into()).digest(digest);
        }
        key.finish()
    }

    /// The points: from the store, from the cells of `last` that are the same, or sampled.
    pub fn run(&self, cells: &[(Cell, Digest)], key: Digest, last: Option<&PointCells>) -> PointCells {
        if let Some(found) = self.steps.find(POINTS, &key, PointCells::load) {
            self.steps.count(StepKind::Points, cells.len(), 0, 0);
            return found;
        }
        let mut old = last.map(|last| last.ranges().peekable());
        // The range of the points of a cell in `last`, where they are the same.
        let kept: Vec<Option<Range<usize>>> = cells
            .iter()
            .map(|(cell, digest)| {
                let old = old.as_mut()?;
                while old.next_if(|(other, _)| other.code < cell.code).is_some() {}
                let (_, range) =
                    old.next_if(|(other, _)| other.code == cell.code && other.digest == *digest)?;
                Some(range)
            })
            .collect();
        let fresh = self.sample(cells, &kept);
        let mut result = PointCells::default();
        let mut fresh = fresh.chunk_by(|a, b| a.0 == b.0).peekable();
        for ((cell, digest), kept) in cells.iter().zip(&kept) {
            let start = result.points.len();
            match (kept, last) {
                (Some(range), Some(last)) => result.points.extend_from_slice(&last.points[range.clone()]),
                _ => {
                    if let Some(points) = fresh.next_if(|points| points[0].0 == cell.code) {
                        result.points.extend(points.iter().map(|(_, point)| *point));
                    }
                }
            }
            let count = (result.points.len() - start) as u32;
            result.cells.push(PointCell { code: cell.code, count, digest: *digest });
        }
        let reused = kept.iter().flatten().count();
        self.steps.count(StepKind::Points, reused, cells.len() - reused, 0);
        if self.steps.has_store() {
            self.steps.keep(POINTS, key, result.save(), None);
        }
        result
    }

    /// The points of the cells that are not kept, each with its cell's code, in Morton order.
    fn sample(&self, cells: &[(Cell, Digest)], kept: &[Option<Range<usize>>]) -> Vec<(u32, [i16; 3])> {
        let mut wanted_runs = vec![false; self.runs.runs.len()];
        let mut wanted_meshes = vec![false; self.scene.meshes.len()];
        let mut wanted_cells = vec![false; 1 << (3 * POINT_CELL_BITS)];
        for ((cell, _), _) in cells.iter().zip(kept).filter(|(_, kept)| kept.is_none()) {
            wanted_cells[cell.code as usize] = true;
            cell.runs.iter().for_each(|run| wanted_runs[*run as usize] = true);
        }
        let pieces: Vec<_> = self
            .runs
            .runs
            .iter()
            .zip(&wanted_runs)
            .filter(|(_, wanted)| **wanted)
            .map(|(run, _)| (run.instance, run.triangles.clone()))
            .collect();
        for (instance, _) in &pieces {
            wanted_meshes[self.scene.instances[*instance as usize].mesh as usize] = true;
        }
        let cutouts = Cutouts::of_meshes(self.scene, |mesh| wanted_meshes[mesh]);
        let mut keyed = Vec::new();
        // Never all triangles at once: a few instanced meshes may draw billions.
        for pieces in waves(&pieces) {
            let triangles = LatticeTriangles::of_pieces(self.scene, &cutouts, pieces, |p| {
                self.lattice.snap(p.to_array())
            });
            let points = keyed_points(&triangles, &cutouts, self.bits, |cell| wanted_cells[cell as usize]);
            merge_points(&mut keyed, points);
        }
        keyed.iter_mut().for_each(|(key, _)| *key = coarse_cell(*key, self.bits));
        keyed
    }
}

/// Loads the points that an earlier bake kept.
pub(crate) fn load_points(steps: &Steps, key: &Digest) -> Option<PointCells> {
    steps.find(POINTS, key, PointCells::load)
}
