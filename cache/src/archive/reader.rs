//! Reading archives.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::Path;

use rayon::prelude::*;

use super::chunk::{decode_chunk, decode_chunk_into_zeros};
use super::error::{ArchiveError, ArchiveErrorKind, read_error};
use super::format::{ChunkRecord, HEADER_BYTES, Header, Index, Section, SectionId, SectionName};
use super::source::{ByteSource, FileSource};

/// The largest section that is read unless the caller raises the limit.
const DEFAULT_SECTION_LIMIT_BYTES: u64 = 16 << 30;

/// How many chunks are decoded before memory for the next ones is taken, where it is not taken at once.
const CHUNKS_PER_WAVE: usize = 64;

/// Memory for a whole section is taken at once up to this ratio of raw to stored bytes. Voxels stay far below, zeros
/// reach 30,000, and a lie may claim anything.
const TRUSTED_RATIO: u64 = 256;

/// An archive open for reading: its header and index are read and checked, its content is not.
pub struct Archive {
    source: Box<dyn ByteSource>,
    name: String,
    header: Header,
    index: Index,
    section_numbers: BTreeMap<SectionId, usize>,
    /// Of each chunk, whether its stored bytes are the beginning of an earlier one.
    is_shared: Vec<bool>,
    section_limit_bytes: u64,
}

impl Archive {
    /// Opens the archive at `path`.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, ArchiveError> {
        let path = path.as_ref();
        let name = path.display().to_string();
        match fs_err::File::open(path) {
            Ok(file) => Self::from_source(Box::new(FileSource::new(file)), name),
            Err(error) => Err(read_error(error).in_archive(&name)),
        }
    }

    /// Opens an archive in memory.
    pub fn from_bytes(bytes: Vec<u8>) -> Result<Self, ArchiveError> {
        Self::from_source(Box::new(bytes), "archive in memory".to_owned())
    }

    /// Opens an archive anywhere. The `name` is for messages.
    pub fn from_source(source: Box<dyn ByteSource>, name: String) -> Result<Self, ArchiveError> {
        let (header, index) = read_index(&*source).map_err(|error| error.in_archive(&name))?;
        let section_numbers =
            index.sections.iter().enumerate().map(|(number, section)| (section.id, number)).collect();
        let section_limit_bytes = DEFAULT_SECTION_LIMIT_BYTES;
        let mut end = 0;
        let is_shared = |chunk: &ChunkRecord| {
            let is_shared = chunk.offset < end;
            end = chunk.end().max(end);
            is_shared
        };
        let is_shared = index.chunks.iter().map(is_shared).collect();
        Ok(Self { source, name, header, index, section_numbers, is_shared, section_limit_bytes })
    }

    /// Sets the largest content that [`read_section`](Self::read_section) accepts (16 GiB unless set). A small file
    /// can hold terabytes of zeros.
    #[must_use]
    pub fn with_section_limit(mut self, bytes: u64) -> Self {
        self.section_limit_bytes = bytes;
        self
    }

    /// The path or name, for messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The header.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The sections, in the order of the file.
    pub fn sections(&self) -> &[Section] {
        &self.index.sections
    }

    /// The chunks of all sections, in the order of the file.
    pub fn chunks(&self) -> &[ChunkRecord] {
        &self.index.chunks
    }

    /// Whether the stored bytes of a chunk, by its number, are the beginning of those of an earlier one.
    ///
    /// # Panics
    /// Where there is no such chunk.
    pub fn is_shared(&self, number: u32) -> bool {
        self.is_shared[number as usize]
    }

    /// The stored bytes of a section, without those that it shares with an earlier chunk.
    pub fn stored_bytes(&self, section: &Section) -> u64 {
        let range = section.chunk_range();
        let chunks = self.index.chunks[range.clone()].iter().zip(&self.is_shared[range]);
        chunks.filter(|(_, is_shared)| !**is_shared).map(|(chunk, _)| u64::from(chunk.stored_bytes)).sum()
    }

    /// The section `item` of a kind, if there is one.
    pub fn section(&self, name: &str, item: u32) -> Option<&Section> {
        let id = SectionId { name: name.parse().ok()?, item };
        self.section_numbers.get(&id).map(|&number| &self.index.sections[number])
    }

    /// The section `item` of a kind, which must be there.
    pub fn expect_section(&self, name: &str, item: u32) -> Result<&Section, ArchiveError> {
        let id = SectionId { name: name.parse::<SectionName>()?, item };
        self.section(name, item).ok_or_else(|| self.name_error(ArchiveErrorKind::MissingSection.into(), id))
    }

    /// The content of a section of this archive. Its chunks are read, checked and decoded in parallel.
    pub fn read_section(&self, section: &Section) -> Result<Vec<u8>, ArchiveError> {
        let mut content = Vec::new();
        self.read_section_into(section, &mut content)?;
        Ok(content)
    }

    /// As [`read_section`](Self::read_section), into memory of the caller, whose old content is lost.
    pub fn read_section_into(&self, section: &Section, content: &mut Vec<u8>) -> Result<(), ArchiveError> {
        self.try_read_section(section, content).map_err(|error| {
            content.clear();
            self.name_error(error, section.id)
        })
    }

    fn try_read_section(&self, section: &Section, content: &mut Vec<u8>) -> Result<(), ArchiveError> {
        if self.section_numbers.get(&section.id).is_none_or(|&number| self.index.sections[number] != *section)
        {
            return Err(ArchiveErrorKind::MissingSection.into());
        }
        let limit_bytes = self.section_limit_bytes;
        let raw_bytes = section.raw_bytes;
        if raw_bytes > limit_bytes {
            return Err(ArchiveErrorKind::SectionTooLarge { raw_bytes, limit_bytes }.into());
        }
        let out_of_memory = || ArchiveErrorKind::OutOfMemory { bytes: raw_bytes };
        let size = usize::try_from(raw_bytes).map_err(|_| out_of_memory())?;
        let records = &self.index.chunks[section.chunk_range()];
        let stored_bytes: u64 = records.iter().map(|record| u64::from(record.stored_bytes)).sum();
        content.truncate(size);
        if content.capacity() < size && raw_bytes / TRUSTED_RATIO <= stored_bytes {
            *content = Vec::new();
            *content = zeroed(size).ok_or_else(out_of_memory)?;
        }
        let mut end = 0;
        for (wave, records) in records.chunks(CHUNKS_PER_WAVE).enumerate() {
            let start = end;
            end += records.iter().map(|record| record.raw_bytes as usize).sum::<usize>();
            if content.len() < end {
                content.try_reserve(end - content.len()).map_err(|_| out_of_memory())?;
                content.resize(end, 0);
            }
            let mut rest = &mut content[start..end];
            let mut jobs = Vec::with_capacity(records.len());
            for (number, record) in records.iter().enumerate() {
                let (raw, behind) = rest.split_at_mut(record.raw_bytes as usize);
                rest = behind;
                jobs.push((section.chunk_range().start + wave * CHUNKS_PER_WAVE + number, record, raw));
            }
            // All jobs end before the first error in file order is returned: the same error for any thread count.
            let results: Vec<_> = jobs
                .into_par_iter()
                .map(|(number, record, raw)| self.decode(record, raw).map_err(|error| error.in_chunk(number)))
                .collect();
            results.into_iter().collect::<Result<(), _>>()?;
        }
        Ok(())
    }

    /// The content of one chunk, by its number in [`chunks`](Self::chunks), into memory of the caller, whose old
    /// content is lost.
    ///
    /// # Panics
    /// Where there is no such chunk.
    pub fn read_chunk(&self, number: u32, content: &mut Vec<u8>) -> Result<(), ArchiveError> {
        let number = number as usize;
        let record = &self.index.chunks[number];
        content.clear();
        content.resize(record.raw_bytes as usize, 0);
        self.decode(record, content).map_err(|error| self.name_chunk_error(error, number))
    }

    /// The content of one chunk, by its number, to where it belongs: `zeros`, which are all zero and of the chunk's raw
    /// size. Where the chunk has zeros they are not touched, so that fresh pages of the system stay untouched too.
    /// Threads may read chunks at the same time. After an error the content is undefined.
    ///
    /// # Panics
    /// Where there is no such chunk.
    pub fn read_chunk_into_zeros(&self, number: u32, zeros: &mut [u8]) -> Result<(), ArchiveError> {
        let number = number as usize;
        let record = &self.index.chunks[number];
        self.with_stored(record, |stored| decode_chunk_into_zeros(record, stored, zeros))
            .map_err(|error| self.name_chunk_error(error, number))
    }

    /// Reads, checks and decodes a chunk.
    pub(super) fn decode(&self, record: &ChunkRecord, raw: &mut [u8]) -> Result<(), ArchiveError> {
        self.with_stored(record, |stored| decode_chunk(record, stored, raw))
    }

    fn with_stored(
        &self,
        record: &ChunkRecord,
        decode: impl FnOnce(&[u8]) -> Result<(), ArchiveError>,
    ) -> Result<(), ArchiveError> {
        thread_local!(static STORED: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) });
        if let Some(bytes) = self.source.in_memory() {
            // Within bounds, as the index was checked against the size of the file.
            return decode(&bytes[record.offset as usize..record.end() as usize]);
        }
        STORED.with_borrow_mut(|stored| {
            stored.resize(record.stored_bytes as usize, 0);
            self.source.read_exact_at(record.offset, stored).map_err(read_error)?;
            decode(stored)
        })
    }

    pub(super) fn source(&self) -> &dyn ByteSource {
        &*self.source
    }

    pub(super) fn name_error(&self, error: ArchiveError, section: SectionId) -> ArchiveError {
        error.in_section(section).in_archive(&self.name)
    }

    pub(super) fn name_chunk_error(&self, error: ArchiveError, number: usize) -> ArchiveError {
        let behind = self.index.sections.partition_point(|section| section.chunk_range().end <= number);
        let error = match self.index.sections.get(behind) {
            Some(section) => error.in_section(section.id),
            None => error,
        };
        error.in_chunk(number).in_archive(&self.name)
    }
}

/// Zeros, or `None` where there is no memory for them. They are zeroed pages of the system, which the threads that
/// decode touch first: filling them on one thread would take as long as decoding.
fn zeroed(size: usize) -> Option<Vec<u8>> {
    // Allocating zeros aborts where it fails; this, which is freed again, does not.
    Vec::<u8>::new().try_reserve_exact(size).ok()?;
    Some(vec![0; size])
}

fn read_index(source: &dyn ByteSource) -> Result<(Header, Index), ArchiveError> {
    let file_bytes = source.byte_count().map_err(read_error)?;
    let mut start = [0; HEADER_BYTES];
    let start = &mut start[..file_bytes.min(HEADER_BYTES as u64) as usize];
    source.read_exact_at(0, start).map_err(read_error)?;
    let header = Header::decode(start, file_bytes)?;
    // No larger than the limit and the file.
    let mut bytes = vec![0; header.index_bytes as usize];
    source.read_exact_at(header.index_offset, &mut bytes).map_err(read_error)?;
    let index = Index::decode(&header, &bytes)?;
    Ok((header, index))
}
