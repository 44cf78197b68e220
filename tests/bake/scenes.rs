//! Small scenes whose voxels are known.

use glam::{DMat4, DVec3, Vec2, Vec3, Vec4};
use manyview::Archive;
use manyview_pipeline::bake::{BakeOptions, bake_in_memory};
use manyview_pipeline::cube::SceneCube;
use manyview_pipeline::rows::{RowsFrom, RowsOptions};
use manyview_pipeline::scene::{AlphaMode, Instance, Material, Mesh, Scene, Texture, Wrap};
use manyview_shaders::directions::{DirectionSet, Fit};
use serde_json::{Value, json};

/// A scene of one mesh with one material, in its place.
pub(crate) fn one_mesh(mesh: Mesh, material: Material) -> Scene {
    Scene {
        meshes: vec![mesh],
        instances: vec![Instance { mesh: 0, world_from_object: DMat4::IDENTITY }],
        materials: vec![material],
        ..Scene::default()
    }
}

/// A mesh of quads, counter-clockwise, as two triangles each; texture coordinates run over each.
pub(crate) fn quads(quads: &[[Vec3; 4]]) -> Mesh {
    let mut mesh = Mesh::default();
    for quad in quads {
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(quad);
        mesh.base_color_uvs.extend([Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y]);
        mesh.triangles.extend([[0, 1, 2], [0, 2, 3]].map(|t| t.map(|v| first + v)));
    }
    mesh
}

/// The surface of an axis-aligned box, fronts outside.
pub(crate) fn box_mesh(min: Vec3, max: Vec3) -> Mesh {
    let corner =
        |bits: usize| Vec3::from_array([0, 1, 2].map(|i| if bits >> i & 1 == 1 { max[i] } else { min[i] }));
    // Corner bits: 1 is x, 2 is y, 4 is z.
    quads(
        &[[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]]
            .map(|q| q.map(corner)),
    )
}

/// A horizontal square from (min, y, min) to (max, y, max), its front above; u of the texture runs along x.
pub(crate) fn floor_mesh(min: f32, max: f32, y: f32) -> Mesh {
    let corner = |x, z| Vec3::new(x, y, z);
    let mut mesh = quads(&[[corner(min, max), corner(max, max), corner(max, min), corner(min, min)]]);
    mesh.name = "floor".to_owned();
    mesh
}

/// A closed sphere of about `4 · steps²` triangles. Its vertices are points of a subdivided octahedron.
pub(crate) fn sphere_mesh(center: Vec3, radius: f32, steps: u32) -> Mesh {
    let mut mesh = Mesh::default();
    for octant in 0..8u32 {
        let sign = |bit: u32| if octant >> bit & 1 == 1 { -1.0 } else { 1.0 };
        let signs = Vec3::new(sign(0), sign(1), sign(2));
        let mirrored = octant.count_ones() % 2 == 1;
        let first = mesh.positions.len() as u32;
        // Row i has the points with i + j + k = steps.
        let index = |i: u32, j: u32| first + (0..i).map(|row| steps - row + 1).sum::<u32>() + j;
        for i in 0..=steps {
            for j in 0..=steps - i {
                let point = Vec3::new(i as f32, j as f32, (steps - i - j) as f32) * signs;
                mesh.positions.push(center + point / point.length() * radius);
            }
        }
        for i in 0..steps {
            for j in 0..steps - i {
                let mut push = |[a, b, c]: [u32; 3]| {
                    mesh.triangles.push(if mirrored { [a, c, b] } else { [a, b, c] });
                };
                push([index(i, j), index(i + 1, j), index(i, j + 1)]);
                if j + 1 < steps - i {
                    push([index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)]);
                }
            }
        }
    }
    mesh
}

/// A material that a texture of 2 × 1 texels cuts: nothing for u < ½, everything above.
pub(crate) fn cut_in_half() -> (Material, Texture) {
    let material = Material {
        base_color_texture: Some(0),
        alpha_mode: AlphaMode::Mask { cutoff: 0.5 },
        ..Material::default()
    };
    let texels = vec![[255, 0, 0, 0], [0, 255, 0, 255]];
    (material, Texture { width: 2, height: 1, texels, wrap: [Wrap::ClampToEdge; 2] })
}

/// A material of one colour.
pub(crate) fn plain(color: [f32; 3]) -> Material {
    Material { base_color: Vec4::from((Vec3::from_array(color), 1.0)), ..Material::default() }
}

/// Translates the only instance of a scene.
pub(crate) fn moved(mut scene: Scene, by: DVec3) -> Scene {
    for instance in &mut scene.instances {
        instance.world_from_object = DMat4::from_translation(by) * instance.world_from_object;
    }
    scene
}

/// Small settings for the library: a cube of 2^levels metres at the origin, so that voxels are a metre wide.
pub(crate) fn metre_voxels(levels: u32) -> BakeOptions {
    let cube = SceneCube { origin: [0.0; 3], size: f64::from(1u32 << levels) };
    BakeOptions { levels, rows: None, cube: Some(cube), ..BakeOptions::default() }
}

/// Small settings for the library, with rows of 32³.
pub(crate) fn small(rows_from: RowsFrom) -> BakeOptions {
    BakeOptions {
        levels: 6,
        rows: Some(RowsOptions {
            bits: 5,
            directions: DirectionSet::LatLong { thetas: 6, phis: 6 },
            fit: Fit::Extent,
            from: rows_from,
        }),
        ..BakeOptions::default()
    }
}

/// Bakes in memory and opens the result.
pub(crate) fn baked(scene: &Scene, options: &BakeOptions) -> Archive {
    Archive::from_bytes(bake_in_memory(scene, options).expect("a scene that can be baked")).unwrap()
}

/// Name, item and digest of every section of the octree and the rows.
pub(crate) fn geometry_digests(archive: &Archive) -> Vec<String> {
    let sections = archive.container().sections().iter();
    let digests: Vec<String> = sections
        .filter(|section| !section.id.name.as_str().starts_with("scene."))
        .map(|section| format!("{} {:?}", section.id, section.digest))
        .collect();
    assert!(digests.len() > 5);
    digests
}

/// A GLB of one triangle; `edit` may change its JSON.
pub(crate) fn triangle_glb(positions: [[f32; 3]; 3], edit: impl FnOnce(&mut Value)) -> Vec<u8> {
    let mut binary: Vec<u8> = positions.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
    binary.extend([0u16, 1, 2, 0].iter().flat_map(|i| i.to_le_bytes()));
    let mut json = json!({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{}],
        "buffers": [{"byteLength": binary.len()}],
        "bufferViews": [
            {"buffer": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 6}
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"}
        ],
    });
    edit(&mut json);
    join_glb(&json, &binary)
}

/// JSON and binary chunk of a GLB.
pub(crate) fn join_glb(json: &Value, binary: &[u8]) -> Vec<u8> {
    let mut text = serde_json::to_vec(json).unwrap();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut glb = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
    for (kind, data) in [(b"JSON", &text[..]), (b"BIN\0", binary)] {
        glb.extend((data.len() as u32).to_le_bytes());
        glb.extend(kind);
        glb.extend(data);
    }
    let length = (glb.len() as u32).to_le_bytes();
    glb[8..12].copy_from_slice(&length);
    glb
}

/// The JSON and the binary chunk of a GLB.
pub(crate) fn split_glb(glb: &[u8]) -> (Value, Vec<u8>) {
    let number = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().unwrap()) as usize;
    let json_end = 20 + number(12);
    let json = serde_json::from_slice(&glb[20..json_end]).unwrap();
    (json, glb[json_end + 8..json_end + 8 + number(json_end)].to_vec())
}
