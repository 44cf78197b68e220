//! Any bytes as an index, with a header that fits them: refused, or everything that it says holds.

use manyview_cache::archive::{ALIGNMENT, HEADER_BYTES, Header, Index, MAX_CHUNK_BYTES};
use manyview_cache::digest::Digest;

/// Fails if the rule is broken.
pub(crate) fn check(data: &[u8]) {
    // Header::decode must cope with any start, too.
    _ = Header::decode(data, data.len() as u64);
    let Some((offset, index_bytes)) = data.split_first_chunk::<8>() else { return };
    // An offset as a header may have it; the payload need not exist.
    let index_offset =
        (u64::from_le_bytes(*offset) >> 1).next_multiple_of(ALIGNMENT).max(HEADER_BYTES as u64);
    let header = Header {
        index_offset,
        index_bytes: index_bytes.len() as u32,
        file_bytes: index_offset + index_bytes.len() as u64,
        index_digest: Digest::of(index_bytes),
    };
    let Ok(header) = Header::decode(&header.encode(), header.file_bytes) else { return };
    let Ok(index) = Index::decode(&header, index_bytes) else { return };
    let mut end = HEADER_BYTES as u64;
    for chunk in &index.chunks {
        assert!(chunk.offset >= end && chunk.end() <= header.index_offset);
        assert!(
            (1..=MAX_CHUNK_BYTES).contains(&(chunk.raw_bytes as usize))
                && chunk.stored_bytes <= chunk.raw_bytes
        );
        end = chunk.end();
    }
    let mut next = 0;
    for section in &index.sections {
        assert_eq!(section.chunks.start, next);
        next = section.chunks.end;
        let chunks = &index.chunks[section.chunks.start as usize..section.chunks.end as usize];
        assert_eq!(section.raw_bytes, chunks.iter().map(|chunk| u64::from(chunk.raw_bytes)).sum::<u64>());
    }
    assert_eq!(next as usize, index.chunks.len());
}
