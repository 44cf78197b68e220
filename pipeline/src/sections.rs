//! Writing the heads of the archive's sections; their layout is in [`manyview_shaders::sections`].

use crate::bake::BakeError;
use crate::scene::{LightKind, Scene};
use manyview_cache::archive::ArchiveWriter;
use manyview_shaders::sections::{Light, SceneInfo, SvoInfo, name};
use std::io::{Seek, Write};

/// The lights of a scene as the archive keeps them.
pub fn lights(scene: &Scene) -> Vec<Light> {
    scene
        .lights
        .iter()
        .map(|light| {
            let (kind, inner_angle, outer_angle) = match light.kind {
                LightKind::Directional => (0, 0.0, 0.0),
                LightKind::Point => (1, 0.0, 0.0),
                LightKind::Spot { inner_angle, outer_angle } => (2, inner_angle, outer_angle),
            };
            Light {
                position: light.position.to_array(),
                kind,
                direction: light.direction.to_array(),
                range: light.range,
                intensity: light.intensity.to_array(),
                inner_angle,
                outer_angle,
                reserved: [0; 3],
            }
        })
        .collect()
}

/// Appends `scene.info` and `scene.lights`.
pub fn write_scene<W: Write + Seek>(
    writer: &mut ArchiveWriter<W>,
    info: &SceneInfo,
    lights: &[Light],
) -> Result<(), BakeError> {
    writer.begin_section(name::SCENE_INFO, 0)?;
    writer.append_raw(bytemuck::bytes_of(info))?;
    writer.begin_section(name::SCENE_LIGHTS, 0)?;
    writer.append_raw(bytemuck::cast_slice(lights))?;
    Ok(())
}

/// Appends `svo.info`.
pub fn write_svo_info<W: Write + Seek>(
    writer: &mut ArchiveWriter<W>,
    info: &SvoInfo,
) -> Result<(), BakeError> {
    writer.begin_section(name::SVO_INFO, 0)?;
    writer.append_raw(bytemuck::bytes_of(info))?;
    Ok(())
}

/// Byte 0 of every value, then byte 1 of every value, …
pub(crate) fn planes<T, const N: usize>(values: &[T], bytes: impl Fn(&T) -> [u8; N]) -> Vec<u8> {
    let mut planes = vec![0; values.len() * N];
    for (i, value) in values.iter().enumerate() {
        for (plane, byte) in bytes(value).into_iter().enumerate() {
            planes[plane * values.len() + i] = byte;
        }
    }
    planes
}
