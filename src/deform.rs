//! Rows of an object that deforms: made anew each frame from points on its surface.
//!
//! # Theory
//! \[WMP\] Algorithm 5: per frame only one voxelization is made from the triangles, and the rows of all directions are
//! filled by rotating its occupied voxels. [`occupied_points`] gives those voxels' centres.
//!
//! # Differences from the paper
//! Any points on the surface will do, such as the vertices of a dense mesh or points that were sampled once per
//! triangle and move with it. Two points a voxel edge leave next to no holes; that is also what the bake takes by
//! default, and from the same points these rows are the bake's own, bit for bit.
//!
//! # Practice
//! The directions' frames are fixed once, over bounds that hold the object however it deforms: computing them anew
//! would take longer than filling the rows. Memory is reused; directions are filled in parallel. On a GPU
//! [`GpuDeformingRows`](crate::gpu::GpuDeformingRows) does the same without leaving it.

use glam::{DMat3, DVec3};
use manyview_shaders::directions::{
    DirectionFrame, DirectionSet, Fit, ROW_LATTICE, ROW_RAW_BITS, RowLattice, extents_along,
};
use manyview_shaders::rotate::{SpreadPoints, rotate_points};
use rayon::prelude::*;
use thiserror::Error;

/// Why rows cannot be made.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum DeformError {
    /// The rows have another size than there are kernels for.
    #[error("rows of 2^{bits} voxels: 5 to 8 bits (32 to 256 voxels a side) can be done")]
    Bits {
        /// log2 of voxels a side.
        bits: u32,
    },
    /// The bounds are no box with an extent.
    #[error("the bounds {min:?} to {max:?} are no box of finite numbers with an extent")]
    Bounds {
        /// Smallest corner.
        min: [f64; 3],
        /// Largest corner.
        max: [f64; 3],
    },
    /// There are not as many frames as directions.
    #[error("{frames} frames for {directions} directions")]
    Frames {
        /// Frames given.
        frames: usize,
        /// Directions of the set.
        directions: u32,
    },
}

/// The rows of a deforming object.
#[derive(Debug, Clone)]
pub struct DeformingRows {
    directions: DirectionSet,
    lattice: RowLattice,
    bits: u32,
    frames: Vec<DirectionFrame>,
    points: SpreadPoints,
    rows: Vec<u32>,
}

impl DeformingRows {
    /// Empty rows for an object within bounds (object space, metres) that hold it however it deforms.
    pub fn new(
        directions: DirectionSet,
        bits: u32,
        fit: Fit,
        [min, max]: [DVec3; 2],
    ) -> Result<Self, DeformError> {
        let extent = max - min;
        if !(extent.is_finite() && extent.min_element() >= 0.0 && extent.max_element() > 0.0) {
            return Err(DeformError::Bounds { min: min.to_array(), max: max.to_array() });
        }
        let lattice = RowLattice::new(min.to_array(), max.to_array());
        let whole = [[[-ROW_LATTICE as i16; 3], [ROW_LATTICE as i16; 3]]];
        let frame = |direction| {
            let axes = directions.frame(direction);
            DirectionFrame::new(axes, &lattice, fit, extents_along(axes, &lattice, &whole))
        };
        let frames = (0..directions.count()).into_par_iter().map(frame).collect();
        Self::with_frames(directions, lattice, bits, frames)
    }

    /// Empty rows in frames from elsewhere, such as those of a bake of the object's rest pose.
    pub fn with_frames(
        directions: DirectionSet,
        lattice: RowLattice,
        bits: u32,
        frames: Vec<DirectionFrame>,
    ) -> Result<Self, DeformError> {
        if !(5..=8).contains(&bits) {
            return Err(DeformError::Bits { bits });
        }
        if frames.len() != directions.count() as usize {
            return Err(DeformError::Frames { frames: frames.len(), directions: directions.count() });
        }
        let rows = vec![0; frames.len() << (3 * bits - 5)];
        Ok(Self { directions, lattice, bits, frames, points: SpreadPoints::default(), rows })
    }

    /// Fills the rows from points in object space, metres. Points outside the bounds move onto them; a coordinate that
    /// is NaN counts as the bounds' middle.
    pub fn refill(&mut self, points: &[[f32; 3]]) {
        let lattice = self.lattice;
        self.points.assign(points.len(), |index| lattice.snap(points[index].map(f64::from)));
        self.fill();
    }

    /// Fills the rows from points of the row lattice.
    pub fn refill_lattice(&mut self, points: &[[i16; 3]]) {
        self.points.assign(points.len(), |index| points[index]);
        self.fill();
    }

    fn fill(&mut self) {
        let (bits, points) = (self.bits, &self.points);
        self.rows.par_chunks_mut(1 << (3 * bits - 5)).zip(&self.frames).for_each(|(rows, frame)| {
            rows.fill(0);
            rotate_points(frame, bits, points, rows);
        });
    }

    /// The sampled directions.
    pub fn directions(&self) -> DirectionSet {
        self.directions
    }

    /// Where all frames start from.
    pub fn lattice(&self) -> RowLattice {
        self.lattice
    }

    /// log2 of voxels a side.
    pub fn bits(&self) -> u32 {
        self.bits
    }

    /// One frame per direction.
    pub fn frames(&self) -> &[DirectionFrame] {
        &self.frames
    }

    /// The rows, direction after direction, layout of `rows.bits` ([`manyview_shaders::sections`]).
    pub fn rows(&self) -> &[u32] {
        &self.rows
    }
}

/// The centres of the occupied voxels of one direction's rows, as points of the row lattice: what the paper rotates
/// into all other directions. Rows after rows, first voxels first.
pub fn occupied_points(frame: &DirectionFrame, bits: u32, rows: &[u32]) -> Vec<[i16; 3]> {
    let matrix = DMat3::from_cols_array_2d(&frame.row_from_lattice.map(|row| row.map(f64::from))).transpose();
    let lattice_from_raw = matrix.inverse();
    let offset = DVec3::from_array(frame.offset.map(f64::from));
    let voxel = f64::from(1u32 << (ROW_RAW_BITS - bits));
    let limit = f64::from(ROW_LATTICE);
    let words_a_row = 1usize << (bits - 5);
    let mut points = Vec::new();
    for (index, &word) in rows.iter().enumerate() {
        let (row, first) = (index / words_a_row, index % words_a_row * 32);
        let (u, v) = (row & ((1 << bits) - 1), row >> bits);
        let mut left = word;
        while left != 0 {
            let w = first + left.trailing_zeros() as usize;
            left &= left - 1;
            let center = DVec3::from_array([u, v, w].map(|c| (c as f64 + 0.5) * voxel));
            let point = lattice_from_raw * (center - offset);
            points.push(point.to_array().map(|c| (c + 0.5).floor().clamp(-limit, limit) as i16));
        }
    }
    points
}

#[cfg(all(test, feature = "bake"))]
mod tests {
    use super::*;
    use crate::bench::Random;
    use manyview_pipeline::generate::{SceneKind, generate};
    use manyview_pipeline::rows::{RowsFrom, RowsOptions, RowsPlan};
    use manyview_pipeline::triangles::{Cutouts, LatticeTriangles};

    const SET: DirectionSet = DirectionSet::LatLong { thetas: 5, phis: 6 };

    #[test]
    fn from_the_bakes_points_come_the_bakes_rows() {
        let scene = generate(SceneKind::Park, 2000, 3);
        let cutouts = Cutouts::new(&scene);
        let (min, max) = scene.bounds().unwrap();
        let lattice = RowLattice::new(min.to_array(), max.to_array());
        let drawn = LatticeTriangles::new(&scene, &cutouts, |p| lattice.snap(p.to_array()));
        for from in [RowsFrom::Points, RowsFrom::Rotate] {
            for fit in [Fit::Cube, Fit::Extent] {
                let options = RowsOptions { bits: 6, directions: SET, fit, from };
                let plan = RowsPlan::new(options, lattice, &drawn, &cutouts);
                let frames = plan.frames.clone();
                let mut rows = DeformingRows::with_frames(SET, lattice, 6, frames).unwrap();
                // What was there before leaves no trace.
                rows.refill_lattice(&[[77, -5, 16_384]]);
                rows.refill_lattice(plan.points());
                assert!(rows.rows() == plan.block(&plan.frames), "{from} {fit:?}");
                assert!(plan.point_count() > 500);
            }
        }
    }

    #[test]
    fn points_of_a_moving_ball_are_where_it_is() {
        let mut rows =
            DeformingRows::new(SET, 5, Fit::Extent, [DVec3::splat(-4.0), DVec3::splat(4.0)]).unwrap();
        let mut random = Random::new(1);
        for frame in 0..3 {
            let center = DVec3::new(f64::from(frame) - 1.0, 0.0, 1.0);
            let points: Vec<[f32; 3]> =
                (0..500).map(|_| (center + random.direction() * 2.0).as_vec3().to_array()).collect();
            rows.refill(&points);
            let words = 1usize << 10;
            for (direction, found) in rows.rows().chunks(words).enumerate() {
                let (matrix, offset) = rows.frames()[direction].voxel_from_world(&rows.lattice(), 5);
                let mut expected = vec![0u32; words];
                for p in &points {
                    let voxel = [0, 1, 2].map(|a| {
                        let along: f64 = (0..3).map(|i| matrix[a][i] * f64::from(p[i])).sum();
                        along + offset[a]
                    });
                    // Snapping moves points by less than a thousandth of a voxel; those at borders may go either way.
                    if voxel.iter().all(|c| (c - c.round()).abs() > 2e-3) {
                        let [u, v, w] = voxel.map(|c| c as usize);
                        expected[v << 5 | u] |= 1 << w;
                    }
                }
                let missing: u32 = expected.iter().zip(found).map(|(e, f)| (e & !f).count_ones()).sum();
                let extra: u32 = expected.iter().zip(found).map(|(e, f)| (f & !e).count_ones()).sum();
                assert!(missing == 0 && extra <= 20, "direction {direction}: {missing} {extra}");
            }
        }
    }

    #[test]
    fn occupied_voxels_come_back_to_their_own_places() {
        let mut rows =
            DeformingRows::new(SET, 5, Fit::Cube, [DVec3::ZERO, DVec3::new(9.0, 4.0, 7.0)]).unwrap();
        let mut random = Random::new(2);
        let points: Vec<_> =
            (0..300).map(|_| [(); 3].map(|()| (random.signed() * 16_000.0) as i16)).collect();
        rows.refill_lattice(&points);
        let first = rows.rows()[..1024].to_vec();
        let centers = occupied_points(&rows.frames()[0], 5, &first);
        assert_eq!(centers.len(), first.iter().map(|word| word.count_ones() as usize).sum::<usize>());
        rows.refill_lattice(&centers);
        // Voxels whose centre lies outside the lattice's bounds are the only ones that may move.
        let lost: u32 = first.iter().zip(rows.rows()).map(|(a, b)| (a & !b).count_ones()).sum();
        assert!(lost <= 6, "{lost}");
    }

    #[test]
    fn wrong_settings_are_refused() {
        let cube = [DVec3::ZERO, DVec3::ONE];
        let refused = |bits, bounds| DeformingRows::new(SET, bits, Fit::Cube, bounds).unwrap_err();
        assert_eq!(refused(9, cube), DeformError::Bits { bits: 9 });
        assert!(matches!(refused(5, [DVec3::ONE, DVec3::ZERO]), DeformError::Bounds { .. }));
        assert!(matches!(refused(5, [DVec3::NAN, DVec3::ZERO]), DeformError::Bounds { .. }));
        assert!(matches!(refused(5, [DVec3::ONE, DVec3::ONE]), DeformError::Bounds { .. }));
        let lattice = RowLattice::new([0.0; 3], [1.0; 3]);
        let error = DeformingRows::with_frames(SET, lattice, 5, Vec::new()).unwrap_err();
        assert_eq!(error, DeformError::Frames { frames: 0, directions: 30 });
        let mut none = DeformingRows::new(SET, 5, Fit::Cube, cube).unwrap();
        none.refill(&[]);
        assert!(none.rows().iter().all(|&word| word == 0));
    }
}
