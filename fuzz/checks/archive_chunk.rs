//! Any bytes as the stored bytes of a chunk whose digest fits: refused, or content of the declared size. And any bytes
//! as content: they come back.

use manyview_cache::archive::{ChunkRecord, Codec, CompressedChunk, MAX_CHUNK_BYTES, decode_chunk};
use manyview_cache::digest::Digest;

/// Fails if the rule is broken.
pub(crate) fn check(data: &[u8]) {
    let Some((&[size_0, size_1, size_2, codec], stored)) = data.split_first_chunk::<4>() else { return };
    let raw_bytes = u32::from_le_bytes([size_0, size_1, size_2, 0]).min(MAX_CHUNK_BYTES as u32);
    let record = ChunkRecord {
        offset: 64,
        stored_bytes: stored.len() as u32,
        raw_bytes,
        codec: match codec {
            0 => Codec::Raw,
            1 => Codec::Zstd,
            2 => Codec::Rows,
            _ => Codec::Masks,
        },
        stored_digest: Digest::of(stored),
    };
    let mut raw = vec![0; raw_bytes as usize];
    _ = decode_chunk(&record, stored, &mut raw);

    if (1..=MAX_CHUNK_BYTES).contains(&stored.len()) {
        let (chunk, compressed) = if codec & 8 == 0 {
            (CompressedChunk::compress(stored, i32::from(codec % 8)), Codec::Zstd)
        } else {
            // What is no whole lines is compressed as it is.
            let chunk = CompressedChunk::compress_rows(stored, 4 << (codec % 4));
            let compressed = chunk.codec();
            (chunk, compressed)
        };
        let codec = if chunk.stored().len() < stored.len() { compressed } else { Codec::Raw };
        let record = ChunkRecord {
            offset: 64,
            stored_bytes: chunk.stored().len() as u32,
            raw_bytes: chunk.raw_bytes(),
            codec,
            stored_digest: Digest::of(chunk.stored()),
        };
        let mut back = vec![0; stored.len()];
        decode_chunk(&record, chunk.stored(), &mut back).expect("what was compressed is decoded");
        assert_eq!(back, stored);
    }
    check_masks(stored);
}

/// Bytes as which of a cube's voxels are filled: all levels of its masks come back.
fn check_masks(filled: &[u8]) {
    let mut levels = Vec::new();
    let mut masks = filled[..filled.len().min(1 << 12)].to_vec();
    loop {
        levels.push(masks.iter().copied().filter(|&mask| mask != 0).collect::<Vec<u8>>());
        if masks.len() <= 1 {
            break;
        }
        let above =
            |masks: &[u8]| (0..).zip(masks).fold(0, |above, (i, &mask)| above | u8::from(mask != 0) << i);
        masks = masks.chunks(8).map(above).collect();
    }
    levels.reverse();
    if levels[0].is_empty() {
        return;
    }
    let slices: Vec<&[u8]> = levels.iter().map(Vec::as_slice).collect();
    for (level, chunk) in levels.iter().zip(CompressedChunk::compress_masks(&slices, 0)) {
        assert_eq!(&chunk.content().expect("what was coded is decoded"), level);
    }
}
