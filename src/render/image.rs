//! From a G-buffer and a method to a picture.

use super::gbuffer::{GBuffer, Pixel};
use super::lights::light_points;
use super::scene::RenderScene;
use super::shade::{Lighting, reflected};
use crate::preview::{Extra, Picture, display, luminance, tone_mapped};
use crate::visibility::{Receiver, Visibility, VisibilityError, light_words};
use glam::Vec3;
use manyview_pipeline::bake::Progress;
use manyview_pipeline::scene::PunctualLight;
use rayon::prelude::*;
use serde_json::json;
use std::io;
use std::time::{Duration, Instant};
use thiserror::Error;

/// Most bytes of receivers and bits that are held at once.
const BAND_BYTES: usize = 64 << 20;
/// Pairs of a receiver and a light in the first band; later ones are as many as take about [`BAND_TIME`].
const FIRST_PAIRS: usize = 1 << 20;
/// Between two bands one may cancel.
const BAND_TIME: Duration = Duration::from_millis(500);
/// Pixels of a band come in columns this wide, so that neighbours in both directions are asked about together.
const TILE_WIDTH: usize = 16;

/// Why there is no picture.
#[derive(Debug, Error)]
pub enum RenderError {
    /// The method failed.
    #[error(transparent)]
    Visibility(#[from] VisibilityError),
    /// The bits cannot be written.
    #[error("cannot write the light bits: {0}")]
    Bits(io::Error),
    /// The caller asked to stop.
    #[error("cancelled")]
    Cancelled,
}

/// Light as it leaves every pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct LitImage {
    /// Linear radiance; 0 where there is no surface.
    pub radiance: Vec<[f32; 3]>,
    /// Hidden lights / all lights; 0 where there is no surface or no light.
    pub shadow: Vec<f32>,
    /// Luminance that is due to lights alone, without glow and ambient light.
    pub direct: Vec<f32>,
}

/// Takes the bits of hidden lights of pixel after pixel, [`light_words`] words each, 0 where there is no surface.
pub type BitSink<'a> = dyn FnMut(&[u32]) -> io::Result<()> + 'a;

/// Asks `method` about every pixel and light, band by band, and sums what the visible lights give.
pub fn render(
    scene: &RenderScene,
    gbuffer: &GBuffer,
    lights: &[PunctualLight],
    method: &dyn Visibility,
    bits: Option<&mut BitSink<'_>>,
    progress: &dyn Progress,
) -> Result<LitImage, RenderError> {
    render_with(&Lighting::new(lights, scene), scene, gbuffer, lights, method, bits, progress)
}

/// [`render`] with the lighting of these lights as it has been prepared.
pub fn render_with(
    lighting: &Lighting,
    scene: &RenderScene,
    gbuffer: &GBuffer,
    lights: &[PunctualLight],
    method: &dyn Visibility,
    mut bits: Option<&mut BitSink<'_>>,
    progress: &dyn Progress,
) -> Result<LitImage, RenderError> {
    let words = light_words(lights.len());
    let points = light_points(lights, scene);
    let count = gbuffer.pixels.len();
    let mut image =
        LitImage { radiance: vec![[0.0; 3]; count], shadow: vec![0.0; count], direct: vec![0.0; count] };
    let mut hidden = Vec::new();
    let mut ordered_bits = Vec::new();
    let most = (BAND_BYTES / (size_of::<Receiver>() + 4 * words)).max(1);
    let mut wanted = (FIRST_PAIRS / lights.len().max(1)).clamp(1, most);
    progress.begin("lights", gbuffer.surface_count() as u64, "pixels");
    let mut start = 0;
    while start < count {
        if progress.cancelled() {
            return Err(RenderError::Cancelled);
        }
        let clock = Instant::now();
        let end = band_end(&gbuffer.pixels, start, wanted, most);
        let pixels = tiled(gbuffer, start, end);
        let receivers: Vec<Receiver> = pixels.iter().map(|&i| gbuffer.pixels[i].receiver()).collect();
        hidden.clear();
        hidden.resize(receivers.len() * words, 0);
        if words > 0 && !receivers.is_empty() {
            method.hidden_lights(&receivers, &points, &mut hidden)?;
        }
        let of = |place: usize| &hidden[place * words..(place + 1) * words];
        let lit: Vec<(Vec3, f32, u32)> = pixels
            .par_iter()
            .enumerate()
            .map(|(place, &i)| {
                let hidden = of(place);
                let count = hidden.iter().map(|word| word.count_ones()).sum();
                let pixel = &gbuffer.pixels[i];
                let direct = lighting.direct(pixel, hidden);
                (lighting.radiance(pixel, direct), luminance(reflected(pixel, direct)), count)
            })
            .collect();
        for (&i, (radiance, direct, hidden)) in pixels.iter().zip(lit) {
            image.radiance[i] = radiance.to_array();
            image.direct[i] = direct;
            image.shadow[i] = hidden as f32 / lights.len().max(1) as f32;
        }
        if let Some(sink) = &mut bits {
            ordered_bits.clear();
            ordered_bits.resize((end - start) * words, 0);
            for (place, &i) in pixels.iter().enumerate() {
                ordered_bits[(i - start) * words..(i - start + 1) * words].copy_from_slice(of(place));
            }
            sink(&ordered_bits).map_err(RenderError::Bits)?;
        }
        progress.advance(pixels.len() as u64);
        // A result never depends on the size of a band.
        match clock.elapsed() {
            long if long > BAND_TIME => wanted = (wanted / 2).max(1),
            short if short < BAND_TIME / 4 => wanted = (wanted * 2).min(most),
            _ => {}
        }
        start = end;
    }
    Ok(image)
}

/// The end of a band from `start` on, of at most `surfaces` pixels with a surface and `most` in all.
fn band_end(pixels: &[Pixel], start: usize, surfaces: usize, most: usize) -> usize {
    let mut left = surfaces;
    let band = pixels[start..].iter().take(most);
    let len = band
        .take_while(|pixel| {
            let fits = left > 0 || !pixel.is_surface();
            left -= usize::from(fits && pixel.is_surface());
            fits
        })
        .count();
    start + len
}

/// Pixels with a surface from `start` to `end`, tile by tile.
fn tiled(gbuffer: &GBuffer, start: usize, end: usize) -> Vec<usize> {
    let width = gbuffer.width as usize;
    let mut pixels: Vec<usize> = (start..end).filter(|&i| gbuffer.pixels[i].is_surface()).collect();
    pixels.sort_by_key(|&i| (i % width / TILE_WIDTH, i));
    pixels
}

/// How bright a picture comes out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Exposure {
    /// As suits the picture.
    Auto,
    /// Radiance times 2 to this power.
    Stops(f32),
}

impl Exposure {
    /// Stops for a picture whose surfaces send back these luminances.
    pub fn stops(self, luminances: impl Iterator<Item = f32>) -> f32 {
        match self {
            Self::Stops(stops) => stops,
            // Rounded, so that it can be written down and given back.
            Self::Auto => (auto_stops(luminances) * 100.0).round() / 100.0,
        }
    }
}

impl LitImage {
    /// The picture without any light but what glows, or without that too.
    pub fn dark(gbuffer: &GBuffer, glows: bool) -> Self {
        let emissive = |pixel: &Pixel| if glows { pixel.emissive } else { [0.0; 3] };
        let count = gbuffer.pixels.len();
        Self {
            radiance: gbuffer.pixels.iter().map(emissive).collect(),
            shadow: vec![0.0; count],
            direct: vec![0.0; count],
        }
    }

    /// Adds what surfaces send back of more light, an irradiance for each pixel.
    ///
    /// # Panics
    /// If there is not one for each pixel.
    pub fn add(&mut self, gbuffer: &GBuffer, irradiance: &[[f32; 3]]) {
        assert_eq!(gbuffer.pixels.len(), irradiance.len(), "an irradiance for each pixel");
        for (i, pixel) in gbuffer.pixels.iter().enumerate() {
            let more = reflected(pixel, irradiance[i].into());
            self.radiance[i] = (Vec3::from(self.radiance[i]) + more).to_array();
            self.direct[i] += luminance(more);
        }
    }

    /// Stops for this picture: automatic ones go by what lights reach, or by all that is not black where they reach
    /// nothing.
    pub fn stops(&self, exposure: Exposure) -> f32 {
        match self.direct.iter().any(|&light| light > 0.0) {
            true => exposure.stops(self.direct.iter().copied()),
            false => exposure.stops(self.radiance.iter().map(|&c| luminance(Vec3::from(c)))),
        }
    }
}

/// Between what brings the median to a dark grey and what keeps all but the brightest twentieth below white. Black does
/// not count, so that scenes at night stay dark where no light is.
fn auto_stops(luminances: impl Iterator<Item = f32>) -> f32 {
    let mut lights: Vec<f32> = luminances.filter(|light| light.is_finite() && *light > 0.0).collect();
    if lights.is_empty() {
        return 0.0;
    }
    let mut at = |share: f64| {
        let place = ((lights.len() - 1) as f64 * share) as usize;
        *lights.select_nth_unstable_by(place, f32::total_cmp).1
    };
    let (median, bright) = (at(0.5), at(0.95));
    let (from_median, from_bright) = ((0.14 / median).log2(), (0.7 / bright).log2());
    ((from_median + 2.0 * from_bright) / 3.0).clamp(-60.0, 60.0)
}

/// What a picture's file says of how it was made.
#[derive(Debug, Clone, PartialEq)]
pub struct Provenance<'a> {
    /// Name of the method.
    pub visibility: &'a str,
    /// How many lights.
    pub lights: usize,
    /// Stops between radiance and the tone-mapped picture.
    pub exposure_stops: f32,
}

/// The picture with all its layers. `glow` is linear light for screens alone, for each pixel, or empty.
///
/// # Panics
/// If `glow` has another length than the picture has pixels.
pub fn picture(
    gbuffer: &GBuffer,
    image: LitImage,
    glow: &[[f32; 3]],
    provenance: &Provenance<'_>,
) -> Picture {
    assert!(glow.is_empty() || glow.len() == gbuffer.pixels.len(), "glow for each pixel");
    let factor = provenance.exposure_stops.exp2();
    let developed = |(i, radiance): (usize, &[f32; 3])| {
        let glow = glow.get(i).copied().unwrap_or_default();
        display([0, 1, 2].map(|c| tone_mapped(radiance[c] * factor) + glow[c]))
    };
    let display = image.radiance.par_iter().enumerate().map(developed).collect();
    let vectors = |of: fn(&Pixel) -> [f32; 3]| gbuffer.pixels.iter().map(of).collect::<Vec<_>>();
    let mut layers = vec![
        ("albedo", Extra::Color(vectors(|p| p.albedo))),
        ("depth", Extra::Scalar(gbuffer.pixels.iter().map(|p| p.depth).collect())),
        ("normal", Extra::Vector(vectors(|p| p.normal))),
        ("position", Extra::Vector(vectors(|p| p.position))),
        ("shadow", Extra::Scalar(image.shadow)),
    ];
    if gbuffer.pixels.iter().any(|p| p.emissive != [0.0; 3]) {
        layers.push(("emissive", Extra::Color(vectors(|p| p.emissive))));
    }
    let note = json!({
        "visibility": provenance.visibility,
        "lights": provenance.lights,
        "exposure_stops": provenance.exposure_stops,
    });
    Picture {
        width: gbuffer.width,
        height: gbuffer.height,
        color: image.radiance,
        display,
        layers,
        note: Some(note.to_string()),
    }
}
