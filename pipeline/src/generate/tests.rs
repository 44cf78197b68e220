use super::*;
use crate::glb::write_glb;

fn each_kind_and_size(mut check: impl FnMut(SceneKind, u64, &Scene)) {
    for kind in SceneKind::all() {
        for triangles in [1_000, 5_000, 30_000, 100_000, 700_000] {
            check(kind, triangles, &generate(kind, triangles, 7));
        }
    }
}

#[test]
fn counts_are_within_three_per_cent() {
    each_kind_and_size(|kind, triangles, scene| {
        let drawn = scene.drawn_triangles();
        assert!(drawn.abs_diff(triangles) * 100 <= 3 * triangles, "{kind} of {triangles} draws {drawn}");
    });
}

#[test]
fn counts_hold_for_any_seed_and_odd_numbers() {
    for kind in SceneKind::all() {
        for triangles in [1_000, 1_777, 2_999, 4_001, 7_919, 14_000, 19_999, 20_001, 54_321] {
            for seed in 0..4 {
                let drawn = generate(kind, triangles, seed).drawn_triangles();
                let what = format!("{kind} of {triangles}, seed {seed}, draws {drawn}");
                assert!(drawn.abs_diff(triangles) * 100 <= 3 * triangles, "{what}");
            }
        }
    }
}

#[test]
fn every_number_is_finite_and_every_index_valid() {
    each_kind_and_size(|kind, triangles, scene| {
        for mesh in &scene.meshes {
            let count = mesh.positions.len();
            let what = format!("{kind} {triangles}: {}", mesh.name);
            assert!(!mesh.triangles.is_empty(), "{what} is empty");
            assert!(mesh.triangles.iter().flatten().all(|index| (*index as usize) < count), "{what}");
            assert!(mesh.positions.iter().all(|p| p.is_finite()), "{what}");
            assert!(mesh.normals.is_empty() || mesh.normals.len() == count, "{what}");
            assert!(mesh.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-4), "{what}: normals");
            assert!(mesh.colors.is_empty() || mesh.colors.len() == count, "{what}");
            let material = &scene.materials[mesh.material as usize];
            let textured = material.base_color_texture.is_some();
            assert_eq!(mesh.base_color_uvs.len(), if textured { count } else { 0 }, "{what}: uvs");
            assert!(mesh.base_color_uvs.iter().all(|uv| uv.is_finite()), "{what}: uvs");
        }
        for material in &scene.materials {
            assert!(material.base_color_texture.is_none_or(|t| (t as usize) < scene.textures.len()));
        }
        assert!(scene.instances.iter().all(|i| (i.mesh as usize) < scene.meshes.len()));
        assert!(scene.instances.iter().all(|i| i.world_from_object.is_finite()));
    });
}

#[test]
fn one_seed_gives_the_same_bytes_and_another_gives_others() {
    for kind in SceneKind::all() {
        let bytes = |seed: u64| {
            let mut bytes = Vec::new();
            write_glb(&generate(kind, 3_000, seed), &mut bytes).unwrap();
            bytes
        };
        assert!(bytes(1) == bytes(1), "{kind} differs between runs");
        assert!(bytes(1) != bytes(2), "{kind} ignores the seed");
    }
}

#[test]
fn hardly_any_triangle_is_degenerate() {
    each_kind_and_size(|kind, triangles, scene| {
        let mut flat = 0;
        for mesh in &scene.meshes {
            for [a, b, c] in &mesh.triangles {
                let p = |i: &u32| mesh.positions[*i as usize];
                flat += u64::from((p(b) - p(a)).cross(p(c) - p(a)).length_squared() == 0.0);
            }
        }
        assert_eq!(flat, 0, "{kind} of {triangles}");
    });
}

#[test]
fn larger_scenes_hold_more_unique_triangles() {
    for kind in SceneKind::all() {
        let scene = generate(kind, 700_000, 1);
        let unique: u64 = scene.meshes.iter().map(|mesh| mesh.triangles.len() as u64).sum();
        assert!(unique * 4 > scene.drawn_triangles(), "{kind}: {unique} unique triangles");
    }
}

#[test]
fn the_town_has_lamps_lit_windows_and_masked_leaves() {
    let scene = generate(SceneKind::Town, 100_000, 1);
    assert!(scene.lights.len() >= 20, "{} lights", scene.lights.len());
    assert!(scene.materials.iter().any(|material| material.emissive.max_element() > 1.0));
    assert!(scene.materials.iter().any(|material| material.alpha_mode.cutoff().is_some()));
    let (low, high) = scene.bounds().unwrap();
    let size = high - low;
    assert!(size.x > 100.0 && size.x < 500.0 && size.y > 20.0 && size.y < 80.0, "{size}");
}

#[test]
fn names_are_read_back() {
    for kind in SceneKind::all() {
        assert_eq!(kind.to_string().parse(), Ok(kind));
    }
    let error = "village".parse::<SceneKind>().unwrap_err();
    assert_eq!(error.to_string(), "no scene is called \"village\": use town, city, forest, hairball or park");
}

/// Frozen digests: whoever changes a generator changes them here, and a host that computes otherwise fails.
#[test]
fn bits_are_frozen() {
    let digests: Vec<_> =
        SceneKind::all().into_iter().map(|kind| digest(&generate(kind, 20_000, 1))).collect();
    assert_eq!(
        digests,
        ["cd91b23e077d52ce", "fa32fef5d24c15b9", "81db9e54e4881de3", "391b6193fe6a5a78", "7b2622da1350c6ce"]
    );
}

/// The first 16 hexadecimal digits of a hash over geometry, placement, textures and lights.
fn digest(scene: &Scene) -> String {
    let mut hasher = blake3::Hasher::new();
    let mut numbers = |values: &[f32]| {
        for value in values {
            hasher.update(&value.to_le_bytes());
        }
    };
    for mesh in &scene.meshes {
        mesh.positions.iter().chain(&mesh.normals).for_each(|p| numbers(&p.to_array()));
        mesh.base_color_uvs.iter().for_each(|uv| numbers(&uv.to_array()));
        mesh.colors.iter().for_each(|color| numbers(&color.to_array()));
    }
    for light in &scene.lights {
        numbers(&light.position.to_array());
    }
    for index in scene.meshes.iter().flat_map(|mesh| mesh.triangles.iter().flatten()) {
        hasher.update(&index.to_le_bytes());
    }
    for value in scene.instances.iter().flat_map(|instance| instance.world_from_object.to_cols_array()) {
        hasher.update(&value.to_le_bytes());
    }
    for texture in &scene.textures {
        hasher.update(bytemuck::cast_slice(&texture.texels));
    }
    hasher.finalize().to_hex()[..16].to_owned()
}
