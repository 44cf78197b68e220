//! Marching rays through a sparse grid of bits.
//!
//! # Theory
//! A digital differential analyser (J. Amanatides, A. Woo, *A Fast Voxel Traversal Algorithm for Ray Tracing*,
//! Eurographics 1987) over a brickmap (T. van Wingerden, *Real-time Ray Tracing and Editing of Large Voxel Scenes*, 2015):
//! three levels, a dense coarse grid of cells 16³, in each that is not empty a 64-bit mask of 4³ bricks, and in each of
//! those a 64-bit mask of 4³ cells.
//!
//! # Differences from the paper
//! Empty space is left in the largest aligned cube that the masks show to be empty: of coarse cells too (their entry
//! says how large), and of 2³ bricks or cells, whose bits are neighbours in Morton order.
//!
//! # Practice
//! The ray is mirrored so that it never runs backwards. A cube is left through the nearest of its three far planes,
//! whose distances follow from whole numbers, so that each step advances by at least one cell along one axis and never
//! leaves the face-connected cells along the ray: a wall without holes between cells that share faces lets no ray
//! through. `lib_brickmap.wgsl` does the same operations in the same order. Where a GPU fuses multiplications and
//! additions or divides less exactly, a ray that passes within rounding of a cell's edge may answer otherwise.

use crate::executor::CpuBinding;
use crate::types::{BrickmapParams, Segment};

/// From here on an entry of the coarse grid is empty.
pub const BRICKMAP_EMPTY: u32 = 1 << 31;
/// Smallest component of a direction, cells per ray: what is smaller is parallel to the planes.
pub const MIN_DIRECTION: f32 = 1e-20;
/// Smallest cosine between a ray and a normal that the bias reckons with.
pub const MIN_COSINE: f32 = 0.05;
/// log2 of the cells of a coarse cell.
const COARSE_CELL_BITS: u32 = 4;

/// How a ray's origin is kept clear of its own surface, in cells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BrickmapBias {
    /// The origin moves this far along its normal.
    pub normal_cells: f32,
    /// Then this far of the ray, divided by the cosine between ray and normal, is skipped.
    pub skip_cells: f32,
}

impl BrickmapBias {
    /// No bias at all.
    pub const NONE: Self = Self { normal_cells: 0.0, skip_cells: 0.0 };
}

/// The arrays of a brickmap.
#[derive(Debug, Clone, PartialEq)]
pub struct Brickmap {
    /// Where it lies.
    pub params: BrickmapParams,
    /// x fastest: index of a coarse cell's block, or [`BRICKMAP_EMPTY`] plus log2 of the cells a side of the aligned
    /// cube around it that is empty.
    pub coarse: Vec<u32>,
    /// 16 bytes each: mask of bricks in Morton order (low, high half), index of the first brick, 0.
    pub blocks: Vec<[u32; 4]>,
    /// 8 bytes each: mask of cells in Morton order (low, high half).
    pub bricks: Vec<[u32; 2]>,
}

impl Brickmap {
    /// From the cells of an octree's level in Morton order, with the world position of the cube's smallest corner and
    /// its edge in metres.
    ///
    /// # Panics
    /// If a cell lies beyond the level's, or cells are not in Morton order.
    pub fn new(origin: [f64; 3], size: f64, level: u32, cells: &[[u16; 3]], bias: BrickmapBias) -> Self {
        // A grid coarser than one coarse cell fills a corner of it.
        let bits = level.max(COARSE_CELL_BITS);
        let coarse_bits = bits - COARSE_CELL_BITS;
        let params = BrickmapParams {
            origin: origin.map(|c| c as f32),
            cells_per_metre: (f64::from(1u32 << level) / size) as f32,
            side: 1 << bits,
            coarse_bits,
            normal_cells: bias.normal_cells,
            skip_cells: bias.skip_cells,
        };
        let mut map = Self {
            params,
            coarse: vec![BRICKMAP_EMPTY; 1 << (3 * coarse_bits)],
            blocks: Vec::new(),
            bricks: Vec::new(),
        };
        let (mut block_at, mut brick_at) = ([u32::MAX; 3], [u32::MAX; 3]);
        for cell in cells {
            let cell = cell.map(u32::from);
            assert!(cell.iter().all(|&c| c < 1 << level), "cell {cell:?} of level {level}");
            let coarse = cell.map(|c| c >> COARSE_CELL_BITS);
            if coarse != block_at {
                block_at = coarse;
                let entry = &mut map.coarse[coarse_index(coarse_bits, coarse)];
                assert_eq!(*entry, BRICKMAP_EMPTY, "cells are in Morton order");
                *entry = map.blocks.len() as u32;
                map.blocks.push([0, 0, map.bricks.len() as u32, 0]);
            }
            let brick = cell.map(|c| c >> 2);
            if brick != brick_at {
                brick_at = brick;
                let bit = group_bit(brick);
                let block = map.blocks.last_mut().expect("pushed above");
                block[bit as usize / 32] |= 1 << (bit % 32);
                map.bricks.push([0; 2]);
            }
            let bit = group_bit(cell);
            map.bricks.last_mut().expect("pushed above")[bit as usize / 32] |= 1 << (bit % 32);
        }
        map.measure_emptiness();
        map
    }

    /// Writes into every empty entry how large the empty aligned cube around it is.
    fn measure_emptiness(&mut self) {
        let bits = self.params.coarse_bits;
        // Whether cubes of 2^k coarse cells a side are empty, for k upwards.
        let mut empty: Vec<bool> = self.coarse.iter().map(|&entry| entry == BRICKMAP_EMPTY).collect();
        for k in 0..=bits {
            let side_bits = bits - k;
            if k > 0 {
                let finer = empty;
                let is_empty = |index: usize| {
                    let p = coarse_cell(side_bits, index);
                    (0..8u32).all(|c| {
                        finer[coarse_index(side_bits + 1, [0, 1, 2].map(|i| 2 * p[i] + (c >> i & 1)))]
                    })
                };
                empty = (0..1usize << (3 * side_bits)).map(is_empty).collect();
            }
            for (index, entry) in self.coarse.iter_mut().enumerate().filter(|(_, e)| **e >= BRICKMAP_EMPTY) {
                let p = coarse_cell(bits, index).map(|c| c >> k);
                if empty[coarse_index(side_bits, p)] {
                    *entry = BRICKMAP_EMPTY + COARSE_CELL_BITS + k;
                }
            }
        }
    }

    /// Ready to march through.
    pub fn view(&self) -> BrickmapView<'_> {
        BrickmapView { params: self.params, coarse: &self.coarse, blocks: &self.blocks, bricks: &self.bricks }
    }

    /// Bytes of all arrays.
    pub fn bytes(&self) -> u64 {
        (size_of_val(&self.coarse[..]) + size_of_val(&self.blocks[..]) + size_of_val(&self.bricks[..])) as u64
    }
}

fn coarse_index(bits: u32, [x, y, z]: [u32; 3]) -> usize {
    ((((z << bits) | y) << bits) | x) as usize
}

fn coarse_cell(bits: u32, index: usize) -> [u32; 3] {
    [0, bits, 2 * bits].map(|shift| (index as u32) >> shift & ((1 << bits) - 1))
}

/// Number of a cell in its group of 4³, in Morton order.
#[inline]
fn group_bit([x, y, z]: [u32; 3]) -> u32 {
    (x & 1) | (y & 1) << 1 | (z & 1) << 2 | (x & 2) << 2 | (y & 2) << 3 | (z & 2) << 4
}

/// Borrowed arrays of a [`Brickmap`].
#[derive(Debug, Clone, Copy)]
pub struct BrickmapView<'a> {
    params: BrickmapParams,
    coarse: &'a [u32],
    blocks: &'a [[u32; 4]],
    bricks: &'a [[u32; 2]],
}

impl<'a> BrickmapView<'a> {
    /// From what the stages bind.
    pub(crate) fn bound(bindings: &'a [CpuBinding]) -> Self {
        Self {
            params: bindings[0].first(),
            coarse: bindings[1].slice(),
            blocks: bindings[2].slice(),
            bricks: bindings[3].slice(),
        }
    }

    /// log2 of the empty cells a side around `cell`, or `None` if it is set. `cached` is the last brick looked into and
    /// its mask: rays stay in a brick for some steps.
    #[inline]
    fn empty_bits(&self, cell: [u32; 3], cached: &mut ([u32; 3], u64)) -> Option<u32> {
        let brick_cell = cell.map(|c| c >> 2);
        if brick_cell != cached.0 {
            let at = cell.map(|c| c >> COARSE_CELL_BITS);
            let entry = self.coarse[coarse_index(self.params.coarse_bits, at)];
            if entry >= BRICKMAP_EMPTY {
                return Some(entry - BRICKMAP_EMPTY);
            }
            let block = &self.blocks[entry as usize];
            let brick = group_bit(brick_cell);
            let mask = u64::from(block[0]) | u64::from(block[1]) << 32;
            if mask >> brick & 1 == 0 {
                return Some(if mask >> (brick & 56) & 255 == 0 { 3 } else { 2 });
            }
            let before = (mask & ((1 << brick) - 1)).count_ones();
            let bits = self.bricks[(block[2] + before) as usize];
            *cached = (brick_cell, u64::from(bits[0]) | u64::from(bits[1]) << 32);
        }
        let bit = group_bit(cell);
        if cached.1 >> bit & 1 == 1 {
            return None;
        }
        Some(u32::from(cached.1 >> (bit & 56) & 255 == 0))
    }

    /// Distance in metres to the first set cell along a testable segment ([`crate::testable`]), from its lifted origin.
    /// Takes one of `steps_left` for each cube it passes and finds nothing where none is left.
    #[inline]
    pub fn march(&self, segment: &Segment, steps_left: &mut u32) -> Option<f32> {
        let params = &self.params;
        let scale = params.cells_per_metre;
        let normal = segment.normal;
        let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let mut start = [0, 1, 2]
            .map(|i| (segment.origin[i] - params.origin[i]) * scale + normal[i] * params.normal_cells);
        let mut along = [0, 1, 2].map(|i| (segment.target[i] - params.origin[i]) * scale - start[i]);
        let length = dot(along, along).sqrt();
        let mut t = 0.0f32;
        if normal != [0.0; 3] {
            let cosine = dot(along, normal).abs() / length;
            t = params.skip_cells / cosine.max(MIN_COSINE) / length;
        }
        let side = params.side as f32;
        let mut mirror = [0; 3];
        let mut inverse = [0.0; 3];
        let mut t_end = 1.0f32;
        for i in 0..3 {
            if along[i] < 0.0 {
                mirror[i] = params.side - 1;
                start[i] = side - start[i];
                along[i] = -along[i];
            }
            inverse[i] = 1.0 / along[i].max(MIN_DIRECTION);
            t = t.max(-start[i] * inverse[i]);
            t_end = t_end.min((side - start[i]) * inverse[i]);
        }
        // Not `t >= t_end`: NaN is no hit.
        if t.partial_cmp(&t_end) != Some(std::cmp::Ordering::Less) {
            return None;
        }
        // No number here is below -1: cutting off fractions rounds down, but for those that are clamped anyway.
        let mut cell = [0, 1, 2].map(|i| ((start[i] + along[i] * t) as i32).clamp(0, params.side as i32 - 1));
        let mut cached = ([u32::MAX; 3], 0);
        while *steps_left > 0 {
            *steps_left -= 1;
            let Some(empty) = self.empty_bits([0, 1, 2].map(|i| cell[i] as u32 ^ mirror[i]), &mut cached)
            else {
                return Some(t * length / scale);
            };
            let far = cell.map(|c| (c | ((1 << empty) - 1)) + 1);
            let planes = [0, 1, 2].map(|i| (far[i] as f32 - start[i]) * inverse[i]);
            t = t.max(planes[0].min(planes[1].min(planes[2])));
            if t >= t_end {
                return None;
            }
            let axis = if planes[0] <= planes[1] && planes[0] <= planes[2] {
                0
            } else if planes[1] <= planes[2] {
                1
            } else {
                2
            };
            for i in 0..3 {
                let next = (start[i] + along[i] * t) as i32;
                cell[i] = if i == axis { far[i] } else { next.max(cell[i]).min(far[i] - 1) };
            }
            if cell[axis] >= params.side as i32 {
                return None;
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cases::Random;

    /// The cells of a set, in Morton order.
    fn morton(mut cells: Vec<[u16; 3]>) -> Vec<[u16; 3]> {
        let key = |c: &[u16; 3]| {
            (0..16).map(|b| (0..3).map(|i| u64::from(c[i] >> b & 1) << (3 * b + i)).sum::<u64>()).sum::<u64>()
        };
        cells.sort_by_key(key);
        cells.dedup();
        cells
    }

    fn map(level: u32, cells: Vec<[u16; 3]>, bias: BrickmapBias) -> Brickmap {
        Brickmap::new([-1.0, 2.0, 0.5], f64::from(1u32 << level), level, &morton(cells), bias)
    }

    fn segment(origin: [f32; 3], target: [f32; 3], normal: [f32; 3]) -> Segment {
        // Grid coordinates to world.
        let world = |p: [f32; 3]| [p[0] - 1.0, p[1] + 2.0, p[2] + 0.5];
        Segment { origin: world(origin), target: world(target), normal }
    }

    fn ask(map: &Brickmap, segment: &Segment) -> Option<f32> {
        let mut steps = u32::MAX;
        map.view().march(segment, &mut steps)
    }

    #[test]
    fn every_cell_is_found_and_nothing_else() {
        let mut random = Random::new(5);
        for level in [1, 3, 4, 5, 6] {
            let side = 1u32 << level;
            let cells: Vec<[u16; 3]> =
                (0..side * 3).map(|_| [0; 3].map(|_| random.below(side) as u16)).collect();
            let map = map(level, cells.clone(), BrickmapBias::NONE);
            for z in 0..side {
                for y in 0..side {
                    for x in 0..side {
                        let set = cells.contains(&[x, y, z].map(|c| c as u16));
                        let empty = map.view().empty_bits([x, y, z], &mut ([u32::MAX; 3], 0));
                        assert_eq!(empty.is_none(), set);
                        // The cube that is said to be empty is.
                        if let Some(bits) = empty {
                            let inside = |c: &&[u16; 3]| {
                                [x, y, z].iter().zip(*c).all(|(&a, &b)| a >> bits == u32::from(b) >> bits)
                            };
                            assert_eq!(cells.iter().find(inside), None, "{bits} bits around {x} {y} {z}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn marching_meets_the_first_cell_along_every_axis() {
        let map = map(6, vec![[20, 30, 40], [5, 3, 10]], BrickmapBias::NONE);
        let p = [20.5, 30.5, 40.5];
        for axis in 0..3 {
            for sign in [-1.0f32, 1.0] {
                let mut from = p;
                from[axis] += sign * 12.0;
                let found = ask(&map, &segment(from, p, [0.0; 3])).expect("a cell");
                assert!((found - 11.5).abs() < 1e-4, "{found}");
                let mut far = p;
                far[axis] -= sign * 100.0;
                from[axis] += sign * 100.0;
                let found = ask(&map, &segment(from, far, [0.0; 3])).expect("from outside to outside");
                assert!((found - 111.5).abs() < 1e-3, "{found}");
                let mut past = p;
                past[axis] += sign * 0.6;
                assert_eq!(ask(&map, &segment(from, past, [0.0; 3])), None, "ends in front of it");
            }
        }
        assert_eq!(ask(&map, &segment([-5.0, 1.0, 1.0], [-5.0, 60.0, 60.0], [0.0; 3])), None, "passes by");
        assert_eq!(ask(&map, &segment(p, [0.0; 3], [0.0; 3])), Some(0.0), "begins inside");
    }

    #[test]
    fn a_wall_lets_nothing_through() {
        // A slanted wall, one cell thick, whose cells share faces.
        let cells: Vec<[u16; 3]> = (0..64u16)
            .flat_map(|y| (0..64u16).flat_map(move |z| [[20 + y / 3, y, z], [20 + (y + 1) / 3, y, z]]))
            .collect();
        let map = map(6, cells, BrickmapBias::NONE);
        let mut random = Random::new(8);
        let mut at = |low: u32, high: u32| (low + random.below(high - low)) as f32 / 16.0;
        for _ in 0..20_000 {
            let from = [at(0, 320), at(0, 1024), at(0, 1024)];
            let to = [at(43 * 16, 1024), at(0, 1024), at(0, 1024)];
            assert!(ask(&map, &segment(from, to, [0.0; 3])).is_some(), "{from:?} {to:?}");
            assert!(ask(&map, &segment(to, from, [0.0; 3])).is_some(), "{to:?} {from:?}");
        }
    }

    #[test]
    fn the_bias_leaves_the_own_surface() {
        let floor: Vec<[u16; 3]> = (0..32).flat_map(|x| (0..32).map(move |z| [x, 8, z])).collect();
        let up = [0.0, 1.0, 0.0];
        let slanted = |cells| segment([10.5, 8.5, 10.5], [13.5, 12.5, 10.5], cells);
        let none = map(5, floor.clone(), BrickmapBias::NONE);
        assert!(ask(&none, &slanted(up)).is_some());
        let lifted = map(5, floor.clone(), BrickmapBias { normal_cells: 0.6, skip_cells: 0.0 });
        assert!(ask(&lifted, &slanted(up)).is_none());
        assert!(ask(&lifted, &slanted([0.0; 3])).is_some(), "a free origin is not lifted");
        let skipped = map(5, floor, BrickmapBias { normal_cells: 0.0, skip_cells: 0.6 });
        assert!(ask(&skipped, &slanted(up)).is_none());
    }

    #[test]
    fn steps_end_a_march() {
        let map = map(6, vec![[63, 63, 63]], BrickmapBias::NONE);
        let diagonal = segment([0.5; 3], [63.5; 3], [0.0; 3]);
        let mut steps = 1000;
        assert!(map.view().march(&diagonal, &mut steps).is_some());
        let mut few = 1000 - steps - 1;
        assert!(map.view().march(&diagonal, &mut few).is_none() && few == 0);
    }

    #[test]
    fn an_empty_map_hides_nothing() {
        let map = map(0, Vec::new(), BrickmapBias::NONE);
        assert_eq!(ask(&map, &segment([-3.0; 3], [9.0, 8.0, 7.0], [0.0; 3])), None);
    }
}
