//! `manyview rays` as a shell sees it: files in, files out, exit codes.
#![cfg(feature = "bake")]

mod support;

use manyview::npy::{ArrayReader, Element, write_elements, write_header};
use std::path::Path;
use support::{Numbers, bake_town, expect_exit};

const TOWN: &str = "town:2000";

fn write(path: &Path, width: usize, numbers: &[f32]) {
    let mut file = Vec::new();
    write_header::<f32>(&mut file, &[numbers.len() / width, width]).unwrap();
    write_elements(&mut file, numbers).unwrap();
    fs_err::write(path, file).unwrap();
}

fn read<T: Element>(path: &Path) -> Vec<T> {
    let bytes = fs_err::read(path).unwrap();
    let mut reader = ArrayReader::<T, _>::new("h", bytes.as_slice(), &[&[None]]).unwrap();
    let mut values = vec![T::zeroed(); reader.shape()[0] as usize + 1];
    let count = reader.read(&mut values).unwrap();
    values.truncate(count);
    values
}

/// Segments from points high above a scene straight down, and some that hit nothing by definition.
fn rays(count: usize) -> Vec<f32> {
    let mut numbers = Numbers(7);
    let mut at = || (numbers.unit() as f32 - 0.5) * 30.0;
    let mut rays: Vec<f32> = (0..count)
        .flat_map(|_| {
            let (x, z) = (at(), at());
            [x, 500.0, z, x, -500.0, z]
        })
        .collect();
    rays.extend([f32::NAN, 500.0, 0.0, 0.0, -500.0, 0.0]);
    rays.extend([0.0, 500.0, 0.0, 0.0, f32::INFINITY, 0.0]);
    rays.extend([1.0, 2.0, 3.0, 1.0, 2.0, 3.0]);
    rays
}

#[test]
fn segments_through_the_ground_hit_it_by_every_method() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let text = |name: &str| path(name).to_str().unwrap().to_owned();
    bake_town(&path("a.mvb"), 6, 1, true);
    write(&path("r.npy"), 6, &rays(100));
    let run = |input: &str, method: &str, more: &[&str]| {
        let (rays, answers) = (text("r.npy"), text("h.npy"));
        let all = [&["rays", input, "--rays", &rays, "-o", &answers, "--method", method], more].concat();
        expect_exit(0, &all)
    };
    run(TOWN, "bvh", &[]);
    let bvh: Vec<u8> = read(&path("h.npy"));
    run(TOWN, "exact", &[]);
    let exact: Vec<u8> = read(&path("h.npy"));
    assert_eq!(exact.len(), 103);
    assert!(exact[..100].iter().all(|&hit| hit == 1) && exact[100..] == [0; 3], "{exact:?}");
    assert_eq!(bvh, exact);
    let (stdout, _) = run(TOWN, "exact", &["--distance", "--format", "json"]);
    let distances: Vec<f32> = read(&path("h.npy"));
    assert!(distances[..100].iter().all(|d| (400.0..520.0).contains(d)), "{distances:?}");
    assert_eq!(distances[100..], [f32::INFINITY; 3]);
    let told: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(
        (&told["rays"], &told["hits"], &told["without_answer"]),
        (&103.into(), &100.into(), &3.into())
    );
    for method in ["rows", "brickmap"] {
        run(&text("a.mvb"), method, &[]);
        let found: Vec<u8> = read(&path("h.npy"));
        assert_eq!((found.len(), &found[100..]), (103, &[0u8; 3][..]));
        let hits = found.iter().filter(|&&hit| hit == 1).count();
        assert!(hits >= 95, "{hits} by {method}");
    }
}

#[test]
fn no_segments_give_no_answers_and_normals_are_taken() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let text = |name: &str| path(name).to_str().unwrap().to_owned();
    write(&path("none.npy"), 6, &[]);
    expect_exit(0, &["rays", TOWN, "--rays", &text("none.npy"), "-o", &text("h.npy"), "--method", "bvh"]);
    assert!(read::<u8>(&path("h.npy")).is_empty());
    write(&path("one.npy"), 9, &[0.0, 500.0, 0.0, 0.0, -500.0, 0.0, 0.0, 1.0, 0.0]);
    expect_exit(0, &["rays", TOWN, "--rays", &text("one.npy"), "-o", &text("h.npy"), "--method", "bvh"]);
    assert_eq!(read::<u8>(&path("h.npy")), [1]);
}

#[test]
fn answers_do_not_overwrite_what_they_are_answers_to() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let text = |name: &str| path(name).to_str().unwrap().to_owned();
    bake_town(&path("a.mvb"), 5, 1, true);
    write(&path("r.npy"), 6, &rays(1));
    let before = [fs_err::read(path("a.mvb")).unwrap(), fs_err::read(path("r.npy")).unwrap()];
    fs_err::create_dir(path("sub")).unwrap();
    for (output, named) in [("r.npy", "--rays"), ("sub/../r.npy", "--rays"), ("a.mvb", "A.mvb|SCENE")] {
        let arguments = ["rays", &text("a.mvb"), "--rays", &text("r.npy"), "-o", &text(output)];
        let (_, stderr) = expect_exit(2, &arguments);
        assert!(stderr.contains("--output") && stderr.contains(named), "{stderr}");
    }
    let (_, stderr) = expect_exit(2, &["voxels", &text("a.mvb"), "--level", "2", "-o", &text("a.mvb")]);
    assert!(stderr.contains("--output") && stderr.contains("A.mvb"), "{stderr}");
    assert_eq!(before, [fs_err::read(path("a.mvb")).unwrap(), fs_err::read(path("r.npy")).unwrap()]);
}

#[test]
fn wrong_inputs_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let text = |name: &str| path(name).to_str().unwrap().to_owned();
    bake_town(&path("a.mvb"), 5, 1, true);
    write(&path("r.npy"), 6, &rays(1));
    write(&path("seven.npy"), 7, &[0.0; 14]);
    fs_err::write(path("words.npy"), "no array").unwrap();
    let fail = |exit, input: &str, rays: &str, method: &str| {
        let arguments = ["rays", input, "--rays", &text(rays), "-o", &text("h.npy"), "--method", method];
        let (stdout, stderr) = expect_exit(exit, &arguments);
        assert!(stdout.is_empty() && !path("h.npy").exists());
        stderr
    };
    let archive = text("a.mvb");
    let message = fail(2, &archive, "r.npy", "bvh");
    assert!(
        message.contains("a.mvb") && message.contains("name the scene that it was baked from"),
        "{message}"
    );
    let message = fail(3, TOWN, "seven.npy", "bvh");
    assert!(message.contains("expected float32 (n, 6) or (n, 9), found float32 (2, 7)"), "{message}");
    assert!(fail(3, TOWN, "words.npy", "bvh").contains("numpy.save"));
    let message = fail(3, TOWN, "missing.npy", "bvh");
    assert!(message.contains("missing.npy") && message.contains("check that the file is there"), "{message}");
    let message = fail(2, "town:0", "r.npy", "bvh");
    assert!(message.contains("1000 to 1000000000 triangles"), "{message}");
    assert!(fail(2, "town:-1", "r.npy", "bvh").contains("town:100000"));
    assert!(fail(3, &text("missing.glb"), "r.npy", "bvh").contains("missing.glb"));
    assert!(fail(3, &text("missing.mvb"), "r.npy", "rows").contains("missing.mvb"));
}
