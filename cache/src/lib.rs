//! Bytes at rest: the archive container, digests, atomic files, and the store. Knows nothing of voxels.
//!
//! - [`archive`]: the container `.mvb`, described below.
//! - [`atomic`]: output files that are either complete or absent.
//! - [`digest`]: BLAKE3 digests, and the stable encoding of keys.
//! - [`store`]: results of steps under the digests of what they were made from.
//!
//! ```
//! use manyview_cache::archive::{Archive, ArchiveWriter};
//!
//! let mut writer = ArchiveWriter::in_memory()?; // or ArchiveWriter::create("city.mvb")?
//! writer.begin_section("svo.mask", 0)?;
//! writer.append_raw(&[0xff; 1_000_000])?;
//! let (bytes, stats) = writer.finish()?;
//! assert_eq!(stats.raw_bytes, 1_000_000);
//! assert!(stats.file_bytes < 1_000);
//!
//! let archive = Archive::from_bytes(bytes)?; // or Archive::open("city.mvb")?
//! let masks = archive.expect_section("svo.mask", 0)?;
//! assert_eq!(archive.read_section(masks)?, [0xff; 1_000_000]);
//! assert!(archive.verify().is_sound());
//! # Ok::<(), manyview_cache::archive::ArchiveError>(())
//! ```
//!
//! # The archive, format version 1
//!
//! Named byte strings (*sections*), cut into *chunks* of at most 4 MiB that are compressed each on its own. The index
//! is at the end, so that archives are written from front to back, and is read without the payload, so that a reader
//! fetches only what it needs. Every byte is covered: the header's fields by checks, the index by the header's digest,
//! the chunks by the index's digests, the padding by being zero.
//!
//! ```text
//! header   64 bytes
//! chunk 0, zeros up to the next multiple of 16
//! chunk 1, zeros
//! …
//! index    to the end of the file
//! ```
//!
//! Integers are little-endian and unsigned; digests are BLAKE3 of 32 bytes.
//!
//! ## Header
//!
//! | offset | size | field |
//! |---|---|---|
//! | 0 | 8 | magic: `89 4d 56 42 0d 0a 1a 0a` (`\x89MVB\r\n\x1a\n`) |
//! | 8 | 4 | format version: 1 |
//! | 12 | 4 | size of the index, at most 64 MiB |
//! | 16 | 8 | offset of the index: the end of the last chunk that shares no bytes, rounded up to a multiple of 16 (64 if there is no chunk) |
//! | 24 | 8 | size of the file: offset + size of the index |
//! | 32 | 32 | digest of the index |
//!
//! Magic and version keep their place in all versions. Nothing behind them is read if the version is unknown.
//!
//! ## Index
//!
//! An [rkyv](https://rkyv.org) structure (little-endian, 32-bit offsets, aligned), which comes out as three parts
//! without gaps: the sections, the chunks, and 16 bytes for where those two lists are.
//!
//! A section, 72 bytes:
//!
//! | offset | size | field |
//! |---|---|---|
//! | 0 | 16 | name: 1 to 16 characters of `a-z 0-9 . _ -`, then zeros |
//! | 16 | 32 | digest of its content: over, for each chunk, its raw size (4 bytes) and the digest of its raw bytes |
//! | 48 | 8 | raw size: the sum of its chunks' |
//! | 56 | 4 | item: a number such as a level or a block |
//! | 60 | 4 | number of its first chunk |
//! | 64 | 4 | how many chunks it has; none is allowed |
//! | 68 | 4 | reserved, 0 |
//!
//! Name and item together are unique. The sections take all chunks, in order.
//!
//! A chunk, 56 bytes:
//!
//! | offset | size | field |
//! |---|---|---|
//! | 0 | 8 | offset in the file: the end of the chunk before (of the header), rounded up to a multiple of 16. Or, both of codec 5, that of an earlier chunk, whose first bytes it shares |
//! | 8 | 4 | stored size |
//! | 12 | 4 | raw size, 1 to 4 MiB |
//! | 16 | 32 | digest of the stored bytes |
//! | 48 | 1 | codec: 0 raw (stored = raw size), 1 one zstd frame (stored < raw size), 4 rows in tiles ([`archive::tiles`]; stored < raw size), 5 child masks ([`archive::mask_code`]; stored < raw size); 2 and 3 are those of older versions. A reader that does not know a codec says so |
//! | 49 | 7 | reserved, 0 |
//!
//! The last 16 bytes, as rkyv writes two vectors:
//!
//! | offset | size | field |
//! |---|---|---|
//! | 0 | 4 | where the first section is, relative to this field (signed) |
//! | 4 | 4 | number of sections |
//! | 8 | 4 | where the first chunk is, relative to this field (signed) |
//! | 12 | 4 | number of chunks |
//!
//! A reader refuses whatever differs from this. A change of any of it gets a new format version.

pub mod archive;
pub mod atomic;
pub mod digest;
pub mod scratch;
pub mod store;
