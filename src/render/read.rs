//! Pictures from files, to be compared.

use super::compare::{Color, Compared};
use super::gbuffer::MAX_PIXELS;
use crate::preview::{NOTE_ATTRIBUTE, PictureFormat};
use exr::meta::MetaData;
use exr::prelude::{AttributeValue, FlatSamples, ReadChannels, ReadLayers, Text};
use image::ImageReader;
use serde_json::Value;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The most channels of an EXR.
const MAX_CHANNELS: usize = 256;

/// Why a picture cannot be read.
#[derive(Debug, Error)]
#[error("{}: {reason}", path.display())]
pub struct ReadPictureError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong, and what would do.
    pub reason: String,
}

/// Reads a PNG or EXR picture.
pub fn read_picture(path: &Path) -> Result<Compared, ReadPictureError> {
    let read = match PictureFormat::of_path(path) {
        Some(PictureFormat::Exr) => read_exr(path),
        Some(PictureFormat::Png) => read_png(path),
        None => Err("pictures end in .png or .exr".to_owned()),
    };
    read.map_err(|reason| ReadPictureError { path: path.to_owned(), reason })
}

fn check_size(width: usize, height: usize) -> Result<[u32; 2], String> {
    match (width as u64).checked_mul(height as u64) {
        Some(1..=MAX_PIXELS) => Ok([width as u32, height as u32]),
        _ => Err(format!("{width} × {height} pixels; a picture has 1 to {MAX_PIXELS}")),
    }
}

fn unreadable(error: &std::io::Error) -> String {
    format!("cannot be read: {error}; check that the file is there and readable")
}

fn read_png(path: &Path) -> Result<Compared, String> {
    let open = || {
        let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format);
        reader.map_err(|error| unreadable(&error))
    };
    let broken = |error: image::ImageError| format!("no readable picture: {error}");
    let (width, height) = open()?.into_dimensions().map_err(broken)?;
    let [width, height] = check_size(width as usize, height as usize)?;
    let picture = open()?.decode().map_err(broken)?.into_rgb32f();
    let color = picture.pixels().map(|pixel| pixel.0).collect();
    Ok(Compared {
        width,
        height,
        color: Color::Codes(color),
        shadow: None,
        surface: None,
        lights: None,
        exposure_stops: None,
    })
}

fn read_exr(path: &Path) -> Result<Compared, String> {
    let open = || {
        let file = fs_err::File::open(path).map_err(|error| unreadable(&error))?;
        Ok::<_, String>(BufReader::new(file))
    };
    let broken = |error: exr::error::Error| format!("no readable EXR: {error}");
    // Sizes first, before memory is taken for them.
    let meta = MetaData::read_from_buffered(open()?, false).map_err(broken)?;
    for header in &meta.headers {
        check_size(header.layer_size.x(), header.layer_size.y())?;
        let channels = header.channels.list.len();
        if channels > MAX_CHANNELS {
            return Err(format!("{channels} channels are more than {MAX_CHANNELS}"));
        }
    }
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_buffered(open()?)
        .map_err(broken)?;
    let layer = image.layer_data;
    let [width, height] = check_size(layer.size.x(), layer.size.y())?;
    let channel = |name: &str| -> Option<Vec<f32>> {
        let channels = layer.channel_data.list.iter();
        let found = channels.into_iter().find(|channel| channel.name.eq(name))?;
        Some(match &found.sample_data {
            FlatSamples::F32(values) => values.clone(),
            FlatSamples::F16(values) => values.iter().map(|value| value.to_f32()).collect(),
            FlatSamples::U32(values) => values.iter().map(|&value| value as f32).collect(),
        })
    };
    let needed = |name: &str| {
        let names: Vec<String> = layer.channel_data.list.iter().map(|c| c.name.to_string()).collect();
        channel(name).ok_or_else(|| format!("the channel {name} is missing; there are {}", names.join(", ")))
    };
    let (r, g, b) = (needed("R")?, needed("G")?, needed("B")?);
    let color = r.into_iter().zip(g).zip(b).map(|((r, g), b)| [r, g, b]).collect();
    let note = match layer.attributes.other.get(&Text::from(NOTE_ATTRIBUTE)) {
        Some(AttributeValue::Text(text)) => serde_json::from_str(&text.to_string()).unwrap_or(Value::Null),
        _ => Value::Null,
    };
    Ok(Compared {
        width,
        height,
        color: Color::Radiance(color),
        shadow: channel("shadow.Z"),
        surface: channel("depth.Z").map(|depths| depths.iter().map(|depth| depth.is_finite()).collect()),
        lights: note["lights"].as_u64(),
        exposure_stops: note["exposure_stops"].as_f64().map(|stops| stops as f32).filter(|s| s.abs() <= 60.0),
    })
}
