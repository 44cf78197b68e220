//! Triangles in, sparse voxel octree out.
//!
//! # Theory
//! \[MV\] §3: the scene hierarchy is an SVO built by depth peeling down to the deepest level, with averaged colour and a
//! normal cone in every node.
//!
//! # Differences from the paper
//! Fragments come from the integer raster ([`manyview_shaders::raster`]) in one pass; depth peeling gives the same
//! voxels ([`crate::bake::VoxelsFrom::Peel`]). The cube is cut into bricks that are voxelized one by one, each in a
//! dense bitmap in Morton order, whose bytes are the child masks of the level above the leaves. All sums are integers,
//! so that neither the brick size nor the order of fragments shows in the result.
//!
//! # Practice
//! [`Bricks::new`] bins triangles, [`Brick::new`] turns one brick's fragments into levels, [`join`] joins them and
//! adds the levels above ([`crate::reduce`]).

use crate::appearance::{Appearance, EMISSIVE_ONE};
use crate::reduce::reduce_level;
use crate::triangles::{Cutouts, LatticeTriangles};
use manyview_shaders::device::PackedFragment;
use manyview_shaders::octahedral;
use manyview_shaders::raster::{Grid, Raster, VoxelBox};
use manyview_shaders::rgb9e5;
use manyview_shaders::srgb::srgb_from_linear;
use manyview_shaders::svo::SvoLevel;
use rayon::prelude::*;

/// Triangles by the bricks of the grid that they may touch.
pub struct Bricks {
    /// The whole grid.
    pub grid: Grid,
    /// log2 of voxels a side of a brick.
    pub brick_bits: u32,
    /// Brick (Morton code) in the upper half, triangle in the lower half; ascending.
    entries: Vec<u64>,
    /// Start of each brick in `entries`, and the end.
    starts: Vec<usize>,
}

/// Triangles that one task bins.
const CHUNK: usize = 4096;

impl Bricks {
    /// Bins triangles into bricks of `2^brick_bits` voxels a side. Triangles without area, which have no fragments, are
    /// in none.
    pub fn new(grid: Grid, brick_bits: u32, triangles: &[[[i16; 3]; 3]]) -> Self {
        Self::within(grid, brick_bits, EVERYWHERE, triangles)
    }

    /// As [`new`](Self::new), of those bricks alone that lie within a box of bricks (smallest and largest).
    pub fn within(grid: Grid, brick_bits: u32, within: [[i64; 3]; 2], triangles: &[[[i16; 3]; 3]]) -> Self {
        let brick_bits = brick_bits.min(grid.bits);
        let shift = brick_bits + grid.sub_bits;
        let mut entries: Vec<u64> = triangles
            .par_chunks(CHUNK)
            .enumerate()
            .flat_map_iter(|(chunk, triangles)| {
                let mut entries = Vec::with_capacity(triangles.len() * 2);
                for (index, triangle) in (chunk * CHUNK..).zip(triangles) {
                    cells_touched(&triangle.map(|p| p.map(i64::from)), shift, within, |cell| {
                        let code = morton(cell.map(|c| c as u32));
                        entries.push(u64::from(code) << 32 | index as u64);
                    });
                }
                entries
            })
            .collect();
        entries.par_sort_unstable();
        let mut starts: Vec<usize> =
            (0..entries.len()).filter(|&i| i == 0 || entries[i - 1] >> 32 != entries[i] >> 32).collect();
        starts.push(entries.len());
        Self { grid, brick_bits, entries, starts }
    }

    /// Number of bricks that a triangle may touch.
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// Whether no triangle touches any brick.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Morton code, box and triangles of brick `index`; bricks come in Morton order.
    pub fn brick(&self, index: usize) -> (u32, VoxelBox, Vec<u32>) {
        let entries = &self.entries[self.starts[index]..self.starts[index + 1]];
        let code = (entries[0] >> 32) as u32;
        let min = cell_of_morton(code).map(|c| (c << self.brick_bits) as i32);
        let clip = VoxelBox { min, max: min.map(|c| c + (1 << self.brick_bits)) };
        (code, clip, entries.iter().map(|e| *e as u32).collect())
    }
}

/// A box of cells that all are in.
pub(crate) const EVERYWHERE: [[i64; 3]; 2] = [[i64::MIN; 3], [i64::MAX; 3]];

/// Visits the cubic cells of edge `2^shift` within a box of cells (smallest and largest) that a triangle passes
/// through, and few others: columns of cells along the axis that the triangle faces most, each from the lowest to the
/// highest point of the plane in it. So the work grows with the triangle's projected bounds in the box, not with the
/// volume of its bounds.
pub(crate) fn cells_touched(
    triangle: &[[i64; 3]; 3],
    shift: u32,
    within: [[i64; 3]; 2],
    mut visit: impl FnMut([i64; 3]),
) {
    let cell_of = |p: &[i64; 3], i: usize| p[i] >> shift;
    let whole = [0, 1, 2].map(|i| {
        let cells = triangle.each_ref().map(|p| cell_of(p, i));
        [cells[0].min(cells[1]).min(cells[2]), cells[0].max(cells[1]).max(cells[2])]
    });
    let lo = [0, 1, 2].map(|i| whole[i][0].max(within[0][i]));
    let hi = [0, 1, 2].map(|i| whole[i][1].min(within[1][i]));
    if (0..3).any(|i| lo[i] > hi[i]) {
        return;
    }
    let e = |i: usize, c: usize| triangle[i][c] - triangle[0][c];
    let normal = [
        e(1, 1) * e(2, 2) - e(1, 2) * e(2, 1),
        e(1, 2) * e(2, 0) - e(1, 0) * e(2, 2),
        e(1, 0) * e(2, 1) - e(1, 1) * e(2, 0),
    ];
    if normal == [0; 3] {
        return;
    }
    if whole.iter().all(|[lo, hi]| lo == hi) {
        return visit(lo);
    }
    let z = (0..3).max_by_key(|&axis| normal[axis].abs()).expect("three axes");
    let (x, y) = ((z + 1) % 3, (z + 2) % 3);
    let facing = normal[z].signum();
    let size = 1i64 << shift;
    // Largest value of `a · dx + b · dy` for dx, dy in 0 ..= size.
    let highest = |a: i64, b: i64| (a.max(0) + b.max(0)) * size;
    for cell_y in lo[y]..=hi[y] {
        for cell_x in lo[x]..=hi[x] {
            let corner = [cell_x << shift, cell_y << shift];
            let is_beside = (0..3).any(|i| {
                let (p, q) = (triangle[i], triangle[(i + 1) % 3]);
                let (dx, dy) = ((q[x] - p[x]) * facing, (q[y] - p[y]) * facing);
                dx * (corner[1] - p[y]) - dy * (corner[0] - p[x]) + highest(-dy, dx) < 0
            });
            if is_beside {
                continue;
            }
            // The plane's depth is that of vertex 0 plus `rise / |normal[z]|`.
            let (a, b) = (-normal[x] * facing, -normal[y] * facing);
            let rise = a * (corner[0] - triangle[0][x]) + b * (corner[1] - triangle[0][y]);
            let depth = |rise: i64| (triangle[0][z] + rise.div_euclid(normal[z].abs())) >> shift;
            let (first, last) = (depth(rise - highest(-a, -b)), depth(rise + highest(a, b)));
            for cell_z in first.max(lo[z])..=last.min(hi[z]) {
                let mut cell = [0; 3];
                (cell[x], cell[y], cell[z]) = (cell_x, cell_y, cell_z);
                visit(cell);
            }
        }
    }
}

/// The fragments of one brick, by the CPU's raster. `triangle` of a fragment is its index in `members`.
pub fn brick_fragments(
    grid: Grid,
    clip: &VoxelBox,
    all: &LatticeTriangles,
    cutouts: &Cutouts,
    members: &[u32],
) -> Vec<PackedFragment> {
    let mut fragments = Vec::new();
    for (local, &index) in members.iter().enumerate() {
        let triangle = all.triangles[index as usize].map(|v| v.map(i32::from));
        let mask = all.mask(cutouts, index as usize);
        for axis in 0..3 {
            let Some(raster) = Raster::new(grid, &triangle, axis) else { continue };
            raster.fragments(clip, |f| {
                if mask.is_some_and(|m| !m.passes(&cutouts.planes, f.barycentric)) {
                    return;
                }
                let [x, y, z] = [0, 1, 2].map(|i| (f.voxel[i] - clip.min[i]) as u32);
                fragments.push(PackedFragment {
                    voxel: x | y << 10 | z << 20,
                    triangle: local as u32,
                    barycentric: f.barycentric[0] | f.barycentric[1] << 16,
                });
            });
        }
    }
    fragments
}

/// One brick's part of the octree: its levels from its own root to the leaves.
pub struct Brick {
    /// Morton code of the brick among the bricks.
    pub code: u32,
    /// Local levels 0 ..= brick_bits.
    pub levels: Vec<SvoLevel>,
}

#[derive(Clone, Copy, Default)]
struct Accumulator {
    color: [u64; 3],
    emissive: [u64; 3],
    /// Sum of normals times 2^14.
    normal: [i64; 3],
    count: u64,
}

impl Brick {
    /// Averages fragments (voxels relative to the brick's smallest corner) into leaves and builds the levels above
    /// them; `None` if there are no fragments. `members` are the brick's triangles, as in [`brick_fragments`].
    pub fn new(
        code: u32,
        brick_bits: u32,
        mut fragments: Vec<PackedFragment>,
        members: &[u32],
        all: &LatticeTriangles,
        appearance: &Appearance,
    ) -> Option<Self> {
        if fragments.is_empty() {
            return None;
        }
        // Fragments of one triangle share its set-up. A GPU may deliver them in any order.
        if !fragments.is_sorted_by_key(|f| f.triangle) {
            fragments.sort_unstable_by_key(|f| f.triangle);
        }
        let morton_of =
            |f: &PackedFragment| morton([f.voxel & 1023, f.voxel >> 10 & 1023, f.voxel >> 20 & 1023]);
        let mut occupied = vec![0u64; (1usize << (3 * brick_bits)).div_ceil(64)];
        for fragment in &fragments {
            let m = morton_of(fragment);
            occupied[(m / 64) as usize] |= 1 << (m % 64);
        }
        let mut rank_of_word = Vec::with_capacity(occupied.len());
        let mut leaves = 0u32;
        for word in &occupied {
            rank_of_word.push(leaves);
            leaves += word.count_ones();
        }
        let rank_of = |f: &PackedFragment| {
            let m = morton_of(f);
            let word = (m / 64) as usize;
            (rank_of_word[word] + (occupied[word] & ((1 << (m % 64)) - 1)).count_ones()) as usize
        };

        let mut sums = vec![Accumulator::default(); leaves as usize];
        let mut normals = Vec::with_capacity(fragments.len());
        for same in fragments.chunk_by(|a, b| a.triangle == b.triangle) {
            let surface = appearance.surface(all.sources[members[same[0].triangle as usize] as usize]);
            for fragment in same {
                let sample = surface.sample([fragment.barycentric & 0xffff, fragment.barycentric >> 16]);
                let sum = &mut sums[rank_of(fragment)];
                for c in 0..3 {
                    sum.color[c] += u64::from(sample.color[c]);
                    sum.emissive[c] += u64::from(sample.emissive[c]);
                    sum.normal[c] += (f64::from(sample.normal[c]) * 16384.0 + 0.5).floor() as i64;
                }
                sum.count += 1;
                normals.push(sample.normal);
            }
        }

        let mut leaf_level = SvoLevel::default();
        let axes: Vec<[f64; 3]> = sums
            .iter()
            .map(|sum| {
                leaf_level
                    .colors
                    .push(sum.color.map(|c| srgb_from_linear(((c + sum.count / 2) / sum.count) as u16)));
                if appearance.emits() {
                    let mean = sum.emissive.map(|e| e as f64 / sum.count as f64 / EMISSIVE_ONE);
                    leaf_level.emissive.push(rgb9e5::encode(mean));
                }
                let packed = octahedral::encode(sum.normal.map(|n| n as f64));
                leaf_level.normals.push(packed);
                octahedral::decode(packed)
            })
            .collect();
        let mut cosines = vec![1.0f64; sums.len()];
        for (fragment, normal) in fragments.iter().zip(&normals) {
            let rank = rank_of(fragment);
            let dot: f64 = (0..3).map(|i| axes[rank][i] * f64::from(normal[i])).sum();
            cosines[rank] = cosines[rank].min(dot);
        }
        leaf_level.cones = cosines.into_iter().map(octahedral::encode_cone).collect();

        let mut levels = vec![leaf_level];
        // The bitmap's bytes are the child masks one level up; whether a byte is zero is the bitmap one level up.
        let mut bits: Vec<u8> =
            occupied.iter().flat_map(|w| w.to_le_bytes()).take(1usize << (3 * brick_bits) >> 3).collect();
        for _ in 0..brick_bits {
            let masks: Vec<u8> = bits.iter().copied().filter(|&m| m != 0).collect();
            let children = levels.last().expect("starts with the leaves");
            levels.push(reduce_level(masks, children));
            bits = bits
                .chunks(8)
                .map(|c| c.iter().enumerate().fold(0, |m, (i, &b)| m | u8::from(b != 0) << i))
                .collect();
        }
        levels.reverse();
        Some(Self { code, levels })
    }
}

/// Joins bricks (in Morton order; codes relative to what is joined) into the levels of a cube of depth `bits`.
///
/// # Panics
/// If there is no brick.
pub fn join(bits: u32, brick_bits: u32, bricks: Vec<Brick>) -> Vec<SvoLevel> {
    assert!(!bricks.is_empty(), "an octree has at least one voxel");
    let top = (bits - brick_bits.min(bits)) as usize;
    let mut levels = vec![SvoLevel::default(); bits as usize + 1];
    let mut codes: Vec<u32> = bricks.iter().map(|b| b.code).collect();
    for brick in bricks {
        for (into, from) in levels[top..].iter_mut().zip(brick.levels) {
            into.append(from);
        }
    }
    build_above(&mut levels, top, &mut codes);
    levels
}

/// Makes the levels above level `top`, whose nodes have the Morton codes `codes`.
pub(crate) fn build_above(levels: &mut [SvoLevel], top: usize, codes: &mut Vec<u32>) {
    for level in (0..top).rev() {
        let mut masks: Vec<u8> = Vec::new();
        let mut parents: Vec<u32> = Vec::new();
        for code in codes.iter() {
            if parents.last() != Some(&(code >> 3)) {
                parents.push(code >> 3);
                masks.push(0);
            }
            *masks.last_mut().expect("pushed above") |= 1 << (code & 7);
        }
        levels[level] = reduce_level(masks, &levels[level + 1]);
        *codes = parents;
    }
}

/// Morton code of a cell: bit 3i of the result is bit i of x, 3i + 1 of y, 3i + 2 of z; 10 bits each.
#[inline]
pub fn morton(cell: [u32; 3]) -> u32 {
    let spread = |v: u32| {
        let v = (v | v << 16) & 0x0300_00ff;
        let v = (v | v << 8) & 0x0300_f00f;
        let v = (v | v << 4) & 0x030c_30c3;
        (v | v << 2) & 0x0924_9249
    };
    spread(cell[0]) | spread(cell[1]) << 1 | spread(cell[2]) << 2
}

/// The inverse of [`morton`].
pub fn cell_of_morton(code: u32) -> [u32; 3] {
    [0, 1, 2].map(|axis| (0..10).fold(0, |cell, bit| cell | (code >> (3 * bit + axis) & 1) << bit))
}

#[cfg(test)]
mod tests {
    use super::*;
    use manyview_shaders::raster::fragments_basic;

    #[test]
    fn morton_codes_round_trip() {
        for cell in [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1023, 1, 512], [5, 900, 77]] {
            assert_eq!(cell_of_morton(morton(cell)), cell);
        }
        assert_eq!(morton([1, 1, 1]), 7);
    }

    #[test]
    fn bricks_hold_every_triangle_that_has_fragments_there() {
        let grid = Grid::new(5);
        let whole = VoxelBox::whole(grid);
        let mut state = 7u32;
        let mut random = |range: i32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((i64::from(state) * i64::from(range)) >> 32) as i32
        };
        let size = grid.lattice_size();
        let mut triangles: Vec<[[i16; 3]; 3]> = Vec::new();
        for _ in 0..60 {
            // A triangle of any shape, a needle along a line, and a small one that may be flat along an axis.
            let corners = [0; 3].map(|_: i32| [0; 3].map(|_: i32| random(size) as i16));
            triangles.push(corners);
            let near = corners[1].map(|c| (i32::from(c) + random(500) - 250).clamp(0, size - 1) as i16);
            triangles.push([corners[0], corners[1], near]);
            let spread = [random(700) + 1, random(700) + 1, 1];
            triangles.push([0; 3].map(|_: i32| {
                [0, 1, 2].map(|i| (i32::from(corners[2][i]) + random(spread[i])).min(size - 1) as i16)
            }));
        }
        let fragments = |triangle: [[i16; 3]; 3], clip: &VoxelBox| {
            fragments_basic(grid, &triangle.map(|v| v.map(i32::from)), clip).len()
        };
        let expected: usize = triangles.iter().map(|t| fragments(*t, &whole)).sum();
        for brick_bits in 1..=5 {
            let bricks = Bricks::new(grid, brick_bits, &triangles);
            let mut found = 0;
            for i in 0..bricks.len() {
                let (code, clip, members) = bricks.brick(i);
                assert_eq!(cell_of_morton(code).map(|c| (c as i32) << brick_bits), clip.min);
                found += members.iter().map(|m| fragments(triangles[*m as usize], &clip)).sum::<usize>();
            }
            assert_eq!(found, expected, "bricks of {brick_bits} bits");
        }
    }

    #[test]
    fn bricks_within_a_box_are_those_of_all_bricks() {
        let grid = Grid::new(8);
        let end = (grid.lattice_size() - 1) as i16;
        let triangles =
            [[[0; 3], [end, 7, end / 2], [end / 3, end, 9]], [[end, 0, 0], [5, end, 1], [0, 40, end]]];
        let all = Bricks::new(grid, 4, &triangles);
        let within = [[3, 0, 5], [9, 6, 7]];
        let some = Bricks::within(grid, 4, within, &triangles);
        let is_in = |code: u32| {
            let cell = cell_of_morton(code).map(i64::from);
            (0..3).all(|i| (within[0][i]..=within[1][i]).contains(&cell[i]))
        };
        let inside: Vec<_> = (0..all.len()).map(|i| all.brick(i)).filter(|(code, ..)| is_in(*code)).collect();
        assert!(inside.len() > 5 && inside.len() < all.len());
        assert_eq!(inside, (0..some.len()).map(|i| some.brick(i)).collect::<Vec<_>>());
    }

    #[test]
    fn long_thin_triangles_are_in_few_bricks() {
        let grid = Grid::new(11);
        let entries = |triangle| Bricks::new(grid, 6, &[triangle]).entries.len();
        let end = (grid.lattice_size() - 1) as i16;
        assert_eq!(entries([[0; 3], [end / 2; 3], [end; 3]]), 0, "no area");
        // 32 bricks along the diagonal, each with a few neighbours.
        let needle = entries([[0; 3], [end; 3], [1, 0, 2]]);
        assert!((32..=200).contains(&needle), "{needle}");
        let floor = entries([[0, 5, 0], [end, 5, 0], [0, 5, end]]);
        assert!((32 * 33 / 2..=32 * 34 / 2).contains(&floor), "{floor}");
    }
}
