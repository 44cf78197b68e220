//! What a bake will cost, told before it starts, and how it is cut so that its memory holds.
//!
//! # Theory
//! Memory is what stays (the scene, its runs), what stays while the octree is made (textures halved again and again,
//! alpha planes, compressed bricks that wait for their place), and what a piece of work takes while it is made. The
//! last two can be cut: bricks wait on disk ([`ChunkSpool`](manyview_cache::archive::ChunkSpool)), and fewer are made at
//! the same time. [`Budget`] says how far.
//!
//! # Practice
//! Everything follows from counts: triangles, their surface in voxels, the bricks that they reach into, texels. The
//! factors are measured (`manyview bench estimates` compares them with what happens).

use crate::bake::BakeOptions;
use crate::cube::SceneCube;
use crate::regions::{BrickCost, RegionGrid};
use crate::rows::{RowsFrom, RowsOptions, point_bits};
use crate::runs::{Cell, Run, Runs};
use crate::sample;
use crate::scene::Scene;
use crate::triangles::material_of;
use manyview_cache::archive::MAX_CHUNK_BYTES;
use manyview_shaders::directions::RowLattice;
use manyview_shaders::raster::Grid;

/// Costs to expect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Triangles drawn.
    pub triangles: u64,
    /// Leaves of the octree.
    pub leaves: u64,
    /// Points that rows are made from.
    pub points: u64,
    /// Peak memory of the process.
    pub peak_bytes: u64,
    /// The least that `--max-memory` must allow.
    pub least_bytes: u64,
    /// Rows before compression.
    pub rows_raw_bytes: u64,
    /// Of the archive, the octree.
    pub svo_bytes: u64,
    /// Size of the archive.
    pub archive_bytes: u64,
    /// Time without a cache, by a processor like the one that the factors were measured on.
    pub seconds: f64,
}

/// How a bake is cut so that it stays within `--max-memory`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Budget {
    /// What bricks may take that are made at the same time.
    pub bricks_bytes: u64,
    /// What finished bricks may take in memory; the others wait on disk.
    pub spool_bytes: u64,
    /// Packs of rows that are made at the same time, and whether the next are made while these are written.
    pub rows_packs: usize,
}

/// A mebibyte.
const MIB: u64 = 1 << 20;
/// Bricks that may be made at the same time, for each thread, where there is room: enough that no thread waits for long.
const BRICKS_BYTES: u64 = 32 * MIB;
/// Finished bricks in memory, at most: beyond this size writing them twice costs little.
const SPOOL_BYTES: u64 = 512 * MIB;
/// The program and what each thread keeps: compressors, and buffers of the size of a chunk.
const PROGRAM_BYTES: u64 = 14 * MIB;
const THREAD_BYTES: u64 = 6 * MIB;
/// Results on their way to the store, and its lists.
const STORE_BYTES: u64 = 16 * MIB;
/// What a leaf takes where no piece of the octree was made.
const USUAL_LEAF: sample::Sample = sample::Sample { bytes: 4.0, seconds: 0.5e-6 };
/// Pieces compress worse than what they are pieces of, and overlap less.
const LARGE_LEAVES: f64 = 0.75;
const LARGE_ROWS: f64 = 0.88;
/// Threads wait for each other, for memory and for the disk: what all of them take, over what each takes of the pieces.
const SHARED_SECONDS: f64 = 1.1;
/// Of the limit, what is planned for; allocators keep some of what is given back.
const PLANNED_PERCENT: u64 = 85;

/// What the scene's parts take.
struct SceneBytes {
    /// From the import to the end.
    scene: u64,
    /// While the octree is made: textures halved again and again, alpha planes and masks.
    looks: u64,
    /// While points are made: alpha planes and masks.
    cutouts: u64,
}

impl SceneBytes {
    fn new(scene: &Scene) -> Self {
        let mesh_bytes = |mesh: &crate::scene::Mesh| {
            (mesh.positions.len() * 12
                + mesh.normals.len() * 12
                + (mesh.base_color_uvs.len() + mesh.emissive_uvs.len()) * 8
                + mesh.colors.len() * 16
                + mesh.triangles.len() * 12) as u64
        };
        let texels: u64 = scene.textures.iter().map(|texture| texture.texels.len() as u64).sum();
        let meshes: u64 = scene.meshes.iter().map(mesh_bytes).sum();
        let mut cutouts = 0;
        let mut is_cut = vec![false; scene.textures.len()];
        for mesh in &scene.meshes {
            let material = material_of(scene, mesh);
            if material.alpha_mode.cutoff().is_some() {
                let mask = material.base_color_texture.map_or(0, |texture| {
                    is_cut[texture as usize] = true;
                    size_of::<manyview_shaders::masks::TriangleMask>()
                });
                cutouts += (mesh.triangles.len() * (8 + mask)) as u64;
            }
        }
        let planes = scene.textures.iter().zip(is_cut).filter(|(_, is_cut)| *is_cut);
        cutouts += planes.map(|(texture, _)| texture.texels.len() as u64).sum::<u64>();
        Self { scene: meshes + texels * 4, looks: texels * 4 + cutouts, cutouts }
    }
}

/// About how many cells of the points' grid the runs touch. Its cells are as flat as the scene is.
fn expected_points(runs: &Runs, bits: u32) -> f64 {
    let Some((min, max)) = runs.bounds() else { return 0.0 };
    let lattice = RowLattice::new(min.to_array(), max.to_array());
    let cells_per_metre = lattice.half_extent.map(|half| f64::from(1u32 << bits) / (2.0 * half));
    let of_run = |run: &Run| {
        let [x, y, z] = cells_per_metre;
        let facing = [run.facing[0] * y * z, run.facing[1] * z * x, run.facing[2] * x * y];
        let most = facing.iter().fold(0.0f64, |a, b| a.max(*b));
        let surface = most + (facing.iter().sum::<f64>() - most) * 0.5;
        let size = run.bounds[1] - run.bounds[0];
        let room: f64 = (0..3).map(|i| size[i] * cells_per_metre[i] + 1.0).product();
        let filled = room * -(-surface / room).exp_m1();
        if filled.is_finite() { filled } else { surface.min(room) }
    };
    let sum: f64 = runs.runs.iter().map(of_run).sum();
    sum.min((1u64 << (3 * bits)) as f64)
}

/// What a bake takes of everything.
pub(crate) struct Plan {
    pub(crate) estimate: Estimate,
    pub(crate) budget: Budget,
    /// The bricks that runs reach into, and what each will cost.
    pub(crate) cells: Vec<Cell>,
    pub(crate) costs: Vec<BrickCost>,
}

impl Plan {
    /// Counts, and cuts the work so that it fits the limit if it can.
    /// `read_bytes` were in memory while the scene was imported; a `has_store` bake keeps the results of its steps.
    pub(crate) fn new(
        scene: &Scene,
        options: &BakeOptions,
        runs: &Runs,
        cube: SceneCube,
        read_bytes: u64,
        has_store: bool,
    ) -> Self {
        let grid = RegionGrid { cube, grid: Grid::new(options.levels) };
        let cells = grid.cells(scene, runs).cells;
        let costs = grid.costs(runs, &cells);
        let threads = rayon::current_num_threads() as u64;
        let bytes = SceneBytes::new(scene);
        // `as` saturates; halves of the largest number can still be added.
        let whole = |x: f64| if x.is_finite() { (x.ceil() as u64).min(1 << 56) } else { 1 << 56 };

        let leaves = whole(costs.iter().map(|cost| cost.leaves).sum());
        let of_leaf = sample::octree(scene, runs, grid, &cells, &costs).unwrap_or(USUAL_LEAF);
        let octree_bytes = whole(leaves as f64 * of_leaf.bytes * LARGE_LEAVES);
        let entries: u64 = cells.iter().map(|cell| cell.runs.len() as u64).sum();
        let program = options.held_bytes.max(PROGRAM_BYTES) + if has_store { STORE_BYTES } else { 0 };
        let fixed = program
            + threads * THREAD_BYTES
            + bytes.scene
            + (runs.runs.len() * size_of::<Run>()) as u64
            + entries * 8
            + cells.len() as u64 * 3000;
        let largest = costs.iter().map(|cost| cost.bytes()).max().unwrap_or(0);
        let all: u64 = costs.iter().fold(0, |sum, cost| sum.saturating_add(cost.bytes()));
        // Levels above the fine ones stay as they are.
        let coarse = leaves / 64 * 36;

        let rows = options.rows.map(|rows| RowsCost::new(rows, scene, runs));
        let rows = rows.unwrap_or_default();
        let rows_least = rows.points_bytes.max(rows.rows_bytes + threads * MAX_CHUNK_BYTES as u64);

        let planned = options.max_memory_bytes / 100 * PLANNED_PERCENT;
        let room = planned.saturating_sub(fixed + bytes.looks + coarse);
        let bricks_bytes = (room / 4 * 3).min(threads * BRICKS_BYTES).max(largest);
        let spool_bytes = room.saturating_sub(bricks_bytes).min(SPOOL_BYTES);
        let pack_bytes = rows.pack_bytes.max(1);
        let rows_room = planned.saturating_sub(fixed + rows.rows_bytes);
        let rows_packs = (rows_room / (2 * pack_bytes)).clamp(1, threads) as usize;
        let budget = Budget { bricks_bytes, spool_bytes, rows_packs };

        let waiting = octree_bytes.min(spool_bytes) + coarse;
        // A thread that waits for a part of its brick begins another.
        let making = all.min(bricks_bytes).min(largest * threads * 3 / 2);
        let octree = bytes.looks + making + waiting;
        let points = rows.points_bytes + bytes.cutouts + waiting;
        let writing = rows.rows_bytes + rows_packs as u64 * pack_bytes * 2;
        let importing = program + bytes.scene + read_bytes;
        let peak_bytes = (fixed + octree.max(points).max(writing)).max(importing);
        let least = fixed + (bytes.looks + coarse + largest).max(rows_least + coarse);
        let least_bytes = least / PLANNED_PERCENT * 100;
        let shared = if threads > 1 { SHARED_SECONDS } else { 1.0 };
        let estimate = Estimate {
            triangles: scene.drawn_triangles(),
            leaves,
            points: rows.points,
            peak_bytes,
            least_bytes,
            rows_raw_bytes: rows.raw_bytes,
            svo_bytes: octree_bytes,
            archive_bytes: octree_bytes + rows.stored_bytes,
            seconds: (leaves as f64 * of_leaf.seconds + rows.seconds) * shared / threads as f64,
        };
        Self { estimate, budget, cells, costs }
    }
}

/// What rows take.
#[derive(Default)]
struct RowsCost {
    points: u64,
    raw_bytes: u64,
    stored_bytes: u64,
    /// While points are made.
    points_bytes: u64,
    /// While rows are made.
    rows_bytes: u64,
    /// A pack of blocks, compressed.
    pack_bytes: u64,
    /// Of one thread.
    seconds: f64,
}

impl RowsCost {
    fn new(options: RowsOptions, scene: &Scene, runs: &Runs) -> Self {
        let triangles = scene.drawn_triangles();
        let points = expected_points(runs, point_bits(options)).ceil() as u64;
        let directions = u64::from(options.directions.count());
        let raw_bytes = directions << (3 * options.bits) >> 3;
        let (min, max) = runs.bounds().unwrap_or_default();
        let lattice = RowLattice::new(min.to_array(), max.to_array());
        let sample = sample::rows(scene, runs, options, &lattice, points);
        let rows = (directions << (2 * options.bits)) as f64;
        let stored_bytes = (rows * sample.bytes * LARGE_ROWS) as u64;
        let flat = if options.from == RowsFrom::Points { 0 } else { triangles.saturating_mul(52) };
        let pack = raw_bytes.min(16 * MAX_CHUNK_BYTES as u64);
        Self {
            points,
            raw_bytes,
            stored_bytes,
            points_bytes: points * 36 + flat,
            rows_bytes: points * 12 + flat,
            pack_bytes: stored_bytes.saturating_mul(pack) / raw_bytes.max(1),
            seconds: rows * sample.seconds,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Instance, Mesh};
    use glam::{DMat4, Vec3};

    /// A square of 32 × 32 voxels across the cube, drawn some times.
    fn square(corners: [[f32; 3]; 4], times: usize, max_memory_bytes: u64) -> Plan {
        let mesh = Mesh {
            positions: corners.map(Vec3::from_array).to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        let scene = Scene {
            meshes: vec![mesh],
            instances: vec![Instance { mesh: 0, world_from_object: DMat4::IDENTITY }; times],
            ..Scene::default()
        };
        let options = BakeOptions { levels: 5, rows: None, max_memory_bytes, ..BakeOptions::default() };
        let cube = SceneCube { origin: [0.0; 3], size: 32.0 };
        Plan::new(&scene, &options, &Runs::new(&scene), cube, 0, false)
    }

    const FLAT: [[f32; 3]; 4] = [[0.0, 5.0, 0.0], [32.0, 5.0, 0.0], [32.0, 5.0, 32.0], [0.0, 5.0, 32.0]];

    #[test]
    fn a_plane_has_about_as_many_leaves_as_it_shows_to_the_axis_it_faces() {
        let flat = square(FLAT, 1, 8 << 30).estimate;
        assert_eq!((flat.triangles, flat.rows_raw_bytes), (2, 0));
        assert!((750..=1024).contains(&flat.leaves), "{}", flat.leaves);
        // At 45 degrees half of the other axis' samples may fall into new voxels.
        let slanted = [[0.0, 0.0, 0.0], [32.0, 32.0, 0.0], [32.0, 32.0, 32.0], [0.0, 0.0, 32.0]];
        let slanted = square(slanted, 1, 8 << 30).estimate;
        assert!((1450..=1536).contains(&slanted.leaves), "{}", slanted.leaves);
        assert!(slanted.archive_bytes > 0 && slanted.peak_bytes >= PROGRAM_BYTES);
    }

    #[test]
    fn there_are_no_more_leaves_than_cells_and_sums_do_not_overflow() {
        let huge = [[0.0, 0.0, 0.0], [1e30, 0.0, 0.0], [1e30, 1.0, 1e30], [0.0, 1.0, 1e30]];
        let plan = square(huge, 40, 8 << 30);
        assert!(plan.estimate.leaves <= 1 << 15, "{}", plan.estimate.leaves);
    }

    #[test]
    fn less_memory_makes_smaller_pieces_until_none_is_left() {
        let [much, little] = [8 << 30, 40 << 20].map(|limit| square(FLAT, 1, limit));
        assert!(much.budget.spool_bytes == SPOOL_BYTES && little.budget.spool_bytes < 40 << 20);
        assert!(much.estimate.peak_bytes >= little.estimate.peak_bytes);
        assert_eq!(much.estimate.least_bytes, little.estimate.least_bytes, "whatever the limit");
        let none = square(FLAT, 1, 1 << 20);
        assert!(none.estimate.least_bytes > 1 << 20);
        assert_eq!(none.budget.bricks_bytes, none.costs[0].bytes(), "one brick at a time");
    }
}
