//! A dense set of points on the scene's surface, for rotating into every direction.
//!
//! # Theory
//! \[WMP\] Algorithm 5 fills all directions by rotating the voxels of one voxelization: far cheaper than voxelizing the
//! triangles 8,100 times, and less accurate, because a voxel's centre stands for all of it.
//!
//! # Differences from the paper
//! We rotate points that lie *on* the surface, at half a voxel's spacing: the error of the centre is gone, and every
//! voxel that the surface crosses by more than a corner holds a point. [`surface_points`] makes them,
//! [`voxel_centers`] is the paper's set.
//!
//! # Practice
//! Points are row-lattice coordinates, sorted in Morton order of their cells so that neighbours in the list fall into
//! neighbouring rows of every direction.

use crate::octree::morton;
use crate::triangles::{Cutouts, LatticeTriangles};
use manyview_shaders::directions::ROW_LATTICE;
use manyview_shaders::masks::TriangleMask;
use manyview_shaders::raster::{BARYCENTRIC_ONE, Grid, Raster, VoxelBox};
use rayon::prelude::*;

/// Triangles that one task samples before it drops what falls into the same cell.
const CHUNK: usize = 4096;
/// Points that a task collects before it does so earlier.
const MOST_POINTS: usize = 1 << 16;

/// Points on the triangles, about one per cell of a grid of `2^bits` cells a side over the row lattice.
///
/// Each triangle is sampled at the cell centres of the axis plane it faces most; one that no centre hits is sampled
/// along its longest median, so that wires and blades of grass stay whole. Of several points in one cell the smallest
/// (by coordinates) is kept, so that the result does not depend on the order of triangles.
pub fn surface_points(triangles: &LatticeTriangles, cutouts: &Cutouts, bits: u32) -> Vec<[i16; 3]> {
    sampled_points(triangles, cutouts, bits, |_| true).into_iter().map(|(_, p)| p).collect()
}

/// log2 of cells a side of the coarse grid that [`sampled_points`] and [`coarse_boxes`] tell cells of.
pub const POINT_CELL_BITS: u32 = 4;

/// As [`surface_points`], of those cells of the coarse grid alone that `is_wanted` tells by their Morton code; each
/// point comes with its coarse cell's code.
pub fn sampled_points(
    triangles: &LatticeTriangles,
    cutouts: &Cutouts,
    bits: u32,
    is_wanted: impl Fn(u32) -> bool + Sync,
) -> Vec<(u32, [i16; 3])> {
    let mut keyed = keyed_points(triangles, cutouts, bits, is_wanted);
    keyed.iter_mut().for_each(|(key, _)| *key = coarse_cell(*key, bits));
    keyed
}

/// The coarse cell of a finer one, whose code begins with its.
pub(crate) fn coarse_cell(key: u32, bits: u32) -> u32 {
    key >> (3 * bits.saturating_sub(POINT_CELL_BITS))
}

/// Adds points, each with its cell's code, to others; of several in one cell the smallest stays. Both are in order, and
/// so is the result.
pub(crate) fn merge_points(keyed: &mut Vec<(u32, [i16; 3])>, others: Vec<(u32, [i16; 3])>) {
    let mut merged: Vec<(u32, [i16; 3])> = Vec::with_capacity(keyed.len() + others.len());
    let (mut ours, mut theirs) = (keyed.iter().peekable(), others.iter().peekable());
    loop {
        let next = match (ours.peek(), theirs.peek()) {
            (Some(a), Some(b)) if a <= b => ours.next(),
            (_, Some(_)) => theirs.next(),
            (Some(_), None) => ours.next(),
            (None, None) => break,
        };
        // The first of a cell is its smallest.
        merged.extend(next.filter(|point| merged.last().is_none_or(|last| last.0 != point.0)));
    }
    *keyed = merged;
}

/// As [`sampled_points`], each with the code of its own cell.
pub(crate) fn keyed_points(
    triangles: &LatticeTriangles,
    cutouts: &Cutouts,
    bits: u32,
    is_wanted: impl Fn(u32) -> bool + Sync,
) -> Vec<(u32, [i16; 3])> {
    let grid = Grid::new(bits);
    let thin = |points: &mut Vec<(u32, [i16; 3])>| {
        points.sort_unstable();
        points.dedup_by_key(|(key, _)| *key);
    };
    let mut keyed: Vec<(u32, [i16; 3])> = (0..triangles.triangles.len().div_ceil(CHUNK))
        .into_par_iter()
        .flat_map_iter(|chunk| {
            let mut points = Vec::new();
            let mut most = MOST_POINTS;
            let end = ((chunk + 1) * CHUNK).min(triangles.triangles.len());
            for index in chunk * CHUNK..end {
                // Large triangles give many points, over each other perhaps the same ones again and again.
                if points.len() > most {
                    thin(&mut points);
                    most = MOST_POINTS.max(2 * points.len());
                }
                let mask = triangles.mask(cutouts, index);
                sample_triangle(grid, &triangles.triangles[index], mask, cutouts, |p| {
                    let key = cell_key(p, bits);
                    if is_wanted(coarse_cell(key, bits)) {
                        points.push((key, p));
                    }
                });
            }
            thin(&mut points);
            points
        })
        .collect();
    keyed.par_sort_unstable();
    keyed.dedup_by_key(|(key, _)| *key);
    keyed
}

/// Morton code of a lattice point's cell in a grid of `2^bits` cells a side.
fn cell_key(p: [i16; 3], bits: u32) -> u32 {
    morton(cell_code(p, bits))
}

/// A lattice point's cell in a grid of `2^bits` cells a side.
pub(crate) fn cell_code(p: [i16; 3], bits: u32) -> [u32; 3] {
    p.map(|c| ((i32::from(c) + ROW_LATTICE).min(2 * ROW_LATTICE - 1) >> (15 - bits)) as u32)
}

fn sample_triangle(
    grid: Grid,
    triangle: &[[i16; 3]; 3],
    mask: Option<&TriangleMask>,
    cutouts: &Cutouts,
    mut emit: impl FnMut([i16; 3]),
) {
    let v = triangle.map(|p| p.map(i64::from));
    let point = |b: [u32; 2]| {
        let (b1, b2) = (i64::from(b[0]), i64::from(b[1]));
        // Rounded to nearest; inside the triangle's bounds because the weights are.
        [0, 1, 2].map(|i| {
            let rise = b1 * (v[1][i] - v[0][i]) + b2 * (v[2][i] - v[0][i]);
            (v[0][i] + ((rise + i64::from(BARYCENTRIC_ONE) / 2) >> 15)) as i16
        })
    };
    let hit = std::cell::Cell::new(false);
    let mut sample = |b: [u32; 2]| {
        hit.set(true);
        if mask.is_none_or(|m| m.passes(&cutouts.planes, b)) {
            emit(point(b));
        }
    };
    let e = |i: usize, c: usize| v[i][c] - v[0][c];
    let normal = [
        e(1, 1) * e(2, 2) - e(1, 2) * e(2, 1),
        e(1, 2) * e(2, 0) - e(1, 0) * e(2, 2),
        e(1, 0) * e(2, 1) - e(1, 1) * e(2, 0),
    ]
    .map(i64::abs);
    let axis = (0..3).max_by_key(|&a| (normal[a], std::cmp::Reverse(a))).expect("three axes");
    // The grid's lattice is the row lattice shifted to start at 0; its sub-voxel bits may be fewer.
    let shift = 15 - grid.bits - grid.sub_bits;
    let shifted =
        triangle.map(|p| p.map(|c| ((i32::from(c) + ROW_LATTICE) >> shift).min(grid.lattice_size() - 1)));
    if let Some(raster) = Raster::new(grid, &shifted, axis) {
        raster.fragments(&VoxelBox::whole(grid), |f| sample(f.barycentric));
    }
    if hit.get() {
        return;
    }
    // Longest median: from the middle of the shortest edge to the opposite vertex.
    let length2 = |a: usize, b: usize| (0..3).map(|i| (v[a][i] - v[b][i]).pow(2)).sum::<i64>();
    let apex = (0..3).min_by_key(|&a| length2((a + 1) % 3, (a + 2) % 3)).expect("three vertices");
    let longest =
        (0..3).map(|i| (2 * v[apex][i] - v[(apex + 1) % 3][i] - v[(apex + 2) % 3][i]).abs() / 2).max();
    let steps = (longest.expect("three axes") >> (15 - grid.bits)) as u32 + 1;
    for step in 0..=steps {
        // Weight of the apex; the rest is shared by the other two.
        let at_apex = BARYCENTRIC_ONE * step / (steps + 1);
        let others = (BARYCENTRIC_ONE - at_apex) / 2;
        let mut weights = [others; 3];
        weights[apex] = at_apex;
        sample([weights[1], weights[2]]);
    }
}

/// The paper's point set: centres of the occupied voxels of one voxelization along the world's axes, `2^bits` voxels
/// a side.
///
/// `half_extent_share[i]` is the half extent of the scene along axis i over half the edge of the voxelization's grid:
/// 1 for a grid fitted to the bounds, less for a cube around the bounding sphere (the paper's).
pub fn voxel_centers(
    triangles: &LatticeTriangles,
    cutouts: &Cutouts,
    bits: u32,
    half_extent_share: [f64; 3],
) -> Vec<[i16; 3]> {
    let grid = Grid::new(bits);
    let half = f64::from(grid.size()) * 0.5;
    let voxel_of = |p: [i16; 3]| {
        [0, 1, 2]
            .map(|i| grid.snap(half + f64::from(p[i]) / f64::from(ROW_LATTICE) * half_extent_share[i] * half))
    };
    let clip = VoxelBox::whole(grid);
    let mut occupied: Vec<u32> = (0..triangles.triangles.len().div_ceil(CHUNK))
        .into_par_iter()
        .flat_map_iter(|chunk| {
            let mut codes = Vec::new();
            let end = ((chunk + 1) * CHUNK).min(triangles.triangles.len());
            for index in chunk * CHUNK..end {
                let triangle = triangles.triangles[index].map(voxel_of);
                let mask = triangles.mask(cutouts, index);
                for raster in (0..3).filter_map(|axis| Raster::new(grid, &triangle, axis)) {
                    raster.fragments(&clip, |f| {
                        if mask.is_none_or(|m| m.passes(&cutouts.planes, f.barycentric)) {
                            codes.push(morton(f.voxel.map(|c| c as u32)));
                        }
                    });
                }
            }
            codes.sort_unstable();
            codes.dedup();
            codes
        })
        .collect();
    occupied.par_sort_unstable();
    occupied.dedup();
    occupied
        .into_iter()
        .map(|code| {
            let cell = crate::octree::cell_of_morton(code);
            [0, 1, 2].map(|i| {
                let center = (f64::from(cell[i]) + 0.5 - half) / half / half_extent_share[i];
                (center * f64::from(ROW_LATTICE) + 0.5)
                    .floor()
                    .clamp(-f64::from(ROW_LATTICE), f64::from(ROW_LATTICE)) as i16
            })
        })
        .collect()
}

/// Tight boxes (min and max corners) around the points of each cell of a coarse grid, for
/// [`extents_along`](manyview_shaders::directions::extents_along). `points` are in Morton order of finer cells.
pub fn coarse_boxes(points: &[[i16; 3]]) -> Vec<[[i16; 3]; 2]> {
    points
        .chunk_by(|a, b| cell_key(*a, POINT_CELL_BITS) == cell_key(*b, POINT_CELL_BITS))
        .map(|cell| {
            cell.iter().fold([cell[0]; 2], |[lo, hi], p| {
                [[0, 1, 2].map(|i| lo[i].min(p[i])), [0, 1, 2].map(|i| hi[i].max(p[i]))]
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(triangle: [[i16; 3]; 3]) -> LatticeTriangles {
        LatticeTriangles {
            triangles: vec![triangle],
            sources: vec![crate::triangles::TriangleRef { instance: 0, triangle: 0 }],
            mask_of: Vec::new(),
        }
    }

    #[test]
    fn a_square_facing_an_axis_gets_one_point_per_cell() {
        let mut all = one([[-16384, 100, -16384], [16384, 100, -16384], [16384, 100, 16384]]);
        all.triangles.push([[-16384, 100, -16384], [16384, 100, 16384], [-16384, 100, 16384]]);
        let points = surface_points(&all, &Cutouts::default(), 5);
        assert_eq!(points.len(), 32 * 32);
        assert!(points.iter().all(|p| p[1] == 100), "points lie on the surface");
    }

    #[test]
    fn merged_points_are_in_order_and_the_smallest_of_each_cell() {
        let mut points = vec![(1, [5, 0, 0]), (3, [2, 0, 0]), (9, [0, 0, 7])];
        merge_points(&mut points, vec![(0, [1; 3]), (1, [4, 0, 0]), (3, [2, 0, 0]), (3, [2, 0, 1])]);
        assert_eq!(points, [(0, [1; 3]), (1, [4, 0, 0]), (3, [2, 0, 0]), (9, [0, 0, 7])]);
        merge_points(&mut points, Vec::new());
        assert_eq!(points.len(), 4);
    }

    #[test]
    fn a_needle_is_sampled_along_its_length() {
        let all = one([[-16000, 3, 3], [-16000, 5, 3], [16000, 4, 5]]);
        let points = surface_points(&all, &Cutouts::default(), 6);
        assert!(points.len() >= 60, "{}", points.len());
    }

    #[test]
    fn the_order_of_triangles_does_not_matter() {
        let a = [[-9000, 2, -70], [8000, 900, 3000], [12, -16000, 77]];
        let b = [[-9000, 2, -70], [12, -16000, 77], [8000, -900, 3000]];
        let mut ab = one(a);
        ab.triangles.push(b);
        let mut ba = one(b);
        ba.triangles.push(a);
        let none = Cutouts::default();
        assert_eq!(surface_points(&ab, &none, 7), surface_points(&ba, &none, 7));
    }

    #[test]
    fn voxel_centres_lie_in_their_voxels() {
        let all = one([[-16384, -16384, -16384], [16384, -16384, -16384], [-16384, 16384, -16384]]);
        let centers = voxel_centers(&all, &Cutouts::default(), 5, [1.0; 3]);
        assert!(!centers.is_empty());
        assert!(centers.iter().all(|c| c[2] == -16384 + 512), "half a voxel of 1024 above the border");
    }
}
