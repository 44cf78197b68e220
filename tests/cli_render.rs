//! `render` and `compare`, read back from their files.
#![cfg(feature = "bake")]

mod support;

use std::path::Path;

use serde_json::Value;
use support::{bake_town, expect_exit};

const SCENE: &str = "town:2000";

/// `render` of the town at a small size, with more arguments.
fn render(code: i32, arguments: &[&str]) -> (String, String) {
    expect_exit(code, &[&["render", SCENE, "--size", "48x32", "--backend", "cpu"], arguments].concat())
}

fn json(arguments: &[&str]) -> Value {
    let (stdout, _) = expect_exit(0, &[arguments, &["--format", "json"]].concat());
    serde_json::from_str(&stdout).unwrap_or_else(|error| panic!("{error}: {stdout}"))
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn one_run_writes_all_outputs_and_compare_reads_them() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (png, exr, bits) = (at("p.png"), at("p.exr"), at("b.npy"));
    let (stdout, stderr) = render(
        0,
        &["--lights", "random:40", "-o", text(&png), "-o", text(&exr), "--light-bits", text(&bits)],
    );
    assert!(stdout.contains("40 lights"), "{stdout}");
    assert!(stderr.contains("1,536 pixels × 40 lights = at most 61,440 segments"), "{stderr}");
    assert_eq!(image::open(&png).unwrap().into_rgb8().dimensions(), (48, 32));
    assert_eq!(fs_err::metadata(&bits).unwrap().len(), 128 + 48 * 32 * 2 * 4);
    // The same again, byte by byte.
    let (again, bits_again) = (at("q.exr"), at("c.npy"));
    render(0, &["--lights", "random:40", "-o", text(&again), "--light-bits", text(&bits_again)]);
    assert_eq!(fs_err::read(&exr).unwrap(), fs_err::read(&again).unwrap());
    assert_eq!(fs_err::read(&bits).unwrap(), fs_err::read(&bits_again).unwrap());

    let same = json(&["compare", text(&exr), text(&again), "--light-bits", text(&bits), text(&bits_again)]);
    assert_eq!(same["equal"], true);
    assert_eq!((&same["eps_v"], &same["eps_s"], &same["psnr_db"]), (&0.0.into(), &0.0.into(), &Value::Null));
    assert!((same["ssim"].as_f64().unwrap() - 1.0).abs() < 1e-9);

    // Other lights give another picture.
    render(
        0,
        &[
            "--lights",
            "random:40:2",
            "-o",
            text(&again),
            "--light-bits",
            text(&bits_again),
            "-o",
            text(&at("q.png")),
        ],
    );
    let diff = at("d.png");
    let other = json(&[
        "compare",
        text(&exr),
        text(&again),
        "--light-bits",
        text(&bits),
        text(&bits_again),
        "-o",
        text(&diff),
    ]);
    let [eps_v, eps_s, ssim] = ["eps_v", "eps_s", "ssim"].map(|name| other[name].as_f64().unwrap());
    assert!(eps_v > 0.05 && eps_s > 0.0 && eps_s <= eps_v + 1e-6 && ssim < 0.99, "{other}");
    assert_eq!(image::open(&diff).unwrap().into_rgb8().dimensions(), (48, 32));
    let (pngs, _) = expect_exit(0, &["compare", text(&png), text(&at("q.png"))]);
    assert!(pngs.contains("SSIM") && pngs.contains("eps_v                     –"), "{pngs}");
}

#[test]
fn the_layers_of_an_exr_fit_together() {
    let folder = tempfile::tempdir().unwrap();
    let exr = folder.path().join("p.exr");
    let camera = folder.path().join("c.toml");
    fs_err::write(&camera, "eye = [40, 60, 40]\ntarget = [0, 0, 0]\nfov = 60").unwrap();
    render(0, &["--lights", "particles:33", "-o", text(&exr), "--camera", text(&camera)]);
    let image = exr::prelude::read_first_flat_layer_from_file(&exr).unwrap();
    let layer = image.layer_data;
    let names: Vec<String> = layer.channel_data.list.iter().map(|channel| channel.name.to_string()).collect();
    for name in [
        "R",
        "G",
        "B",
        "albedo.R",
        "albedo.G",
        "albedo.B",
        "depth.Z",
        "normal.X",
        "normal.Y",
        "normal.Z",
        "position.X",
        "position.Y",
        "position.Z",
        "shadow.Z",
    ] {
        assert!(names.iter().any(|n| n == name), "{name} is missing in {names:?}");
    }
    let channel = |name: &str| -> Vec<f32> {
        let found = layer.channel_data.list.iter().find(|c| c.name.eq(name)).unwrap();
        found.sample_data.values_as_f32().collect()
    };
    let (depth, shadow) = (channel("depth.Z"), channel("shadow.Z"));
    let position = ["position.X", "position.Y", "position.Z"].map(channel);
    let mut surfaces = 0;
    for i in 0..48 * 32 {
        if depth[i].is_infinite() {
            assert!(position[0][i].is_infinite() && shadow[i] == 0.0);
            continue;
        }
        surfaces += 1;
        let away = [40.0, 60.0, 40.0];
        let distance = (0..3).map(|c| (position[c][i] - away[c]).powi(2)).sum::<f32>().sqrt();
        assert!((distance - depth[i]).abs() < 1e-3);
        let hidden = shadow[i] * 33.0;
        assert!((hidden - hidden.round()).abs() < 1e-4 && (0.0..=1.0).contains(&shadow[i]));
    }
    assert!(surfaces > 200, "{surfaces}");
    let note = layer.attributes.other.get(&exr::prelude::Text::from("manyview"));
    let Some(exr::prelude::AttributeValue::Text(note)) = note else { panic!("{note:?}") };
    let note: Value = serde_json::from_str(&note.to_string()).unwrap();
    assert_eq!((&note["lights"], &note["visibility"]), (&33.into(), &"raytrace".into()));
}

#[test]
fn lights_come_from_where_they_are_said_to() {
    let folder = tempfile::tempdir().unwrap();
    let png = folder.path().join("p.png");
    let lights = folder.path().join("lights.json");
    fs_err::write(&lights, r#"[{"position": [0, 30, 0], "intensity": 1000}]"#).unwrap();
    let (stdout, _) = render(0, &["--lights", text(&lights), "-o", text(&png)]);
    assert!(stdout.contains("1 light,"), "{stdout}");
    fs_err::write(&lights, "[]").unwrap();
    let (stdout, stderr) = render(0, &["--lights", text(&lights), "-o", text(&png)]);
    assert!(stdout.contains("0 lights") && stderr.contains("ambient light only"), "{stdout} {stderr}");
    fs_err::write(&lights, "[{}]").unwrap();
    let (_, stderr) = render(3, &["--lights", text(&lights), "-o", text(&png)]);
    assert!(stderr.contains("lights.json") && stderr.contains("`position` is missing"), "{stderr}");
    let (_, stderr) = render(2, &["--lights", "vpl:0", "-o", text(&png)]);
    assert!(stderr.contains("vpl:N:BOUNCES"), "{stderr}");
    // A scene without lights says what it takes instead.
    let bare = folder.path().join("bare.glb");
    manyview_pipeline::glb::write_glb(
        &manyview_pipeline::scene::Scene {
            lights: Vec::new(),
            ..manyview_pipeline::generate::generate(manyview_pipeline::generate::SceneKind::Hairball, 1000, 1)
        },
        &mut fs_err::File::create(&bare).unwrap(),
    )
    .unwrap();
    let (stdout, stderr) = expect_exit(0, &["render", text(&bare), "-o", text(&png), "--size", "8x8"]);
    assert!(stderr.contains("--lights random:256 is taken") && stdout.contains("256 lights"), "{stderr}");
}

#[test]
fn wrong_arguments_and_inputs_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let png = at("p.png");
    let out = ["-o", text(&png)];
    for (code, arguments, part) in [
        (2, vec!["--size", "0x4"], "8192"),
        (2, vec!["--size", "8000x8000"], "16777216"),
        (2, vec!["--lights", "random:0"], "1000000"),
        (2, vec!["--lights", "random:1000001"], "1000000"),
        (2, vec!["--visibility", "guess"], "raytrace"),
        (2, vec!["--exposure", "bright"], "stops"),
        (3, vec!["--camera", "no-such.toml"], "no-such.toml"),
        (3, vec!["--bake", "no-such.mvb"], "no-such.mvb"),
        (3, vec!["--lights", "no-such.json"], "no-such.json"),
    ] {
        let all = [&["render", SCENE][..], &out, &arguments].concat();
        let (_, stderr) = expect_exit(code, &all);
        assert!(stderr.contains(part), "{arguments:?}: {stderr}");
    }
    assert!(!png.exists());
    let (_, stderr) = expect_exit(2, &["render", "town:0", "-o", text(&png)]);
    assert!(stderr.contains("1000 to 1000000000 triangles"), "{stderr}");
    let (_, stderr) = expect_exit(2, &["render", SCENE, "-o", "picture.jpg"]);
    assert!(stderr.contains(".png or .exr"), "{stderr}");
    let (_, stderr) = expect_exit(3, &["render", "no-such.glb", "-o", text(&png)]);
    assert!(stderr.contains("no-such.glb"), "{stderr}");
    let (_, stderr) = expect_exit(3, &["render", SCENE, "--size", "8x8", "-o", text(&at("no/such/p.png"))]);
    assert!(stderr.contains("no/such"), "{stderr}");
    // An archive of another scene.
    let archive = at("a.mvb");
    bake_town(&archive, 5, 1, false);
    let (_, stderr) = render(3, &["--bake", text(&archive), "-o", text(&png)]);
    assert!(stderr.contains("no bake of town:2000"), "{stderr}");
    let (_, stderr) = expect_exit(2, &["render", text(&archive), "-o", text(&png)]);
    assert!(stderr.contains("name the scene"), "{stderr}");
}

#[test]
fn outputs_do_not_overwrite_inputs_or_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (png, exr, bits) = (at("p.png"), at("p.exr"), at("b.npy"));
    let camera = at("c.png");
    fs_err::write(&camera, "eye = [40, 60, 40]\ntarget = [0, 0, 0]").unwrap();
    let lights = at("lights.csv");
    fs_err::write(&lights, "0,30,0\n").unwrap();
    for (arguments, named) in [
        (vec!["-o", text(&camera), "--camera", text(&camera)], ["--output", "--camera"]),
        (
            vec!["-o", text(&png), "--lights", text(&lights), "--light-bits", text(&lights)],
            ["--light-bits", "--lights"],
        ),
        (
            vec!["-o", text(&png), "--bake", text(&bits), "--light-bits", text(&bits)],
            ["--light-bits", "--bake"],
        ),
        (vec!["-o", text(&exr), "--light-bits", text(&exr)], ["--light-bits", "--output"]),
        (vec!["-o", text(&exr), "-o", text(&exr)], ["--output", "same file"]),
    ] {
        let (_, stderr) = render(2, &arguments);
        assert!(named.iter().all(|part| stderr.contains(part)), "{arguments:?}: {stderr}");
    }
    assert!(!png.exists() && !exr.exists() && fs_err::read(&lights).unwrap() == b"0,30,0\n");
    render(0, &["--lights", text(&lights), "-o", text(&exr), "--light-bits", text(&bits)]);
    let before = fs_err::read(&exr).unwrap();
    let (_, stderr) = expect_exit(2, &["compare", text(&exr), text(&exr), "-o", text(&exr)]);
    assert!(stderr.contains("--output") && stderr.contains("REF"), "{stderr}");
    assert_eq!(before, fs_err::read(&exr).unwrap());
}

#[test]
fn pictures_that_cannot_be_compared_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (a, b, png) = (at("a.exr"), at("b.exr"), at("a.png"));
    render(0, &["--lights", "random:3", "-o", text(&a), "-o", text(&png)]);
    render(0, &["--lights", "random:4", "-o", text(&b)]);
    let (_, stderr) = expect_exit(3, &["compare", text(&a), text(&b)]);
    assert!(stderr.contains("3 and 4 lights"), "{stderr}");
    let (_, stderr) = expect_exit(3, &["compare", text(&a), text(&png)]);
    assert!(stderr.contains("two of a kind"), "{stderr}");
    expect_exit(0, &["render", SCENE, "--lights", "random:3", "-o", text(&b), "--size", "40x32"]);
    let (_, stderr) = expect_exit(3, &["compare", text(&a), text(&b)]);
    assert!(stderr.contains("48 × 32 and 40 × 32"), "{stderr}");
    let (_, stderr) = expect_exit(3, &["compare", text(&a), text(&at("none.exr"))]);
    assert!(stderr.contains("none.exr") && stderr.contains("check that the file is there"), "{stderr}");
    let (_, stderr) = expect_exit(3, &["compare", text(&png), text(&at("none.png"))]);
    assert!(stderr.contains("none.png") && stderr.contains("check that the file is there"), "{stderr}");
    let none = at("none.npy");
    let (_, stderr) =
        expect_exit(3, &["compare", text(&a), text(&a), "--light-bits", text(&none), text(&none)]);
    assert!(stderr.contains("none.npy") && stderr.contains("check that the file is there"), "{stderr}");
    let broken = at("broken.exr");
    let bytes = fs_err::read(&a).unwrap();
    for length in [0, 3, 100, bytes.len() / 2] {
        fs_err::write(&broken, &bytes[..length]).unwrap();
        let (_, stderr) = expect_exit(3, &["compare", text(&broken), text(&a)]);
        assert!(stderr.contains("broken.exr"), "{stderr}");
    }
    fs_err::write(at("broken.png"), b"no picture").unwrap();
    let (_, stderr) = expect_exit(3, &["compare", text(&png), text(&at("broken.png"))]);
    assert!(stderr.contains("broken.png"), "{stderr}");
    // An EXR of another program, with colours alone, can be compared all the same.
    let plain = at("plain.exr");
    let archive = at("p.mvb");
    bake_town(&archive, 5, 1, false);
    expect_exit(0, &["preview", text(&archive), "-o", text(&plain), "--size", "48x32", "--mode", "color"]);
    let found = json(&["compare", text(&plain), text(&plain)]);
    assert_eq!(
        (&found["equal"], &found["eps_s"], &found["eps_v"]),
        (&true.into(), &Value::Null, &Value::Null)
    );
    let (_, stderr) = expect_exit(
        3,
        &["compare", text(&plain), text(&plain), "--light-bits", text(&archive), text(&archive)],
    );
    assert!(stderr.contains("how many lights"), "{stderr}");
}

#[test]
fn virtual_lights_by_maps_are_like_exact_ones() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (scene, archive) = (at("s.glb"), at("a.mvb"));
    expect_exit(0, &["scene", "town", "--triangles", "2000", "-o", text(&scene)]);
    expect_exit(0, &["bake", text(&scene), "-o", text(&archive), "--levels", "9", "--rows", "0"]);
    let of = |method: &str| {
        let exr = at(&format!("{method}.exr"));
        let bake =
            ["--lights", "vpl:300:2", "--indirect-only", "--vpl-samples", "all", "--visibility", method];
        let files = ["--bake", text(&archive), "--resolution", "32", "-o", text(&exr), "--format", "json"];
        let (stdout, _) = render(0, &[&bake[..], &files].concat());
        let told: Value = serde_json::from_str(&stdout).unwrap();
        assert!((299..=300).contains(&told["lights"].as_u64().unwrap()), "{stdout}");
        assert!(told["gathered"]["seconds"]["gather"].is_number());
        (exr, told["mean_shadow"].as_f64().unwrap())
    };
    let (exact, exact_shadow) = of("raytrace");
    assert!(exact_shadow > 0.05);
    let psnr_of = |method: &str| {
        let (exr, shadow) = of(method);
        let found = json(&["compare", text(&exact), text(&exr)]);
        (found["psnr_db"].as_f64().unwrap(), shadow)
    };
    let (none, shadow) = psnr_of("none");
    assert_eq!(shadow, 0.0);
    for (method, most_difference, gain_db) in
        [("megaviews", 0.1, 3.0), ("manylods", 0.1, 3.0), ("ism", 0.2, 0.0)]
    {
        let (psnr, shadow) = psnr_of(method);
        assert!((shadow - exact_shadow).abs() < most_difference, "{method}: {shadow} {exact_shadow}");
        assert!(psnr > none + gain_db, "{method}: {psnr} dB, without shadows {none}");
    }
    let (_, stderr) =
        render(2, &["--lights", "vpl:9", "-o", text(&at("p.png")), "--light-bits", text(&at("b.npy"))]);
    assert!(stderr.contains("--light-bits"), "{stderr}");
}

/// A channel of an EXR.
fn channel(path: &Path, name: &str) -> Vec<f32> {
    let image = exr::prelude::read_first_flat_layer_from_file(path).unwrap();
    let found = image.layer_data.channel_data.list.iter().find(|c| c.name.eq(name)).unwrap();
    found.sample_data.values_as_f32().collect()
}

/// A closed room, eight metres long, of walls in three colours, and a block that stands in it.
fn write_room(path: &Path) {
    use glam::{DMat4, Vec3, Vec4};
    use manyview_pipeline::scene::{Instance, Material, Mesh, Scene};
    // The sides of a box whose fronts face out, or in.
    let sides = |min: Vec3, max: Vec3, inward: bool, material: u32| -> Vec<Mesh> {
        let side = |number: usize| {
            let (axis, is_far) = (number / 2, number % 2 == 1);
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let corner = |a: bool, b: bool| {
                let mut at = min;
                at[axis] = if is_far { max[axis] } else { min[axis] };
                at[u] = if a { max[u] } else { min[u] };
                at[v] = if b { max[v] } else { min[v] };
                at
            };
            let positions =
                vec![corner(false, false), corner(true, false), corner(true, true), corner(false, true)];
            let triangles =
                if is_far == inward { vec![[0, 2, 1], [0, 3, 2]] } else { vec![[0, 1, 2], [0, 2, 3]] };
            let material = if inward { axis as u32 } else { material };
            Mesh { positions, triangles, material, ..Mesh::default() }
        };
        (0..6).map(side).collect()
    };
    let mut meshes = sides(Vec3::new(-4.0, 0.0, -3.0), Vec3::new(4.0, 4.0, 3.0), true, 0);
    meshes.extend(sides(Vec3::new(-1.0, 0.0, -1.5), Vec3::new(0.5, 2.0, 0.0), false, 1));
    let colors = [[0.8, 0.2, 0.1], [0.7, 0.7, 0.7], [0.2, 0.6, 0.3]];
    let scene = Scene {
        instances: (0..meshes.len() as u32)
            .map(|mesh| Instance { mesh, world_from_object: DMat4::IDENTITY })
            .collect(),
        meshes,
        materials: colors
            .map(|[r, g, b]| Material { base_color: Vec4::new(r, g, b, 1.0), ..Material::default() })
            .into(),
        ..Scene::default()
    };
    manyview_pipeline::glb::write_glb(&scene, &mut fs_err::File::create(path).unwrap()).unwrap();
}

#[test]
fn light_over_points_is_like_that_of_virtual_lights() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let [scene, archive, lights, camera] = ["s.glb", "a.mvb", "l.json", "c.toml"].map(at);
    write_room(&scene);
    expect_exit(0, &["bake", text(&scene), "-o", text(&archive), "--levels", "8", "--rows", "0"]);
    fs_err::write(
        &lights,
        r#"[{"position": [2, 3, 1], "intensity": 90}, {"position": [-3, 1, 2], "intensity": 30, "color": [1, 0.5, 0.2]}]"#,
    )
    .unwrap();
    fs_err::write(&camera, "eye = [3.6, 2.2, 2.6]\ntarget = [-2, 1.2, -1.5]\nfov = 70").unwrap();
    let of = |name: &str, more: &[&str]| {
        let exr = at(name);
        let room = ["render", text(&scene), "--camera", text(&camera), "--size", "48x32", "--backend", "cpu"];
        let told = json(&[&room[..], &["--exposure", "0", "-o", text(&exr)], more].concat());
        (exr, told)
    };
    let points = |name: &str, kind: &str, more: &[&str]| {
        let bake = ["--bake", text(&archive), "--gi", kind, "--lights", text(&lights)];
        of(name, &[&bake[..], more].concat())
    };
    let (all, told) = points("all.exr", "points:300", &[]);
    assert_eq!((&told["gi"]["views"], &told["gi"]["lit_level"]), (&300.into(), &8.into()), "{told}");
    assert!(told["gi"]["seconds"]["maps"].is_number() && told["lights"] == 2);
    let (again, _) = points("again.exr", "points:300", &[]);
    assert_eq!(fs_err::read(&all).unwrap(), fs_err::read(&again).unwrap());
    // The same light as that of very many virtual lights at first hits, all of them tested by rays.
    let indirect = ["--indirect-only", "--resolution", "64"];
    let (maps, _) = points("maps.exr", "points:300", &indirect);
    let (casts, _) = points("casts.exr", "raycast:300", &["--indirect-only", "--resolution", "32"]);
    let vpls =
        ["--lights", "vpl:3000:1", "--primary", text(&lights), "--vpl-samples", "all", "--indirect-only"];
    let (exact, _) = of("exact.exr", &vpls);
    let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
    for color in ["R", "G", "B"] {
        let exact = channel(&exact, color);
        for (name, path) in [("maps", &maps), ("casts", &casts)] {
            let found = channel(path, color);
            let errors: Vec<f32> = found.iter().zip(&exact).map(|(a, b)| (a - b).abs()).collect();
            let (bias, error) = (mean(&found) / mean(&exact) - 1.0, mean(&errors) / mean(&exact));
            assert!(bias.abs() < 0.06 && error < 0.12, "{name} {color}: {bias} {error}");
        }
        assert!(mean(&channel(&all, color)) > 1.5 * mean(&exact), "lights are seen too");
    }
    let bake = ["render", text(&scene), "--bake", text(&archive), "--size", "8x8", "-o", text(&all)];
    let small = ["--gi", "points:50", "--lights", text(&lights), "--max-memory", "1KiB"];
    let (_, stderr) = expect_exit(4, &[&bake[..], &small].concat());
    assert!(stderr.contains("budget"), "{stderr}");
}

#[test]
fn light_over_points_is_refused_where_it_makes_no_sense() {
    let folder = tempfile::tempdir().unwrap();
    let [png, bits, scene, archive] =
        ["p.png", "b.npy", "s.glb", "a.mvb"].map(|name| folder.path().join(name));
    write_room(&scene);
    expect_exit(0, &["bake", text(&scene), "-o", text(&archive), "--levels", "4", "--rows", "0"]);
    let room = ["render", text(&scene), "--bake", text(&archive), "--size", "8x8", "-o", text(&png)];
    for (arguments, part) in [
        (vec!["--gi", "points:0"], "1 to 1000000 views"),
        (vec!["--gi", "points:1000001"], "1 to 1000000 views"),
        (vec!["--gi", "lines"], "points:VIEWS"),
        (vec!["--gi", "points", "--lights", "vpl:9"], "not vpl:N"),
        (vec!["--gi", "points", "--lights", "random:200000"], "at most 100000"),
        (vec!["--gi", "points", "--resolution", "12"], "use 8, 16"),
        (vec!["--gi", "points", "--indirect-only", "--light-bits", text(&bits)], "--light-bits"),
    ] {
        let (_, stderr) = expect_exit(2, &[&room[..], &arguments].concat());
        assert!(stderr.contains(part), "{arguments:?}: {stderr}");
    }
    assert!(!png.exists() && !bits.exists());
}
