//! The fuzz targets' checks of archives and arrays over their seeds, which are made here.
#![cfg(feature = "bake")]

#[path = "../fuzz/checks/archive_chunk.rs"]
mod archive_chunk;
#[path = "../fuzz/checks/archive_content.rs"]
mod archive_content;
#[path = "../fuzz/checks/archive_index.rs"]
mod archive_index;
#[path = "../fuzz/checks/npy.rs"]
mod npy;
#[path = "../fuzz/checks/replay.rs"]
mod replay;
mod support;

use manyview_cache::archive::{CompressedChunk, HEADER_BYTES, Header};
use replay::replay;
use support::bake_levels_and_directions;

fn town() -> Vec<u8> {
    bake_levels_and_directions(4, 5, 3, 3)
}

#[test]
fn indexes() {
    let town = town();
    let header = Header::decode(&town[..HEADER_BYTES], town.len() as u64).unwrap();
    // The offset, twice because the check halves it, and the index itself.
    let mut index = (header.index_offset << 1).to_le_bytes().to_vec();
    index.extend(&town[header.index_offset as usize..]);
    replay("archive_index", &[index, town[..HEADER_BYTES].to_vec()], 2000, archive_index::check);
}

#[test]
fn chunks() {
    let content: Vec<u8> = (0..4096_u32).map(|i| if i % 97 == 0 { (i / 97) as u8 } else { 0 }).collect();
    let seed = |codec: u8, stored: &[u8]| [&[0, 16, 0, codec], stored].concat();
    // A full cube.
    let masks: Vec<Vec<u8>> = (0..4).map(|level| vec![0xff; 8usize.pow(level)]).collect();
    let masks: Vec<&[u8]> = masks.iter().map(Vec::as_slice).collect();
    let masks = CompressedChunk::compress_masks(&masks, 3);
    let masks_seed = || [&masks[0].raw_bytes().to_le_bytes()[..3], &[3], masks[0].stored()].concat();
    let seeds = [
        seed(0, &content),
        seed(1, CompressedChunk::compress(&content, 3).stored()),
        seed(2, CompressedChunk::compress_rows(&content, 16).stored()),
        seed(10, &content),
        masks_seed(),
    ];
    replay("archive_chunk", &seeds, 500, archive_chunk::check);
}

#[test]
fn contents() {
    let town = town();
    if let Some(folder) = std::env::var_os("MANYVIEW_SEEDS") {
        fs_err::create_dir_all(&folder).unwrap();
        fs_err::write(std::path::Path::new(&folder).join("town.mvb"), &town).unwrap();
    }
    let sections = archive_content::sections(&town);
    // Every section in turn: a byte changed, one byte short, one byte long, another item, gone.
    let mut seeds = vec![Vec::new()];
    for section in 0..sections.len() as u8 {
        for action in [0, 4, 5, 6, 7] {
            seeds.push(vec![section, action, 1, 0, 0x80]);
        }
    }
    replay("archive_content", &seeds, 6, |data| archive_content::check(&sections, data));
}

#[test]
fn arrays() {
    let array = |shape: &[usize], count: usize| {
        let mut file = vec![5];
        manyview::npy::write_header::<f32>(&mut file, shape).unwrap();
        manyview::npy::write_elements(&mut file, &vec![1.5_f32; count]).unwrap();
        file
    };
    let mut seeds =
        vec![array(&[3, 6], 18), array(&[2, 9], 18), array(&[7], 7), array(&[2, 1, 2], 4), array(&[0], 0)];
    // Versions 2.0 and 3.0 have a header length of four bytes.
    for version in [2, 3] {
        let mut longer = seeds[0].clone();
        longer[7] = version;
        longer.splice(11..11, [0, 0]);
        seeds.push(longer);
    }
    replay("npy", &seeds, 1000, npy::check);
}
