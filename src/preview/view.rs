//! Ray-cast pictures.

use std::sync::atomic::{AtomicBool, Ordering};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::camera::{Camera, CameraError};
use super::filter;
use super::octree::{Hit, Ray};
use super::picture::{self, Extra, Picture};
use super::scene::Scene;
use super::shade::{Light, random_numbers};

/// What a view shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Colours in the light of a sun and a sky, with shadows and glow.
    Shaded,
    /// Base colours as they are stored.
    Color,
    /// World-space normals, -1 … 1 as 0 … 1.
    Normal,
    /// The level whose cells are about as large as a pixel.
    Level,
    /// Emitted light.
    Emissive,
    /// Distance from the camera: near is bright.
    Depth,
}

/// How a view is made.
#[derive(Debug, Clone, Copy)]
pub struct ViewSettings {
    /// What it shows.
    pub mode: Mode,
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The deepest level that is looked at.
    pub level: u32,
    /// Rays a pixel, at least 1.
    pub samples: u32,
    /// Largest extent of the scene, metres.
    pub extent: f64,
}

/// The picture was given up because the caller asked for that.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("cancelled")]
pub struct Cancelled;

/// What is known of a pixel: means over its samples.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Pixel {
    /// Share of samples that hit something.
    pub(super) hits: f32,
    /// What is shown of the surface; for shaded pictures, its base colour.
    pub(super) surface: Vec3,
    /// Light that arrives there.
    pub(super) light: Vec3,
    /// Light that starts there.
    pub(super) emitted: Vec3,
    /// Light of the sky where nothing was hit.
    pub(super) sky: Vec3,
    /// Unit length, or zero.
    pub(super) normal: Vec3,
    /// Distance along the ray of the nearest sample, metres; +infinity where nothing was hit.
    pub(super) depth: f32,
    /// Position of the nearest sample, metres.
    pub(super) position: [f32; 3],
}

/// Ray-casts a picture of `scene`. Gives up soon after `cancel` becomes true.
pub fn picture_view(
    scene: &Scene,
    camera: &Camera,
    settings: &ViewSettings,
    cancel: &AtomicBool,
) -> Result<Result<Picture, Cancelled>, CameraError> {
    let rays = camera.ray_maker(settings.width, settings.height)?;
    let light = Light::new(rays.forward(), settings.extent);
    let spread = if settings.mode == Mode::Level { rays.pixel_spread() } else { 0.0 };
    let mut pixels = vec![Pixel::default(); settings.width as usize * settings.height as usize];
    pixels.par_iter_mut().enumerate().for_each(|(index, pixel)| {
        if !cancel.load(Ordering::Relaxed) {
            let (x, y) = (index as u32 % settings.width, index as u32 / settings.width);
            let ray = |x: f64, y: f64| Ray { spread, ..rays.ray(x, y) };
            *pixel = trace_pixel(scene, &light, settings, index as u32, |dx, dy| {
                ray(f64::from(x) + dx, f64::from(y) + dy)
            });
        }
    });
    if cancel.load(Ordering::Relaxed) {
        return Ok(Err(Cancelled));
    }
    Ok(Ok(compose(pixels, settings)))
}

fn trace_pixel(
    scene: &Scene,
    light: &Light,
    settings: &ViewSettings,
    index: u32,
    ray: impl Fn(f64, f64) -> Ray,
) -> Pixel {
    let mut sum = Pixel { depth: f32::INFINITY, position: [f32::INFINITY; 3], ..Pixel::default() };
    for sample in 0..settings.samples {
        let [dx, dy, random @ ..] = random_numbers(index, sample);
        let (dx, dy) = if settings.samples == 1 { (0.5, 0.5) } else { (dx, dy) };
        let ray = ray(dx, dy);
        let Some(hit) = scene.octree().intersect(&ray, settings.level) else {
            sum.sky += light.sky(ray.direction.into());
            continue;
        };
        let normal = scene.shading_normal(&ray, &hit);
        sum.hits += 1.0;
        sum.normal += normal.as_vec3();
        if (hit.t as f32) < sum.depth {
            sum.depth = hit.t as f32;
            sum.position = ray.at(hit.t).map(|c| c as f32);
        }
        match settings.mode {
            Mode::Shaded => {
                sum.surface += Vec3::from(scene.base_color(&hit));
                sum.light += light.arriving(scene, &ray, &hit, normal, random);
                sum.emitted += Vec3::from(scene.emitted(&hit));
            }
            Mode::Emissive => sum.emitted += Vec3::from(scene.emitted(&hit)),
            Mode::Color => sum.surface += Vec3::from(scene.base_color(&hit)),
            Mode::Normal => sum.surface += normal.as_vec3() * 0.5 + 0.5,
            Mode::Level => sum.surface += level_color(&ray, &hit, normal),
            Mode::Depth => {}
        }
    }
    let hits = sum.hits.max(1.0);
    Pixel {
        hits: sum.hits / settings.samples as f32,
        surface: sum.surface / hits,
        light: sum.light / hits,
        emitted: sum.emitted / hits,
        sky: sum.sky / (settings.samples as f32 - sum.hits).max(1.0),
        normal: sum.normal.normalize_or_zero(),
        ..sum
    }
}

/// One hue per level, with enough light and shade to see the form.
fn level_color(ray: &Ray, hit: &Hit, normal: DVec3) -> Vec3 {
    const HUES: [[u8; 3]; 7] = [
        [228, 87, 86],
        [244, 154, 60],
        [238, 204, 84],
        [111, 176, 82],
        [86, 178, 174],
        [82, 124, 186],
        [158, 106, 170],
    ];
    let facing = normal.dot(-DVec3::from(ray.direction)).abs() as f32;
    Vec3::from(picture::linear(HUES[hit.level as usize % HUES.len()])) * (0.35 + 0.65 * facing)
}

fn compose(mut pixels: Vec<Pixel>, settings: &ViewSettings) -> Picture {
    let (width, height) = (settings.width, settings.height);
    let background = Vec3::splat(0.02);
    let mut picture = match settings.mode {
        Mode::Shaded => filter::develop(&mut pixels, width as usize),
        Mode::Emissive => {
            let color = pixels.iter().map(|p| (p.emitted * p.hits).to_array()).collect();
            filter::expose(width, height, color)
        }
        Mode::Depth => {
            let depths = pixels.iter().map(|p| p.depth).filter(|d| d.is_finite());
            let (near, far) =
                depths.fold((f32::INFINITY, 0.0f32), |(near, far), d| (near.min(d), far.max(d)));
            let range = (far - near).max(f32::MIN_POSITIVE);
            let shade = |depth: f32| {
                if depth.is_finite() {
                    Vec3::splat(0.04 + 0.96 * (1.0 - (depth - near) / range).powi(2))
                } else {
                    background * 0.25
                }
            };
            Picture::of_colors(width, height, pixels.iter().map(|p| shade(p.depth).to_array()).collect())
        }
        Mode::Color | Mode::Normal | Mode::Level => {
            let color = pixels.iter().map(|p| background.lerp(p.surface, p.hits).to_array());
            Picture::of_colors(width, height, color.collect())
        }
    };
    picture.layers = vec![
        ("depth", Extra::Scalar(pixels.iter().map(|p| p.depth).collect())),
        ("normal", Extra::Vector(pixels.iter().map(|p| p.normal.to_array()).collect())),
        ("position", Extra::Vector(pixels.iter().map(|p| p.position).collect())),
    ];
    picture
}
