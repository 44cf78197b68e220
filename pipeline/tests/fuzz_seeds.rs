//! The fuzz targets' checks of scenes and recipes over their seeds, which are made here.

#[path = "../../fuzz/checks/import.rs"]
mod import;
#[path = "../../fuzz/checks/recipe.rs"]
mod recipe;
#[path = "../../fuzz/checks/replay.rs"]
mod replay;

use replay::replay;
use serde_json::{Value, json};

/// A document in the making: JSON, and the bytes of its only buffer.
struct Document {
    json: Value,
    bin: Vec<u8>,
}

impl Document {
    /// One triangle, once.
    fn triangle() -> Self {
        let mut document = Self { json: json!({"asset": {"version": "2.0"}}), bin: Vec::new() };
        let positions = document.accessor("VEC3", 3, &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        document.json["meshes"] = json!([{"primitives": [{"attributes": {"POSITION": positions}}]}]);
        document.json["nodes"] = json!([{"mesh": 0}]);
        document.json["scenes"] = json!([{"nodes": [0]}]);
        document
    }

    fn push(&mut self, key: &str, value: Value) -> usize {
        if self.json[key].is_null() {
            self.json[key] = json!([]);
        }
        let entries = self.json[key].as_array_mut().unwrap();
        entries.push(value);
        entries.len() - 1
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let view = json!({"buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len()});
        self.bin.extend(bytes);
        self.push("bufferViews", view)
    }

    fn accessor(&mut self, kind: &str, count: usize, values: &[f32]) -> usize {
        let view = self.view(bytemuck::cast_slice(values));
        self.push(
            "accessors",
            json!({"bufferView": view, "componentType": 5126, "count": count, "type": kind}),
        )
    }

    fn primitive(&mut self) -> &mut Value {
        &mut self.json["meshes"][0]["primitives"][0]
    }

    fn glb(mut self) -> Vec<u8> {
        self.json["buffers"] = json!([{"byteLength": self.bin.len()}]);
        let mut text = self.json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let length = (12 + 8 + text.len() + 8 + self.bin.len()) as u32;
        let mut glb = [&b"glTF\x02\0\0\0"[..], &length.to_le_bytes()].concat();
        for (kind, part) in [(b"JSON", &text), (b"BIN\0", &self.bin)] {
            glb.extend((part.len() as u32).to_le_bytes());
            glb.extend(kind);
            glb.extend(part);
        }
        glb
    }

    /// As text, with the buffer in a data URI.
    fn gltf(mut self) -> Vec<u8> {
        use base64::Engine as _;
        let data = base64::engine::general_purpose::STANDARD.encode(&self.bin);
        let uri = format!("data:application/octet-stream;base64,{data}");
        self.json["buffers"] = json!([{"byteLength": self.bin.len(), "uri": uri}]);
        self.json.to_string().into_bytes()
    }
}

/// Morph targets, a skin, an animation, instancing, lights.
fn moving() -> Document {
    let mut document = Document::triangle();
    let target = document.accessor("VEC3", 3, &[0.1; 9]);
    let weights = document.accessor("VEC4", 3, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
    let joints = document.view(&[0; 12]);
    let joints = document
        .push("accessors", json!({"bufferView": joints, "componentType": 5121, "count": 3, "type": "VEC4"}));
    let times = document.accessor("SCALAR", 2, &[0.0, 1.0]);
    let moves = document.accessor("VEC3", 2, &[0.0, 0.0, 0.0, 1.0, 2.0, 3.0]);
    let turns = document.accessor("VEC4", 2, &[0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
    *document.primitive() = json!({"targets": [{"POSITION": target}],
        "attributes": {"POSITION": 0, "JOINTS_0": joints, "WEIGHTS_0": weights}});
    document.json["nodes"] = json!([{"mesh": 0, "skin": 0, "weights": [0.5], "children": [1]},
        {"mesh": 0, "scale": [1, 2, 1], "extensions": {"KHR_lights_punctual": {"light": 0},
        "EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": moves, "ROTATION": turns}}}}]);
    document.json["skins"] = json!([{"joints": [1]}]);
    document.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [{"type": "spot", "spot": {}}]}});
    document.json["animations"] = json!([{"samplers": [{"input": times, "output": moves}, {"input": times, "output": turns}],
        "channels": [{"sampler": 0, "target": {"node": 1, "path": "translation"}},
                     {"sampler": 1, "target": {"node": 1, "path": "rotation"}}]}]);
    document
}

/// Sparse and normalized accessors, a strip, textures with a transform, an alpha cut-out.
fn painted() -> Document {
    let mut document = Document::triangle();
    let (indices, values) = (document.view(&[1]), document.view(&[0; 12]));
    document.json["accessors"][0]["sparse"] = json!({"count": 1,
        "indices": {"bufferView": indices, "componentType": 5121}, "values": {"bufferView": values}});
    let uvs = document.view(&[0, 0, 255, 0, 0, 255, 0, 0]);
    let uvs = document.push(
        "accessors",
        json!({"bufferView": uvs, "componentType": 5121, "normalized": true, "count": 3, "type": "VEC2"}),
    );
    let strip = document.view(&[0, 1, 2, 1]);
    let strip = document
        .push("accessors", json!({"bufferView": strip, "componentType": 5121, "count": 4, "type": "SCALAR"}));
    let mut png = Vec::new();
    let pixels = image::RgbaImage::from_pixel(2, 2, image::Rgba([200, 100, 50, 128]));
    pixels.write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png).unwrap();
    let png = document.view(&png);
    document.json["images"] = json!([{"bufferView": png, "mimeType": "image/png"}]);
    document.json["samplers"] = json!([{"wrapS": 33071, "wrapT": 33648}]);
    document.json["textures"] = json!([{"source": 0, "sampler": 0}]);
    let texture =
        json!({"index": 0, "extensions": {"KHR_texture_transform": {"scale": [2, 2], "rotation": 1}}});
    document.json["materials"] = json!([{"alphaMode": "MASK", "alphaCutoff": 0.25, "emissiveFactor": [1, 1, 1],
        "emissiveTexture": {"index": 0}, "pbrMetallicRoughness": {"baseColorTexture": texture}}]);
    *document.primitive() = json!({"mode": 5, "indices": strip, "material": 0,
        "attributes": {"POSITION": 0, "TEXCOORD_0": uvs}});
    document
}

/// Positions packed by meshoptimizer.
fn meshopt_packed() -> Document {
    let mut document = Document::triangle();
    let corners = [[0.0_f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let packed = document.view(&meshopt::encode_vertex_buffer(&corners).unwrap());
    let part = document.json["bufferViews"][packed].clone();
    let view = document.push(
        "bufferViews",
        json!({"buffer": 0, "byteLength": 36,
        "extensions": {"EXT_meshopt_compression": {"buffer": 0, "byteOffset": part["byteOffset"],
            "byteLength": part["byteLength"], "byteStride": 12, "count": 3, "mode": "ATTRIBUTES"}}}),
    );
    document.json["accessors"][0]["bufferView"] = json!(view);
    document
}

/// A triangle packed by Draco.
fn draco_packed() -> Document {
    use draco_core::{
        DataType, EncoderBuffer, EncoderOptions, FaceIndex, GeometryAttributeType, Mesh, MeshEncoder,
        PointAttribute, PointIndex,
    };
    let mut position = PointAttribute::new();
    position.init(GeometryAttributeType::Position, 3, DataType::Float32, false, 3);
    for (at, value) in [0.0_f32, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().enumerate() {
        position.buffer_mut().write(at * 4, &value.to_le_bytes());
    }
    let mut mesh = Mesh::new();
    mesh.set_num_points(3);
    mesh.add_attribute(position);
    mesh.set_num_faces(1);
    mesh.set_face(FaceIndex(0), [PointIndex(0), PointIndex(1), PointIndex(2)]);
    let mut encoder = MeshEncoder::new();
    encoder.set_mesh(mesh);
    let mut packed = EncoderBuffer::new();
    encoder.encode(&EncoderOptions::new(), &mut packed).unwrap();
    let mut document = Document::triangle();
    let view = document.view(packed.data());
    document.json["accessors"][0].as_object_mut().unwrap().remove("bufferView");
    document.primitive()["extensions"] =
        json!({"KHR_draco_mesh_compression": {"bufferView": view, "attributes": {"POSITION": 0}}});
    document
}

#[test]
fn scenes() {
    let options = manyview_pipeline::import::ImportOptions::default();
    let seeds = [
        Document::triangle().glb(),
        Document::triangle().gltf(),
        moving().glb(),
        painted().glb(),
        painted().gltf(),
        meshopt_packed().glb(),
        draco_packed().glb(),
    ];
    for (number, seed) in seeds.iter().enumerate() {
        let imported =
            manyview_pipeline::import::import_bytes("seed", seed, std::path::Path::new("."), &options);
        let scene = imported.unwrap_or_else(|error| panic!("seed {number}: {error}")).scene;
        assert!(scene.drawn_triangles() > 0, "seed {number} draws nothing");
    }
    replay("import", &seeds, 400, import::check);
}

#[test]
fn recipes() {
    let seeds = [
        "",
        "scene = \"a.glb\"\nlevels = 9\nrows = 64\ndirections = \"octahedral:30\"\ngrid = \"cube\"\n",
        "generate = { kind = \"town\", triangles = 5000, seed = 3 }\noutput = \"o.mvb\"\ntime = 1.5\n",
        "rows = 0\nrows_from = \"rotate\"\ncube = { origin = [-1.0, 0.0, 1e3], size = 2.0 }\n",
        "directions = \"latlong:90x90\"\npreview = \"p.png\"\ncamera = \"c.toml\"\nrows_from = \"peel\"\n",
    ];
    let seeds: Vec<Vec<u8>> = seeds.iter().map(|text| text.as_bytes().to_vec()).collect();
    replay("recipe", &seeds, 1000, recipe::check);
}
