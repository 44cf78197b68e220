//! `KHR_draco_mesh_compression`: primitives packed by Draco, unpacked by a decoder in safe Rust.

use super::error::ImportError;
use super::json::Json;
use super::resources::Resources;
use draco_core::{DecodeLimits, DecoderBuffer, Mesh, MeshDecoder};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// An unpacked primitive.
pub(super) struct Decoded {
    mesh: Mesh,
    /// Vertices.
    pub(super) vertex_count: usize,
}

impl Decoded {
    /// Unpacks the primitive whose extension object is `extension`.
    pub(super) fn decode(resources: &Resources<'_>, extension: &Json<'_>) -> Result<Self, ImportError> {
        /// Positions, normals, texture coordinates, colours, and what Draco needs beside them while it decodes.
        const BYTES_PER_ELEMENT: u64 = 64;
        let view = resources.view(extension.required_index("bufferView")?)?;
        let limit = resources.available_bytes() / BYTES_PER_ELEMENT;
        let limits = DecodeLimits::default()
            .with_max_points(limit)
            .with_max_faces(limit)
            .with_max_decoded_bytes(resources.available_bytes());
        let mut buffer = DecoderBuffer::new(view.bytes).with_limits(limits);
        // A decoder of this size may still hold a slip; broken data must not take the whole bake down.
        let decoded = catch_unwind(AssertUnwindSafe(|| {
            let mut mesh = Mesh::new();
            MeshDecoder::new()
                .decode(&mut buffer, &mut mesh)
                .map(|()| mesh)
                .map_err(|error| error.to_string())
        }));
        let mesh = match decoded {
            Ok(Ok(mesh)) => mesh,
            Ok(Err(error)) => return Err(extension.malformed(format!("its Draco data is broken: {error}"))),
            Err(_) => return Err(extension.malformed("its Draco data is broken")),
        };
        let vertex_count = mesh.num_points();
        resources.charge(
            (vertex_count as u64 + mesh.num_faces() as u64) * BYTES_PER_ELEMENT,
            &extension.place(),
        )?;
        Ok(Self { mesh, vertex_count })
    }

    /// Vertex indices of all triangles.
    pub(super) fn indices(&self) -> Vec<u32> {
        self.mesh.faces().iter().flatten().map(|point| point.0).collect()
    }

    /// `width` components of the attribute `unique_id` for every vertex, or `None` if there is no such attribute.
    pub(super) fn read(&self, unique_id: u32, width: usize) -> Option<Vec<f32>> {
        let attribute = self.mesh.attribute_by_unique_id(unique_id)?;
        Some(attribute.read_f32s(self.vertex_count, width))
    }
}
