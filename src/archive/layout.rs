//! Checks that need no payload: the structs at the head of each group, and every section's size against them.

use manyview_cache::archive::Archive as Container;
use manyview_shaders::directions::{DirectionFrame, DirectionSet};
use manyview_shaders::sections::{Light, RowsInfo, SceneInfo, SvoInfo, name};
use manyview_shaders::svo::MAX_LEVELS;

use super::error::Broken;

/// The most nodes of one level: node indices are 32 bits wide.
const MAX_LEVEL_NODES: u64 = u32::MAX as u64;

/// Checks the counts and bounds of the scene.
pub(super) fn check_scene(container: &Container, info: &SceneInfo) -> Result<(), Broken> {
    let section = format!("{}[0]", name::SCENE_INFO);
    for (min, max) in info.bounds_min.iter().zip(&info.bounds_max) {
        if !min.is_finite() || !max.is_finite() || min > max {
            return Err(Broken::new(section, "bounds", "finite, min ≤ max", format!("{min} to {max}")));
        }
    }
    let stored = container.section(name::SCENE_LIGHTS, 0).map_or(0, |section| section.raw_bytes);
    let expected = info.lights.saturating_mul(size_of::<Light>() as u64);
    Broken::unless_equal(format!("{}[0]", name::SCENE_LIGHTS), "bytes of the lights", expected, stored)
}

/// Checks the octree's head and the size of every level's sections. Returns the number of nodes of each level.
pub(super) fn check_svo(container: &Container, info: &SvoInfo) -> Result<Vec<u64>, Broken> {
    let head = format!("{}[0]", name::SVO_INFO);
    if info.levels > MAX_LEVELS {
        return Err(Broken::new(head, "levels", format!("at most {MAX_LEVELS}"), info.levels));
    }
    if info.emissive > 1 {
        return Err(Broken::new(head, "emissive", "0 or 1", info.emissive));
    }
    if !info.origin.iter().all(|c| c.is_finite()) {
        return Err(Broken::new(head, "origin", "finite", format!("{:?}", info.origin)));
    }
    if !(info.size.is_finite() && info.size > 0.0) {
        return Err(Broken::new(head, "size", "finite and positive", info.size));
    }
    let bytes = |kind: &str, level: u32| container.section(kind, level).map_or(0, |s| s.raw_bytes);
    let mut nodes_of = Vec::with_capacity(info.levels as usize + 1);
    for level in 0..=info.levels {
        // One byte each: the simplest count of a level's nodes.
        let nodes = bytes(name::SVO_CONES, level);
        let cones = format!("{}[{level}]", name::SVO_CONES);
        let most = nodes_of.last().map_or(1, |above: &u64| above.saturating_mul(8)).min(MAX_LEVEL_NODES);
        let least = nodes_of.last().copied().unwrap_or(1);
        if nodes < least || nodes > most {
            return Err(Broken::new(cones, "nodes of the level", format!("{least} to {most}"), nodes));
        }
        let inner = if level < info.levels { nodes } else { 0 };
        let emitting = if info.emissive == 1 { nodes } else { 0 };
        for (kind, expected) in [
            (name::SVO_MASKS, inner),
            (name::SVO_COVERAGES, inner),
            (name::SVO_COLORS, nodes * 3),
            (name::SVO_NORMALS, nodes * 2),
            (name::SVO_EMISSIVE, emitting * 4),
        ] {
            let section = format!("{kind}[{level}]");
            Broken::unless_equal(section, "bytes for the nodes of the level", expected, bytes(kind, level))?;
        }
        nodes_of.push(nodes);
    }
    let leaves = nodes_of.last().copied().unwrap_or_default();
    Broken::unless_equal(&head, "leaves (the deepest level's nodes)", leaves, info.leaves)?;
    Broken::unless_equal(&head, "nodes (the sum over levels)", nodes_of.iter().sum(), info.nodes)?;
    Ok(nodes_of)
}

/// Checks the rows' head and the size of the frames and of every block. Returns the set of directions.
pub(super) fn check_rows(container: &Container, info: &RowsInfo) -> Result<DirectionSet, Broken> {
    let head = format!("{}[0]", name::ROWS_INFO);
    let in_range = |rule, range: std::ops::RangeInclusive<u32>, found: u32| {
        if range.contains(&found) {
            Ok(())
        } else {
            Err(Broken::new(&head, rule, format!("{} to {}", range.start(), range.end()), found))
        }
    };
    in_range("bits (log2 of voxels a side)", 5..=8, info.bits)?;
    in_range("kind of direction set", 0..=1, info.set_kind)?;
    in_range("first size of the direction set", 1..=512, info.set_a)?;
    in_range("fit", 0..=1, info.fit)?;
    in_range("source", 0..=2, info.source)?;
    let set = if info.set_kind == 0 {
        in_range("second size of the direction set", 1..=512, info.set_b)?;
        DirectionSet::LatLong { thetas: info.set_a, phis: info.set_b }
    } else {
        in_range("second size of the direction set", 0..=0, info.set_b)?;
        DirectionSet::Octahedral { size: info.set_a }
    };
    Broken::unless_equal(&head, "directions of the set", set.count(), info.directions)?;
    in_range("directions per block", 1..=u32::MAX, info.block_directions)?;
    if !info.center.iter().all(|c| c.is_finite()) {
        return Err(Broken::new(head, "centre", "finite", format!("{:?}", info.center)));
    }
    if !info.half_extent.iter().all(|h| h.is_finite() && *h > 0.0) {
        let found = format!("{:?}", info.half_extent);
        return Err(Broken::new(head, "half extent", "finite and positive", found));
    }
    let frames = container.section(name::ROWS_FRAMES, 0).map_or(0, |section| section.raw_bytes);
    let expected = u64::from(info.directions) * size_of::<DirectionFrame>() as u64;
    Broken::unless_equal(format!("{}[0]", name::ROWS_FRAMES), "bytes of the frames", expected, frames)?;
    for block in 0..info.directions.div_ceil(info.block_directions) {
        let directions = info.block_directions.min(info.directions - block * info.block_directions);
        let stored = container.section(name::ROWS_BITS, block).map_or(0, |section| section.raw_bytes);
        let expected = u64::from(directions) * info.direction_bytes() as u64;
        Broken::unless_equal(
            format!("{}[{block}]", name::ROWS_BITS),
            "bytes of the block's rows",
            expected,
            stored,
        )?;
    }
    Ok(set)
}

/// Whether no row coordinate that a frame yields leaves an `i32`, for any point of the lattice.
pub(super) fn frame_is_in_range(frame: &DirectionFrame) -> bool {
    let lattice = i64::from(manyview_shaders::directions::ROW_LATTICE);
    frame.row_from_lattice.iter().zip(frame.offset).all(|(row, offset)| {
        let reach: i64 = row.iter().map(|&entry| i64::from(entry).abs() * lattice).sum();
        row.iter().all(|&entry| i64::from(entry).abs() < 1 << 15)
            && reach + i64::from(offset).abs() <= i64::from(i32::MAX)
    })
}
