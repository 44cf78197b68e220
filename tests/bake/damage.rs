//! Bad input and bad outputs: the right exit code, a message that helps, nothing left behind, nothing lost.

use crate::scenes::{floor_mesh, one_mesh, plain, triangle_glb};
use crate::workplace::{Run, SMALL, Workplace};
use manyview_pipeline::scene::Material;
use serde_json::{Value, json};

const USUAL: [[f32; 3]; 3] = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.5]];
const OLD: &[u8] = b"an older archive";

/// Bakes where there is an older output and where there is none; both must fail alike and change nothing.
fn fails(work: &Workplace, arguments: &[&str], code: i32, needles: &[&str]) {
    for old in [None, Some(OLD)] {
        if let Some(old) = old {
            work.write("out.mvb", old);
        }
        let before = work.names();
        let Run { code: found, stdout, stderr } = work.run([&["bake"], arguments].concat());
        assert_eq!(found, Some(code), "{arguments:?}: {stderr}");
        for needle in needles {
            assert!(stderr.contains(needle), "{arguments:?}: no `{needle}` in: {stderr}");
        }
        assert!(!stderr.contains("panicked"), "{arguments:?}: {stderr}");
        assert_eq!(stdout, "", "{arguments:?}: nothing is printed as a result");
        assert_eq!(work.names(), before, "{arguments:?}: nothing appears or goes away");
        if let Some(old) = old {
            assert_eq!(work.read("out.mvb"), old, "{arguments:?}: the older output is intact");
        }
    }
}

/// Bakes `scene.glb` with these bytes.
fn bytes_fail(bytes: &[u8], code: i32, needles: &[&str]) {
    let work = Workplace::new();
    work.write("scene.glb", bytes);
    let arguments = [&["scene.glb", "-o", "out.mvb"], &SMALL[..]].concat();
    fails(&work, &arguments, code, &[&["scene.glb"], needles].concat());
}

fn triangle_fails(positions: [[f32; 3]; 3], edit: impl FnOnce(&mut Value), needles: &[&str]) {
    bytes_fail(&triangle_glb(positions, edit), 3, needles);
}

fn usual() -> Vec<u8> {
    triangle_glb(USUAL, |_| ())
}

#[test]
fn the_usual_triangle_bakes() {
    let work = Workplace::new();
    work.write("scene.glb", &usual());
    work.bake("scene.glb", "out.mvb", &[]);
    assert_eq!(work.names(), ["out.mvb", "scene.glb"]);
}

#[test]
fn missing_files_are_named() {
    let work = Workplace::new();
    fails(&work, &["nothing.glb", "-o", "out.mvb"], 3, &["nothing.glb", "No such file"]);
    fails(&work, &[".", "-o", "out.mvb"], 3, &["no regular file"]);
    let scene = json!({
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": "gone.bin"}],
    });
    work.write("scene.gltf", scene.to_string().as_bytes());
    fails(&work, &["scene.gltf", "-o", "out.mvb"], 3, &["scene.gltf", "gone.bin", "No such file"]);
    work.write("gone.bin", &[0; 35]);
    fails(&work, &["scene.gltf", "-o", "out.mvb"], 3, &["scene.gltf", "buffers[0]"]);
}

#[test]
fn truncated_and_foreign_files_are_refused() {
    let whole = usual();
    for length in [0, 3, 11, 12, 19, 20, 100, whole.len() / 2, whole.len() - 40, whole.len() - 1] {
        bytes_fail(&whole[..length], 3, &[]);
    }
    bytes_fail(b"PK\x03\x04 this is a zip file", 3, &[]);
    let work = Workplace::new();
    for (text, needle) in [("{\"asset\": {\"version\": \"1.0\"}}", "version"), ("{\"asset\": ", "line 1")] {
        work.write("scene.gltf", text.as_bytes());
        fails(&work, &["scene.gltf", "-o", "out.mvb"], 3, &["scene.gltf", needle]);
    }
}

#[test]
fn numbers_that_are_none_are_refused() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut positions = USUAL;
        positions[1][2] = bad;
        triangle_fails(positions, |_| (), &["accessors[0]"]);
    }
    triangle_fails(USUAL, |json| json["accessors"][1]["count"] = json!(3_000_000_000u32), &["accessors[1]"]);
    triangle_fails(USUAL, |json| json["accessors"][0]["count"] = json!(2), &["meshes[0]"]);
    triangle_fails(USUAL, |json| json["nodes"][0]["scale"] = json!([1.0, "x", 1.0]), &["nodes[0]"]);
    triangle_fails(USUAL, |json| json["nodes"][0]["mesh"] = json!(7), &["nodes[0]"]);
}

#[test]
fn cycles_and_crowds_of_nodes_end() {
    let node = |json: &mut Value, nodes: Value| json["nodes"] = nodes;
    triangle_fails(USUAL, |j| node(j, json!([{"mesh": 0, "children": [0]}])), &["nodes[0]"]);
    triangle_fails(USUAL, |j| node(j, json!([{"mesh": 0, "children": [1]}, {"children": [0]}])), &["nodes["]);
    // 40 levels of two children each that are the same node: 2^40 paths.
    let levels = (0..40).map(|i| json!({"mesh": 0, "children": [i + 1, i + 1]}));
    let nodes: Vec<Value> = levels.chain([json!({"mesh": 0})]).collect();
    triangle_fails(USUAL, |j| node(j, json!(nodes)), &["nodes["]);
}

#[test]
fn scenes_that_draw_nothing_say_why() {
    triangle_fails(USUAL, |json| json["scenes"][0]["nodes"] = json!([]), &["draws no triangle"]);
    triangle_fails(
        USUAL,
        |json| json["meshes"][0]["primitives"][0]["mode"] = json!(1),
        &["draws no triangle"],
    );
    let invisible = json!({"alphaMode": "MASK", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.2]}});
    triangle_fails(USUAL, |json| json["materials"][0] = invisible, &["alpha cuts away every triangle"]);
}

#[test]
fn scenes_without_extent_or_area_say_so() {
    triangle_fails([[1.0, 2.0, 3.0]; 3], |_| (), &["bounds", "no size"]);
    triangle_fails(USUAL, |json| json["nodes"][0]["scale"] = json!([0, 0, 0]), &["bounds", "zero scales"]);
    let line = [[0.0; 3], [1.0, 2.0, 3.0], [2.0, 4.0, 6.0]];
    triangle_fails(line, |_| (), &["no area"]);
    // A needle much thinner than a voxel, between all pixel centres.
    let needle = [[0.01, 0.01, 0.01], [1.01, 0.01, 0.01], [1.01, 0.010_001, 0.010_001]];
    triangle_fails(needle, |_| (), &["--levels"]);
}

#[test]
fn huge_coordinates_are_bad_bounds() {
    let huge = [[0.0; 3], [1e38, 0.0, 0.0], [0.0, 3e38, 0.0]];
    triangle_fails(huge, |_| (), &["bounds"]);
    triangle_fails(USUAL, |json| json["nodes"][0]["scale"] = json!([1e35, 1e35, 1e35]), &["bounds"]);
    triangle_fails(USUAL, |json| json["nodes"][0]["translation"] = json!([1e300, 0, 0]), &[]);
    // Large, but a scene like any other.
    let work = Workplace::new();
    work.write(
        "scene.glb",
        &triangle_glb(USUAL, |json| json["nodes"][0]["scale"] = json!([1e20, 1e20, 1e20])),
    );
    work.bake("scene.glb", "out.mvb", &[]);
    work.run(["verify", "out.mvb"]).succeeded();
    // Small and far away: no finer than its floats, but it ends.
    let translated = |json: &mut Value| json["nodes"][0]["translation"] = json!([1e9, -1e9, 1e9]);
    work.write("scene.glb", &triangle_glb(USUAL, translated));
    work.bake("scene.glb", "out.mvb", &[]);
    work.run(["verify", "out.mvb"]).succeeded();
}

#[test]
fn degenerate_triangles_between_others_do_no_harm() {
    let mut mesh = floor_mesh(0.0, 32.0, 5.25);
    let whole =
        crate::scenes::baked(&one_mesh(mesh.clone(), Material::default()), &crate::scenes::metre_voxels(5));
    // A diagonal through the whole cube without area, many times, and points.
    mesh.positions.push(glam::Vec3::new(16.0, 5.25, 16.0));
    for _ in 0..1000 {
        mesh.triangles.extend([[0, 4, 2], [1, 1, 3], [0, 0, 0], [2, 0, 4]]);
    }
    let more = crate::scenes::baked(&one_mesh(mesh, Material::default()), &crate::scenes::metre_voxels(5));
    assert_eq!(whole.svo().unwrap(), more.svo().unwrap());
}

#[test]
fn outputs_that_cannot_be_written_are_named() {
    let work = Workplace::new();
    work.write("scene.glb", &usual());
    work.write("a file", b"no folder");
    fs_err::create_dir(work.path("folder")).unwrap();
    let fails_at = |output: &str, needle: &str| {
        let arguments = [&["scene.glb", "-o", output], &SMALL[..]].concat();
        fails(&work, &arguments, 3, &[output, needle]);
    };
    fails_at("no such folder/out.mvb", "make the folder first");
    fails_at("a file/out.mvb", "make the folder first");
    fails_at("folder", "is a folder");
    if cfg!(target_os = "linux") {
        // Nobody makes files or replaces devices there, root included.
        fails_at("/proc/self/out.mvb", "cannot create it");
        fails_at("/dev/null", "device");
    }
}

#[test]
fn the_scene_is_never_overwritten() {
    let work = Workplace::new();
    work.write("scene.glb", &usual());
    let arguments = |output: &'static str| [&["scene.glb", "-o", output], &SMALL[..]].concat();
    for output in ["scene.glb", "./scene.glb"] {
        fails(&work, &arguments(output), 2, &["would overwrite the scene"]);
    }
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(work.path("scene.glb"), work.path("link.mvb")).unwrap();
        fails(&work, &arguments("link.mvb"), 2, &["would overwrite the scene"]);
    }
    assert_eq!(work.read("scene.glb"), usual());
}

#[cfg(unix)]
#[test]
fn a_full_disk_costs_nothing_but_the_bake() {
    let work = Workplace::new();
    work.write_scene("scene.glb", &one_mesh(floor_mesh(0.0, 32.0, 5.25), plain([1.0; 3])));
    work.write("out.mvb", OLD);
    let before = work.names();
    // A limit on file sizes gives an error in the middle of writing, as a full disk does. Its signal is no end either.
    let bake = format!(
        "ulimit -f 2; exec '{}' bake scene.glb -o out.mvb --levels 9 --rows 64 --backend cpu",
        env!("CARGO_BIN_EXE_manyview")
    );
    let run = Run::of(
        std::process::Command::new("sh")
            .args(["-c", &bake])
            .env("MANYVIEW_CACHE", "")
            .current_dir(work.folder()),
    );
    assert_eq!(run.code, Some(3), "{}", run.stderr);
    assert!(run.stderr.contains("out.mvb") && run.stderr.contains("free some space"), "{}", run.stderr);
    assert_eq!(work.names(), before);
    assert_eq!(work.read("out.mvb"), OLD);
}

#[test]
fn options_out_of_range_are_usage_errors() {
    let work = Workplace::new();
    work.write("scene.glb", &usual());
    let cases: [(&[&str], &str); 13] = [
        (&["--levels", "0"], "1 to 13"),
        (&["--levels", "14"], "1 to 13"),
        (&["--levels", "many"], "--levels"),
        (&["--rows", "100"], "32, 64, 128 or 256"),
        (&["--rows", "512"], "32, 64, 128 or 256"),
        (&["--directions", "sphere:9"], "latlong:THETASxPHIS"),
        (&["--directions", "latlong:0x9"], "1 to 512"),
        (&["--directions", "octahedral:513"], "1 to 512"),
        (&["--rows-from", "guess"], "points, peel or rotate"),
        (&["--grid", "sphere"], "extent or cube"),
        (&["--jobs", "0"], "--jobs"),
        (&["--max-memory", "8 furlongs"], "use B, KiB, MiB, GiB or TiB"),
        (&["--time", "nan"], "finite"),
    ];
    for (arguments, needle) in cases {
        fails(&work, &[&["scene.glb", "-o", "out.mvb"], arguments].concat(), 2, &[needle]);
    }
    fails(&work, &["-o", "out.mvb"], 2, &["SCENE"]);
    // Settings are looked at before a scene is read.
    fails(&work, &["nothing.glb", "-o", "out.mvb", "--levels", "14"], 2, &["1 to 13"]);
}

#[test]
fn a_bake_beyond_its_memory_is_over_budget() {
    let work = Workplace::new();
    work.write("scene.glb", &usual());
    fails(
        &work,
        &["scene.glb", "-o", "out.mvb", "--max-memory", "1MiB"],
        4,
        &["--max-memory", "limit is 1 MiB"],
    );
    fails(&work, &["scene.glb", "-o", "out.mvb", "--max-memory", "100"], 4, &["100"]);
}

#[test]
fn recipes_that_cannot_be_used_are_named() {
    let work = Workplace::new();
    work.write("scene.glb", &usual());
    let cases = [
        ("scene = \"scene.glb\"\nlevles = 6", 3, "unknown field `levles`"),
        ("scene = \"scene.glb\"\nlevels = \"six\"", 3, "levels"),
        ("scene = \"scene.glb\"\ncube = { origin = [0, 0, 0], size = 0.5 }", 3, "the pinned cube"),
        ("scene = \"scene.glb\"\ncube = { origin = [0.1, 0, 0], size = 50 }", 3, "the pinned cube"),
        (
            "scene = \"scene.glb\"\ncube = { origin = [0, 0, 0], size = -1 }",
            3,
            "cube: the size must be positive",
        ),
        ("scene = \"gone.glb\"", 3, "gone.glb"),
        ("levels = 6", 2, "names no scene"),
        ("scene = \"scene.glb\"\nlevels = 20", 2, "1 to 13"),
        ("generate = { kind = \"town\", triangles = 9000000000000 }", 3, "generate.triangles"),
        ("scene = [", 3, "recipe.toml"),
    ];
    for (text, code, needle) in cases {
        work.write("recipe.toml", text.as_bytes());
        fails(&work, &["--recipe", "recipe.toml", "-o", "out.mvb"], code, &[needle]);
    }
    fails(
        &work,
        &["--recipe", "gone.toml", "-o", "out.mvb"],
        3,
        &["gone.toml", "check that the file is there"],
    );
}

#[test]
fn side_outputs_do_not_replace_what_they_describe() {
    let work = Workplace::new();
    work.write("scene.glb", &usual());
    for other in ["scene.glb", "out.mvb", "./out.mvb"] {
        let arguments = [&["scene.glb", "-o", "out.mvb", "--depfile", other], &SMALL[..]].concat();
        fails(&work, &arguments, 2, &["--depfile"]);
    }
    work.write("recipe.toml", b"scene = \"scene.glb\"");
    fails(&work, &["--recipe", "recipe.toml", "-o", "recipe.toml"], 2, &["--output", "--recipe"]);
    let preview = ["scene.glb", "-o", "out.png", "--preview", "./out.png"];
    fails(&work, &preview, 2, &["--preview", "--output"]);
    assert_eq!(work.read("scene.glb"), usual());
}
