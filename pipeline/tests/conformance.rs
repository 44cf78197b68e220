//! Imports files made by others: odd ones, broken ones, and real scenes. They are not part of the repository; where their
//! folder is missing, these tests pass without having tested anything, and say so.

use manyview_pipeline::import::{ImportError, ImportOptions, import};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// A folder of `MANYVIEW_SHARED`, or of `shared` beside the workspace or above it.
fn shared(folder: &str) -> Option<PathBuf> {
    let roots = match std::env::var_os("MANYVIEW_SHARED") {
        Some(root) => vec![PathBuf::from(root)],
        None => {
            let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).parent()?;
            workspace.ancestors().skip(1).take(2).map(|above| above.join("shared")).collect()
        }
    };
    let found = roots.into_iter().map(|root| root.join(folder)).find(|folder| folder.is_dir());
    if found.is_none() {
        eprintln!("shared/{folder} is not there: nothing is tested");
    }
    found
}

#[test]
fn odd_files_draw_as_many_triangles_as_other_tools_say() {
    let Some(folder) = shared("conformance") else { return };
    let table = fs_err::read_to_string(folder.join("expected.tsv")).unwrap();
    // One file is known to differ: its Draco streams hold fewer triangles, by Google's own decoder, too, than its
    // accessors claim, which the table counts.
    let mut count = 0;
    let mut refused = 0;
    let mut failures = Vec::new();
    for line in table.lines().skip(1) {
        let (file, triangles) = line.split_once('\t').unwrap();
        let triangles: u64 = triangles.parse().unwrap();
        count += 1;
        match import(&folder.join(file), &ImportOptions::default()) {
            Ok(imported) if imported.scene.drawn_triangles() == triangles => {}
            Ok(imported) => {
                failures
                    .push(format!("{file}: {} triangles, not {triangles}", imported.scene.drawn_triangles()));
            }
            Err(error @ ImportError::Unsupported { .. }) => {
                refused += 1;
                eprintln!("refused: {error}");
            }
            Err(error) => failures.push(format!("{file}: {error}")),
        }
    }
    failures.iter().for_each(|failure| eprintln!("{failure}"));
    eprintln!("{} of {count} right, {refused} of them refused by name", count - failures.len());
    assert!(count > 400, "the table is too short: {count}");
    assert!(refused * 100 <= count, "{refused} of {count} refused");
    assert!(failures.len() * 50 <= count, "{} of {count} wrong", failures.len());
}

#[test]
fn broken_files_are_refused_or_forgiven_in_bounded_time() {
    let Some(folder) = shared("conformance/invalid") else { return };
    let mut pending = vec![folder];
    let mut count = 0;
    while let Some(folder) = pending.pop() {
        for entry in fs_err::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.is_dir() {
                pending.push(path);
            } else if name.ends_with(".gltf") || name.ends_with(".glb") {
                for time_seconds in [None, Some(0.5)] {
                    let start = Instant::now();
                    let outcome = import(&path, &ImportOptions { time_seconds, ..ImportOptions::default() });
                    if let Err(error) = outcome {
                        assert!(error.to_string().contains(&name), "{error} does not name {name}");
                    }
                    assert!(start.elapsed() < Duration::from_secs(10), "{name} took {:?}", start.elapsed());
                }
                count += 1;
            }
        }
    }
    assert!(count > 200, "{count} files only");
}

/// The same model as text and binary, plain, quantized, packed by Draco and by meshoptimizer, must fill the same space.
#[test]
fn variants_of_a_model_have_the_same_bounds() {
    const TOLERANCE: f64 = 0.01;
    let Some(folder) = shared("conformance") else { return };
    let table = fs_err::read_to_string(folder.join("expected.tsv")).unwrap();
    let mut first: Option<(String, glam::DVec3, glam::DVec3)> = None;
    let mut compared = 0;
    for file in table.lines().filter_map(|line| line.split('\t').next()) {
        let parts: Vec<&str> = file.split('/').collect();
        let model = match parts[..] {
            ["khronos-sample-assets", model, ..] => model.to_owned(),
            ["gltf-pipeline", "extensions", name, ..] if name.contains("meshopt") => "meshopt".to_owned(),
            _ => continue,
        };
        let scene = import(&folder.join(file), &ImportOptions::default()).unwrap().scene;
        let Some((low, high)) = scene.bounds() else { continue };
        match &first {
            Some((known, known_low, known_high)) if *known == model => {
                let tolerance = TOLERANCE * (*known_high - *known_low).max_element();
                let same = low.abs_diff_eq(*known_low, tolerance) && high.abs_diff_eq(*known_high, tolerance);
                assert!(same, "{file} fills {low} to {high}, another variant {known_low} to {known_high}");
                compared += 1;
            }
            _ => first = Some((model, low, high)),
        }
    }
    assert!(compared > 30, "{compared} pairs only");
}

/// Damages binary files in many places: whatever comes of it, the importer returns.
#[test]
fn damaged_files_are_refused_or_forgiven_in_bounded_time() {
    const MAX_BYTES: usize = 200_000;
    const DAMAGES_PER_FILE: u64 = 10;
    let Some(folder) = shared("conformance") else { return };
    let table = fs_err::read_to_string(folder.join("expected.tsv")).unwrap();
    let files =
        table.lines().filter_map(|line| line.split('\t').next()).filter(|file| file.ends_with(".glb"));
    let temporary = tempfile::tempdir().unwrap();
    let path = temporary.path().join("damaged.glb");
    let options =
        ImportOptions { time_seconds: Some(0.5), max_memory_bytes: 1 << 30, ..ImportOptions::default() };
    let mut state = 1_u64;
    let mut random = move |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    let mut count = 0;
    for file in files {
        let bytes = fs_err::read(folder.join(file)).unwrap();
        if bytes.len() > MAX_BYTES {
            continue;
        }
        for _ in 0..DAMAGES_PER_FILE {
            let mut damaged = bytes.clone();
            for _ in 0..1 + random(4) {
                let at = random(damaged.len());
                damaged[at] = random(256) as u8;
            }
            fs_err::write(&path, &damaged).unwrap();
            let start = Instant::now();
            let _either = import(&path, &options);
            assert!(start.elapsed() < Duration::from_secs(10), "{file} took {:?}", start.elapsed());
            count += 1;
        }
    }
    assert!(count > 300, "{count} damages only");
}

#[test]
fn real_scenes_draw_as_many_triangles_as_their_table_says() {
    let Some(folder) = shared("scenes") else { return };
    let table = fs_err::read_to_string(folder.join("README.md")).unwrap();
    let mut count = 0;
    for line in table.lines().filter(|line| line.contains(".glb |")) {
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        let digits: String =
            cells[4].chars().take_while(|c| *c != '(').filter(char::is_ascii_digit).collect();
        let start = Instant::now();
        let scene = import(&folder.join(cells[1]), &ImportOptions::default()).unwrap().scene;
        eprintln!(
            "{}: {} triangles, {} meshes, {} instances, {} materials, {} textures, {} lights, {} warnings in {:?}",
            cells[1],
            scene.drawn_triangles(),
            scene.meshes.len(),
            scene.instances.len(),
            scene.materials.len(),
            scene.textures.len(),
            scene.lights.len(),
            scene.warnings.len(),
            start.elapsed()
        );
        scene.warnings.iter().for_each(|warning| eprintln!("    {warning}"));
        assert_eq!(scene.drawn_triangles(), digits.parse::<u64>().unwrap(), "{}", cells[1]);
        if let Some(lights) = cells[6].split("lights ").nth(1) {
            let punctual: usize = lights.split([' ', '/']).next().unwrap().parse().unwrap();
            assert!(scene.lights.len() >= punctual, "{}: {} lights", cells[1], scene.lights.len());
        }
        count += 1;
    }
    assert!(count >= 10, "{count} scenes only");
}
