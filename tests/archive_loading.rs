//! The loader against archives that are right, and against archives that are wrong in one place.
#![cfg(feature = "bake")]

mod support;

use std::path::PathBuf;

use manyview::{Archive, LoadError};
use manyview_shaders::directions::DirectionSet;
use manyview_shaders::sections::{RowsInfo, SvoInfo};
use support::{bake_town, rewrite};

struct Town {
    folder: tempfile::TempDir,
    path: PathBuf,
}

fn town(with_rows: bool) -> Town {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("town.mvb");
    bake_town(&path, 6, 1, with_rows);
    Town { folder, path }
}

#[test]
fn a_bake_is_read_back() {
    let town = town(true);
    let archive = Archive::open(&town.path).unwrap();
    assert!(archive.scene_info().triangles.abs_diff(5_000) < 500);
    assert_eq!(archive.lights().unwrap().len() as u64, archive.scene_info().lights);
    let svo = archive.svo().unwrap();
    assert_eq!(svo.depth(), 6);
    assert_eq!(svo.node_count(6) as u64, archive.svo_info().leaves);
    assert_eq!(archive.svo_node_count(6), Some(archive.svo_info().leaves));
    // A part of the levels is the same as in the whole, but for the new leaves.
    let coarse = archive.svo_levels(..3).unwrap();
    assert_eq!(coarse.levels.len(), 3);
    assert_eq!(coarse.levels[1], svo.levels[1]);
    assert_eq!(coarse.levels[2].colors, svo.levels[2].colors);
    assert!(coarse.levels[2].child_masks.is_empty() && coarse.levels[2].coverages.is_empty());
    assert_eq!(archive.svo_levels(0..=2).unwrap(), coarse);
    assert_eq!(archive.svo_levels(..=0).unwrap().levels.len(), 1);
    // Rows, by direction and by block.
    let info = *archive.rows_info().unwrap();
    assert_eq!(archive.direction_set(), Some(DirectionSet::LatLong { thetas: 6, phis: 6 }));
    assert_eq!(archive.frames().unwrap().len(), 36);
    let words = info.direction_bytes() / 4;
    for block in 0..archive.row_block_count() {
        for (i, rows) in archive.row_block(block).unwrap().chunks(words).enumerate() {
            let direction = block * info.block_directions + i as u32;
            assert_eq!(archive.direction_rows(direction).unwrap(), rows);
            assert!(rows.iter().any(|&word| word != 0));
        }
    }
}

#[test]
fn what_is_not_there_is_named() {
    let town = town(false);
    let archive = Archive::open(&town.path).unwrap();
    assert!(archive.rows_info().is_none() && archive.direction_set().is_none());
    assert!(matches!(archive.frames(), Err(LoadError::NoRows { .. })));
    assert!(matches!(archive.direction_rows(0), Err(LoadError::NoRows { .. })));
    let error = archive.svo_levels(..=7).unwrap_err();
    assert!(error.to_string().contains("no level 7: the bake has levels 0 to 6"), "{error}");
    assert!(!error.is_corruption());
}

#[test]
fn memory_is_bounded_before_it_is_taken() {
    let town = town(true);
    let archive = Archive::open(&town.path).unwrap();
    let bytes = archive.svo_bytes(6);
    let archive = archive.with_memory_limit(bytes - 1);
    let error = archive.svo().unwrap_err();
    assert!(error.is_over_budget() && !error.is_corruption(), "{error}");
    assert!(archive.svo_levels(..=5).is_ok());
    assert!(archive.with_memory_limit(bytes).svo().is_ok());
}

#[test]
fn every_wrong_section_is_refused_by_name() {
    let town = town(true);
    let broken = town.folder.path().join("broken.mvb");
    let edit_info = |content: Vec<u8>, edit: fn(&mut SvoInfo)| {
        let mut info: SvoInfo = bytemuck::pod_read_unaligned(&content);
        edit(&mut info);
        bytemuck::bytes_of(&info).to_vec()
    };
    let edit_rows = |content: Vec<u8>, edit: fn(&mut RowsInfo)| {
        let mut info: RowsInfo = bytemuck::pod_read_unaligned(&content);
        edit(&mut info);
        bytemuck::bytes_of(&info).to_vec()
    };
    let svo_edits: [fn(&mut SvoInfo); 8] = [
        |info| info.levels = 5,
        |info| info.levels = 14,
        |info| info.size = -1.0,
        |info| info.size = f64::INFINITY,
        |info| info.origin[1] = f64::NAN,
        |info| info.emissive = 2,
        |info| info.leaves += 1,
        |info| info.nodes = u64::MAX,
    ];
    for (i, edit) in svo_edits.into_iter().enumerate() {
        rewrite(&town.path, &broken, |name, _, content| {
            Some(if name == "svo.info" { edit_info(content, edit) } else { content })
        });
        let error = Archive::open(&broken).err().unwrap_or_else(|| panic!("octree edit {i} was accepted"));
        assert!(error.is_corruption() && error.section().unwrap().starts_with("svo."), "{i}: {error}");
    }
    let rows_edits: [fn(&mut RowsInfo); 9] = [
        |info| info.bits = 4,
        |info| info.bits = 8,
        |info| info.set_kind = 2,
        |info| info.set_a = 7,
        |info| info.set_b = u32::MAX,
        |info| info.fit = 9,
        |info| info.block_directions = 0,
        |info| info.half_extent[2] = 0.0,
        |info| info.directions = u32::MAX,
    ];
    for (i, edit) in rows_edits.into_iter().enumerate() {
        rewrite(&town.path, &broken, |name, _, content| {
            Some(if name == "rows.info" { edit_rows(content, edit) } else { content })
        });
        let error = Archive::open(&broken).err().unwrap_or_else(|| panic!("rows edit {i} was accepted"));
        assert!(error.is_corruption() && error.section().unwrap().starts_with("rows."), "{i}: {error}");
    }
}

#[test]
fn no_section_may_be_missing_or_of_another_size() {
    let town = town(true);
    let broken = town.folder.path().join("broken.mvb");
    let ids: Vec<(String, u32)> = Archive::open(&town.path)
        .unwrap()
        .container()
        .sections()
        .iter()
        .map(|section| (section.id.name.as_str().to_owned(), section.id.item))
        .collect();
    for (name, item) in &ids {
        let is_it = |n: &str, i: u32| (n, i) == (name.as_str(), *item);
        rewrite(&town.path, &broken, |n, i, content| (!is_it(n, i)).then_some(content));
        // Rows are optional, all other sections are not; a scene may also have no lights.
        let opened = Archive::open(&broken);
        if name == "rows.info" {
            assert!(opened.unwrap().rows_info().is_none());
        } else {
            let error = opened.err().unwrap_or_else(|| panic!("{name}[{item}] may be missing"));
            assert!(error.is_corruption(), "{error}");
        }
        rewrite(&town.path, &broken, |n, i, mut content| {
            if is_it(n, i) {
                content.push(0);
            }
            Some(content)
        });
        let error = Archive::open(&broken).err().unwrap_or_else(|| panic!("{name}[{item}] may be longer"));
        assert!(error.is_corruption() && error.to_string().contains("broken.mvb"), "{error}");
    }
}

#[test]
fn contents_are_checked_when_they_are_loaded() {
    let town = town(true);
    let broken = town.folder.path().join("broken.mvb");
    // As many nodes as before, but one without children.
    rewrite(&town.path, &broken, |name, item, mut content| {
        if (name, item) == ("svo.masks", 5) {
            content[3] = 0;
        }
        Some(content)
    });
    let error = Archive::open(&broken).unwrap().svo().unwrap_err();
    assert!(error.is_corruption() && error.to_string().contains("svo.*[5]"), "{error}");
    assert!(Archive::open(&broken).unwrap().svo_levels(..=5).is_ok(), "the levels above are sound");
    rewrite(&town.path, &broken, |name, _, mut content| {
        if name == "rows.frames" {
            content[2] = 0x7f;
        }
        Some(content)
    });
    let error = Archive::open(&broken).unwrap().frames().unwrap_err();
    assert!(error.is_corruption() && error.to_string().contains("direction 0"), "{error}");
    rewrite(&town.path, &broken, |name, _, mut content| {
        if name == "scene.lights" {
            content[12] = 3;
        }
        Some(content)
    });
    assert!(Archive::open(&broken).unwrap().lights().unwrap_err().is_corruption());
}
