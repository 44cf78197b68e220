//! Who is there: locks on files that the system takes back when a process ends, however it ends.

use std::fs::TryLockError;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::SystemTime;

use fs_err::{File, OpenOptions};

/// A process that uses a store: a locked file in `leases`.
pub(super) struct Lease {
    path: PathBuf,
    name: String,
    /// Holds the lock.
    _file: File,
}

impl Lease {
    pub(super) fn take(root: &Path) -> io::Result<Self> {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        loop {
            let name = format!("{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
            let path = root.join("leases").join(&name);
            let file = match OpenOptions::new().write(true).create_new(true).open(&path) {
                // Of a process with our number, on another machine or long gone.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
                other => other?,
            };
            lock(&file);
            // Another process may have taken it for stale before it was locked.
            if path.exists() {
                return Ok(Self { path, name, _file: file });
            }
        }
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        _ = fs_err::remove_file(&self.path);
    }
}

/// Locks a file that nobody else knows of yet. Where there are no locks, nobody can tell that it is stale either.
fn lock(file: &File) {
    while file.file().lock().is_err_and(|error| error.kind() == io::ErrorKind::Interrupted) {}
}

/// Removes the leases and unfinished entries of processes that are gone. Housekeeping: what fails is left for later.
pub(super) fn remove_stale(root: &Path) {
    let mut stale = Vec::new();
    for path in files_in(&root.join("leases")) {
        if let Some(_lock) = lock_of_nobody(&path) {
            stale.extend(path.file_name().and_then(|name| name.to_str()).map(str::to_owned));
            _ = fs_err::remove_file(&path);
        }
    }
    for path in files_in(&root.join("claims")) {
        if let Some(_lock) = lock_of_nobody(&path) {
            _ = fs_err::remove_file(&path);
        }
    }
    if stale.is_empty() {
        return;
    }
    for path in files_in(&root.join("tmp")) {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        if name.rsplit_once('-').is_some_and(|(owner, _)| stale.iter().any(|lease| lease == owner)) {
            _ = fs_err::remove_file(&path);
        }
    }
}

/// When the longest-living other process took its lease, if there is one.
pub(super) fn oldest_other(root: &Path, own: &Lease) -> Option<SystemTime> {
    let taken = |path: PathBuf| fs_err::metadata(path).and_then(|metadata| metadata.modified()).ok();
    others(root, own).filter_map(taken).min()
}

/// How many other processes there are.
pub(super) fn count_others(root: &Path, own: &Lease) -> usize {
    others(root, own).count()
}

fn others(root: &Path, own: &Lease) -> impl Iterator<Item = PathBuf> {
    let leases = files_in(&root.join("leases")).into_iter().filter(|path| *path != own.path);
    leases.filter(|path| lock_of_nobody(path).is_none())
}

/// Locks a file that no process holds; `None` if one does, or if that cannot be told.
fn lock_of_nobody(path: &Path) -> Option<File> {
    let file = OpenOptions::new().write(true).open(path).ok()?;
    file.file().try_lock().ok()?;
    Some(file)
}

fn files_in(folder: &Path) -> Vec<PathBuf> {
    let entries = fs_err::read_dir(folder).into_iter().flatten().flatten();
    let mut files: Vec<_> = entries.map(|entry| entry.path()).collect();
    files.sort();
    files
}

/// Which process makes a value. A claim ends when it is dropped, or when its process ends.
pub enum Claim {
    /// This one, while the claim is kept. The value may be there by now: look again.
    Mine(ClaimGuard),
    /// Another one is at work: do something else first, then look again.
    Theirs,
    /// Claims do not work here (no locks, no permission): just make it.
    Unknown,
}

/// Keeps a claim.
pub struct ClaimGuard {
    path: PathBuf,
    _file: File,
}

impl Claim {
    pub(super) fn take(path: &Path) -> Self {
        loop {
            let Ok(file) = OpenOptions::new().write(true).create(true).truncate(false).open(path) else {
                return Self::Unknown;
            };
            match file.file().try_lock() {
                Ok(()) if is_at(&file, path) => {
                    return Self::Mine(ClaimGuard { path: path.to_owned(), _file: file });
                }
                // Its last owner removed it between our opening and our lock.
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => return Self::Theirs,
                Err(TryLockError::Error(_)) => return Self::Unknown,
            }
        }
    }
}

impl Drop for ClaimGuard {
    fn drop(&mut self) {
        // First the name, then the lock, which goes with the handle.
        _ = fs_err::remove_file(&self.path);
    }
}

/// Whether an open file is still the one that its path names.
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let same = |a: &std::fs::Metadata, b: &std::fs::Metadata| (a.dev(), a.ino()) == (b.dev(), b.ino());
    matches!((file.file().metadata(), fs_err::metadata(path)), (Ok(a), Ok(b)) if same(&a, &b))
}

/// Elsewhere open files cannot be removed from under their path.
#[cfg(not(unix))]
fn is_at(_: &File, path: &Path) -> bool {
    path.exists()
}
