//! `KHR_lights_punctual`.

use super::error::ImportError;
use super::json::Json;
use super::resources::Resources;
use crate::scene::{LightKind, PunctualLight};
use glam::{DMat4, DVec3, Vec3};

/// The light that a node carries, in world space, if it carries one that is known.
pub(super) fn load(
    resources: &Resources<'_>,
    node: &Json<'_>,
    world_from_node: DMat4,
) -> Result<Option<PunctualLight>, ImportError> {
    let Some(reference) = node.extension("KHR_lights_punctual") else { return Ok(None) };
    let Some(index) = reference.index("light")? else { return Ok(None) };
    let Some(lights) = resources.root.extension("KHR_lights_punctual") else {
        return Err(reference.malformed_at("light", "the document has no lights"));
    };
    let light = lights.item("lights", index)?;
    let kind = match light.string("type")? {
        Some("directional") => LightKind::Directional,
        Some("point") => LightKind::Point,
        Some("spot") => {
            let spot = light.object("spot")?;
            let angle = |key: &str, default: f64| -> Result<f64, ImportError> {
                Ok(spot.as_ref().map(|spot| spot.number(key)).transpose()?.flatten().unwrap_or(default))
            };
            let outer =
                angle("outerConeAngle", std::f64::consts::FRAC_PI_4)?.clamp(0.0, std::f64::consts::FRAC_PI_2);
            let inner = angle("innerConeAngle", 0.0)?.clamp(0.0, outer);
            LightKind::Spot { inner_angle: inner as f32, outer_angle: outer as f32 }
        }
        other => {
            let name = other.unwrap_or("nothing");
            resources.warn(format!(
                "{}: \"{name}\" is no known kind; the light is left out",
                light.place_of("type")
            ));
            return Ok(None);
        }
    };
    let color = light.numbers::<3>("color")?.unwrap_or([1.0; 3]);
    let intensity = light.number("intensity")?.unwrap_or(1.0);
    let range =
        light.number("range")?.filter(|range| *range > 0.0).map_or(f32::INFINITY, |range| range as f32);
    let position = world_from_node.transform_point3(DVec3::ZERO).as_vec3();
    // Negative z is where a light shines; a singular transform leaves it no direction, so down it is.
    let direction = world_from_node.transform_vector3(DVec3::NEG_Z);
    let length = direction.length();
    let direction =
        if length > 0.0 && length.is_finite() { (direction / length).as_vec3() } else { Vec3::NEG_Y };
    if !position.is_finite() {
        return Err(node.malformed("its light lies at a position that is not finite"));
    }
    let intensity = color.map(|color| ((color * intensity) as f32).clamp(0.0, f32::MAX));
    Ok(Some(PunctualLight { position, direction, intensity: Vec3::from_array(intensity), range, kind }))
}
