//! `manyview compare`.

use std::path::{Path, PathBuf};

use manyview::preview::{PictureFormat, write_picture};
use manyview::render::compare::{CompareError, Comparison, compare, eps_v};
use manyview::render::image::Exposure;
use manyview::render::read::read_picture;
use serde_json::{Value, json};

use super::Format;
use super::cancel;
use super::error::{CliError, CliResult, Exit, open_input};
use super::output::{count, print, print_json};
use super::overwrite::check_outputs;
use super::render::exposure;

/// Options of `compare`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Options {
    /// The picture that is right: .exr or .png
    #[arg(value_name = "REF")]
    reference: PathBuf,
    /// The picture to judge, of the same kind and size
    #[arg(value_name = "IMG")]
    image: PathBuf,
    /// A picture of the differences: from dark blue over red to yellow, magenta where a colour is not finite
    #[arg(short, long, value_name = "DIFF.png|DIFF.exr")]
    output: Option<PathBuf>,
    /// Light bits of both pictures (`render --light-bits`), for eps_v
    #[arg(long, num_args = 2, value_names = ["REF.npy", "IMG.npy"])]
    light_bits: Option<Vec<PathBuf>>,
    /// Stops that both EXRs are tone-mapped for; `auto` takes the reference's own
    #[arg(long, value_name = "EV|auto", default_value = "auto", value_parser = exposure, allow_hyphen_values = true)]
    exposure: Exposure,
    /// Of the result on stdout
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

const AFTER_HELP: &str = "\
PSNR, SSIM (Gaussian window of 11 × 11, of luma) and errors are of sRGB codes from 0 to 1 as a screen would show them, not \
rounded; EXRs are tone-mapped as `render` does. eps_s is the mean difference of shadow values, eps_v the share of lights \
whose visibility differs; both over pixels that show a surface in REF. Pixels with a colour that is not finite are counted \
and left out. In JSON a measure that does not exist is null; so is the PSNR of pictures that are equal.";

/// Runs `compare`.
pub(crate) fn run(options: &Options) -> CliResult {
    let format = match &options.output {
        Some(path) => Some(PictureFormat::of_path(path).ok_or_else(|| {
            CliError::usage(format!("{}: name the picture with the ending .png or .exr", path.display()))
        })?),
        None => None,
    };
    if let Some(output) = &options.output {
        let bits = options.light_bits.iter().flatten().map(|path| ("--light-bits", &**path));
        let inputs: Vec<_> =
            [("REF", &*options.reference), ("IMG", &*options.image)].into_iter().chain(bits).collect();
        check_outputs(&inputs, &[("--output", output)])?;
    }
    let read = |path: &Path| read_picture(path).map_err(|error| CliError::new(Exit::BadInput, error));
    let (reference, image) = (read(&options.reference)?, read(&options.image)?);
    cancel::check()?;
    let bad = |error: CompareError| CliError::new(Exit::BadInput, error);
    let (mut comparison, difference) = compare(&reference, &image, options.exposure).map_err(bad)?;
    if let Some([a, b]) = options.light_bits.as_deref() {
        let names = [a, b].map(|path| path.display().to_string());
        let files =
            [open_input(a)?, open_input(b)?].map(|file| std::io::BufReader::with_capacity(1 << 20, file));
        comparison.eps_v = eps_v(&reference, [&names[0], &names[1]], files).map_err(bad)?;
    }
    if let Some((path, format)) = options.output.as_ref().zip(format) {
        write_picture(path, format, &difference)?;
    }
    match options.format {
        Format::Text => print(&text(&comparison))?,
        Format::Json => print_json(&json(&comparison))?,
    }
    Ok(Exit::Done)
}

fn text(found: &Comparison) -> String {
    let percent = |share: f64| format!("{:.3}%", share * 100.0);
    let known = |value: Option<String>| value.unwrap_or_else(|| "–".to_owned());
    let mut lines = vec![
        ("eps_v", known(found.eps_v.map(percent))),
        ("eps_s", known(found.eps_s.map(percent))),
        ("PSNR", if found.pixels > 0 { format!("{:.2} dB", found.psnr_db) } else { "–".to_owned() }),
        ("SSIM", known(found.ssim.map(|ssim| format!("{ssim:.4}")))),
        ("largest error", format!("{:.4}", found.max_error)),
        ("differing pixels", percent(found.differing_share)),
    ];
    if let Some(error) = found.max_radiance_error {
        lines.push(("largest error of radiance", format!("{error:.4}")));
    }
    if let Some(stops) = found.exposure_stops {
        lines.push(("exposure", format!("{stops:+.2} stops")));
    }
    if found.not_finite != [0, 0] {
        let [a, b] = found.not_finite.map(count);
        lines.push(("not finite, left out", format!("{a} pixels of the first, {b} of the second")));
    }
    lines.iter().map(|(name, value)| format!("{name:<26}{value}\n")).collect()
}

fn json(found: &Comparison) -> Value {
    let finite = |value: f64| value.is_finite().then_some(value);
    json!({
        "eps_v": found.eps_v,
        "eps_s": found.eps_s,
        "psnr_db": finite(found.psnr_db),
        "equal": found.psnr_db == f64::INFINITY,
        "ssim": found.ssim,
        "max_error": found.max_error,
        "max_radiance_error": found.max_radiance_error,
        "differing_share": found.differing_share,
        "pixels": found.pixels,
        "not_finite": found.not_finite,
        "exposure_stops": found.exposure_stops,
    })
}
