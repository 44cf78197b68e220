//! A folder of its own for a test, and the program run in it.

use manyview_pipeline::glb::write_glb;
use manyview_pipeline::scene::Scene;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Settings that bake in a moment.
pub(crate) const SMALL: [&str; 8] =
    ["--levels", "6", "--rows", "32", "--directions", "latlong:6x6", "--backend", "cpu"];

/// How a command ended.
pub(crate) struct Run {
    /// Its exit code; `None` if a signal ended it.
    pub(crate) code: Option<i32>,
    /// What it printed.
    pub(crate) stdout: String,
    /// What it said besides.
    pub(crate) stderr: String,
}

impl Run {
    pub(crate) fn of(command: &mut Command) -> Self {
        let output = command.stdin(Stdio::null()).output().expect("the program starts");
        Self {
            code: output.status.code(),
            stdout: String::from_utf8(output.stdout).expect("stdout is text"),
            stderr: String::from_utf8(output.stderr).expect("stderr is text"),
        }
    }

    /// Fails the test unless the command succeeded.
    pub(crate) fn succeeded(self) -> Self {
        assert_eq!(self.code, Some(0), "{}", self.stderr);
        self
    }
}

/// A folder that the test has for itself.
pub(crate) struct Workplace {
    folder: tempfile::TempDir,
}

impl Workplace {
    pub(crate) fn new() -> Self {
        Self { folder: tempfile::tempdir().expect("a temporary folder") }
    }

    pub(crate) fn folder(&self) -> &Path {
        self.folder.path()
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder().join(name)
    }

    /// Writes a file and the folders above it.
    pub(crate) fn write(&self, name: &str, content: &[u8]) {
        let path = self.path(name);
        fs_err::create_dir_all(path.parent().expect("a file in the folder")).unwrap();
        fs_err::write(path, content).unwrap();
    }

    pub(crate) fn read(&self, name: &str) -> Vec<u8> {
        fs_err::read(self.path(name)).unwrap()
    }

    pub(crate) fn write_scene(&self, name: &str, scene: &Scene) {
        self.write(name, &glb(scene));
    }

    /// The program with this folder as current one, to be given arguments.
    pub(crate) fn command(&self) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_manyview"));
        command.current_dir(self.folder()).env_remove("MANYVIEW_LOG").env("MANYVIEW_CACHE", "");
        command
    }

    /// Runs the program here.
    pub(crate) fn run(&self, arguments: impl IntoIterator<Item = impl AsRef<OsStr>>) -> Run {
        Run::of(self.command().args(arguments))
    }

    /// Bakes a scene with [`SMALL`] settings and more arguments, and gives the archive's bytes.
    pub(crate) fn bake(&self, scene: &str, output: &str, arguments: &[&str]) -> Vec<u8> {
        self.run([&["bake", scene, "-o", output], &SMALL[..], arguments].concat()).succeeded();
        self.read(output)
    }

    /// The names of everything here, sorted; files in folders with their path.
    pub(crate) fn names(&self) -> Vec<String> {
        let mut names = Vec::new();
        let mut folders = vec![self.folder().to_owned()];
        while let Some(folder) = folders.pop() {
            for entry in fs_err::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    let name = path.strip_prefix(self.folder()).expect("below the folder");
                    names.push(name.to_str().expect("a name in UTF-8").to_owned());
                }
            }
        }
        names.sort();
        names
    }
}

/// A scene as the bytes of a `.glb`.
pub(crate) fn glb(scene: &Scene) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_glb(scene, &mut bytes).expect("a scene that can be written");
    bytes
}
