//! What happens to files around a bake: folders that may not be written, other file systems, scenes that change.
#![cfg(unix)]

use crate::workplace::{Run, SMALL, Workplace, glb};
use manyview_pipeline::generate::{SceneKind, generate};
use std::os::unix::fs::PermissionsExt;
use std::sync::atomic::{AtomicBool, Ordering};

fn park(seed: u64) -> Vec<u8> {
    glb(&generate(SceneKind::Park, 3_000, seed))
}

#[test]
fn a_folder_that_may_not_be_written_is_named_and_left_alone() {
    use std::os::unix::process::CommandExt as _;
    const NOBODY: u32 = 65534;
    let work = Workplace::new();
    work.write("scene.glb", &park(1));
    work.write("shut/out.mvb", b"an older archive");
    // Root may write anywhere, so that the program then runs as nobody; from here, where nobody may read it.
    let is_root = std::os::unix::fs::MetadataExt::uid(&fs_err::metadata(work.folder()).unwrap()) == 0;
    fs_err::copy(env!("CARGO_BIN_EXE_manyview"), work.path("manyview")).unwrap();
    let allow = |name: &str, mode| {
        fs_err::set_permissions(work.path(name), PermissionsExt::from_mode(mode)).unwrap();
    };
    allow("", 0o755);
    allow("shut", 0o555);
    let before = work.names();
    for output in ["shut/out.mvb", "shut/new.mvb"] {
        let mut command = std::process::Command::new(work.path("manyview"));
        if is_root {
            command.uid(NOBODY).gid(NOBODY);
        }
        command.current_dir(work.folder()).args(["bake", "scene.glb", "-o", output]).args(SMALL);
        let run = Run::of(&mut command);
        assert_eq!(run.code, Some(3), "{}", run.stderr);
        for needle in [output, "the folder must be writable"] {
            assert!(run.stderr.contains(needle), "no `{needle}` in: {}", run.stderr);
        }
        assert_eq!(work.names(), before);
        assert_eq!(work.read("shut/out.mvb"), b"an older archive");
    }
    allow("shut", 0o755);
}

#[test]
fn the_output_may_lie_on_another_file_system() {
    let Ok(there) = tempfile::tempdir_in("/dev/shm") else {
        eprintln!("there is no /dev/shm: nothing is tested");
        return;
    };
    let work = Workplace::new();
    work.write("scene.glb", &park(1));
    let expected = work.bake("scene.glb", "here.mvb", &[]);
    let output = there.path().join("there.mvb");
    for _ in 0..2 {
        work.run([&["bake", "scene.glb", "-o", output.to_str().unwrap()], &SMALL[..]].concat()).succeeded();
        assert!(fs_err::read(&output).unwrap() == expected);
        assert_eq!(fs_err::read_dir(there.path()).unwrap().count(), 1, "the archive alone");
    }
}

/// Somebody saves the scene again and again, by writing over it and by renaming into place. A bake is of one version or
/// of the other, or says that it could not read a whole one.
#[test]
fn a_scene_that_changes_is_baked_as_one_version_or_refused() {
    let work = Workplace::new();
    let versions = [park(1), park(2)];
    let expected = versions.each_ref().map(|version| {
        work.write("scene.glb", version);
        work.bake("scene.glb", "expected.mvb", &[])
    });
    assert!(expected[0] != expected[1]);
    for renames in [true, false] {
        let done = AtomicBool::new(false);
        let (mut baked, mut refused) = (0, 0);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                for version in versions.iter().cycle() {
                    if done.load(Ordering::Relaxed) {
                        break;
                    }
                    if renames {
                        work.write("next.glb", version);
                        fs_err::rename(work.path("next.glb"), work.path("scene.glb")).unwrap();
                    } else {
                        work.write("scene.glb", version);
                    }
                    std::thread::sleep(std::time::Duration::from_millis(3));
                }
            });
            for _ in 0..15 {
                work.write("out.mvb", b"an older archive");
                let run = work.run([&["bake", "scene.glb", "-o", "out.mvb"], &SMALL[..]].concat());
                let output = work.read("out.mvb");
                match run.code {
                    Some(0) => {
                        baked += 1;
                        // The names of files in messages aside, an archive is of its scene alone.
                        assert!(expected.contains(&output), "a bake of neither version");
                    }
                    code => {
                        refused += 1;
                        assert_eq!(code, Some(3), "{}", run.stderr);
                        assert!(run.stderr.contains("scene.glb"), "{}", run.stderr);
                        assert_eq!(output, b"an older archive");
                    }
                }
            }
            done.store(true, Ordering::Relaxed);
        });
        eprintln!("renames {renames}: {baked} baked, {refused} refused");
        assert!(baked > 0 || !renames, "{refused} refused");
        assert!(!work.names().iter().any(|name| name.ends_with(".mvpart")));
    }
}

/// A file system of its own for a script, which alone sees it; `None` where that is not allowed. The script finds it as
/// the folder `disk`, of `size` until it calls `grow`.
#[cfg(target_os = "linux")]
fn on_a_small_disk(work: &Workplace, size: &str, script: &str) -> Option<Run> {
    fs_err::create_dir_all(work.path("disk")).unwrap();
    let script = format!(
        "mount -t tmpfs -o size={size} tmpfs disk || exit 99
         grow() {{ mount -o remount,size=64m disk; }}
         bake() {{ '{}' bake scene.glb {} \"$@\"; }}
         {script}",
        env!("CARGO_BIN_EXE_manyview"),
        SMALL.join(" "),
    );
    let mut command = std::process::Command::new("unshare");
    command.args(["--map-root-user", "--mount", "sh", "-c", &script]).current_dir(work.folder());
    let run = Run::of(command.env("MANYVIEW_CACHE", ""));
    let is_allowed = run.code != Some(99) && !run.stderr.starts_with("unshare:");
    if !is_allowed {
        eprintln!("no small disk can be mounted: nothing is tested\n{}", run.stderr);
    }
    is_allowed.then_some(run)
}

#[cfg(target_os = "linux")]
#[test]
fn a_disk_that_fills_up_keeps_the_older_archive() {
    let work = Workplace::new();
    work.write("scene.glb", &park(1));
    let expected = work.bake("scene.glb", "expected.mvb", &[]);
    let pages = expected.len() / 4096;
    assert!(pages > 3, "{pages} pages");
    let script = "printf 'an older archive' > disk/out.mvb
        bake -o disk/out.mvb 2> said; code=$?
        cat disk/out.mvb > kept; ls -A disk > names
        grow; bake -o disk/out.mvb > /dev/null; cat disk/out.mvb > again
        exit $code";
    for size in [2, pages / 2, pages] {
        let Some(run) = on_a_small_disk(&work, &format!("{}k", size * 4), script) else { return };
        let said = String::from_utf8(work.read("said")).unwrap();
        assert_eq!(run.code, Some(3), "{said}");
        assert!(said.contains("disk/out.mvb") && said.contains("free some space"), "{said}");
        assert_eq!(work.read("kept"), b"an older archive");
        assert_eq!(work.read("names"), b"out.mvb\n");
        assert!(work.read("again") == expected);
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_disk_that_fills_up_costs_the_cache_but_not_the_bake() {
    let work = Workplace::new();
    work.write("scene.glb", &park(1));
    work.bake("scene.glb", "expected.mvb", &[]);
    let script = format!(
        "bake -o out.mvb --cache disk 2> said || exit 1
         cmp out.mvb expected.mvb && '{0}' cache verify --cache disk || exit 1
         grow; bake -o again.mvb --cache disk && cmp again.mvb expected.mvb && '{0}' cache verify --cache disk",
        env!("CARGO_BIN_EXE_manyview")
    );
    for size in ["8k", "32k", "64k"] {
        let Some(run) = on_a_small_disk(&work, size, &script) else { return };
        assert_eq!(run.code, Some(0), "{size}: {}{}", run.stdout, run.stderr);
        let said = String::from_utf8(work.read("said")).unwrap();
        assert!(said.contains("stores nothing more"), "{size}: {said}");
    }
}
