//! How far two pictures of one view are apart.
//!
//! # Theory
//! \[WMP\], *Error measures*: eps_v is the share of lights whose visibility is wrong, eps_s is |wrongly visible − wrongly
//! hidden| / lights, which is the difference of shadow values; both are means over pixels.
//!
//! # Practice
//! PSNR, SSIM and errors compare what a screen would show: sRGB codes from 0 to 1, not rounded, of EXRs tone-mapped as
//! [`super::image`] does with one exposure for both. SSIM is of their luma (Rec. 709). Pixels where a picture is not
//! finite are counted, and left out of everything else.

use super::image::Exposure;
use super::ssim::ssim;
use crate::npy::{ArrayReader, ReadError};
use crate::preview::{Picture, heat, luminance, tone_mapped};
use std::io::Read;
use thiserror::Error;

/// A pixel differs where a channel does by at least this: one code of 8 bits.
const DIFFERING: f32 = 1.0 / 255.0;
/// Words of light bits that are read at once.
const BITS_AT_ONCE: usize = 1 << 18;

/// A picture to compare.
#[derive(Debug, Clone, PartialEq)]
pub struct Compared {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// What it shows.
    pub color: Color,
    /// Hidden lights / all lights, if it has that layer.
    pub shadow: Option<Vec<f32>>,
    /// Which pixels show a surface, if it tells.
    pub surface: Option<Vec<bool>>,
    /// How many lights it was made with, if it tells.
    pub lights: Option<u64>,
    /// Stops that it was made for, if it tells.
    pub exposure_stops: Option<f32>,
}

/// Colours of a picture.
#[derive(Debug, Clone, PartialEq)]
pub enum Color {
    /// Linear radiance, of an EXR.
    Radiance(Vec<[f32; 3]>),
    /// sRGB codes 0 … 1, of a PNG.
    Codes(Vec<[f32; 3]>),
}

impl Color {
    /// The numbers.
    pub fn values(&self) -> &[[f32; 3]] {
        match self {
            Self::Radiance(values) | Self::Codes(values) => values,
        }
    }
}

/// Why two pictures cannot be compared.
#[derive(Debug, Error)]
pub enum CompareError {
    /// Their sizes differ.
    #[error(
        "the pictures differ in size: {} × {} and {} × {} pixels; render both with one --size",
        sizes[0][0], sizes[0][1], sizes[1][0], sizes[1][1]
    )]
    Sizes {
        /// Width and height of both.
        sizes: [[u32; 2]; 2],
    },
    /// One has radiances, the other codes.
    #[error(
        "one picture is an EXR and the other a PNG, which show light on different scales: compare two of a kind"
    )]
    Kinds,
    /// They were made with different numbers of lights.
    #[error("the pictures were made with {} and {} lights: render both with the same --lights", lights[0], lights[1])]
    Lights {
        /// Lights of both.
        lights: [u64; 2],
    },
    /// Light bits need to know how many lights there are.
    #[error(
        "light bits need an EXR of `manyview render` as the reference: it says how many lights there are"
    )]
    NoLightCount,
    /// The light bits cannot be read.
    #[error(transparent)]
    Bits(#[from] ReadError),
}

/// What was measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Comparison {
    /// Peak signal-to-noise ratio, decibels; +infinity for equal pictures, NaN where nothing can be compared.
    pub psnr_db: f64,
    /// Mean structural similarity; `None` where no window fits.
    pub ssim: Option<f64>,
    /// Mean difference of shadow values over surfaces, if both have them.
    pub eps_s: Option<f64>,
    /// Share of lights whose visibility differs, mean over surfaces; if both have light bits.
    pub eps_v: Option<f64>,
    /// Largest difference of a code, 0 … 1.
    pub max_error: f64,
    /// Largest difference of a radiance, for EXRs.
    pub max_radiance_error: Option<f64>,
    /// Share of pixels that differ by at least one of 255 codes.
    pub differing_share: f64,
    /// Pixels that were compared.
    pub pixels: u64,
    /// Pixels with a colour that is not finite, of both pictures.
    pub not_finite: [u64; 2],
    /// Stops that EXRs were tone-mapped for.
    pub exposure_stops: Option<f32>,
}

/// Compares `image` with a `reference`. `exposure` is for EXRs; where it is automatic, the reference's own is taken.
pub fn compare(
    reference: &Compared,
    image: &Compared,
    exposure: Exposure,
) -> Result<(Comparison, Picture), CompareError> {
    let sizes = [[reference.width, reference.height], [image.width, image.height]];
    if sizes[0] != sizes[1] {
        return Err(CompareError::Sizes { sizes });
    }
    if let (Some(a), Some(b)) = (reference.lights, image.lights)
        && a != b
    {
        return Err(CompareError::Lights { lights: [a, b] });
    }
    let exposure_stops = match (&reference.color, &image.color) {
        (Color::Radiance(values), Color::Radiance(_)) => Some(match (exposure, reference.exposure_stops) {
            (Exposure::Auto, Some(stops)) => stops,
            _ => exposure.stops(values.iter().map(|&c| luminance(c.into()))),
        }),
        (Color::Codes(_), Color::Codes(_)) => None,
        _ => return Err(CompareError::Kinds),
    };
    let (a, b) = (reference.color.values(), image.color.values());
    let is_finite = |c: &[f32; 3]| c.iter().all(|c| c.is_finite());
    let not_finite = [a, b].map(|values| values.iter().filter(|c| !is_finite(c)).count() as u64);
    let coded = |values: &[[f32; 3]]| -> Vec<[f32; 3]> {
        let factor = exposure_stops.map(f32::exp2);
        let code = |c: &[f32; 3]| match factor {
            // NaN as it is: the tone map would make it black.
            Some(factor) if is_finite(c) => c.map(|c| srgb_code(tone_mapped(c * factor))),
            Some(_) => [f32::NAN; 3],
            None => *c,
        };
        values.iter().map(code).collect()
    };
    let codes = [coded(a), coded(b)];
    let (mut squares, mut max_error, mut max_radiance_error) = (0.0f64, 0.0f32, 0.0f32);
    let (mut pixels, mut differing) = (0u64, 0u64);
    let mut errors = Vec::with_capacity(a.len());
    for (i, (p, q)) in codes[0].iter().zip(&codes[1]).enumerate() {
        if !(is_finite(p) && is_finite(q)) {
            errors.push(f32::NAN);
            continue;
        }
        pixels += 1;
        let error = [0, 1, 2].map(|c| (p[c] - q[c]).abs());
        squares += error.iter().map(|&e| f64::from(e).powi(2)).sum::<f64>();
        let largest = error[0].max(error[1]).max(error[2]);
        // A hair less, since codes of PNGs are rounded quotients.
        differing += u64::from(largest >= DIFFERING * 0.9999);
        max_error = max_error.max(largest);
        errors.push(largest);
        for c in 0..3 {
            max_radiance_error = max_radiance_error.max((a[i][c] - b[i][c]).abs());
        }
    }
    let luma = |codes: &[[f32; 3]]| -> Vec<f32> {
        codes.iter().map(|[r, g, b]| 0.2126 * r + 0.7152 * g + 0.0722 * b).collect()
    };
    let comparison = Comparison {
        psnr_db: -10.0 * (squares / (3 * pixels) as f64).log10(),
        ssim: ssim(&luma(&codes[0]), &luma(&codes[1]), reference.width as usize),
        eps_s: eps_s(reference, image),
        eps_v: None,
        max_error: f64::from(max_error),
        max_radiance_error: exposure_stops.map(|_| f64::from(max_radiance_error)),
        differing_share: differing as f64 / pixels.max(1) as f64,
        pixels,
        not_finite,
        exposure_stops,
    };
    Ok((comparison, difference(reference.width, reference.height, &errors)))
}

/// The sRGB code of a linear value, not rounded.
fn srgb_code(linear: f32) -> f32 {
    let c = linear.clamp(0.0, 1.0);
    if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
}

/// Errors in false colours, magenta where there is none to tell. The square root lets small ones be seen.
fn difference(width: u32, height: u32, errors: &[f32]) -> Picture {
    let color = |error: &f32| if error.is_nan() { [1.0, 0.0, 1.0] } else { heat(error.sqrt()) };
    Picture::of_colors(width, height, errors.iter().map(color).collect())
}

/// Whether a pixel shows a surface, as far as a picture tells.
fn is_surface(picture: &Compared, pixel: usize) -> bool {
    picture.surface.as_ref().is_none_or(|surface| surface[pixel])
}

fn eps_s(reference: &Compared, image: &Compared) -> Option<f64> {
    let (a, b) = (reference.shadow.as_ref()?, image.shadow.as_ref()?);
    let (mut sum, mut count) = (0.0, 0u64);
    for (i, (a, b)) in a.iter().zip(b).enumerate() {
        if is_surface(reference, i) && a.is_finite() && b.is_finite() {
            sum += f64::from((a - b).abs());
            count += 1;
        }
    }
    (count > 0).then(|| sum / count as f64)
}

/// eps_v from the light bits of both pictures, files of uint32 (height, width, words); read side by side.
pub fn eps_v<R: Read>(
    reference: &Compared,
    names: [&str; 2],
    files: [R; 2],
) -> Result<Option<f64>, CompareError> {
    let lights = reference.lights.ok_or(CompareError::NoLightCount)?;
    let words = lights.div_ceil(32) as usize;
    let shape = [u64::from(reference.height), u64::from(reference.width), words as u64].map(Some);
    let [name_a, name_b] = names;
    let [file_a, file_b] = files;
    let mut a = ArrayReader::<u32, R>::new(name_a, file_a, &[&shape])?;
    let mut b = ArrayReader::<u32, R>::new(name_b, file_b, &[&shape])?;
    if words == 0 {
        return Ok(None);
    }
    let mut buffers = [vec![0u32; (BITS_AT_ONCE / words).max(1) * words], Vec::new()];
    buffers[1] = buffers[0].clone();
    let (mut wrong, mut surfaces, mut pixel) = (0u64, 0u64, 0);
    loop {
        let count = a.read(&mut buffers[0])?;
        let same = b.read(&mut buffers[1])?;
        debug_assert_eq!(count, same, "both have one shape");
        if count == 0 {
            break;
        }
        let pixels = buffers[0][..count].chunks(words).zip(buffers[1][..count].chunks(words));
        for (a, b) in pixels {
            if is_surface(reference, pixel) {
                wrong += a.iter().zip(b).map(|(a, b)| u64::from((a ^ b).count_ones())).sum::<u64>();
                surfaces += 1;
            }
            pixel += 1;
        }
    }
    Ok((surfaces > 0).then(|| wrong as f64 / (surfaces * lights) as f64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::Random;
    use crate::npy;

    fn radiance(seed: u64) -> Compared {
        let mut random = Random::new(seed);
        let color = (0..16 * 12).map(|_| [0; 3].map(|_: i32| random.unit() as f32)).collect();
        Compared {
            width: 16,
            height: 12,
            color: Color::Radiance(color),
            shadow: Some((0..16 * 12).map(|_| random.unit() as f32).collect()),
            surface: Some(vec![true; 16 * 12]),
            lights: Some(40),
            exposure_stops: Some(0.5),
        }
    }

    fn values(picture: &mut Compared) -> &mut Vec<[f32; 3]> {
        match &mut picture.color {
            Color::Radiance(values) | Color::Codes(values) => values,
        }
    }

    #[test]
    fn a_picture_equals_itself() {
        let a = radiance(1);
        let (found, difference) = compare(&a, &a, Exposure::Auto).unwrap();
        assert_eq!(found.psnr_db, f64::INFINITY);
        assert!((found.ssim.unwrap() - 1.0).abs() < 1e-9);
        assert_eq!((found.eps_s, found.max_error, found.differing_share), (Some(0.0), 0.0, 0.0));
        assert_eq!((found.pixels, found.not_finite, found.exposure_stops), (192, [0, 0], Some(0.5)));
        assert!(difference.display.iter().all(|c| *c == difference.display[0]));
    }

    #[test]
    fn psnr_of_a_known_error() {
        let codes = |value: f32| Compared {
            color: Color::Codes(vec![[value; 3]; 192]),
            shadow: None,
            lights: None,
            ..radiance(1)
        };
        let (found, _) = compare(&codes(0.5), &codes(0.6), Exposure::Auto).unwrap();
        assert!((found.psnr_db - 20.0).abs() < 1e-5, "a tenth everywhere: {}", found.psnr_db);
        assert_eq!((found.differing_share, found.eps_s, found.max_radiance_error), (1.0, None, None));
        let mut one = codes(0.5);
        values(&mut one)[7][1] += 1.0 / 255.0;
        values(&mut one)[8][1] += 0.5 / 255.0;
        let (found, _) = compare(&codes(0.5), &one, Exposure::Auto).unwrap();
        assert!((found.differing_share - 1.0 / 192.0).abs() < 1e-12);
    }

    #[test]
    fn pixels_that_are_not_finite_are_counted_and_left_out() {
        let a = radiance(1);
        let mut b = a.clone();
        values(&mut b)[100][2] = f32::NAN;
        let (found, difference) = compare(&a, &b, Exposure::Auto).unwrap();
        assert_eq!((found.not_finite, found.pixels, found.max_error), ([0, 1], 191, 0.0));
        assert_eq!(found.psnr_db, f64::INFINITY);
        assert_eq!(difference.display[100], [255, 0, 255]);
        *values(&mut b) = vec![[f32::INFINITY; 3]; 192];
        let (found, _) = compare(&a, &b, Exposure::Auto).unwrap();
        assert!(found.psnr_db.is_nan() && found.ssim.is_none() && found.pixels == 0);
    }

    #[test]
    fn shadow_errors_count_surfaces_alone() {
        let mut a = radiance(1);
        a.shadow = Some(vec![0.25; 192]);
        a.surface = Some((0..192).map(|i| i < 96).collect());
        let mut b = a.clone();
        b.shadow = Some((0..192).map(|i| if i < 48 { 0.75 } else { 0.25 }).collect());
        assert_eq!(compare(&a, &b, Exposure::Auto).unwrap().0.eps_s, Some(0.25));
        b.shadow = None;
        assert_eq!(compare(&a, &b, Exposure::Auto).unwrap().0.eps_s, None);
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        let a = radiance(1);
        let wide = Compared { width: 24, height: 8, ..radiance(1) };
        let png = Compared { color: Color::Codes(vec![[0.0; 3]; 192]), ..radiance(1) };
        let lights = Compared { lights: Some(41), ..radiance(1) };
        assert!(matches!(compare(&a, &wide, Exposure::Auto), Err(CompareError::Sizes { .. })));
        assert!(matches!(compare(&a, &png, Exposure::Auto), Err(CompareError::Kinds)));
        assert!(matches!(compare(&a, &lights, Exposure::Auto), Err(CompareError::Lights { .. })));
    }

    #[test]
    fn light_bits_are_counted_one_by_one() {
        let mut a = radiance(1);
        a.surface = Some((0..192).map(|i| i != 5).collect());
        let file = |bits: &[u32]| {
            let mut bytes = Vec::new();
            npy::write_header::<u32>(&mut bytes, &[12, 16, 2]).unwrap();
            npy::write_elements(&mut bytes, bits).unwrap();
            bytes
        };
        let zero = vec![0; 384];
        let mut some = zero.clone();
        // Three wrong bits on surfaces, two where there is none.
        (some[0], some[1], some[383]) = (1 << 31, 1 << 7, 1);
        some[10] = 3;
        let files = [file(&zero), file(&some)];
        let found = eps_v(&a, ["a", "b"], [files[0].as_slice(), files[1].as_slice()]).unwrap();
        assert_eq!(found, Some(3.0 / (191.0 * 40.0)));
        let wrong = Compared { lights: Some(80), ..a.clone() };
        let error = eps_v(&wrong, ["a.npy", "b"], [files[0].as_slice(), files[1].as_slice()]).unwrap_err();
        assert!(error.to_string().contains("a.npy") && error.to_string().contains("(12, 16, 3)"), "{error}");
        let unknown = Compared { lights: None, ..a };
        let error = eps_v(&unknown, ["a", "b"], [files[0].as_slice(), files[1].as_slice()]).unwrap_err();
        assert!(matches!(error, CompareError::NoLightCount));
    }
}
