//! From pixels to pictures: light smoothed along surfaces, glow, exposure and tone mapping.

use glam::Vec3;
use rayon::prelude::*;

use super::picture::{self, Picture};
use super::view::Pixel;

/// Passes of the smoothing filter; the reach doubles with each.
const SMOOTHING_PASSES: usize = 4;
/// How much of the emitted light glows around its source.
const GLOW: f32 = 0.22;
/// Emitted light beyond this adds nothing to the glow.
const GLOW_LIMIT: f32 = 8.0;

/// Finishes a shaded picture.
pub(super) fn develop(pixels: &mut [Pixel], width: usize) -> Picture {
    for pass in 0..SMOOTHING_PASSES {
        let smooth = smoothed(pixels, width, 1 << pass);
        for (pixel, light) in pixels.iter_mut().zip(smooth) {
            pixel.light = light;
        }
    }
    let height = pixels.len() / width;
    let source = pixels.iter().map(|p| p.emitted.min(Vec3::splat(GLOW_LIMIT)) * p.hits).collect();
    let glow = blurred(source, width, height as f32 * 0.012);
    let surfaces = pixels.iter().map(|p| p.surface * p.light + p.emitted);
    let exposure =
        exposure(surfaces.clone().zip(pixels.iter()).filter(|(_, p)| p.hits > 0.0).map(|(c, _)| c));
    let color = surfaces.zip(pixels.iter()).zip(glow).map(|((surface, p), glow)| {
        // The sky looks the same whatever the exposure.
        ((p.sky / exposure).lerp(surface, p.hits) + glow * GLOW).to_array()
    });
    expose_by(width as u32, height as u32, color.collect(), exposure)
}

/// Tone-maps linear colours, exposed for the pixels that are not black.
pub(super) fn expose(width: u32, height: u32, color: Vec<[f32; 3]>) -> Picture {
    let exposure = exposure(color.iter().map(|&c| Vec3::from(c)).filter(|c| c.max_element() > 0.0));
    expose_by(width, height, color, exposure)
}

/// The factor that brings colours half way to a middle grey, so that bright scenes stay brighter than dark ones.
fn exposure(colors: impl Iterator<Item = Vec3>) -> f32 {
    let logs = colors.map(|color| f64::from((luminance(color) + 1e-3).ln()));
    let (sum, count) = logs.fold((0.0, 0u32), |(sum, count), log| (sum + log, count + 1));
    if count == 0 {
        return 1.0;
    }
    let mean = (sum / f64::from(count)).exp() as f32;
    (0.30 / mean).sqrt().clamp(0.5, 3.0)
}

fn expose_by(width: u32, height: u32, color: Vec<[f32; 3]>, exposure: f32) -> Picture {
    let display = color.par_iter().map(|&c| picture::display(c.map(|c| tone_mapped(c * exposure)))).collect();
    Picture { width, height, color, display, layers: Vec::new(), note: None }
}

/// Luminance of a linear colour.
pub(crate) fn luminance(color: Vec3) -> f32 {
    color.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

/// Narkowicz's fit (2015) of the ACES curve.
pub(crate) fn tone_mapped(c: f32) -> f32 {
    let c = if c > 0.0 { c.min(1e4) * 0.7 } else { 0.0 };
    (c * (2.51 * c + 0.03)) / (c * (2.43 * c + 0.59) + 0.14)
}

/// One pass of an edge-avoiding à-trous filter (Dammertz et al. 2010): light is averaged over pixels `step` apart
/// whose normals agree and which lie in one surface.
fn smoothed(pixels: &[Pixel], width: usize, step: isize) -> Vec<Vec3> {
    const KERNEL: [f32; 5] = [1.0 / 16.0, 1.0 / 4.0, 3.0 / 8.0, 1.0 / 4.0, 1.0 / 16.0];
    let height = pixels.len() / width;
    let filter_pixel = |index: usize| {
        let center = &pixels[index];
        if center.hits == 0.0 {
            return Vec3::ZERO;
        }
        let (x, y) = ((index % width) as isize, (index / width) as isize);
        let position = Vec3::from(center.position);
        let mut sum = Vec3::ZERO;
        let mut weights = 0.0;
        for (j, ky) in KERNEL.iter().enumerate() {
            let row = y + (j as isize - 2) * step;
            if row < 0 || row >= height as isize {
                continue;
            }
            for (i, kx) in KERNEL.iter().enumerate() {
                let column = x + (i as isize - 2) * step;
                if column < 0 || column >= width as isize {
                    continue;
                }
                let other = &pixels[row as usize * width + column as usize];
                if other.hits == 0.0 {
                    continue;
                }
                let facing = center.normal.dot(other.normal).max(0.0);
                let away = (Vec3::from(other.position) - position).dot(center.normal).abs()
                    / (center.depth * 0.004 * step as f32 + 1e-9);
                let weight = kx * ky * facing.powi(8) / (1.0 + away * away);
                sum += other.light * weight;
                weights += weight;
            }
        }
        if weights > 0.0 { sum / weights } else { center.light }
    };
    (0..pixels.len()).into_par_iter().map(filter_pixel).collect()
}

/// A Gaussian blur of a standard deviation in pixels.
fn blurred(source: Vec<Vec3>, width: usize, deviation: f32) -> Vec<Vec3> {
    if source.iter().all(|c| *c == Vec3::ZERO) {
        return source;
    }
    let radius = (deviation * 3.0).ceil() as isize;
    let weights: Vec<f32> =
        (-radius..=radius).map(|d| (-0.5 * (d as f32 / deviation.max(0.1)).powi(2)).exp()).collect();
    let total: f32 = weights.iter().sum();
    let height = (source.len() / width) as isize;
    let along = |source: &[Vec3], dx: isize, dy: isize| -> Vec<Vec3> {
        let blur = |index: usize| {
            let (x, y) = ((index % width) as isize, (index / width) as isize);
            let mut sum = Vec3::ZERO;
            for (i, weight) in weights.iter().enumerate() {
                let offset = i as isize - radius;
                let (x, y) = (x + dx * offset, y + dy * offset);
                if x >= 0 && x < width as isize && y >= 0 && y < height {
                    sum += source[y as usize * width + x as usize] * *weight;
                }
            }
            sum / total
        };
        (0..source.len()).into_par_iter().map(blur).collect()
    };
    along(&along(&source, 1, 0), 0, 1)
}
