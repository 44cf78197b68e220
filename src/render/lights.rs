//! Where light comes from: the scene's own lights, a file, or generated ones.
//!
//! # Practice
//! Generated lights share a total intensity of [`INTENSITY_PER_SQUARE_RADIUS`] candela per square metre of the scene's
//! squared radius, whatever their number: a surface a radius away from all of them gets that many lux.

pub use super::lights_file::LightsFileError;
use super::lights_file::read_lights;
use super::scene::RenderScene;
use crate::bench::Random;
use crate::radiosity::MAX_BOUNCES;
use crate::reference::{Reference, area_normal};
use crate::visibility::LightPoint;
use glam::{DVec3, Vec3};
use manyview_pipeline::scene::{LightKind, PunctualLight};
use manyview_shaders::trig::sin_cos;
use std::f64::consts::TAU;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::str::FromStr;

/// The most lights of a picture that every pixel is lit by; of more it takes a choice ([`crate::radiosity`]).
pub const MAX_LIGHTS: usize = 100_000;
/// Beyond so many point lights every pixel takes a choice if it may: a picture of a million pixels would test 10¹⁰ segments.
pub const CHOICE_LIGHTS: usize = 10_000;
/// The most lights of a picture at all.
pub const MAX_GATHERED_LIGHTS: usize = crate::radiosity::MAX_VIRTUAL_LIGHTS;
/// Generated when a scene has no lights and none are asked for.
pub const DEFAULT_LIGHTS: LightSource = LightSource::Random { count: 256, seed: 1 };
/// Sum of the intensities of generated lights, candela per square metre of the scene's squared radius.
pub const INTENSITY_PER_SQUARE_RADIUS: f64 = 4.0;

/// Tries for the place of a fountain.
const FOUNTAIN_TRIES: usize = 6;
/// Height of a fountain as a share of the scene's largest extent, where nothing is above.
const FOUNTAIN_HEIGHT: f64 = 0.12;

/// What lights a scene.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LightSource {
    /// The scene's own lights (`KHR_lights_punctual`).
    Scene,
    /// A JSON, TOML, CSV or NumPy file.
    File(PathBuf),
    /// Point lights, uniform in the scene's bounds.
    Random {
        /// How many.
        count: usize,
        /// Another seed gives other lights.
        seed: u64,
    },
    /// Glowing particles of fountains that stand on the scene's floors.
    Particles {
        /// How many.
        count: usize,
        /// Another seed gives other lights.
        seed: u64,
    },
    /// The scene's own lights, and virtual ones for what surfaces send on of their light.
    Virtual {
        /// How many virtual ones.
        count: usize,
        /// Surfaces that light goes on from.
        bounces: u32,
        /// Another seed gives other virtual lights.
        seed: u64,
    },
}

impl FromStr for LightSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let Some((kind, rest)) = text.split_once(':') else {
            return match text {
                "" => Err("name a file, `scene`, random:N, particles:N or vpl:N".to_owned()),
                "scene" => Ok(Self::Scene),
                "random" | "particles" | "vpl" => Err(format!("say how many: {text}:1024")),
                file => Ok(Self::File(file.into())),
            };
        };
        if kind == "vpl" {
            return Self::virtual_lights(rest);
        }
        if kind != "random" && kind != "particles" {
            return Ok(Self::File(text.into()));
        }
        let (count, seed) = rest.split_once(':').unwrap_or((rest, "1"));
        let count = count.parse().ok().filter(|count| (1..=MAX_GATHERED_LIGHTS).contains(count));
        let (Some(count), Ok(seed)) = (count, seed.parse()) else {
            return Err(format!(
                "write {kind}:N or {kind}:N:SEED, as in {kind}:1024:7, of 1 to {MAX_GATHERED_LIGHTS} lights"
            ));
        };
        Ok(match kind {
            "random" => Self::Random { count, seed },
            _ => Self::Particles { count, seed },
        })
    }
}

impl LightSource {
    fn virtual_lights(text: &str) -> Result<Self, String> {
        let mut parts = text.split(':');
        let mut number = |default: Option<u64>, range: RangeInclusive<u64>| match parts.next() {
            Some(part) => part.parse().ok().filter(|number| range.contains(number)),
            None => default,
        };
        let count = number(None, 1..=MAX_GATHERED_LIGHTS as u64);
        let bounces = number(Some(1), 1..=u64::from(MAX_BOUNCES));
        let seed = number(Some(1), 0..=u64::MAX);
        match (count, bounces, seed, parts.next()) {
            (Some(count), Some(bounces), Some(seed), None) => {
                Ok(Self::Virtual { count: count as usize, bounces: bounces as u32, seed })
            }
            _ => Err(format!(
                "write vpl:N, vpl:N:BOUNCES or vpl:N:BOUNCES:SEED, as in vpl:65536:4, of 1 to {MAX_GATHERED_LIGHTS} lights \
                 and 1 to {MAX_BOUNCES} bounces"
            )),
        }
    }

    /// The lights, in a fixed order; of virtual ones those that they come from.
    pub fn lights(
        &self,
        scene: &RenderScene,
        reference: &Reference<'_>,
    ) -> Result<Vec<PunctualLight>, LightsFileError> {
        match self {
            Self::Scene | Self::Virtual { .. } => Ok(scene.scene.lights.clone()),
            Self::File(path) => read_lights(path),
            Self::Random { count, seed } => Ok(random(scene, *count, *seed)),
            Self::Particles { count, seed } => Ok(particles(scene, reference, *count, *seed)),
        }
    }
}

/// A light that shines everywhere from a point.
pub fn point_light(position: Vec3, intensity: Vec3) -> PunctualLight {
    PunctualLight {
        position,
        direction: Vec3::NEG_Y,
        intensity,
        range: f32::INFINITY,
        kind: LightKind::Point,
    }
}

/// Where segments to the lights end.
pub fn light_points(lights: &[PunctualLight], scene: &RenderScene) -> Vec<LightPoint> {
    let diameter = (scene.radius() * 2.0) as f32;
    let point = |light: &PunctualLight| match light.kind {
        LightKind::Directional => LightPoint::directional(light.direction.to_array(), diameter),
        LightKind::Point | LightKind::Spot { .. } => LightPoint::at(light.position.to_array()),
    };
    lights.iter().map(point).collect()
}

/// Mean intensity of one of `count` generated lights, candela.
pub fn intensity(scene: &RenderScene, count: usize) -> f32 {
    (INTENSITY_PER_SQUARE_RADIUS * scene.radius().powi(2) / count as f64) as f32
}

/// A light colour of a hue (0 … 1) whose channels' mean is 1: `saturation` 0 is white.
fn color(hue: f64, saturation: f64) -> Vec3 {
    let channel = |shift: f64| {
        let (_, cosine) = sin_cos((hue + shift) * TAU);
        (1.0 + saturation * cosine) as f32
    };
    Vec3::new(channel(0.0), channel(2.0 / 3.0), channel(1.0 / 3.0))
}

fn random(scene: &RenderScene, count: usize, seed: u64) -> Vec<PunctualLight> {
    let mut random = Random::new(seed);
    let intensity = intensity(scene, count);
    let [min, max] = scene.bounds;
    (0..count)
        .map(|_| {
            let share = DVec3::new(random.unit(), random.unit(), random.unit());
            let tint = color(random.unit(), 0.6);
            point_light((min + (max - min) * share).as_vec3(), tint * intensity)
        })
        .collect()
}

fn particles(scene: &RenderScene, reference: &Reference<'_>, count: usize, seed: u64) -> Vec<PunctualLight> {
    let mut random = Random::new(seed ^ 0x7061_7274_6963_6c65);
    // More particles make more fountains, and denser ones.
    let fountains = (((count as f64).sqrt() / 2.0) as usize).clamp(1, 64);
    let fountains: Vec<Fountain> = {
        let floors = Floors::new(reference);
        let hue = random.unit();
        let at = |i: usize| (hue + i as f64 / fountains as f64).fract();
        (0..fountains).map(|i| floors.fountain(scene, reference, at(i), &mut random)).collect()
    };
    let intensity = intensity(scene, count);
    (0..count)
        .map(|i| {
            let fountain = &fountains[i % fountains.len()];
            let (position, tint) = fountain.particle(&mut random);
            point_light(position.as_vec3(), tint * intensity)
        })
        .collect()
}

/// Triangles that one can stand on, to be drawn by area.
struct Floors<'a> {
    triangles: Vec<&'a [DVec3; 3]>,
    /// Sums of areas.
    areas: Vec<f64>,
}

impl<'a> Floors<'a> {
    fn new(reference: &'a Reference<'_>) -> Self {
        let (mut triangles, mut areas, mut sum) = (Vec::new(), Vec::new(), 0.0);
        for triangle in reference.triangles() {
            let normal = area_normal(triangle);
            if normal.y.abs() > 0.7 * normal.length() {
                sum += normal.length();
                triangles.push(triangle);
                areas.push(sum);
            }
        }
        Self { triangles, areas }
    }

    /// A fountain on a floor; of some places one with room above, near the middle, and rather low than on a roof.
    fn fountain(
        &self,
        scene: &RenderScene,
        reference: &Reference<'_>,
        hue: f64,
        random: &mut Random,
    ) -> Fountain {
        let [min, max] = scene.bounds;
        let most = scene.extent() * FOUNTAIN_HEIGHT;
        let mut best: Option<(f64, Fountain)> = None;
        for _ in 0..FOUNTAIN_TRIES {
            let foot = self.point(random).unwrap_or((min + max) * 0.5) + DVec3::Y * (scene.extent() * 1e-4);
            let above = reference.intersect(foot, DVec3::Y, f64::INFINITY).map_or(f64::INFINITY, |hit| hit.t);
            let height = most.min(above * 0.8).max(scene.extent() * 1e-3);
            let aside = (foot - (min + max) * 0.5).with_y(0.0).length() / scene.radius();
            let roof = (foot.y - min.y) / scene.extent();
            let score = (height / most).min(0.6) - aside - 2.0 * roof;
            if best.as_ref().is_none_or(|(best, _)| score > *best) {
                best = Some((score, Fountain { foot, height, hue }));
            }
        }
        best.map_or(Fountain { foot: min, height: most, hue }, |(_, fountain)| fountain)
    }

    fn point(&self, random: &mut Random) -> Option<DVec3> {
        let at = random.unit() * self.areas.last()?;
        let [a, b, c] =
            self.triangles[self.areas.partition_point(|&sum| sum <= at).min(self.areas.len() - 1)];
        let (mut b1, mut b2) = (random.unit(), random.unit());
        if b1 + b2 > 1.0 {
            (b1, b2) = (1.0 - b1, 1.0 - b2);
        }
        Some(*a + (*b - *a) * b1 + (*c - *a) * b2)
    }
}

/// Particles thrown up from a point.
struct Fountain {
    foot: DVec3,
    /// Metres.
    height: f64,
    hue: f64,
}

impl Fountain {
    /// A particle's place on its parabola, and its colour, which changes on the way.
    fn particle(&self, random: &mut Random) -> (DVec3, Vec3) {
        let age = 0.04 + 0.92 * random.unit();
        let strength = 0.6 + 0.4 * random.unit();
        let reach = self.height * (0.25 + 0.75 * random.unit()) * age;
        let (sine, cosine) = sin_cos(random.unit() * TAU);
        let height = self.height * strength * 4.0 * age * (1.0 - age);
        let offset = DVec3::new(cosine * reach, height, sine * reach);
        (self.foot + offset, color(self.hue + 0.12 * age, 0.7))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use manyview_pipeline::generate::{SceneKind, generate};

    #[test]
    fn sources_are_named() {
        let parse = |text: &str| text.parse::<LightSource>();
        assert_eq!(parse("random:9"), Ok(LightSource::Random { count: 9, seed: 1 }));
        assert_eq!(parse("particles:100000:3"), Ok(LightSource::Particles { count: 100_000, seed: 3 }));
        assert_eq!(parse("scene"), Ok(LightSource::Scene));
        assert_eq!(parse("a/b.json"), Ok(LightSource::File("a/b.json".into())));
        assert_eq!(parse("C:\\b.json"), Ok(LightSource::File("C:\\b.json".into())));
        for wrong in ["", "random", "random:", "random:0", "random:1000001", "particles:9:x", "random:-1"] {
            assert!(parse(wrong).is_err(), "{wrong}");
        }
        let virtual_lights = |count, bounces, seed| Ok(LightSource::Virtual { count, bounces, seed });
        assert_eq!(parse("vpl:1000"), virtual_lights(1000, 1, 1));
        assert_eq!(parse("vpl:1000000:4"), virtual_lights(1_000_000, 4, 1));
        assert_eq!(parse("vpl:7:2:9"), virtual_lights(7, 2, 9));
        for wrong in
            ["vpl", "vpl:", "vpl:0", "vpl:1000001", "vpl:9:0", "vpl:9:17", "vpl:9:1:x", "vpl:9:1:1:1"]
        {
            assert!(parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn generated_lights_have_one_total_and_depend_on_their_seed() {
        let scene = RenderScene::new(generate(SceneKind::Town, 2000, 1)).unwrap();
        let reference = scene.reference();
        let [min, max] = scene.bounds.map(DVec3::as_vec3);
        for text in ["random:7", "random:500", "particles:7", "particles:500"] {
            let lights = text.parse::<LightSource>().unwrap().lights(&scene, &reference).unwrap();
            let again = text.parse::<LightSource>().unwrap().lights(&scene, &reference).unwrap();
            let other = format!("{text}:2").parse::<LightSource>().unwrap();
            assert_eq!(lights, again);
            assert_ne!(lights, other.lights(&scene, &reference).unwrap());
            let sum: f32 = lights.iter().map(|light| light.intensity.element_sum() / 3.0).sum();
            let expected = (INTENSITY_PER_SQUARE_RADIUS * scene.radius().powi(2)) as f32;
            assert!((sum / expected - 1.0).abs() < 1e-3, "{text}: {sum} {expected}");
            let low = lights.iter().filter(|light| light.position.y < min.y - 0.01).count();
            assert_eq!(low, 0, "{text}");
            if text.starts_with("random") {
                assert!(lights.iter().all(|l| l.position.cmpge(min).all() && l.position.cmple(max).all()));
            }
        }
    }
}
