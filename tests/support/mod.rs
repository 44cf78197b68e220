//! Octrees and archives for tests.

#![allow(dead_code, reason = "each test file uses a part of it")]

pub(crate) mod gpu;

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Output};

use manyview_cache::archive::{Archive as Container, ArchiveWriter, CompressedChunk};
use manyview_pipeline::bake::{BakeOptions, RowsFrom, Silent, bake};
use manyview_pipeline::generate::{SceneKind, generate};
use manyview_pipeline::reduce::reduce_level;
use manyview_pipeline::rows::RowsOptions;
use manyview_shaders::directions::{DirectionSet, Fit};
use manyview_shaders::octahedral;
use manyview_shaders::sections::{RowsInfo, name};
use manyview_shaders::svo::{Svo, SvoLevel};

/// A generator of numbers from a seed (xorshift).
pub(crate) struct Numbers(pub u64);

impl Numbers {
    /// The next number.
    pub(crate) fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    /// A number in 0 … 1.
    pub(crate) fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn morton(cell: [u32; 3]) -> u64 {
    (0..48).fold(0, |code, bit| code | u64::from(cell[bit % 3] >> (bit / 3) & 1) << bit)
}

/// An octree of the given voxels, coloured by their coordinates, with normals up.
pub(crate) fn octree(origin: [f64; 3], size: f64, depth: u32, voxels: &[[u32; 3]]) -> Svo {
    let voxels: BTreeMap<u64, [u32; 3]> = voxels.iter().map(|&voxel| (morton(voxel), voxel)).collect();
    let mut level = SvoLevel::default();
    for voxel in voxels.values() {
        level.colors.push(voxel.map(|c| (c * 37 + 60) as u8));
        level.normals.push(octahedral::encode([0.0, 1.0, 0.0]));
        level.cones.push(0);
    }
    let mut codes: Vec<u64> = voxels.into_keys().collect();
    let mut levels = vec![level];
    for _ in 0..depth {
        let mut masks: BTreeMap<u64, u8> = BTreeMap::new();
        for code in codes {
            *masks.entry(code >> 3).or_default() |= 1 << (code & 7);
        }
        levels.push(reduce_level(masks.values().copied().collect(), &levels[levels.len() - 1]));
        codes = masks.into_keys().collect();
    }
    levels.reverse();
    let svo = Svo { origin, size, levels };
    svo.validate().unwrap();
    svo
}

/// Bakes a small town into an archive: `levels` deep, 6 × 6 directions of 32³ unless it shall have none.
pub(crate) fn bake_town(path: &Path, levels: u32, seed: u64, with_rows: bool) {
    let rows = RowsOptions {
        bits: 5,
        directions: DirectionSet::LatLong { thetas: 6, phis: 6 },
        fit: Fit::Extent,
        from: RowsFrom::Points,
    };
    let options = BakeOptions { levels, rows: with_rows.then_some(rows), ..BakeOptions::default() };
    let scene = generate(SceneKind::Town, 5_000, seed);
    let mut writer = ArchiveWriter::create(path).unwrap();
    bake(&scene, &options, None, &mut writer, &Silent).unwrap();
    writer.finish().unwrap();
}

/// Writes the sections of `from` as `change` leaves them (`None` to leave one out) into a new, valid container.
pub(crate) fn rewrite(from: &Path, to: &Path, mut change: impl FnMut(&str, u32, Vec<u8>) -> Option<Vec<u8>>) {
    let container = Container::open(from).unwrap();
    let mut writer = ArchiveWriter::create(to).unwrap();
    for section in container.sections() {
        let content = container.read_section(section).unwrap();
        if let Some(content) = change(section.id.name.as_str(), section.id.item, content) {
            writer.begin_section(section.id.name.as_str(), section.id.item).unwrap();
            writer.append_raw(&content).unwrap();
        }
    }
    writer.finish().unwrap();
}

/// Runs the program.
pub(crate) fn manyview(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_manyview")).env("MANYVIEW_CACHE", "").args(arguments).output().unwrap()
}

/// Runs the program, expects an exit code, and returns what it wrote to stdout and stderr.
pub(crate) fn expect_exit(code: i32, arguments: &[&str]) -> (String, String) {
    let output = manyview(arguments);
    let stdout = String::from_utf8(output.stdout).unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(code), "{arguments:?}\n{stdout}\n{stderr}");
    (stdout, stderr)
}

/// Bakes a small town whose only purpose is its rows: `thetas` × `phis` directions of `2^bits` voxels a side.
pub(crate) fn bake_directions(bits: u32, thetas: u32, phis: u32) -> Vec<u8> {
    bake_levels_and_directions(4, bits, thetas, phis)
}

/// The same with an octree of so many levels.
pub(crate) fn bake_levels_and_directions(levels: u32, bits: u32, thetas: u32, phis: u32) -> Vec<u8> {
    let rows = RowsOptions {
        bits,
        directions: DirectionSet::LatLong { thetas, phis },
        fit: Fit::Extent,
        from: RowsFrom::Points,
    };
    let options = BakeOptions { levels, rows: Some(rows), ..BakeOptions::default() };
    let mut writer = ArchiveWriter::in_memory().unwrap();
    bake(&generate(SceneKind::Town, 2_000, 1), &options, None, &mut writer, &Silent).unwrap();
    writer.finish().unwrap().0
}

/// As [`bake_directions`] with 6 × 6 directions, stored in blocks of
/// `block_directions` and in chunks of `chunk_bytes`, unlike the bake's own.
pub(crate) fn bake_rows(bits: u32, block_directions: u32, chunk_bytes: usize) -> Vec<u8> {
    let container = Container::from_bytes(bake_directions(bits, 6, 6)).unwrap();
    let all_rows = container
        .sections()
        .iter()
        .filter(|section| section.id.name.as_str() == name::ROWS_BITS)
        .flat_map(|section| container.read_section(section).unwrap())
        .collect::<Vec<u8>>();
    let mut writer = ArchiveWriter::in_memory().unwrap();
    for section in container.sections() {
        let kind = section.id.name.as_str();
        let mut content = container.read_section(section).unwrap();
        if kind == name::ROWS_INFO {
            let mut info: RowsInfo = bytemuck::pod_read_unaligned(&content);
            info.block_directions = block_directions;
            content = bytemuck::bytes_of(&info).to_vec();
        }
        if kind != name::ROWS_BITS {
            writer.begin_section(kind, section.id.item).unwrap();
            writer.append_raw(&content).unwrap();
        }
    }
    let block_bytes = (block_directions as usize) << (3 * bits - 3);
    for (item, block) in (0..).zip(all_rows.chunks(block_bytes)) {
        writer.begin_section(name::ROWS_BITS, item).unwrap();
        for chunk in block.chunks(chunk_bytes) {
            writer.append(&CompressedChunk::compress_rows(chunk, 1 << (bits - 3))).unwrap();
        }
    }
    writer.finish().unwrap().0
}

/// Turns one stored byte of the last chunk of a section.
pub(crate) fn corrupt_section(archive: &[u8], kind: &str, item: u32) -> Vec<u8> {
    let container = Container::from_bytes(archive.to_vec()).unwrap();
    let section = container.expect_section(kind, item).unwrap();
    let chunk = &container.chunks()[section.chunks.end as usize - 1];
    let mut archive = archive.to_vec();
    archive[chunk.end() as usize - 1] ^= 1;
    archive
}

/// A bake whose rows are all zero: `thetas` × `phis` directions of `2^bits` voxels a side (7 or 8 bits), in one block.
pub(crate) fn empty_rows(bits: u32, thetas: u32, phis: u32) -> Vec<u8> {
    let container = Container::from_bytes(bake_directions(5, 2, 2)).unwrap();
    let mut writer = ArchiveWriter::in_memory().unwrap();
    let directions = thetas * phis;
    for section in container.sections() {
        let mut content = container.read_section(section).unwrap();
        writer.begin_section(section.id.name.as_str(), section.id.item).unwrap();
        match section.id.name.as_str() {
            name::ROWS_INFO => {
                let mut info: RowsInfo = bytemuck::pod_read_unaligned(&content);
                (info.bits, info.set_a, info.set_b) = (bits, thetas, phis);
                (info.directions, info.block_directions) = (directions, directions);
                content = bytemuck::bytes_of(&info).to_vec();
            }
            name::ROWS_FRAMES => content = content[..48].repeat(directions as usize),
            name::ROWS_BITS => {
                let direction_bytes = 1 << (3 * bits - 3);
                let chunk = CompressedChunk::compress_rows(&vec![0; direction_bytes], 1 << (bits - 3));
                for _ in 0..directions {
                    writer.append(&chunk).unwrap();
                }
                continue;
            }
            _ => {}
        }
        writer.append_raw(&content).unwrap();
    }
    writer.finish().unwrap().0
}
