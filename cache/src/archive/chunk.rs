//! Chunks: pieces of content that are stored, checked and decoded each on its own.

use std::cell::RefCell;
use std::io;

use blake3::hazmat::ChainingValue;
use rayon::prelude::*;
use zstd::bulk::{Compressor, Decompressor};

use super::error::{ArchiveError, ArchiveErrorKind, corrupt, expect_equal};
use super::format::{ChunkRecord, MAX_CHUNK_BYTES};
use super::mask_code;
use super::tiles;
use super::writer::DEFAULT_LEVEL;
use crate::digest::Digest;

/// How the bytes of a chunk are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Codec {
    /// As they are.
    Raw = 0,
    /// As one zstd frame that tells its content size and has no checksum.
    Zstd = 1,
    /// In [tiles](super::tiles) of rows, each [coded](super::row_code) on its own. Before it there were 2 and 3, which
    /// nothing writes any more.
    Rows = 4,
    /// An octree's child masks under [probabilities of their neighbours](super::mask_code).
    Masks = 5,
}

impl Codec {
    pub(super) fn from_stored(stored: u8) -> Result<Self, ArchiveError> {
        match stored {
            0 => Ok(Self::Raw),
            1 => Ok(Self::Zstd),
            4 => Ok(Self::Rows),
            5 => Ok(Self::Masks),
            found => Err(ArchiveErrorKind::UnsupportedCodec { found }.into()),
        }
    }
}

/// A chunk ready to be appended to an archive. Compressing, which takes the time, can so be done by many threads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CompressedChunk {
    stored: Box<[u8]>,
    raw_bytes: u32,
    codec: Codec,
    raw_digest: Digest,
    stored_digest: Digest,
    /// The tiles' parts of the raw digest; of other codecs none.
    tile_digests: Vec<ChainingValue>,
}

thread_local! {
    /// With the level it is set to. Contexts take megabytes and much time to make, so each thread keeps one.
    static COMPRESSOR: RefCell<Option<(i32, Compressor<'static>)>> = const { RefCell::new(None) };
    static DECOMPRESSOR: RefCell<Option<Decompressor<'static>>> = const { RefCell::new(None) };
    /// Room for a compressed chunk before its size is known.
    static SCRATCH: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

impl CompressedChunk {
    /// Compresses `raw` at a zstd `level` (1 fast, 19 small), or keeps it as it is where that is not smaller. The
    /// result depends on nothing but the arguments.
    ///
    /// # Panics
    /// Where `raw` is empty or larger than [`MAX_CHUNK_BYTES`].
    pub fn compress(raw: &[u8], level: i32) -> Self {
        assert!(!raw.is_empty(), "a chunk has content");
        assert!(raw.len() <= MAX_CHUNK_BYTES, "{} bytes are more than a chunk takes", raw.len());
        let raw_digest = Digest::of(raw);
        // Compression into less than `raw.len()` bytes fails where it would not help.
        let compressed = SCRATCH.with_borrow_mut(|scratch| {
            scratch.resize(raw.len() - 1, 0);
            compress_into(raw, level, scratch).ok().map(|size| Box::from(&scratch[..size]))
        });
        let (codec, stored) = match compressed {
            Some(stored) => (Codec::Zstd, stored),
            None => (Codec::Raw, Box::from(raw)),
        };
        let stored_digest = if codec == Codec::Raw { raw_digest } else { Digest::of(&stored) };
        let tile_digests = Vec::new();
        Self { stored, raw_bytes: raw.len() as u32, codec, raw_digest, stored_digest, tile_digests }
    }

    /// Codes `raw`, which is rows of `row_bytes` bytes (4, 8, 16, 32) in whole lines of 8 · `row_bytes` rows, in tiles,
    /// so that a [`TileEditor`](super::TileEditor) can change some of it at the cost of some. Other content is
    /// compressed as by [`compress`](Self::compress).
    ///
    /// # Panics
    /// Where `raw` is empty or larger than [`MAX_CHUNK_BYTES`].
    pub fn compress_rows(raw: &[u8], row_bytes: usize) -> Self {
        assert!(!raw.is_empty(), "a chunk has content");
        assert!(raw.len() <= MAX_CHUNK_BYTES, "{} bytes are more than a chunk takes", raw.len());
        match tiles::encode(raw, row_bytes) {
            Some((stored, digest, digests)) => Self::of_tiles(stored, raw.len(), digest, digests),
            None => Self::compress(raw, DEFAULT_LEVEL),
        }
    }

    /// Codes child masks: of a cube of an octree, all `levels` from its root on, of which those from `first` on become a
    /// chunk each. The stored bytes of a level begin with those of the level above, and an archive has them once if the
    /// deepest level is appended first. Where coding does not make all of them smaller, they are compressed as by
    /// [`compress`](Self::compress).
    ///
    /// # Panics
    /// Unless there are 1 to [`MAX_LEVELS`](mask_code::MAX_LEVELS) levels and one from `first` on, the first level has
    /// one mask, each other as many as the one above has bits, and no mask is zero.
    pub fn compress_masks(levels: &[&[u8]], first: usize) -> Vec<Self> {
        let forms = mask_code::encode(levels, first);
        let levels = &levels[first..];
        if levels.iter().zip(&forms).any(|(raw, stored)| stored.len() >= raw.len()) {
            return levels.iter().map(|raw| Self::compress(raw, DEFAULT_LEVEL)).collect();
        }
        let chunk = |(raw, stored): (&&[u8], Vec<u8>)| {
            let stored_digest = Digest::of(&stored);
            Self::of_stored(stored, raw.len() as u32, Codec::Masks, Digest::of(raw), stored_digest)
        };
        levels.iter().zip(forms).map(chunk).collect()
    }

    /// A chunk in tiles that are stored already.
    pub(super) fn of_tiles(
        stored: Vec<u8>,
        raw_bytes: usize,
        raw_digest: Digest,
        tile_digests: Vec<ChainingValue>,
    ) -> Self {
        let stored_digest = Digest::of(&stored);
        let (stored, raw_bytes) = (stored.into_boxed_slice(), raw_bytes as u32);
        Self { stored, raw_bytes, codec: Codec::Rows, raw_digest, stored_digest, tile_digests }
    }

    /// A chunk whose stored bytes were put aside; without its tiles' parts of the digest.
    pub(super) fn of_stored(
        stored: Vec<u8>,
        raw_bytes: u32,
        codec: Codec,
        raw_digest: Digest,
        stored_digest: Digest,
    ) -> Self {
        let stored = stored.into_boxed_slice();
        Self { stored, raw_bytes, codec, raw_digest, stored_digest, tile_digests: Vec::new() }
    }

    /// The tiles' parts of the content's digest; none of chunks that are not in tiles.
    pub(super) fn tile_digests(&self) -> &[ChainingValue] {
        &self.tile_digests
    }

    /// How it is stored.
    pub fn codec(&self) -> Codec {
        self.codec
    }

    /// Cuts `raw` into chunks as [`ArchiveWriter::append_raw`](super::ArchiveWriter::append_raw) does, and compresses
    /// them in parallel.
    pub fn compress_all(raw: &[u8], level: i32) -> Vec<Self> {
        raw.par_chunks(MAX_CHUNK_BYTES).map(|raw| Self::compress(raw, level)).collect()
    }

    /// The content.
    pub fn content(&self) -> Result<Vec<u8>, ArchiveError> {
        let mut raw = vec![0; self.raw_bytes as usize];
        self.content_into_zeros(&mut raw)?;
        Ok(raw)
    }

    /// Writes the content to `raw`, which is all zero and as large as the content.
    pub fn content_into_zeros(&self, raw: &mut [u8]) -> Result<(), ArchiveError> {
        decode_chunk_into_zeros(&self.record_at(0), &self.stored, raw)
    }

    /// Appends the chunk to what will be a value of a [store](crate::store): raw size, stored size, codec (4 bytes
    /// each), both digests, the stored bytes; of a chunk in tiles, their parts of the digest.
    pub fn save(&self, value: &mut Vec<u8>) {
        value.extend(self.raw_bytes.to_le_bytes());
        value.extend((self.stored.len() as u32).to_le_bytes());
        value.extend((self.codec as u32).to_le_bytes());
        value.extend(self.raw_digest.0);
        value.extend(self.stored_digest.0);
        value.extend(&self.stored);
        self.tile_digests.iter().for_each(|digest| value.extend(digest));
    }

    /// Takes a chunk that [`save`](Self::save) wrote from the front of a checked `value`; `None` if there is none.
    pub fn load(value: &mut &[u8]) -> Option<Self> {
        let (head, rest) = value.split_at_checked(12 + 64)?;
        let number = |at: usize| Some(u32::from_le_bytes(head.get(at..at + 4)?.try_into().ok()?));
        let (stored, rest) = rest.split_at_checked(number(4)? as usize)?;
        let raw_bytes = number(0)?;
        if raw_bytes == 0 || raw_bytes as usize > MAX_CHUNK_BYTES {
            return None;
        }
        let codec = Codec::from_stored(u8::try_from(number(8)?).ok()?).ok()?;
        let tiles = if codec == Codec::Rows { tiles::tile_count(raw_bytes as usize) } else { 0 };
        let (digests, rest) = rest.split_at_checked(tiles * 32)?;
        *value = rest;
        Some(Self {
            stored: stored.into(),
            raw_bytes,
            codec,
            tile_digests: digests.as_chunks::<32>().0.to_vec(),
            raw_digest: Digest(head[12..44].try_into().ok()?),
            stored_digest: Digest(head[44..].try_into().ok()?),
        })
    }

    /// The bytes to store.
    pub fn stored(&self) -> &[u8] {
        &self.stored
    }

    /// The size of the content.
    pub fn raw_bytes(&self) -> u32 {
        self.raw_bytes
    }

    /// The digest of the stored bytes.
    pub(super) fn stored_digest(&self) -> Digest {
        self.stored_digest
    }

    /// The digest of the content.
    pub fn raw_digest(&self) -> Digest {
        self.raw_digest
    }

    /// The entry in the index of this chunk at an `offset`.
    pub(super) fn record_at(&self, offset: u64) -> ChunkRecord {
        ChunkRecord {
            offset,
            stored_bytes: self.stored.len() as u32,
            raw_bytes: self.raw_bytes,
            codec: self.codec,
            stored_digest: self.stored_digest,
        }
    }
}

fn compress_into(raw: &[u8], level: i32, stored: &mut [u8]) -> io::Result<usize> {
    COMPRESSOR.with_borrow_mut(|slot| {
        if slot.as_ref().is_none_or(|(current, _)| *current != level) {
            *slot = Some((level, Compressor::new(level)?));
        }
        let Some((_, compressor)) = slot else { return Err(io::Error::other("no compressor")) };
        compressor.compress_to_buffer(raw, stored)
    })
}

/// Decodes the `stored` bytes of a chunk into `raw`, whose size must be the chunk's raw size. First the digest is
/// checked, so that the decoder sees only what a writer wrote. Takes no memory beyond a fixed context per thread.
pub fn decode_chunk(record: &ChunkRecord, stored: &[u8], raw: &mut [u8]) -> Result<(), ArchiveError> {
    if record.codec == Codec::Rows {
        raw.fill(0);
    }
    decode_chunk_into_zeros(record, stored, raw)
}

/// As [`decode_chunk`], into a `raw` that is all zero.
pub(super) fn decode_chunk_into_zeros(
    record: &ChunkRecord,
    stored: &[u8],
    raw: &mut [u8],
) -> Result<(), ArchiveError> {
    expect_equal("stored size", record.stored_bytes as usize, stored.len())?;
    expect_equal("raw size", record.raw_bytes as usize, raw.len())?;
    expect_equal("digest of the stored bytes", record.stored_digest, Digest::of(stored))?;
    match record.codec {
        Codec::Raw => {
            expect_equal("stored size of a raw chunk", raw.len(), stored.len())?;
            raw.copy_from_slice(stored);
        }
        Codec::Zstd => {
            let written = decompress(stored, raw)?;
            expect_equal("content of the zstd frame", raw.len(), written)?;
        }
        Codec::Rows => tiles::decode_into_zeros(stored, raw)?,
        Codec::Masks => mask_code::decode(stored, raw)?,
    }
    Ok(())
}

/// Decompresses a frame into a buffer that is large enough for any honest one; how much it filled.
fn decompress(stored: &[u8], content: &mut [u8]) -> Result<usize, ArchiveError> {
    let most = content.len();
    DECOMPRESSOR
        .with_borrow_mut(|slot| {
            if slot.is_none() {
                *slot = Some(Decompressor::new()?);
            }
            let Some(decompressor) = slot else { return Err(io::Error::other("no decompressor")) };
            decompressor.decompress_to_buffer(stored, content)
        })
        .map_err(|error| corrupt("content of the zstd frame", format!("{most} bytes at most"), error))
}
