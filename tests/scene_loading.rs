//! Rows in memory: the same whatever blocks and chunks they are stored in, and refused where they are broken.
#![cfg(feature = "bake")]

mod support;

use std::sync::Arc;

use manyview::{Archive, CpuScene, LoadError};
use manyview_shaders::sections::name;
use support::{bake_rows, bake_town, corrupt_section};

/// Block after block, as the container has them.
fn rows_by_blocks(archive: &Archive) -> Vec<u32> {
    (0..archive.row_block_count()).flat_map(|block| archive.row_block(block).unwrap()).collect()
}

#[test]
fn a_scene_has_the_rows_of_all_blocks_in_order() {
    let mut of_bits = None;
    for (block_directions, chunk_bytes) in
        [(36, 1 << 22), (5, 1 << 22), (1, 2048), (7, 5 * 1024), (1000, 999)]
    {
        let archive = Archive::from_bytes(bake_rows(5, block_directions, chunk_bytes)).unwrap();
        let scene = CpuScene::load(&archive).unwrap();
        let expected = rows_by_blocks(&archive);
        assert!(expected.iter().any(|&word| word != 0));
        assert_eq!(
            **scene.words(),
            expected,
            "{block_directions} directions a block, {chunk_bytes} bytes a chunk"
        );
        assert_eq!(of_bits.get_or_insert(expected), &**scene.words(), "storage changes nothing");
        assert_eq!(scene.frames(), archive.frames().unwrap());
        assert_eq!(Some(scene.rows_info()), archive.rows_info());
        assert_eq!(scene.words().len(), 36 * 1024);
    }
}

#[test]
fn any_range_of_directions_loads_alone() {
    for (block_directions, chunk_bytes) in [(36, 1 << 22), (5, 1 << 22), (7, 5 * 1024)] {
        let archive = Archive::from_bytes(bake_rows(5, block_directions, chunk_bytes)).unwrap();
        let all = rows_by_blocks(&archive);
        for (start, end) in [(0, 36), (0, 1), (35, 36), (3, 17), (5, 10), (14, 15), (9, 9), (0, 0), (36, 36)]
        {
            let expected = &all[start as usize * 1024..end as usize * 1024];
            assert_eq!(archive.rows(start..end).unwrap(), expected, "{start}..{end}");
        }
        assert_eq!(archive.direction_rows(20).unwrap(), all[20 * 1024..21 * 1024]);
        for (start, end) in [(0, 37), (36, 37), (u32::MAX - 1, u32::MAX)] {
            let error = archive.rows(start..end).unwrap_err();
            assert!(matches!(error, LoadError::NoSuchItem { what: "direction", last: 35, .. }), "{error}");
        }
        assert!(matches!(archive.direction_rows(u32::MAX), Err(LoadError::NoSuchItem { .. })));
    }
}

#[test]
fn a_corrupt_chunk_is_named() {
    let sound = bake_rows(5, 4, 1 << 22);
    let archive = Archive::from_bytes(corrupt_section(&sound, name::ROWS_BITS, 3)).unwrap();
    let error = CpuScene::load(&archive).unwrap_err();
    assert!(error.is_corruption() && error.section().unwrap() == "rows.bits[3]", "{error}");
    // The other blocks are sound.
    assert!(archive.rows(0..12).is_ok() && archive.rows(16..36).is_ok());
    assert!(archive.rows(11..13).unwrap_err().is_corruption());
}

#[test]
fn what_cannot_be_loaded_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("town.mvb");
    bake_town(&path, 3, 1, false);
    let archive = Archive::open(&path).unwrap();
    assert!(matches!(CpuScene::load(&archive), Err(LoadError::NoRows { .. })));
    assert!(matches!(archive.rows(0..0), Err(LoadError::NoRows { .. })));
    let archive = Archive::from_bytes(bake_rows(5, 36, 1 << 22)).unwrap().with_memory_limit(36 * 4096 - 1);
    let error = CpuScene::load(&archive).unwrap_err();
    assert!(error.is_over_budget(), "{error}");
    assert!(CpuScene::load(&archive.with_memory_limit(36 * 4096)).is_ok());
}

#[test]
fn the_rows_image_shares_the_scenes_words() {
    let archive = Archive::from_bytes(bake_rows(6, 36, 1 << 22)).unwrap();
    let scene = CpuScene::load(&archive).unwrap();
    let image = scene.rows_image().unwrap();
    assert!(Arc::ptr_eq(image.rows(), scene.words()));
    let [x, y, layer] = image.layout().tile_origin(17);
    let (u, v) = (20, 31);
    let row = &archive.direction_rows(17).unwrap()[((v << 6) + u) * 2..][..2];
    assert_eq!(image.texel([x + u as u32, y + v as u32, layer]), [row[0], row[1], 0, 0]);
}

#[test]
fn octree_levels_load_alone() {
    let sound = bake_rows(5, 36, 1 << 22);
    let archive = Archive::from_bytes(sound.clone()).unwrap();
    let svo = archive.svo().unwrap();
    for (level, expected) in (0..).zip(&svo.levels) {
        assert_eq!(&archive.svo_level_alone(level).unwrap(), expected);
    }
    assert!(matches!(archive.svo_level_alone(5), Err(LoadError::NoSuchItem { .. })));
    let broken = Archive::from_bytes(corrupt_section(&sound, name::SVO_MASKS, 2)).unwrap();
    assert!(broken.svo_level_alone(2).unwrap_err().is_corruption());
    assert!(broken.svo_level_alone(1).is_ok() && broken.svo_level_alone(3).is_ok());
}
