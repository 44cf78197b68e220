//! What is refused, and what the message says.

use super::builder::{Builder, U16, import_bytes};
use crate::import::{ImportError, ImportOptions, import};
use serde_json::json;
use std::path::Path;

/// The message has all of these parts.
#[track_caller]
fn assert_names(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "\"{message}\" does not say \"{part}\"");
    }
}

#[test]
fn missing_files() {
    let error = import(Path::new("/nonexistent/scene.glb"), &ImportOptions::default()).unwrap_err();
    assert!(matches!(error, ImportError::Unreadable { .. }), "{error}");
    let mut builder = Builder::triangle();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.gltf");
    builder.json["buffers"] = json!([{"byteLength": 36, "uri": "gone.bin"}]);
    fs_err::write(&path, builder.json.to_string()).unwrap();
    let error = import(&path, &ImportOptions::default()).unwrap_err();
    assert!(matches!(error, ImportError::Unreadable { .. }), "{error}");
    assert_names(&error.to_string(), &["scene.gltf", "buffers[0].uri", "gone.bin"]);
    fs_err::write(folder.path().join("gone.bin"), [0; 35]).unwrap();
    let error = import(&path, &ImportOptions::default()).unwrap_err();
    assert_names(&error.to_string(), &["buffers[0]", "36", "35"]);
    assert!(import(folder.path(), &ImportOptions::default()).is_err(), "a folder is no scene");
}

#[test]
fn positions_that_are_not_finite() {
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut builder = Builder::triangle();
        let positions = builder.floats("VEC3", &[0.0, 0.0, 0.0, 1.0, value, 0.0, 0.0, 1.0, 0.0]);
        builder.primitive()["attributes"]["POSITION"] = json!(positions);
        assert_names(
            &builder.refusal(),
            &[
                "scene.glb: meshes[0].primitives[0].attributes.POSITION (accessors[1]) element 1",
                "not finite",
            ],
        );
    }
}

#[test]
fn indices_out_of_range() {
    let mut builder = Builder::triangle();
    let indices = builder.accessor("SCALAR", U16, 3, &[0, 0, 1, 0, 3, 0]);
    builder.primitive()["indices"] = json!(indices);
    assert_names(
        &builder.refusal(),
        &["meshes[0].primitives[0].indices (accessors[1])", "element 2 is 3", "3 vertices"],
    );
}

#[test]
fn nodes_that_are_no_forest() {
    let cases = [
        (json!([{"mesh": 0, "children": [0]}]), "cycle"),
        (json!([{"mesh": 0}, {"children": [2]}, {"children": [3]}, {"children": [1]}]), "cycle"),
        (json!([{"children": [2]}, {"children": [2]}, {"mesh": 0}]), "one parent"),
        (json!([{"children": [1, 1]}, {"mesh": 0}]), "one parent"),
        (json!([{"children": [7]}]), "nodes[0].children: refers to nodes[7]"),
        (
            json!([{"mesh": 1}]),
            "nodes[0].mesh: refers to meshes[1], which does not exist; there are 1 meshes",
        ),
    ];
    for (nodes, part) in cases {
        let mut builder = Builder::triangle();
        builder.json["nodes"] = nodes;
        assert_names(&builder.refusal(), &["scene.glb: ", part]);
    }
}

#[test]
fn a_deep_hierarchy_is_no_problem() {
    let mut builder = Builder::triangle();
    let mut nodes: Vec<_> = (1..100_000).map(|child| json!({"children": [child]})).collect();
    nodes.push(json!({"mesh": 0}));
    builder.json["nodes"] = json!(nodes);
    assert_eq!(builder.import().unwrap().scene.drawn_triangles(), 1);
}

#[test]
fn accessors_beyond_their_data() {
    let mut cases = Vec::new();
    for count in [4_u64, 1 << 31, 1 << 40, u64::MAX] {
        let mut builder = Builder::triangle();
        builder.json["accessors"][0]["count"] = json!(count);
        cases.push(builder);
    }
    for (key, value) in
        [("byteOffset", u64::MAX), ("byteOffset", 4), ("byteLength", 1 << 40), ("byteStride", 1 << 60)]
    {
        let mut builder = Builder::triangle();
        builder.json["bufferViews"][0][key] = json!(value);
        cases.push(builder);
    }
    for builder in cases {
        let message = builder.refusal();
        assert!(message.contains("accessors[0]") || message.contains("bufferViews[0]"), "{message}");
    }
}

#[test]
fn zeros_without_end() {
    let mut builder = Builder::triangle();
    builder.json["accessors"][0] = json!({"componentType": 5126, "type": "VEC3", "count": 4_000_000_000_u64});
    assert_names(&builder.refusal(), &["accessors[0].count", "4000000000", "limit of"]);
}

#[test]
fn attributes_of_other_lengths_and_types() {
    let mut builder = Builder::triangle();
    let colors = builder.floats("VEC4", &[1.0; 8]);
    builder.primitive()["attributes"]["COLOR_0"] = json!(colors);
    assert_names(&builder.refusal(), &["accessors[1]", "2 elements", "COLOR_0", "3 vertices"]);
    let positions = builder.floats("VEC2", &[1.0; 6]);
    builder.primitive()["attributes"]["POSITION"] = json!(positions);
    assert_names(&builder.refusal(), &["accessors[2]", "POSITION"]);
}

#[test]
fn required_extensions_and_versions() {
    for (name, way_out) in [
        ("ACME_geometry", "extensionsRequired"),
        ("KHR_texture_basisu", "PNG, JPEG or WebP"),
        ("CESIUM_RTC", "root transform"),
    ] {
        let mut builder = Builder::triangle();
        builder.json["extensionsRequired"] = json!([name]);
        let error = builder.import().unwrap_err();
        assert!(matches!(&error, ImportError::Unsupported { feature, .. } if feature == name), "{error}");
        assert_names(&error.to_string(), &[way_out]);
    }
    let mut builder = Builder::triangle();
    builder.json["asset"]["version"] = json!("1.0");
    assert!(matches!(builder.import(), Err(ImportError::Unsupported { .. })));
    builder.json["asset"] = json!({"version": "2.1", "minVersion": "2.1"});
    assert!(matches!(builder.import(), Err(ImportError::Unsupported { .. })));
    builder.json["asset"] = json!({"version": "2.1", "minVersion": "2.0"});
    assert!(builder.import().is_ok());
}

#[test]
fn files_outside_of_the_folder() {
    let above = tempfile::tempdir().unwrap();
    let folder = above.path().join("scene");
    fs_err::create_dir_all(&folder).unwrap();
    let mut builder = Builder::triangle();
    fs_err::write(above.path().join("secret.bin"), &builder.bin).unwrap();
    builder.json["buffers"] = json!([{"byteLength": 36, "uri": "../secret.bin"}]);
    let path = folder.join("scene.gltf");
    fs_err::write(&path, builder.json.to_string()).unwrap();
    let error = import(&path, &ImportOptions::default()).unwrap_err();
    assert!(matches!(error, ImportError::Outside { .. }), "{error}");
    let allowed = import(&path, &ImportOptions { allow_outside: true, ..ImportOptions::default() }).unwrap();
    assert_eq!(allowed.files[1].path, "../secret.bin");
}

#[test]
fn limits_on_triangles_and_memory() {
    let bytes = Builder::triangle().glb();
    let error =
        import_bytes(&bytes, &ImportOptions { max_triangles: 0, ..ImportOptions::default() }).unwrap_err();
    assert!(matches!(error, ImportError::OverLimit { value: 1, limit: 0, .. }), "{error}");
    let limit = bytes.len() as u64 + 100;
    let error = import_bytes(&bytes, &ImportOptions { max_memory_bytes: limit, ..ImportOptions::default() })
        .unwrap_err();
    assert!(matches!(error, ImportError::OverLimit { .. }), "{error}");
}

#[test]
fn a_small_file_that_claims_a_huge_image() {
    let mut builder = Builder::triangle();
    let uvs = builder.floats("VEC2", &[0.0; 6]);
    builder.primitive()["attributes"]["TEXCOORD_0"] = json!(uvs);
    builder.primitive()["material"] = json!(0);
    builder.push("materials", json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}));
    builder.push("textures", json!({"source": 0}));
    let mut png = Vec::new();
    let pixel = image::RgbaImage::from_pixel(1, 1, image::Rgba([1, 2, 3, 255]));
    pixel.write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png).unwrap();
    // The header's size is made 30,000 x 30,000; its checksum is wrong then, which decoders find only later or not at all.
    png[16..24].copy_from_slice(&[0, 0, 0x75, 0x30, 0, 0, 0x75, 0x30]);
    let view = builder.view(&png);
    builder.push("images", json!({"bufferView": view}));
    let scene = builder.import().unwrap().scene;
    assert_eq!((scene.textures.len(), scene.warnings.len()), (0, 1));
}
