//! Writing archives.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Cursor, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::chunk::{Codec, CompressedChunk};
use super::error::{ArchiveError, ArchiveErrorKind, write_error};
use super::format::{
    ALIGNMENT, ChunkRecord, HEADER_BYTES, Header, Index, MAX_CHUNK_BYTES, Section, SectionId, SectionName,
    aligned, section_digest,
};
use super::mask_code;
use super::spool::ChunkSpool;
use crate::atomic::AtomicFile;
use crate::digest::Digest;

/// The zstd level that is used unless another is asked for.
pub const DEFAULT_LEVEL: i32 = 3;

/// How much content [`ArchiveWriter::append_raw`] compresses before it writes: enough work for many threads.
const WAVE_BYTES: usize = 64 * MAX_CHUNK_BYTES;

/// The sizes of a written archive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArchiveStats {
    /// How many sections it has.
    pub sections: usize,
    /// How many chunks they have.
    pub chunks: usize,
    /// The size of their content.
    pub raw_bytes: u64,
    /// The size of their stored bytes, without padding; what chunks share counts once.
    pub stored_bytes: u64,
    /// The size of the file.
    pub file_bytes: u64,
    /// The digest of the index, which covers every byte.
    pub index_digest: Digest,
}

/// Writes an archive from front to back. Until it is finished there is no file, or the old one.
///
/// The bytes depend only on the sections, their chunks and the level, not on threads or time.
pub struct ArchiveWriter<W = AtomicFile> {
    sink: W,
    /// For messages.
    name: String,
    /// Where the archive will be, if it is a file.
    output: Option<PathBuf>,
    level: i32,
    /// Where the next byte goes.
    position: u64,
    index: Index,
    section_ids: BTreeSet<SectionId>,
    /// Where the forms are with which stored chunks of masks begin, by their digests.
    masks: BTreeMap<Digest, u64>,
    /// Stored bytes, counted once.
    stored_bytes: u64,
    /// The digests of the content of the current section's chunks.
    raw_digests: Vec<Digest>,
}

impl ArchiveWriter<AtomicFile> {
    /// Starts an archive at `path`, whose folder must exist.
    pub fn create(path: impl AsRef<Path>) -> Result<Self, ArchiveError> {
        let path = path.as_ref();
        let mut writer = Self::new(AtomicFile::create(path)?, path.display().to_string())?;
        writer.output = Some(path.to_owned());
        Ok(writer)
    }

    /// Completes the archive and puts it in place of the old file.
    pub fn finish(mut self) -> Result<ArchiveStats, ArchiveError> {
        let stats = self.seal()?;
        self.sink.commit()?;
        Ok(stats)
    }
}

impl ArchiveWriter<Cursor<Vec<u8>>> {
    /// Starts an archive in memory.
    pub fn in_memory() -> Result<Self, ArchiveError> {
        Self::new(Cursor::default(), "archive in memory".to_owned())
    }

    /// Completes the archive and returns its bytes.
    pub fn finish(mut self) -> Result<(Vec<u8>, ArchiveStats), ArchiveError> {
        let stats = self.seal()?;
        Ok((self.sink.into_inner(), stats))
    }
}

impl<W: Write + Seek> ArchiveWriter<W> {
    pub(super) fn new(sink: W, name: String) -> Result<Self, ArchiveError> {
        let mut writer = Self {
            sink,
            name,
            output: None,
            level: DEFAULT_LEVEL,
            position: 0,
            index: Index { sections: Vec::new(), chunks: Vec::new() },
            section_ids: BTreeSet::new(),
            masks: BTreeMap::new(),
            stored_bytes: 0,
            raw_digests: Vec::new(),
        };
        // Its place; without the magic, so that an unfinished file is no archive.
        writer.write(&[0; HEADER_BYTES])?;
        Ok(writer)
    }

    /// Sets the zstd level of [`append_raw`](Self::append_raw).
    #[must_use]
    pub fn with_level(mut self, level: i32) -> Self {
        self.level = level;
        self
    }

    /// Somewhere to keep chunks until their place comes: up to `limit_bytes` in memory, the others on disk beside the
    /// archive. An archive in memory has no disk.
    pub fn spool(&self, limit_bytes: u64) -> ChunkSpool {
        ChunkSpool::new(self.output.clone(), limit_bytes)
    }

    /// Starts a section; what is appended next belongs to it. Sections stay in the order of writing, and no two have
    /// the same name and item.
    pub fn begin_section(&mut self, name: &str, item: u32) -> Result<(), ArchiveError> {
        let name: SectionName = name.parse().map_err(|error: ArchiveError| error.in_archive(&self.name))?;
        let id = SectionId { name, item };
        if !self.section_ids.insert(id) {
            let reason = "the archive already has this section; give the second one another item".to_owned();
            return Err(self.not_expressible(reason).in_section(id));
        }
        self.end_section();
        let next_chunk = self.next_chunk()?;
        let digest = section_digest([]);
        self.index.sections.push(Section { id, chunks: next_chunk..next_chunk, raw_bytes: 0, digest });
        Ok(())
    }

    /// Appends a chunk to the current section. Masks that an earlier chunk of masks begins with are not stored again.
    pub fn append(&mut self, chunk: &CompressedChunk) -> Result<(), ArchiveError> {
        if self.index.sections.is_empty() {
            return Err(self.not_expressible("a chunk needs a section: begin one first".to_owned()));
        }
        let earlier = self.masks.get(&chunk.stored_digest()).filter(|_| chunk.codec() == Codec::Masks);
        let record = match earlier {
            Some(&offset) => chunk.record_at(offset),
            None => self.store(chunk)?,
        };
        self.index.chunks.push(record);
        self.raw_digests.push(chunk.raw_digest());
        let end = self.next_chunk()?;
        if let Some(section) = self.index.sections.last_mut() {
            section.chunks.end = end;
            section.raw_bytes += u64::from(chunk.raw_bytes());
        }
        Ok(())
    }

    fn store(&mut self, chunk: &CompressedChunk) -> Result<ChunkRecord, ArchiveError> {
        self.pad()?;
        let (stored, offset) = (chunk.stored(), self.position);
        if chunk.codec() == Codec::Masks {
            let ends = mask_code::ends(stored).into_iter();
            self.masks.extend(ends.map(|end| (Digest::of(&stored[..end]), offset)));
        }
        self.write(stored)?;
        self.stored_bytes += stored.len() as u64;
        Ok(chunk.record_at(offset))
    }

    /// Cuts `raw` into chunks, compresses them in parallel, and appends them to the current section.
    pub fn append_raw(&mut self, raw: &[u8]) -> Result<(), ArchiveError> {
        for wave in raw.chunks(WAVE_BYTES) {
            let chunks = CompressedChunk::compress_all(wave, self.level);
            chunks.iter().try_for_each(|chunk| self.append(chunk))?;
        }
        Ok(())
    }

    /// Writes the index, and the header that tells of it.
    fn seal(&mut self) -> Result<ArchiveStats, ArchiveError> {
        self.end_section();
        self.pad()?;
        let index_offset = self.position;
        let index = self.index.encode().map_err(|error| error.in_archive(&self.name))?;
        self.write(&index)?;
        let header = Header {
            index_offset,
            index_bytes: index.len() as u32,
            file_bytes: self.position,
            index_digest: Digest::of(&index),
        };
        self.sink
            .seek(SeekFrom::Start(0))
            .and_then(|_| self.sink.write_all(&header.encode()))
            .and_then(|()| self.sink.flush())
            .map_err(|error| write_error(error).in_archive(&self.name))?;
        Ok(ArchiveStats {
            sections: self.index.sections.len(),
            chunks: self.index.chunks.len(),
            raw_bytes: self.index.sections.iter().map(|section| section.raw_bytes).sum(),
            stored_bytes: self.stored_bytes,
            file_bytes: self.position,
            index_digest: header.index_digest,
        })
    }

    fn end_section(&mut self) {
        if let Some(section) = self.index.sections.last_mut() {
            let sizes = self.index.chunks[section.chunk_range()].iter().map(|chunk| chunk.raw_bytes);
            section.digest = section_digest(sizes.zip(self.raw_digests.drain(..)));
        }
    }

    /// The number of the next chunk.
    fn next_chunk(&self) -> Result<u32, ArchiveError> {
        u32::try_from(self.index.chunks.len()).map_err(|_| self.not_expressible("too many chunks".to_owned()))
    }

    fn pad(&mut self) -> Result<(), ArchiveError> {
        let zeros = [0; ALIGNMENT as usize];
        let padding = aligned(self.position) - self.position;
        self.write(&zeros[..padding as usize])
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), ArchiveError> {
        self.sink.write_all(bytes).map_err(|error| write_error(error).in_archive(&self.name))?;
        self.position += bytes.len() as u64;
        Ok(())
    }

    fn not_expressible(&self, reason: String) -> ArchiveError {
        ArchiveError::from(ArchiveErrorKind::NotExpressible { reason }).in_archive(&self.name)
    }
}
