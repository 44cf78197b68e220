//! Whole bakes, damaged in every way that a disk, a network or an enemy knows: refused as corrupt, by name, in bounded
//! memory, and never read as another bake.
#![cfg(feature = "bake")]

mod support;

use std::ops::Range;

use manyview::{Archive, LoadError};
use manyview_cache::archive::{Archive as Container, HEADER_BYTES};
use manyview_cache::digest::Digest;
use support::{Numbers, bake_levels_and_directions};

/// An octree of 4 levels and 3 × 3 directions of 32³.
fn town() -> Vec<u8> {
    bake_levels_and_directions(4, 5, 3, 3)
}

fn container(bytes: &[u8]) -> Container {
    Container::from_bytes(bytes.to_vec()).unwrap()
}

/// Where the index lies.
fn index_range(bytes: &[u8]) -> Range<usize> {
    let container = container(bytes);
    container.header().index_offset as usize..bytes.len()
}

/// Opens an archive and reads all that is in it.
fn load_all(bytes: &[u8]) -> Result<(), LoadError> {
    let archive = Archive::from_bytes(bytes.to_vec())?;
    archive.lights()?;
    archive.svo()?;
    archive.frames()?;
    (0..archive.row_block_count()).try_for_each(|block| archive.row_block(block).map(|_| ()))
}

fn expect_corrupt(bytes: &[u8], what: &str) {
    match load_all(bytes) {
        Ok(()) => panic!("{what}: accepted"),
        // Nothing but its first bytes tells what a file is.
        Err(error) if bytes.len() < 8 || bytes[..8] != town_magic() => {
            assert!(error.to_string().contains("not a manyview archive"), "{what}: {error}");
        }
        Err(error) => assert!(error.is_corruption(), "{what}: {error}"),
    }
}

fn town_magic() -> [u8; 8] {
    manyview_cache::archive::MAGIC
}

/// Writes a header with a digest that fits the index, whatever is in it.
fn reseal(bytes: &mut [u8], index: Range<usize>) {
    let digest = Digest::of(&bytes[index]);
    bytes[32..HEADER_BYTES].copy_from_slice(digest.as_bytes());
}

#[test]
fn the_undamaged_bake_is_read() {
    load_all(&town()).unwrap();
}

#[test]
fn a_bake_cut_at_any_border_of_a_chunk_is_corrupt() {
    let town = town();
    let container = container(&town);
    let mut borders = vec![0, HEADER_BYTES, container.header().index_offset as usize];
    for chunk in container.chunks() {
        borders.extend([chunk.offset as usize, chunk.end() as usize]);
    }
    assert!(borders.len() > 20);
    for border in borders {
        for length in [border.saturating_sub(1), border, border + 1] {
            expect_corrupt(&town[..length], &format!("cut at {length}"));
        }
    }
}

#[test]
fn a_bake_cut_at_a_thousand_places_is_corrupt() {
    let town = town();
    let mut numbers = Numbers(0x5eed);
    for _ in 0..1000 {
        let length = numbers.next() as usize % town.len();
        expect_corrupt(&town[..length], &format!("cut at {length}"));
    }
}

#[test]
fn bytes_added_anywhere_are_corrupt() {
    let town = town();
    let mut numbers = Numbers(0xadd);
    for _ in 0..200 {
        let at = 12 + numbers.next() as usize % (town.len() - 12);
        let count = 1 + numbers.next() as usize % 100;
        let mut longer = town.clone();
        longer.splice(at..at, vec![numbers.next() as u8; count]);
        expect_corrupt(&longer, &format!("{count} bytes more at {at}"));
    }
    expect_corrupt(&[&town[..], &[0]].concat(), "one byte more at the end");
    expect_corrupt(&[&town[..], &town].concat(), "the archive twice");
}

/// Every byte of the index, with a digest that does not fit it and with one that does: corrupt, or a bake without rows
/// where it is the name of their head that changed.
#[test]
fn every_byte_of_the_index_matters() {
    let town = town();
    let index = index_range(&town);
    let rows_head = index.clone().find(|&at| town[at..].starts_with(b"rows.info")).unwrap();
    // The name, and the item behind digest and size.
    let rows_head = rows_head..rows_head + 60;
    for at in index.clone() {
        for flip in [0x01, 0x80, 0xff] {
            let mut changed = town.clone();
            changed[at] ^= flip;
            expect_corrupt(&changed, &format!("byte {at} ^ {flip:#x}"));
            reseal(&mut changed, index.clone());
            let what = format!("byte {at} ^ {flip:#x}, resealed");
            match load_all(&changed) {
                Err(LoadError::NoRows { .. }) => assert!(rows_head.contains(&at), "{what}: no rows"),
                Err(error) => assert!(error.is_corruption(), "{what}: {error}"),
                // The loader reads no digest of a section's content, only those of chunks; `verify` reads both.
                Ok(()) => {
                    let report = container(&changed).verify();
                    assert!(!report.is_sound(), "{what}: accepted");
                    assert_eq!(report.failures.len(), 1, "{what}");
                    assert!(report.failures[0].to_string().contains("digest of the content"), "{what}");
                }
            }
        }
    }
}

/// Every number of the index, of chunks' offsets and sizes too, claims exabytes, with a digest that fits.
#[test]
fn numbers_that_claim_exabytes_take_nothing() {
    let town = town();
    let index = index_range(&town);
    for at in index.clone().step_by(8) {
        for value in [u64::MAX, 1 << 60, 1 << 40, u64::from(u32::MAX), i64::MAX as u64] {
            let mut changed = town.clone();
            let end = (at + 8).min(index.end);
            changed[at..end].copy_from_slice(&value.to_le_bytes()[..end - at]);
            reseal(&mut changed, index.clone());
            let opened = load_all(&changed).err();
            let found = opened.map(|error| (error.is_corruption(), error.to_string()));
            let sound = || container(&changed).verify().is_sound();
            assert!(
                found.as_ref().map_or_else(|| !sound(), |(corrupt, _)| *corrupt),
                "{value:#x} at {at}: {found:?}"
            );
        }
    }
    // And the header's own.
    for at in [12, 16, 24] {
        for value in [u64::MAX, 1 << 60, 1 << 40] {
            let mut changed = town.clone();
            changed[at..at + 8].copy_from_slice(&value.to_le_bytes());
            expect_corrupt(&changed, &format!("{value:#x} at {at} of the header"));
        }
    }
}

/// Two chunks share their bytes, or lie in each other, with digests that fit.
#[test]
fn chunks_that_overlap_are_corrupt() {
    let town = town();
    let index = index_range(&town);
    let chunks = container(&town).chunks().to_vec();
    let mut overlaps = 0;
    for pair in chunks.windows(2) {
        // The place of the second offset in the index: the only such eight bytes.
        let needle = pair[1].offset.to_le_bytes();
        let places: Vec<usize> =
            index.clone().filter(|&at| town[at..].starts_with(&needle) && at % 8 == 0).collect();
        for place in places {
            for offset in [pair[0].offset, pair[1].offset - 16] {
                let mut changed = town.clone();
                changed[place..place + 8].copy_from_slice(&offset.to_le_bytes());
                reseal(&mut changed, index.clone());
                expect_corrupt(&changed, &format!("offset {} became {offset}", pair[1].offset));
                overlaps += 1;
            }
        }
    }
    assert!(overlaps >= 2 * (chunks.len() - 1), "{overlaps} only");
}

/// As a shell sees it: the exit code, and the memory that the program may take (address space, so that an allocation of
/// a size that is merely claimed fails at once).
#[cfg(target_os = "linux")]
#[test]
fn commands_exit_with_5_within_a_gibibyte() {
    let town = town();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("broken.mvb");
    let index = index_range(&town);
    let mut cases: Vec<(String, Vec<u8>)> = vec![
        ("cut in the payload".to_owned(), town[..index.start / 2].to_vec()),
        ("cut in the index".to_owned(), town[..(index.start + index.end) / 2].to_vec()),
        ("longer".to_owned(), [&town[..], b"more"].concat()),
        ("a bomb".to_owned(), bomb(&town)),
    ];
    for at in [index.start + 48, index.start + 60, index.end - 16, index.end - 60] {
        let mut changed = town.clone();
        changed[at..at + 8].copy_from_slice(&(1_u64 << 60).to_le_bytes());
        reseal(&mut changed, index.clone());
        cases.push((format!("an exabyte at {at}"), changed));
    }
    for (what, bytes) in cases {
        fs_err::write(&path, bytes).unwrap();
        for command in ["verify", "inspect"] {
            let run = format!(
                "ulimit -v 1048576; exec '{}' {command} '{}'",
                env!("CARGO_BIN_EXE_manyview"),
                path.display()
            );
            // Few threads: on machines of many cores their stacks alone would be more.
            let mut shell = std::process::Command::new("sh");
            let output = shell.args(["-c", &run]).env("RAYON_NUM_THREADS", "2").output().unwrap();
            let stderr = String::from_utf8_lossy(&output.stderr);
            // Contents are not read by `inspect`.
            if command == "verify" || !what.contains("bomb") {
                assert_eq!(output.status.code(), Some(5), "{command}, {what}: {stderr}");
                assert!(stderr.contains("broken.mvb"), "{command}, {what}: {stderr}");
            }
        }
    }
}

/// The bake with a chunk whose few bytes decode to 64 MiB, and whose digests fit.
#[cfg(target_os = "linux")]
fn bomb(town: &[u8]) -> Vec<u8> {
    let container = container(town);
    let zeros = zstd_zeros();
    let mut bytes = town.to_vec();
    // Into the largest chunk, whose stored bytes then are the frame and what is left of the old ones.
    let chunk = container.chunks().iter().max_by_key(|chunk| chunk.stored_bytes).unwrap();
    assert!(chunk.stored_bytes as usize > zeros.len(), "the frame fits in");
    let start = chunk.offset as usize;
    let old_digest = chunk.stored_digest;
    bytes[start..start + zeros.len()].copy_from_slice(&zeros);
    let new_digest = Digest::of(&bytes[start..chunk.end() as usize]);
    let index = index_range(town);
    let place = index
        .clone()
        .find(|&at| bytes[at..].starts_with(old_digest.as_bytes()))
        .expect("the digest is in the index");
    bytes[place..place + 32].copy_from_slice(new_digest.as_bytes());
    reseal(&mut bytes, index);
    bytes
}

/// A zstd frame of 64 MiB of zeros, made of blocks that repeat one byte (RFC 8878, 3.1.1.2.2).
#[cfg(target_os = "linux")]
fn zstd_zeros() -> Vec<u8> {
    const BLOCK_BYTES: u32 = 128 << 10;
    const BLOCKS: u32 = 512;
    // Magic number; a frame of one segment with a content size of four bytes.
    let mut frame = vec![0x28, 0xb5, 0x2f, 0xfd, 0b1010_0000];
    frame.extend((BLOCKS * BLOCK_BYTES).to_le_bytes());
    for block in 1..=BLOCKS {
        let header = BLOCK_BYTES << 3 | 1 << 1 | u32::from(block == BLOCKS);
        frame.extend(&header.to_le_bytes()[..3]);
        frame.push(0);
    }
    frame
}
