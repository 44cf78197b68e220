//! The lights themselves, as they are seen: small discs with a soft rim.
//!
//! They are for screens only, added to what is tone-mapped, and in no layer of an EXR: a point has no radiance.

use super::gbuffer::GBuffer;
use crate::preview::{Camera, CameraError};
use glam::{DVec3, Vec3};
use manyview_pipeline::scene::{LightKind, PunctualLight};

/// Radius of a disc as a share of the scene's radius.
const DISC_SHARE: f64 = 0.003;
/// The rim fades out at this many radii.
const RIM: f64 = 3.0;
/// Brightness of the rim where it begins.
const RIM_BRIGHTNESS: f32 = 0.35;
/// Light of a disc with its rim, of radius 1: π · (1 + 2 · [`RIM_BRIGHTNESS`]).
const DISC_LIGHT: f64 = 5.34;
/// The least radius of a disc, pixels.
const LEAST_DISC: f64 = 0.6;
/// Most light that is added to a picture, as a mean over its pixels: thousands of lights must not cover what they
/// shine on. Where it would be more, discs are smaller, and then darker.
pub const MOST_GLOW: f64 = 0.05;

/// A light in the picture.
struct Disc {
    /// Pixels.
    center: [f64; 2],
    /// Pixels.
    radius: f64,
    /// Metres from the eye.
    distance: f64,
    tint: Vec3,
}

/// Linear light to add to every tone-mapped pixel, for the lights that nothing hides from the camera.
pub fn glow(
    gbuffer: &GBuffer,
    camera: &Camera,
    lights: &[PunctualLight],
    scene_radius: f64,
) -> Result<Vec<[f32; 3]>, CameraError> {
    let (width, height) = (gbuffer.width, gbuffer.height);
    let rays = camera.ray_maker(width, height)?;
    let [right, up] = rays.half_axes();
    let disc = |light: &PunctualLight| {
        let from_eye: DVec3 = light.position.as_dvec3() - camera.eye;
        let depth = from_eye.dot(rays.forward());
        let (distance, brightest) = (from_eye.length(), light.intensity.max_element());
        if !(depth > 0.0 && brightest > 0.0) {
            return None;
        }
        let ndc = [
            from_eye.dot(right) / right.length_squared() / depth,
            -from_eye.dot(up) / up.length_squared() / depth,
        ];
        let center = [(ndc[0] + 1.0) * 0.5 * f64::from(width), (ndc[1] + 1.0) * 0.5 * f64::from(height)];
        let radius = (scene_radius * DISC_SHARE / (rays.pixel_spread() * depth))
            .clamp(LEAST_DISC, 0.02 * f64::from(height).max(30.0));
        Some(Disc { center, radius, distance, tint: light.intensity / brightest })
    };
    let lights = lights.iter().filter(|light| light.kind != LightKind::Directional);
    let mut discs: Vec<Disc> = lights.filter_map(disc).collect();
    let is_seen = |disc: &&Disc| {
        let [x, y] = disc.center;
        let is_within = x >= 0.0 && y >= 0.0 && x < f64::from(width) && y < f64::from(height);
        is_within
            && f64::from(gbuffer.pixels[y as usize * width as usize + x as usize].depth) >= disc.distance
    };
    let most = MOST_GLOW * gbuffer.pixels.len() as f64;
    let seen: f64 = discs.iter().filter(is_seen).map(|disc| DISC_LIGHT * disc.radius * disc.radius).sum();
    let smaller = (most / seen).sqrt().min(1.0);
    let mut glow = vec![[0.0f32; 3]; gbuffer.pixels.len()];
    for disc in &mut discs {
        disc.radius = (disc.radius * smaller).max(LEAST_DISC);
        draw(gbuffer, disc, &mut glow);
    }
    let drawn: f64 = glow.iter().map(|light| f64::from(Vec3::from(*light).max_element())).sum();
    if drawn > most {
        let darker = (most / drawn) as f32;
        glow.iter_mut().flatten().for_each(|light| *light *= darker);
    }
    Ok(glow)
}

/// Adds a disc where nothing hides it.
fn draw(gbuffer: &GBuffer, disc: &Disc, glow: &mut [[f32; 3]]) {
    let Disc { center, radius, distance, tint } = *disc;
    let reach = radius * RIM;
    // `as` saturates.
    let span = |c: f64, side: u32| (c - reach).max(0.0) as u32..((c + reach).max(0.0) as u32 + 1).min(side);
    for y in span(center[1], gbuffer.height) {
        for x in span(center[0], gbuffer.width) {
            let (dx, dy) = (f64::from(x) + 0.5 - center[0], f64::from(y) + 0.5 - center[1]);
            let radii = dx.hypot(dy) / radius;
            let pixel = (y * gbuffer.width + x) as usize;
            if radii >= RIM || f64::from(gbuffer.pixels[pixel].depth) < distance {
                continue;
            }
            let fade = (1.0 - (radii - 1.0) / (RIM - 1.0)) as f32;
            let brightness = if radii <= 1.0 { 1.0 } else { RIM_BRIGHTNESS * fade * fade };
            let sum = Vec3::from(glow[pixel]) + tint * brightness;
            glow[pixel] = sum.min(Vec3::ONE).to_array();
        }
    }
}
