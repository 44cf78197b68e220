//! `EXT_mesh_gpu_instancing`: one node, many placements of its mesh.

use super::accessor::Accessor;
use super::error::ImportError;
use super::json::Json;
use super::nodes::transform;
use super::resources::Resources;
use glam::DMat4;

/// Transforms of all placements relative to the node; just the node itself if it has no such extension.
pub(super) fn placements(resources: &Resources<'_>, node: &Json<'_>) -> Result<Vec<DMat4>, ImportError> {
    let Some(extension) = node.extension("EXT_mesh_gpu_instancing") else { return Ok(vec![DMat4::IDENTITY]) };
    let attributes = extension.object("attributes")?;
    let attributes = attributes.ok_or_else(|| extension.malformed_at("attributes", "is missing"))?;
    let mut count = None;
    let mut read = |name: &str, width: usize| -> Result<Option<Vec<f32>>, ImportError> {
        let Some(index) = attributes.reference(name, &resources.root, "accessors")? else { return Ok(None) };
        let accessor = Accessor::parse(resources, index)?;
        if accessor.width != width {
            return Err(
                accessor.malformed(format!("must have {width} components as {}", attributes.place_of(name)))
            );
        }
        let expected = *count.get_or_insert(accessor.count);
        if accessor.count != expected {
            return Err(attributes
                .malformed(format!("{name} has {} elements, others have {expected}", accessor.count)));
        }
        let values = accessor.read(resources, None, &attributes.place_of(name))?;
        match values.iter().position(|value| !value.is_finite()) {
            Some(at) => Err(accessor.malformed(format!("element {} is not finite", at / width))),
            None => Ok(Some(values)),
        }
    };
    let translations = read("TRANSLATION", 3)?;
    let rotations = read("ROTATION", 4)?;
    let scales = read("SCALE", 3)?;
    let count = match count {
        Some(count) => count,
        // Only custom attributes: they place nothing, but there are as many instances as they have elements.
        None => match attributes.keys().first() {
            Some(name) => {
                let accessor = Accessor::parse(resources, attributes.required_index(name)?)?;
                accessor.check_extent(resources)?;
                accessor.count
            }
            None => return Err(attributes.malformed("must have at least one attribute")),
        },
    };
    resources.charge(count as u64 * size_of::<DMat4>() as u64, &attributes.place())?;
    fn at<const N: usize>(values: &Option<Vec<f32>>, i: usize, default: [f64; N]) -> [f64; N] {
        let value = values.as_ref().and_then(|values| values.as_chunks::<N>().0.get(i));
        value.map_or(default, |value| value.map(f64::from))
    }
    let placement = |i| {
        transform(
            at(&translations, i, [0.0; 3]),
            at(&rotations, i, [0.0, 0.0, 0.0, 1.0]),
            at(&scales, i, [1.0; 3]),
        )
    };
    Ok((0..count).map(placement).collect())
}
