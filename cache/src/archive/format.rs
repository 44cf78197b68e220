//! Header and index: what is where in an archive, and the checks before any of it is believed.

use std::collections::BTreeSet;
use std::fmt;
use std::ops::Range;
use std::str::FromStr;

use rkyv::util::AlignedVec;

use super::chunk::Codec;
use super::error::{ArchiveError, ArchiveErrorKind, corrupt, expect_equal};
use crate::digest::{Digest, DigestBuilder};

/// The first bytes of every archive. Like PNG's they break when a transfer strips the high bit or changes line ends.
pub const MAGIC: [u8; 8] = *b"\x89MVB\r\n\x1a\n";

/// The version that this program writes, and the only one that it reads.
pub const FORMAT_VERSION: u32 = 1;

/// The size of the header.
pub const HEADER_BYTES: usize = 64;

/// Chunks and the index begin at multiples of this, so that mapped or fetched ranges can be read in place.
pub const ALIGNMENT: u64 = 16;

/// The largest content of one chunk.
pub const MAX_CHUNK_BYTES: usize = 4 << 20;

/// The largest index, enough for more than a million chunks.
pub const MAX_INDEX_BYTES: usize = 64 << 20;

/// The next multiple of the alignment.
pub(super) const fn aligned(offset: u64) -> u64 {
    offset.next_multiple_of(ALIGNMENT)
}

/// The name of a kind of section: 1 to 16 characters of `a-z`, `0-9`, `.`, `_` and `-`.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SectionName([u8; 16]);

impl SectionName {
    /// Takes the stored form: the characters, then zeros.
    pub fn from_stored(stored: [u8; 16]) -> Option<Self> {
        let length = stored.iter().position(|&byte| byte == 0).unwrap_or(stored.len());
        let (name, padding) = stored.split_at(length);
        let in_alphabet = |byte: &u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'.' | b'_' | b'-');
        (!name.is_empty() && name.iter().all(in_alphabet) && padding.iter().all(|&byte| byte == 0))
            .then_some(Self(stored))
    }

    /// The stored form.
    pub const fn stored(&self) -> &[u8; 16] {
        &self.0
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        let length = self.0.iter().position(|&byte| byte == 0).unwrap_or(self.0.len());
        str::from_utf8(&self.0[..length]).unwrap_or_default()
    }
}

impl FromStr for SectionName {
    type Err = ArchiveError;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let mut stored = [0; 16];
        stored
            .get_mut(..name.len())
            .map(|start| start.copy_from_slice(name.as_bytes()))
            .and_then(|()| Self::from_stored(stored))
            // A zero at the end would pass for padding.
            .filter(|stored| stored.as_str() == name)
            .ok_or_else(|| {
                let reason = format!(
                    "{name:?} is no name for a section: it takes 1 to 16 characters of a-z, 0-9, '.', '_' and '-'"
                );
                ArchiveErrorKind::NotExpressible { reason }.into()
            })
    }
}

impl fmt::Display for SectionName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl fmt::Debug for SectionName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.as_str(), f)
    }
}

/// What tells the sections of an archive apart: a name, and a number such as a level or a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SectionId {
    /// The kind of content.
    pub name: SectionName,
    /// Which one of its kind.
    pub item: u32,
}

impl fmt::Display for SectionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}[{}]", self.name, self.item)
    }
}

/// A section: named content, cut into chunks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Section {
    /// Name and item.
    pub id: SectionId,
    /// Its chunks, as a range of [`Index::chunks`].
    pub chunks: Range<u32>,
    /// The size of its content.
    pub raw_bytes: u64,
    /// The identity of its content, whatever the compression: BLAKE3 over, for each chunk, its raw size (u32,
    /// little-endian) and the BLAKE3 of its raw bytes. So it is computed and checked with chunks in parallel.
    pub digest: Digest,
}

impl Section {
    /// The range of its chunks, for slices.
    pub(super) fn chunk_range(&self) -> Range<usize> {
        self.chunks.start as usize..self.chunks.end as usize
    }
}

/// Where a chunk is and what it must be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ChunkRecord {
    /// Where its stored bytes begin in the file.
    pub offset: u64,
    /// How many bytes are stored.
    pub stored_bytes: u32,
    /// How many bytes they stand for.
    pub raw_bytes: u32,
    /// How they are stored.
    pub codec: Codec,
    /// The digest of the stored bytes, so that it can be checked before they are decoded.
    pub stored_digest: Digest,
}

impl ChunkRecord {
    /// The first offset behind the stored bytes.
    pub const fn end(&self) -> u64 {
        self.offset + self.stored_bytes as u64
    }
}

/// [`Section::digest`], of the raw size and the digest of the raw bytes of each chunk.
pub(super) fn section_digest(chunks: impl IntoIterator<Item = (u32, Digest)>) -> Digest {
    let mut digest = DigestBuilder::new();
    for (raw_bytes, raw_digest) in chunks {
        digest.update(&raw_bytes.to_le_bytes()).update(raw_digest.as_bytes());
    }
    digest.finish()
}

/// The header: what must be known to find and check the index.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// Where the index begins.
    pub index_offset: u64,
    /// The size of the index.
    pub index_bytes: u32,
    /// The size of the whole file.
    pub file_bytes: u64,
    /// The digest of the index.
    pub index_digest: Digest,
}

impl Header {
    /// Writes the header.
    pub fn encode(&self) -> [u8; HEADER_BYTES] {
        let mut bytes = [0; HEADER_BYTES];
        bytes[..8].copy_from_slice(&MAGIC);
        bytes[8..12].copy_from_slice(&FORMAT_VERSION.to_le_bytes());
        bytes[12..16].copy_from_slice(&self.index_bytes.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.index_offset.to_le_bytes());
        bytes[24..32].copy_from_slice(&self.file_bytes.to_le_bytes());
        bytes[32..].copy_from_slice(self.index_digest.as_bytes());
        bytes
    }

    /// Reads a header from the `start` of a file of `file_bytes`, and checks that the index it tells of can exist.
    pub fn decode(start: &[u8], file_bytes: u64) -> Result<Self, ArchiveError> {
        if start.get(..8) != Some(&MAGIC) {
            let first = &start[..start.len().min(8)];
            let found = if first.is_empty() {
                "nothing".to_owned()
            } else {
                format!("{:?}", first.escape_ascii().to_string())
            };
            return Err(ArchiveErrorKind::NotAnArchive { found }.into());
        }
        let field = |range: Range<usize>| {
            let short = || corrupt("size of the file", format!("at least {HEADER_BYTES} bytes"), file_bytes);
            start.get(range).ok_or_else(short)
        };
        let u32_at =
            |at| field(at..at + 4).map(|bytes| u32::from_le_bytes(bytes.try_into().unwrap_or_default()));
        let u64_at =
            |at| field(at..at + 8).map(|bytes| u64::from_le_bytes(bytes.try_into().unwrap_or_default()));
        let version = u32_at(8)?;
        if version != FORMAT_VERSION {
            let supported = FORMAT_VERSION;
            return Err(ArchiveErrorKind::UnsupportedVersion { found: version, supported }.into());
        }
        let header = Self {
            index_bytes: u32_at(12)?,
            index_offset: u64_at(16)?,
            file_bytes: u64_at(24)?,
            index_digest: Digest(field(32..64)?.try_into().unwrap_or_default()),
        };
        expect_equal("size of the file", header.file_bytes, file_bytes)?;
        if header.index_bytes as usize > MAX_INDEX_BYTES {
            return Err(corrupt(
                "size of the index",
                format!("at most {MAX_INDEX_BYTES}"),
                header.index_bytes,
            ));
        }
        if header.index_offset < HEADER_BYTES as u64 || !header.index_offset.is_multiple_of(ALIGNMENT) {
            let expected = format!("a multiple of {ALIGNMENT}, at least {HEADER_BYTES}");
            return Err(corrupt("offset of the index", expected, header.index_offset));
        }
        // The index is the last thing in the file. Subtracting cannot overflow as adding to a hostile offset could.
        expect_equal(
            "offset of the index",
            file_bytes.saturating_sub(header.index_bytes.into()),
            header.index_offset,
        )?;
        Ok(header)
    }
}

/// What an archive holds. Every value of this type has passed the checks of [`Index::decode`] or comes from a writer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Index {
    /// The sections, in the order of their chunks.
    pub sections: Vec<Section>,
    /// The chunks, in the order of the file, but for those that are the beginning of an earlier one.
    pub chunks: Vec<ChunkRecord>,
}

/// The stored form of [`Index`]. Its layout is documented at the top of the crate.
#[derive(rkyv::Archive, rkyv::Serialize)]
struct StoredIndex {
    sections: Vec<StoredSection>,
    chunks: Vec<StoredChunk>,
}

#[derive(rkyv::Archive, rkyv::Serialize)]
struct StoredSection {
    name: [u8; 16],
    digest: [u8; 32],
    raw_bytes: u64,
    item: u32,
    first_chunk: u32,
    chunk_count: u32,
    reserved: u32,
}

#[derive(rkyv::Archive, rkyv::Serialize)]
struct StoredChunk {
    offset: u64,
    stored_bytes: u32,
    raw_bytes: u32,
    stored_digest: [u8; 32],
    codec: u8,
    reserved: [u8; 7],
}

const SECTION_BYTES: usize = size_of::<ArchivedStoredSection>();
const CHUNK_BYTES: usize = size_of::<ArchivedStoredChunk>();
const ROOT_BYTES: usize = size_of::<ArchivedStoredIndex>();

// The layout on disk, wherever this is built.
const _: () = assert!(SECTION_BYTES == 72 && CHUNK_BYTES == 56 && ROOT_BYTES == 16);

impl Index {
    /// Writes the index.
    pub(super) fn encode(&self) -> Result<AlignedVec<16>, ArchiveError> {
        let sections = self.sections.iter().map(|section| StoredSection {
            name: *section.id.name.stored(),
            digest: section.digest.0,
            raw_bytes: section.raw_bytes,
            item: section.id.item,
            first_chunk: section.chunks.start,
            chunk_count: section.chunks.end - section.chunks.start,
            reserved: 0,
        });
        let chunks = self.chunks.iter().map(|chunk| StoredChunk {
            offset: chunk.offset,
            stored_bytes: chunk.stored_bytes,
            raw_bytes: chunk.raw_bytes,
            stored_digest: chunk.stored_digest.0,
            codec: chunk.codec as u8,
            reserved: [0; 7],
        });
        let stored = StoredIndex { sections: sections.collect(), chunks: chunks.collect() };
        let bytes = self.sections.len() * SECTION_BYTES + self.chunks.len() * CHUNK_BYTES + ROOT_BYTES;
        if bytes > MAX_INDEX_BYTES {
            let reason = format!(
                "the index of {} sections and {} chunks takes {bytes} bytes, more than the limit of {MAX_INDEX_BYTES}; \
                 write less into one archive",
                self.sections.len(),
                self.chunks.len()
            );
            return Err(ArchiveErrorKind::NotExpressible { reason }.into());
        }
        rkyv::to_bytes::<rkyv::rancor::Error>(&stored).map_err(|error| {
            ArchiveErrorKind::NotExpressible { reason: format!("the index: {error}") }.into()
        })
    }

    /// Reads the index whose `bytes` the `header` tells of, and checks everything in it: what it says of sections
    /// and chunks is consistent, within the limits, and covers the file from header to index.
    pub fn decode(header: &Header, bytes: &[u8]) -> Result<Self, ArchiveError> {
        expect_equal("size of the index", header.index_bytes as usize, bytes.len())?;
        expect_equal("digest of the index", header.index_digest, Digest::of(bytes))?;
        let mut in_place = AlignedVec::<16>::with_capacity(bytes.len());
        in_place.extend_from_slice(bytes);
        let stored = rkyv::access::<ArchivedStoredIndex, rkyv::rancor::Error>(&in_place)
            .map_err(|error| corrupt("structure of the index", "one of sections and chunks", error))?;
        // Vectors cannot share bytes (rkyv checks), so with this size there is nothing else in the index.
        expect_equal(
            "size of the index for its sections and chunks",
            (stored.sections.len() as u64)
                .saturating_mul(SECTION_BYTES as u64)
                .saturating_add((stored.chunks.len() as u64).saturating_mul(CHUNK_BYTES as u64))
                .saturating_add(ROOT_BYTES as u64),
            bytes.len() as u64,
        )?;
        let chunks = decode_chunks(header, &stored.chunks)?;
        let sections = decode_sections(&stored.sections, &chunks)?;
        Ok(Self { sections, chunks })
    }
}

/// Checks the chunks, each of which must follow the one before or, of masks, be the beginning of an earlier one.
fn decode_chunks(header: &Header, stored: &[ArchivedStoredChunk]) -> Result<Vec<ChunkRecord>, ArchiveError> {
    let mut chunks = Vec::with_capacity(stored.len());
    let mut end = HEADER_BYTES as u64;
    // Start and end of the chunks of masks that follow the one before.
    let mut masks: Vec<[u64; 2]> = Vec::new();
    for (number, chunk) in stored.iter().enumerate() {
        let offset = chunk.offset.to_native();
        let whole = masks.binary_search_by_key(&offset, |[start, _]| *start).ok().map(|at| masks[at]);
        let whole = whole.filter(|_| chunk.codec == Codec::Masks as u8);
        let [start, payload_end] = whole.unwrap_or([aligned(end), header.index_offset]);
        let chunk = decode_chunk_record(chunk, start, payload_end).map_err(|e| e.in_chunk(number))?;
        if whole.is_none() {
            end = chunk.end();
            if chunk.codec == Codec::Masks {
                masks.push([chunk.offset, end]);
            }
        }
        chunks.push(chunk);
    }
    expect_equal("offset of the index", aligned(end), header.index_offset)?;
    Ok(chunks)
}

fn decode_chunk_record(
    stored: &ArchivedStoredChunk,
    start: u64,
    payload_end: u64,
) -> Result<ChunkRecord, ArchiveError> {
    let codec = Codec::from_stored(stored.codec)?;
    let offset = stored.offset.to_native();
    let stored_bytes = stored.stored_bytes.to_native();
    let raw_bytes = stored.raw_bytes.to_native();
    expect_equal("offset", start, offset)?;
    if payload_end.checked_sub(offset).is_none_or(|available| u64::from(stored_bytes) > available) {
        let available = payload_end.saturating_sub(offset);
        return Err(corrupt(
            "stored size",
            format!("at most {available}, up to the end of what holds it"),
            stored_bytes,
        ));
    }
    if raw_bytes == 0 || raw_bytes as usize > MAX_CHUNK_BYTES {
        return Err(corrupt("raw size", format!("1 to {MAX_CHUNK_BYTES}"), raw_bytes));
    }
    match codec {
        Codec::Raw => expect_equal("stored size of a raw chunk", raw_bytes, stored_bytes)?,
        Codec::Zstd | Codec::Rows | Codec::Masks if stored_bytes == 0 || stored_bytes >= raw_bytes => {
            let expected = format!("1 to {}, less than the raw size", raw_bytes - 1);
            return Err(corrupt("stored size of a compressed chunk", expected, stored_bytes));
        }
        Codec::Zstd | Codec::Rows | Codec::Masks => {}
    }
    if stored.reserved != [0; 7] {
        return Err(corrupt("reserved bytes", "zeros", format!("{:?}", stored.reserved)));
    }
    Ok(ChunkRecord { offset, stored_bytes, raw_bytes, codec, stored_digest: Digest(stored.stored_digest) })
}

/// Checks the sections, which must be unique and take all chunks in order.
fn decode_sections(
    stored: &[ArchivedStoredSection],
    chunks: &[ChunkRecord],
) -> Result<Vec<Section>, ArchiveError> {
    let mut sections = Vec::with_capacity(stored.len());
    let mut seen = BTreeSet::new();
    let mut next_chunk = 0;
    for (number, section) in stored.iter().enumerate() {
        let name = SectionName::from_stored(section.name).ok_or_else(|| {
            let expected = "1 to 16 characters of a-z, 0-9, '.', '_' and '-', then zeros";
            let found = format!("{:?} in section number {number}", section.name.escape_ascii().to_string());
            corrupt("name of a section", expected, found)
        })?;
        let id = SectionId { name, item: section.item.to_native() };
        let section =
            decode_section(section, id, next_chunk, chunks).map_err(|error| error.in_section(id))?;
        if !seen.insert(id) {
            return Err(corrupt("number of sections with this name and item", 1, 2).in_section(id));
        }
        next_chunk = section.chunks.end;
        sections.push(section);
    }
    expect_equal("number of chunks in all sections", chunks.len(), next_chunk as usize)?;
    Ok(sections)
}

fn decode_section(
    stored: &ArchivedStoredSection,
    id: SectionId,
    next_chunk: u32,
    chunks: &[ChunkRecord],
) -> Result<Section, ArchiveError> {
    let first_chunk = stored.first_chunk.to_native();
    let chunk_count = stored.chunk_count.to_native();
    expect_equal("first chunk", next_chunk, first_chunk)?;
    let available = chunks.len().saturating_sub(first_chunk as usize);
    if chunk_count as usize > available {
        return Err(corrupt("number of chunks", format!("at most {available}"), chunk_count));
    }
    expect_equal("reserved bytes", 0, stored.reserved.to_native())?;
    let section = Section {
        id,
        chunks: first_chunk..first_chunk + chunk_count,
        raw_bytes: stored.raw_bytes.to_native(),
        digest: Digest(stored.digest),
    };
    // At most 2^32 chunks of at most 4 MiB: no overflow.
    let raw_bytes = chunks[section.chunk_range()].iter().map(|chunk| u64::from(chunk.raw_bytes)).sum();
    expect_equal("raw size of the chunks", section.raw_bytes, raw_bytes)?;
    Ok(section)
}
