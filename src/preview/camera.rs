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

    /// A camera that sees a whole box from the direction `from` (unit length, pointing from the box to the camera),
    /// at an aspect ratio (width / height), with a margin of a part in 50.
    pub fn fitted(min: DVec3, max: DVec3, from: DVec3, fov_degrees: f64, aspect: f64) -> Self {
        let center = (min + max) * 0.5;
        let camera = Self::looking(center + from, -from, fov_degrees);
        let (right, up) = camera.axes();
        let tangent = (fov_degrees.to_radians() * 0.5).tan();
        let distance = (0..8).map(|corner| {
            let corner =
                DVec3::from([0, 1, 2].map(|i| if corner >> i & 1 == 1 { max[i] } else { min[i] })) - center;
            // The corner is seen if the camera stands this far from the centre.
            let sideways = corner.dot(right).abs() / aspect;
            sideways.max(corner.dot(up).abs()) / tangent * 1.02 + corner.dot(from)
        });
        let distance = distance.fold(0.0, f64::max);
        // A box without extent is seen from a metre away.
        let distance = if distance > 0.0 { distance } else { 1.0 };
        Self { eye: center + from * distance, target: center, up: DVec3::Y, fov_degrees }
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
    fn a_fitted_camera_sees_every_corner() {
        let (min, max) = (DVec3::new(-1.0, 0.0, -20.0), DVec3::new(3.0, 9.0, 2.0));
        for from in [DVec3::new(0.6, 0.5, 0.7), DVec3::Y, DVec3::X, DVec3::new(-0.2, 0.1, -0.9)] {
            let from = from.normalize_or_zero();
            let camera = Camera::fitted(min, max, from, 40.0, 1.6);
            let rays = camera.ray_maker(160, 100).unwrap();
            for corner in 0..8 {
                let corner =
                    DVec3::from([0, 1, 2].map(|i| if corner >> i & 1 == 1 { max[i] } else { min[i] }));
                let to = corner - camera.eye;
                let depth = to.dot(rays.forward);
                assert!(depth > 0.0);
                let x = to.dot(rays.right) / rays.right.length_squared() / depth;
                let y = to.dot(rays.up) / rays.up.length_squared() / depth;
                assert!(x.abs() <= 1.0 && y.abs() <= 1.0, "{from} {x} {y}");
            }
        }
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
