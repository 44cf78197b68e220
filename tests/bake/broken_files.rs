//! The broken scenes of others through the real binary. They are not part of the repository; where their folder is
//! missing, this passes without having tested anything, and says so.
#![cfg(target_os = "linux")]

use crate::workplace::{Run, SMALL, Workplace};
use std::path::{Path, PathBuf};

/// Every scene below `folder`.
fn scenes(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs_err::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            scenes(&path, found);
        } else if path.extension().is_some_and(|ending| ending == "gltf" || ending == "glb") {
            found.push(path);
        }
    }
}

#[test]
fn broken_scenes_exit_with_0_or_3_within_a_gibibyte() {
    let roots = match std::env::var_os("MANYVIEW_SHARED") {
        Some(root) => vec![PathBuf::from(root)],
        None => Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().take(2).map(|a| a.join("shared")).collect(),
    };
    let Some(folder) = roots.iter().map(|root| root.join("conformance/invalid")).find(|f| f.is_dir()) else {
        eprintln!("shared/conformance/invalid is not there: nothing is tested");
        return;
    };
    let mut paths = Vec::new();
    scenes(&folder, &mut paths);
    assert!(paths.len() > 200, "{} only", paths.len());
    let work = Workplace::new();
    let program = env!("CARGO_BIN_EXE_manyview");
    // Address space, so that memory that is merely asked for counts; five seconds of processor time.
    let script = format!("ulimit -v 1048576; ulimit -t 5; exec '{program}' \"$@\"");
    let (mut baked, mut refused) = (0, 0);
    for path in paths {
        let arguments =
            [&["bake", path.to_str().unwrap(), "-o", "out.mvb", "--jobs", "2"], &SMALL[..]].concat();
        let mut shell = std::process::Command::new("sh");
        shell.args(["-c", &script, "sh"]).args(arguments).current_dir(work.folder());
        let run = Run::of(shell.env("RAYON_NUM_THREADS", "2"));
        match run.code {
            Some(0) => baked += 1,
            Some(3) => {
                refused += 1;
                let name = path.file_name().unwrap().to_str().unwrap();
                assert!(run.stderr.contains(name), "{} is not named: {}", path.display(), run.stderr);
            }
            code => panic!("{}: {code:?}: {}", path.display(), run.stderr),
        }
        assert!(!work.names().iter().any(|name| name.ends_with(".mvpart")));
    }
    eprintln!("{baked} forgiven, {refused} refused");
}
