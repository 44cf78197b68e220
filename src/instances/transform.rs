use glam::{DMat3, DMat4, DVec3};
use thiserror::Error;

/// A rotation or reflection, then a uniform scale, then a translation: what keeps angles and ratios of lengths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    world_from_object: DMat3,
    object_from_world: DMat3,
    translation: DVec3,
    scale: f64,
}

/// Why a matrix is no similarity.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum TransformProblem {
    /// An entry is NaN or infinite.
    #[error("the transform has an entry that is not a finite number")]
    NotFinite,
    /// It flattens space.
    #[error("the transform is singular: it scales by 0 along an axis")]
    Singular,
    /// It shears, or scales axes differently.
    #[error(
        "the transform shears, or scales its axes differently (by {least} to {most}): bake the object with its scale \
         as a type of its own"
    )]
    NotUniform {
        /// Smallest scale of an axis.
        least: f64,
        /// Largest scale of an axis.
        most: f64,
    },
    /// Its last row is not 0 0 0 1.
    #[error("the transform is a projection: its last row must be 0 0 0 1")]
    Projection,
}

/// How far axes may be from orthogonal and of one length, as a share of that length: a few roundings of `f32`.
const TOLERANCE: f64 = 1e-5;

impl Similarity {
    /// Nothing moves.
    pub const IDENTITY: Self = Self {
        world_from_object: DMat3::IDENTITY,
        object_from_world: DMat3::IDENTITY,
        translation: DVec3::ZERO,
        scale: 1.0,
    };

    /// Takes a matrix apart.
    pub fn from_matrix(world_from_object: DMat4) -> Result<Self, TransformProblem> {
        if !world_from_object.is_finite() {
            return Err(TransformProblem::NotFinite);
        }
        if world_from_object.row(3).to_array() != [0.0, 0.0, 0.0, 1.0] {
            return Err(TransformProblem::Projection);
        }
        let linear = DMat3::from_mat4(world_from_object);
        let axes = [linear.x_axis, linear.y_axis, linear.z_axis];
        let lengths = axes.map(DVec3::length);
        let [least, most] = [f64::min, f64::max].map(|of| of(of(lengths[0], lengths[1]), lengths[2]));
        let inverse = linear.inverse();
        if least <= most * 1e-9 || !inverse.is_finite() {
            return Err(TransformProblem::Singular);
        }
        let off =
            [(0, 1), (1, 2), (2, 0)].map(|(a, b)| (axes[a].dot(axes[b]) / (lengths[a] * lengths[b])).abs());
        if most - least > TOLERANCE * most || off.into_iter().any(|off| off > TOLERANCE) {
            return Err(TransformProblem::NotUniform { least, most });
        }
        Ok(Self {
            world_from_object: linear,
            object_from_world: inverse,
            translation: world_from_object.w_axis.truncate(),
            scale: lengths.iter().sum::<f64>() / 3.0,
        })
    }

    /// World-space lengths of object-space ones.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// A point in world space.
    pub fn world_point(&self, object: DVec3) -> DVec3 {
        self.world_from_object * object + self.translation
    }

    /// A point in object space.
    pub fn object_point(&self, world: DVec3) -> DVec3 {
        self.object_from_world * (world - self.translation)
    }

    /// A unit normal in object space; zero stays zero.
    pub fn object_normal(&self, world: DVec3) -> DVec3 {
        (self.world_from_object.transpose() * world).normalize_or_zero()
    }

    /// Half the extent along world axes of a box of half extent `half` along object axes.
    pub(super) fn world_reach(&self, half: DVec3) -> DVec3 {
        let [x, y, z] = [0, 1, 2].map(|axis| self.world_from_object.col(axis).abs() * half[axis]);
        x + y + z
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    #[test]
    fn a_similarity_is_taken_apart_and_undone() {
        let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -2.0) / 3.0, 0.7);
        for mirror in [1.0, -1.0] {
            let scale = DVec3::new(mirror, 1.0, 1.0) * 2.5;
            let matrix = DMat4::from_scale_rotation_translation(scale, turn, DVec3::new(4.0, 5.0, 6.0));
            let similarity = Similarity::from_matrix(matrix).unwrap();
            let p = DVec3::new(0.3, -7.0, 2.0);
            assert!((similarity.world_point(p) - matrix.transform_point3(p)).length() < 1e-12);
            assert!((similarity.object_point(similarity.world_point(p)) - p).length() < 1e-12);
            assert!((similarity.scale() - 2.5).abs() < 1e-12);
            let normal = similarity.object_normal(matrix.transform_vector3(DVec3::Y).normalize_or_zero());
            assert!((normal - DVec3::Y).length() < 1e-12);
            assert_eq!(similarity.object_normal(DVec3::ZERO), DVec3::ZERO);
        }
        assert_eq!(Similarity::from_matrix(DMat4::IDENTITY), Ok(Similarity::IDENTITY));
    }

    #[test]
    fn what_is_no_similarity_is_refused_for_its_reason() {
        let problem = |matrix| Similarity::from_matrix(matrix).unwrap_err();
        let scaled = |x, y, z| DMat4::from_scale(DVec3::new(x, y, z));
        assert_eq!(problem(scaled(1.0, 0.0, 1.0)), TransformProblem::Singular);
        assert_eq!(
            problem(
                DMat4::ZERO
                    + DMat4::from_cols_array_2d(&[[0.0; 4], [0.0; 4], [0.0; 4], [0.0, 0.0, 0.0, 1.0]])
            ),
            TransformProblem::Singular
        );
        assert_eq!(problem(scaled(1.0, f64::NAN, 1.0)), TransformProblem::NotFinite);
        assert_eq!(problem(scaled(1.0, f64::INFINITY, 1.0)), TransformProblem::NotFinite);
        assert_eq!(problem(scaled(1.0, 2.0, 1.0)), TransformProblem::NotUniform { least: 1.0, most: 2.0 });
        let mut sheared = DMat4::IDENTITY;
        sheared.y_axis.x = 0.1;
        assert!(matches!(problem(sheared), TransformProblem::NotUniform { .. }));
        let mut projection = DMat4::IDENTITY;
        projection.x_axis.w = 0.5;
        assert_eq!(problem(projection), TransformProblem::Projection);
        assert!(Similarity::from_matrix(scaled(1.0, 1.000_001, 1.0)).is_ok());
    }
}
