//! What invalidates what: a test for each row of the table in `docs/rebakes.md`. Every bake here is compared with a
//! clean one, byte by byte.

use crate::scenes::split_glb;
use crate::village::{Bakes, CORNERS, EDGE, SETTINGS, texture, village};
use crate::workplace::glb;
use glam::{DMat4, DVec3, Vec3};
use manyview_pipeline::scene::Scene;
use serde_json::json;
use std::time::{Duration, SystemTime};

fn edited(edit: impl FnOnce(&mut Scene)) -> Scene {
    let mut scene = village();
    edit(&mut scene);
    scene
}

#[test]
fn a_bake_of_the_same_files_does_nothing() {
    let bakes = Bakes::of_village();
    let did = bakes.bake(&[]);
    assert!(did.is_up_to_date() && did.kinds().is_empty(), "{}", did.summary);
}

#[test]
fn touching_a_files_time_changes_nothing() {
    let bakes = Bakes::of_village();
    let file = fs_err::OpenOptions::new().write(true).open(bakes.work.path("scene.glb")).unwrap();
    file.file().set_modified(SystemTime::now() + Duration::from_secs(3600)).unwrap();
    assert!(bakes.bake(&[]).is_up_to_date());
}

#[test]
fn moving_the_folder_changes_nothing() {
    let bakes = Bakes::of_village();
    let (work, settings) = (&bakes.work, &SETTINGS[..]);
    work.write("a/scene.glb", &work.read("scene.glb"));
    let bake = |folder: &str| {
        let [scene, output] = ["scene.glb", "out.mvb"].map(|name| format!("{folder}/{name}"));
        let usual = ["bake", &scene, "-o", &output, "--cache", "cache", "--format", "json"];
        let run = work.run([&usual[..], settings].concat()).succeeded();
        serde_json::from_str::<serde_json::Value>(&run.stdout).unwrap()
    };
    // A copy elsewhere: everything but the file itself is there.
    let copy = bake("a");
    assert_eq!(copy["steps"]["rebuilt"], 2, "import and archive: {copy}");
    fs_err::rename(work.path("a"), work.path("b")).unwrap();
    assert_eq!(bake("b")["up_to_date"], true);
}

#[test]
fn another_order_or_name_of_nodes_rebakes_nothing_below_import() {
    let bakes = Bakes::of_village();
    let did = bakes.bake_scene(&edited(|scene| {
        scene.instances.reverse();
        scene.meshes.iter_mut().for_each(|mesh| mesh.name = format!("renamed {}", mesh.name));
        scene.materials.iter_mut().for_each(|material| material.name.push('!'));
    }));
    assert_eq!(did.kinds(), ["import", "archive"], "{}", did.summary);
}

#[test]
fn another_colour_of_a_texture_rebakes_attributes_alone() {
    let bakes = Bakes::of_village();
    let did = bakes.bake_scene(&edited(|scene| scene.textures[0] = texture([[9, 99, 199, 255]; 4])));
    assert_eq!(did.kinds(), ["import", "attributes", "archive"], "{}", did.summary);
    assert_eq!((did.reused("bricks"), did.rebuilt("rows")), (8, 0));
}

#[test]
fn another_material_rebakes_attributes_where_it_is() {
    let bakes = Bakes::of_village();
    let did = bakes.bake_scene(&edited(|scene| {
        // On one box alone.
        let mut mesh = scene.meshes[2].clone();
        mesh.material = scene.materials.len() as u32;
        let mut material = scene.materials[0].clone();
        material.base_color.x = 0.9;
        scene.materials.push(material);
        scene.instances[CORNERS + 1].mesh = scene.meshes.len() as u32;
        scene.meshes.push(mesh);
    }));
    assert_eq!(did.kinds(), ["import", "attributes", "archive"], "{}", did.summary);
    assert_eq!((did.rebuilt("attributes"), did.reused("attributes")), (1, 7));
}

#[test]
fn alpha_that_cuts_rebakes_bricks_and_rows_where_it_is() {
    let bakes = Bakes::of_village();
    let did = bakes.bake_scene(&edited(|scene| {
        scene.textures[1] =
            texture([[20, 90, 20, 0], [20, 90, 20, 255], [60, 120, 20, 0], [20, 90, 20, 255]]);
    }));
    assert_eq!(did.kinds(), ["import", "bricks", "attributes", "points", "rows", "archive"]);
    assert!(did.reused("bricks") > 0 && did.reused("points") > 0, "{}", did.summary);
}

#[test]
fn moving_an_object_rebakes_the_bricks_that_it_leaves_and_enters() {
    let bakes = Bakes::of_village();
    // Within its brick.
    let nudged = edited(|scene| scene.instances[CORNERS].world_from_object.w_axis.y += 0.5);
    let did = bakes.bake_scene(&nudged);
    assert_eq!((did.rebuilt("bricks"), did.reused("bricks")), (1, 7), "{}", did.summary);
    let blocks = did.rebuilt("rows");
    assert_eq!(did.patched("rows"), blocks, "rows are changed, not made anew: {}", did.summary);
    assert!(did.rebuilt("points") <= 16 && did.reused("points") > 20, "{}", did.summary);
    // From one corner to the opposite one.
    let mut far = nudged;
    let place = DVec3::splat(EDGE - 5.0);
    far.instances[CORNERS].world_from_object = DMat4::from_translation(place);
    let did = bakes.bake_scene(&far);
    assert_eq!((did.rebuilt("bricks"), did.reused("bricks")), (2, 6), "{}", did.summary);
    assert_eq!(did.patched("rows"), blocks);
    // And back: all is there still.
    let did = bakes.bake_scene(&village());
    assert_eq!(did.kinds(), ["import", "archive"], "{}", did.summary);
}

#[test]
fn adding_and_deleting_an_object_rebakes_where_it_is() {
    let bakes = Bakes::of_village();
    let fewer = edited(|scene| _ = scene.instances.remove(CORNERS + 3));
    let did = bakes.bake_scene(&fewer);
    assert!((1..=2).contains(&did.rebuilt("bricks")), "{}", did.summary);
    assert_eq!(did.patched("rows"), did.rebuilt("rows"));
    let did = bakes.bake_scene(&village());
    assert_eq!(did.kinds(), ["import", "archive"], "as before it was deleted");
}

#[test]
fn swapping_a_mesh_rebakes_where_it_is() {
    let bakes = Bakes::of_village();
    let did = bakes.bake_scene(&edited(|scene| scene.instances[CORNERS].mesh = 2));
    assert!((1..=2).contains(&did.rebuilt("bricks")), "{}", did.summary);
    assert_eq!(did.patched("rows"), did.rebuilt("rows"));
}

#[test]
fn a_light_rebakes_no_voxel() {
    let bakes = Bakes::of_village();
    let did = bakes.bake_scene(&edited(|scene| scene.lights[0].position = Vec3::splat(7.0)));
    assert_eq!(did.kinds(), ["import", "archive"], "{}", did.summary);
}

#[test]
fn a_parameter_rebakes_exactly_its_steps() {
    let bakes = Bakes::of_village();
    let with = |option: &str, value: &'static str| {
        let mut settings = SETTINGS.to_vec();
        match settings.iter().position(|word| *word == option) {
            Some(at) => settings[at + 1] = value,
            None => settings.extend([option.to_owned().leak(), value]),
        }
        bakes.bake_with(&settings, &[])
    };
    let did = with("--levels", "8");
    assert_eq!(did.kinds(), ["import", "bricks", "attributes", "archive"], "{}", did.summary);
    let did = with("--directions", "octahedral:9");
    assert_eq!(did.kinds(), ["import", "rows", "archive"], "{}", did.summary);
    let did = with("--grid", "cube");
    assert_eq!(did.kinds(), ["import", "rows", "archive"], "{}", did.summary);
    let did = with("--rows-from", "peel");
    assert_eq!(did.kinds(), ["import", "rows", "archive"], "{}", did.summary);
    let did = with("--rows-from", "rotate");
    assert_eq!(did.kinds(), ["import", "rows", "archive"], "{}", did.summary);
    let did = with("--rows", "32");
    assert_eq!(did.kinds(), ["import", "points", "rows", "archive"], "{}", did.summary);
    let did = with("--rows", "0");
    assert_eq!(did.kinds(), ["import", "archive"], "{}", did.summary);
}

#[test]
fn threads_backends_and_limits_are_in_no_key() {
    let bakes = Bakes::of_village();
    for arguments in
        [&["--jobs", "1"][..], &["--jobs", "3", "--max-memory", "2GiB"], &["--voxels-from", "peel"]]
    {
        assert!(bakes.bake(arguments).is_up_to_date(), "{arguments:?}");
    }
}

#[test]
fn growing_the_bounds_rebakes_all_rows_and_no_brick_elsewhere() {
    let bakes = Bakes::of_village();
    let did = bakes.bake_scene(&edited(|scene| scene.instances[1].world_from_object.w_axis.x += 0.25));
    assert_eq!((did.rebuilt("bricks"), did.reused("bricks")), (1, 7), "{}", did.summary);
    assert_eq!((did.reused("rows"), did.patched("rows"), did.reused("points")), (0, 0, 0));
}

#[test]
fn outgrowing_the_cube_rebakes_everything() {
    let bakes = Bakes::of_village();
    let did = bakes.bake_scene(&edited(|scene| scene.instances[1].world_from_object.w_axis.x += EDGE));
    assert_eq!((did.reused("bricks"), did.reused("attributes"), did.reused("rows")), (0, 0, 0));
}

#[test]
fn another_output_is_put_together_from_what_is_there() {
    let bakes = Bakes::of_village();
    fs_err::remove_file(bakes.work.path("out.mvb")).unwrap();
    let did = bakes.bake(&[]);
    assert_eq!(did.kinds(), ["import", "archive"], "the output was lost");
    bakes.work.write("out.mvb", b"something else");
    assert_eq!(bakes.bake(&[]).kinds(), ["import", "archive"], "the output was changed");
}

#[test]
fn files_beside_the_scene_count_by_content_also_missing_ones() {
    let bakes = Bakes::of_village();
    let work = &bakes.work;
    let (mut json, binary) = split_glb(&glb(&village()));
    json["buffers"][0]["uri"] = json!("scene.bin");
    json["images"][0] = json!({"uri": "wall.png"});
    work.write("scene.bin", &binary);
    work.write("scene.gltf", &serde_json::to_vec(&json).unwrap());
    let usual = ["bake", "scene.gltf", "-o", "g.mvb", "--cache", "cache", "--format", "json"];
    let bake = || {
        let run = work.run([&usual[..], &SETTINGS[..]].concat()).succeeded();
        let summary: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
        summary
    };
    let rebuilt =
        |summary: &serde_json::Value, kind: &str| summary["steps"]["kinds"][kind]["rebuilt"].as_u64();
    let missing = bake();
    assert_eq!(rebuilt(&missing, "rows"), Some(0), "without its texture the village has the same shape");
    assert_eq!(bake()["up_to_date"], true);
    let png = |color: [u8; 4]| {
        let mut bytes = std::io::Cursor::new(Vec::new());
        image::RgbaImage::from_pixel(2, 2, image::Rgba(color))
            .write_to(&mut bytes, image::ImageFormat::Png)
            .unwrap();
        bytes.into_inner()
    };
    work.write("wall.png", &png([1, 2, 3, 255]));
    let appeared = bake();
    assert_eq!((&appeared["up_to_date"], rebuilt(&appeared, "bricks")), (&json!(false), Some(0)));
    assert!(rebuilt(&appeared, "attributes") > Some(0), "{appeared}");
    work.write("wall.png", &png([3, 2, 1, 255]));
    let changed = bake();
    assert!(rebuilt(&changed, "attributes") > Some(0), "{changed}");
    fs_err::remove_file(work.path("wall.png")).unwrap();
    let gone = bake();
    assert_eq!(
        (&gone["up_to_date"], rebuilt(&gone, "attributes")),
        (&json!(false), Some(0)),
        "known from before"
    );
}

#[test]
fn no_cache_keeps_nothing_and_the_cache_is_where_it_is_said() {
    let bakes = Bakes { work: crate::workplace::Workplace::new() };
    let work = &bakes.work;
    work.write_scene("scene.glb", &village());
    let bake = [&["bake", "scene.glb", "-o", "out.mvb"], &SETTINGS[..]].concat();
    let run = |arguments: &[&str], variable: &str| {
        let mut command = work.command();
        command.env("MANYVIEW_CACHE", variable).args(&bake).args(arguments);
        crate::workplace::Run::of(&mut command).succeeded()
    };
    run(&["--no-cache"], "by variable");
    run(&[], "");
    assert_eq!(work.names(), ["out.mvb", "scene.glb"]);
    run(&[], "by variable");
    assert!(work.path("by variable/rows-v2").is_dir());
    run(&["--cache", "by option"], "by variable");
    assert!(work.path("by option/rows-v2").is_dir());
    let path = work.run(["cache", "path", "--cache", "by option"]).succeeded();
    assert_eq!(path.stdout.trim(), "by option");
}
