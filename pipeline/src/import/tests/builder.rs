//! Makes tiny glTF files.

use crate::import::{ImportError, ImportOptions, Imported, import};
use serde_json::{Value, json};

/// A glTF document in the making: JSON and one binary buffer.
#[derive(Debug, Clone)]
pub(super) struct Builder {
    pub(super) json: Value,
    pub(super) bin: Vec<u8>,
}

/// Component types by their numbers in the file.
pub(super) const U8: u32 = 5121;
pub(super) const U16: u32 = 5123;
pub(super) const U32: u32 = 5125;
pub(super) const I8: u32 = 5120;
pub(super) const F32: u32 = 5126;

impl Builder {
    /// A document with nothing in it but its version.
    pub(super) fn new() -> Self {
        Self { json: json!({"asset": {"version": "2.0"}}), bin: Vec::new() }
    }

    /// One right-angled triangle in the z = 0 plane as mesh 0 of node 0: (0, 0), (1, 0), (0, 1).
    pub(super) fn triangle() -> Self {
        let mut builder = Self::new();
        let positions = builder.floats("VEC3", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        builder.push("meshes", json!({"primitives": [{"attributes": {"POSITION": positions}}]}));
        builder.push("nodes", json!({"mesh": 0}));
        builder.push("scenes", json!({"nodes": [0]}));
        builder
    }

    /// Appends to an array of the document and returns the entry's index.
    pub(super) fn push(&mut self, key: &str, value: Value) -> usize {
        let entries = self.json.as_object_mut().unwrap().entry(key).or_insert_with(|| json!([]));
        let entries = entries.as_array_mut().unwrap();
        entries.push(value);
        entries.len() - 1
    }

    /// A buffer view of these bytes.
    pub(super) fn view(&mut self, bytes: &[u8]) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let offset = self.bin.len();
        self.bin.extend(bytes);
        self.push("bufferViews", json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len()}))
    }

    /// An accessor of these bytes.
    pub(super) fn accessor(&mut self, kind: &str, component: u32, count: usize, bytes: &[u8]) -> usize {
        let view = self.view(bytes);
        self.push(
            "accessors",
            json!({"bufferView": view, "componentType": component, "count": count, "type": kind}),
        )
    }

    /// An accessor of floats.
    pub(super) fn floats(&mut self, kind: &str, values: &[f32]) -> usize {
        let width = match kind {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 16,
        };
        self.accessor(kind, F32, values.len() / width, bytemuck::cast_slice(values))
    }

    /// The document's first primitive.
    pub(super) fn primitive(&mut self) -> &mut Value {
        &mut self.json["meshes"][0]["primitives"][0]
    }

    /// The document as a GLB.
    pub(super) fn glb(&self) -> Vec<u8> {
        let mut builder = self.clone();
        if !builder.bin.is_empty() {
            builder.json["buffers"] = json!([{"byteLength": builder.bin.len()}]);
        }
        let mut text = serde_json::to_vec(&builder.json).unwrap();
        text.resize(text.len().next_multiple_of(4), b' ');
        builder.bin.resize(builder.bin.len().next_multiple_of(4), 0);
        let mut glb = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
        for (kind, data) in [(b"JSON", &text), (b"BIN\0", &builder.bin)] {
            glb.extend((data.len() as u32).to_le_bytes());
            glb.extend(kind);
            glb.extend(data);
        }
        let length = (glb.len() as u32).to_le_bytes();
        glb[8..12].copy_from_slice(&length);
        glb
    }

    /// Imports the document with default options.
    pub(super) fn import(&self) -> Result<Imported, ImportError> {
        import_bytes(&self.glb(), &ImportOptions::default())
    }

    /// Imports the document at a time of its first animation.
    pub(super) fn import_at(&self, time: f64) -> Result<Imported, ImportError> {
        import_bytes(&self.glb(), &ImportOptions { time_seconds: Some(time), ..ImportOptions::default() })
    }

    /// The message of the error that the document must give.
    pub(super) fn refusal(&self) -> String {
        self.import().expect_err("must be refused").to_string()
    }
}

/// Imports a file of these bytes.
pub(super) fn import_bytes(bytes: &[u8], options: &ImportOptions) -> Result<Imported, ImportError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.glb");
    fs_err::write(&path, bytes).unwrap();
    import(&path, options)
}
