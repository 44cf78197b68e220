//! `bake --watch`: bakes again when a file changes.
//!
//! Files are looked at ten times a second: their time, size and identity. That works on every file system, for files
//! that editors replace, and for files that are not there yet. Whether their content has changed, the bake sees by
//! itself. Outputs are no inputs, so a bake never wakes itself.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant, SystemTime};

use serde_json::json;

use super::super::Format;
use super::super::cancel;
use super::super::error::{CliResult, Exit};
use super::{Options, Outcome, run_once};

/// Between two looks.
const INTERVAL: Duration = Duration::from_millis(100);
/// Exporters write several files, in several goes: a bake begins when nothing has changed for so long.
const QUIET: Duration = Duration::from_millis(300);

/// What a look at a file sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Look {
    changed: Option<SystemTime>,
    bytes: u64,
    identity: u64,
}

/// `None` for a file that is not there.
fn look(path: &Path) -> Option<Look> {
    let metadata = fs_err::metadata(path).ok()?;
    #[cfg(unix)]
    let identity = std::os::unix::fs::MetadataExt::ino(&metadata);
    #[cfg(not(unix))]
    let identity = 0;
    Some(Look { changed: metadata.modified().ok(), bytes: metadata.len(), identity })
}

/// Bakes, waits for a change, and so on.
pub(super) fn run(options: &Options) -> CliResult {
    let is_cancelled = || cancel::watch().load(Ordering::Relaxed);
    let mut inputs = BTreeSet::new();
    loop {
        // Looked at before the bake reads them: what changes meanwhile is seen after it.
        let mut seen: Vec<(PathBuf, Option<Look>)> = looks(&inputs);
        let Outcome { result, inputs: found } = run_once(options);
        if is_cancelled() {
            return Ok(Exit::Cancelled);
        }
        match &result {
            Ok(()) => inputs = found.into_iter().collect(),
            // A scene that is broken now may name its files again soon.
            Err(error) => {
                error.tell(options.format);
                inputs.extend(found);
            }
        }
        let new: BTreeSet<PathBuf> =
            inputs.iter().filter(|path| seen.iter().all(|(known, _)| known != *path)).cloned().collect();
        seen.retain(|(path, _)| inputs.contains(path));
        seen.extend(looks(&new));
        tell(options.format, "watching", seen.iter().map(|(path, _)| path.as_path()));
        let changed = loop {
            std::thread::sleep(INTERVAL);
            if is_cancelled() {
                return Ok(Exit::Cancelled);
            }
            let changed: Vec<&PathBuf> =
                seen.iter().filter(|(path, before)| look(path) != *before).map(|(path, _)| path).collect();
            if !changed.is_empty() {
                break changed;
            }
        };
        tell(options.format, "changed", changed.iter().map(|path| path.as_path()));
        wait_until_quiet(&inputs, is_cancelled);
    }
}

fn looks(paths: &BTreeSet<PathBuf>) -> Vec<(PathBuf, Option<Look>)> {
    paths.iter().map(|path| (path.clone(), look(path))).collect()
}

fn wait_until_quiet(paths: &BTreeSet<PathBuf>, is_cancelled: impl Fn() -> bool) {
    let mut last = looks(paths);
    let mut since = Instant::now();
    while since.elapsed() < QUIET && !is_cancelled() {
        std::thread::sleep(INTERVAL / 2);
        let now = looks(paths);
        if now != last {
            (last, since) = (now, Instant::now());
        }
    }
}

fn tell<'p>(format: Format, event: &str, paths: impl Iterator<Item = &'p Path>) {
    let paths: Vec<String> = paths.map(|path| path.display().to_string()).collect();
    match format {
        Format::Json => eprintln!("{}", json!({ "event": event, "files": paths })),
        Format::Text => eprintln!("{event:>12}  {}", paths.join(", ")),
    }
}
