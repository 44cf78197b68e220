//! The archive's bytes depend on the scene and the settings alone.

use crate::scenes::{baked, geometry_digests, small, split_glb};
use crate::workplace::{SMALL, Workplace, glb};
use manyview_pipeline::generate::{SceneKind, generate};
use manyview_pipeline::rows::RowsFrom;
use manyview_pipeline::run::Bake;
use manyview_pipeline::scene::Scene;
use manyview_pipeline::triangles::Cutouts;
use serde_json::json;

/// A scene with foliage that alpha cuts.
fn forest() -> Scene {
    let scene = generate(SceneKind::Forest, 3000, 5);
    assert!(!Cutouts::new(&scene).masks.is_empty(), "some leaves are cut out by a texture");
    scene
}

#[test]
fn threads_runs_and_folders_do_not_show() {
    let work = Workplace::new();
    let scene = forest();
    work.write_scene("forest.glb", &scene);
    work.write_scene("ein anderer/Wald ü.glb", &scene);
    for way in ["points", "peel", "rotate"] {
        let one = work.bake("forest.glb", "one.mvb", &["--jobs", "1", "--rows-from", way]);
        let two = work.bake("forest.glb", "two.mvb", &["--jobs", "2", "--rows-from", way]);
        assert!(one == two, "{way}: --jobs 1 and 2 differ");
        let again = work.bake("forest.glb", "one.mvb", &["--jobs", "3", "--rows-from", way]);
        assert!(one == again, "{way}: a second run differs");
        let moved = work.bake("ein anderer/Wald ü.glb", "ein anderer/o.mvb", &["--rows-from", way]);
        assert!(one == moved, "{way}: a copy in another folder differs");
    }
}

#[test]
fn depth_peeling_on_the_cpu_gives_the_same_bytes() {
    let work = Workplace::new();
    work.write_scene("forest.glb", &forest());
    let usual = work.bake("forest.glb", "a.mvb", &["--rows-from", "peel"]);
    let peeled = work.bake("forest.glb", "b.mvb", &["--rows-from", "peel", "--voxels-from", "peel"]);
    assert!(usual == peeled);
}

#[test]
fn a_gltf_with_external_files_bakes_as_its_glb_does() {
    let work = Workplace::new();
    let bytes = glb(&forest());
    work.write("a.glb", &bytes);
    let (mut json, binary) = split_glb(&bytes);
    json["buffers"][0]["uri"] = json!("data/all%20bytes.bin");
    let views = json["bufferViews"].as_array().unwrap().clone();
    let images = json["images"].as_array_mut().unwrap();
    assert!(!images.is_empty());
    for (number, image) in images.iter_mut().enumerate() {
        let view = &views[image["bufferView"].as_u64().unwrap() as usize];
        let start = view["byteOffset"].as_u64().unwrap_or(0) as usize;
        let end = start + view["byteLength"].as_u64().unwrap() as usize;
        work.write(&format!("b/textures/{number}.png"), &binary[start..end]);
        *image = json!({"uri": format!("textures/{number}.png")});
    }
    work.write("b/data/all bytes.bin", &binary);
    work.write("b/a.gltf", &serde_json::to_vec(&json).unwrap());
    assert!(work.bake("a.glb", "a.mvb", &[]) == work.bake("b/a.gltf", "b.mvb", &[]));
}

#[test]
fn the_library_writes_what_the_command_writes() {
    let work = Workplace::new();
    work.write_scene("forest.glb", &forest());
    let expected = work.bake("forest.glb", "command.mvb", &[]);
    let mut bake = Bake::new(work.path("forest.glb"));
    assert_eq!(bake.output, work.path("forest.mvb"), "beside the scene by default");
    bake.options = small(RowsFrom::Points);
    bake.jobs = Some(2);
    let summary = bake.run().unwrap();
    assert!(work.read("forest.mvb") == expected);
    assert_eq!(summary.archive.file_bytes, expected.len() as u64);
    assert_eq!(summary.files, [work.path("forest.glb")]);
}

#[test]
fn the_order_of_triangles_and_nodes_does_not_show() {
    let scene = forest();
    let mut shuffled = scene.clone();
    shuffled.instances.reverse();
    for mesh in &mut shuffled.meshes {
        let middle = mesh.triangles.len() / 3;
        mesh.triangles.rotate_left(middle);
    }
    for way in [RowsFrom::Points, RowsFrom::Peel, RowsFrom::Rotate] {
        let digests = |scene| geometry_digests(&baked(scene, &small(way)));
        assert_eq!(digests(&scene), digests(&shuffled), "{way}");
    }
    // And as `diff` sees it.
    let work = Workplace::new();
    work.write_scene("a.glb", &scene);
    work.write_scene("b.glb", &shuffled);
    assert!(work.bake("a.glb", "a.mvb", &[]) == work.bake("b.glb", "b.mvb", &[]));
    work.run(["diff", "a.mvb", "b.mvb"]).succeeded();
}

#[test]
fn every_setting_that_matters_shows() {
    let work = Workplace::new();
    work.write_scene("forest.glb", &forest());
    let plain = work.bake("forest.glb", "plain.mvb", &[]);
    let changed: [&[&str]; 6] = [
        &["--levels", "5"],
        &["--rows", "64"],
        &["--directions", "octahedral:6"],
        &["--grid", "cube"],
        &["--rows-from", "peel"],
        &["--rows", "0"],
    ];
    for arguments in changed {
        // The last of two equal options would be refused, so the small settings are written out.
        let mut settings = SMALL.to_vec();
        settings.retain(|word| *word != "--backend" && *word != "cpu");
        if let Some(at) = settings.iter().position(|word| *word == arguments[0]) {
            settings.drain(at..at + 2);
        }
        let all = [&["bake", "forest.glb", "-o", "other.mvb", "--backend", "cpu"], &settings[..], arguments];
        work.run(all.concat()).succeeded();
        assert!(work.read("other.mvb") != plain, "{arguments:?} changes nothing");
        assert_eq!(work.run(["diff", "plain.mvb", "other.mvb"]).code, Some(1), "{arguments:?}");
    }
}
