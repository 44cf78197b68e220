//! What a surface sends back of the light that reaches it.
//!
//! # Theory
//! Lambert: radiance is emitted radiance + albedo / π · (ambient + Σ intensity · cosine / distance²) over the visible
//! lights; `KHR_lights_punctual` says how range and cone weaken a light.
//!
//! # Practice
//! Within [`NEAR_SHARE`] of the scene's radius a light shines as from that distance. The ambient term stands for all
//! light that comes over other surfaces: [`AMBIENT_SHARE`] of the irradiance that all lights give together a scene radius
//! away, or that one of them gives on average at half its range, whichever is larger; without lights, of one lux.

use super::gbuffer::Pixel;
use super::scene::RenderScene;
use glam::Vec3;
use manyview_pipeline::scene::{LightKind, PunctualLight};
use std::f32::consts::FRAC_1_PI;

/// Closest distance at which a light's inverse square is taken, as a share of the scene's radius.
pub const NEAR_SHARE: f64 = 0.004;
/// Share of the typical light of a scene that reaches every surface.
pub const AMBIENT_SHARE: f32 = 0.03;

/// A light, prepared for sums.
#[derive(Debug, Clone, Copy)]
struct Source {
    /// Position, or for a directional light the way to it.
    place: Vec3,
    intensity: Vec3,
    kind: SourceKind,
}

#[derive(Debug, Clone, Copy)]
enum SourceKind {
    Directional,
    Point { range: f32 },
    Spot { range: f32, axis: Vec3, scale: f32, offset: f32 },
}

/// All lights of a picture.
#[derive(Debug, Clone)]
pub struct Lighting {
    sources: Vec<Source>,
    ambient: Vec3,
    near2: f32,
}

impl Lighting {
    /// The light of `lights` in a scene.
    pub fn new(lights: &[PunctualLight], scene: &RenderScene) -> Self {
        let radius = (scene.radius() as f32).max(f32::MIN_POSITIVE);
        let at = |light: &PunctualLight, metres: f32| match light.kind {
            LightKind::Directional => light.intensity,
            LightKind::Point | LightKind::Spot { .. } => light.intensity / (metres * metres),
        };
        let together: Vec3 = lights.iter().map(|light| at(light, radius)).sum();
        let near: Vec3 = lights.iter().map(|light| at(light, radius.min(light.range * 0.5))).sum();
        let typical = match lights.len() {
            0 => Vec3::ONE,
            count => together.max(near / count as f32),
        };
        Self {
            sources: lights.iter().map(source).collect(),
            ambient: typical * AMBIENT_SHARE,
            near2: (scene.radius() * NEAR_SHARE).powi(2) as f32,
        }
    }

    /// The same without the light that stands for all that comes over other surfaces, where that is known.
    pub fn without_ambient(self) -> Self {
        Self { ambient: Vec3::ZERO, ..self }
    }

    /// Irradiance that reaches every surface.
    pub fn ambient(&self) -> Vec3 {
        self.ambient
    }

    /// Irradiance from the lights of which the bits of `hidden` say that a pixel's surface sees them.
    ///
    /// # Panics
    /// If `hidden` has fewer bits than there are lights.
    pub fn direct(&self, pixel: &Pixel, hidden: &[u32]) -> Vec3 {
        assert!(hidden.len() >= self.sources.len().div_ceil(32), "a bit for each light");
        let position = Vec3::from(pixel.position);
        let (normal, face) = (Vec3::from(pixel.normal), Vec3::from(pixel.geometric_normal));
        let mut sum = Vec3::ZERO;
        for (lights, &hidden) in self.sources.chunks(32).zip(hidden) {
            let mut visible = !hidden;
            if lights.len() < 32 {
                visible &= (1 << lights.len()) - 1;
            }
            while visible != 0 {
                let source = &lights[visible.trailing_zeros() as usize];
                visible &= visible - 1;
                sum += source.irradiance(position, normal, face, self.near2);
            }
        }
        sum
    }

    /// Radiance of a pixel's surface towards the viewer under an irradiance from lights.
    pub fn radiance(&self, pixel: &Pixel, direct: Vec3) -> Vec3 {
        Vec3::from(pixel.emissive) + reflected(pixel, self.ambient + direct)
    }
}

/// Radiance that a surface sends back of an irradiance.
pub fn reflected(pixel: &Pixel, irradiance: Vec3) -> Vec3 {
    Vec3::from(pixel.albedo) * FRAC_1_PI * irradiance
}

fn source(light: &PunctualLight) -> Source {
    let (place, kind) = match light.kind {
        LightKind::Directional => (-light.direction, SourceKind::Directional),
        LightKind::Point => (light.position, SourceKind::Point { range: light.range }),
        LightKind::Spot { inner_angle, outer_angle } => {
            let (inner, outer) = (inner_angle.cos(), outer_angle.cos());
            // As the extension's text recommends.
            let scale = 1.0 / (inner - outer).max(0.001);
            let axis = light.direction;
            (light.position, SourceKind::Spot { range: light.range, axis, scale, offset: -outer * scale })
        }
    };
    Source { place, intensity: light.intensity, kind }
}

impl Source {
    fn irradiance(&self, position: Vec3, normal: Vec3, face: Vec3, near2: f32) -> Vec3 {
        let to_light = match self.kind {
            SourceKind::Directional => self.place,
            SourceKind::Point { .. } | SourceKind::Spot { .. } => self.place - position,
        };
        // Both, or light would shine through surfaces whose shading normal leans.
        if !(to_light.dot(normal) > 0.0 && to_light.dot(face) > 0.0) {
            return Vec3::ZERO;
        }
        let distance2 = to_light.length_squared();
        let cosine = to_light.dot(normal) / distance2.sqrt();
        let falloff = match self.kind {
            SourceKind::Directional => 1.0,
            SourceKind::Point { range } => inverse_square(distance2, range, near2),
            SourceKind::Spot { range, axis, scale, offset } => {
                let along = -to_light.dot(axis) / distance2.sqrt();
                let cone = (along * scale + offset).clamp(0.0, 1.0);
                cone * cone * inverse_square(distance2, range, near2)
            }
        };
        self.intensity * (cosine * falloff)
    }
}

/// 1 / distance², faded out towards the range.
fn inverse_square(distance2: f32, range: f32, near2: f32) -> f32 {
    let fade = (1.0 - (distance2 / (range * range)).powi(2)).clamp(0.0, 1.0);
    fade / distance2.max(near2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::lights::point_light;
    use manyview_pipeline::generate::{SceneKind, generate};

    const PIXEL: Pixel = Pixel {
        position: [0.0; 3],
        geometric_normal: [0.0, 1.0, 0.0],
        normal: [0.0, 1.0, 0.0],
        albedo: [0.5, 0.25, 1.0],
        emissive: [0.0; 3],
        depth: 1.0,
        triangle: 0,
    };

    fn lit(lights: &[PunctualLight], hidden: &[u32]) -> Vec3 {
        let scene = RenderScene::new(generate(SceneKind::Town, 1000, 1)).unwrap();
        let lighting = Lighting::new(lights, &scene);
        let direct = lighting.direct(&PIXEL, hidden);
        let expected = reflected(&PIXEL, lighting.ambient()) + reflected(&PIXEL, direct);
        assert!((lighting.radiance(&PIXEL, direct) - expected).abs().max_element() < 1e-5);
        reflected(&PIXEL, direct)
    }

    fn near(found: Vec3, irradiance: f32) {
        let expected = Vec3::from(PIXEL.albedo) * irradiance * FRAC_1_PI;
        assert!((found - expected).abs().max_element() < 1e-4 * irradiance.max(0.1), "{found} {expected}");
    }

    #[test]
    fn a_point_light_gives_cosine_over_distance_squared() {
        let light = point_light(Vec3::new(3.0, 4.0, 0.0), Vec3::splat(100.0));
        near(lit(&[light], &[0]), 100.0 * 0.8 / 25.0);
        near(lit(&[light], &[1]), 0.0);
        near(lit(&[PunctualLight { position: -light.position, ..light }], &[0]), 0.0);
        // Half way to its range a light has lost a sixteenth.
        near(lit(&[PunctualLight { range: 10.0, ..light }], &[0]), 100.0 * 0.8 / 25.0 * 15.0 / 16.0);
        near(lit(&[PunctualLight { range: 4.9, ..light }], &[0]), 0.0);
    }

    #[test]
    fn bits_choose_lights() {
        let lights: Vec<_> = (0..40)
            .map(|i| point_light(Vec3::Y * 5.0, Vec3::splat(if i == 35 { 25.0 } else { 0.0 })))
            .collect();
        near(lit(&lights, &[0, 0]), 1.0);
        near(lit(&lights, &[0, 1 << 3]), 0.0);
        near(lit(&lights, &[u32::MAX, !(1 << 3)]), 1.0);
    }

    #[test]
    fn cones_and_directions() {
        let down = PunctualLight {
            position: Vec3::new(0.0, 2.0, 0.0),
            direction: Vec3::NEG_Y,
            intensity: Vec3::splat(8.0),
            range: f32::INFINITY,
            kind: LightKind::Directional,
        };
        near(lit(&[down], &[0]), 8.0);
        let kind = LightKind::Spot { inner_angle: 0.1, outer_angle: 0.5 };
        near(lit(&[PunctualLight { kind, ..down }], &[0]), 2.0);
        near(lit(&[PunctualLight { kind, direction: Vec3::X, ..down }], &[0]), 0.0);
        // Between the angles: the square of the share of the way between the cosines.
        let direction = Vec3::new(0.3f32.sin(), -0.3f32.cos(), 0.0);
        let share = (0.3f32.cos() - 0.5f32.cos()) / (0.1f32.cos() - 0.5f32.cos());
        near(lit(&[PunctualLight { kind, direction, ..down }], &[0]), 2.0 * share * share);
    }

    #[test]
    fn a_light_on_the_surface_is_no_infinity() {
        let light = point_light(Vec3::Y * 1e-20, Vec3::ONE);
        assert!(lit(&[light], &[0]).is_finite());
        assert_eq!(lit(&[point_light(Vec3::ZERO, Vec3::ONE)], &[0]), Vec3::ZERO);
    }
}
