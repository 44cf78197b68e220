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
    let mut glow = vec![[0.0f32; 3]; gbuffer.pixels.len()];
    for light in lights.iter().filter(|light| light.kind != LightKind::Directional) {
        let from_eye: DVec3 = light.position.as_dvec3() - camera.eye;
        let depth = from_eye.dot(rays.forward());
        let (distance, brightest) = (from_eye.length(), light.intensity.max_element());
        if !(depth > 0.0 && brightest > 0.0) {
            continue;
        }
        let tint = light.intensity / brightest;
        let ndc = [
            from_eye.dot(right) / right.length_squared() / depth,
            -from_eye.dot(up) / up.length_squared() / depth,
        ];
        let center = [(ndc[0] + 1.0) * 0.5 * f64::from(width), (ndc[1] + 1.0) * 0.5 * f64::from(height)];
        let disc = (scene_radius * DISC_SHARE / (rays.pixel_spread() * depth))
            .clamp(0.6, 0.02 * f64::from(height).max(30.0));
        let reach = disc * RIM;
        // `as` saturates.
        let span =
            |c: f64, side: u32| (c - reach).max(0.0) as u32..((c + reach).max(0.0) as u32 + 1).min(side);
        for y in span(center[1], height) {
            for x in span(center[0], width) {
                let (dx, dy) = (f64::from(x) + 0.5 - center[0], f64::from(y) + 0.5 - center[1]);
                let radii = dx.hypot(dy) / disc;
                let pixel = (y * width + x) as usize;
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
    Ok(glow)
}
