//! What is not an archive, or not a whole one, is refused by name.

use super::*;
use crate::archive::{
    ArchiveErrorKind, ChunkRecord, Codec, CompressedChunk, MAX_CHUNK_BYTES, MAX_INDEX_BYTES, SectionId,
    SectionName, decode_chunk,
};

/// What is in the message for a change of the index.
type Case<'a> = (&'a str, &'a dyn Fn(&mut Index));

/// The message of the error for an archive whose index is changed.
fn with_index(change: impl FnOnce(&mut Index)) -> String {
    let (payload, mut index) = disassemble(&small());
    change(&mut index);
    refused(&assemble(&payload, &index)).to_string()
}

#[test]
fn taking_apart_and_assembling_changes_nothing() {
    let (payload, index) = disassemble(&small());
    assert!(assemble(&payload, &index) == small());
}

#[test]
fn every_truncation_and_every_addition_is_refused() {
    let bytes = small();
    for length in 0..bytes.len() {
        refused(&bytes[..length]);
    }
    for extra in [0, 1] {
        let error = refused(&[&bytes[..], &[extra]].concat()).to_string();
        let (size, found) = (bytes.len(), bytes.len() + 1);
        assert!(error.ends_with(&format!("size of the file: expected {size}, found {found}")), "{error}");
    }
}

#[test]
fn every_changed_byte_is_found_and_those_of_header_and_index_on_opening() {
    let bytes = small();
    let index_offset = open(&bytes).unwrap().header().index_offset as usize;
    for at in 0..bytes.len() {
        for flip in [1, 0x80, 0xff] {
            let mut changed = bytes.clone();
            changed[at] ^= flip;
            assert!(check(&changed).is_err(), "byte {at} ^ {flip}");
            let opens = open(&changed).is_ok();
            assert_eq!(opens, (HEADER_BYTES..index_offset).contains(&at), "byte {at} ^ {flip}");
        }
    }
}

/// A changed index whose digest fits: the structure must still hold, or the content must not.
#[test]
fn every_changed_byte_of_a_resealed_index_is_found_but_in_names_and_items() {
    let bytes = small();
    let header = open(&bytes).unwrap().header().clone();
    let section_count = open(&bytes).unwrap().sections().len();
    let mut accepted = 0;
    for at in header.index_offset as usize..bytes.len() {
        for flip in 1..=255 {
            let mut changed = bytes.clone();
            changed[at] ^= flip;
            reseal(&mut changed, header.index_bytes as usize);
            if check(&changed).is_ok() {
                let at = at - header.index_offset as usize;
                let in_id = at < section_count * 72 && matches!(at % 72, 0..16 | 56..60);
                assert!(in_id, "byte {at} of the index ^ {flip}");
                accepted += 1;
            }
        }
    }
    assert!(accepted > 0, "another name is another archive");
}

#[test]
fn a_changed_payload_is_found_in_its_chunk_and_only_there() {
    let mut bytes = small();
    let chunk = open(&bytes).unwrap().chunks()[1].clone();
    bytes[chunk.offset as usize + 2] ^= 4;
    let archive = open(&bytes).unwrap();
    let error = archive.read_section(&section(&archive, "svo.mask", 3)).unwrap_err();
    assert_eq!((error.section().unwrap().to_string(), error.chunk()), ("svo.mask[3]".to_owned(), Some(1)));
    let message = error.to_string();
    let expected =
        "archive in memory: section svo.mask[3]: chunk 1: corrupt archive: digest of the stored bytes: ";
    assert!(message.starts_with(expected), "{message}");
    assert!(message.contains(&chunk.stored_digest.to_string()), "{message}");
    assert_eq!(archive.read_chunk(1, &mut Vec::new()).unwrap_err().to_string(), message);
    let report = archive.verify();
    assert_eq!(report.failures.iter().map(ToString::to_string).collect::<Vec<_>>(), [message]);
    assert_eq!(archive.read_section(&section(&archive, "rows", 0)).unwrap(), [7; 301]);
}

#[test]
fn verify_names_everything_that_is_wrong_in_the_order_of_the_file() {
    let (mut payload, mut index) = disassemble(&small());
    payload[index.chunks[0].offset as usize - HEADER_BYTES] ^= 1;
    payload[index.chunks[2].offset as usize - HEADER_BYTES] ^= 1;
    index.sections[1].digest = Digest::of(b"something else");
    let report = open(&assemble(&payload, &index)).unwrap().verify();
    let places: Vec<_> =
        report.failures.iter().map(|error| (error.section().unwrap().to_string(), error.chunk())).collect();
    let expected = [("meta[0]", Some(0)), ("svo.mask[3]", None), ("rows[0]", Some(2))];
    assert_eq!(places, expected.map(|(section, chunk)| (section.to_owned(), chunk)));
}

#[test]
fn padding_is_zeros() {
    let mut bytes = small();
    let chunk = open(&bytes).unwrap().chunks()[0].clone();
    bytes[chunk.end() as usize] = 1;
    let error = check(&bytes).unwrap_err().to_string();
    assert!(error.contains("section meta[0]: chunk 0: corrupt archive: padding behind the chunk"), "{error}");
}

#[test]
fn a_wrong_digest_of_a_section_is_found() {
    let (payload, mut index) = disassemble(&small());
    index.sections[2].digest = Digest::of(b"something else");
    let error = check(&assemble(&payload, &index)).unwrap_err().to_string();
    assert!(error.contains("section svo.mask[4]: corrupt archive: digest of the content"), "{error}");
}

#[test]
fn other_files_are_not_archives() {
    for (bytes, found) in
        [(&b""[..], "nothing"), (b"PNG", "\"PNG\""), (b"glTF\x02\0\0\0rest", r#""glTF\\x02\\x00"#)]
    {
        let error = refused(bytes);
        assert!(matches!(error.kind(), ArchiveErrorKind::NotAnArchive { .. }));
        assert!(error.to_string().contains(&format!("it begins with {found}")), "{error}");
    }
    let error = Archive::open("no/such/file.mvb").map(|_| ()).unwrap_err();
    assert!(matches!(error.kind(), ArchiveErrorKind::Read { .. }));
    assert!(error.to_string().starts_with("no/such/file.mvb: cannot read it: "), "{error}");
}

#[test]
fn unknown_versions_are_named_before_anything_else_is_read() {
    for (version, way_out) in
        [(0, "bake the scene again"), (2, "update manyview"), (u32::MAX, "update manyview")]
    {
        let mut bytes = small();
        bytes[8..12].copy_from_slice(&u32::to_le_bytes(version));
        // The rest means something else in that version.
        for length in [12, 40, bytes.len()] {
            let error = refused(&bytes[..length]).to_string();
            let expected =
                format!("archive format version {version}, but this program reads version 1; {way_out}");
            assert!(error.ends_with(&expected), "{error}");
        }
    }
}

#[test]
fn unknown_codecs_are_named() {
    let mut bytes = small();
    let header = open(&bytes).unwrap().header().clone();
    let codec_of_chunk_2 = header.index_offset as usize + 4 * 72 + 2 * 56 + 48;
    bytes[codec_of_chunk_2] = 7;
    reseal(&mut bytes, header.index_bytes as usize);
    let error = refused(&bytes);
    assert_eq!(error.chunk(), Some(2));
    assert!(error.to_string().contains("codec 7 is unknown"), "{error}");
}

#[test]
fn chunks_that_overlap_leave_gaps_or_leave_the_file_are_refused() {
    let cases: &[Case] = &[
        ("chunk 1: corrupt archive: offset: expected 80, found 64", &|index| index.chunks[1].offset = 64),
        ("chunk 1: corrupt archive: offset: expected 80, found 96", &|index| index.chunks[1].offset = 96),
        ("chunk 1: corrupt archive: offset: expected 80, found 81", &|index| index.chunks[1].offset = 81),
        ("chunk 0: corrupt archive: offset: expected 64, found 0", &|index| index.chunks[0].offset = 0),
        ("chunk 0: corrupt archive: offset", &|index| index.chunks[0].offset = u64::MAX - 7),
        ("chunk 2: corrupt archive: stored size: expected at most", &|index| {
            index.chunks[2].stored_bytes = 200;
            index.chunks[2].raw_bytes = 300;
        }),
        ("number of chunks in all sections: expected 3, found 2", &|index| _ = index.sections.pop()),
        ("offset of the index: expected", &|index| {
            index.chunks.pop();
            index.sections.pop();
        }),
    ];
    for (expected, change) in cases {
        let error = with_index(change);
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn sections_must_be_unique_and_take_the_chunks_in_order() {
    let cases: &[Case] = &[
        ("section svo.mask[3]: corrupt archive: number of sections with this name and item", &|index| {
            index.sections[2].id.item = 3;
        }),
        ("section svo.mask[3]: corrupt archive: first chunk: expected 1, found 0", &|index| {
            index.sections[1].chunks = 0..1;
        }),
        ("section rows[0]: corrupt archive: number of chunks: expected at most 1, found 2", &|index| {
            index.sections[3].chunks = 2..4;
        }),
        (
            "section rows[0]: corrupt archive: number of chunks: expected at most 1, found 4294967293",
            &|index| {
                index.sections[3].chunks = 2..u32::MAX;
            },
        ),
        ("section meta[0]: corrupt archive: raw size of the chunks: expected 9, found 8", &|index| {
            index.sections[0].raw_bytes = 9;
        }),
    ];
    for (expected, change) in cases {
        let error = with_index(change);
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn sizes_beyond_the_limits_are_refused() {
    let limit = MAX_CHUNK_BYTES as u32;
    let cases: &[Case] = &[
        ("raw size: expected 1 to 4194304, found 4194305", &|index| index.chunks[1].raw_bytes = limit + 1),
        ("raw size: expected 1 to 4194304, found 0", &|index| index.chunks[1].raw_bytes = 0),
        ("stored size of a raw chunk: expected 100, found 8", &|index| index.chunks[0].raw_bytes = 100),
        ("stored size of a compressed chunk: expected 1 to 0", &|index| index.chunks[1].raw_bytes = 1),
        ("stored size of a compressed chunk", &|index| index.chunks[1].stored_bytes = 0),
        ("raw size of the chunks: expected 18446744073709551615, found 1000", &|index| {
            index.sections[1].raw_bytes = u64::MAX;
        }),
    ];
    for (expected, change) in cases {
        let error = with_index(change);
        assert!(error.contains(expected), "{error}");
    }
}

/// Exabytes in the header claim nothing.
#[test]
fn headers_that_claim_too_much_are_refused() {
    let header = open(&small()).unwrap().header().clone();
    let file_bytes = header.file_bytes;
    let limit = MAX_INDEX_BYTES as u32;
    let refused_as =
        |header: Header, file_bytes| Header::decode(&header.encode(), file_bytes).unwrap_err().to_string();
    let exabyte = 1 << 60;
    let error = refused_as(Header { file_bytes: exabyte, ..header.clone() }, file_bytes);
    assert!(error.contains("size of the file"), "{error}");
    let error = refused_as(Header { index_bytes: limit + 1, file_bytes: exabyte, ..header.clone() }, exabyte);
    assert!(error.contains("size of the index: expected at most 67108864"), "{error}");
    for index_offset in
        [0, 48, exabyte, u64::MAX - 15, u64::MAX, header.index_offset + 16, header.index_offset - 16]
    {
        let error = refused_as(Header { index_offset, ..header.clone() }, file_bytes);
        assert!(error.contains("offset of the index"), "{error}");
    }
    let error = refused_as(Header { index_bytes: limit, ..header }, file_bytes);
    assert!(error.contains("offset of the index"), "{error}");
}

/// Vectors of the index that reach out of it, or lie on each other.
#[test]
fn indexes_that_are_no_index_are_refused() {
    let bytes = small();
    let index_bytes = open(&bytes).unwrap().header().index_bytes as usize;
    let root = bytes.len() - 16;
    for (at, value) in
        [(0, 0), (0, -1), (0, i32::MIN), (4, -1), (4, i32::MAX), (8, 8), (8, -16), (12, -1), (12, 0)]
    {
        let mut changed = bytes.clone();
        changed[root + at..root + at + 4].copy_from_slice(&i32::to_le_bytes(value));
        reseal(&mut changed, index_bytes);
        refused(&changed);
    }
    for index in [&[][..], &[0; 15], &[0; 17], &[0xff; 64]] {
        let mut changed = bytes[..root - index_bytes + 16].to_vec();
        changed.extend(index);
        reseal(&mut changed, index.len());
        refused(&changed);
    }
}

#[test]
fn a_section_larger_than_the_limit_is_refused_before_memory_is_taken() {
    let archive = open(&small()).unwrap().with_section_limit(999);
    let error = archive.read_section(&section(&archive, "svo.mask", 3)).unwrap_err();
    assert!(
        error.to_string().ends_with("the section holds 1000 bytes, more than the limit of 999"),
        "{error}"
    );
    archive.read_section(&section(&archive, "rows", 0)).unwrap();
}

#[test]
fn sections_of_another_archive_are_not_read() {
    let archive = open(&write(&[("rows", 0, b"short")])).unwrap();
    let foreign = section(&open(&small()).unwrap(), "rows", 0);
    let error = archive.read_section(&foreign).unwrap_err();
    assert!(matches!(error.kind(), ArchiveErrorKind::MissingSection), "{error}");
}

/// Two thousand chunks say that they are 4 MiB; memory is taken for the first few dozen, and not before they decode.
#[test]
fn chunks_that_lie_about_their_size_cost_little() {
    let frame = zstd::bulk::compress(&[0; 1000], 3).unwrap();
    let mut payload = Vec::new();
    let mut index = Index { sections: Vec::new(), chunks: Vec::new() };
    for number in 0..2000 {
        let mut chunk = chunk_of(&frame, MAX_CHUNK_BYTES as u32);
        chunk.offset = HEADER_BYTES as u64 + number * frame.len().next_multiple_of(16) as u64;
        payload.extend(&frame);
        payload.resize(payload.len().next_multiple_of(16), 0);
        index.chunks.push(chunk);
    }
    let id = SectionId { name: "lies".parse().unwrap(), item: 0 };
    let raw_bytes = 2000 * MAX_CHUNK_BYTES as u64;
    index.sections.push(Section { id, chunks: 0..2000, raw_bytes, digest: Digest::of(b"") });
    let archive = open(&assemble(&payload, &index)).unwrap();
    let mut content = Vec::new();
    let error = archive.read_section_into(&section(&archive, "lies", 0), &mut content).unwrap_err();
    assert_eq!(error.chunk(), Some(0), "{error}");
    assert!(content.capacity() <= 64 * MAX_CHUNK_BYTES, "{} bytes were taken", content.capacity());
    assert_eq!(archive.verify().failures.len(), 2000);
}

fn chunk_of(stored: &[u8], raw_bytes: u32) -> ChunkRecord {
    let stored_bytes = stored.len() as u32;
    ChunkRecord { offset: 64, stored_bytes, raw_bytes, codec: Codec::Zstd, stored_digest: Digest::of(stored) }
}

/// The declared size, not the frame, says how much is written.
#[test]
fn frames_of_another_size_than_declared_are_corrupt() {
    let bomb = zstd::bulk::compress(&vec![0; 64 << 20], 3).unwrap();
    let frame = zstd::bulk::compress(&[1; 1000], 3).unwrap();
    let without_size = zstd::encode_all(&[1; 1000][..], 3).unwrap();
    let two_frames = [&frame[..], &frame].concat();
    let cases = [(&bomb, 20_000), (&frame, 999), (&frame, 1001), (&two_frames, 1000), (&without_size, 999)];
    for (number, (stored, raw_bytes)) in cases.into_iter().enumerate() {
        let mut raw = vec![0; raw_bytes];
        let error = decode_chunk(&chunk_of(stored, raw_bytes as u32), stored, &mut raw).unwrap_err();
        let message = error.to_string();
        assert!(message.contains("content of the zstd frame: expected"), "case {number}: {message}");
    }
    let mut raw = [0; 1000];
    decode_chunk(&chunk_of(&without_size, 1000), &without_size, &mut raw).unwrap();
    assert_eq!(raw, [1; 1000]);
}

#[test]
fn damaged_frames_whose_digest_fits_do_no_harm() {
    let content: Vec<u8> = (0..5000_u32).map(|i| (i * i / 77) as u8 & 0x33).collect();
    let frame = CompressedChunk::compress(&content, 3).stored().to_vec();
    let mut raw = vec![0; content.len()];
    for at in 0..frame.len() {
        let mut changed = frame.clone();
        changed[at] ^= 0x55;
        // Some changes give other content of the same size; only a panic or a write out of bounds would be wrong.
        _ = decode_chunk(&chunk_of(&changed, content.len() as u32), &changed, &mut raw);
        let cut = &frame[..at];
        decode_chunk(&chunk_of(cut, content.len() as u32), cut, &mut raw).unwrap_err();
    }
}

#[test]
fn stored_names_are_characters_then_zeros() {
    assert!(
        SectionName::from_stored(*b"svo.mask\0\0\0\0\0\0\0\0")
            .is_some_and(|name| name.as_str() == "svo.mask")
    );
    assert!(
        SectionName::from_stored(*b"sixteen.letters_")
            .is_some_and(|name| name.as_str() == "sixteen.letters_")
    );
    for stored in [
        b"\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0",
        b"a\0b\0\0\0\0\0\0\0\0\0\0\0\0\0",
        b"A\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0",
    ] {
        assert!(SectionName::from_stored(*stored).is_none());
    }
}
