//! Ctrl-C and sudden death: never a half-written archive, never a lost one.
#![cfg(unix)]

use crate::workplace::{Run, SMALL, Workplace};
use manyview_pipeline::generate::{SceneKind, generate};
use std::io::{BufRead as _, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Takes minutes if nobody stops it: every direction from the triangles, at 256³.
const LONG: [&str; 12] = [
    "bake",
    "scene.glb",
    "-o",
    "out.mvb",
    "--backend",
    "cpu",
    "--levels",
    "8",
    "--rows",
    "256",
    "--rows-from",
    "peel",
];

/// How many bakes are killed at random moments; a few unless it is set.
const KILLS_VARIABLE: &str = "MANYVIEW_TEST_KILLS";

fn workplace() -> Workplace {
    let work = Workplace::new();
    work.write_scene("scene.glb", &generate(SceneKind::Park, 20_000, 2));
    work
}

fn interrupt(child: &Child) {
    let kill = format!("kill -INT {}", child.id());
    Run::of(Command::new("sh").args(["-c", &kill])).succeeded();
}

/// Starts the long bake and waits until it begins `step`.
fn start_until(work: &Workplace, step: &str) -> (Child, BufReader<std::process::ChildStderr>) {
    let mut child =
        work.command().args(LONG).args(["--format", "json"]).stderr(Stdio::piped()).spawn().unwrap();
    let mut events = BufReader::new(child.stderr.take().expect("piped"));
    let mut line = String::new();
    while !line.contains(&format!("\"{step}\"")) {
        line.clear();
        assert!(events.read_line(&mut line).unwrap() > 0, "the bake ended before {step}");
    }
    (child, events)
}

#[test]
fn an_interrupt_ends_the_bake_and_leaves_nothing() {
    for (step, old) in [("octree", None), ("rows", None), ("rows", Some(b"an older archive"))] {
        let work = workplace();
        if let Some(old) = old {
            work.write("out.mvb", old);
        }
        let before = work.names();
        let (mut child, mut events) = start_until(&work, step);
        assert!(work.names().iter().any(|name| name.ends_with(".mvpart")), "{step}: work in progress");
        interrupt(&child);
        let clock = Instant::now();
        let mut rest = String::new();
        std::io::Read::read_to_string(&mut events, &mut rest).unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(130), "{step}: {rest}");
        assert!(clock.elapsed() < Duration::from_secs(20), "{step}: {:?} to stop", clock.elapsed());
        assert!(rest.contains("cancelled"), "{step}: {rest}");
        assert_eq!(work.names(), before, "{step}");
        if let Some(old) = old {
            assert_eq!(work.read("out.mvb"), old, "{step}");
        }
    }
}

#[test]
fn an_interrupt_of_a_scene_in_the_making_leaves_nothing() {
    for milliseconds in [0, 500] {
        let work = Workplace::new();
        let arguments = ["scene", "city", "--triangles", "20000000", "-o", "city.glb"];
        let mut child = work.command().args(arguments).stderr(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        let mut lines = BufReader::new(child.stderr.take().expect("piped"));
        assert!(lines.read_line(&mut line).unwrap() > 0, "it says what it is about to do");
        std::thread::sleep(Duration::from_millis(milliseconds));
        interrupt(&child);
        assert_eq!(child.wait().unwrap().code(), Some(130), "after {milliseconds} ms");
        assert_eq!(work.names(), [""; 0], "after {milliseconds} ms");
    }
}

#[test]
fn a_killed_bake_loses_nothing_and_the_next_one_cleans_up() {
    let work = workplace();
    let expected = work.bake("scene.glb", "expected.mvb", &[]);
    let mut left_a_part = 0;
    let kills = std::env::var(KILLS_VARIABLE).map_or(6, |count| count.parse().expect("a number"));
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    for kill in 0..kills {
        // The first moments are spread evenly from the start into the rows, the others random between them.
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let milliseconds = if kill < 6 { [0, 20, 90, 250, 600, 1100][kill] } else { (state >> 40) % 1200 };
        work.write("out.mvb", b"an older archive");
        let mut child = work.command().args(LONG).stderr(Stdio::null()).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(milliseconds));
        child.kill().unwrap();
        child.wait().unwrap();
        assert_eq!(work.read("out.mvb"), b"an older archive", "killed after {milliseconds} ms");
        left_a_part += work.names().iter().filter(|name| name.ends_with(".mvpart")).count();
        assert!(work.bake("scene.glb", "out.mvb", &[]) == expected, "after a kill at {milliseconds} ms");
        assert_eq!(work.names(), ["expected.mvb", "out.mvb", "scene.glb"], "{milliseconds} ms");
    }
    eprintln!("{kills} kills, {left_a_part} of them left a part to clean up");
    assert!(left_a_part > 0, "no kill came while there was something to clean up");
}

#[test]
fn two_bakes_of_one_output_do_not_disturb_each_other() {
    let work = workplace();
    let expected = work.bake("scene.glb", "expected.mvb", &[]);
    let arguments = [&["bake", "scene.glb", "-o", "out.mvb"], &SMALL[..]].concat();
    let spawn =
        || work.command().args(&arguments).stderr(Stdio::null()).stdout(Stdio::null()).spawn().unwrap();
    for mut child in [spawn(), spawn()] {
        assert!(child.wait().unwrap().success());
    }
    assert!(work.read("out.mvb") == expected);
    assert_eq!(work.names(), ["expected.mvb", "out.mvb", "scene.glb"]);
}
