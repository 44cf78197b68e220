//! Child masks: coded, stored once for all levels, refused where they are other than coded.

use proptest::prelude::*;

use super::super::mask_code::{MAX_LEVELS, decode, encode, ends};
use super::super::{Archive, ChunkRecord, Codec, CompressedChunk};
use super::{assemble, check, disassemble, open, refused, writer};
use crate::archive::ArchiveError;
use crate::digest::Digest;

/// The masks of all levels above `2^depth` cells a side, of which some are filled.
fn octree(depth: usize, is_filled: impl Fn([u32; 3]) -> bool) -> Vec<Vec<u8>> {
    let cell =
        |code: usize| [0, 1, 2].map(|axis| (0..depth).fold(0, |c, i| c | (code >> (3 * i + axis) & 1) << i));
    let mut filled: Vec<bool> =
        (0..1usize << (3 * depth)).map(|code| is_filled(cell(code).map(|c| c as u32))).collect();
    let mut levels = Vec::new();
    for _ in 0..depth {
        let masks: Vec<u8> =
            filled.chunks(8).map(|cells| (0..8).fold(0, |mask, i| mask | u8::from(cells[i]) << i)).collect();
        filled = masks.iter().map(|&mask| mask != 0).collect();
        levels.push(masks.into_iter().filter(|&mask| mask != 0).collect());
    }
    levels.reverse();
    levels
}

fn slices(levels: &[Vec<u8>]) -> Vec<&[u8]> {
    levels.iter().map(Vec::as_slice).collect()
}

/// Scrambles an integer.
fn noise(seed: u32) -> u32 {
    let mixed = (seed ^ seed >> 15).wrapping_mul(0x2c1b_3c6d);
    (mixed ^ mixed >> 12).wrapping_mul(0x297a_2d39) ^ mixed >> 9
}

/// One of some kinds of octrees with at least one voxel.
fn some_octree(kind: u32, depth: usize, seed: u32) -> Vec<Vec<u8>> {
    let size = 1 << depth;
    let chosen = [0, 10, 20].map(|shift| noise(seed) >> shift & (size - 1));
    octree(depth, |cell| {
        let [x, y, z] = cell;
        let of_kind = match kind {
            0 => false,
            1 => true,
            2 => (x + 2 * y).abs_diff(3 * z) < 3,
            3 => {
                cell.iter().map(|c| (2 * c + 1).abs_diff(size).pow(2)).sum::<u32>().abs_diff(size * size)
                    < 4 * size
            }
            4 => noise(seed ^ (x | y << 8 | z << 16)).is_multiple_of(50),
            _ => noise(seed ^ (x | y << 8 | z << 16)).is_multiple_of(2),
        };
        of_kind || cell == chosen
    })
}

/// All levels of a form whose first part has one level.
fn decode_all(stored: &[u8]) -> Result<Vec<Vec<u8>>, ArchiveError> {
    let mut levels: Vec<Vec<u8>> = Vec::new();
    for end in ends(stored) {
        let bits = |masks: &Vec<u8>| masks.iter().map(|mask| mask.count_ones() as usize).sum();
        let mut masks = vec![0x55; levels.last().map_or(1, bits)];
        decode(&stored[..end], &mut masks)?;
        levels.push(masks);
    }
    Ok(levels)
}

#[test]
fn a_known_form() {
    // A voxel in a corner, another in the opposite one: the root's mask, then two masks.
    let forms = encode(&[&[0x81], &[0x01, 0x80]], 0);
    assert_eq!(forms.len(), 2);
    assert_eq!(forms[0], [1, 4, 0, 0, 0, 125, 255, 248, 0], "one level, four bytes");
    assert_eq!(forms[1][..9], forms[0]);
    assert_eq!(forms[1][9..], [5, 0, 0, 0, 207, 234, 194, 158, 0]);
    let shell = encode(&slices(&some_octree(3, 6, 7)), 4);
    let frozen = "f0995db4518ea163356fe23ac3d8e084bf56cb1f25b223ee1233beeaf6d583df";
    assert_eq!(Digest::of(&shell[1]).to_string(), frozen, "another form is another codec");
}

#[test]
fn what_is_regular_costs_little() {
    let floor = octree(8, |[_, y, _]| y == 100);
    let stored = encode(&slices(&floor), 6);
    let voxels = 256 * 256;
    assert!(stored[1].len() * 8 * 20 < voxels, "{} bytes", stored[1].len());
    let full = octree(6, |_| true);
    assert!(encode(&slices(&full), 5)[0].len() < 1000);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    #[test]
    fn masks_round_trip(kind in 0u32..6, depth in 1usize..=6, seed: u32, first: u8) {
        let levels = some_octree(kind, depth, seed);
        let first = usize::from(first) % depth;
        let forms = encode(&slices(&levels), first);
        prop_assert_eq!(forms.len(), depth - first);
        for (level, form) in levels[first..].iter().zip(&forms) {
            let mut masks = vec![0xaa; level.len()];
            decode(form, &mut masks).unwrap();
            prop_assert_eq!(&masks, level);
            prop_assert!(decode(form, &mut vec![0; level.len() + 1]).is_err());
            prop_assert!(decode(form, &mut vec![0; level.len() - 1]).is_err());
        }
        let last = &forms[forms.len() - 1];
        let found = ends(last);
        prop_assert_eq!(found.len(), forms.len());
        for (form, end) in forms.iter().zip(found) {
            prop_assert_eq!(form, &last[..end]);
        }
    }

    #[test]
    fn chunks_of_masks_are_those_of_their_levels(kind in 0u32..6, depth in 1usize..=6, seed: u32, first: u8) {
        let levels = some_octree(kind, depth, seed);
        let first = usize::from(first) % depth;
        let chunks = CompressedChunk::compress_masks(&slices(&levels), first);
        prop_assert_eq!(chunks.len(), depth - first);
        for (level, chunk) in levels[first..].iter().zip(&chunks) {
            prop_assert_eq!(&chunk.content().unwrap(), level);
            prop_assert!(chunk.codec() == Codec::Raw || chunk.stored().len() < level.len());
            let mut value = Vec::new();
            chunk.save(&mut value);
            prop_assert_eq!(CompressedChunk::load(&mut &value[..]), Some(chunk.clone()));
        }
    }

    #[test]
    fn any_bytes_decode_or_fail(
        stored in prop::collection::vec(any::<u8>(), 0..200), size in 1usize..100, first in 1u8..9
    ) {
        _ = decode(&stored, &mut vec![0; size]);
        let size_of_part = (stored.len() as u32).to_le_bytes();
        let form = [&[first][..], &size_of_part, &stored].concat();
        _ = decode(&form, &mut vec![0; size]);
    }

    #[test]
    fn what_decodes_is_what_the_coder_makes(kind in 0u32..6, seed: u32, at: u32, byte: u8) {
        let levels = some_octree(kind, 4, seed);
        let mut form = encode(&slices(&levels), 0).pop().unwrap();
        let at = at as usize % form.len();
        form[at] = byte;
        if form[0] == 1 && let Ok(levels) = decode_all(&form) && !levels.is_empty() {
            prop_assert_eq!(encode(&slices(&levels), 0).pop(), Some(form));
        }
    }
}

#[test]
fn cut_or_longer_forms_are_refused() {
    let levels = some_octree(3, 5, 7);
    let form = encode(&slices(&levels), 2).pop().unwrap();
    let last = levels.last().unwrap().len();
    for size in 0..form.len() {
        assert!(decode(&form[..size], &mut vec![0; last]).is_err(), "{size} bytes");
    }
    for more in [&[0][..], &[0; 4], &[0; 9], &[1, 0, 0, 0, 0]] {
        assert!(decode(&[&form, more].concat(), &mut vec![0; last]).is_err(), "{more:?}");
    }
}

#[test]
fn forms_of_too_many_levels_are_refused() {
    let line: Vec<&[u8]> = vec![&[1]; MAX_LEVELS];
    let form = encode(&line, 0).pop().unwrap();
    decode(&form, &mut [0]).unwrap();
    let more = [&form[..], &form[1..10]].concat();
    assert!(decode(&more, &mut [0]).is_err());
    for first in [0, 9, 255] {
        let mut other = encode(&line, 7).pop().unwrap();
        other[0] = first;
        assert!(decode(&other, &mut [0]).is_err(), "{first}");
    }
}

/// An archive of two cubes' two deepest levels, the deepest first.
fn cubes() -> (Vec<u8>, [Vec<Vec<u8>>; 2]) {
    let cubes = [some_octree(3, 6, 1), some_octree(2, 6, 2)];
    let chunks = cubes.each_ref().map(|levels| CompressedChunk::compress_masks(&slices(levels), 4));
    let mut writer = writer();
    for (item, level) in [(5, 1), (4, 0)] {
        writer.begin_section("masks", item).unwrap();
        chunks.iter().for_each(|chunks| writer.append(&chunks[level]).unwrap());
    }
    writer.begin_section("other", 0).unwrap();
    writer.append_raw(b"behind").unwrap();
    let (bytes, stats) = writer.finish().unwrap();
    let stored = chunks.iter().map(|chunks| chunks[1].stored().len() as u64).sum::<u64>() + 6;
    assert_eq!(stats.stored_bytes, stored, "masks once");
    (bytes, cubes)
}

fn sizes(archive: &Archive) -> Vec<u64> {
    archive.sections().iter().map(|section| archive.stored_bytes(section)).collect()
}

#[test]
fn an_archive_has_the_masks_of_all_levels_once() {
    let (bytes, cubes) = cubes();
    check(&bytes).unwrap();
    let archive = open(&bytes).unwrap();
    for level in [4, 5] {
        let section = archive.expect_section("masks", level).unwrap();
        let expected = [&cubes[0][level as usize][..], &cubes[1][level as usize]].concat();
        assert_eq!(archive.read_section(section).unwrap(), expected);
    }
    let chunks = archive.chunks();
    assert!(chunks[..4].iter().all(|chunk| chunk.codec == Codec::Masks));
    assert_eq!([chunks[2].offset, chunks[3].offset], [chunks[0].offset, chunks[1].offset]);
    assert_eq!([0, 1, 2, 3, 4].map(|number| archive.is_shared(number)), [false, false, true, true, false]);
    let own = u64::from(chunks[0].stored_bytes + chunks[1].stored_bytes);
    assert_eq!(sizes(&archive), [own, 0, 6]);
}

#[test]
fn masks_without_a_whole_are_stored_themselves() {
    let levels = some_octree(3, 6, 1);
    let chunks = CompressedChunk::compress_masks(&slices(&levels), 4);
    let mut writer = writer();
    // The other way round: the second begins with the first, not the first with the second.
    for (item, chunk) in chunks.iter().enumerate() {
        writer.begin_section("masks", item as u32).unwrap();
        writer.append(chunk).unwrap();
    }
    let bytes = writer.finish().unwrap().0;
    check(&bytes).unwrap();
    assert_eq!(sizes(&open(&bytes).unwrap()), [0, 1].map(|level: usize| chunks[level].stored().len() as u64));
}

#[test]
fn only_beginnings_of_masks_are_shared() {
    let (bytes, _) = cubes();
    let (payload, index) = disassemble(&bytes);
    type Change<'a> = &'a dyn Fn(&mut [ChunkRecord]);
    let changes: [(&str, Change); 6] = [
        ("chunk 2: corrupt archive: offset", &|chunks| chunks[2].offset += 16),
        ("chunk 2: corrupt archive: offset", &|chunks| chunks[2].offset -= 16),
        ("chunk 2: corrupt archive: offset", &|chunks| chunks[2].codec = Codec::Zstd),
        ("chunk 2: corrupt archive: offset", &|chunks| chunks[0].codec = Codec::Zstd),
        ("chunk 4: corrupt archive: offset", &|chunks| chunks[4].offset = chunks[0].offset),
        ("chunk 2: corrupt archive: stored size", &|chunks| {
            chunks[2].raw_bytes = 1 << 20;
            chunks[2].stored_bytes = chunks[0].stored_bytes + 1;
        }),
    ];
    for (message, change) in changes {
        let mut index = index.clone();
        change(&mut index.chunks);
        let error = refused(&assemble(&payload, &index)).to_string();
        assert!(error.contains(message), "{error}, not {message}");
    }
}

#[test]
fn a_broken_byte_breaks_the_levels_that_have_it() {
    let (bytes, _) = cubes();
    let archive = open(&bytes).unwrap();
    let [whole, part] = [0, 2].map(|number| archive.chunks()[number].clone());
    for (at, breaks_part) in
        [(part.offset, true), (part.end() - 1, true), (part.end(), false), (whole.end() - 1, false)]
    {
        let mut broken = bytes.clone();
        broken[at as usize] ^= 1;
        let archive = open(&broken).unwrap();
        let fails = |level| archive.read_section(archive.expect_section("masks", level).unwrap()).is_err();
        assert_eq!([fails(5), fails(4)], [true, breaks_part], "byte {at}");
        assert_eq!(archive.verify().failures.len(), 1 + usize::from(breaks_part), "byte {at}");
    }
    let padding = (whole.end() as usize..whole.end().next_multiple_of(16) as usize).next();
    if let Some(at) = padding {
        let mut broken = bytes.clone();
        broken[at] = 1;
        assert_eq!(open(&broken).unwrap().verify().failures.len(), 1);
    }
}
