//! Images that the drawn materials need, decoded in parallel.

use super::error::ImportError;
use super::json::Json;
use super::resources::Resources;
use crate::scene::{Texture, Wrap};
use glam::Vec2;
use image::ImageReader;
use rayon::prelude::*;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;

/// Texels beyond this number must be backed by encoded bytes.
const MAX_UNBACKED_TEXELS: u64 = 1 << 24;
/// Most texels that a byte of an encoded image can sensibly stand for: deflate reaches about 1000.
const MAX_TEXELS_PER_BYTE: u64 = 4096;

/// Where in texture space a material looks its texture up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct UvUse {
    /// Number of the texture coordinate set.
    pub(super) set: usize,
    offset: [f64; 2],
    sin_cos: [f64; 2],
    scale: [f64; 2],
}

impl UvUse {
    /// Reads a texture reference of a material, `KHR_texture_transform` included.
    fn parse(reference: &Json<'_>) -> Result<Self, ImportError> {
        let set = reference.index("texCoord")?.unwrap_or(0);
        let Some(transform) = reference.extension("KHR_texture_transform") else {
            return Ok(Self { set, offset: [0.0; 2], sin_cos: [0.0, 1.0], scale: [1.0; 2] });
        };
        Ok(Self {
            set: transform.index("texCoord")?.unwrap_or(set),
            offset: transform.numbers("offset")?.unwrap_or([0.0; 2]),
            sin_cos: sin_cos(transform.number("rotation")?.unwrap_or(0.0)),
            scale: transform.numbers("scale")?.unwrap_or([1.0; 2]),
        })
    }

    /// Scales, then rotates (counter-clockwise as seen in the image, whose v runs down), then moves.
    pub(super) fn apply(&self, uv: [f32; 2]) -> Vec2 {
        let (u, v) = (f64::from(uv[0]) * self.scale[0], f64::from(uv[1]) * self.scale[1]);
        let [sin, cos] = self.sin_cos;
        Vec2::new((cos * u + sin * v + self.offset[0]) as f32, (cos * v - sin * u + self.offset[1]) as f32)
    }
}

/// Sine and cosine by their series: the same bits on every host.
fn sin_cos(angle: f64) -> [f64; 2] {
    let x = angle - (angle / std::f64::consts::TAU).round() * std::f64::consts::TAU;
    let (mut sin, mut cos) = (0.0, 0.0);
    let mut term = 1.0;
    for order in 0..32_u32 {
        match order % 4 {
            0 => cos += term,
            1 => sin += term,
            2 => cos -= term,
            _ => sin -= term,
        }
        term *= x / f64::from(order + 1);
    }
    [sin, cos]
}

/// A texture that will be decoded: images to try in turn, and what happens beyond their edges.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Request {
    place: String,
    images: Vec<usize>,
    wrap: [Wrap; 2],
}

/// Textures in the order in which materials ask for them.
#[derive(Debug, Default)]
pub(super) struct Textures {
    requests: Vec<Request>,
    /// Positions of requests by images and wrap modes.
    known: BTreeMap<(Vec<usize>, [u8; 2]), u32>,
}

impl Textures {
    /// Notes a texture reference of a material. The texture is `None` if there is nothing to decode.
    pub(super) fn request(
        &mut self,
        resources: &Resources<'_>,
        reference: &Json<'_>,
    ) -> Result<(Option<u32>, UvUse), ImportError> {
        let uv = UvUse::parse(reference)?;
        let texture = resources.root.item("textures", texture_index(resources, reference)?)?;
        let webp = texture
            .extension("EXT_texture_webp")
            .map(|webp| webp.reference("source", &resources.root, "images"))
            .transpose()?
            .flatten();
        let images: Vec<usize> =
            webp.into_iter().chain(texture.reference("source", &resources.root, "images")?).collect();
        if images.is_empty() {
            let extensions = texture.object("extensions")?.map(|extensions| extensions.keys().join(", "));
            let why = extensions
                .map_or_else(|| "no source".to_owned(), |names| format!("no source but that of {names}"));
            resources.warn(format!("{}: has {why}; the factor is used alone", texture.place()));
            return Ok((None, uv));
        }
        let wrap = match texture.reference("sampler", &resources.root, "samplers")? {
            None => [Wrap::Repeat; 2],
            Some(sampler) => {
                let sampler = resources.root.item("samplers", sampler)?;
                [wrap(resources, &sampler, "wrapS")?, wrap(resources, &sampler, "wrapT")?]
            }
        };
        let index = *self.known.entry((images.clone(), wrap.map(|wrap| wrap as u8))).or_insert_with(|| {
            self.requests.push(Request { place: texture.place(), images, wrap });
            self.requests.len() as u32 - 1
        });
        Ok((Some(index), uv))
    }

    /// Decodes all textures; those that fail are `None`, and a warning says why.
    pub(super) fn decode(self, resources: &Resources<'_>) -> Result<Vec<Option<Texture>>, ImportError> {
        // Files are read and memory is counted one after the other, so that the outcome depends on nothing else.
        let mut jobs = Vec::new();
        for request in &self.requests {
            let mut candidates = Vec::new();
            let mut complaints = Vec::new();
            for image in &request.images {
                match prepare(resources, *image)? {
                    Ok(bytes) => candidates.push((*image, bytes)),
                    Err(complaint) => complaints.push(complaint),
                }
            }
            jobs.push((request, candidates, complaints));
        }
        let decoded: Vec<(Option<Texture>, Vec<String>)> = jobs
            .into_par_iter()
            .map(|(request, candidates, mut complaints)| {
                for (image, bytes) in candidates {
                    match decode(&bytes, request.wrap) {
                        Ok(texture) => return (Some(texture), complaints),
                        Err(error) => complaints.push(format!("images[{image}]: {error}")),
                    }
                }
                (None, complaints)
            })
            .collect();
        let mut textures = Vec::new();
        for (request, (texture, complaints)) in self.requests.iter().zip(decoded) {
            if texture.is_none() {
                resources.warn(format!(
                    "{}: cannot be used ({}); as base colour it counts as white, as emission as black",
                    request.place,
                    complaints.join("; ")
                ));
            }
            textures.push(texture);
        }
        Ok(textures)
    }
}

fn texture_index(resources: &Resources<'_>, reference: &Json<'_>) -> Result<usize, ImportError> {
    let index = reference.reference("index", &resources.root, "textures")?;
    index.ok_or_else(|| reference.malformed_at("index", "is missing"))
}

fn wrap(resources: &Resources<'_>, sampler: &Json<'_>, key: &str) -> Result<Wrap, ImportError> {
    Ok(match sampler.index(key)? {
        None | Some(10497) => Wrap::Repeat,
        Some(33648) => Wrap::MirroredRepeat,
        Some(33071) => Wrap::ClampToEdge,
        Some(other) => {
            resources.warn(format!("{}: {other} is no wrap mode; REPEAT is used", sampler.place_of(key)));
            Wrap::Repeat
        }
    })
}

/// Encoded bytes of an image whose size is plausible and paid for; the inner error is a reason not to use it.
fn prepare<'r>(
    resources: &'r Resources<'_>,
    index: usize,
) -> Result<Result<Cow<'r, [u8]>, String>, ImportError> {
    let image = resources.root.item("images", index)?;
    let loaded = match (image.reference("bufferView", &resources.root, "bufferViews")?, image.string("uri")?)
    {
        (Some(view), _) => resources.view(view).map(|view| Cow::Borrowed(view.bytes)),
        (None, Some(uri)) => resources.load(&image.place_of("uri"), uri).map(Cow::Owned),
        (None, None) => Err(image.malformed("has neither uri nor bufferView")),
    };
    let bytes = match loaded {
        Ok(bytes) => bytes,

        // Warnings are part of the scene, so no path of this machine may be in them.
        Err(ImportError::Unreadable { place, source, .. }) => {
            return Ok(Err(format!("{place} cannot be read: {}", source.kind())));
        }
        Err(ImportError::Malformed { place, rule, .. }) => return Ok(Err(format!("{place}: {rule}"))),
        Err(error) => return Err(error),
    };
    let size =
        ImageReader::new(Cursor::new(&bytes[..])).with_guessed_format().map_err(image::ImageError::from);
    match size.and_then(ImageReader::into_dimensions) {
        Ok((width, height)) => {
            let texels = u64::from(width) * u64::from(height);
            if texels > MAX_UNBACKED_TEXELS && texels / MAX_TEXELS_PER_BYTE > bytes.len() as u64 {
                let place = image.place();
                return Ok(Err(format!(
                    "{place}: {width} x {height} texels cannot come from {} bytes",
                    bytes.len()
                )));
            }
            resources.charge(texels * 4, &image.place())?;
            Ok(Ok(bytes))
        }
        Err(error) => Ok(Err(format!("{}: {error}", image.place()))),
    }
}

fn decode(bytes: &[u8], wrap: [Wrap; 2]) -> Result<Texture, image::ImageError> {
    let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format()?;
    // The size was checked and counted against the memory limit by now.
    reader.no_limits();
    let image = reader.decode()?.into_rgba8();
    let (width, height) = image.dimensions();
    Ok(Texture { width, height, texels: image.into_raw().as_chunks::<4>().0.to_vec(), wrap })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_series_agree_with_known_angles() {
        use std::f64::consts::{FRAC_1_SQRT_2, PI};
        let cases = [
            (0.0, 0.0, 1.0),
            (PI / 2.0, 1.0, 0.0),
            (PI, 0.0, -1.0),
            (-PI / 4.0, -FRAC_1_SQRT_2, FRAC_1_SQRT_2),
            (PI / 6.0 + 20.0 * PI, 0.5, 0.75_f64.sqrt()),
        ];
        for (angle, sin, cos) in cases {
            let [s, c] = sin_cos(angle);
            assert!((s - sin).abs() < 1e-13 && (c - cos).abs() < 1e-13, "{angle}: {s}, {c}");
        }
    }

    #[test]
    fn texture_transforms_scale_then_rotate_then_move() {
        let json = json!({"texCoord": 0, "extensions": {"KHR_texture_transform":
            {"offset": [10, 20], "rotation": std::f64::consts::FRAC_PI_2, "scale": [2, 3], "texCoord": 1}}});
        let uv = UvUse::parse(&Json::root("s.gltf", &json)).unwrap();
        assert_eq!(uv.set, 1);
        // (1, 0) scales to (2, 0); a quarter turn counter-clockwise, v down, makes it (0, -2).
        assert!(uv.apply([1.0, 0.0]).abs_diff_eq(Vec2::new(10.0, 18.0), 1e-6));
        assert!(uv.apply([0.0, 1.0]).abs_diff_eq(Vec2::new(13.0, 20.0), 1e-6));
    }

    #[test]
    fn rotation_turns_the_way_of_the_khronos_test_model() {
        // TextureTransformTest: turned by 22.5 degrees, the arrow's tip, at (7/9, 7/9) of its image, must show up at the
        // marker "correct", which is 0.0790 left of and 0.5163 below the middle of the quad.
        let json =
            json!({"extensions": {"KHR_texture_transform": {"rotation": std::f64::consts::FRAC_PI_8}}});
        let uv = UvUse::parse(&Json::root("s.gltf", &json)).unwrap();
        assert!(uv.apply([0.5 - 0.0790, 0.5 + 0.5163]).abs_diff_eq(Vec2::splat(7.0 / 9.0), 1e-3));
    }
}
