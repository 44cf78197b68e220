//! Pictures, read back from their files.
#![cfg(feature = "bake")]

mod support;

use std::path::Path;

use exr::prelude::{FlatSamples, ReadChannels, ReadLayers};
use manyview::Archive;
use support::{bake_town, expect_exit};

/// Channels of a single-layer EXR by name.
fn read_exr(path: &Path) -> (usize, usize, Vec<(String, Vec<f32>)>) {
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_file(path)
        .unwrap();
    let layer = image.layer_data;
    let channels = layer.channel_data.list.into_iter().map(|channel| match channel.sample_data {
        FlatSamples::F32(values) => (channel.name.to_string(), values),
        other => panic!("{} is not 32-bit float: {other:?}", channel.name),
    });
    (layer.size.x(), layer.size.y(), channels.collect())
}

#[test]
fn every_mode_makes_a_picture_of_the_size_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let archive = folder.path().join("a.mvb");
    bake_town(&archive, 7, 1, true);
    let archive = archive.to_str().unwrap();
    let png = folder.path().join("p.png");
    let mut pictures: Vec<Vec<u8>> = Vec::new();
    for mode in ["shaded", "color", "normal", "level", "emissive", "depth"] {
        let arguments = ["preview", archive, "-o", png.to_str().unwrap(), "--size", "64x40", "--mode", mode];
        expect_exit(0, &arguments);
        let picture = image::open(&png).unwrap().into_rgb8();
        assert_eq!(picture.dimensions(), (64, 40));
        let first = picture.pixels().next().unwrap();
        let others = picture.pixels().filter(|pixel| *pixel != first).count();
        // Of the emitted light, a few windows and lamps.
        let least = if mode == "emissive" { 3 } else { 100 };
        assert!(others >= least, "{mode}: only {others} pixels show something");
        assert!(!pictures.contains(picture.as_raw()), "{mode} looks like another mode");
        pictures.push(picture.into_raw());
    }
    // The same again, whatever the threads do.
    expect_exit(0, &["preview", archive, "-o", png.to_str().unwrap(), "--size", "64x40"]);
    assert_eq!(image::open(&png).unwrap().into_rgb8().into_raw(), pictures[0]);
    expect_exit(0, &["preview", archive, "-o", png.to_str().unwrap(), "--size", "64x40", "--level", "3"]);
    assert_ne!(image::open(&png).unwrap().into_rgb8().into_raw(), pictures[0]);
    expect_exit(
        0,
        &["preview", archive, "-o", png.to_str().unwrap(), "--size", "64x40", "--camera", "inside"],
    );
    assert_ne!(image::open(&png).unwrap().into_rgb8().into_raw(), pictures[0]);
}

#[test]
fn an_exr_has_depths_normals_and_positions_in_metres() {
    let folder = tempfile::tempdir().unwrap();
    let archive = folder.path().join("a.mvb");
    bake_town(&archive, 7, 1, true);
    let info = *Archive::open(&archive).unwrap().scene_info();
    // Straight down from a kilometre above, wide enough to see past the town.
    let camera = folder.path().join("c.toml");
    let middle = [0, 2].map(|i| (info.bounds_min[i] + info.bounds_max[i]) * 0.5);
    let eye = format!("[{}, 1000.0, {}]", middle[0], middle[1]);
    let target = format!("[{}, 0.0, {}]", middle[0], middle[1]);
    fs_err::write(&camera, format!("eye = {eye}\ntarget = {target}\nup = [0, 0, -1]\nfov = 60")).unwrap();
    let exr = folder.path().join("p.exr");
    expect_exit(
        0,
        &[
            "preview",
            archive.to_str().unwrap(),
            "-o",
            exr.to_str().unwrap(),
            "--size",
            "33x33",
            "--samples",
            "1",
            "--camera",
            camera.to_str().unwrap(),
        ],
    );
    let (width, height, channels) = read_exr(&exr);
    assert_eq!((width, height), (33, 33));
    let names: Vec<&str> = channels.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(
        names,
        [
            "B",
            "G",
            "R",
            "depth.Z",
            "normal.X",
            "normal.Y",
            "normal.Z",
            "position.X",
            "position.Y",
            "position.Z"
        ]
    );
    let channel = |name: &str| &channels.iter().find(|(n, _)| n == name).unwrap().1;
    let center = 16 * 33 + 16;
    let (depth, y) = (channel("depth.Z")[center], channel("position.Y")[center]);
    assert!((depth + y - 1000.0).abs() < 1e-3, "the ray goes straight down: {depth} + {y}");
    assert!((channel("position.X")[center] - middle[0] as f32).abs() < 1e-3);
    assert!(f64::from(y) <= info.bounds_max[1] + 4.0 && f64::from(y) >= info.bounds_min[1]);
    assert!(channel("normal.Y")[center] > 0.0, "the surface faces the camera");
    assert_eq!(channel("depth.Z")[0], f32::INFINITY, "the corner is empty");
    assert!(channel("R").iter().all(|c| c.is_finite() && *c >= 0.0));
}

#[test]
fn slices_show_each_cell_of_a_layer() {
    let folder = tempfile::tempdir().unwrap();
    let archive = folder.path().join("a.mvb");
    bake_town(&archive, 6, 1, true);
    let svo = Archive::open(&archive).unwrap().svo().unwrap();
    let png = folder.path().join("s.png");
    let cells = svo.cells(6);
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let index = cells[cells.len() / 2][axis];
        let slice = format!("{name}={index}");
        let arguments =
            ["preview", archive.to_str().unwrap(), "-o", png.to_str().unwrap(), "--slice", &slice];
        expect_exit(0, &arguments);
        let picture = image::open(&png).unwrap().into_rgb8();
        assert_eq!(picture.dimensions(), (64, 64));
        let mut filled = vec![];
        for cell in cells.iter().filter(|cell| cell[axis] == index) {
            let [x, y, z] = cell.map(u32::from);
            filled.push([(z, 63 - y), (x, z), (x, 63 - y)][axis]);
        }
        let background = (0..64 * 64)
            .map(|i| (i % 64, i / 64))
            .find(|place| !filled.contains(place))
            .map(|(x, y)| *picture.get_pixel(x, y));
        for y in 0..64 {
            for x in 0..64 {
                let shows = Some(*picture.get_pixel(x, y)) != background;
                assert_eq!(shows, filled.contains(&(x, y)), "{slice} at {x}, {y}");
            }
        }
    }
    expect_exit(
        0,
        &[
            "preview",
            archive.to_str().unwrap(),
            "-o",
            png.to_str().unwrap(),
            "--slice",
            "y=1.0",
            "--level",
            "2",
        ],
    );
    assert_eq!(image::open(&png).unwrap().width(), 4);
}

#[test]
fn the_rows_of_a_direction_show_their_silhouette() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mvb");
    bake_town(&path, 5, 1, true);
    let rows = Archive::open(&path).unwrap().direction_rows(20).unwrap();
    let exr = folder.path().join("d.exr");
    let arguments = ["preview", path.to_str().unwrap(), "-o", exr.to_str().unwrap(), "--direction", "20"];
    expect_exit(0, &arguments);
    let (width, height, channels) = read_exr(&exr);
    assert_eq!(height, 512, "32 rows, 16 pixels each");
    let channel = |name: &str| &channels.iter().find(|(n, _)| n == name).unwrap().1;
    for v in 0..32 {
        for u in 0..32 {
            let at = (511 - (v * 16 + 3)) * width + u * 16 + 5;
            let row = rows[v * 32 + u];
            let first = if row == 0 { f32::INFINITY } else { row.trailing_zeros() as f32 };
            assert_eq!(channel("first.Z")[at], first, "{u} {v}");
            assert_eq!(channel("voxels.Z")[at], row.count_ones() as f32);
        }
    }
}
