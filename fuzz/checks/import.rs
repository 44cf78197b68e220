//! Any bytes as a glTF or GLB file, at rest and at a time: refused with a message that names the file, or a scene that
//! keeps what its types promise.

use manyview_pipeline::import::{ImportError, ImportOptions, import_bytes};
use manyview_pipeline::scene::Scene;
use std::path::Path;

/// Small enough that a run that takes it is noticed, large enough for every honest seed.
const MAX_MEMORY_BYTES: u64 = 64 << 20;
const MAX_TRIANGLES: u64 = 1 << 20;

/// Fails if the rule is broken.
pub(crate) fn check(data: &[u8]) {
    for time_seconds in [None, Some(0.5)] {
        let options = ImportOptions {
            time_seconds,
            max_memory_bytes: MAX_MEMORY_BYTES,
            max_triangles: MAX_TRIANGLES,
            ..ImportOptions::default()
        };
        // Where nothing is, so that no file beside the scene is ever found.
        match import_bytes("fuzz.gltf", data, Path::new("no such folder"), &options) {
            Ok(imported) => expect_sound(&imported.scene),
            Err(ImportError::OverLimit { value, limit, .. }) => assert!(value > limit),
            Err(error) => assert!(error.to_string().starts_with("fuzz.gltf: "), "{error}"),
        }
    }
}

fn expect_sound(scene: &Scene) {
    assert!(scene.drawn_triangles() <= MAX_TRIANGLES);
    for mesh in &scene.meshes {
        let count = mesh.positions.len();
        assert!(mesh.positions.iter().all(|position| position.is_finite()));
        assert!(mesh.triangles.iter().flatten().all(|&vertex| (vertex as usize) < count));
        for length in
            [mesh.normals.len(), mesh.base_color_uvs.len(), mesh.emissive_uvs.len(), mesh.colors.len()]
        {
            assert!(length == 0 || length == count);
        }
        assert!(mesh.normals.iter().all(|normal| normal.is_finite()));
        assert!(mesh.base_color_uvs.iter().chain(&mesh.emissive_uvs).all(|uv| uv.is_finite()));
        assert!(mesh.colors.iter().all(|color| color.is_finite()));
        assert!((mesh.material as usize) < scene.materials.len());
    }
    for instance in &scene.instances {
        assert!((instance.mesh as usize) < scene.meshes.len() && instance.world_from_object.is_finite());
    }
    for material in &scene.materials {
        assert!(material.base_color.is_finite() && material.emissive.is_finite());
        for texture in [material.base_color_texture, material.emissive_texture].into_iter().flatten() {
            assert!((texture as usize) < scene.textures.len());
        }
    }
}
