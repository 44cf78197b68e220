//! A pinhole camera.

use glam::DVec3;

use super::octree::Ray;

/// A pinhole camera in world space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Where it stands, metres.
    pub eye: DVec3,
    /// What is in the middle of the picture, metres.
    pub target: DVec3,
    /// What is up in the picture.
    pub up: DVec3,
    /// Vertical field of view, degrees.
    pub fov_degrees: f64,
}

/// A camera that cannot see.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CameraError {
    /// A number is NaN or infinite.
    #[error("the camera has a coordinate that is not a finite number")]
    NotFinite,
    /// Eye and target are one point.
    #[error("the camera's eye and target are the same point: move one of them")]
    NoDirection,
    /// The field of view is out of range.
    #[error("the camera's field of view must be more than 0 and less than 180 degrees")]
    FieldOfView,
}

/// A camera and a picture size, ready to make rays.
#[derive(Debug, Clone, Copy)]
pub struct RayMaker {
    eye: DVec3,
    forward: DVec3,
    /// From the middle of the picture to its right edge, at distance 1.
    right: DVec3,
    /// From the middle of the picture to its upper edge, at distance 1.
    up: DVec3,
    size: [f64; 2],
}

impl Camera {
    /// A camera at `eye` that looks along `forward`, with +Y up.
    pub fn looking(eye: DVec3, forward: DVec3, fov_degrees: f64) -> Self {
        Self { eye, target: eye + forward, up: DVec3::Y, fov_degrees }
    }

    /// The nearest camera that sees all `points` from the direction `from` (unit length, pointing from the points to
    /// the camera), at an aspect ratio (width / height), with a margin.
    pub fn fitted(points: &[DVec3], from: DVec3, fov_degrees: f64, aspect: f64) -> Self {
        let forward = -from;
        let (right, up) = Self::looking(from, forward, fov_degrees).axes();
        // A margin of a part in 25 on each side.
        let tangent = (fov_degrees.to_radians() * 0.5).tan() * 0.92;
        // A camera at (x, z) sees the point (p, q) if |p - x| ≤ (q - z) · tangent: two half planes for each point, of
        // which only the outermost matter.
        let place = |side: DVec3, tangent: f64| {
            let outermost = |side: DVec3| {
                points
                    .iter()
                    .map(|p| p.dot(side) - p.dot(forward) * tangent)
                    .fold(f64::NEG_INFINITY, f64::max)
            };
            let (a, b) = (outermost(side), outermost(-side));
            ((a - b) * 0.5, -(a + b) * 0.5 / tangent)
        };
        let (x, z_across) = place(right, tangent * aspect);
        let (y, z_up) = place(up, tangent);
        let (near, far) = points
            .iter()
            .map(|p| p.dot(forward))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(near, far), q| (near.min(q), far.max(q)));
        // Points without extent are seen from a metre away.
        let z = z_across.min(z_up).min(near - if far > near { 0.0 } else { 1.0 });
        let eye = right * x + up * y + forward * z;
        Self { eye, target: eye + forward * ((near + far) * 0.5 - z), up: DVec3::Y, fov_degrees }
    }

    /// Unit vectors to the right and up in the picture.
    fn axes(&self) -> (DVec3, DVec3) {
        let forward = (self.target - self.eye).normalize_or_zero();
        // An `up` along the view, or none, is replaced by another axis.
        let right = [self.up, DVec3::Y, DVec3::NEG_Z]
            .iter()
            .map(|up| forward.cross(up.normalize_or_zero()))
            .find(|right| right.length_squared() > 1e-12)
            .unwrap_or(DVec3::X)
            .normalize_or_zero();
        (right, right.cross(forward))
    }

    /// Prepares for pictures of a size in pixels.
    pub fn ray_maker(&self, width: u32, height: u32) -> Result<RayMaker, CameraError> {
        if !(self.eye.is_finite() && self.target.is_finite() && self.up.is_finite()) {
            return Err(CameraError::NotFinite);
        }
        if !(self.fov_degrees > 0.0 && self.fov_degrees < 180.0) {
            return Err(CameraError::FieldOfView);
        }
        let forward = (self.target - self.eye).normalize_or_zero();
        if forward == DVec3::ZERO {
            return Err(CameraError::NoDirection);
        }
        let (right, up) = self.axes();
        let tangent = (self.fov_degrees.to_radians() * 0.5).tan();
        let size = [f64::from(width), f64::from(height)];
        let right = right * (tangent * size[0] / size[1]);
        Ok(RayMaker { eye: self.eye, forward, right, up: up * tangent, size })
    }
}

impl RayMaker {
    /// The ray through a point of the picture, in pixels from its upper left corner. Its direction has unit length,
    /// so that distances are in metres.
    pub fn ray(&self, x: f64, y: f64) -> Ray {
        let right = self.right * (2.0 * x / self.size[0] - 1.0);
        let up = self.up * (1.0 - 2.0 * y / self.size[1]);
        Ray::new(self.eye.to_array(), (self.forward + right + up).normalize_or_zero().to_array())
    }

    /// Width of a pixel in the middle of the picture, metres per metre of distance.
    pub fn pixel_spread(&self) -> f64 {
        2.0 * self.up.length() / self.size[1]
    }

    /// From the middle of the picture to its right and its upper edge, at distance 1.
    pub fn half_axes(&self) -> [DVec3; 2] {
        [self.right, self.up]
    }

    /// Unit vector along the middle of the view.
    pub fn forward(&self) -> DVec3 {
        self.forward
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_ray_goes_to_the_target_and_edges_span_the_field_of_view() {
        let camera = Camera {
            eye: DVec3::new(1.0, 2.0, 3.0),
            target: DVec3::new(1.0, 2.0, -7.0),
            up: DVec3::Y,
            fov_degrees: 90.0,
        };
        let rays = camera.ray_maker(200, 100).unwrap();
        let near = |ray: Ray, d: [f64; 3]| (DVec3::from(ray.direction) - DVec3::from(d)).length() < 1e-12;
        assert!(near(rays.ray(100.0, 50.0), [0.0, 0.0, -1.0]));
        let h = 0.5f64.sqrt();
        assert!(near(rays.ray(100.0, 0.0), [0.0, h, -h]), "the upper edge is 45° up");
        assert!(near(rays.ray(150.0, 50.0), [h, 0.0, -h]), "+X is right when looking along -Z");
    }

    #[test]
    fn a_fitted_camera_sees_every_point_and_stands_no_farther_than_it_must() {
        let (min, max) = (DVec3::new(-1.0, 0.0, -20.0), DVec3::new(3.0, 9.0, 2.0));
        let corners: Vec<DVec3> = (0..8)
            .map(|c| DVec3::from([0, 1, 2].map(|i| if c >> i & 1 == 1 { max[i] } else { min[i] })))
            .collect();
        for from in [DVec3::new(0.6, 0.5, 0.7), DVec3::Y, DVec3::X, DVec3::new(-0.2, 0.1, -0.9)] {
            let camera = Camera::fitted(&corners, from.normalize_or_zero(), 40.0, 1.6);
            let rays = camera.ray_maker(160, 100).unwrap();
            let mut largest = [0.0f64; 2];
            for corner in &corners {
                let to = *corner - camera.eye;
                let depth = to.dot(rays.forward);
                assert!(depth > 0.0);
                for (largest, side) in largest.iter_mut().zip([rays.right, rays.up]) {
                    *largest = largest.max((to.dot(side) / side.length_squared() / depth).abs());
                }
            }
            let tightest = largest[0].max(largest[1]);
            assert!((0.91..0.93).contains(&tightest), "{from} {largest:?}");
        }
        let camera = Camera::fitted(&[DVec3::ONE], DVec3::Z, 40.0, 1.0);
        assert_eq!((camera.eye, camera.target), (DVec3::new(1.0, 1.0, 2.0), DVec3::ONE));
    }

    #[test]
    fn cameras_that_cannot_see_are_refused() {
        let camera = Camera::looking(DVec3::ZERO, DVec3::X, 60.0);
        assert!(camera.ray_maker(4, 4).is_ok());
        let blind = Camera { target: DVec3::ZERO, ..camera };
        assert_eq!(blind.ray_maker(4, 4).unwrap_err(), CameraError::NoDirection);
        let blind = Camera { fov_degrees: 180.0, ..camera };
        assert_eq!(blind.ray_maker(4, 4).unwrap_err(), CameraError::FieldOfView);
        let blind = Camera { eye: DVec3::NAN, ..camera };
        assert_eq!(blind.ray_maker(4, 4).unwrap_err(), CameraError::NotFinite);
        let upward = Camera { target: DVec3::Y, ..camera };
        assert!(DVec3::from(upward.ray_maker(4, 4).unwrap().ray(1.0, 1.0).direction).is_normalized());
    }
}
