//! Noise out of gathered light.
//!
//! # Theory
//! A cross-bilateral filter (G. Petschnigg et al., *Digital Photography with Flash and No-Flash Image Pairs*, SIGGRAPH
//! 2004): a pixel takes the mean of those around it, each by how close it is and by how much its surface is the same,
//! which the G-buffer tells without noise. Albedo is not filtered, only the light that falls on it.

use crate::render::gbuffer::GBuffer;
use glam::Vec3;
use rayon::prelude::*;

/// How light is filtered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FilterOptions {
    /// Pixels to each side.
    pub radius: u32,
    /// Width of a pixel, metres per metre of distance.
    pub spread: f64,
}

/// Mean of the irradiances around every pixel on the same surface.
///
/// # Panics
/// If there is not an irradiance for each pixel.
pub fn filter(gbuffer: &GBuffer, irradiance: &[[f32; 3]], options: &FilterOptions) -> Vec<[f32; 3]> {
    assert_eq!(gbuffer.pixels.len(), irradiance.len(), "an irradiance for each pixel");
    let (width, height) = (gbuffer.width as i64, gbuffer.height as i64);
    let radius = i64::from(options.radius);
    let falloff = 2.0 / (radius * radius).max(1) as f32;
    let of = |index: usize| {
        let center = &gbuffer.pixels[index];
        if !center.is_surface() {
            return irradiance[index];
        }
        let (x, y) = (index as i64 % width, index as i64 / width);
        let (at, normal) = (Vec3::from(center.position), Vec3::from(center.normal));
        // A surface may bend by a pixel's width for each pixel of the way.
        let bend =
            1.0 / (center.depth * options.spread as f32 * (radius.max(1) as f32)).max(f32::MIN_POSITIVE);
        let (mut sum, mut weights) = (Vec3::ZERO, 0.0f32);
        for v in (y - radius).max(0)..=(y + radius).min(height - 1) {
            for u in (x - radius).max(0)..=(x + radius).min(width - 1) {
                let other = (v * width + u) as usize;
                let pixel = &gbuffer.pixels[other];
                if !pixel.is_surface() {
                    continue;
                }
                let cosine = normal.dot(pixel.normal.into()).max(0.0);
                let off = normal.dot(Vec3::from(pixel.position) - at) * bend;
                let near = ((u - x).pow(2) + (v - y).pow(2)) as f32 * falloff;
                let power = |c: f32| {
                    let square = c * c;
                    let fourth = square * square;
                    let eighth = fourth * fourth;
                    eighth * eighth
                };
                // Rational instead of exponential functions: the same on every machine.
                let weight = power(cosine) / ((1.0 + near * near) * (1.0 + 4.0 * off * off).powi(2));
                sum += Vec3::from(irradiance[other]) * weight;
                weights += weight;
            }
        }
        if weights > 0.0 { (sum / weights).to_array() } else { irradiance[index] }
    };
    (0..irradiance.len()).into_par_iter().map(of).collect()
}
