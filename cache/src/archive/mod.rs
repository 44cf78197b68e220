//! The archive container. The file layout is described at the [top of the crate](crate).

mod chunk;
mod error;
mod format;
pub mod mask_code;
mod reader;
pub mod row_code;
pub mod row_model;
mod source;
mod spool;
pub mod tiles;
mod verify;
mod writer;

#[cfg(test)]
mod tests;

pub use chunk::{Codec, CompressedChunk, decode_chunk};
pub use error::{ArchiveError, ArchiveErrorKind};
pub use format::{
    ALIGNMENT, ChunkRecord, FORMAT_VERSION, HEADER_BYTES, Header, Index, MAGIC, MAX_CHUNK_BYTES,
    MAX_INDEX_BYTES, Section, SectionId, SectionName,
};
pub use reader::Archive;
pub use row_code::TILE_BYTES;
pub use source::ByteSource;
pub use spool::{ChunkSpool, SpooledChunk};
pub use tiles::TileEditor;
pub use verify::VerifyReport;
pub use writer::{ArchiveStats, ArchiveWriter, DEFAULT_LEVEL};
