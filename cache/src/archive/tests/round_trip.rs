//! What is written is what is read.

use std::io::{self, Cursor, Seek, SeekFrom, Write};
use std::sync::Mutex;

use proptest::prelude::*;

use super::*;
use crate::archive::{ByteSource, Codec, CompressedChunk, HEADER_BYTES, MAX_CHUNK_BYTES};

/// Bytes that zstd cannot shrink, the same on every run.
fn noise(count: usize) -> Vec<u8> {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state as u8
    };
    (0..count).map(|_| next()).collect()
}

#[test]
fn an_archive_without_sections_is_header_and_index() {
    let (bytes, stats) = writer().finish().unwrap();
    assert_eq!(bytes.len(), HEADER_BYTES + 16);
    assert_eq!((stats.sections, stats.chunks, stats.raw_bytes, stats.file_bytes), (0, 0, 0, 80));
    let archive = open(&bytes).unwrap();
    assert!(archive.sections().is_empty() && archive.verify().is_sound());
}

#[test]
fn sections_of_any_size_come_back() {
    let noise = noise(3 * MAX_CHUNK_BYTES + 1);
    for size in [0, 1, 15, 16, 17, MAX_CHUNK_BYTES - 1, MAX_CHUNK_BYTES, MAX_CHUNK_BYTES + 1, noise.len()] {
        let zeros = vec![0; size];
        let bytes = write(&[("noise", 0, &noise[..size]), ("zeros", 0, &zeros), ("last", 0, b"!")]);
        let archive = open(&bytes).unwrap();
        assert!(
            archive.read_section(&section(&archive, "noise", 0)).unwrap() == noise[..size],
            "{size} of noise"
        );
        assert!(archive.read_section(&section(&archive, "zeros", 0)).unwrap() == zeros, "{size} zeros");
        assert_eq!(archive.read_section(&section(&archive, "last", 0)).unwrap(), b"!");
        let report = archive.verify();
        assert!(report.is_sound(), "{:?}", report.failures);
        assert_eq!(report.chunks, 2 * size.div_ceil(MAX_CHUNK_BYTES) + 1);
        assert_eq!(report.raw_bytes, 2 * size as u64 + 1);
    }
}

#[test]
fn a_thousand_sections_are_found_by_name_and_item() {
    let mut writer = writer();
    for item in 0..1000 {
        writer.begin_section(["even", "odd"][item as usize % 2], item / 2).unwrap();
        writer.append_raw(&item.to_le_bytes()).unwrap();
    }
    let archive = open(&writer.finish().unwrap().0).unwrap();
    for item in 0..1000_u32 {
        let found = section(&archive, ["even", "odd"][item as usize % 2], item / 2);
        assert_eq!(archive.read_section(&found).unwrap(), item.to_le_bytes());
    }
    assert!(archive.section("even", 500).is_none() && archive.section("No Name", 0).is_none());
    let error = archive.expect_section("even", 500).unwrap_err();
    assert_eq!(error.to_string(), "archive in memory: section even[500]: the archive has no such section");
}

#[test]
fn chunks_compressed_elsewhere_equal_chunks_compressed_here() {
    let content = [noise(10_000), vec![1; 90_000]].concat();
    let mut by_hand = writer();
    by_hand.begin_section("a", 0).unwrap();
    by_hand.append(&CompressedChunk::compress(&content, super::super::DEFAULT_LEVEL)).unwrap();
    assert!(by_hand.finish().unwrap().0 == write(&[("a", 0, &content)]));
}

#[test]
fn the_same_content_gives_the_same_bytes_on_any_number_of_threads() {
    let content: Vec<u8> = noise(6 * MAX_CHUNK_BYTES).iter().map(|byte| byte & 0x11).collect();
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| write(&[("a", 0, &content)]))
    };
    assert!(on(1) == on(3));
}

#[test]
fn incompressible_chunks_are_stored_as_they_are_and_others_are_smaller() {
    let bytes = write(&[("noise", 0, &noise(500)), ("zeros", 0, &[0; 500])]);
    let archive = open(&bytes).unwrap();
    let [noise, zeros] = archive.chunks() else { panic!("two chunks") };
    assert_eq!((noise.codec, noise.stored_bytes), (Codec::Raw, 500));
    assert_eq!(zeros.codec, Codec::Zstd);
    assert!(zeros.stored_bytes < 30);
}

#[test]
fn the_digest_of_a_section_does_not_depend_on_the_level() {
    let content: Vec<u8> = noise(50_000).iter().map(|byte| byte & 3).collect();
    let at = |level| {
        let mut writer = writer().with_level(level);
        writer.begin_section("a", 0).unwrap();
        writer.append_raw(&content).unwrap();
        writer.finish().unwrap().0
    };
    let (fast, small) = (at(1), at(19));
    assert!(small.len() < fast.len());
    assert_eq!(open(&fast).unwrap().sections()[0].digest, open(&small).unwrap().sections()[0].digest);
    // By the definition in the format's description.
    let mut expected = 50_000_u32.to_le_bytes().to_vec();
    expected.extend(Digest::of(&content).as_bytes());
    assert_eq!(open(&fast).unwrap().sections()[0].digest, Digest::of(&expected));
}

/// Reads an archive by the tables at the top of the crate, without the reader.
#[test]
fn the_layout_is_the_documented_one() {
    let bytes = write(&[("meta", 7, b"manyview!"), ("b", 1, &[9; 100])]);
    let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let u64_at = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
    assert_eq!(&bytes[..8], b"\x89MVB\r\n\x1a\n");
    assert_eq!(u32_at(8), 1, "version");
    let index = u64_at(16);
    assert_eq!((u32_at(12), u64_at(24)), (bytes.len() - index, bytes.len()));
    assert_eq!(bytes[32..64], *blake3::hash(&bytes[index..]).as_bytes());
    assert_eq!(bytes.len() - index, 2 * 72 + 2 * 56 + 16);

    let (sections, chunks) = (index, index + 2 * 72);
    assert_eq!(&bytes[sections..sections + 16], b"meta\0\0\0\0\0\0\0\0\0\0\0\0");
    let content = [&9_u32.to_le_bytes()[..], blake3::hash(b"manyview!").as_bytes()].concat();
    assert_eq!(bytes[sections + 16..sections + 48], *blake3::hash(&content).as_bytes());
    let numbers =
        [u64_at(sections + 48), u32_at(sections + 56), u32_at(sections + 60), u32_at(sections + 64)];
    assert_eq!(numbers, [9, 7, 0, 1], "raw size, item, first chunk, count of chunks");
    assert_eq!(u32_at(sections + 68), 0, "reserved");
    assert_eq!([u32_at(sections + 72 + 56), u32_at(sections + 72 + 60)], [1, 1], "item and first chunk of b");

    assert_eq!([u64_at(chunks), u32_at(chunks + 8), u32_at(chunks + 12)], [64, 9, 9], "offset, sizes");
    assert_eq!(bytes[chunks + 16..chunks + 48], *blake3::hash(b"manyview!").as_bytes());
    assert_eq!(bytes[chunks + 48..chunks + 56], [0; 8], "codec raw, reserved");
    assert_eq!(&bytes[64..80], b"manyview!\0\0\0\0\0\0\0");
    assert_eq!([u64_at(chunks + 56), u32_at(chunks + 56 + 12)], [80, 100]);
    assert_eq!(bytes[chunks + 56 + 48], 1, "codec zstd");
    let stored = &bytes[80..80 + u32_at(chunks + 56 + 8)];
    assert_eq!(zstd::bulk::decompress(stored, 1000).unwrap(), [9; 100]);
}

/// An archive of version 1, as first written. It must be read for as long as version 1 is.
#[test]
fn frozen_version_1_is_read() {
    let bytes: Vec<u8> = FROZEN_V1.iter().flat_map(|line| decode_hex(line)).collect();
    let archive = open(&bytes).unwrap();
    assert_eq!(archive.read_section(&section(&archive, "meta", 7)).unwrap(), b"manyview");
    assert_eq!(archive.read_section(&section(&archive, "zeros", 4_000_000_000)).unwrap(), [0; 300]);
    assert!(archive.verify().is_sound());
}

const FROZEN_V1: [&str; 8] = [
    "894d56420d0a1a0a0100000010010000700000000000000080010000000000004f6d4771c901dbf9b7e9da7fb2533ba0",
    "2bf12637b7c93e8ccf84eff0c60c2e056d616e7976696577000000000000000028b52ffd602c004d0000100000010027",
    "2ac002000000000000000000000000006d6574610000000000000000000000008c85f71043a5b9fa72213794ea8b1978",
    "372747818eb131e346cc45a9ae8426cb0800000000000000070000000000000001000000000000007a65726f73000000",
    "0000000000000000b6fe07cc0e0a6a2ad6ba30f6bc38ea2017f4a52e793d624b1f417378ecfe84012c01000000000000",
    "00286bee0100000001000000000000004000000000000000080000000800000048894ca06f1f5a24c7fee5d300a648a3",
    "f9763afd48c1944f3367b6d482da5d0000000000000000005000000000000000130000002c010000f4d1678646dd3cf4",
    "886afce01da0443ccabca4c3bd7e91d9347f35cbdedd1db2010000000000000000ffffff0200000088ffffff02000000",
];

fn decode_hex(line: &str) -> Vec<u8> {
    line.as_bytes()
        .chunks(2)
        .map(|pair| u8::from_str_radix(str::from_utf8(pair).unwrap(), 16).unwrap())
        .collect()
}

/// Notes which ranges are read.
struct Watched {
    bytes: Vec<u8>,
    reads: &'static Mutex<Vec<(u64, usize)>>,
}

impl ByteSource for Watched {
    fn byte_count(&self) -> io::Result<u64> {
        self.bytes.byte_count()
    }

    fn read_exact_at(&self, offset: u64, buffer: &mut [u8]) -> io::Result<()> {
        self.reads.lock().unwrap().push((offset, buffer.len()));
        self.bytes.read_exact_at(offset, buffer)
    }
}

#[test]
fn opening_reads_no_payload_and_a_section_is_read_alone() {
    static READS: Mutex<Vec<(u64, usize)>> = Mutex::new(Vec::new());
    let bytes = small();
    let size = bytes.len();
    let archive =
        Archive::from_source(Box::new(Watched { bytes, reads: &READS }), "watched".to_owned()).unwrap();
    let index_offset = archive.header().index_offset;
    let opening = [(0, HEADER_BYTES), (index_offset, size - index_offset as usize)];
    assert_eq!(*READS.lock().unwrap(), opening);
    READS.lock().unwrap().clear();
    archive.read_section(&section(&archive, "svo.mask", 3)).unwrap();
    let chunk = &archive.chunks()[1];
    assert_eq!(*READS.lock().unwrap(), [(chunk.offset, chunk.stored_bytes as usize)]);
}

#[test]
fn a_file_is_read_like_memory() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mvb");
    let mut writer = ArchiveWriter::create(&path).unwrap();
    let content = noise(5 * MAX_CHUNK_BYTES);
    writer.begin_section("a", 0).unwrap();
    writer.append_raw(&content).unwrap();
    assert!(!path.exists(), "not before it is finished");
    let stats = writer.finish().unwrap();
    let archive = Archive::open(&path).unwrap();
    assert_eq!(stats.file_bytes, fs_err::metadata(&path).unwrap().len());
    assert!(archive.read_section(&archive.sections()[0]).unwrap() == content);
    let mut chunk = vec![1, 2, 3];
    archive.read_chunk(4, &mut chunk).unwrap();
    assert!(chunk == content[4 * MAX_CHUNK_BYTES..]);
    assert!(archive.verify().is_sound());
    assert!(fs_err::read(&path).unwrap() == write(&[("a", 0, &content)]));
}

#[test]
fn memory_of_the_caller_is_used_again() {
    let archive = open(&small()).unwrap();
    let mut content = vec![0xee; 5000];
    let address = content.as_ptr();
    for (name, item, expected) in
        [("meta", 0, &b"manyview"[..]), ("svo.mask", 3, &[0x5a; 1000]), ("svo.mask", 4, b"")]
    {
        archive.read_section_into(&section(&archive, name, item), &mut content).unwrap();
        assert_eq!((&content[..], content.as_ptr()), (expected, address));
    }
}

#[test]
fn an_unfinished_archive_leaves_the_old_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mvb");
    fs_err::write(&path, "old").unwrap();
    let mut writer = ArchiveWriter::create(&path).unwrap();
    writer.begin_section("a", 0).unwrap();
    writer.append_raw(&noise(3 << 20)).unwrap();
    drop(writer);
    assert_eq!(fs_err::read(&path).unwrap(), b"old");
    assert_eq!(fs_err::read_dir(folder.path()).unwrap().count(), 1, "nothing beside it");
}

#[test]
fn what_the_format_cannot_express_is_refused() {
    let message = |error: Result<(), ArchiveError>| error.unwrap_err().to_string();
    let mut writer = writer();
    assert!(message(writer.append_raw(b"x")).contains("begin one first"));
    for name in ["", "Upper", "a b", "seventeen.letters", "é", "nul\0"] {
        assert!(message(writer.begin_section(name, 0)).contains("1 to 16 characters"), "{name:?}");
    }
    writer.begin_section("sixteen.letters_", 0).unwrap();
    assert!(message(writer.begin_section("sixteen.letters_", 0)).contains("already has this section"));
    // A refused call leaves no trace.
    writer.append_raw(b"x").unwrap();
    check(&writer.finish().unwrap().0).unwrap();
}

#[test]
#[should_panic(expected = "more than a chunk takes")]
fn oversized_chunks_are_a_bug_of_the_caller() {
    CompressedChunk::compress(&vec![0; MAX_CHUNK_BYTES + 1], 1);
}

/// A disk with room for some bytes.
struct SmallDisk(Cursor<Vec<u8>>, usize);

impl Write for SmallDisk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.0.position() as usize + bytes.len() > self.1 {
            return Err(io::ErrorKind::StorageFull.into());
        }
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for SmallDisk {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        self.0.seek(position)
    }
}

#[test]
fn a_full_disk_is_named_with_the_way_out() {
    let mut writer = ArchiveWriter::new(SmallDisk(Cursor::default(), 1000), "city.mvb".to_owned()).unwrap();
    writer.begin_section("a", 0).unwrap();
    let error = writer.append_raw(&noise(2000)).unwrap_err().to_string();
    assert!(error.starts_with("city.mvb: cannot write it: "), "{error}");
    assert!(error.contains("free some space"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_content_comes_back(
        sections in prop::collection::vec(prop::collection::vec(prop::collection::vec(any::<u8>(), 1..200), 0..4), 0..6),
        level in -5..12,
    ) {
        let mut writer = writer();
        for (item, chunks) in sections.iter().enumerate() {
            writer.begin_section("any", item as u32).unwrap();
            for chunk in chunks {
                writer.append(&CompressedChunk::compress(chunk, level)).unwrap();
            }
        }
        let archive = open(&writer.finish().unwrap().0).unwrap();
        for (item, chunks) in sections.iter().enumerate() {
            let found = section(&archive, "any", item as u32);
            prop_assert_eq!(found.chunks.len(), chunks.len());
            prop_assert_eq!(archive.read_section(&found).unwrap(), chunks.concat());
        }
        prop_assert!(archive.verify().is_sound());
    }
}
