//! What a measurement ran on.

use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Machine, program and command of a measurement: what its figures depend on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunInfo {
    /// Model of the processor.
    pub cpu: String,
    /// Threads in use.
    pub threads: usize,
    /// The GPU adapter with its backend and driver, if one was used.
    pub adapter: Option<String>,
    /// The repository's commit, where the program runs inside of one.
    pub commit: Option<String>,
    /// Version and profile of the program.
    pub version: String,
    /// The command that was run.
    pub command: String,
}

impl RunInfo {
    /// Looks around.
    pub fn gather(command: String, adapter: Option<String>) -> Self {
        let profile = if cfg!(debug_assertions) { "debug" } else { "release" };
        Self {
            cpu: cpu_model(),
            threads: rayon::current_num_threads(),
            adapter,
            commit: std::env::current_dir().ok().and_then(|folder| commit_of(&folder)),
            version: format!("{} ({profile})", env!("CARGO_PKG_VERSION")),
            command,
        }
    }

    /// As an object.
    pub fn json(&self) -> Value {
        json!({
            "cpu": self.cpu,
            "threads": self.threads,
            "adapter": self.adapter,
            "commit": self.commit,
            "version": self.version,
            "command": self.command,
        })
    }

    /// In a sentence.
    pub fn text(&self) -> String {
        let adapter = self.adapter.as_deref().map_or(String::new(), |name| format!(", {name}"));
        let commit = self.commit.as_deref().map_or("unknown", |commit| &commit[..commit.len().min(12)]);
        let Self { cpu, threads, version, command, .. } = self;
        format!("{cpu}, {threads} threads{adapter}; manyview {version}, commit {commit}; `{command}`")
    }
}

fn cpu_model() -> String {
    let listed = fs_err::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = listed.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    model.map_or_else(|| std::env::consts::ARCH.to_owned(), |(_, name)| name.trim().to_owned())
}

/// The commit that is checked out in the repository around `folder`.
fn commit_of(folder: &Path) -> Option<String> {
    let git = folder.ancestors().map(|folder| folder.join(".git")).find(|path| path.exists())?;
    // In a worktree it is a file that names the folder.
    let git = match fs_err::read_to_string(&git) {
        Ok(text) => PathBuf::from(text.strip_prefix("gitdir:")?.trim()),
        Err(_) => git,
    };
    let head = fs_err::read_to_string(git.join("HEAD")).ok()?;
    let Some(reference) = head.trim().strip_prefix("ref: ") else { return Some(head.trim().to_owned()) };
    let common = fs_err::read_to_string(git.join("commondir"));
    let common = common.map_or(git.clone(), |path| git.join(path.trim()));
    let loose = [&git, &common].into_iter().find_map(|git| fs_err::read_to_string(git.join(reference)).ok());
    let packed = || {
        let packed = fs_err::read_to_string(common.join("packed-refs")).ok()?;
        packed.lines().find_map(|line| line.strip_suffix(reference).map(str::to_owned))
    };
    loose.or_else(packed).map(|commit| commit.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_commit_is_found_in_a_repository_and_in_a_worktree_of_it() {
        let folder = tempfile::tempdir().unwrap();
        let write = |path: &str, text: &str| {
            let path = folder.path().join(path);
            fs_err::create_dir_all(path.parent().unwrap()).unwrap();
            fs_err::write(path, text).unwrap();
        };
        write("main/.git/HEAD", "ref: refs/heads/main\n");
        write("main/.git/refs/heads/main", "abc\n");
        write("main/.git/packed-refs", "# pack-refs\n123 refs/heads/side\n");
        write("main/.git/worktrees/side/HEAD", "ref: refs/heads/side\n");
        write("main/.git/worktrees/side/commondir", "../..\n");
        write("main/src/x", "");
        let git = folder.path().join("main/.git/worktrees/side");
        write("side/.git", &format!("gitdir: {}\n", git.display()));
        write("detached/.git/HEAD", "789\n");
        let commit = |path: &str| commit_of(&folder.path().join(path));
        assert_eq!(commit("main/src").as_deref(), Some("abc"));
        assert_eq!(commit("side").as_deref(), Some("123"));
        assert_eq!(commit("detached").as_deref(), Some("789"));
    }

    #[test]
    fn a_run_tells_what_it_ran_on() {
        let info = RunInfo::gather("manyview bench".to_owned(), Some("lavapipe".to_owned()));
        assert!(!info.cpu.is_empty() && info.threads > 0);
        assert!(info.text().contains("lavapipe") && info.json()["command"] == "manyview bench");
    }
}
