//! Where paths begin: at the scene's lights.

use super::VirtualLight;
use crate::bench::Random;
use crate::preview::luminance;
use crate::reference::{Hit, Reference, area_normal};
use crate::render::gbuffer::Looks;
use crate::render::scene::RenderScene;
use glam::{DVec3, Vec3};
use manyview_pipeline::scene::{LightKind, Material, PunctualLight};
use manyview_shaders::trig::sin_cos;
use std::f64::consts::{PI, TAU};

/// A path's beginning.
#[derive(Debug, Clone, Copy)]
pub(super) struct Emission {
    pub(super) origin: DVec3,
    /// Unit length.
    pub(super) direction: DVec3,
    /// Flux of all lights as this path stands for it, lumens: the mean over many paths is the whole.
    pub(super) flux: Vec3,
    /// Metres beyond which the light does not reach.
    pub(super) range: f64,
}

/// The lights that paths begin at: lights at points and suns, or where there are none what glows.
pub struct Primaries<'a> {
    lights: Vec<PunctualLight>,
    glowing: Vec<Glowing>,
    /// Sums of what lights, or fronts and backs of triangles, are chosen by: an estimate of their flux.
    sums: Vec<f64>,
    bounds: [DVec3; 2],
    reference: &'a Reference<'a>,
}

/// A triangle that glows.
#[derive(Debug, Clone, Copy)]
struct Glowing {
    triangle: u32,
    /// Unit normal of its front.
    front: DVec3,
}

impl<'a> Primaries<'a> {
    /// These lights; without any, the scene's glowing triangles, each by its area.
    pub fn new(scene: &RenderScene, reference: &'a Reference<'a>, lights: &[PunctualLight]) -> Self {
        let mut primaries = Self {
            lights: lights.to_vec(),
            glowing: Vec::new(),
            sums: Vec::new(),
            bounds: scene.bounds,
            reference,
        };
        let mut sum = 0.0;
        for light in lights {
            sum += primaries.solid_angle(light) * f64::from(luminance(light.intensity).max(0.0));
            primaries.sums.push(sum);
        }
        if !lights.is_empty() {
            return primaries;
        }
        let default = Material::default();
        for (index, triangle) in reference.triangles().iter().enumerate() {
            let source = reference.sources()[index];
            let instance = &scene.scene.instances[source.instance as usize];
            let mesh = &scene.scene.meshes[instance.mesh as usize];
            let material = scene.scene.materials.get(mesh.material as usize).unwrap_or(&default);
            let glow = f64::from(luminance(material.emissive));
            if glow > 0.0 {
                let normal = area_normal(triangle);
                let mirrored = instance.world_from_object.determinant() < 0.0;
                let front = if mirrored { -normal } else { normal }.normalize_or_zero();
                primaries.glowing.push(Glowing { triangle: index as u32, front });
                // Front and back.
                for share in [0.5, if material.double_sided { 0.5 } else { 0.0 }] {
                    sum += glow * PI * normal.length() * share;
                    primaries.sums.push(sum);
                }
            }
        }
        primaries
    }

    /// Whether surfaces glow in place of lights.
    pub fn are_surfaces(&self) -> bool {
        !self.glowing.is_empty()
    }

    /// Whether nothing shines.
    pub fn are_dark(&self) -> bool {
        self.sums.last().is_none_or(|&sum| !(sum > 0.0 && sum.is_finite()))
    }

    /// Solid angle of a light whose intensity were the same all over, steradians; of a sun the area that its light
    /// passes through, square metres.
    fn solid_angle(&self, light: &PunctualLight) -> f64 {
        match light.kind {
            LightKind::Point => 4.0 * PI,
            LightKind::Spot { inner_angle, outer_angle } => {
                let cosine = |angle: f32| sin_cos(f64::from(angle)).1;
                // Of the square of a share that falls evenly with the cosine, the mean is a third.
                let (inner, outer) = (cosine(inner_angle), cosine(outer_angle));
                TAU * ((1.0 - inner) + (inner - outer) / 3.0)
            }
            LightKind::Directional => {
                let window = Window::new(light.direction, self.bounds);
                window.sides[0].length() * window.sides[1].length()
            }
        }
    }

    /// Path number `index`. Which light, and where to, are well spread over successive paths.
    pub(super) fn emission(&self, index: u64, seed: u64, looks: &Looks<'_>, lift_metres: f64) -> Emission {
        let [choice, u, v, b1, b2] = spread(index, seed);
        let (chosen, probability) = self.choose(choice);
        if let Some(light) = self.lights.get(chosen) {
            return self.of_light(light, probability, [u, v]);
        }
        let (position, normal, flux) = self.of_surface(chosen, probability, [b1, b2], looks);
        let origin = position + normal * lift_metres;
        Emission { origin, direction: cosine_weighted(normal, [u, v]), flux, range: f64::INFINITY }
    }

    /// One of many lights that stand for the glowing surfaces themselves; the mean of their fluxes is that of the surfaces.
    pub(super) fn surface_light(
        &self,
        index: u64,
        seed: u64,
        looks: &Looks<'_>,
        lift_metres: f64,
    ) -> VirtualLight {
        let [choice, _, _, b1, b2] = spread(index, seed);
        let (chosen, probability) = self.choose(choice);
        let (position, normal, flux) = self.of_surface(chosen, probability, [b1, b2], looks);
        VirtualLight {
            position: (position + normal * lift_metres).as_vec3().to_array(),
            normal: normal.as_vec3().to_array(),
            intensity: (flux / std::f32::consts::PI).to_array(),
        }
    }

    fn choose(&self, share: f64) -> (usize, f64) {
        let all = self.sums.last().copied().unwrap_or(1.0);
        let at = share * all;
        let chosen = self.sums.partition_point(|&sum| sum <= at).min(self.sums.len().saturating_sub(1));
        let before = if chosen == 0 { 0.0 } else { self.sums[chosen - 1] };
        (chosen, (self.sums[chosen] - before) / all)
    }

    fn of_light(&self, light: &PunctualLight, probability: f64, [u, v]: [f64; 2]) -> Emission {
        let (sine, cosine) = sin_cos(v * TAU);
        let around = |axis: DVec3, along: f64| {
            let (x, y) = axis.any_orthonormal_pair();
            let across = (1.0 - along * along).max(0.0).sqrt();
            axis * along + (x * cosine + y * sine) * across
        };
        let origin = light.position.as_dvec3();
        let range = f64::from(light.range);
        let emission = |direction: DVec3, scale: f64| Emission {
            origin,
            direction,
            flux: light.intensity * (scale / probability) as f32,
            range,
        };
        match light.kind {
            LightKind::Point => emission(around(DVec3::X, 1.0 - 2.0 * u), 4.0 * PI),
            LightKind::Spot { inner_angle, outer_angle } => {
                let outer = sin_cos(f64::from(outer_angle)).1;
                let inner = sin_cos(f64::from(inner_angle)).1;
                let along = 1.0 - u * (1.0 - outer);
                let share = ((along - outer) / (inner - outer).max(0.001)).clamp(0.0, 1.0);
                let axis = light.direction.as_dvec3().normalize_or(DVec3::NEG_Y);
                emission(around(axis, along), share * share * TAU * (1.0 - outer))
            }
            LightKind::Directional => {
                let window = Window::new(light.direction, self.bounds);
                let area = window.sides[0].length() * window.sides[1].length();
                let origin = window.corner + window.sides[0] * u + window.sides[1] * v;
                let flux = light.intensity * (area / probability) as f32;
                Emission { origin, direction: window.direction, flux, range: f64::INFINITY }
            }
        }
    }

    /// Point, unit normal of the glowing side, and flux of the whole.
    fn of_surface(
        &self,
        chosen: usize,
        probability: f64,
        [mut b1, mut b2]: [f64; 2],
        looks: &Looks<'_>,
    ) -> (DVec3, DVec3, Vec3) {
        let glowing = self.glowing[chosen / 2];
        let normal = if chosen.is_multiple_of(2) { glowing.front } else { -glowing.front };
        if b1 + b2 > 1.0 {
            (b1, b2) = (1.0 - b1, 1.0 - b2);
        }
        let corners = &self.reference.triangles()[glowing.triangle as usize];
        let [a, b, c] = *corners;
        let position = a + (b - a) * b1 + (c - a) * b2;
        let hit = Hit { t: 0.0, triangle: glowing.triangle, barycentric: [b1, b2] };
        let emissive = match self.reference.exists(glowing.triangle, [b1, b2]) {
            true => Vec3::from(looks.pixel(&hit, position, -normal).emissive),
            false => Vec3::ZERO,
        };
        (position, normal, emissive * (PI * area_normal(corners).length() * 0.5 / probability) as f32)
    }
}

/// What of a plane before the scene a sun shines through onto the scene's bounds: a rectangle.
struct Window {
    direction: DVec3,
    corner: DVec3,
    sides: [DVec3; 2],
}

impl Window {
    fn new(direction: Vec3, [min, max]: [DVec3; 2]) -> Self {
        let direction = direction.as_dvec3().normalize_or(DVec3::NEG_Y);
        let (x, y) = direction.any_orthonormal_pair();
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for corner in 0..8 {
            let c = DVec3::from([0, 1, 2].map(|i| if corner >> i & 1 == 1 { max[i] } else { min[i] }));
            let at = DVec3::new(c.dot(x), c.dot(y), c.dot(direction));
            (low, high) = (low.min(at), high.max(at));
        }
        let before = low.z - (max - min).length() * 0.01;
        let corner = x * low.x + y * low.y + direction * before;
        Self { direction, corner, sides: [x * (high.x - low.x), y * (high.y - low.y)] }
    }
}

/// A direction about a unit normal, as likely as its cosine is large.
pub(super) fn cosine_weighted(normal: DVec3, [u, v]: [f64; 2]) -> DVec3 {
    let (x, y) = normal.any_orthonormal_pair();
    let (sine, cosine) = sin_cos(v * TAU);
    let radius = u.sqrt();
    (x * cosine + y * sine) * radius + normal * (1.0 - u).max(0.0).sqrt()
}

/// Five numbers in 0 … 1: a choice, and two pairs that are each well spread over successive indices. Kronecker sequences of
/// the golden ratio and of its generalizations (M. Roberts, *The Unreasonable Effectiveness of Quasirandom Sequences*,
/// 2018), shifted by the seed; the last pair is random, since five such sequences are not spread well two by two.
fn spread(index: u64, seed: u64) -> [f64; 5] {
    const TWO_TO_64: f64 = 18_446_744_073_709_551_616.0;
    const STEPS: [f64; 3] = [0.618_033_988_749_894_9, 0.754_877_666_246_692_8, 0.569_840_290_998_053_3];
    let mut shift = Random::new(seed);
    let [choice, u, v] = STEPS.map(|step| {
        let at = shift.bits().wrapping_add(((step * TWO_TO_64) as u64).wrapping_mul(index));
        (at >> 11) as f64 / (1u64 << 53) as f64
    });
    let mut random = Random::new(Random::new(seed.rotate_left(17) ^ index).bits());
    [choice, u, v, random.unit(), random.unit()]
}
