//! Rows as a method among others, the plain version: one segment after the other, one row each.

use crate::rays::paper::{DirectionRows, ExactSegment, OriginBias};
use crate::visibility::{Segment, Visibility, VisibilityError};
use glam::DVec3;
use manyview_shaders::directions::{DirectionFrame, DirectionSet, RowLattice};
use rayon::prelude::*;

/// The rows of all directions in memory, asked through [`Visibility`]: method `rows-paper`.
pub struct PlainRows {
    directions: DirectionSet,
    lattice: RowLattice,
    bits: u32,
    frames: Vec<DirectionFrame>,
    rows: Vec<u32>,
    bias: OriginBias,
}

impl PlainRows {
    /// Takes rows from elsewhere: direction after direction, layout of `rows.bits`
    /// ([`manyview_shaders::sections`]).
    ///
    /// # Panics
    /// If there are not as many frames and rows as directions.
    pub fn new(
        directions: DirectionSet,
        lattice: RowLattice,
        bits: u32,
        frames: Vec<DirectionFrame>,
        rows: Vec<u32>,
        bias: OriginBias,
    ) -> Self {
        let count = directions.count() as usize;
        assert_eq!(frames.len(), count, "one frame for each direction");
        assert_eq!(rows.len(), count << (3 * bits - 5), "rows for each direction");
        Self { directions, lattice, bits, frames, rows, bias }
    }

    /// Bytes of the rows.
    pub fn bytes(&self) -> u64 {
        4 * self.rows.len() as u64
    }

    fn is_occluded(&self, segment: &Segment) -> bool {
        let [origin, target, normal] =
            [segment.origin, segment.target, segment.normal].map(|v| DVec3::from_array(v.map(f64::from)));
        if !(origin.is_finite() && target.is_finite() && normal.is_finite()) || origin == target {
            return false;
        }
        let direction = (target - origin).normalize_or_zero();
        let nearest = self.directions.nearest(direction.as_vec3().to_array()) as usize;
        let words = 1usize << (3 * self.bits - 5);
        let rows = &self.rows[nearest * words..(nearest + 1) * words];
        let segment = ExactSegment { origin, target, normal };
        DirectionRows::new(&self.frames[nearest], &self.lattice, self.bits, rows)
            .is_occluded(&segment, self.bias)
    }
}

impl Visibility for PlainRows {
    fn name(&self) -> &'static str {
        "rows-paper"
    }

    fn occluded(&self, segments: &[Segment], occluded: &mut [u8]) -> Result<(), VisibilityError> {
        assert_eq!(segments.len(), occluded.len(), "one answer for each segment");
        segments
            .par_iter()
            .zip(occluded)
            .with_min_len(256)
            .for_each(|(segment, occluded)| *occluded = u8::from(self.is_occluded(segment)));
        Ok(())
    }

    fn distances(&self, _: &[Segment], _: &mut [f32]) -> Result<(), VisibilityError> {
        let problem = "in its plain version only says whether something is hit: use `bvh` for distances";
        Err(VisibilityError::Unsupported { method: self.name(), problem })
    }
}
