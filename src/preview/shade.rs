//! Light for previews: a sun with shadow rays, a sky, and short rays that gather ambient and emitted light.
//!
//! This is no reference: it is chosen so that forms and colours read well in any scene, indoors and out. Ambient rays
//! are short, so that closed rooms get light too.

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};
use manyview_shaders::trig::sin_cos;

use super::octree::{Hit, Ray};
use super::scene::{Scene, face_normal};

/// Emitted light is gathered up to this, so that few bright voxels do not make speckles.
const GATHER_LIMIT: f32 = 6.0;

/// A sun and a sky over a scene.
#[derive(Debug, Clone, Copy)]
pub(super) struct Light {
    /// Unit vector towards the sun.
    sun: DVec3,
    sun_color: Vec3,
    /// Length of ambient rays, metres.
    reach: f64,
}

impl Light {
    /// A sun high to the left behind the camera, and ambient light within a part of the scene's extent.
    pub(super) fn new(camera_forward: DVec3, extent: f64) -> Self {
        let back = DVec3::new(-camera_forward.x, 0.0, -camera_forward.z).normalize_or(DVec3::Z);
        let left = DVec3::Y.cross(back) * -1.0;
        let sun = (back * 0.45 + left * 0.6 + DVec3::Y * 1.05).normalize_or(DVec3::Y);
        Self { sun, sun_color: Vec3::new(2.3, 2.1, 1.8), reach: extent * 0.06 }
    }

    /// What is seen where there is nothing, as it shall look once exposed.
    pub(super) fn sky(&self, direction: DVec3) -> Vec3 {
        let ground = Vec3::new(0.40, 0.43, 0.46);
        let horizon = Vec3::new(0.62, 0.74, 0.85);
        let zenith = Vec3::new(0.16, 0.34, 0.70);
        let height = direction.y as f32;
        // Wide blends: a sharp horizon would look like a part of the scene.
        let above = ((height + 0.45) / 0.6).clamp(0.0, 1.0);
        let haze = ground.lerp(horizon, above * above * (3.0 - 2.0 * above));
        haze.lerp(zenith, (height - 0.02).clamp(0.0, 1.0).sqrt())
    }

    /// Light that arrives at a hit, for a white surface. `random` are four numbers in 0 … 1.
    pub(super) fn arriving(
        &self,
        scene: &Scene,
        ray: &Ray,
        hit: &Hit,
        normal: DVec3,
        random: [f64; 4],
    ) -> Vec3 {
        let voxel = scene.octree().voxel();
        let cell = voxel * f64::from(1u32 << (scene.octree().depth() - hit.level));
        // Out of the cell that was hit and its neighbours in the same surface.
        let face = face_normal(ray, hit);
        let start = DVec3::from(ray.at(hit.t)) + (normal + face * 0.5) * (1.25 * cell);
        let mut light = Vec3::ZERO;
        let cosine = normal.dot(self.sun);
        if cosine > 0.0 {
            let (a, b) = tangents(self.sun);
            let (sine, cos) = sin_cos(random[0] * TAU);
            let radius = 0.012 * random[1].sqrt();
            let towards = self.sun + (a * cos + b * sine) * radius;
            let shadow = Ray { spread: 0.0, ..Ray::new(start.to_array(), towards.to_array()) };
            if !scene.octree().is_occluded(&shadow) {
                light += self.sun_color * cosine as f32;
            }
        }
        // Cosine-weighted: the mean of what such rays see is what a white surface gets.
        let (a, b) = tangents(normal);
        let (sine, cos) = sin_cos(random[2] * TAU);
        let radius = random[3].sqrt();
        let towards = (a * cos + b * sine) * radius + normal * (1.0 - random[3]).max(0.0).sqrt();
        let gather = Ray {
            t_max: self.reach,
            // Ambient light is soft: cells that look small from here may count as full.
            spread: 0.03,
            ..Ray::new(start.to_array(), towards.to_array())
        };
        light
            + match scene.octree().intersect(&gather, hit.level) {
                None => self.ambient(towards),
                // In a crease the ray may begin inside a neighbour, which tells nothing of what is around.
                Some(found) if found.face.is_none() => self.ambient(towards) * 0.6,
                Some(found) => {
                    let emitted = Vec3::from(scene.emitted(&found)).min(Vec3::splat(GATHER_LIMIT));
                    let near = (found.t / self.reach) as f32;
                    emitted
                        + Vec3::from(scene.base_color(&found)) * self.ambient(towards) * (0.15 + 0.45 * near)
                }
            }
    }

    fn ambient(&self, direction: DVec3) -> Vec3 {
        let below = Vec3::new(0.34, 0.32, 0.30);
        below.lerp(Vec3::new(0.62, 0.72, 0.90), (direction.y * 0.5 + 0.5) as f32)
    }
}

/// Two unit vectors that are perpendicular to a unit vector and each other.
fn tangents(normal: DVec3) -> (DVec3, DVec3) {
    let helper = if normal.x.abs() < 0.6 { DVec3::X } else { DVec3::Y };
    let a = normal.cross(helper).normalize_or(DVec3::Z);
    (a, normal.cross(a))
}

/// The numbers of a sample: a low-discrepancy sequence over samples, shifted for every pixel.
pub(super) fn random_numbers(pixel: u32, sample: u32) -> [f64; 6] {
    // Reciprocal powers of the generalized golden ratio in six dimensions (Roberts 2018).
    const STEPS: [f64; 6] = [
        0.898_653_712_638_928_8,
        0.807_578_494_957_087_5,
        0.725_733_414_108_879_7,
        0.652_183_024_936_823_4,
        0.586_086_697_500_474_4,
        0.526_688_989_116_476_1,
    ];
    let mut state = pixel;
    STEPS.map(|step| {
        // PCG (Jarzynski and Olano 2020).
        state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
        let shift = f64::from((word >> 22) ^ word) / 4_294_967_296.0;
        (shift + f64::from(sample) * step).fract()
    })
}
