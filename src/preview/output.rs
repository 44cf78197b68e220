//! PNG and EXR files of pictures.

use std::io::{self, Seek, Write};
use std::path::Path;

use exr::prelude::{
    AnyChannel, AnyChannels, AttributeValue, Compression, Encoding, FlatSamples, Image, Layer,
    LayerAttributes, LineOrder, SmallVec, WritableImage,
};
use image::{ExtendedColorType, ImageEncoder, codecs::png};
use manyview_cache::atomic::{AtomicFile, AtomicFileError};

use super::picture::{Extra, Picture};

/// The EXR attribute that holds [`Picture::note`].
pub const NOTE_ATTRIBUTE: &str = "manyview";

/// A kind of picture file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PictureFormat {
    /// 8 bits a channel, as on a screen.
    Png,
    /// 32-bit floats: linear colour in R, G, B, and the other layers as `layer.channel`.
    Exr,
}

impl PictureFormat {
    /// The format that a path's extension names.
    pub fn of_path(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "png" => Some(Self::Png),
            "exr" => Some(Self::Exr),
            _ => None,
        }
    }
}

/// Writes a picture to `path`: all of it, or nothing.
pub fn write_picture(path: &Path, format: PictureFormat, picture: &Picture) -> Result<(), AtomicFileError> {
    let mut file = AtomicFile::create(path)?;
    let written = match format {
        PictureFormat::Png => write_png(&mut file, picture),
        PictureFormat::Exr => write_exr(&mut file, picture),
    };
    written.map_err(|source| AtomicFileError { path: path.to_owned(), action: "write it", source })?;
    file.commit()
}

/// Writes a PNG.
pub fn write_png(file: &mut impl Write, picture: &Picture) -> io::Result<()> {
    let encoder =
        png::PngEncoder::new_with_quality(file, png::CompressionType::Default, png::FilterType::Adaptive);
    encoder
        .write_image(picture.display.as_flattened(), picture.width, picture.height, ExtendedColorType::Rgb8)
        .map_err(io::Error::other)
}

/// Writes an EXR with ZIP compression.
pub fn write_exr(file: &mut (impl Write + Seek), picture: &Picture) -> io::Result<()> {
    fn plane(name: String, values: impl Iterator<Item = f32>) -> AnyChannel<FlatSamples> {
        AnyChannel::new(name.as_str(), FlatSamples::F32(values.collect()))
    }
    let mut channels: SmallVec<[_; 4]> = SmallVec::new();
    for (i, name) in ["R", "G", "B"].into_iter().enumerate() {
        channels.push(plane(name.to_owned(), picture.color.iter().map(|c| c[i])));
    }
    for (layer, extra) in &picture.layers {
        match extra {
            Extra::Scalar(values) => channels.push(plane(format!("{layer}.Z"), values.iter().copied())),
            Extra::Vector(values) | Extra::Color(values) => {
                let names = if matches!(extra, Extra::Color(_)) { ["R", "G", "B"] } else { ["X", "Y", "Z"] };
                for (i, name) in names.into_iter().enumerate() {
                    channels.push(plane(format!("{layer}.{name}"), values.iter().map(|v| v[i])));
                }
            }
        }
    }
    let size = (picture.width as usize, picture.height as usize);
    let encoding = Encoding {
        compression: Compression::ZIP16,
        line_order: LineOrder::Increasing,
        blocks: exr::image::Blocks::ScanLines,
    };
    let mut attributes = LayerAttributes::default();
    if let Some(note) = &picture.note {
        // One attribute for all: `exr` writes several in the random order of a hash map.
        let text = AttributeValue::Text(note.as_str().into());
        attributes.other.insert(NOTE_ATTRIBUTE.into(), text);
    }
    let layer = Layer::new(size, attributes, encoding, AnyChannels::sort(channels));
    Image::from_layer(layer).write().to_buffered(file).map_err(io::Error::other)
}
