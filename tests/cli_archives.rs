//! The commands that look into archives, as a shell sees them: exit codes, stdout, files.
#![cfg(feature = "bake")]

mod support;

use std::path::{Path, PathBuf};

use manyview::Archive;
use support::{bake_town, expect_exit, rewrite};

struct Towns {
    folder: tempfile::TempDir,
    a: String,
    b: String,
}

/// Two towns: the second has another seed.
fn towns() -> Towns {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    bake_town(&path("a.mvb"), 6, 1, true);
    bake_town(&path("b.mvb"), 6, 2, true);
    let text = |name: &str| path(name).to_str().unwrap().to_owned();
    Towns { a: text("a.mvb"), b: text("b.mvb"), folder }
}

impl Towns {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }
}

#[test]
fn usage_errors_exit_with_2() {
    let towns = towns();
    let out = towns.text("out");
    for arguments in [
        &["nonsense"][..],
        &["inspect"],
        &["inspect", &towns.a, "--format", "xml"],
        &["voxels", &towns.a, "--level", "7", "-o", &out],
        &["voxels", &towns.a, "--level", "-1", "-o", &out],
        &["preview", &towns.a, "-o", &out],
        &["preview", &towns.a, "-o", "p.png", "--size", "0x0"],
        &["preview", &towns.a, "-o", "p.png", "--samples", "0"],
        &["preview", &towns.a, "-o", "p.png", "--level", "7"],
        &["preview", &towns.a, "-o", "p.png", "--slice", "y=64"],
        &["preview", &towns.a, "-o", "p.png", "--direction", "36"],
        &["preview", &towns.a, "-o", "p.png", "--direction", "3", "--slice", "y=0.5"],
    ] {
        let (stdout, stderr) = expect_exit(2, arguments);
        assert!(stdout.is_empty() && !stderr.is_empty(), "{arguments:?}");
    }
    assert!(!Path::new("p.png").exists() && !Path::new(&out).exists());
    expect_exit(0, &["--help"]);
    expect_exit(0, &["--version"]);
}

#[test]
fn bad_input_exits_with_3_and_names_it() {
    let towns = towns();
    let missing = towns.text("missing.mvb");
    let other = towns.text("other.mvb");
    fs_err::write(&other, b"glTF\x02\0\0\0 and more of another file").unwrap();
    let unwritable = towns.text("no/such/folder/v.npy");
    for arguments in [
        &["inspect", &missing][..],
        &["verify", &missing],
        &["diff", &towns.a, &missing],
        &["inspect", &other],
        &["voxels", &towns.a, "--level", "2", "-o", &unwritable],
        &["voxels", &towns.a, "--level", "2", "-o", towns.folder.path().to_str().unwrap()],
        &["preview", &towns.a, "-o", &unwritable.replace("npy", "png")],
        &["preview", &towns.a, "-o", &towns.text("p.png"), "--camera", &missing],
    ] {
        let (stdout, stderr) = expect_exit(3, arguments);
        let named = ["missing.mvb", "other.mvb", "no/such/folder", towns.folder.path().to_str().unwrap()];
        assert!(stdout.is_empty() && named.iter().any(|name| stderr.contains(name)), "{stderr}");
        assert_eq!(stderr.matches("error:").count(), 1, "{stderr}");
    }
    assert!(!towns.path("p.png").exists());
}

#[test]
fn corruption_anywhere_exits_with_5() {
    let towns = towns();
    let broken = towns.text("broken.mvb");
    let sound = fs_err::read(&towns.a).unwrap();
    expect_exit(0, &["verify", &towns.a]);
    let version = 8..12;
    for at in (0..sound.len()).step_by(sound.len() / 60).chain([0, 20, 40, sound.len() - 1]) {
        if version.contains(&at) {
            continue;
        }
        let mut bytes = sound.clone();
        bytes[at] ^= 0x10;
        fs_err::write(&broken, bytes).unwrap();
        let (_, stderr) = expect_exit(5, &["verify", &broken]);
        assert!(stderr.contains("broken.mvb"), "{at}: {stderr}");
    }
    for length in [0, 7, 63, 64, 1000, sound.len() / 2, sound.len() - 1] {
        fs_err::write(&broken, &sound[..length]).unwrap();
        expect_exit(5, &["verify", &broken]);
    }
    fs_err::write(&broken, &sound[..sound.len() / 2]).unwrap();
    expect_exit(5, &["inspect", &broken]);
    expect_exit(5, &["diff", &towns.a, &broken]);
    let mut newer = sound.clone();
    newer[8] = 99;
    fs_err::write(&broken, newer).unwrap();
    let (_, stderr) = expect_exit(3, &["verify", &broken]);
    assert!(stderr.contains("version 99"), "{stderr}");
}

#[test]
fn verify_finds_what_hashes_cannot() {
    let towns = towns();
    let broken = towns.text("broken.mvb");
    let path = Path::new(&broken);
    let expect_failure = |part: &str| {
        let (_, stderr) = expect_exit(5, &["verify", &broken]);
        assert!(stderr.contains(part), "{part}: {stderr}");
    };
    // A valid container each time: all hashes are right.
    for (kind, item) in [("svo.colors", 3), ("svo.normals", 5), ("svo.cones", 0), ("svo.coverages", 4)] {
        rewrite(Path::new(&towns.a), path, |name, i, mut content| {
            if (name, i) == (kind, item) {
                content[0] ^= 0x21;
            }
            Some(content)
        });
        expect_failure(&format!("section {kind}[{item}]: node 0 does not follow"));
    }
    rewrite(Path::new(&towns.a), path, |name, item, mut content| {
        if (name, item) == ("svo.coverages", 5) {
            content[7] = 0;
        }
        Some(content)
    });
    expect_failure("svo.coverages[5]: coverage of node 7");
    let (stdout, _) = expect_exit(5, &["verify", &broken, "--format", "json"]);
    let json: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(json["sound"], false);
    let direction_bytes = 32 * 32 * 4;
    rewrite(Path::new(&towns.a), path, |name, item, mut content| {
        if (name, item) == ("rows.bits", 0) {
            content[direction_bytes..2 * direction_bytes].fill(0);
        }
        Some(content)
    });
    // Thin scenes have such directions: no fault, but worth a word.
    let (stdout, _) = expect_exit(0, &["verify", &broken]);
    assert!(stdout.contains("1 direction without any"), "{stdout}");
}

#[test]
fn inspect_tells_what_is_inside() {
    let towns = towns();
    let (stdout, stderr) = expect_exit(0, &["inspect", &towns.a, "--format", "json"]);
    assert!(stderr.is_empty());
    let json: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    let archive = Archive::open(&towns.a).unwrap();
    assert_eq!(json["format_version"], 1);
    assert_eq!(json["scene"]["triangles"], archive.scene_info().triangles);
    assert_eq!(json["scene"]["bounds"]["max"][1], archive.scene_info().bounds_max[1]);
    assert_eq!(json["svo"]["levels"], 6);
    assert_eq!(json["svo"]["leaves"], archive.svo_info().leaves);
    assert_eq!(json["svo"]["nodes"], archive.svo_info().nodes);
    assert_eq!(json["svo"]["origin"].as_array().unwrap().len(), 3);
    assert_eq!(json["svo"]["size"], archive.svo_info().size);
    assert_eq!(json["rows"]["directions"], "latlong:6x6");
    assert_eq!(json["rows"]["count"], 36);
    assert_eq!(json["rows"]["resolution"], 32);
    assert_eq!(json["rows"]["grid"], "extent");
    assert_eq!(json["rows"]["source"], "points");
    assert_eq!(json["rows"]["raw_bytes"], 36 * 4096 + 36 * 48 + 80);
    assert_eq!(json["chunks"], archive.container().chunks().len());
    let sections = json["sections"].as_array().unwrap();
    let sum = |key: &str| sections.iter().map(|section| section[key].as_u64().unwrap()).sum::<u64>();
    assert_eq!(json["raw_bytes"], sum("raw_bytes"));
    assert_eq!(sections[0]["digest"].as_str().unwrap().len(), 64);
    assert!(json["svo"]["stored_bytes"].as_u64().unwrap() < json["svo"]["raw_bytes"].as_u64().unwrap());
    let (stdout, _) = expect_exit(0, &["inspect", &towns.a]);
    for part in ["triangles drawn", "6 levels (64³)", "latlong:6x6: 36 directions of 32³", "svo.masks"] {
        assert!(stdout.contains(part), "{part} is missing from\n{stdout}");
    }
    // A bake without rows.
    let bare = towns.path("bare.mvb");
    bake_town(&bare, 3, 1, false);
    let (stdout, _) = expect_exit(0, &["inspect", bare.to_str().unwrap(), "--format", "json"]);
    let json: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert!(json["rows"].is_null());
    expect_exit(0, &["verify", bare.to_str().unwrap()]);
    expect_exit(3, &["preview", bare.to_str().unwrap(), "--direction", "0", "-o", &towns.text("d.png")]);
}

#[test]
fn diff_counts_what_differs() {
    let towns = towns();
    let (stdout, _) = expect_exit(0, &["diff", &towns.a, &towns.a]);
    assert!(stdout.contains("hold the same"), "{stdout}");
    // Other chunks and another order are no difference, one bit of a row is.
    let changed = towns.text("changed.mvb");
    rewrite(Path::new(&towns.a), Path::new(&changed), |_, _, content| Some(content));
    expect_exit(0, &["diff", &towns.a, &changed]);
    rewrite(Path::new(&towns.a), Path::new(&changed), |name, item, mut content| {
        if (name, item) == ("rows.bits", 0) {
            content[3 * 4096 + 9] ^= 0b101;
        }
        if (name, item) == ("svo.colors", 6) {
            content[0] ^= 1;
        }
        Some(content)
    });
    let (stdout, _) = expect_exit(1, &["diff", &towns.a, &changed, "--format", "json"]);
    let json: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(json["same"], false);
    assert_eq!(json["rows"]["directions"], serde_json::json!([{ "direction": 3, "bits": 2 }]));
    assert_eq!(json["svo"][6]["attributes"], 1);
    assert_eq!(json["svo"][6]["only_in_a"], 0);
    assert_eq!(json["svo"][5]["attributes"], 0);
    let differing = json["sections"].as_array().unwrap().iter().filter(|s| s["state"] == "differs").count();
    assert_eq!(differing, 2);
    // Two towns in the same cube share some cells and not others.
    let (stdout, _) = expect_exit(1, &["diff", &towns.a, &towns.b]);
    assert!(stdout.contains("differ"), "{stdout}");
}

#[test]
fn voxels_are_a_numpy_array_in_morton_order() {
    let towns = towns();
    let out = towns.text("v.npy");
    let svo = Archive::open(&towns.a).unwrap().svo().unwrap();
    for level in [0, 3, 6] {
        let (stdout, _) = expect_exit(0, &["voxels", &towns.a, "--level", &level.to_string(), "-o", &out]);
        assert!(stdout.is_empty());
        let file = fs_err::read(&out).unwrap();
        assert_eq!(&file[..8], b"\x93NUMPY\x01\0");
        let header = usize::from(u16::from_le_bytes([file[8], file[9]])) + 10;
        let cells = svo.cells(level);
        let text = String::from_utf8(file[10..header].to_vec()).unwrap();
        assert!(text.contains(&format!("'shape': ({}, 3)", cells.len())) && text.contains("'<i4'"), "{text}");
        let values: Vec<i32> =
            file[header..].as_chunks().0.iter().map(|&value| i32::from_le_bytes(value)).collect();
        let expected: Vec<i32> = cells.into_iter().flatten().map(i32::from).collect();
        assert_eq!(values, expected);
    }
    let left: Vec<_> =
        fs_err::read_dir(towns.folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left.len(), 3, "nothing but two archives and the array: {left:?}");
}
