//! Small pieces of the octree and of the rows, made and compressed before the work starts: what they take, all of it
//! will take. How well a surface compresses follows from its textures, its normals and its roughness, which no count
//! tells.
//!
//! Pieces are chosen by a fixed sequence, so that an estimate is the same each time but for its seconds. These are taken
//! when caches are warm, as they are while the work goes on.

use crate::appearance::Appearance;
use crate::octree::{self, Brick, Bricks, brick_fragments, cell_of_morton};
use crate::points::keyed_points;
use crate::regions::{BrickCost, RegionGrid};
use crate::rows::{RowsOptions, point_bits};
use crate::rows_frames::fit_frame;
use crate::runs::{Cell, Run, Runs};
use crate::scene::Scene;
use crate::triangles::{Cutouts, LatticeTriangles};
use glam::DVec3;
use manyview_cache::archive::{CompressedChunk, DEFAULT_LEVEL};
use manyview_shaders::directions::{GroupedBoxes, ROW_LATTICE, RowLattice};
use manyview_shaders::rotate::{SpreadPoints, rotate_points};
use manyview_shaders::svo::SvoLevel;
use std::ops::Range;
use std::time::Instant;

/// What pieces took.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Sample {
    /// Bytes of the archive for each leaf, or for each row.
    pub(crate) bytes: f64,
    /// Seconds of one thread for each leaf, or for each row.
    pub(crate) seconds: f64,
}

/// log2 of voxels a side of a piece of the octree.
const PIECE_BITS: u32 = 5;
/// Pieces of the octree.
const PIECES: u64 = 24;
/// Pieces of the rows along each axis of their grid.
const WINDOWS: u32 = 4;
/// Rows a side of a piece.
const WINDOW: u32 = 16;
/// Pieces are left out where more triangles than this would be looked at for all of them.
const MOST_TRIANGLES: usize = 1 << 21;

/// log2 of the points that are rotated to see how long one takes.
const POINT_BITS: u32 = 15;

/// Seconds of some work that all threads do at the same time, as they share memory and cores: of three times each, the
/// middle one. `room` makes what a thread works in.
fn warm_seconds<R, T>(room: impl Fn() -> R + Sync, work: impl Fn(&mut R) -> T + Sync) -> f64 {
    let of_thread = || {
        let mut room = room();
        let mut seconds = [(); 3].map(|()| {
            let clock = Instant::now();
            std::hint::black_box(work(&mut room));
            clock.elapsed().as_secs_f64()
        });
        seconds.sort_by(f64::total_cmp);
        seconds[1]
    };
    let seconds = rayon::broadcast(|_| of_thread());
    seconds.iter().sum::<f64>() / seconds.len() as f64
}

/// Numbers that look random, the same each time.
fn scattered(index: u64) -> u64 {
    let mut x = index.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ x >> 31
}

/// One of some things, in proportion to their weights; what `random` decides.
fn weighted<T>(random: u64, things: impl Iterator<Item = (T, f64)>) -> Option<T> {
    let things: Vec<(T, f64)> = things.collect();
    let all: f64 = things.iter().map(|(_, weight)| weight).sum();
    let mut left = all * (random >> 11) as f64 / (1u64 << 53) as f64;
    let last = things.len().checked_sub(1)?;
    let chosen = things.iter().position(|(_, weight)| {
        left -= weight;
        left < 0.0
    });
    things.into_iter().nth(chosen.unwrap_or(last)).map(|(thing, _)| thing)
}

fn wanted_meshes(scene: &Scene, runs: &Runs, wanted: impl Iterator<Item = u32>) -> Vec<bool> {
    let mut meshes = vec![false; scene.meshes.len()];
    for run in wanted {
        let instance = runs.runs[run as usize].instance as usize;
        meshes[scene.instances[instance].mesh as usize] = true;
    }
    meshes
}

fn pieces_of<'r>(runs: impl Iterator<Item = &'r Run>) -> Vec<(u32, Range<u32>)> {
    runs.map(|run| (run.instance, run.triangles.clone())).collect()
}

/// Makes some pieces of the octree; `None` where none holds a voxel.
pub(crate) fn octree(
    scene: &Scene,
    runs: &Runs,
    grid: RegionGrid,
    cells: &[Cell],
    costs: &[BrickCost],
) -> Option<Sample> {
    let bits = PIECE_BITS.min(grid.grid.bits);
    let all: f64 = costs.iter().map(|cost| cost.leaves).sum();
    let mut ends = costs.iter().scan(0.0, |sum, cost| {
        *sum += cost.leaves;
        Some(*sum)
    });
    // Where the surface is: cells in proportion to their voxels, in them a triangle of any run.
    let mut at = 0;
    let mut end = ends.next()?;
    let mut codes = Vec::new();
    let to_piece = |p: DVec3| {
        grid.cube.snap(grid.grid, p.to_array()).map(|c| i64::from(c) >> (bits + grid.grid.sub_bits))
    };
    for k in 0..PIECES {
        while end < all * (k as f64 + 0.5) / PIECES as f64 && at + 1 < cells.len() {
            end = ends.next()?;
            at += 1;
        }
        let of_cell = cells[at].runs.iter().map(|run| &runs.runs[*run as usize]);
        let run = weighted(scattered(k), of_cell.map(|run| (run, run.surface)))?;
        let instance = &scene.instances[run.instance as usize];
        let mesh = &scene.meshes[instance.mesh as usize];
        let corners_of = |triangle: u32| {
            mesh.triangles[triangle as usize].map(|vertex| {
                instance.world_from_object.transform_point3(mesh.positions[vertex as usize].as_dvec3())
            })
        };
        let area = |c: [DVec3; 3]| (c[1] - c[0]).cross(c[2] - c[0]).length();
        let triangles = run.triangles.clone().map(corners_of);
        let corners = weighted(scattered(k + 99), triangles.map(|corners| (corners, area(corners))))?;
        let middle = to_piece((corners[0] + corners[1] + corners[2]) / 3.0);
        // The middle of a large triangle may lie in another cell.
        let shift = grid.bits() - bits;
        let (lo, hi) = {
            let cell = cell_of_morton(cells[at].code).map(i64::from);
            (cell.map(|c| c << shift), cell.map(|c| ((c + 1) << shift) - 1))
        };
        let piece = [0, 1, 2].map(|i| middle[i].clamp(lo[i], hi[i]));
        codes.push((at, piece));
    }
    codes.dedup();
    let near = |cell: &Cell, piece: [i64; 3]| -> Vec<u32> {
        let reaches = |run: &&u32| {
            let [lo, hi] = runs.runs[**run as usize].bounds.map(to_piece);
            (0..3).all(|i| lo[i] <= piece[i] && piece[i] <= hi[i])
        };
        cell.runs.iter().filter(reaches).copied().collect()
    };
    let triangles =
        |near: &[u32]| near.iter().map(|run| runs.runs[*run as usize].triangles.len()).sum::<usize>();
    let mut room = MOST_TRIANGLES;
    let jobs: Vec<_> = codes
        .into_iter()
        .map(|(at, piece)| (piece, near(&cells[at], piece)))
        .filter(|(_, near)| {
            let fits = triangles(near) <= room;
            room -= if fits { triangles(near) } else { 0 };
            fits
        })
        .collect();
    let wanted = wanted_meshes(scene, runs, jobs.iter().flat_map(|(_, near)| near.iter().copied()));
    let cutouts = Cutouts::of_meshes(scene, |mesh| wanted[mesh]);
    let voxel_size = grid.cube.size / f64::from(grid.grid.size());
    let appearance = Appearance::unfiltered(scene, voxel_size, |mesh| wanted[mesh]);
    let mut seconds = 0.0;
    let mut planes: Vec<Vec<u8>> = Vec::new();
    let mut leaves = 0usize;
    for (piece, near) in &jobs {
        let pieces = pieces_of(near.iter().map(|run| &runs.runs[*run as usize]));
        let snap = |p: DVec3| grid.cube.snap(grid.grid, p.to_array());
        let triangles = LatticeTriangles::of_pieces(scene, &cutouts, &pieces, snap);
        let bricks = Bricks::within(grid.grid, bits, [*piece; 2], &triangles.triangles);
        let make = || -> Vec<SvoLevel> {
            let make = |i| {
                let (code, clip, members) = bricks.brick(i);
                let fragments = brick_fragments(grid.grid, &clip, &triangles, &cutouts, &members);
                Brick::new(code, bits, fragments, &members, &triangles, &appearance)
            };
            (0..bricks.len())
                .filter_map(make)
                .flat_map(|brick| octree::join(bits, bits, vec![brick]))
                .collect()
        };
        seconds += warm_seconds(|| (), |()| make());
        let made = make();
        for levels in made.chunks(bits as usize + 1) {
            leaves += levels.last().map_or(0, |level| level.colors.len());
            // Three levels are nearly all of it.
            let fine = levels.iter().rev().take(3).flat_map(crate::regions::byte_planes);
            for (index, plane) in fine.enumerate() {
                if planes.len() <= index {
                    planes.push(Vec::new());
                }
                planes[index].extend(plane);
            }
        }
    }
    let stored = |plane: &Vec<u8>| match plane.is_empty() {
        true => 0,
        false => CompressedChunk::compress(plane, DEFAULT_LEVEL).stored().len(),
    };
    let compress = || planes.iter().map(stored).sum::<usize>();
    let bytes = compress();
    let leaves_f = leaves as f64;
    seconds += warm_seconds(|| (), |()| compress());
    (leaves > 0).then(|| Sample { bytes: bytes as f64 / leaves_f, seconds: seconds / leaves_f })
}

/// Makes some pieces of the rows.
pub(crate) fn rows(
    scene: &Scene,
    runs: &Runs,
    options: RowsOptions,
    lattice: &RowLattice,
    points: u64,
) -> Sample {
    let directions = options.directions.count();
    let snap = |p: DVec3| lattice.snap(p.to_array());
    // Frames are fitted to boxes around the surface; the runs' are not as tight.
    let every = runs.runs.len().div_ceil(256).max(1);
    let boxes: Vec<_> = runs.runs.iter().step_by(every).map(|run| run.bounds.map(snap)).collect();
    let boxes = GroupedBoxes::new(&boxes);
    let (bits, side) = (options.bits, 1u32 << options.bits);
    let windows: Vec<_> = (0..WINDOWS * WINDOWS)
        .map(|k| {
            let random = scattered(u64::from(k));
            let direction = ((u64::from(k) * u64::from(directions) + (random >> 40) % u64::from(directions))
                / u64::from(WINDOWS * WINDOWS)) as u32;
            let step = side / WINDOWS;
            let spare = u64::from(step.saturating_sub(WINDOW)) + 1;
            let u = k % WINDOWS * step + (random % spare) as u32;
            let v = k / WINDOWS * step + ((random >> 20) % spare) as u32;
            (fit_frame(options, lattice, &boxes, direction.min(directions - 1)), [u, v])
        })
        .collect();
    let window = WINDOW.min(side / WINDOWS);
    // Whether what spans these lattice points may reach into a window.
    let reaches =
        |frame: &manyview_shaders::directions::DirectionFrame, at: [u32; 2], points: &[[i16; 3]]| {
            let voxels = points.iter().map(|p| frame.voxel(*p, bits));
            let (lo, hi) = voxels.fold(([u32::MAX; 3], [0; 3]), |(lo, hi), v| {
                ([0, 1, 2].map(|i| v[i].min(lo[i])), [0, 1, 2].map(|i| v[i].max(hi[i])))
            });
            (0..2).all(|i| lo[i] < at[i] + window && hi[i] >= at[i])
        };
    let corners = |bounds: [[i16; 3]; 2]| -> [[i16; 3]; 8] {
        std::array::from_fn(|c| [0, 1, 2].map(|i| bounds[c >> i & 1][i]))
    };
    let near: Vec<Vec<u32>> = windows
        .iter()
        .map(|(frame, at)| {
            let reaches = |(_, run): &(usize, &Run)| reaches(frame, *at, &corners(run.bounds.map(snap)));
            runs.runs.iter().enumerate().filter(reaches).map(|(index, _)| index as u32).collect()
        })
        .collect();
    let wanted = wanted_meshes(scene, runs, near.iter().flatten().copied());
    let cutouts = Cutouts::of_meshes(scene, |mesh| wanted[mesh]);
    let words = (side / 32).max(1) as usize;
    // The windows, side by side as if they were of one direction: rows are coded by their neighbours.
    let mut made = vec![0u32; (side * WINDOWS * window) as usize * words];
    let mut room = MOST_TRIANGLES;
    let mut count = 0u32;
    // In an order in which any few are spread out.
    for k in (0..windows.len()).map(|k| k * 7 % windows.len()) {
        let ((frame, at), near) = (&windows[k], &near[k]);
        let pieces = pieces_of(near.iter().map(|run| &runs.runs[*run as usize]));
        let triangles: usize = pieces.iter().map(|(_, triangles)| triangles.len()).sum();
        if triangles > room {
            continue;
        }
        room -= triangles;
        let corner = [count % WINDOWS * window, count / WINDOWS * window];
        count += 1;
        let is_in = |triangle: &[[i16; 3]; 3]| reaches(frame, *at, triangle);
        let triangles = LatticeTriangles::of_pieces_where(scene, &cutouts, &pieces, snap, is_in);
        for (_, point) in keyed_points(&triangles, &cutouts, point_bits(options), |_| true) {
            let [u, v, w] = frame.voxel(point, bits);
            let (u, v) = (u.wrapping_sub(at[0]), v.wrapping_sub(at[1]));
            if u < window && v < window {
                let row = (corner[1] + v) * side + corner[0] + u;
                made[row as usize * words + (w / 32) as usize] |= 1 << (w % 32);
            }
        }
    }
    if count == 0 {
        // Every window is full of triangles: they are no more than a row of bits each.
        made.iter_mut().zip(0..).for_each(|(word, k)| *word = scattered(k) as u32);
        count = WINDOWS * WINDOWS;
    }
    // As often side by side as there is room.
    let across = WINDOWS * window;
    for line in made.chunks_exact_mut(side as usize * words) {
        let (first, others) = line.split_at_mut(across as usize * words);
        others.chunks_mut(first.len()).for_each(|other| other.copy_from_slice(&first[..other.len()]));
    }
    let compress =
        || CompressedChunk::compress_rows(bytemuck::cast_slice(&made), 1 << (bits - 3)).stored().len();
    let rows = f64::from(window * window * count) * f64::from(side) / f64::from(across);
    let compressing = warm_seconds(|| (), |()| compress());
    // Points of a slanted plane, as far from each other as the surface's and in the same order.
    let points_bits = point_bits(options);
    let patch = (0..1u32 << POINT_BITS.min(2 * points_bits - 1)).map(|code| {
        let [x, y] = [0, 1].map(|axis| (0..16).fold(0, |c, bit| c | (code >> (2 * bit + axis) & 1) << bit));
        [x, y, (x + y) / 2].map(|c| ((c << (15 - points_bits)) as i32 - ROW_LATTICE) as i16)
    });
    let spread = SpreadPoints::new(&patch.collect::<Vec<_>>());
    let room = || vec![0u32; side as usize * side as usize * words];
    let rotating = warm_seconds(room, |room| {
        windows.iter().for_each(|(frame, _)| rotate_points(frame, bits, &spread, room));
    });
    let clearing = warm_seconds(room, |room| room.fill(0));
    let of_point = rotating / (windows.len() * spread.len()) as f64;
    let of_direction = clearing + of_point * points as f64;
    let seconds = compressing / rows + of_direction / f64::from(side * side);
    Sample { bytes: compress() as f64 / rows, seconds }
}
