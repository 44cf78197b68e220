//! Any sequence of edits: every rebake gives the bytes of a clean bake.

use crate::scenes::box_mesh;
use crate::village::{EDGE, texture, village};
use glam::{DMat4, DQuat, DVec3, Vec3};
use manyview_cache::archive::ArchiveWriter;
use manyview_cache::store::Store;
use manyview_pipeline::bake::{BakeOptions, RowsFrom, Silent, bake_in_memory, bake_with};
use manyview_pipeline::rows::RowsOptions;
use manyview_pipeline::scene::Scene;
use manyview_pipeline::steps::Steps;
use manyview_shaders::directions::{DirectionSet, Fit};
use proptest::prelude::*;
use std::sync::Arc;

fn options() -> BakeOptions {
    BakeOptions {
        levels: 9,
        rows: Some(RowsOptions {
            bits: 5,
            directions: DirectionSet::LatLong { thetas: 5, phis: 5 },
            fit: Fit::Extent,
            from: RowsFrom::Points,
        }),
        ..BakeOptions::default()
    }
}

/// One edit; numbers are taken modulo what there is.
#[derive(Debug, Clone)]
enum Edit {
    Move(usize, [f64; 3]),
    Turn(usize, f64),
    Add(usize, [f64; 3]),
    Delete(usize),
    SwapMesh(usize, usize),
    Reshape(usize, f32),
    Paint(usize, f32),
    Glow(usize, f32),
    Texture(usize, [u8; 4]),
    Light(f32),
    Reorder,
    Levels(u32),
    RowsBits(u32),
    From(usize),
    CutOff(f32),
}

fn edit() -> impl Strategy<Value = Edit> {
    let place = || prop::array::uniform3(0.0..EDGE - 5.0);
    prop_oneof![
        6 => (any::<usize>(), place()).prop_map(|(i, p)| Edit::Move(i, p)),
        1 => (any::<usize>(), 0.0..6.0).prop_map(|(i, a)| Edit::Turn(i, a)),
        2 => (any::<usize>(), place()).prop_map(|(i, p)| Edit::Add(i, p)),
        2 => any::<usize>().prop_map(Edit::Delete),
        2 => (any::<usize>(), any::<usize>()).prop_map(|(i, m)| Edit::SwapMesh(i, m)),
        1 => (any::<usize>(), 0.5f32..4.0).prop_map(|(m, s)| Edit::Reshape(m, s)),
        1 => (any::<usize>(), 0.0f32..1.0).prop_map(|(m, c)| Edit::Paint(m, c)),
        1 => (any::<usize>(), 0.0f32..2.0).prop_map(|(m, c)| Edit::Glow(m, c)),
        1 => (any::<usize>(), any::<[u8; 4]>()).prop_map(|(t, c)| Edit::Texture(t, c)),
        1 => (0.0f32..9.0).prop_map(Edit::Light),
        1 => Just(Edit::Reorder),
        1 => (7u32..10).prop_map(Edit::Levels),
        1 => (5u32..7).prop_map(Edit::RowsBits),
        1 => any::<usize>().prop_map(Edit::From),
        1 => (0.0f32..1.0).prop_map(Edit::CutOff),
    ]
}

fn apply(edit: &Edit, scene: &mut Scene, options: &mut BakeOptions) {
    let instances = scene.instances.len();
    let rows = options.rows.as_mut().expect("with rows");
    match *edit {
        Edit::Move(i, p) => {
            scene.instances[i % instances].world_from_object.w_axis = DVec3::from(p).extend(1.0);
        }
        Edit::Turn(i, angle) => {
            let matrix = &mut scene.instances[i % instances].world_from_object;
            *matrix *= DMat4::from_quat(DQuat::from_rotation_y(angle));
        }
        Edit::Add(i, p) => {
            let mut instance = scene.instances[i % instances];
            instance.world_from_object = DMat4::from_translation(DVec3::from(p));
            scene.instances.push(instance);
        }
        Edit::Delete(i) if instances > 2 => _ = scene.instances.remove(i % instances),
        Edit::Delete(_) => {}
        Edit::SwapMesh(i, mesh) => scene.instances[i % instances].mesh = (mesh % scene.meshes.len()) as u32,
        Edit::Reshape(mesh, size) => {
            let count = scene.meshes.len();
            let mesh = &mut scene.meshes[mesh % count];
            let other = box_mesh(Vec3::ZERO, Vec3::new(size, 1.0, size * 0.5));
            (mesh.positions, mesh.triangles) = (other.positions, other.triangles);
            mesh.base_color_uvs = other.base_color_uvs;
        }
        Edit::Paint(material, value) => {
            let count = scene.materials.len();
            scene.materials[material % count].base_color.y = value;
        }
        Edit::Glow(material, value) => {
            let count = scene.materials.len();
            scene.materials[material % count].emissive = Vec3::splat((value - 1.0).max(0.0));
        }
        Edit::Texture(index, color) => {
            let count = scene.textures.len();
            scene.textures[index % count] = texture([color, [255; 4], color, [9, 9, 9, 0]]);
        }
        Edit::Light(x) => scene.lights[0].position.x = x,
        Edit::Reorder => {
            scene.instances.reverse();
            scene.meshes.iter_mut().for_each(|mesh| mesh.triangles.rotate_left(1));
        }
        Edit::Levels(levels) => options.levels = levels,
        Edit::RowsBits(bits) => rows.bits = bits,
        Edit::From(way) => rows.from = RowsFrom::ALL[way % 3].0,
        Edit::CutOff(cutoff) => {
            scene.materials[2].alpha_mode = manyview_pipeline::scene::AlphaMode::Mask { cutoff };
        }
    }
}

fn rebake(scene: &Scene, options: &BakeOptions, store: &Arc<Store>) -> Result<Vec<u8>, String> {
    let steps = Steps::new(Some(store.clone()));
    let mut writer = ArchiveWriter::in_memory().unwrap();
    bake_with(scene, options, None, &steps, &mut writer, &Silent).map_err(|error| error.to_string())?;
    steps.flush();
    assert_eq!(store.take_warnings(), Vec::<String>::new());
    Ok(writer.finish().unwrap().0)
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: std::env::var("MANYVIEW_STRESS").ok().and_then(|n| n.parse::<u32>().ok()).unwrap_or(1) * 8,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn every_rebake_after_any_edits_is_a_clean_bake(edits in prop::collection::vec(edit(), 4..8)) {
        let folder = tempfile::tempdir().unwrap();
        let store = Arc::new(Store::open(folder.path()).unwrap());
        let (mut scene, mut options) = (village(), options());
        rebake(&scene, &options, &store).unwrap();
        for (number, edit) in edits.iter().enumerate() {
            apply(edit, &mut scene, &mut options);
            let clean = bake_in_memory(&scene, &options).map_err(|error| error.to_string());
            let again = rebake(&scene, &options, &store);
            prop_assert!(again == clean, "edit {} of {:?}", number, edits);
        }
    }
}
