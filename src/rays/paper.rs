//! The paper's own test, in plain floating point: what the tables compare ours with.
//!
//! # Theory
//! \[WMP\] Algorithm 2: the sampled direction nearest to the segment, the row of its voxelization that holds the segment's
//! midpoint, all bits outside the segment's extent cleared; the segment is occluded iff a bit is left.
//!
//! # Differences from the paper
//! The paper says nothing of the origin's own surface, whose voxels would hide everything. [`OriginBias`] lifts the
//! origin along its normal and skips a piece of the row that grows as the ray gets flatter. Both are counted in voxels
//! of the direction at hand, whose grid may be narrower along one axis than along another.

use crate::visibility::{Segment, Visibility, VisibilityError};
use glam::{DMat3, DVec3, Vec3};
use manyview_shaders::directions::{DirectionFrame, DirectionSet, RowLattice};
use manyview_shaders::testable::testable;
use rayon::prelude::*;
use std::sync::Arc;

/// What is asked, in double precision: is anything between two points?
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExactSegment {
    /// World space, metres; on a surface, or free.
    pub origin: DVec3,
    /// World space, metres; free (a light, a camera).
    pub target: DVec3,
    /// Unit normal of the origin's surface on the target's side; zero where the origin is free.
    pub normal: DVec3,
}

/// How a segment's origin is kept clear of its own surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OriginBias {
    /// The origin moves this far along its normal, in voxels.
    pub normal_voxels: f64,
    /// The row is skipped for this far divided by the cosine between ray and normal, in voxels.
    pub skip_voxels: f64,
    /// Then set bits without a gap belong to the origin's surface, for at most this far divided by the cosine, in
    /// voxels.
    pub run_voxels: f64,
}

impl Default for OriginBias {
    /// One voxel along the normal, and half a voxel of the row over the cosine.
    fn default() -> Self {
        Self { normal_voxels: 1.0, skip_voxels: 0.5, run_voxels: 0.0 }
    }
}

impl OriginBias {
    /// No bias at all.
    pub const NONE: Self = Self { normal_voxels: 0.0, skip_voxels: 0.0, run_voxels: 0.0 };
}

/// The rows of one direction.
#[derive(Debug, Clone, Copy)]
pub struct DirectionRows<'a> {
    voxel_from_world: DMat3,
    /// Along a normal's image, voxels per metre differ from those along a point's: this is the inverse transpose.
    voxel_from_world_normal: DMat3,
    offset: DVec3,
    center: DVec3,
    bits: u32,
    rows: &'a [u32],
}

impl<'a> DirectionRows<'a> {
    /// The rows of the direction of `frame`: `2^bits` voxels a side, layout of `rows.bits`
    /// ([`manyview_shaders::sections`]).
    ///
    /// # Panics
    /// If `rows` is shorter than a direction's rows.
    pub fn new(frame: &DirectionFrame, lattice: &RowLattice, bits: u32, rows: &'a [u32]) -> Self {
        assert!(rows.len() >= 1 << (3 * bits - 5), "a direction of {bits} bits has more rows");
        let (matrix, offset) = frame.voxel_from_world(lattice, bits);
        let voxel_from_world = DMat3::from_cols_array_2d(&matrix).transpose();
        Self {
            voxel_from_world,
            voxel_from_world_normal: voxel_from_world.inverse().transpose(),
            offset: DVec3::from_array(offset),
            center: DVec3::from_array(lattice.center),
            bits,
            rows,
        }
    }

    /// Whether a bit is set along the segment. Its direction should be nearest to this one.
    pub fn is_occluded(&self, segment: &ExactSegment, bias: OriginBias) -> bool {
        let voxel = |world: DVec3| self.voxel_from_world * (world - self.center) + self.offset;
        let (mut origin, target) = (voxel(segment.origin), voxel(segment.target));
        let normal = (self.voxel_from_world_normal * segment.normal).normalize_or_zero();
        let cosine = (target - origin).normalize_or_zero().dot(normal).abs();
        origin += normal * bias.normal_voxels;
        let skip = if normal == DVec3::ZERO { 0.0 } else { bias.skip_voxels / cosine };
        let (start, end) =
            if target.z >= origin.z { (origin.z + skip, target.z) } else { (target.z, origin.z - skip) };
        let middle = (origin + target) * 0.5;
        let size = f64::from(1u32 << self.bits);
        let inside = |c: f64| (0.0..size).contains(&c);
        // Written so that NaN is no hit.
        if !(start <= end && end >= 0.0 && start < size && inside(middle.x) && inside(middle.y)) {
            return false;
        }
        let (mut first, mut last) = (start.max(0.0) as u32, end.min(size - 1.0) as u32);
        let words = 1usize << (self.bits - 5);
        let row = ((middle.y as usize) << self.bits | middle.x as usize) * words;
        let row = &self.rows[row..row + words];
        if bias.run_voxels > 0.0 && normal != DVec3::ZERO {
            let mut left = (bias.run_voxels / cosine).min(size) as u32;
            let is_set = |w: u32| row[(w >> 5) as usize] >> (w & 31) & 1 == 1;
            let upwards = target.z >= origin.z;
            while left > 0 && is_set(if upwards { first } else { last }) {
                if first == last {
                    return false;
                }
                (first, last) = if upwards { (first + 1, last) } else { (first, last - 1) };
                left -= 1;
            }
        }
        (0u32..).zip(row).any(|(word, bits)| bits & word_mask(word, first, last) != 0)
    }
}

/// Bits `first ..= last` of a row, as far as they are in its word number `word`.
fn word_mask(word: u32, first: u32, last: u32) -> u32 {
    let (start, end) = (word * 32, word * 32 + 31);
    if first > end || last < start {
        return 0;
    }
    let from = first.max(start) - start;
    let to = last.min(end) - start;
    (u32::MAX >> (31 - (to - from))) << from
}

/// The rows of all directions.
#[derive(Debug, Clone, Copy)]
pub struct Rows<'a> {
    /// The sampled directions.
    pub directions: DirectionSet,
    /// Where all frames start from.
    pub lattice: RowLattice,
    /// log2 of voxels a side, at least 5.
    pub bits: u32,
    /// One frame per direction.
    pub frames: &'a [DirectionFrame],
    /// Direction after direction, layout of `rows.bits` ([`manyview_shaders::sections`]).
    pub rows: &'a [u32],
}

impl Rows<'_> {
    /// Whether anything is between a segment's ends.
    pub fn is_occluded(&self, segment: &ExactSegment, bias: OriginBias) -> bool {
        let nearest =
            self.directions.nearest((segment.target - segment.origin).as_vec3().to_array()) as usize;
        let words = 1usize << (3 * self.bits - 5);
        let rows = &self.rows[nearest * words..(nearest + 1) * words];
        DirectionRows::new(&self.frames[nearest], &self.lattice, self.bits, rows).is_occluded(segment, bias)
    }
}

/// The paper's own test as a method, on all threads: slow, and the yardstick for errors.
#[derive(Debug, Clone)]
pub struct PaperRows {
    directions: DirectionSet,
    lattice: RowLattice,
    bits: u32,
    frames: Arc<Vec<DirectionFrame>>,
    rows: Arc<Vec<u32>>,
    bias: OriginBias,
}

impl PaperRows {
    /// Over the rows of all directions, `2^bits` voxels a side, layout of `rows.bits` ([`manyview_shaders::sections`]);
    /// with the usual bias.
    ///
    /// # Panics
    /// If there are not as many frames and rows as directions.
    pub fn new(
        directions: DirectionSet,
        lattice: RowLattice,
        bits: u32,
        frames: Arc<Vec<DirectionFrame>>,
        rows: Arc<Vec<u32>>,
    ) -> Self {
        let count = directions.count() as usize;
        assert_eq!(frames.len(), count, "one frame for each direction");
        assert_eq!(rows.len(), count << (3 * bits - 5), "rows for each direction");
        Self { directions, lattice, bits, frames, rows, bias: OriginBias::default() }
    }
}

impl Visibility for PaperRows {
    fn name(&self) -> &'static str {
        "rows-paper"
    }

    fn occluded(&self, segments: &[Segment], occluded: &mut [u8]) -> Result<(), VisibilityError> {
        assert_eq!(segments.len(), occluded.len(), "one answer per segment");
        let Self { directions, lattice, bits, .. } = *self;
        let rows = Rows { directions, lattice, bits, frames: &self.frames, rows: &self.rows };
        segments.par_iter().zip(occluded).with_min_len(256).for_each(|(segment, occluded)| {
            *occluded = testable(segment).map_or(0, |segment| {
                let [origin, target, normal] =
                    [segment.origin, segment.target, segment.normal].map(|v| Vec3::from_array(v).as_dvec3());
                u8::from(rows.is_occluded(&ExactSegment { origin, target, normal }, self.bias))
            });
        });
        Ok(())
    }

    fn distances(&self, _: &[Segment], _: &mut [f32]) -> Result<(), VisibilityError> {
        let problem = "says whether something is hit, not where; use `rows`";
        Err(VisibilityError::Unsupported { method: self.name(), problem })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use manyview_shaders::directions::Fit;

    const LATTICE: RowLattice = RowLattice { center: [5.0, 0.0, 0.0], half_extent: [16.0, 16.0, 16.0] };
    const UP: DVec3 = DVec3::Y;

    /// Direction 0 of a latitude-longitude set: rows along +Y, one voxel per metre.
    fn along_y() -> DirectionFrame {
        let set = DirectionSet::LatLong { thetas: 2, phis: 2 };
        let extent = 16.0 / (1.0 + 1.0 / 256.0);
        DirectionFrame::new(set.frame(0), &LATTICE, Fit::Extent, [[-extent, extent]; 3])
    }

    /// A floor at y = 0 that fills the voxels from 0 to 1 m.
    fn floor() -> Vec<u32> {
        vec![1 << 16; 1024]
    }

    fn up_from(y: f64) -> ExactSegment {
        ExactSegment { origin: DVec3::new(5.3, y, 0.4), target: DVec3::new(5.3, 12.0, 0.4), normal: UP }
    }

    #[test]
    fn only_what_is_between_the_ends_occludes() {
        let (frame, rows) = (along_y(), floor());
        let rows = DirectionRows::new(&frame, &LATTICE, 5, &rows);
        let free = |from: f64, to: f64| ExactSegment {
            origin: DVec3::new(5.3, from, 0.4),
            target: DVec3::new(5.3, to, 0.4),
            normal: DVec3::ZERO,
        };
        for (from, to, occluded) in
            [(-3.0, 3.0, true), (3.0, -3.0, true), (1.5, 9.0, false), (-9.0, -0.5, false), (0.5, 9.0, true)]
        {
            assert_eq!(rows.is_occluded(&free(from, to), OriginBias::NONE), occluded, "{from} to {to}");
        }
        let outside = ExactSegment { origin: DVec3::splat(90.0), target: DVec3::splat(99.0), normal: UP };
        assert!(!rows.is_occluded(&outside, OriginBias::NONE));
        assert!(!rows.is_occluded(&free(f64::NAN, 1.0), OriginBias::NONE));
    }

    #[test]
    fn the_bias_leaves_the_own_surface() {
        let (frame, rows) = (along_y(), floor());
        let rows = DirectionRows::new(&frame, &LATTICE, 5, &rows);
        assert!(rows.is_occluded(&up_from(0.1), OriginBias::NONE));
        assert!(!rows.is_occluded(&up_from(0.1), OriginBias::default()));
        assert!(rows.is_occluded(&up_from(-2.5), OriginBias::default()), "but not the next one");
        let skip_only = OriginBias { skip_voxels: 0.5, ..OriginBias::NONE };
        assert!(rows.is_occluded(&up_from(0.4), skip_only) && !rows.is_occluded(&up_from(0.6), skip_only));
    }

    #[test]
    fn a_run_of_the_own_surface_ends_at_a_gap_and_at_its_limit() {
        // Voxels 15, 16 and 17 are the own surface; 19 is something else.
        let (frame, rows) = (along_y(), vec![0b10_1110 << 14; 1024]);
        let rows = DirectionRows::new(&frame, &LATTICE, 5, &rows);
        let ask =
            |y: f64, run_voxels| rows.is_occluded(&up_from(y), OriginBias { run_voxels, ..OriginBias::NONE });
        assert!(ask(-0.5, 3.0), "what is behind the gap occludes");
        let below = |run_voxels| {
            let segment = ExactSegment { target: DVec3::new(5.3, 2.5, 0.4), ..up_from(-0.5) };
            rows.is_occluded(&segment, OriginBias { run_voxels, ..OriginBias::NONE })
        };
        assert!(!below(3.0) && below(2.0) && below(0.0));
        let down = ExactSegment {
            origin: DVec3::new(5.3, 1.5, 0.4),
            target: DVec3::new(5.3, -9.0, 0.4),
            normal: -UP,
        };
        assert!(!rows.is_occluded(&down, OriginBias { run_voxels: 3.0, ..OriginBias::NONE }));
        assert!(rows.is_occluded(&down, OriginBias { run_voxels: 2.0, ..OriginBias::NONE }));
    }

    #[test]
    fn masks_keep_exactly_the_bits_between() {
        for first in 0..64 {
            for last in first..64 {
                for bit in 0..64 {
                    let set = word_mask(bit / 32, first, last) >> (bit % 32) & 1 == 1;
                    assert_eq!(set, (first..=last).contains(&bit), "{first} {bit} {last}");
                }
            }
        }
    }

    #[test]
    fn all_directions_answer_like_the_nearest_one() {
        let directions = DirectionSet::LatLong { thetas: 2, phis: 2 };
        let frames = [along_y(); 4];
        let rows = [floor(), vec![0; 3 * 1024]].concat();
        let all = Rows { directions, lattice: LATTICE, bits: 5, frames: &frames, rows: &rows };
        assert!(all.is_occluded(&up_from(-3.0), OriginBias::default()));
        let sideways = ExactSegment { target: DVec3::new(15.0, -3.0, 0.4), ..up_from(-3.0) };
        assert!(!all.is_occluded(&sideways, OriginBias::NONE));
    }
}
