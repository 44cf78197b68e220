//! Paths from lights, and the virtual lights that they leave.
//!
//! # Practice
//! A path begins at a light chosen by its flux and goes on from surface to surface, spread by the cosine; what it carries
//! is multiplied by the surface's colour at each. At every hit it leaves a virtual light that stands for all that this
//! surface sends on. A path that leaves the scene ends there; more paths are taken until there are as many lights as
//! asked for. Each path's share is one over the number of all paths, the lost ones included, so that no light is gained:
//! a scene that lets much light escape gets darker lights, not fewer.
//!
//! What glows, in scenes without lights, cannot be tested light by light: a quarter of the virtual lights then stand for
//! the glowing surfaces themselves.

use super::VirtualLight;
use super::emission::{Primaries, cosine_weighted};
use crate::bench::Random;
use crate::exact::ExactRays;
use crate::render::gbuffer::Looks;
use crate::render::scene::RenderScene;
use glam::Vec3;
use rayon::prelude::*;
use std::f32::consts::PI;

/// The most bounces of a path.
pub const MAX_BOUNCES: u32 = 16;
/// Textures are looked up as seen by pixels this wide, metres per metre of the path: their finest detail is noise.
const SPREAD: f64 = 0.01;
/// The most paths for each light that is wanted, where most escape.
const MOST_PATHS: u64 = 64;

/// Which virtual lights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VplOptions {
    /// How many; a few less if paths have several bounces, and all that there are if almost no path hits anything.
    pub count: usize,
    /// Surfaces that a path touches: 1 leaves a light at its first hit alone.
    pub bounces: u32,
    /// Another seed gives other paths.
    pub seed: u64,
    /// Leave out what stands for glowing surfaces themselves.
    pub indirect_only: bool,
}

/// Virtual lights and how they came about.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct VirtualLights {
    /// All of them.
    pub lights: Vec<VirtualLight>,
    /// Paths that began.
    pub paths: u64,
    /// The first so many stand for glowing surfaces.
    pub glowing: usize,
}

/// Sends out paths.
pub fn trace(
    scene: &RenderScene,
    exact: &ExactRays<'_>,
    primaries: &Primaries<'_>,
    options: &VplOptions,
) -> VirtualLights {
    let mut found = VirtualLights::default();
    if primaries.are_dark() {
        return found;
    }
    let tracer = Tracer {
        exact,
        primaries,
        looks: Looks::new(scene, exact.reference(), SPREAD),
        seed: options.seed,
        bounces: options.bounces.clamp(1, MAX_BOUNCES),
        // Far enough for the position's rounding.
        lift_metres: 2.0 * exact.lift_metres(),
    };
    if primaries.are_surfaces() && !options.indirect_only {
        found.glowing = (options.count / 4).max(1).min(options.count);
        let of = |index| {
            let seed = options.seed ^ 0x676c_6f77;
            let light = primaries.surface_light(index, seed, &tracer.looks, tracer.lift_metres);
            scaled(light, 1.0 / found.glowing as f32)
        };
        found.lights = (0..found.glowing as u64).into_par_iter().map(of).collect();
        found.lights.retain(|light| light.intensity != [0.0; 3]);
        found.glowing = found.lights.len();
    }
    let wanted = options.count - found.glowing;
    let most = (wanted as u64).saturating_mul(MOST_PATHS).max(4096);
    let mut lights: Vec<VirtualLight> = Vec::new();
    'all: while lights.len() < wanted && found.paths < most {
        let missing = (wanted - lights.len()) as u64;
        // As many as fill the rest if the next ones do as those before.
        let each = match found.paths {
            0 => f64::from(tracer.bounces),
            paths => lights.len().max(1) as f64 / paths as f64,
        };
        let round = ((missing as f64 / each) as u64 + 1).clamp(1, most - found.paths).min(1 << 20);
        let paths: Vec<Vec<VirtualLight>> =
            (found.paths..found.paths + round).into_par_iter().map(|index| tracer.path(index)).collect();
        for path in paths {
            if lights.len() + path.len() > wanted && found.paths > 0 {
                break 'all;
            }
            found.paths += 1;
            lights.extend(path);
            if lights.len() >= wanted {
                break 'all;
            }
        }
    }
    // A first path longer than wanted.
    lights.truncate(wanted);
    let share = 1.0 / found.paths.max(1) as f32;
    found.lights.extend(lights.into_iter().map(|light| scaled(light, share)));
    found
}

fn scaled(light: VirtualLight, factor: f32) -> VirtualLight {
    VirtualLight { intensity: light.intensity.map(|c| c * factor), ..light }
}

struct Tracer<'a> {
    exact: &'a ExactRays<'a>,
    primaries: &'a Primaries<'a>,
    looks: Looks<'a>,
    seed: u64,
    bounces: u32,
    lift_metres: f64,
}

impl Tracer<'_> {
    /// The lights of a path whose flux is that of all lights together.
    fn path(&self, index: u64) -> Vec<VirtualLight> {
        let mut random = Random::new(Random::new(self.seed ^ index.rotate_left(32)).bits());
        let emission = self.primaries.emission(index, self.seed, &self.looks, self.lift_metres);
        let (mut origin, mut direction, mut flux) = (emission.origin, emission.direction, emission.flux);
        let mut lights = Vec::new();
        for bounce in 0..self.bounces {
            let Some(hit) = self.exact.reference().intersect(origin, direction, f64::INFINITY) else { break };
            if bounce == 0 && emission.range < f64::INFINITY {
                flux *= (1.0 - (hit.t / emission.range).powi(4)).clamp(0.0, 1.0) as f32;
            }
            let surface = self.looks.pixel(&hit, origin, direction);
            flux *= Vec3::from(surface.albedo);
            // Nothing is sent on from here.
            if !(flux.max_element() > 0.0 && flux.is_finite()) {
                break;
            }
            let normal = Vec3::from(surface.geometric_normal).as_dvec3();
            origin = origin + direction * hit.t + normal * self.lift_metres;
            lights.push(VirtualLight {
                position: origin.as_vec3().to_array(),
                normal: surface.geometric_normal,
                intensity: (flux / PI).to_array(),
            });
            direction = cosine_weighted(normal, [random.unit(), random.unit()]);
        }
        lights
    }
}

impl VirtualLights {
    /// Flux of all lights together, lumens.
    pub fn flux(&self) -> Vec3 {
        self.lights.iter().map(VirtualLight::flux).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::lights::point_light;
    use glam::DMat4;
    use manyview_pipeline::scene::{Instance, LightKind, Material, Mesh, PunctualLight, Scene};

    /// A cube from −half to half without its sides of which `open` has bits (−x, +x, −y, +y, −z, +z).
    fn cube(half: f32, open: u32, material: Material) -> RenderScene {
        let corner = |c: u32| Vec3::from([0, 1, 2].map(|i| if c >> i & 1 == 1 { half } else { -half }));
        let mut mesh = Mesh { positions: (0..8).map(corner).collect(), ..Mesh::default() };
        let sides = [[0, 2, 6, 4], [1, 3, 7, 5], [0, 1, 5, 4], [2, 3, 7, 6], [0, 1, 3, 2], [4, 5, 7, 6]];
        for (_, [a, b, c, d]) in sides.into_iter().enumerate().filter(|(i, _)| open >> i & 1 == 0) {
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
        RenderScene::new(Scene {
            meshes: vec![mesh],
            instances: vec![Instance { mesh: 0, world_from_object: DMat4::IDENTITY }],
            materials: vec![material],
            ..Scene::default()
        })
        .unwrap()
    }

    fn grey(albedo: f32) -> Material {
        Material { base_color: Vec3::splat(albedo).extend(1.0), ..Material::default() }
    }

    fn traced(
        scene: &RenderScene,
        lights: &[PunctualLight],
        count: usize,
        bounces: u32,
        seed: u64,
    ) -> VirtualLights {
        let exact = ExactRays::new(scene.reference());
        let primaries = Primaries::new(scene, exact.reference(), lights);
        trace(scene, &exact, &primaries, &VplOptions { count, bounces, seed, indirect_only: false })
    }

    #[test]
    fn a_closed_room_keeps_its_light() {
        let scene = cube(2.0, 0, grey(0.5));
        let light = point_light(Vec3::new(0.3, 0.5, -0.2), Vec3::new(3.0, 2.0, 1.0));
        let flux = light.intensity * 4.0 * PI;
        for (bounces, sum) in [(1, 0.5), (2, 0.75), (4, 0.9375)] {
            let found = traced(&scene, &[light], 1000, bounces, 1);
            assert_eq!((found.lights.len(), found.paths), (1000, 1000 / u64::from(bounces)));
            assert!((found.flux() / flux - sum).abs().max_element() < 1e-4, "{bounces}: {}", found.flux());
            for light in &found.lights {
                let at = Vec3::from(light.position).abs().max_element();
                assert!((at - 2.0).abs() < 1e-3 && Vec3::from(light.position).dot(light.normal.into()) < 0.0);
            }
        }
    }

    #[test]
    fn what_escapes_is_lost() {
        // Of the light in the middle of a cube, a sixth leaves by each side.
        let scene = cube(1.0, 0b00_1000, grey(0.8));
        let light = point_light(Vec3::ZERO, Vec3::ONE);
        let found = traced(&scene, &[light], 6000, 1, 7);
        assert_eq!(found.lights.len(), 6000);
        let expected = 0.8 * 5.0 / 6.0 * 4.0 * PI;
        assert!((found.flux().x / expected - 1.0).abs() < 0.01, "{} {expected}", found.flux());
        // Light that comes back from a wall escapes too: fewer lights follow than lead.
        let twice = traced(&scene, &[light], 6000, 2, 7);
        assert!((5998..=6000).contains(&twice.lights.len()) && twice.paths > 3000);
    }

    #[test]
    fn suns_spots_and_several_lights_send_what_they_should() {
        let scene = cube(1.0, 0b00_1000, grey(1.0));
        let sun = PunctualLight {
            position: Vec3::ZERO,
            direction: Vec3::NEG_Y,
            intensity: Vec3::splat(5.0),
            range: f32::INFINITY,
            kind: LightKind::Directional,
        };
        // The floor is four square metres.
        assert!((traced(&scene, &[sun], 500, 1, 1).flux().x / 20.0 - 1.0).abs() < 1e-3);
        let kind = LightKind::Spot { inner_angle: 0.0, outer_angle: std::f32::consts::FRAC_PI_2 };
        let spot = PunctualLight { kind, ..sun };
        // ∫ (cos)² over a hemisphere.
        let expected = 5.0 * 2.0 * PI / 3.0;
        assert!((traced(&scene, &[spot], 4000, 1, 1).flux().x / expected - 1.0).abs() < 0.01);
        let point = point_light(Vec3::new(0.0, -0.999, 0.0), Vec3::splat(2.0));
        let both = traced(&scene, &[sun, spot, point], 20_000, 1, 1).flux().x;
        // Half of the point's light and a little more goes to the floor, the rest up and mostly out.
        assert!(both > 20.0 + expected + 4.0 * PI && both < 20.0 + expected + 8.0 * PI, "{both}");
        // Light that ends before the walls.
        let near = PunctualLight { range: 0.9, ..point_light(Vec3::ZERO, Vec3::ONE) };
        assert!(traced(&scene, &[near], 100, 1, 1).lights.is_empty());
    }

    #[test]
    fn what_glows_is_a_light() {
        // The outer sides glow or the inner ones: winding is not the same all over, so both do.
        let material = Material { emissive: Vec3::splat(2.0), double_sided: true, ..grey(0.5) };
        let scene = cube(1.0, 0, material);
        let found = traced(&scene, &[], 1000, 1, 1);
        let flux = 2.0 * 2.0 * 24.0 * PI;
        let glow: Vec3 = found.lights[..found.glowing].iter().map(VirtualLight::flux).sum();
        assert_eq!(found.glowing, 250);
        assert!((glow.x / flux - 1.0).abs() < 1e-3, "{glow} {flux}");
        // What shines inwards is seen again, what shines outwards is gone.
        let sent_on = (found.flux() - glow).x;
        assert!((sent_on / (0.5 * 0.5 * flux) - 1.0).abs() < 0.05, "{sent_on}");
    }

    #[test]
    fn odd_numbers_of_lights_and_dark_scenes() {
        let scene = cube(1.0, 0, grey(0.5));
        let light = point_light(Vec3::ZERO, Vec3::ONE);
        let one = traced(&scene, &[light], 1, 4, 1);
        assert_eq!((one.lights.len(), one.paths), (1, 1));
        assert_eq!(traced(&scene, &[light], 7, 4, 1).lights.len(), 4, "two paths would leave eight");
        assert!(traced(&scene, &[], 9, 1, 1).lights.is_empty(), "no light");
        let dark = PunctualLight { intensity: Vec3::ZERO, ..light };
        assert!(traced(&scene, &[dark], 9, 1, 1).lights.is_empty());
        assert!(traced(&cube(1.0, 0, grey(0.0)), &[light], 9, 1, 1).lights.is_empty(), "black walls");
        let away = point_light(Vec3::splat(1e9), Vec3::ONE);
        let few = traced(&scene, &[away], 9, 1, 1);
        assert!(few.lights.len() <= 9 && few.paths <= 4096);
    }

    #[test]
    fn seeds_and_threads() {
        let scene = cube(1.0, 0b10, grey(0.5));
        let light = point_light(Vec3::new(0.1, 0.2, 0.3), Vec3::ONE);
        let of = |seed| traced(&scene, &[light], 3000, 3, seed);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert_eq!(pool.install(|| of(4)), of(4));
        assert_ne!(of(4), of(5));
    }
}
