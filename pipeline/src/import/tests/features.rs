//! What is read, and how.

use super::builder::{Builder, F32, I8, U8, U16, U32, import_bytes};
use crate::import::{ImportOptions, import};
use crate::scene::{AlphaMode, LightKind, Mesh, Wrap};
use base64::Engine;
use glam::{DVec3, Vec2, Vec3, Vec4};
use serde_json::json;
use std::io::Cursor;

fn mesh(builder: &Builder) -> Mesh {
    builder.import().unwrap().scene.meshes.swap_remove(0)
}

/// A PNG of one row.
fn png(texels: &[[u8; 4]]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let image = image::RgbaImage::from_raw(texels.len() as u32, 1, texels.concat()).unwrap();
    image.write_to(&mut Cursor::new(&mut bytes), image::ImageFormat::Png).unwrap();
    bytes
}

/// A triangle with texture coordinates and a base colour texture of two texels.
fn textured() -> Builder {
    let mut builder = Builder::triangle();
    let uvs = builder.floats("VEC2", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    builder.primitive()["attributes"]["TEXCOORD_0"] = json!(uvs);
    builder.primitive()["material"] = json!(0);
    builder.push("materials", json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}));
    builder.push("textures", json!({"source": 0}));
    let view = builder.view(&png(&[[255, 0, 0, 255], [0, 0, 255, 128]]));
    builder.push("images", json!({"bufferView": view, "mimeType": "image/png"}));
    builder
}

#[test]
fn a_triangle_without_indices() {
    let imported = Builder::triangle().import().unwrap();
    assert_eq!(imported.scene.drawn_triangles(), 1);
    assert_eq!(imported.scene.meshes[0].positions, [Vec3::ZERO, Vec3::X, Vec3::Y]);
    assert_eq!(imported.scene.meshes[0].triangles, [[0, 1, 2]]);
    assert_eq!(imported.files.len(), 1);
    assert_eq!(imported.files[0].path, "scene.glb");
    assert_eq!(imported.scene.warnings, [""; 0]);
}

#[test]
fn all_modes_and_index_types() {
    let square = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0];
    let indices: [u8; 4] = [0, 1, 2, 3];
    let expected = [
        (4, vec![[0, 1, 2]]),
        (5, vec![[0, 1, 2], [1, 3, 2]]),
        (6, vec![[1, 2, 0], [2, 3, 0]]),
        (0, vec![]),
        (1, vec![]),
        (2, vec![]),
        (3, vec![]),
    ];
    for component in [None, Some(U8), Some(U16), Some(U32)] {
        for (mode, triangles) in &expected {
            let mut builder = Builder::triangle();
            let positions = builder.floats("VEC3", &square);
            builder.primitive()["attributes"]["POSITION"] = json!(positions);
            builder.primitive()["mode"] = json!(mode);
            if let Some(component) = component {
                let width = match component {
                    U8 => 1,
                    U16 => 2,
                    _ => 4,
                };
                let bytes: Vec<u8> =
                    indices.iter().flat_map(|i| [*i, 0, 0, 0].into_iter().take(width)).collect();
                let index = builder.accessor("SCALAR", component, 4, &bytes);
                builder.primitive()["indices"] = json!(index);
            }
            let scene = builder.import().unwrap().scene;
            let drawn: Vec<[u32; 3]> = scene.meshes.iter().flat_map(|mesh| mesh.triangles.clone()).collect();
            assert_eq!(drawn, *triangles, "mode {mode}, indices {component:?}");
        }
    }
}

#[test]
fn quantized_and_strided_positions() {
    let mut builder = Builder::triangle();
    let positions = builder.accessor("VEC3", I8, 3, &[0, 0, 0, 9, 127, 0, 0, 9, 0, 129, 0, 9]);
    builder.json["bufferViews"][1]["byteStride"] = json!(4);
    builder.json["accessors"][positions]["normalized"] = json!(true);
    builder.primitive()["attributes"]["POSITION"] = json!(positions);
    builder.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    assert_eq!(mesh(&builder).positions, [Vec3::ZERO, Vec3::X, Vec3::NEG_Y]);
    builder.json["accessors"][positions]["normalized"] = json!(false);
    assert_eq!(mesh(&builder).positions, [Vec3::ZERO, Vec3::X * 127.0, Vec3::Y * -127.0]);
}

#[test]
fn sparse_accessors_replace_elements_of_views_and_of_zeros() {
    let mut builder = Builder::triangle();
    let indices = builder.view(&[1, 0, 2, 0]);
    let values = builder.view(bytemuck::cast_slice(&[5.0_f32, 0.0, 0.0, 0.0, 7.0, 0.0]));
    let sparse = json!({"count": 2, "indices": {"bufferView": indices, "componentType": U16}, "values": {"bufferView": values}});
    builder.json["accessors"][0]["sparse"] = sparse;
    assert_eq!(mesh(&builder).positions, [Vec3::ZERO, Vec3::X * 5.0, Vec3::Y * 7.0]);
    builder.json["accessors"][0].as_object_mut().unwrap().remove("bufferView");
    builder.json["accessors"][0]["sparse"]["count"] = json!(1);
    assert_eq!(mesh(&builder).positions, [Vec3::ZERO, Vec3::X * 5.0, Vec3::ZERO]);
}

#[test]
fn unused_vertices_are_dropped() {
    let mut builder = Builder::triangle();
    let mut positions = vec![0.0; 300];
    positions[90..93].copy_from_slice(&[1.0, 2.0, 3.0]);
    let positions = builder.floats("VEC3", &positions);
    let indices = builder.accessor("SCALAR", U8, 3, &[99, 30, 10]);
    builder.primitive()["attributes"]["POSITION"] = json!(positions);
    builder.primitive()["indices"] = json!(indices);
    let mesh = mesh(&builder);
    assert_eq!(mesh.positions, [Vec3::ZERO, Vec3::new(1.0, 2.0, 3.0), Vec3::ZERO]);
    assert_eq!(mesh.triangles, [[2, 1, 0]]);
}

#[test]
fn transforms_of_a_hierarchy_multiply_and_mirror() {
    let mut builder = Builder::triangle();
    builder.json["nodes"] = json!([
        {"translation": [10, 0, 0], "scale": [-2, 1, 1], "children": [1, 2]},
        {"mesh": 0, "rotation": [0, 0, std::f64::consts::FRAC_1_SQRT_2, std::f64::consts::FRAC_1_SQRT_2]},
        {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 5, 0, 1]},
    ]);
    let scene = builder.import().unwrap().scene;
    assert_eq!((scene.meshes.len(), scene.instances.len()), (1, 2));
    let at = |instance: usize, point| scene.instances[instance].world_from_object.transform_point3(point);
    // A quarter turn takes x to y; then x is mirrored and doubled.
    assert!(at(0, DVec3::X).abs_diff_eq(DVec3::new(10.0, 1.0, 0.0), 1e-12));
    assert!(at(0, DVec3::Y).abs_diff_eq(DVec3::new(12.0, 0.0, 0.0), 1e-12));
    assert_eq!(at(1, DVec3::X), DVec3::new(8.0, 5.0, 0.0));
}

#[test]
fn the_default_scene_or_the_first_or_all_roots_are_drawn() {
    let mut builder = Builder::triangle();
    builder.json["nodes"] = json!([{"mesh": 0}, {"mesh": 0}, {"mesh": 0}]);
    builder.json["scenes"] = json!([{"nodes": [0, 1]}, {"nodes": [2]}]);
    let drawn = |builder: &Builder| builder.import().unwrap().scene.instances.len();
    assert_eq!(drawn(&builder), 2);
    builder.json["scene"] = json!(1);
    assert_eq!(drawn(&builder), 1);
    builder.json.as_object_mut().unwrap().remove("scene");
    builder.json.as_object_mut().unwrap().remove("scenes");
    assert_eq!(drawn(&builder), 3);
    builder.json["nodes"][0]["extensions"] = json!({"KHR_node_visibility": {"visible": false}});
    assert_eq!(drawn(&builder), 2);
}

#[test]
fn nothing_drawn_is_no_error() {
    let imported = Builder::new().import().unwrap();
    assert!(imported.scene.instances.is_empty() && imported.scene.meshes.is_empty());
}

#[test]
fn instancing_places_the_mesh_once_for_every_element() {
    let mut builder = Builder::triangle();
    let translations = builder.floats("VEC3", &[1.0, 0.0, 0.0, 0.0, 2.0, 0.0]);
    let scales = builder.floats("VEC3", &[1.0, 1.0, 1.0, 3.0, 3.0, 3.0]);
    let attributes = json!({"TRANSLATION": translations, "SCALE": scales});
    builder.json["nodes"][0] = json!({"mesh": 0, "translation": [0, 0, 5], "extensions": {"EXT_mesh_gpu_instancing": {"attributes": attributes}}});
    builder.json["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    let scene = builder.import().unwrap().scene;
    assert_eq!(scene.drawn_triangles(), 2);
    let at = |instance: usize| scene.instances[instance].world_from_object.transform_point3(DVec3::X);
    assert_eq!((at(0), at(1)), (DVec3::new(2.0, 0.0, 5.0), DVec3::new(3.0, 2.0, 5.0)));
}

#[test]
fn vertex_colors_of_every_type_and_width() {
    let cases: [(&str, u32, &[u8], Vec4); 3] = [
        ("VEC3", U8, &[255, 0, 51], Vec4::new(1.0, 0.0, 0.2, 1.0)),
        ("VEC4", U16, &[255, 255, 0, 0, 51, 51, 0, 0], Vec4::new(1.0, 0.0, 0.2, 0.0)),
        ("VEC4", F32, &[0, 0, 0, 63, 0, 0, 128, 63, 0, 0, 0, 64, 0, 0, 0, 0], Vec4::new(0.5, 1.0, 1.0, 0.0)),
    ];
    for (kind, component, bytes, expected) in cases {
        let mut builder = Builder::triangle();
        let colors = builder.accessor(kind, component, 3, &bytes.repeat(3));
        builder.primitive()["attributes"]["COLOR_0"] = json!(colors);
        let colors = mesh(&builder).colors;
        assert_eq!(colors.len(), 3);
        assert!(colors[2].abs_diff_eq(expected, 1e-6), "{kind} of {component}: {}", colors[2]);
    }
}

#[test]
fn normals_become_unit_and_broken_ones_are_those_of_the_triangle() {
    let mut builder = Builder::triangle();
    let normals = builder.floats("VEC3", &[0.0, 2.0, 0.0, 0.0, 0.0, 0.0, f32::NAN, 0.0, 1.0]);
    builder.primitive()["attributes"]["NORMAL"] = json!(normals);
    assert_eq!(mesh(&builder).normals, [Vec3::Y, Vec3::Z, Vec3::Z]);
}

#[test]
fn textures_are_decoded_and_their_coordinates_transformed() {
    let mut builder = textured();
    let second = builder.floats("VEC2", &[0.5, 0.5, 0.25, 0.0, 0.0, 0.0]);
    builder.primitive()["attributes"]["TEXCOORD_1"] = json!(second);
    builder.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({"index": 0,
        "extensions": {"KHR_texture_transform": {"texCoord": 1, "scale": [2, 2], "offset": [0, 1]}}});
    builder.json["extensionsRequired"] = json!(["KHR_texture_transform", "KHR_materials_unlit"]);
    builder.push("samplers", json!({"wrapS": 33071, "wrapT": 33648}));
    builder.json["textures"][0]["sampler"] = json!(0);
    let scene = builder.import().unwrap().scene;
    assert_eq!(scene.textures[0].texels, [[255, 0, 0, 255], [0, 0, 255, 128]]);
    assert_eq!(scene.textures[0].wrap, [Wrap::ClampToEdge, Wrap::MirroredRepeat]);
    assert_eq!(scene.materials[0].base_color_texture, Some(0));
    assert_eq!(
        scene.meshes[0].base_color_uvs,
        [Vec2::new(1.0, 2.0), Vec2::new(0.5, 1.0), Vec2::new(0.0, 1.0)]
    );
    assert!(scene.meshes[0].emissive_uvs.is_empty());
}

#[test]
fn webp_is_tried_first_and_its_source_is_the_fallback() {
    let mut builder = textured();
    let mut webp = Vec::new();
    let pixel = image::RgbaImage::from_pixel(1, 1, image::Rgba([1, 2, 3, 255]));
    pixel.write_to(&mut Cursor::new(&mut webp), image::ImageFormat::WebP).unwrap();
    let view = builder.view(&webp);
    builder.push("images", json!({"bufferView": view, "mimeType": "image/webp"}));
    builder.json["textures"][0] = json!({"source": 0, "extensions": {"EXT_texture_webp": {"source": 1}}});
    assert_eq!(builder.import().unwrap().scene.textures[0].texels, [[1, 2, 3, 255]]);
    let broken = builder.view(b"RIFF\x04\0\0\0WEBPnonsense");
    builder.json["images"][1]["bufferView"] = json!(broken);
    assert_eq!(builder.import().unwrap().scene.textures[0].width, 2);
}

#[test]
fn an_image_that_cannot_be_decoded_is_a_warning() {
    let mut builder = textured();
    let view = builder.view(b"\x89PNG\r\n\x1a\nand no more");
    builder.json["images"][0]["bufferView"] = json!(view);
    builder.json["materials"][0]["emissiveFactor"] = json!([1, 1, 1]);
    builder.json["materials"][0]["emissiveTexture"] = json!({"index": 0});
    let scene = builder.import().unwrap().scene;
    assert_eq!((scene.textures.len(), scene.materials[0].base_color_texture), (0, None));
    assert_eq!((scene.materials[0].base_color, scene.materials[0].emissive), (Vec4::ONE, Vec3::ZERO));
    assert!(
        scene.warnings[0].contains("textures[0]") && scene.warnings[0].contains("images[0]"),
        "{:?}",
        scene.warnings
    );
}

#[test]
fn images_that_nothing_needs_are_not_read() {
    let mut builder = textured();
    builder.push("images", json!({"uri": "missing.png"}));
    builder.push("textures", json!({"source": 1}));
    builder.json["materials"][0]["normalTexture"] = json!({"index": 1});
    builder.json["materials"][0]["emissiveTexture"] = json!({"index": 1});
    let imported = builder.import().unwrap();
    assert_eq!(
        (imported.scene.warnings.len(), imported.files.len(), imported.scene.textures.len()),
        (0, 1, 1)
    );
    builder.json["materials"][0]["emissiveFactor"] = json!([1, 1, 1]);
    let imported = builder.import().unwrap();
    assert_eq!(imported.scene.warnings.len(), 1);
    assert_eq!((imported.files[1].path.as_str(), imported.files[1].hash), ("missing.png", None));
}

#[test]
fn materials_keep_what_the_bake_needs() {
    let mut builder = Builder::triangle();
    builder.primitive()["material"] = json!(1);
    builder.push("materials", json!({"name": "unused"}));
    builder.push(
        "materials",
        json!({"name": "lamp", "alphaMode": "MASK", "alphaCutoff": 0.25, "doubleSided": true,
        "pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 0.4]}, "emissiveFactor": [1, 0.5, 0],
        "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 8}}}),
    );
    let material = builder.import().unwrap().scene.materials.swap_remove(0);
    assert_eq!((material.name.as_str(), material.double_sided), ("lamp", true));
    assert_eq!(material.base_color, Vec4::new(0.1, 0.2, 0.3, 0.4));
    assert_eq!(material.emissive, Vec3::new(8.0, 4.0, 0.0));
    assert_eq!(material.alpha_mode, AlphaMode::Mask { cutoff: 0.25 });
    builder.json["materials"][1] = json!({"alphaMode": "BLEND", "extensions": {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [0.5, 0, 0, 1]}}});
    let material = builder.import().unwrap().scene.materials.swap_remove(0);
    assert_eq!((material.base_color.x, material.alpha_mode), (0.5, AlphaMode::Blend));
}

#[test]
fn lights_stand_and_shine_where_their_node_says() {
    let mut builder = Builder::new();
    builder.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [
        {"type": "spot", "color": [1, 0.5, 0], "intensity": 10, "range": 7, "spot": {"outerConeAngle": 0.5}},
        {"type": "point"}, {"type": "unheard of"}]}});
    // A quarter turn about y takes -z to -x.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let light = |index: usize| json!({"KHR_lights_punctual": {"light": index}});
    builder.json["nodes"] = json!([{"translation": [1, 2, 3], "rotation": [0, half, 0, half], "scale": [9, 9, 9], "extensions": light(0)},
        {"extensions": light(1)}, {"extensions": light(2)}]);
    let scene = builder.import().unwrap().scene;
    assert_eq!((scene.lights.len(), scene.warnings.len()), (2, 1));
    let spot = scene.lights[0];
    assert_eq!(
        (spot.position, spot.intensity, spot.range),
        (Vec3::new(1.0, 2.0, 3.0), Vec3::new(10.0, 5.0, 0.0), 7.0)
    );
    assert!(spot.direction.abs_diff_eq(Vec3::NEG_X, 1e-6));
    assert_eq!(spot.kind, LightKind::Spot { inner_angle: 0.0, outer_angle: 0.5 });
    assert_eq!((scene.lights[1].range, scene.lights[1].kind), (f32::INFINITY, LightKind::Point));
}

#[test]
fn files_beside_the_scene_and_data_uris_give_the_same_scene() {
    let builder = textured();
    let folder = tempfile::tempdir().unwrap();
    fs_err::create_dir_all(folder.path().join("my data")).unwrap();
    fs_err::write(folder.path().join("my data/a b.bin"), &builder.bin).unwrap();
    let encoded = base64::engine::general_purpose::STANDARD.encode(&builder.bin);
    let mut scenes = vec![builder.import().unwrap().scene];
    for uri in [
        "my%20data/a%20b.bin",
        "./my data/a b.bin",
        &format!("data:application/gltf-buffer;base64,{encoded}"),
    ] {
        let mut json = builder.json.clone();
        json["buffers"] = json!([{"byteLength": builder.bin.len(), "uri": uri}]);
        let path = folder.path().join("scene.gltf");
        fs_err::write(&path, json.to_string()).unwrap();
        let imported = import(&path, &ImportOptions::default()).unwrap();
        let paths: Vec<&str> = imported.files.iter().map(|file| file.path.as_str()).collect();
        let expected =
            if uri.starts_with("data:") { vec!["scene.gltf"] } else { vec!["scene.gltf", "my data/a b.bin"] };
        assert_eq!(paths, expected);
        scenes.push(imported.scene);
    }
    assert!(scenes.windows(2).all(|pair| pair[0] == pair[1]));
}

#[test]
fn packed_buffer_views_are_unpacked() {
    for name in ["EXT_meshopt_compression", "KHR_meshopt_compression"] {
        let mut builder = Builder::triangle();
        let corners = [[0.0_f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 3.0, 0.0]];
        let packed = meshopt::encode_vertex_buffer(&corners).unwrap();
        let offset = builder.bin.len();
        builder.bin.extend(&packed);
        let extension = json!({"buffer": 0, "byteOffset": offset, "byteLength": packed.len(), "byteStride": 12, "count": 3, "mode": "ATTRIBUTES"});
        builder.json["bufferViews"][0] =
            json!({"buffer": 1, "byteLength": 36, "extensions": {name: extension}});
        builder.json["extensionsRequired"] = json!([name]);
        assert_eq!(mesh(&builder).positions, [Vec3::ZERO, Vec3::X, Vec3::Y * 3.0], "{name}");
    }
}

#[test]
fn draco_primitives_are_unpacked() {
    let mut builder = Builder::triangle();
    let view = builder.view(&draco_triangle());
    builder.json["accessors"][0].as_object_mut().unwrap().remove("bufferView");
    builder.primitive()["extensions"] =
        json!({"KHR_draco_mesh_compression": {"bufferView": view, "attributes": {"POSITION": 0}}});
    builder.json["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
    let mesh = mesh(&builder);
    assert_eq!(mesh.triangles.len(), 1);
    let corners = mesh.triangles[0].map(|corner| mesh.positions[corner as usize]);
    for corner in [Vec3::ZERO, Vec3::X * 2.0, Vec3::Y] {
        assert!(
            corners.iter().any(|other| other.abs_diff_eq(corner, 1e-3)),
            "{corner} is not in {corners:?}"
        );
    }
    // Cut and damaged data is refused, whatever it says.
    for cut in 0..draco_triangle().len() {
        builder.json["bufferViews"][view]["byteLength"] = json!(cut);
        assert!(builder.import().is_err(), "cut at {cut}");
    }
}

fn draco_triangle() -> Vec<u8> {
    use draco_core::{
        DataType, EncoderBuffer, EncoderOptions, FaceIndex, GeometryAttributeType, Mesh, MeshEncoder,
        PointAttribute, PointIndex,
    };
    let mut mesh = Mesh::new();
    let mut position = PointAttribute::new();
    position.init(GeometryAttributeType::Position, 3, DataType::Float32, false, 3);
    let corners: [f32; 9] = [0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    for (at, value) in corners.iter().enumerate() {
        position.buffer_mut().write(at * 4, &value.to_le_bytes());
    }
    mesh.set_num_points(3);
    mesh.add_attribute(position);
    mesh.set_num_faces(1);
    mesh.set_face(FaceIndex(0), [PointIndex(0), PointIndex(1), PointIndex(2)]);
    let mut encoder = MeshEncoder::new();
    encoder.set_mesh(mesh);
    let mut buffer = EncoderBuffer::new();
    encoder.encode(&EncoderOptions::new(), &mut buffer).unwrap();
    buffer.data().to_vec()
}

#[test]
fn unknown_fields_and_extensions_do_no_harm() {
    let mut builder = Builder::triangle();
    builder.json["nodes"][0]["extensions"] = json!({"ACME_gizmo": 7, "ACME_other": {}});
    builder.json["extensionsUsed"] = json!(["ACME_gizmo"]);
    builder.json["cameras"] = json!("nonsense");
    builder.json["accessors"][0]["count"] = json!(3.0);
    assert_eq!(builder.import().unwrap().scene.drawn_triangles(), 1);
}

#[test]
fn degenerate_triangles_are_drawn() {
    let mut builder = Builder::triangle();
    let positions = builder.floats("VEC3", &[0.0; 9]);
    builder.primitive()["attributes"]["POSITION"] = json!(positions);
    assert_eq!(builder.import().unwrap().scene.drawn_triangles(), 1);
}

#[test]
fn the_same_bytes_give_the_same_scene_in_any_folder() {
    let bytes = textured().glb();
    let once = import_bytes(&bytes, &ImportOptions::default()).unwrap();
    assert_eq!(once, import_bytes(&bytes, &ImportOptions::default()).unwrap());
}
