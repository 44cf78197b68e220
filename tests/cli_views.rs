//! `manyview views` as a shell sees it: files in, files out, exit codes.
#![cfg(feature = "bake")]

mod support;

use manyview::npy::{ArrayReader, write_elements, write_header};
use serde_json::Value;
use std::path::Path;
use support::{bake_town, expect_exit};

const ALL_AROUND: f32 = 3.2;

fn write(path: &Path, shape: &[usize], numbers: &[f32]) {
    let mut file = Vec::new();
    write_header::<f32>(&mut file, shape).unwrap();
    write_elements(&mut file, numbers).unwrap();
    fs_err::write(path, file).unwrap();
}

/// Shape and elements.
fn read(path: &Path) -> (Vec<u64>, Vec<f32>) {
    let bytes = fs_err::read(path).unwrap();
    let mut reader = ArrayReader::<f32, _>::new("d", bytes.as_slice(), &[&[None; 4]]).unwrap();
    let shape = reader.shape().to_vec();
    let mut values = vec![0.0; shape.iter().product::<u64>() as usize + 1];
    let count = reader.read(&mut values).unwrap();
    values.truncate(count);
    (shape, values)
}

/// Views high above the town, one of them nowhere.
fn views() -> Vec<f32> {
    let mut views = Vec::new();
    for x in [-3.0, 0.0, 2.0] {
        views.extend([x, 40.0, 1.0, 0.0, -1.0, 0.0, ALL_AROUND]);
    }
    views[7] = f32::NAN;
    views
}

struct Place {
    folder: tempfile::TempDir,
}

impl Place {
    fn new() -> Self {
        let place = Self { folder: tempfile::tempdir().unwrap() };
        bake_town(&place.folder.path().join("a.mvb"), 6, 1, false);
        write(&place.folder.path().join("v.npy"), &[3, 7], &views());
        place
    }

    fn at(&self, name: &str) -> String {
        self.folder.path().join(name).to_str().unwrap().to_owned()
    }

    fn run(&self, exit: i32, input: &str, views: &str, output: &str, more: &[&str]) -> (String, String) {
        let (input, output) =
            (if input.contains(':') { input.to_owned() } else { self.at(input) }, self.at(output));
        let views = if views.contains(':') { views.to_owned() } else { self.at(views) };
        expect_exit(exit, &[&["views", &input, "--views", &views, "-o", &output], more].concat())
    }

    fn map(&self, name: &str) -> (Vec<u64>, Vec<f32>) {
        read(&self.folder.path().join(name))
    }
}

#[test]
fn each_view_has_a_map_and_what_is_nowhere_an_empty_one() {
    let place = Place::new();
    let more = ["--method", "raycast", "--resolution", "32", "--format", "json"];
    let (stdout, stderr) = place.run(0, "a.mvb", "v.npy", "d.npy", &more);
    let (shape, depths) = place.map("d.npy");
    assert_eq!(shape, [3, 2, 32, 32]);
    let maps: Vec<&[f32]> = depths.chunks(2 * 32 * 32).collect();
    assert!(maps[1].iter().all(|d| *d == f32::INFINITY));
    for map in [maps[0], maps[2]] {
        // Straight down is (a, b) = (-1, 0): column 0, row 16.
        let down = map[16 * 32];
        assert!((10.0..60.0).contains(&down), "{down}");
        assert_eq!(map[16 * 32 + 31], f32::INFINITY, "nothing is above");
        assert_eq!(map[0], f32::INFINITY, "outside the disc");
    }
    let told: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(
        (&told["views"], &told["without_map"], &told["maps"], &told["method"]),
        (&3.into(), &1.into(), &2.into(), &"raycast".into())
    );
    assert!(stderr.lines().all(|line| serde_json::from_str::<Value>(line).is_ok()), "{stderr}");
    assert!(stderr.contains("estimate"), "{stderr}");
    let (_, stderr) = place.run(0, "a.mvb", "v.npy", "d.npy", &more[..4]);
    assert!(stderr.contains("1 view at positions that are not finite"), "{stderr}");
}

#[test]
fn a_small_budget_makes_passes_and_the_same_bytes() {
    let place = Place::new();
    let method = ["--method", "raycast"];
    place.run(0, "a.mvb", "surface:40:3", "all.npy", &method);
    let small = ["--method", "raycast", "--max-memory", "10KiB", "--format", "json"];
    let (stdout, _) = place.run(0, "a.mvb", "surface:40:3", "passes.npy", &small);
    let told: Value = serde_json::from_str(&stdout).unwrap();
    assert!(told["passes"].as_u64().unwrap() >= 8, "{told}");
    let all = place.map("all.npy");
    assert_eq!(all, place.map("passes.npy"));
    assert!(all.1.iter().any(|d| d.is_finite()));
}

#[test]
fn triangles_and_their_polygons_agree_and_voxels_nearly() {
    let place = Place::new();
    let scene = "town:5000";
    for method in ["raycast-triangles", "polygons"] {
        place.run(0, scene, "v.npy", &format!("{method}.npy"), &["--method", method]);
    }
    place.run(0, "a.mvb", "v.npy", "raycast.npy", &["--method", "raycast"]);
    let [rays, polygons, voxels] =
        ["raycast-triangles", "polygons", "raycast"].map(|method| place.map(&format!("{method}.npy")).1);
    let near = |other: &[f32], most: f32| {
        rays.iter().zip(other).filter(|(a, b)| a == b || (*a / *b - 1.0).abs() < most).count()
    };
    assert!(near(&polygons, 1e-5) >= rays.len() - 2, "{} of {}", near(&polygons, 1e-5), rays.len());
    assert!(near(&voxels, 0.1) > rays.len() * 9 / 10, "{} of {}", near(&voxels, 0.1), rays.len());
    place.run(0, scene, "surface:3", "s.npy", &["--method", "polygons", "--resolution", "8"]);
    assert_eq!(place.map("s.npy").0, [3, 2, 8, 8]);
}

#[test]
fn no_views_make_an_empty_array() {
    let place = Place::new();
    write(&place.folder.path().join("none.npy"), &[0, 7], &[]);
    for views in ["none.npy", "random:0"] {
        place.run(0, "a.mvb", views, "d.npy", &["--method", "raycast"]);
        assert_eq!(place.map("d.npy"), (vec![0, 2, 16, 16], Vec::new()));
    }
    let (_, stderr) = place.run(2, "a.mvb", "none.npy", "d.exr", &["--method", "raycast"]);
    assert!(stderr.contains(".npy"), "{stderr}");
}

#[test]
fn a_picture_has_all_maps_and_colours() {
    let place = Place::new();
    place.run(0, "a.mvb", "v.npy", "d.npy", &["--method", "raycast"]);
    place.run(0, "a.mvb", "v.npy", "d.exr", &["--method", "raycast", "--colors"]);
    let picture = exr::prelude::read_first_flat_layer_from_file(place.at("d.exr")).unwrap();
    let size = picture.layer_data.size;
    // Two tiles of two halves in the first row, one in the second.
    assert_eq!((size.0, size.1), (64, 32));
    let channel = |name: &str| -> Vec<f32> {
        let channels = &picture.layer_data.channel_data.list;
        let found = channels.iter().find(|channel| channel.name.eq(name)).unwrap();
        found.sample_data.values_as_f32().collect()
    };
    let (depths, red) = (channel("Y"), channel("R"));
    let (_, array) = place.map("d.npy");
    for view in 0..3 {
        for half in 0..2 {
            for (row, column) in [(8, 0), (8, 3), (2, 8), (15, 7)] {
                let at = (view / 2 * 16 + row) * 64 + view % 2 * 32 + half * 16 + column;
                let expected = array[((view * 2 + half) * 16 + row) * 16 + column];
                assert_eq!(depths[at], expected);
                assert!(red[at] >= 0.0 && (red[at] == 0.0) >= (expected == f32::INFINITY));
            }
        }
    }
    assert!(red.iter().any(|&red| red > 0.0));
}

#[test]
fn wrong_inputs_are_told_apart() {
    let place = Place::new();
    write(&place.folder.path().join("six.npy"), &[2, 6], &[0.0; 12]);
    fs_err::write(place.folder.path().join("words.npy"), "no array").unwrap();
    let fail = |exit, input: &str, views: &str, output: &str, more: &[&str]| {
        let before = fs_err::read(place.at(output)).ok();
        let (stdout, stderr) = place.run(exit, input, views, output, more);
        assert!(stdout.is_empty() && fs_err::read(place.at(output)).ok() == before, "{stdout}");
        stderr
    };
    let raycast = ["--method", "raycast"];
    let message = fail(3, "a.mvb", "six.npy", "d.npy", &raycast);
    assert!(message.contains("expected float32 (n, 7), found float32 (2, 6)"), "{message}");
    assert!(fail(3, "a.mvb", "words.npy", "d.npy", &raycast).contains("numpy.save"));
    assert!(fail(3, "a.mvb", "missing.npy", "d.npy", &raycast).contains("random:1000"));
    assert!(fail(3, "missing.mvb", "v.npy", "d.npy", &raycast).contains("missing.mvb"));
    assert!(fail(3, "missing.glb", "v.npy", "d.npy", &raycast).contains("missing.glb"));
    assert!(fail(2, "a.mvb", "v.npy", "d.png", &raycast).contains(".npy or .exr"));
    assert!(fail(2, "a.mvb", "v.npy", "v.npy", &raycast).contains("replace an input"));
    assert!(fail(2, "a.mvb", "random:x", "d.npy", &raycast).contains("surface:1000:7"));
    for resolution in ["0", "4", "12", "2048", "-1"] {
        fail(2, "a.mvb", "v.npy", "d.npy", &["--method", "raycast", "--resolution", resolution]);
    }
    assert!(fail(2, "a.mvb", "v.npy", "d.npy", &["--method", "maps"]).contains("raycast"));
    assert!(fail(2, "a.mvb", "v.npy", "d.npy", &["--method", "raycast", "--colors"]).contains("EXR"));
    let gpu = ["--method", "raycast", "--backend", "gpu"];
    assert!(fail(2, "a.mvb", "v.npy", "d.npy", &gpu).contains("--backend gpu"));
    for method in ["polygons", "raycast-triangles"] {
        let message = fail(2, "a.mvb", "v.npy", "d.npy", &["--method", method]);
        assert!(message.contains("name the scene"), "{message}");
    }
    for budget in ["1KiB", "10"] {
        let more = ["--method", "raycast", "--max-memory", budget];
        assert!(fail(4, "a.mvb", "v.npy", "d.npy", &more).contains("budget"));
        fail(4, "a.mvb", "v.npy", "d.exr", &more);
    }
    let nowhere = format!("nowhere{}d.npy", std::path::MAIN_SEPARATOR);
    assert!(fail(3, "a.mvb", "v.npy", &nowhere, &raycast).contains("make the folder first"));
}
