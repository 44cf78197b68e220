//! Writes a [`Scene`] as binary glTF 2.0.
//!
//! Every size is known before the first byte is written, so the file is streamed: beside the scene itself only the JSON
//! and the encoded textures are held in memory. The same scene gives the same bytes.

use std::io::{self, Write};

use glam::Vec4;
use thiserror::Error;

use crate::scene::{Mesh, Scene};

mod document;
mod schema;

use document::{Component, Document, Payload};

/// Why a scene could not be written.
#[derive(Debug, Error)]
pub enum GlbError {
    /// The output refused bytes.
    #[error("cannot write the scene")]
    Io(#[from] io::Error),
    /// A GLB holds its own length in 32 bits.
    #[error(
        "the scene takes {bytes} bytes, but a .glb can hold at most 4294967295 bytes: generate fewer triangles"
    )]
    TooLarge {
        /// Bytes of the whole file.
        bytes: u64,
    },
    /// A texture cannot be a PNG.
    #[error("texture {texture} cannot be written as a PNG")]
    Texture {
        /// Index into [`Scene::textures`].
        texture: usize,
        /// What the encoder said.
        source: image::ImageError,
    },
    /// The scene breaks its own rules.
    #[error("mesh {mesh} ({name:?}): {problem}")]
    Mesh {
        /// Index into [`Scene::meshes`].
        mesh: usize,
        /// Its name.
        name: String,
        /// What is wrong.
        problem: &'static str,
    },
}

const MAGIC: &[u8; 4] = b"glTF";
const VERSION: u32 = 2;
const JSON_CHUNK: &[u8; 4] = b"JSON";
const BINARY_CHUNK: &[u8; 4] = b"BIN\0";

/// Writes `scene` as a `.glb`: meshes, one node an instance, materials, textures as PNG, and lights. Meshes without
/// triangles are left out, with their instances. Buffer the output: values are written a few bytes at a time.
pub fn write_glb(scene: &Scene, output: &mut impl Write) -> Result<(), GlbError> {
    for (index, mesh) in scene.meshes.iter().enumerate() {
        check(mesh).map_err(|problem| GlbError::Mesh { mesh: index, name: mesh.name.clone(), problem })?;
    }
    let document = Document::new(scene)?;
    let mut json = serde_json::to_vec(&document.root).map_err(io::Error::from)?;
    json.resize(json.len().next_multiple_of(4), b' ');
    let binary_length = document.binary_length;
    let binary_chunk = if binary_length == 0 { 0 } else { 8 + binary_length };
    let total = 12 + 8 + json.len() as u64 + binary_chunk;
    let length = u32::try_from(total).map_err(|_| GlbError::TooLarge { bytes: total })?;

    output.write_all(MAGIC)?;
    output.write_all(&VERSION.to_le_bytes())?;
    output.write_all(&length.to_le_bytes())?;
    // Both lengths are below the total, which fits.
    output.write_all(&(json.len() as u32).to_le_bytes())?;
    output.write_all(JSON_CHUNK)?;
    output.write_all(&json)?;
    if binary_length > 0 {
        output.write_all(&(binary_length as u32).to_le_bytes())?;
        output.write_all(BINARY_CHUNK)?;
        for payload in &document.payloads {
            let written = write_payload(scene, payload, output)?;
            output.write_all(&[0; 4][..(written.next_multiple_of(4) - written) as usize])?;
        }
    }
    output.flush()?;
    Ok(())
}

/// The rules that a wrong file could result from.
fn check(mesh: &Mesh) -> Result<(), &'static str> {
    let vertices = mesh.positions.len();
    let lengths = [mesh.normals.len(), mesh.base_color_uvs.len(), mesh.emissive_uvs.len(), mesh.colors.len()];
    if lengths.iter().any(|length| *length != 0 && *length != vertices) {
        return Err("an attribute has another count than the positions");
    }
    if mesh.triangles.iter().flatten().any(|index| *index as usize >= vertices) {
        return Err("a triangle refers to a vertex that does not exist");
    }
    if !mesh.positions.iter().all(|position| position.is_finite()) {
        return Err("a position is not finite");
    }
    Ok(())
}

/// Writes one buffer view and returns its bytes without padding.
fn write_payload(scene: &Scene, payload: &Payload, output: &mut impl Write) -> io::Result<u64> {
    let mut written = 0;
    let mut write = |bytes: &[u8]| {
        written += bytes.len() as u64;
        output.write_all(bytes)
    };
    match payload {
        Payload::Png(bytes) => write(bytes)?,
        Payload::Positions(mesh) => {
            scene.meshes[*mesh].positions.iter().try_for_each(|p| write_floats(&mut write, p.to_array()))?;
        }
        Payload::Normals(mesh) => {
            scene.meshes[*mesh].normals.iter().try_for_each(|n| write_floats(&mut write, n.to_array()))?;
        }
        Payload::BaseColorUvs(mesh) => {
            scene.meshes[*mesh]
                .base_color_uvs
                .iter()
                .try_for_each(|uv| write_floats(&mut write, uv.to_array()))?;
        }
        Payload::EmissiveUvs(mesh) => {
            scene.meshes[*mesh]
                .emissive_uvs
                .iter()
                .try_for_each(|uv| write_floats(&mut write, uv.to_array()))?;
        }
        Payload::Colors(mesh, Component::U8) => {
            scene.meshes[*mesh]
                .colors
                .iter()
                .try_for_each(|c| write(&color_in_bytes(*c).unwrap_or_default()))?;
        }
        Payload::Colors(mesh, _) => {
            scene.meshes[*mesh].colors.iter().try_for_each(|c| write_floats(&mut write, c.to_array()))?;
        }
        Payload::Indices(mesh, component) => {
            for index in scene.meshes[*mesh].triangles.iter().flatten() {
                let bytes = index.to_le_bytes();
                write(if *component == Component::U16 { &bytes[..2] } else { &bytes })?;
            }
        }
    }
    Ok(written)
}

fn write_floats<const N: usize>(
    write: &mut impl FnMut(&[u8]) -> io::Result<()>,
    values: [f32; N],
) -> io::Result<()> {
    values.iter().try_for_each(|value| write(&value.to_le_bytes()))
}

/// A colour as bytes in 1/255, if that loses nothing.
fn color_in_bytes(color: Vec4) -> Option<[u8; 4]> {
    // The cast saturates, and the comparison finds what it changed.
    let bytes = color.to_array().map(|value| (value * 255.0 + 0.5) as u8);
    (bytes.map(|byte| f32::from(byte) / 255.0) == color.to_array()).then_some(bytes)
}

#[cfg(test)]
mod tests;
