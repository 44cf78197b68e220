//! What a bake says and writes besides the archive: recipes, dependencies, estimates, JSON.

use crate::scenes::{geometry_digests, split_glb};
use crate::workplace::{SMALL, Workplace, glb};
use manyview::Archive;
use manyview_pipeline::generate::{SceneKind, generate};
use serde_json::{Value, json};
use std::collections::BTreeSet;

fn parse(json: &str) -> Value {
    serde_json::from_str(json).unwrap_or_else(|error| panic!("{error}: {json}"))
}

/// Every line as JSON, by its event.
fn events(stderr: &str) -> Vec<String> {
    stderr
        .lines()
        .map(|line| parse(line)["event"].as_str().expect("an event has a name").to_owned())
        .collect()
}

#[test]
fn a_recipes_paths_are_relative_to_it_and_options_win() {
    let work = Workplace::new();
    work.write_scene("scenes/a.glb", &generate(SceneKind::Town, 1500, 1));
    let settings = "levels = 6\nrows = 32\ndirections = \"latlong:6x6\"\n";
    let recipe = format!("scene = \"../scenes/a.glb\"\noutput = \"new folder/a.mvb\"\n{settings}");
    work.write("recipes/a.toml", recipe.as_bytes());
    let expected = work.bake("scenes/a.glb", "expected.mvb", &[]);
    work.run(["bake", "--recipe", "recipes/a.toml", "--backend", "cpu"]).succeeded();
    assert!(work.read("recipes/new folder/a.mvb") == expected, "a recipe is the same as its options");

    // Another output, another setting.
    work.run(["bake", "--recipe", "recipes/a.toml", "-o", "o.mvb", "--levels", "4", "--backend", "cpu"])
        .succeeded();
    let inspected = parse(&work.run(["inspect", "o.mvb", "--format", "json"]).succeeded().stdout);
    assert_eq!(inspected["svo"]["levels"], 4);
    assert_eq!(inspected["rows"]["resolution"], 32, "what is not overridden is the recipe's");

    // Another scene takes the recipe's settings but not its output.
    work.write_scene("b.glb", &generate(SceneKind::Park, 1500, 1));
    work.run(["bake", "b.glb", "--recipe", "recipes/a.toml", "--backend", "cpu"]).succeeded();
    assert!(work.read("recipes/new folder/a.mvb") == expected);
    let inspected = parse(&work.run(["inspect", "b.mvb", "--format", "json"]).succeeded().stdout);
    assert_eq!(inspected["svo"]["levels"], 6);
}

#[test]
fn a_generated_scene_is_the_scene_that_the_command_writes() {
    let work = Workplace::new();
    work.run(["scene", "town", "--triangles", "2000", "--seed", "9", "-o", "t.glb"]).succeeded();
    assert!(work.read("t.glb") == glb(&generate(SceneKind::Town, 2000, 9)));
    let recipe = "generate = { kind = \"town\", triangles = 2000, seed = 9 }\noutput = \"r.mvb\"\nlevels = 6\nrows = 32\ndirections = \"latlong:6x6\"";
    work.write("r.toml", recipe.as_bytes());
    work.run(["bake", "--recipe", "r.toml", "--backend", "cpu"]).succeeded();
    work.bake("t.glb", "t.mvb", &[]);
    let [generated, imported] = ["r.mvb", "t.mvb"].map(|name| Archive::open(work.path(name)).unwrap());
    assert_eq!(geometry_digests(&generated), geometry_digests(&imported));
    assert_eq!(generated.scene_info(), imported.scene_info());
}

#[test]
fn a_pinned_cube_is_where_the_octree_lies() {
    let work = Workplace::new();
    work.write_scene("a.glb", &generate(SceneKind::Town, 1500, 1));
    let bounds = work.bake("a.glb", "a.mvb", &[]);
    assert!(!bounds.is_empty());
    work.write(
        "r.toml",
        b"scene = \"a.glb\"\nlevels = 5\nrows = 0\ncube = { origin = [-500, -200, -500.5], size = 1000 }",
    );
    work.run(["bake", "--recipe", "r.toml", "-o", "p.mvb", "--backend", "cpu"]).succeeded();
    let svo = parse(&work.run(["inspect", "p.mvb", "--format", "json"]).succeeded().stdout)["svo"].clone();
    assert_eq!((&svo["origin"], &svo["size"]), (&json!([-500.0, -200.0, -500.5]), &json!(1000.0)));
}

/// The target and the prerequisites of a rule, read as make does.
fn read_rule(text: &str) -> (String, Vec<String>) {
    let mut words = vec![String::new()];
    let mut target = None;
    let mut letters = text.chars().peekable();
    while let Some(letter) = letters.next() {
        let word = words.last_mut().unwrap();
        match (letter, letters.peek()) {
            ('\\', Some('\n')) => {
                letters.next();
                words.push(String::new());
            }
            ('\\', Some(&escaped @ (' ' | '#' | ':' | '\\'))) => {
                letters.next();
                word.push(escaped);
            }
            ('$', Some('$')) => {
                letters.next();
                word.push('$');
            }
            (':', Some(' ' | '\n')) if target.is_none() => target = Some(std::mem::take(word)),
            (' ' | '\n', _) => words.push(String::new()),
            _ => word.push(letter),
        }
    }
    words.retain(|word| !word.is_empty());
    (target.expect("a rule has a colon"), words)
}

#[test]
fn a_depfile_names_every_file_that_was_read() {
    let work = Workplace::new();
    let (mut json, binary) = split_glb(&glb(&generate(SceneKind::Town, 1500, 1)));
    json["buffers"][0]["uri"] = json!("all%20%23bytes%24.bin");
    work.write("a scene/town $1.gltf", &serde_json::to_vec(&json).unwrap());
    work.write("a scene/all #bytes$.bin", &binary);
    work.write("my recipe.toml", b"levels = 6\nrows = 0\nscene = \"a scene/town $1.gltf\"");
    let arguments =
        ["bake", "--recipe", "my recipe.toml", "-o", "the out.mvb", "--depfile", "out.d", "--backend", "cpu"];
    work.run(arguments).succeeded();
    let text = String::from_utf8(work.read("out.d")).unwrap();
    let (target, files) = read_rule(&text);
    assert_eq!(target, "the out.mvb");
    let files: BTreeSet<&str> = files.iter().map(String::as_str).collect();
    let expected = ["a scene/town $1.gltf", "a scene/all #bytes$.bin", "my recipe.toml"];
    assert_eq!(files, BTreeSet::from(expected), "{text}");
    assert!(files.iter().all(|file| work.path(file).is_file()), "paths are from the current folder");
}

#[test]
fn a_dry_run_tells_the_cost_and_writes_nothing() {
    let work = Workplace::new();
    let scene = generate(SceneKind::Town, 1500, 1);
    work.write_scene("a.glb", &scene);
    work.write("r.toml", b"scene = \"a.glb\"\noutput = \"new/a.mvb\"\npreview = \"new/a.png\"");
    let dry = ["bake", "--recipe", "r.toml", "--dry-run", "--depfile", "a.d"];
    let run = work.run(dry).succeeded();
    assert!(run.stdout.contains("triangles") && run.stdout.contains("memory"), "{}", run.stdout);
    let run = work.run([&dry[..], &["--format", "json"]].concat()).succeeded();
    let estimate = parse(&run.stdout);
    assert_eq!(estimate["triangles"], scene.drawn_triangles());
    assert_eq!(estimate["rows_raw_bytes"], 90 * 90 * 128u64.pow(3) / 8);
    events(&run.stderr);
    assert_eq!(work.names(), ["a.glb", "r.toml"]);
    assert_eq!(work.run(["bake", "gone.glb", "--dry-run"]).code, Some(3));
}

#[test]
fn json_is_json_on_both_streams() {
    let work = Workplace::new();
    let scene = generate(SceneKind::Town, 1500, 1);
    work.write_scene("a.glb", &scene);
    let run = work.run([&["bake", "a.glb", "--format", "json"], &SMALL[..]].concat()).succeeded();
    let summary = parse(&run.stdout);
    assert_eq!(summary["output"], "a.mvb");
    assert_eq!(summary["backend"], "cpu");
    assert_eq!(summary["triangles"], scene.drawn_triangles());
    assert_eq!(summary["file_bytes"], work.read("a.mvb").len());
    let events_seen = events(&run.stderr);
    assert_eq!(events_seen[0], "estimate", "the cost comes first: {events_seen:?}");
    let count = |name: &str| events_seen.iter().filter(|event| *event == name).count();
    assert!(count("step_begin") >= 3 && count("step_begin") == count("step_end"), "{events_seen:?}");

    let svo = parse(&work.run(["inspect", "a.mvb", "--format", "json"]).succeeded().stdout)["svo"].clone();
    assert_eq!((&svo["leaves"], &svo["nodes"]), (&summary["leaves"], &summary["nodes"]));

    // Errors are events too.
    let run = work.run(["bake", "gone.glb", "--format", "json", "--backend", "cpu"]);
    assert_eq!((run.code, run.stdout.as_str()), (Some(3), ""));
    let error = parse(run.stderr.lines().last().unwrap());
    assert_eq!((&error["event"], &error["exit_code"]), (&json!("error"), &json!(3)));
    assert!(error["message"].as_str().unwrap().contains("gone.glb"));
    events(&run.stderr);
}

#[test]
fn the_result_is_what_was_asked_for_and_sound() {
    let work = Workplace::new();
    let scene = generate(SceneKind::Forest, 3000, 1);
    work.write_scene("a.glb", &scene);
    for (directions, grid, way, rows) in [
        ("latlong:3x5", "extent", "points", 32),
        ("octahedral:4", "cube", "peel", 64),
        ("latlong:2x2", "cube", "rotate", 128),
    ] {
        let rows_text = rows.to_string();
        work.run([
            "bake",
            "a.glb",
            "--levels",
            "7",
            "--rows",
            &rows_text,
            "--directions",
            directions,
            "--grid",
            grid,
            "--rows-from",
            way,
            "--backend",
            "cpu",
        ])
        .succeeded();
        let found = parse(&work.run(["inspect", "a.mvb", "--format", "json"]).succeeded().stdout);
        assert_eq!(found["scene"]["triangles"], scene.drawn_triangles());
        assert_eq!(found["scene"]["instances"], scene.instances.len());
        assert_eq!(found["svo"]["levels"], 7);
        let of_rows = |key: &str| found["rows"][key].clone();
        assert_eq!(of_rows("directions"), directions);
        assert_eq!((of_rows("grid"), of_rows("source")), (json!(grid), json!(way)));
        assert_eq!(of_rows("resolution"), rows);
        let report = work.run(["verify", "a.mvb"]).succeeded();
        assert!(report.stdout.contains("sound"), "{}", report.stdout);
    }
}

#[test]
fn a_bake_can_draw_its_picture() {
    let work = Workplace::new();
    work.write_scene("a.glb", &generate(SceneKind::Town, 1500, 1));
    work.bake("a.glb", "a.mvb", &["--preview", "a.png"]);
    assert_eq!(work.read("a.png")[1..4], *b"PNG");
}

#[test]
fn verify_against_the_scene_names_what_differs() {
    let work = Workplace::new();
    let scene = generate(SceneKind::Town, 1500, 1);
    work.write_scene("a.glb", &scene);
    work.write("r.toml", b"scene = \"a.glb\"\ncube = { origin = [-500, -200, -500.5], size = 1000 }");
    for settings in [
        vec!["--rows-from", "points"],
        vec!["--rows-from", "peel", "--grid", "cube"],
        vec!["--rows-from", "rotate", "--recipe", "r.toml"],
        vec!["--rows-from", "points", "--recipe", "r.toml"],
    ] {
        work.bake("a.glb", "a.mvb", &settings);
        let run = work.run(["verify", "a.mvb", "--against", "a.glb"]).succeeded();
        assert!(run.stdout.contains("same as a new bake of a.glb"), "{settings:?}: {}", run.stdout);
    }
    work.run(["bake", "a.glb", "-o", "no rows.mvb", "--levels", "5", "--rows", "0", "--backend", "cpu"])
        .succeeded();
    work.run(["verify", "no rows.mvb", "--against", "a.glb"]).succeeded();

    // Another colour, the same shape.
    work.bake("a.glb", "a.mvb", &[]);
    let mut painted = scene.clone();
    for material in &mut painted.materials {
        material.base_color.x = 1.0 - material.base_color.x;
    }
    work.write_scene("painted.glb", &painted);
    let run = work.run(["verify", "a.mvb", "--against", "painted.glb", "--format", "json"]);
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    let found = parse(&run.stdout);
    assert_eq!((&found["sound"], &found["against"]["same"]), (&json!(true), &json!(false)));
    let names: Vec<&String> = found["against"]["differing"].as_object().unwrap().keys().collect();
    assert_eq!(names, ["svo.colors"]);
    events(&run.stderr);

    // A scene that has outgrown the archive's cube.
    let mut outgrown = scene;
    outgrown.instances[0].world_from_object.w_axis.x += 1000.0;
    work.write_scene("outgrown.glb", &outgrown);
    let run = work.run(["verify", "a.mvb", "--against", "outgrown.glb"]);
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    assert!(run.stdout.contains("differs") && run.stdout.contains("svo.info"), "{}", run.stdout);

    assert_eq!(work.run(["verify", "a.mvb", "--against", "gone.glb"]).code, Some(3));
    assert_eq!(work.run(["verify", "a.mvb", "--time", "1"]).code, Some(2), "--time needs --against");
}
