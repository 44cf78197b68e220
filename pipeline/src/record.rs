//! What a finished bake read and wrote, kept in the store: a bake of the same files ends before it begins.
//!
//! The record lies under a key of the scene file's content and of all options; it names the other files with their
//! digests, those that were missing too. Where all are the same, the archive is known by the digest of its index,
//! which covers every byte of it. So nothing is read but the files of the scene, to hash them, and the archive's index.

use crate::bake::{BakeOptions, BakeReport};
use crate::import::{ImportOptions, SourceFile};
use crate::recipe::SceneSource;
use crate::rows::RowsOptions;
use crate::steps::{BAKES, Steps, step_key};
use manyview_cache::archive::{ArchiveStats, FORMAT_VERSION, HEADER_BYTES, Header};
use manyview_cache::digest::{Digest, KeyEncoder};
use serde::{Deserialize, Serialize};
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// Bumped when any step changes its results.
const VERSION: u32 = 1;

/// See the module.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Record {
    /// Path from the scene's folder, and the BLAKE3 of the content, or none for a file that was missing.
    files: Vec<(String, Option<String>)>,
    /// BLAKE3 of the archive's index.
    index: String,
    triangles: u64,
    leaves: u64,
    nodes: u64,
    points: u64,
    sections: usize,
    chunks: usize,
    raw_bytes: u64,
    stored_bytes: u64,
    file_bytes: u64,
    pub(crate) warnings: Vec<String>,
    /// Steps that the archive is made of.
    pub(crate) steps: u64,
}

/// The key of the record of a bake.
pub(crate) fn record_key(
    source: &SceneSource,
    scene_file: Option<&Digest>,
    import: &ImportOptions,
    options: &BakeOptions,
) -> Digest {
    let mut key = step_key("bake", VERSION);
    key.unsigned(FORMAT_VERSION.into());
    match (source, scene_file) {
        (SceneSource::Generated { kind, triangles, seed }, _) => {
            key.text("generated").text(&kind.to_string()).unsigned(*triangles).unsigned(*seed);
        }
        (SceneSource::File(_), digest) => {
            key.text("file").boolean(import.allow_outside).unsigned(import.animation as u64);
            match import.time_seconds {
                Some(time) => key.float(time),
                None => key.none(),
            };
            match digest {
                Some(digest) => key.digest(digest),
                None => key.none(),
            };
        }
    }
    options_key(&mut key, options);
    key.finish()
}

fn options_key(key: &mut KeyEncoder, options: &BakeOptions) {
    key.unsigned(options.levels.into());
    match &options.rows {
        None => _ = key.none(),
        Some(RowsOptions { bits, directions, fit, from }) => {
            key.unsigned((*bits).into()).text(&directions.to_string());
            key.text(&format!("{fit:?}")).text(&from.to_string());
        }
    }
    match &options.cube {
        None => _ = key.none(),
        Some(cube) => {
            cube.origin.iter().for_each(|c| _ = key.float(*c));
            key.float(cube.size);
        }
    }
}

impl Record {
    pub(crate) fn new(
        files: &[SourceFile],
        report: &BakeReport,
        archive: &ArchiveStats,
        warnings: &[String],
        steps: u64,
    ) -> Self {
        let hash = |file: &SourceFile| file.hash.map(|hash| hash.to_hex().to_string());
        Self {
            files: files.iter().map(|file| (file.path.clone(), hash(file))).collect(),
            index: archive.index_digest.to_string(),
            triangles: report.triangles,
            leaves: report.leaves,
            nodes: report.nodes,
            points: report.points,
            sections: archive.sections,
            chunks: archive.chunks,
            raw_bytes: archive.raw_bytes,
            stored_bytes: archive.stored_bytes,
            file_bytes: archive.file_bytes,
            warnings: warnings.to_vec(),
            steps,
        }
    }

    pub(crate) fn find(steps: &Steps, key: &Digest) -> Option<Self> {
        steps.find(BAKES, key, |value| serde_json::from_slice(value).ok())
    }

    pub(crate) fn keep(&self, steps: &Steps, key: Digest) {
        if let Ok(value) = serde_json::to_vec(self) {
            steps.keep(BAKES, key, value, None);
        }
    }

    /// Whether the files beside the scene file are what they were.
    pub(crate) fn has_same_files(&self, folder: &Path) -> bool {
        self.files.iter().skip(1).all(|(path, hash)| {
            let found =
                fs_err::read(folder.join(path)).ok().map(|bytes| blake3::hash(&bytes).to_hex().to_string());
            found == *hash
        })
    }

    /// Whether the file at `output` is the archive: its size, its index, and what its header says of both.
    pub(crate) fn is_archive_at(&self, output: &Path) -> bool {
        let check = || -> Option<bool> {
            let mut file = fs_err::File::open(output).ok()?;
            let size = file.metadata().ok()?.len();
            let mut start = [0; HEADER_BYTES];
            file.read_exact(&mut start).ok()?;
            let header = Header::decode(&start, size).ok()?;
            if size != self.file_bytes || header.index_digest.to_string() != self.index {
                return Some(false);
            }
            let mut index = vec![0; header.index_bytes as usize];
            file.seek(SeekFrom::Start(header.index_offset)).ok()?;
            file.read_exact(&mut index).ok()?;
            Some(Digest::of(&index) == header.index_digest)
        };
        check().unwrap_or(false)
    }

    pub(crate) fn files(&self) -> impl Iterator<Item = &str> {
        self.files.iter().map(|(path, _)| path.as_str())
    }

    pub(crate) fn report(&self) -> BakeReport {
        BakeReport {
            triangles: self.triangles,
            leaves: self.leaves,
            nodes: self.nodes,
            points: self.points,
            seconds: [0.0; 3],
        }
    }

    pub(crate) fn archive(&self) -> Option<ArchiveStats> {
        Some(ArchiveStats {
            index_digest: self.index.parse().ok()?,
            sections: self.sections,
            chunks: self.chunks,
            raw_bytes: self.raw_bytes,
            stored_bytes: self.stored_bytes,
            file_bytes: self.file_bytes,
        })
    }
}
