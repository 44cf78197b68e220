//! Whatever is broken in a file, the importer returns.

use super::builder::{Builder, U8, import_bytes};
use crate::import::ImportOptions;
use proptest::prelude::*;
use serde_json::{Value, json};

/// A file that uses a bit of everything.
fn rich() -> Builder {
    let mut builder = Builder::triangle();
    let target = builder.floats("VEC3", &[0.1; 9]);
    let joints = builder.accessor("VEC4", U8, 3, &[0; 12]);
    let weights = builder.floats("VEC4", &[1.0; 12]);
    let uvs = builder.floats("VEC2", &[0.5; 6]);
    let indices = builder.accessor("SCALAR", U8, 3, &[0, 1, 2]);
    let times = builder.floats("SCALAR", &[0.0, 1.0]);
    let moves = builder.floats("VEC3", &[0.0, 0.0, 0.0, 1.0, 2.0, 3.0]);
    let sparse_indices = builder.view(&[1]);
    let sparse_values = builder.view(&[0; 12]);
    let packed = builder.view(&meshopt::encode_vertex_buffer(&[[1.0_f32, 2.0, 3.0]; 3]).unwrap());
    let packed_bytes = builder.json["bufferViews"][packed]["byteLength"].clone();
    let offset = builder.json["bufferViews"][packed]["byteOffset"].clone();
    let view = builder.push(
        "bufferViews",
        json!({"buffer": 0, "byteLength": 36, "extensions": {"EXT_meshopt_compression":
            {"buffer": 0, "byteOffset": offset, "byteLength": packed_bytes, "byteStride": 12, "count": 3, "mode": "ATTRIBUTES"}}}),
    );
    let normals = builder
        .push("accessors", json!({"bufferView": view, "componentType": 5126, "count": 3, "type": "VEC3"}));
    builder.json["accessors"][0]["sparse"] = json!({"count": 1,
        "indices": {"bufferView": sparse_indices, "componentType": 5121}, "values": {"bufferView": sparse_values}});
    let mut image = Vec::new();
    let pixel = image::RgbaImage::from_pixel(2, 2, image::Rgba([1, 2, 3, 255]));
    pixel.write_to(&mut std::io::Cursor::new(&mut image), image::ImageFormat::Png).unwrap();
    let image = builder.view(&image);
    builder.push("images", json!({"bufferView": image}));
    builder.push("textures", json!({"source": 0}));
    builder.push("materials", json!({"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": 0},
        "pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "extensions": {"KHR_texture_transform": {"scale": [2, 2]}}}}}));
    *builder.primitive() = json!({"material": 0, "indices": indices, "targets": [{"POSITION": target}],
        "attributes": {"POSITION": 0, "NORMAL": normals, "JOINTS_0": joints, "WEIGHTS_0": weights, "TEXCOORD_0": uvs}});
    builder.json["nodes"] = json!([{"mesh": 0, "skin": 0, "weights": [0.5], "children": [1]}, {"mesh": 0, "scale": [1, 1, 1],
        "extensions": {"KHR_lights_punctual": {"light": 0}, "EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": moves}}}}]);
    builder.json["skins"] = json!([{"joints": [1]}]);
    builder.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [{"type": "point"}]}});
    builder.push(
        "animations",
        json!({"samplers": [{"input": times, "output": moves}],
        "channels": [{"sampler": 0, "target": {"node": 1, "path": "translation"}}]}),
    );
    builder
}

/// Puts `value` in the place of the value number `at` of the document, in the order of a walk.
fn replace(json: &mut Value, at: &mut usize, value: &Value) {
    if *at == 0 {
        *json = value.clone();
    }
    *at = at.wrapping_sub(1);
    match json {
        Value::Array(array) => array.iter_mut().for_each(|entry| replace(entry, at, value)),
        Value::Object(object) => object.values_mut().for_each(|entry| replace(entry, at, value)),
        _ => {}
    }
}

fn options(animated: bool) -> ImportOptions {
    ImportOptions {
        time_seconds: animated.then_some(0.5),
        max_memory_bytes: 1 << 28,
        ..ImportOptions::default()
    }
}

#[test]
fn the_undamaged_file_is_imported() {
    let scene = import_bytes(&rich().glb(), &options(true)).unwrap().scene;
    assert_eq!((scene.drawn_triangles(), scene.lights.len(), scene.textures.len()), (3, 1, 1));
    assert_eq!(scene.warnings, [""; 0]);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn damaged_bytes_never_panic(damage in prop::collection::vec((0_usize..10_000, any::<u8>()), 1..6), animated: bool) {
        let mut bytes = rich().glb();
        for (at, value) in damage {
            let at = at % bytes.len();
            bytes[at] = value;
        }
        let _either = import_bytes(&bytes, &options(animated));
    }

    #[test]
    fn cut_files_never_panic(at in 0_usize..10_000, animated: bool) {
        let bytes = rich().glb();
        let cut = at % bytes.len();
        prop_assert!(import_bytes(&bytes[..cut], &options(animated)).is_err());
    }

    #[test]
    fn damaged_values_never_panic(at in prop::collection::vec(0_usize..400, 1..4), which in 0_usize..14, animated: bool) {
        let values = [json!(null), json!(0), json!(1), json!(2), json!(-1), json!(1e300), json!(u64::MAX), json!(4_294_967_295_u64),
            json!(0.5), json!("x"), json!([]), json!({}), json!([0]), json!(true)];
        let mut builder = rich();
        for mut at in at {
            replace(&mut builder.json, &mut at, &values[which]);
        }
        if builder.json.is_object() {
            let _either = import_bytes(&builder.glb(), &options(animated));
        }
    }
}
