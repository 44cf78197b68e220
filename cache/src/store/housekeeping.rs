//! Looking through a whole store: how large it is, what is broken, and making room.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use rayon::prelude::*;

use super::entry;
use super::lease;
use super::{Bucket, Store};
use crate::digest::Digest;

/// What one bucket holds.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BucketStat {
    /// The folder's name.
    pub folder: String,
    /// Whether this program reads it; other versions of it do not.
    pub is_current: bool,
    /// How many entries.
    pub entries: u64,
    /// Their sizes, added up.
    pub bytes: u64,
}

/// What a store holds.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StoreStat {
    /// By name.
    pub buckets: Vec<BucketStat>,
    /// Processes that use it now, this one left out.
    pub other_processes: usize,
}

impl StoreStat {
    /// Entries of all buckets.
    pub fn entries(&self) -> u64 {
        self.buckets.iter().map(|bucket| bucket.entries).sum()
    }

    /// Bytes of all buckets.
    pub fn bytes(&self) -> u64 {
        self.buckets.iter().map(|bucket| bucket.bytes).sum()
    }
}

/// What `gc` did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GcReport {
    /// Entries removed.
    pub removed: u64,
    /// Their bytes.
    pub removed_bytes: u64,
    /// Bytes that are left.
    pub kept_bytes: u64,
    /// Of these, bytes that would be gone but are in use by processes that run now.
    pub in_use_bytes: u64,
}

/// What `verify` found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct VerifyReport {
    /// Entries looked at.
    pub entries: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Broken entries, each with what is wrong; they are removed.
    pub broken: Vec<(PathBuf, String)>,
}

struct Found {
    path: PathBuf,
    bucket: String,
    bytes: u64,
    used: SystemTime,
}

/// Clocks of file systems tick in steps of some milliseconds; those of other machines differ by more.
const CLOCK_TOLERANCE: Duration = Duration::from_secs(2);

impl Store {
    /// Counts what is there. `current` are the buckets of this program.
    pub fn stat(&self, current: &[Bucket]) -> StoreStat {
        let current: Vec<String> = current.iter().map(Bucket::folder).collect();
        let mut buckets: BTreeMap<String, BucketStat> = BTreeMap::new();
        for found in self.entries() {
            let bucket = buckets.entry(found.bucket.clone()).or_default();
            bucket.is_current = current.contains(&found.bucket);
            bucket.folder = found.bucket;
            bucket.entries += 1;
            bucket.bytes += found.bytes;
        }
        let other_processes = lease::count_others(self.root(), &self.lease);
        StoreStat { buckets: buckets.into_values().collect(), other_processes }
    }

    /// Removes entries until at most `max_bytes` are left: buckets that this program does not read first, then what
    /// was not used for the longest time. What a process that runs now has used stays.
    pub fn gc(&self, max_bytes: u64, current: &[Bucket]) -> GcReport {
        lease::remove_stale(self.root());
        let in_use_since = lease::oldest_other(self.root(), &self.lease)
            .map(|time| time.checked_sub(CLOCK_TOLERANCE).unwrap_or(SystemTime::UNIX_EPOCH));
        let current: Vec<String> = current.iter().map(Bucket::folder).collect();
        let mut found = self.entries();
        found.sort_by_key(|entry| (current.contains(&entry.bucket), entry.used));
        let mut report =
            GcReport { kept_bytes: found.iter().map(|entry| entry.bytes).sum(), ..GcReport::default() };
        for entry in found {
            let is_old = !current.contains(&entry.bucket);
            if report.kept_bytes <= max_bytes && !is_old {
                break;
            }
            // Asked again: a process may have begun to use it since the list was made.
            let used = fs_err::metadata(&entry.path).and_then(|m| m.modified()).unwrap_or(entry.used);
            if in_use_since.is_some_and(|since| used >= since) {
                report.in_use_bytes += entry.bytes;
            } else if fs_err::remove_file(&entry.path).is_ok() {
                report.removed += 1;
                report.removed_bytes += entry.bytes;
                report.kept_bytes -= entry.bytes;
            }
        }
        report
    }

    /// Reads every entry and removes those that are broken.
    pub fn verify(&self) -> VerifyReport {
        lease::remove_stale(self.root());
        let found = self.entries();
        let broken: Vec<_> = found
            .par_iter()
            .filter_map(|entry| {
                let name = entry.path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
                let result = match name.parse::<Digest>() {
                    Ok(key) => match fs_err::read(&entry.path) {
                        Ok(bytes) => entry::check(&bytes, &key),
                        // Removed meanwhile.
                        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
                        Err(error) => Err(error.to_string()),
                    },
                    Err(_) => Err("its name is no key".to_owned()),
                };
                result.err().map(|reason| (entry.path.clone(), reason))
            })
            .collect();
        for (path, _) in &broken {
            _ = fs_err::remove_file(path);
        }
        VerifyReport {
            entries: found.len() as u64,
            bytes: found.iter().map(|entry| entry.bytes).sum(),
            broken,
        }
    }

    /// All files in all buckets, by path.
    fn entries(&self) -> Vec<Found> {
        let mut found = Vec::new();
        for bucket in folders_in(self.root()) {
            let name = name_of(&bucket);
            if !is_bucket(&name) {
                continue;
            }
            for shard in folders_in(&bucket) {
                let files = fs_err::read_dir(&shard).into_iter().flatten().flatten();
                found.extend(files.filter_map(|file| {
                    let metadata = file.metadata().ok().filter(std::fs::Metadata::is_file)?;
                    let used = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
                    Some(Found { path: file.path(), bucket: name.clone(), bytes: metadata.len(), used })
                }));
            }
        }
        found.sort_by(|a, b| a.path.cmp(&b.path));
        found
    }
}

/// Whether a folder's name is a name, `-v` and a number.
fn is_bucket(name: &str) -> bool {
    name.rsplit_once("-v").is_some_and(|(name, version)| {
        !name.is_empty() && !version.is_empty() && version.bytes().all(|byte| byte.is_ascii_digit())
    })
}

fn name_of(path: &Path) -> String {
    path.file_name().and_then(|name| name.to_str()).unwrap_or_default().to_owned()
}

fn folders_in(folder: &Path) -> Vec<PathBuf> {
    let entries = fs_err::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|entry| entry.path()).filter(|path| path.is_dir()).collect()
}
