//! Whole bakes on the GPU against the same on the CPU: the archives must be equal byte for byte.
//!
//! Without an adapter every test is reported as ignored, or as failed if `MANYVIEW_REQUIRE_GPU` is 1.
//! `MANYVIEW_ADAPTER` chooses among adapters.

use libtest_mimic::{Arguments, Failed, Trial};
use manyview::gpu::{AdapterChoice, GpuDevice};
use manyview_pipeline::generate::{SceneKind, generate};
use manyview_pipeline::glb::write_glb;
use manyview_pipeline::triangles::Cutouts;
use manyview_shaders::device::VoxelDevice;
use std::path::Path;
use std::process::Command;

type Check = fn() -> Result<(), Failed>;

fn main() {
    let arguments = Arguments::from_args();
    let required = std::env::var("MANYVIEW_REQUIRE_GPU").is_ok_and(|value| value == "1");
    let reason = match GpuDevice::open(&AdapterChoice::from_env()) {
        Ok(device) => {
            eprintln!("adapter: {}", device.name());
            None
        }
        Err(error) => {
            eprintln!("no adapter: {error}");
            Some(error.to_string())
        }
    };
    let checks: [(&str, Check); 5] = [
        ("rows_from_points_equal_the_cpus", || gpu_equals_cpu(SceneKind::Town, &["--rows-from", "points"])),
        ("rows_from_rotation_equal_the_cpus", || {
            gpu_equals_cpu(SceneKind::Hairball, &["--rows-from", "rotate"])
        }),
        ("peeled_rows_of_masked_foliage_equal_the_cpus", || {
            gpu_equals_cpu(SceneKind::Forest, &["--rows-from", "peel"])
        }),
        ("paper_grids_and_other_sizes_equal_the_cpus", || {
            let arguments = ["--rows-from", "peel", "--grid", "cube", "--rows", "64", "--levels", "9"];
            gpu_equals_cpu(SceneKind::Park, &arguments)
        }),
        ("peeled_voxels_are_those_of_one_pass", peeled_voxels_are_those_of_one_pass),
    ];
    let trials = checks.map(|(name, check)| {
        let reason = reason.clone();
        Trial::test(name, move || match &reason {
            None => check(),
            Some(reason) => Err(format!("MANYVIEW_REQUIRE_GPU is 1, but {reason}").into()),
        })
    });
    let is_ignored = reason.is_some() && !required;
    let trials = trials.map(|trial| trial.with_ignored_flag(is_ignored)).into();
    libtest_mimic::run(&arguments, trials).exit();
}

fn write_scene(folder: &Path, kind: SceneKind) -> Result<(), Failed> {
    let scene = generate(kind, 2000, 11);
    let has_masks = !Cutouts::new(&scene).masks.is_empty();
    if kind == SceneKind::Forest && !has_masks {
        return Err("the forest has no cut-out leaves".into());
    }
    let mut bytes = Vec::new();
    write_glb(&scene, &mut bytes)?;
    Ok(fs_err::write(folder.join("scene.glb"), bytes)?)
}

/// Bakes the folder's scene on a backend and gives the archive.
fn bake(folder: &Path, backend: &str, arguments: &[&str]) -> Result<Vec<u8>, Failed> {
    let mut all =
        vec!["bake", "scene.glb", "-o", "out.mvb", "--backend", backend, "--directions", "latlong:5x5"];
    for default in [["--levels", "7"], ["--rows", "32"]] {
        if !arguments.contains(&default[0]) {
            all.extend(default);
        }
    }
    all.extend(arguments);
    let output = Command::new(env!("CARGO_BIN_EXE_manyview"))
        .env("MANYVIEW_CACHE", "")
        .current_dir(folder)
        .args(&all)
        .output()?;
    if !output.status.success() {
        return Err(format!("{all:?}: {}", String::from_utf8_lossy(&output.stderr)).into());
    }
    Ok(fs_err::read(folder.join("out.mvb"))?)
}

fn gpu_equals_cpu(kind: SceneKind, arguments: &[&str]) -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    write_scene(folder.path(), kind)?;
    let on_cpu = bake(folder.path(), "cpu", arguments)?;
    if bake(folder.path(), "gpu", arguments)? != on_cpu {
        return Err(format!("{kind} with {arguments:?}: the archives differ").into());
    }
    Ok(())
}

fn peeled_voxels_are_those_of_one_pass() -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    write_scene(folder.path(), SceneKind::Forest)?;
    let once = bake(folder.path(), "cpu", &["--rows", "0"])?;
    if bake(folder.path(), "gpu", &["--rows", "0", "--voxels-from", "peel"])? != once {
        return Err("the archives differ".into());
    }
    Ok(())
}
