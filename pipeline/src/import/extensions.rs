//! Which required extensions and versions the importer takes, and what to do about the others.

use super::error::ImportError;
use super::json::Json;

/// Extensions that are read, and ones that change nothing of what the bake keeps.
const ACCEPTED: &[&str] = &[
    "EXT_lights_ies",
    "EXT_lights_image_based",
    "EXT_mesh_features",
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "EXT_structural_metadata",
    "EXT_texture_webp",
    "GODOT_single_root",
    "KHR_draco_mesh_compression",
    "KHR_lights_punctual",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_node_hoverability",
    "KHR_node_selectability",
    "KHR_node_visibility",
    "KHR_techniques_webgl",
    "KHR_texture_transform",
    "KHR_xmp",
    "KHR_xmp_json_ld",
    "MSFT_packing_normalRoughnessMetallic",
    "MSFT_packing_occlusionRoughnessMetallic",
];

/// Refuses versions and required extensions that would make the scene look or lie otherwise than it should.
pub(super) fn check(root: &Json<'_>, animated: bool) -> Result<(), ImportError> {
    check_version(root)?;
    for name in root.strings("extensionsRequired") {
        // Materials differ in what the bake does not keep: geometry, base colour and emission stay as they are.
        let accepted = ACCEPTED.contains(&name)
            || name.contains("_materials_")
            || (name == "KHR_animation_pointer" && !animated);
        if !accepted {
            return Err(ImportError::Unsupported {
                file: root.file().to_owned(),
                place: "extensionsRequired".to_owned(),
                feature: name.to_owned(),
                way_out: way_out(name),
            });
        }
    }
    Ok(())
}

fn way_out(name: &str) -> String {
    match name {
        name if name.contains("_texture_") => {
            "export the scene with PNG, JPEG or WebP textures, or convert them, say with `gltf-transform png in.glb out.glb`"
        }
        "CESIUM_RTC" => "export the scene with an ordinary root transform instead",
        "KHR_animation_pointer" => "import the rest pose, without an animation time",
        _ => "export the scene without it, or remove it from extensionsRequired if the scene does well without",
    }
    .to_owned()
}

fn check_version(root: &Json<'_>) -> Result<(), ImportError> {
    let asset = root.object("asset")?.ok_or_else(|| root.malformed_at("asset", "is missing"))?;
    let version = asset.string("version")?.ok_or_else(|| asset.malformed_at("version", "is missing"))?;
    let (key, least) = match asset.string("minVersion")? {
        Some(least) => ("minVersion", least),
        None => ("version", version),
    };
    let (major, minor) = least.split_once('.').unwrap_or((least, "0"));
    if major == "2" && (key == "version" || minor == "0") {
        return Ok(());
    }
    if major.parse::<u32>().is_err() {
        return Err(asset.malformed_at(key, format!("\"{least}\" is no version number like \"2.0\"")));
    }
    Err(ImportError::Unsupported {
        file: root.file().to_owned(),
        place: asset.place_of(key),
        feature: format!("glTF {least}"),
        way_out: "export the scene as glTF 2.0".to_owned(),
    })
}
