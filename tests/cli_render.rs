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
#[ignore = "known fault: maps hide 0.71 of the tested pairs in the open where exact rays hide 0.42; their bias is not measured yet"]
fn virtual_lights_by_maps_are_like_exact_ones() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (scene, archive) = (at("s.glb"), at("a.mvb"));
    expect_exit(0, &["scene", "town", "--triangles", "2000", "-o", text(&scene)]);
    expect_exit(0, &["bake", text(&scene), "-o", text(&archive), "--levels", "9", "--rows", "0"]);
    let of = |method: &str, more: &[&str]| {
        let exr = at(&format!("{method}.exr"));
        let bake = ["--lights", "vpl:300:2", "--indirect-only", "--visibility", method, "--exposure", "0"];
        let files = ["--bake", text(&archive), "-o", text(&exr), "--format", "json"];
        let (stdout, _) = render(0, &[&bake[..], &files, more].concat());
        let told: Value = serde_json::from_str(&stdout).unwrap();
        assert!((299..=300).contains(&told["lights"].as_u64().unwrap()), "{stdout}");
        assert!(told["gathered"]["seconds"]["gather"].is_number());
        (exr, told["mean_shadow"].as_f64().unwrap())
    };
    let (exact, exact_shadow) = of("raytrace", &["--vpl-samples", "all"]);
    assert!(exact_shadow > 0.05);
    for (method, more) in [
        ("megaviews", &["--resolution", "32"][..]),
        ("manylods", &["--resolution", "32", "--vpl-samples", "all"]),
        ("ism", &["--resolution", "32"]),
        ("none", &[]),
    ] {
        let (exr, shadow) = of(method, more);
        let found = json(&["compare", text(&exact), text(&exr)]);
        let psnr = found["psnr_db"].as_f64().unwrap();
        eprintln!("{method}: {psnr} dB, shadow {shadow}, exactly {exact_shadow}");
        match method {
            "none" => assert_eq!(shadow, 0.0),
            _ => assert!((shadow - exact_shadow).abs() < 0.2, "{method}: {shadow} {exact_shadow}"),
        }
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

#[test]
fn light_over_points_is_like_that_of_virtual_lights() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (archive, lights) = (at("a.mvb"), at("lights.json"));
    let scene = at("s.glb");
    expect_exit(0, &["scene", "town", "--triangles", "2000", "-o", text(&scene)]);
    expect_exit(0, &["bake", text(&scene), "-o", text(&archive), "--levels", "9", "--rows", "0"]);
    fs_err::write(
        &lights,
        r#"[{"position": [0, 40, 0], "intensity": 9000}, {"position": [30, 30, 20], "intensity": 5000, "color": [1, 0.5, 0.2]}]"#,
    )
    .unwrap();
    let points =
        ["--bake", text(&archive), "--gi", "points:300", "--lights", text(&lights), "--exposure", "0"];
    let of = |name: &str, more: &[&str]| {
        let exr = at(name);
        let (stdout, _) = render(0, &[&points[..], &["--format", "json", "-o", text(&exr)], more].concat());
        (exr, serde_json::from_str::<Value>(&stdout).unwrap())
    };
    let (all, told) = of("all.exr", &[]);
    assert_eq!((&told["gi"]["views"], &told["gi"]["lit_level"]), (&300.into(), &9.into()), "{told}");
    assert!(told["gi"]["seconds"]["maps"].is_number() && told["lights"] == 2);
    let (again, _) = of("again.exr", &[]);
    assert_eq!(fs_err::read(&all).unwrap(), fs_err::read(&again).unwrap());
    // The same light as that of very many virtual lights at first hits, all of them tested by rays.
    let (indirect, _) = of("indirect.exr", &["--indirect-only", "--resolution", "64"]);
    let exact = at("exact.exr");
    let vpls = ["--lights", "vpl:3000:1", "--primary", text(&lights), "--vpl-samples", "all"];
    render(0, &[&vpls[..], &["--indirect-only", "--exposure", "0", "-o", text(&exact)]].concat());
    let [all, indirect, exact] = [&all, &indirect, &exact].map(|path| channel(path, "G"));
    let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
    let error = indirect.iter().zip(&exact).map(|(a, b)| (a - b).abs()).sum::<f32>() / exact.len() as f32;
    eprintln!("{} {} {error}", mean(&indirect), mean(&exact));
    assert!((mean(&indirect) / mean(&exact) - 1.0).abs() < 0.15, "{} {}", mean(&indirect), mean(&exact));
    assert!(error < 0.3 * mean(&exact), "{error} {}", mean(&exact));
    assert!(mean(&all) > 1.5 * mean(&indirect), "lights are seen too");
}

#[test]
fn light_over_points_is_refused_where_it_makes_no_sense() {
    let folder = tempfile::tempdir().unwrap();
    let (png, bits) = (folder.path().join("p.png"), folder.path().join("b.npy"));
    for (arguments, part) in [
        (vec!["--gi", "points:0"], "1 to 1000000 views"),
        (vec!["--gi", "points:1000001"], "1 to 1000000 views"),
        (vec!["--gi", "lines"], "points:VIEWS"),
        (vec!["--gi", "points", "--lights", "vpl:9"], "not vpl:N"),
        (vec!["--gi", "points", "--lights", "random:200000"], "at most 100000"),
        (vec!["--gi", "points", "--resolution", "12"], "use 8, 16"),
        (vec!["--gi", "points", "--indirect-only", "--light-bits", text(&bits)], "--light-bits"),
    ] {
        let (_, stderr) = render(2, &[&arguments[..], &["-o", text(&png)]].concat());
        assert!(stderr.contains(part), "{arguments:?}: {stderr}");
    }
    let small = ["--gi", "points:50", "--lights", "random:2", "--max-memory", "1KiB", "-o", text(&png)];
    let (_, stderr) = render(4, &small);
    assert!(stderr.contains("budget"), "{stderr}");
    assert!(!png.exists() && !bits.exists());
}
