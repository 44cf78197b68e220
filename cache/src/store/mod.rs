//! The store: results of steps under the digests of what they were made from, shared by any number of processes.
//!
//! # What is where
//! A store is a folder. Each kind of value has a *bucket*, a folder named after the kind and the version of its format;
//! a change of one format bumps one version, and the other buckets stay warm. Drawn from a real run:
//!
//! ```text
//! ~/.cache/manyview/
//! ├── CACHEDIR.TAG                      backup programs leave this folder out
//! ├── rows-v2/
//! │   ├── 3c/
//! │   │   └── 3c0f…(64 digits)          one value: header, content
//! │   └── e1/
//! │       └── e17a…
//! ├── octree-cells-v1/
//! │   └── …
//! ├── claims/
//! │   └── 9f2b…                         locked by the process that is making this value now
//! ├── leases/
//! │   └── 4711-0                        locked by process 4711 as long as it lives
//! └── tmp/
//!     └── 4711-0-17                     a value that process 4711 is writing
//! ```
//!
//! # An entry
//!
//! | offset | size | field |
//! |---|---|---|
//! | 0 | 8 | magic: `89 4d 56 45 0d 0a 1a 0a` (`\x89MVE\r\n\x1a\n`) |
//! | 8 | 4 | version of this header: 1 |
//! | 12 | 4 | reserved, 0 |
//! | 16 | 8 | size of the content |
//! | 24 | 32 | BLAKE3 of key and content, so that an entry under another's name is no entry |
//! | 56 | … | the content, to the end of the file |
//!
//! # Rules
//! - An entry is written to `tmp`, synced and renamed: it is there completely or not at all.
//! - A broken entry is a warning and a miss; it is removed, and whoever needs it makes it anew.
//! - Any entry may go at any time; that is a miss, never an error. So nothing needs a lock to read.
//! - Locks are the system's own locks on files (`lease`): a killed process leaves none.
//! - A store that cannot be written (full disk, no permission) makes bakes slower, not wrong.

mod entry;
mod housekeeping;
mod lease;
#[cfg(test)]
mod tests;

pub use housekeeping::{BucketStat, GcReport, StoreStat, VerifyReport};
pub use lease::{Claim, ClaimGuard};

use std::fmt;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::SystemTime;

use crate::atomic::advice;
use crate::digest::Digest;
use lease::Lease;

/// A kind of value, and the version of its format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Bucket {
    /// Lower-case letters and dashes.
    pub name: &'static str,
    /// Bumped when the format of the values changes.
    pub version: u32,
}

impl Bucket {
    /// The name of its folder.
    pub fn folder(&self) -> String {
        format!("{}-v{}", self.name, self.version)
    }
}

/// A store could not be opened, or not be written.
#[derive(Debug)]
pub struct StoreError {
    /// The file or folder.
    pub path: PathBuf,
    /// What was tried, as in "cannot …".
    pub action: &'static str,
    /// Why it failed.
    pub source: io::Error,
}

impl fmt::Display for StoreError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "cache {}: cannot {}: {}", self.path.display(), self.action, self.source)?;
        f.write_str(match advice(self.source.kind()) {
            "" => "; name another folder with --cache or MANYVIEW_CACHE, or go without: --no-cache",
            advice => advice,
        })
    }
}

impl std::error::Error for StoreError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        Some(&self.source)
    }
}

/// What a store did for one process.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StoreCounts {
    /// Values read.
    pub hits: u64,
    /// Values looked for in vain.
    pub misses: u64,
    /// Values written.
    pub written: u64,
    /// Bytes of entries read.
    pub read_bytes: u64,
    /// Bytes of entries written.
    pub written_bytes: u64,
    /// Broken entries met, removed and told of.
    pub broken: u64,
}

/// An open store. All methods may be called from any thread.
pub struct Store {
    root: PathBuf,
    lease: Lease,
    next_part: AtomicU64,
    /// Set by the first failed write: no more are tried.
    is_full: AtomicBool,
    warnings: Mutex<Vec<String>>,
    counts: Mutex<StoreCounts>,
}

const TAG: &str = "Signature: 8a477f597d28d172789f06886806bc55\n\
# This folder is a cache of manyview (`manyview cache`). It can be removed at any time.\n";

impl Store {
    /// Opens the store in the folder `root`, which is made if it is not there.
    pub fn open(root: impl Into<PathBuf>) -> Result<Self, StoreError> {
        let root = root.into();
        let fail = |path: &Path, action| {
            let path = path.to_owned();
            move |source| StoreError { path, action, source }
        };
        for folder in ["tmp", "leases", "claims"].map(|name| root.join(name)) {
            fs_err::create_dir_all(&folder).map_err(fail(&folder, "make the folder"))?;
        }
        let tag = root.join("CACHEDIR.TAG");
        if fs_err::symlink_metadata(&tag).is_err() {
            // Two processes may both do so: the same bytes.
            _ = fs_err::write(&tag, TAG);
        }
        lease::remove_stale(&root);
        let lease = Lease::take(&root).map_err(fail(&root, "register this process"))?;
        Ok(Self {
            root,
            lease,
            next_part: AtomicU64::new(0),
            is_full: AtomicBool::new(false),
            warnings: Mutex::default(),
            counts: Mutex::default(),
        })
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The path of an entry, whether it is there or not.
    pub fn entry_path(&self, bucket: Bucket, key: &Digest) -> PathBuf {
        let name = key.to_string();
        self.root.join(bucket.folder()).join(&name[..2]).join(name)
    }

    /// Whether there is such an entry, unread and unchecked.
    pub fn contains(&self, bucket: Bucket, key: &Digest) -> bool {
        fs_err::symlink_metadata(self.entry_path(bucket, key)).is_ok()
    }

    /// The value under a key, checked; `None` if there is none, or a broken one.
    pub fn get(&self, bucket: Bucket, key: &Digest) -> Option<Vec<u8>> {
        let path = self.entry_path(bucket, key);
        match entry::read(&path, key) {
            Ok(Some(content)) => {
                let mut counts = self.counts();
                counts.hits += 1;
                counts.read_bytes += (content.len() + entry::HEADER_BYTES) as u64;
                Some(content)
            }
            Ok(None) => {
                self.counts().misses += 1;
                None
            }
            Err(reason) => {
                self.report_broken(&path, &reason);
                None
            }
        }
    }

    /// Removes a value that does not mean what it should, although its bytes are those that were written.
    pub fn discard(&self, bucket: Bucket, key: &Digest, reason: &str) {
        self.report_broken(&self.entry_path(bucket, key), reason);
    }

    fn report_broken(&self, path: &Path, reason: &str) {
        _ = fs_err::remove_file(path);
        self.warn(format!(
            "cache entry {} is broken ({reason}): it is removed and made anew",
            path.display()
        ));
        let mut counts = self.counts();
        counts.broken += 1;
        counts.misses += 1;
    }

    /// Stores a value, given in parts. The first write that fails is a warning and ends writing for this process:
    /// a full disk stays full.
    pub fn put(&self, bucket: Bucket, key: &Digest, parts: &[&[u8]]) {
        if self.is_full.load(Ordering::Relaxed) {
            return;
        }
        match self.try_put(bucket, key, parts) {
            Ok(bytes) => {
                let mut counts = self.counts();
                counts.written += 1;
                counts.written_bytes += bytes;
            }
            Err(error) => {
                if !self.is_full.swap(true, Ordering::Relaxed) {
                    self.warn(format!("{error}; this run goes on and stores nothing more"));
                }
            }
        }
    }

    fn try_put(&self, bucket: Bucket, key: &Digest, parts: &[&[u8]]) -> Result<u64, StoreError> {
        let path = self.entry_path(bucket, key);
        let number = self.next_part.fetch_add(1, Ordering::Relaxed);
        let part = self.root.join("tmp").join(format!("{}-{number}", self.lease.name()));
        let written = (|| {
            let mut file = fs_err::OpenOptions::new().write(true).create_new(true).open(&part)?;
            let header = entry::header(key, parts);
            file.write_all(&header)?;
            parts.iter().try_for_each(|part| file.write_all(part))?;
            file.sync_data()?;
            drop(file);
            let rename = || fs_err::rename(&part, &path);
            match rename() {
                Err(error) if error.kind() == io::ErrorKind::NotFound => {
                    fs_err::create_dir_all(path.parent().unwrap_or(&self.root))?;
                    rename()
                }
                other => other,
            }
        })();
        match written {
            Ok(()) => Ok((parts.iter().map(|part| part.len()).sum::<usize>() + entry::HEADER_BYTES) as u64),
            Err(source) => {
                _ = fs_err::remove_file(&part);
                Err(StoreError { path, action: "write the entry", source })
            }
        }
    }

    /// Says that this process is about to make a value; see [`Claim`].
    pub fn claim(&self, key: &Digest) -> Claim {
        Claim::take(&self.root.join("claims").join(key.to_string()))
    }

    /// As [`claim`](Self::claim), but waits while another process has the claim. Asks `is_cancelled` now and then, and
    /// gives up where that says so.
    pub fn claim_or_wait(&self, key: &Digest, is_cancelled: impl Fn() -> bool) -> Claim {
        loop {
            match self.claim(key) {
                Claim::Theirs if !is_cancelled() => std::thread::sleep(std::time::Duration::from_millis(20)),
                claim => return claim,
            }
        }
    }

    /// What this process did so far.
    pub fn counters(&self) -> StoreCounts {
        *self.counts()
    }

    /// Warnings since the last call.
    pub fn take_warnings(&self) -> Vec<String> {
        std::mem::take(&mut *self.warnings.lock().unwrap_or_else(std::sync::PoisonError::into_inner))
    }

    fn warn(&self, warning: String) {
        self.warnings.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push(warning);
    }

    fn counts(&self) -> std::sync::MutexGuard<'_, StoreCounts> {
        self.counts.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

/// Notes that a file is in use, for `gc`: its time of change becomes now. Failing is harmless.
fn touch(file: &std::fs::File) {
    _ = file.set_modified(SystemTime::now());
}
