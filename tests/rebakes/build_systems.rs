//! The examples of `examples/build-systems`: make, ninja and cargo bake when a file has changed, and only then.
#![cfg(unix)]

use crate::workplace::Run;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::SystemTime;

/// A copy of the examples, to be edited.
struct Copy {
    folder: tempfile::TempDir,
}

fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

impl Copy {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut pending = vec![PathBuf::new()];
        while let Some(below) = pending.pop() {
            fs_err::create_dir_all(folder.path().join(&below)).unwrap();
            for entry in fs_err::read_dir(repository().join("examples/build-systems").join(&below)).unwrap() {
                let name = below.join(entry.unwrap().file_name());
                let from = repository().join("examples/build-systems").join(&name);
                if from.is_dir() {
                    pending.push(name);
                } else {
                    fs_err::copy(from, folder.path().join(name)).unwrap();
                }
            }
        }
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn run(&self, program: &str, arguments: &[&str]) -> Run {
        let cache = self.path("cache");
        let mut command = Command::new(program);
        command.current_dir(self.folder.path()).args(arguments).env("MANYVIEW_CACHE", cache);
        Run::of(&mut command).succeeded()
    }

    /// Replaces the column by a taller one: a change of the binary file alone.
    fn raise_the_columns(&self) {
        let mut bytes = fs_err::read(self.path("courtyard.bin")).unwrap();
        let old: Vec<u8> = 3f32.to_le_bytes().to_vec();
        let at: Vec<usize> =
            (0..bytes.len() - 4).step_by(4).filter(|&at| bytes[at..at + 4] == old[..]).collect();
        assert_eq!(at.len(), 4, "the upper corners of a column");
        at.iter().for_each(|&at| bytes[at..at + 4].copy_from_slice(&4f32.to_le_bytes()));
        fs_err::write(self.path("courtyard.bin"), bytes).unwrap();
    }

    /// Gives a file the time of now.
    fn touch(&self, name: &str) {
        let file = fs_err::OpenOptions::new().write(true).open(self.path(name)).unwrap();
        file.file().set_modified(SystemTime::now()).unwrap();
    }
}

/// Whether a program is installed; where it is not, says that its test shows nothing.
fn has(program: &str) -> bool {
    let is_there = Command::new(program).arg("--version").output().is_ok();
    if !is_there {
        eprintln!("SKIPPED: {program} is not installed, its example is not run");
    }
    is_there
}

/// Builds, builds again, edits a file that only the depfile names, touches it, and looks what happened each time.
fn check(copy: &Copy, mut build: impl FnMut() -> String) {
    let first = build();
    assert!(first.contains("bake") || first.contains("BAKE"), "{first}");
    let archive = fs_err::read(copy.path("courtyard.mvb")).unwrap();
    let again = build();
    assert!(!again.contains("steps:") && !again.contains("BAKE"), "nothing to do: {again}");
    copy.raise_the_columns();
    let changed = build();
    assert!(changed.contains("bake") || changed.contains("BAKE"), "{changed}");
    assert!(fs_err::read(copy.path("courtyard.mvb")).unwrap() != archive);
    // A new time alone: one look by the bake, which makes the archive as new as that, then rest.
    let archive = fs_err::read(copy.path("courtyard.mvb")).unwrap();
    copy.touch("courtyard.bin");
    build();
    assert!(fs_err::read(copy.path("courtyard.mvb")).unwrap() == archive);
    let rest = build();
    assert!(!rest.contains("steps:") && !rest.contains("BAKE"), "nothing to do: {rest}");
}

#[test]
fn make_bakes_what_has_changed() {
    if !has("make") {
        return;
    }
    let copy = Copy::new();
    check(&copy, || copy.run("make", &[&format!("MANYVIEW={}", env!("CARGO_BIN_EXE_manyview"))]).stdout);
    copy.run("make", &["clean"]);
    assert!(!copy.path("courtyard.mvb").exists());
}

#[test]
fn ninja_bakes_what_has_changed() {
    if !has("ninja") {
        return;
    }
    let copy = Copy::new();
    let rules = fs_err::read_to_string(copy.path("build.ninja")).unwrap();
    let program = format!("manyview = {}\n", env!("CARGO_BIN_EXE_manyview"));
    fs_err::write(copy.path("build.ninja"), rules.replace("manyview = manyview\n", &program)).unwrap();
    check(&copy, || copy.run("ninja", &[]).stdout);
}

#[test]
#[ignore = "compiles the library anew, for minutes"]
fn cargo_bakes_what_has_changed() {
    let copy = Copy::new();
    // The example names this repository by a relative path; everything else is as a user has it. The same versions of
    // other crates are used as here, which are on this machine.
    let manifest = fs_err::read_to_string(copy.path("cargo/Cargo.toml")).unwrap();
    let here = format!("path = \"{}/", repository().display());
    fs_err::write(copy.path("cargo/Cargo.toml"), manifest.replace("path = \"../../../", &here)).unwrap();
    fs_err::copy(repository().join("Cargo.lock"), copy.path("cargo/Cargo.lock")).unwrap();
    // Kept between runs of the tests: its dependencies take a minute.
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).join("build-systems");
    let run = || {
        let mut command = Command::new(env!("CARGO"));
        command.args(["run", "--offline"]).current_dir(copy.path("cargo")).env("CARGO_TARGET_DIR", &target);
        command.env_remove("RUSTFLAGS").env_remove("CARGO_ENCODED_RUSTFLAGS");
        Run::of(&mut command).succeeded()
    };
    let first = run();
    assert!(first.stdout.contains(" bytes, index "), "{}", first.stdout);
    let again = run();
    assert!(!again.stderr.contains("Compiling courtyard"), "nothing to do: {}", again.stderr);
    assert_eq!(again.stdout, first.stdout);
    copy.raise_the_columns();
    let changed = run();
    assert!(changed.stderr.contains("Compiling courtyard"), "{}", changed.stderr);
    assert!(changed.stdout != first.stdout, "another archive is in the program");
}
