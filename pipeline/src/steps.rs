//! Steps over a store: look a result up, or make it and keep it; count, and say why.
//!
//! A step is a pure function. Its key is the BLAKE3 of its name, its version, its parameters in a stable encoding, and
//! the digests of its inputs; never of a time, a path, an environment variable or the order of a map. Steps do not see
//! the store: the drivers ([`crate::regions`], [`crate::points_step`], [`crate::rows_step`]) ask [`Steps`].

use manyview_cache::digest::{Digest, KeyEncoder};
use manyview_cache::store::{Bucket, Claim, ClaimGuard, Store};
use serde::Serialize;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

/// Child masks and coverages of one brick of the octree.
pub const SHAPES: Bucket = Bucket { name: "brick-shapes", version: 2 };
/// Colours, normals, cones and radiance of one brick.
pub const LOOKS: Bucket = Bucket { name: "brick-looks", version: 1 };
/// The surface points of a scene, by cells.
pub const POINTS: Bucket = Bucket { name: "points", version: 1 };
/// The frames of all directions.
pub const FRAMES: Bucket = Bucket { name: "frames", version: 1 };
/// Compressed rows of some blocks of directions.
pub const ROWS: Bucket = Bucket { name: "rows", version: 2 };
/// What the last bake with some settings was made from: where the next one starts. The only values that change.
pub const LATEST: Bucket = Bucket { name: "latest", version: 1 };
/// What a finished bake read and wrote: by this a bake of the same files ends before it begins.
pub const BAKES: Bucket = Bucket { name: "bakes", version: 1 };

/// All buckets of the bake.
pub const BUCKETS: [Bucket; 7] = [SHAPES, LOOKS, POINTS, FRAMES, ROWS, LATEST, BAKES];

/// Kinds of steps, as people hear of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StepKind {
    /// Files to a scene.
    Import,
    /// Which voxels of a brick are filled.
    Bricks,
    /// What the voxels of a brick look like.
    Attributes,
    /// Surface points of a cell, for rows.
    Points,
    /// A block of directions.
    Rows,
    /// All sections in a file.
    Archive,
}

impl StepKind {
    /// All kinds, in the order of the bake.
    pub const ALL: [Self; 6] =
        [Self::Import, Self::Bricks, Self::Attributes, Self::Points, Self::Rows, Self::Archive];

    /// The word for several of them.
    pub fn name(self) -> &'static str {
        match self {
            Self::Import => "import",
            Self::Bricks => "bricks",
            Self::Attributes => "attributes",
            Self::Points => "points",
            Self::Rows => "rows",
            Self::Archive => "archive",
        }
    }
}

/// How many steps of a kind were reused, and how many made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StepCount {
    /// Found in the store.
    pub reused: u64,
    /// Made in this run.
    pub rebuilt: u64,
    /// Of these, made from an older result by changing what differs.
    pub patched: u64,
}

/// Counts by kind, in the order of [`StepKind::ALL`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StepCounts(pub [StepCount; 6]);

impl StepCounts {
    /// The count of one kind.
    pub fn of(&self, kind: StepKind) -> StepCount {
        self.0[kind as usize]
    }

    /// All kinds together.
    pub fn total(&self) -> StepCount {
        self.0.iter().fold(StepCount::default(), |a, b| StepCount {
            reused: a.reused + b.reused,
            rebuilt: a.rebuilt + b.rebuilt,
            patched: a.patched + b.patched,
        })
    }
}

impl std::fmt::Display for StepCounts {
    /// As in `412 reused, 9 rebuilt (bricks 3, rows 6), 0 failed`. A bake with a failed step has no counts.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let total = self.total();
        write!(f, "{} reused, {} rebuilt", total.reused, total.rebuilt)?;
        let kinds: Vec<String> = StepKind::ALL
            .iter()
            .filter(|kind| self.of(**kind).rebuilt > 0)
            .map(|kind| format!("{} {}", kind.name(), self.of(*kind).rebuilt))
            .collect();
        if !kinds.is_empty() {
            write!(f, " ({})", kinds.join(", "))?;
        }
        write!(f, ", 0 failed")
    }
}

/// The steps of one bake, with a store or without.
pub struct Steps {
    store: Option<Arc<Store>>,
    writer: Mutex<Option<Writer>>,
    counts: Mutex<StepCounts>,
}

/// A thread that writes values, so that nobody else waits for the disk.
struct Writer {
    queue: SyncSender<Job>,
    thread: JoinHandle<()>,
}

struct Job {
    bucket: Bucket,
    key: Digest,
    value: Vec<u8>,
    /// Given up when the value is there.
    claim: Option<Arc<ClaimGuard>>,
}

/// Values that wait to be written, at most.
const QUEUE: usize = 16;

impl Steps {
    /// Steps that look results up in `store`, if there is one, and keep them there.
    pub fn new(store: Option<Arc<Store>>) -> Self {
        let writer = store.clone().map(|store| {
            let (queue, jobs) = sync_channel::<Job>(QUEUE);
            let thread = std::thread::spawn(move || {
                for Job { bucket, key, value, claim } in jobs {
                    store.put(bucket, &key, &[&value]);
                    drop(claim);
                }
            });
            Writer { queue, thread }
        });
        Self { store, writer: Mutex::new(writer), counts: Mutex::default() }
    }

    /// Steps that are all made anew.
    pub fn without_store() -> Self {
        Self::new(None)
    }

    /// Whether there is a store.
    pub fn has_store(&self) -> bool {
        self.store.is_some()
    }

    /// The store.
    pub fn store(&self) -> Option<&Store> {
        self.store.as_deref()
    }

    /// The value under a key, as `parse` reads it. A value that does not parse is discarded.
    pub fn find<T>(&self, bucket: Bucket, key: &Digest, parse: impl FnOnce(&[u8]) -> Option<T>) -> Option<T> {
        let store = self.store.as_ref()?;
        let value = store.get(bucket, key)?;
        let parsed = parse(&value);
        if parsed.is_none() {
            store.discard(bucket, key, "it is not of its format");
        }
        parsed
    }

    /// Whether there is a value, unread.
    pub fn contains(&self, bucket: Bucket, key: &Digest) -> bool {
        self.store.as_ref().is_some_and(|store| store.contains(bucket, key))
    }

    /// Keeps a value, soon.
    pub fn keep(&self, bucket: Bucket, key: Digest, value: Vec<u8>, claim: Option<Arc<ClaimGuard>>) {
        let queue =
            self.writer.lock().unwrap_or_else(PoisonError::into_inner).as_ref().map(|w| w.queue.clone());
        if let Some(queue) = queue {
            // Fails only where the writer has died: then nothing is kept, which is no error.
            _ = queue.send(Job { bucket, key, value, claim });
        }
    }

    /// Claims the making of a value. Without a store nobody else can be at it.
    pub fn claim(&self, key: &Digest) -> Claim {
        self.store.as_ref().map_or(Claim::Unknown, |store| store.claim(key))
    }

    /// As [`claim`](Self::claim), but waits for whoever else is at it.
    pub fn claim_or_wait(&self, key: &Digest, is_cancelled: impl Fn() -> bool) -> Claim {
        self.store.as_ref().map_or(Claim::Unknown, |store| store.claim_or_wait(key, is_cancelled))
    }

    /// Counts steps.
    pub fn count(&self, kind: StepKind, reused: usize, rebuilt: usize, patched: usize) {
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        let count = &mut counts.0[kind as usize];
        count.reused += reused as u64;
        count.rebuilt += rebuilt as u64;
        count.patched += patched as u64;
    }

    /// The counts so far.
    pub fn counts(&self) -> StepCounts {
        *self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until everything is kept.
    pub fn flush(&self) {
        let writer = self.writer.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(Writer { queue, thread }) = writer {
            drop(queue);
            _ = thread.join();
        }
    }
}

impl Drop for Steps {
    fn drop(&mut self) {
        self.flush();
    }
}

/// Begins the key of a step.
pub fn step_key(name: &str, version: u32) -> KeyEncoder {
    let mut key = KeyEncoder::new("manyview.step");
    key.text(name).unsigned(version.into());
    key
}

/// Reads values front to back.
pub(crate) struct Reader<'a>(pub(crate) &'a [u8]);

impl<'a> Reader<'a> {
    pub(crate) fn bytes(&mut self, count: usize) -> Option<&'a [u8]> {
        let (bytes, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(bytes)
    }

    pub(crate) fn u32(&mut self) -> Option<u32> {
        Some(u32::from_le_bytes(self.bytes(4)?.try_into().ok()?))
    }

    pub(crate) fn digest(&mut self) -> Option<Digest> {
        Some(Digest(self.bytes(32)?.try_into().ok()?))
    }

    pub(crate) fn end(&self) -> Option<()> {
        self.0.is_empty().then_some(())
    }
}
