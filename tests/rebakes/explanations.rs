//! `--explain`, `--dry-run`, the summary, events, `cache stat`, and what `diff` says of an edit.

use crate::village::{Bakes, CORNERS, SETTINGS, texture, village};
use crate::workplace::{Run, Workplace};
use serde_json::Value;

const EXPLAIN: [&str; 7] = ["bake", "scene.glb", "-o", "out.mvb", "--cache", "cache", "--explain"];

fn dry(work: &Workplace, settings: &[&str]) -> String {
    work.run([&EXPLAIN[..], &["--dry-run"], settings].concat()).succeeded().stdout
}

fn dry_json(work: &Workplace) -> Vec<Value> {
    let arguments = [&EXPLAIN[..], &["--dry-run", "--format", "json"], &SETTINGS[..]].concat();
    let value: Value = serde_json::from_str(&work.run(arguments).succeeded().stdout).unwrap();
    assert!(value["triangles"].as_u64().unwrap() > 0, "the estimate is there, too");
    value["steps"].as_array().unwrap().clone()
}

#[test]
fn a_first_bake_says_so_and_a_dry_run_writes_nothing() {
    let work = Workplace::new();
    work.write_scene("scene.glb", &village());
    let text = dry(&work, &SETTINGS);
    assert!(text.contains("bricks  8 to make, 0 in the cache"), "{text}");
    assert!(text.contains("the cache remembers no bake of this output"), "{text}");
    assert_eq!(work.names(), ["scene.glb"], "not even a cache");
}

#[test]
fn nothing_to_do_is_said_in_one_line() {
    let bakes = Bakes::of_village();
    let text = dry(&bakes.work, &SETTINGS);
    assert!(text.ends_with("nothing to make: the archive is what a bake would write\n"), "{text}");
    let run = bakes.work.run([&EXPLAIN[..6], &SETTINGS[..]].concat()).succeeded();
    assert!(
        run.stdout.contains("up to date") && run.stdout.contains(" 0 rebuilt, 0 failed"),
        "{}",
        run.stdout
    );
}

#[test]
fn a_moved_object_is_named_with_both_places_and_exactly_its_steps() {
    let bakes = Bakes::of_village();
    let mut scene = village();
    scene.instances[CORNERS].world_from_object.w_axis.y += 0.5;
    bakes.work.write_scene("scene.glb", &scene);
    let steps = dry_json(&bakes.work);
    let of = |kind: &str, state: &str| -> Vec<&Value> {
        steps.iter().filter(|step| step["kind"] == kind && step["state"] == state).collect()
    };
    let counted =
        |kind, state| of(kind, state).iter().map(|step| step["count"].as_u64().unwrap()).sum::<u64>();
    assert_eq!((counted("bricks", "miss"), counted("bricks", "hit")), (1, 7));
    assert_eq!((counted("rows", "miss"), counted("rows", "hit")), (0, 0));
    let reason = &of("bricks", "miss")[0]["reasons"][0];
    assert_eq!((&reason["reason"], &reason["object"]), (&"moved".into(), &"house".into()), "{reason}");
    let (old, new) = (reason["old"][1].as_f64().unwrap(), reason["new"][1].as_f64().unwrap());
    assert_eq!(new - old, 0.5);
    assert_eq!(of("import", "miss")[0]["reasons"][0]["reason"], "file");
    let promised: Vec<u64> = ["bricks", "points"].map(|kind| counted(kind, "miss")).to_vec();
    let patched = counted("rows", "patch");
    let did = bakes.bake(&["--explain"]);
    assert_eq!([did.rebuilt("bricks"), did.rebuilt("points")], promised[..], "as promised");
    assert_eq!(did.patched("rows"), patched);
    let event = did.stderr.lines().find(|line| line.contains("\"explain\"")).expect("an event");
    let event: Value = serde_json::from_str(event).unwrap();
    assert_eq!(event["steps"], Value::from(steps), "a bake explains what a dry run did");
}

#[test]
fn other_changes_have_their_reasons() {
    let bakes = Bakes::of_village();
    let work = &bakes.work;
    let text = |settings: &[&str]| dry(work, settings);
    let mut settings = SETTINGS.to_vec();
    settings[1] = "8";
    assert!(text(&settings).contains("--levels has changed (9 → 8)"), "{}", text(&settings));
    let mut settings = SETTINGS.to_vec();
    settings[5] = "octahedral:5";
    let found = text(&settings);
    assert!(found.contains("--directions has changed (latlong:12x12 → octahedral:5)"), "{found}");
    assert!(found.contains("bricks  0 to make, 8 in the cache"), "{found}");

    let mut scene = village();
    scene.textures[0] = texture([[1, 2, 3, 255]; 4]);
    work.write_scene("scene.glb", &scene);
    let found = text(&SETTINGS);
    assert!(found.contains("`house` has another look ("), "{found}");
    assert!(found.contains("rows  0 to make"), "{found}");

    let mut scene = village();
    scene.instances[1].world_from_object.w_axis.x += 0.25;
    work.write_scene("scene.glb", &scene);
    assert!(text(&SETTINGS).contains("the scene's bounds have changed ("));
    scene.instances[1].world_from_object.w_axis.x += 90.0;
    work.write_scene("scene.glb", &scene);
    assert!(text(&SETTINGS).contains("the scene cube has changed (64 m from"), "{}", text(&SETTINGS));

    // What was lost, not changed.
    work.write_scene("scene.glb", &village());
    work.run(["cache", "gc", "--max-size", "0", "--cache", "cache"]).succeeded();
    work.write("out.mvb", b"lost");
    assert!(text(&SETTINGS).contains("to make"), "{}", text(&SETTINGS));
}

#[test]
fn the_summary_counts_by_kind() {
    let bakes = Bakes::of_village();
    let mut scene = village();
    scene.instances[CORNERS].world_from_object.w_axis.y += 0.5;
    bakes.work.write_scene("scene.glb", &scene);
    let run: Run = bakes.work.run([&EXPLAIN[..6], &SETTINGS[..]].concat()).succeeded();
    let line = run.stdout.lines().find(|line| line.starts_with("steps: ")).expect("a summary");
    assert!(
        line.contains(" reused, ") && line.contains("(import 1, bricks 1, attributes 1, points "),
        "{line}"
    );
    assert!(line.ends_with(", archive 1), 0 failed"), "{line}");
}

#[test]
fn stat_counts_what_is_there() {
    let bakes = Bakes::of_village();
    let run = bakes.work.run(["cache", "stat", "--cache", "cache", "--format", "json"]).succeeded();
    let stat: Value = serde_json::from_str(&run.stdout).unwrap();
    let names: Vec<&str> =
        stat["buckets"].as_array().unwrap().iter().map(|b| b["bucket"].as_str().unwrap()).collect();
    assert_eq!(
        names,
        ["bakes-v1", "brick-looks-v1", "brick-shapes-v2", "frames-v1", "latest-v1", "points-v1", "rows-v2"]
    );
    let in_bucket = |name: &&String| names.iter().any(|bucket| name.contains(&format!("/{bucket}/")));
    let files = bakes.work.names().iter().filter(in_bucket).count() as u64;
    assert_eq!(stat["entries"].as_u64(), Some(files));
    assert_eq!(bakes.work.run(["cache", "stat", "--cache", "nowhere"]).code, Some(3));
}

#[test]
fn diff_tells_where_an_edit_shows() {
    let bakes = Bakes::of_village();
    bakes.work.write("old.mvb", &bakes.work.read("out.mvb"));
    let mut scene = village();
    let place = scene.instances[CORNERS].world_from_object.w_axis;
    scene.instances[CORNERS].world_from_object.w_axis.y += 0.5;
    bakes.bake_scene(&scene);
    let run = bakes.work.run(["diff", "old.mvb", "out.mvb", "--format", "json"]);
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    let diff: Value = serde_json::from_str(&run.stdout).unwrap();
    let region = &diff["region"];
    for axis in 0..3 {
        let [min, max] = ["min", "max"].map(|end| region[end][axis].as_f64().unwrap());
        let from = place.to_array()[axis];
        // A house is 2 × 3 × 2 m, voxels are 12.5 cm.
        assert!((min - from).abs() < 0.2 && max - from > 1.9 && max - from < 3.8, "axis {axis}: {region}");
    }
    let text = bakes.work.run(["diff", "old.mvb", "out.mvb"]).stdout;
    assert!(text.contains("all differences of the octree lie from ("), "{text}");
}
