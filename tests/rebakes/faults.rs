//! Killed processes, flipped bits, full disks, many processes: the cache stays sound and the bytes stay right.
//!
//! `MANYVIEW_STRESS=20` does twenty times as much: 200 kills, 1,000 flips and so on.
#![cfg(unix)]

use crate::village::{SETTINGS, village};
use crate::workplace::{Run, Workplace};
use glam::DMat4;
use manyview_pipeline::generate::{SceneKind, generate};
use serde_json::Value;
use std::path::PathBuf;
use std::process::{Child, Stdio};
use std::time::Duration;

fn stress(usual: usize) -> usize {
    let factor = std::env::var("MANYVIEW_STRESS").ok().and_then(|factor| factor.parse::<usize>().ok());
    usual * factor.unwrap_or(1)
}

/// A generator of numbers (xorshift).
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }
}

fn workplace() -> Workplace {
    let work = Workplace::new();
    work.write_scene("scene.glb", &generate(SceneKind::Town, 4000, 3));
    work
}

fn spawn(work: &Workplace, scene: &str, output: &str) -> Child {
    let usual = ["bake", scene, "-o", output, "--cache", "cache", "--format", "json"];
    let mut command = work.command();
    command.args(usual).args(SETTINGS);
    command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap()
}

fn finish(child: Child) -> Value {
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    serde_json::from_slice(&output.stdout).unwrap()
}

fn clean(work: &Workplace, scene: &str) -> Vec<u8> {
    work.run([&["bake", scene, "-o", "clean.mvb", "--no-cache"], &SETTINGS[..]].concat()).succeeded();
    work.read("clean.mvb")
}

fn verify(work: &Workplace) -> Run {
    work.run(["cache", "verify", "--cache", "cache"])
}

#[test]
fn bakes_that_are_killed_at_any_moment_leave_a_sound_cache_and_the_next_goes_on() {
    let work = workplace();
    let expected = clean(&work, "scene.glb");
    let mut numbers = Numbers(7);
    let mut resumed = 0;
    for _ in 0..stress(10) {
        let mut victim = spawn(&work, "scene.glb", "out.mvb");
        std::thread::sleep(Duration::from_millis(numbers.next() % 400));
        victim.kill().unwrap();
        victim.wait().unwrap();
        // It may have been killed before it made a cache.
        if work.path("cache").exists() {
            verify(&work).succeeded();
        }
        if numbers.next().is_multiple_of(5) {
            // Now and then one may end, and the next begins with nothing.
            let summary = finish(spawn(&work, "scene.glb", "out.mvb"));
            resumed += summary["steps"]["reused"].as_u64().unwrap();
            assert!(work.read("out.mvb") == expected);
            fs_err::remove_dir_all(work.path("cache")).unwrap();
            fs_err::remove_file(work.path("out.mvb")).unwrap();
        }
    }
    finish(spawn(&work, "scene.glb", "out.mvb"));
    assert!(work.read("out.mvb") == expected);
    verify(&work).succeeded();
    assert!(!work.names().iter().any(|name| name.ends_with(".mvpart") || name.starts_with("cache/tmp/")));
    assert!(resumed > 0 || stress(1) == 1, "what was finished was reused");
}

#[test]
fn an_interrupted_bake_keeps_its_finished_steps() {
    use std::io::{BufRead as _, BufReader};
    let work = workplace();
    // Many rows: bricks and points are done when the interrupt comes.
    let arguments = ["--rows", "128", "--directions", "latlong:40x40", "--levels", "9", "--backend", "cpu"];
    let usual = ["bake", "scene.glb", "-o", "out.mvb", "--cache", "cache", "--format", "json"];
    let mut command = work.command();
    command.args(usual).args(arguments).stderr(Stdio::piped()).stdout(Stdio::null());
    let mut child = command.spawn().unwrap();
    let mut events = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    while !line.contains("\"rows\"") {
        line.clear();
        assert!(events.read_line(&mut line).unwrap() > 0, "the bake ended before its rows");
    }
    let kill = format!("kill -INT {}", child.id());
    Run::of(std::process::Command::new("sh").args(["-c", &kill])).succeeded();
    std::io::copy(&mut events, &mut std::io::sink()).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert!(!work.path("out.mvb").exists());
    let run = work.run([&usual[..], &arguments[..]].concat()).succeeded();
    let summary: Value = serde_json::from_str(&run.stdout).unwrap();
    let kinds = &summary["steps"]["kinds"];
    assert_eq!(
        (kinds["bricks"]["rebuilt"].as_u64(), kinds["points"]["rebuilt"].as_u64()),
        (Some(0), Some(0))
    );
}

/// All entries of the cache.
fn entries(work: &Workplace) -> Vec<PathBuf> {
    let is_entry = |name: &String| name.starts_with("cache/") && name.contains("-v");
    work.names().into_iter().filter(is_entry).map(|name| work.path(&name)).collect()
}

#[test]
fn every_flipped_bit_is_found_reported_and_rebuilt() {
    let work = workplace();
    let expected = clean(&work, "scene.glb");
    finish(spawn(&work, "scene.glb", "out.mvb"));
    let all = entries(&work);
    let mut numbers = Numbers(99);
    let mut flipped = 0;
    while flipped < stress(50) {
        // Some at a time, and each once.
        let mut chosen: Vec<&PathBuf> = Vec::new();
        for _ in 0..8 {
            let entry = &all[numbers.next() as usize % all.len()];
            if entry.exists() && !chosen.contains(&entry) {
                chosen.push(entry);
            }
        }
        for entry in &chosen {
            let mut bytes = fs_err::read(entry).unwrap();
            let bit = numbers.next() as usize % (bytes.len() * 8);
            bytes[bit / 8] ^= 1 << (bit % 8);
            fs_err::write(entry, bytes).unwrap();
        }
        flipped += chosen.len();
        if numbers.next().is_multiple_of(2) {
            let run = verify(&work);
            assert_eq!(run.code, Some(5), "{}", run.stdout);
            for entry in &chosen {
                let name = entry.file_name().unwrap().to_str().unwrap();
                assert!(run.stderr.contains(name), "{name} is not in {}", run.stderr);
            }
            assert_eq!(run.stderr.matches("broken and removed").count(), chosen.len());
        }
        _ = fs_err::remove_file(work.path("out.mvb"));
        let usual = ["bake", "scene.glb", "-o", "out.mvb", "--cache", "cache"];
        let run = work.run([&usual[..], &SETTINGS[..]].concat()).succeeded();
        assert!(work.read("out.mvb") == expected);
        // What the bake read of them, it has told of; nothing else is broken.
        for warning in run.stderr.lines().filter(|line| line.starts_with("warning")) {
            let known = |entry: &&&PathBuf| warning.contains(entry.file_name().unwrap().to_str().unwrap());
            assert!(warning.contains("is broken") && chosen.iter().any(|e| known(&e)), "{warning}");
        }
        // `latest` alone may be left broken by a bake that had no need of it: it is written anew by each.
        verify(&work).succeeded();
    }
}

#[test]
fn four_processes_share_one_cache_without_doing_anything_twice() {
    let work = workplace();
    let expected = clean(&work, "scene.glb");
    let first = finish(spawn(&work, "scene.glb", "alone.mvb"));
    let of = |summary: &Value, kind: &str| summary["steps"]["kinds"][kind]["rebuilt"].as_u64().unwrap_or(0);
    for _ in 0..stress(1) {
        fs_err::remove_dir_all(work.path("cache")).unwrap();
        let children: Vec<Child> =
            (0..4).map(|i| spawn(&work, "scene.glb", &format!("out{i}.mvb"))).collect();
        let summaries: Vec<Value> = children.into_iter().map(finish).collect();
        for kind in ["bricks", "attributes", "rows"] {
            let made: u64 = summaries.iter().map(|summary| of(summary, kind)).sum();
            assert_eq!(made, of(&first, kind), "{kind} made by all together");
        }
        for i in 0..4 {
            assert!(work.read(&format!("out{i}.mvb")) == expected, "process {i}");
        }
        verify(&work).succeeded();
    }
}

#[test]
fn processes_with_different_scenes_share_one_cache() {
    let work = Workplace::new();
    let scenes: Vec<String> = (0..4).map(|i| format!("{i}.glb")).collect();
    for (i, name) in scenes.iter().enumerate() {
        let mut scene = village();
        scene.instances[4].world_from_object *= DMat4::from_translation(glam::DVec3::X * i as f64);
        work.write_scene(name, &scene);
    }
    let expected: Vec<Vec<u8>> = scenes.iter().map(|name| clean(&work, name)).collect();
    for _ in 0..stress(1) {
        let children: Vec<Child> =
            scenes.iter().map(|name| spawn(&work, name, &format!("{name}.mvb"))).collect();
        // Housekeeping meanwhile takes nothing from them.
        while !work.path("cache/tmp").is_dir() {
            std::thread::sleep(Duration::from_millis(5));
        }
        work.run(["cache", "gc", "--max-size", "0", "--cache", "cache"]).succeeded();
        children.into_iter().for_each(|child| _ = finish(child));
        for (name, expected) in scenes.iter().zip(&expected) {
            assert!(work.read(&format!("{name}.mvb")) == *expected, "{name}");
        }
        verify(&work).succeeded();
        fs_err::remove_dir_all(work.path("cache")).unwrap();
    }
}

#[test]
fn a_full_disk_is_told_and_leaves_the_cache_sound() {
    let work = workplace();
    // A limit on file sizes gives an error in the middle of writing, as a full disk does. Units are 512 bytes.
    let bake = |limit: u32| {
        let program = env!("CARGO_BIN_EXE_manyview");
        let settings = SETTINGS.join(" ");
        let line = format!(
            "trap '' XFSZ; ulimit -f {limit}; exec '{program}' bake scene.glb -o out.mvb --cache cache {settings}"
        );
        Run::of(std::process::Command::new("sh").args(["-c", &line]).current_dir(work.folder()))
    };
    let run = bake(40);
    assert_eq!(run.code, Some(3), "{}", run.stderr);
    assert!(run.stderr.contains("out.mvb") && run.stderr.contains("free some space"), "{}", run.stderr);
    assert!(run.stderr.contains("stores nothing more"), "{}", run.stderr);
    assert!(!work.path("out.mvb").exists());
    verify(&work).succeeded();
    let run = bake(1 << 20).succeeded();
    assert!(run.stdout.contains("steps: ") && run.stdout.contains(", 0 failed"), "{}", run.stdout);
    assert!(work.read("out.mvb") == clean(&work, "scene.glb"));
}
