use glam::{DMat4, DVec3, Vec2, Vec3, Vec4, vec3};
use serde_json::Value;

use super::*;
use crate::generate::{SceneKind, generate};
use crate::scene::{AlphaMode, Instance, LightKind, Material, PunctualLight, Texture, Wrap};

/// Header and chunk structure are checked here; the JSON and the binary chunk are returned.
fn parse(bytes: &[u8]) -> (Value, Vec<u8>) {
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!(&bytes[..4], b"glTF");
    assert_eq!(word(4), 2);
    assert_eq!(word(8), bytes.len());
    let json_length = word(12);
    assert_eq!(json_length % 4, 0);
    assert_eq!(&bytes[16..20], b"JSON");
    let json = serde_json::from_slice(&bytes[20..20 + json_length]).unwrap();
    let start = 20 + json_length;
    if start == bytes.len() {
        return (json, Vec::new());
    }
    assert_eq!(&bytes[start + 4..start + 8], b"BIN\0");
    assert_eq!(start + 8 + word(start), bytes.len());
    (json, bytes[start + 8..].to_vec())
}

fn write(scene: &Scene) -> (Value, Vec<u8>) {
    let mut bytes = Vec::new();
    write_glb(scene, &mut bytes).unwrap();
    parse(&bytes)
}

fn number(value: &Value) -> usize {
    value.as_u64().unwrap() as usize
}

/// The bytes of an accessor, its bounds checked.
fn accessor_bytes<'a>(json: &Value, binary: &'a [u8], index: usize) -> &'a [u8] {
    let accessor = &json["accessors"][index];
    let view = &json["bufferViews"][number(&accessor["bufferView"])];
    let component = match number(&accessor["componentType"]) {
        5121 => 1,
        5123 => 2,
        5125 | 5126 => 4,
        other => panic!("component type {other}"),
    };
    let components = match accessor["type"].as_str().unwrap() {
        "SCALAR" => 1,
        "VEC2" => 2,
        "VEC3" => 3,
        "VEC4" => 4,
        other => panic!("type {other}"),
    };
    let length = number(&accessor["count"]) * component * components;
    assert_eq!(number(&view["byteLength"]), length);
    let offset = number(&view["byteOffset"]);
    assert_eq!(offset % 4, 0);
    &binary[offset..offset + length]
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks(4).map(|chunk| f32::from_le_bytes(chunk.try_into().unwrap())).collect()
}

fn tiny() -> Scene {
    Scene {
        meshes: vec![Mesh {
            name: "triangle".to_owned(),
            positions: vec![Vec3::ZERO, vec3(2.0, 0.0, 0.0), vec3(0.0, 3.0, -1.0)],
            normals: vec![Vec3::Z; 3],
            base_color_uvs: vec![Vec2::ZERO, Vec2::X, Vec2::Y],
            emissive_uvs: Vec::new(),
            colors: vec![Vec4::ONE, Vec4::new(0.0, 51.0 / 255.0, 1.0, 1.0), Vec4::W],
            triangles: vec![[0, 1, 2]],
            material: 0,
        }],
        instances: vec![
            Instance { mesh: 0, world_from_object: DMat4::IDENTITY },
            Instance { mesh: 0, world_from_object: DMat4::from_translation(DVec3::new(1.0, 2.0, 3.0)) },
        ],
        materials: vec![Material {
            name: "leaf".to_owned(),
            base_color: Vec4::new(0.5, 0.25, 1.0, 1.0),
            base_color_texture: Some(0),
            emissive: vec3(4.0, 2.0, 1.0),
            alpha_mode: AlphaMode::Mask { cutoff: 0.5 },
            double_sided: true,
            ..Material::default()
        }],
        textures: vec![Texture {
            width: 2,
            height: 1,
            texels: vec![[255, 0, 0, 255], [0, 0, 255, 0]],
            wrap: [Wrap::Repeat, Wrap::ClampToEdge],
        }],
        lights: vec![
            PunctualLight {
                position: vec3(1.0, 5.0, 2.0),
                direction: Vec3::NEG_Y,
                intensity: vec3(10.0, 5.0, 0.0),
                range: f32::INFINITY,
                kind: LightKind::Point,
            },
            PunctualLight {
                position: Vec3::ZERO,
                direction: Vec3::X,
                intensity: Vec3::ONE,
                range: 8.0,
                kind: LightKind::Spot { inner_angle: 0.25, outer_angle: 0.5 },
            },
        ],
        warnings: Vec::new(),
    }
}

#[test]
fn a_tiny_scene_is_written_as_expected() {
    let (json, binary) = write(&tiny());
    assert_eq!(json["asset"]["version"], "2.0");
    assert_eq!(json["scenes"][0]["nodes"], serde_json::json!([0, 1, 2, 3]));
    assert_eq!(json["nodes"][0], serde_json::json!({ "mesh": 0 }));
    assert_eq!(json["nodes"][1]["matrix"][13], 2.0);
    let primitive = &json["meshes"][0]["primitives"][0];
    let attributes = &primitive["attributes"];
    let positions = number(&attributes["POSITION"]);
    assert_eq!(
        floats(accessor_bytes(&json, &binary, positions)),
        [0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 3.0, -1.0]
    );
    assert_eq!(json["accessors"][positions]["min"], serde_json::json!([0.0, 0.0, -1.0]));
    assert_eq!(json["accessors"][positions]["max"], serde_json::json!([2.0, 3.0, 0.0]));
    let colors = accessor_bytes(&json, &binary, number(&attributes["COLOR_0"]));
    assert_eq!(colors, [255, 255, 255, 255, 0, 51, 255, 255, 0, 0, 0, 255]);
    assert_eq!(accessor_bytes(&json, &binary, number(&primitive["indices"])), [0, 0, 1, 0, 2, 0]);
    let material = &json["materials"][0];
    assert_eq!(material["emissiveFactor"], serde_json::json!([1.0, 0.5, 0.25]));
    assert_eq!(
        material["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"],
        serde_json::json!(4.0)
    );
    assert_eq!(material["alphaMode"], "MASK");
    assert_eq!(json["samplers"][0], serde_json::json!({ "wrapS": 10497, "wrapT": 33071 }));
    let lights = &json["extensions"]["KHR_lights_punctual"]["lights"];
    assert_eq!(lights[0]["color"], serde_json::json!([1.0, 0.5, 0.0]));
    assert_eq!(lights[0]["intensity"], 10.0);
    assert_eq!(lights[0].get("range"), None);
    assert_eq!(lights[1]["range"], 8.0);
    assert_eq!(
        json["extensionsUsed"],
        serde_json::json!(["KHR_lights_punctual", "KHR_materials_emissive_strength"])
    );
}

#[test]
fn the_picture_is_read_back() {
    let (json, binary) = write(&tiny());
    let view = &json["bufferViews"][number(&json["images"][0]["bufferView"])];
    let offset = number(&view["byteOffset"]);
    let png = &binary[offset..offset + number(&view["byteLength"])];
    let image = image::load_from_memory(png).unwrap().to_rgba8();
    assert_eq!(image.as_raw(), &[255, 0, 0, 255, 0, 0, 255, 0]);
}

#[test]
fn spot_lights_are_turned_to_shine_along_their_direction() {
    for direction in [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Z, Vec3::Z, vec3(0.6, -0.48, 0.64)] {
        let mut scene = tiny();
        scene.lights[1].direction = direction;
        let (json, _) = write(&scene);
        let q: Vec<_> = (0..4).map(|i| json["nodes"][3]["rotation"][i].as_f64().unwrap()).collect();
        let rotated = glam::DQuat::from_xyzw(q[0], q[1], q[2], q[3]).mul_vec3(DVec3::NEG_Z);
        assert!((rotated - direction.as_dvec3()).length() < 1e-6, "{direction} became {rotated}");
    }
}

#[test]
fn an_empty_scene_has_no_empty_arrays() {
    let (json, binary) = write(&Scene::default());
    assert!(binary.is_empty());
    assert!(json.get("nodes").is_none() && json.get("meshes").is_none() && json.get("buffers").is_none());
}

#[test]
fn emissive_coordinates_are_the_second_set() {
    let mut scene = tiny();
    scene.materials[0].emissive_texture = Some(0);
    scene.meshes[0].emissive_uvs = vec![Vec2::ONE, Vec2::X, Vec2::Y];
    let (json, binary) = write(&scene);
    assert_eq!(json["materials"][0]["emissiveTexture"]["texCoord"], 1);
    let set = number(&json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"]);
    assert_eq!(floats(accessor_bytes(&json, &binary, set))[..2], [1.0, 1.0]);
    scene.meshes[0].base_color_uvs.clear();
    scene.materials[0].base_color_texture = None;
    let (json, _) = write(&scene);
    let attributes = &json["meshes"][0]["primitives"][0]["attributes"];
    assert_eq!(attributes["TEXCOORD_0"], attributes["TEXCOORD_1"]);
}

#[test]
fn meshes_without_triangles_are_left_out() {
    let mut scene = tiny();
    scene.meshes.insert(0, Mesh::default());
    scene.instances[0].mesh = 0;
    scene.instances[1].mesh = 1;
    let (json, _) = write(&scene);
    assert_eq!(json["meshes"].as_array().unwrap().len(), 1);
    assert_eq!(json["nodes"][0]["mesh"], 0);
    assert_eq!(json["nodes"].as_array().unwrap().len(), 3);
}

#[test]
fn many_vertices_take_wide_indices() {
    let mut scene = tiny();
    let mesh = &mut scene.meshes[0];
    *mesh = Mesh { positions: vec![Vec3::ONE; 65_536], triangles: vec![[0, 1, 65_535]], ..Mesh::default() };
    let (json, binary) = write(&scene);
    let indices = number(&json["meshes"][0]["primitives"][0]["indices"]);
    assert_eq!(json["accessors"][indices]["componentType"], 5125);
    assert_eq!(accessor_bytes(&json, &binary, indices)[8..], 65_535_u32.to_le_bytes());
}

#[test]
fn broken_meshes_are_refused_by_name() {
    let mut scene = tiny();
    scene.meshes[0].triangles[0][2] = 3;
    let error = write_glb(&scene, &mut Vec::new()).unwrap_err();
    assert_eq!(error.to_string(), "mesh 0 (\"triangle\"): a triangle refers to a vertex that does not exist");
    let mut scene = tiny();
    scene.meshes[0].positions[1].x = f32::NAN;
    assert!(write_glb(&scene, &mut Vec::new()).is_err());
    let mut scene = tiny();
    scene.meshes[0].colors.pop();
    assert!(write_glb(&scene, &mut Vec::new()).is_err());
}

#[test]
fn generated_scenes_have_sound_accessors() {
    for kind in SceneKind::all() {
        let scene = generate(kind, 20_000, 3);
        let (json, binary) = write(&scene);
        let mut drawn = vec![0; json["meshes"].as_array().unwrap().len()];
        for (index, mesh) in json["meshes"].as_array().unwrap().iter().enumerate() {
            let primitive = &mesh["primitives"][0];
            let position = number(&primitive["attributes"]["POSITION"]);
            let accessor = &json["accessors"][position];
            let count = number(&accessor["count"]);
            for attribute in primitive["attributes"].as_object().unwrap().values() {
                accessor_bytes(&json, &binary, number(attribute));
                assert_eq!(number(&json["accessors"][number(attribute)]["count"]), count);
            }
            let positions = floats(accessor_bytes(&json, &binary, position));
            for axis in 0..3 {
                let values = || positions.iter().skip(axis).step_by(3).copied();
                let (low, high) = (values().fold(f32::MAX, f32::min), values().fold(f32::MIN, f32::max));
                assert_eq!(accessor["min"][axis].as_f64().unwrap() as f32, low);
                assert_eq!(accessor["max"][axis].as_f64().unwrap() as f32, high);
            }
            let indices = number(&primitive["indices"]);
            accessor_bytes(&json, &binary, indices);
            drawn[index] = number(&json["accessors"][indices]["count"]) / 3;
        }
        let nodes = json["nodes"].as_array().unwrap();
        let total: usize =
            nodes.iter().filter_map(|node| node.get("mesh")).map(|mesh| drawn[number(mesh)]).sum();
        assert_eq!(total as u64, scene.drawn_triangles(), "{kind}");
    }
}
