//! `manyview inspect`.

use std::collections::BTreeMap;
use std::path::PathBuf;

use manyview::Archive;
use manyview_cache::archive::{FORMAT_VERSION, Section};
use manyview_shaders::sections::{RowsInfo, name};
use serde_json::{Value, json};

use super::Format;
use super::error::{CliResult, Exit};
use super::output::{Table, bytes, count, counted, length, print, print_json, ratio};

/// Options of `inspect`.
#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The archive
    #[arg(value_name = "A.mvb")]
    archive: PathBuf,
    /// How to print it
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// Runs `inspect`.
pub(crate) fn run(options: &Options) -> CliResult {
    let archive = Archive::open(&options.archive)?;
    match options.format {
        Format::Text => print(&text(&archive))?,
        Format::Json => print_json(&json(&archive))?,
    }
    Ok(Exit::Done)
}

/// Sizes of some sections together.
#[derive(Debug, Clone, Copy, Default)]
struct Sizes {
    sections: u64,
    chunks: u64,
    raw_bytes: u64,
    stored_bytes: u64,
}

fn stored_bytes(archive: &Archive, section: &Section) -> u64 {
    archive.container().stored_bytes(section)
}

/// The sizes of the sections that a filter lets through.
fn sizes(archive: &Archive, filter: impl Fn(&Section) -> bool) -> Sizes {
    let mut sum = Sizes::default();
    for section in archive.container().sections().iter().filter(|section| filter(section)) {
        sum.sections += 1;
        sum.chunks += u64::from(section.chunks.end - section.chunks.start);
        sum.raw_bytes += section.raw_bytes;
        sum.stored_bytes += stored_bytes(archive, section);
    }
    sum
}

fn group(archive: &Archive, prefix: &str) -> Sizes {
    sizes(archive, |section| section.id.name.as_str().starts_with(prefix))
}

/// The name of a rows' grid, as `--fit` has it.
fn grid(info: &RowsInfo) -> &'static str {
    if info.fit == 0 { "cube" } else { "extent" }
}

/// The name of where rows come from, as `--rows-from` has it.
fn source(info: &RowsInfo) -> &'static str {
    ["peel", "rotate", "points"].get(info.source as usize).copied().unwrap_or("unknown")
}

fn json(archive: &Archive) -> Value {
    let scene = archive.scene_info();
    let svo = archive.svo_info();
    let svo_sizes = group(archive, "svo.");
    let container = archive.container();
    let ratio =
        |sizes: Sizes| (sizes.stored_bytes > 0).then(|| sizes.raw_bytes as f64 / sizes.stored_bytes as f64);
    let all = sizes(archive, |_| true);
    let levels: Vec<Value> = (0..=svo.levels)
        .map(|level| {
            let sizes = sizes(archive, |s| is_level(s, level));
            json!({
                "level": level,
                "nodes": archive.svo_node_count(level),
                "cell": archive.cell_size(level),
                "raw_bytes": sizes.raw_bytes,
                "stored_bytes": sizes.stored_bytes,
            })
        })
        .collect();
    let rows = archive.rows_info().zip(archive.direction_set()).map(|(info, set)| {
        let sizes = group(archive, "rows.");
        json!({
            "directions": set.to_string(),
            "count": info.directions,
            "resolution": 1u32 << info.bits,
            "grid": grid(info),
            "source": source(info),
            "block_directions": info.block_directions,
            "center": info.center,
            "half_extent": info.half_extent,
            "raw_bytes": sizes.raw_bytes,
            "stored_bytes": sizes.stored_bytes,
            "ratio": ratio(sizes),
        })
    });
    let sections: Vec<Value> = container
        .sections()
        .iter()
        .map(|section| {
            json!({
                "name": section.id.name.as_str(),
                "item": section.id.item,
                "chunks": section.chunks.end - section.chunks.start,
                "raw_bytes": section.raw_bytes,
                "stored_bytes": stored_bytes(archive, section),
                "digest": section.digest.to_string(),
            })
        })
        .collect();
    json!({
        "archive": archive.name(),
        "format_version": FORMAT_VERSION,
        "file_bytes": container.header().file_bytes,
        "raw_bytes": all.raw_bytes,
        "stored_bytes": all.stored_bytes,
        "ratio": ratio(all),
        "index_digest": container.header().index_digest.to_string(),
        "scene": {
            "triangles": scene.triangles,
            "meshes": scene.meshes,
            "instances": scene.instances,
            "materials": scene.materials,
            "lights": scene.lights,
            "bounds": { "min": scene.bounds_min, "max": scene.bounds_max },
        },
        "svo": {
            "levels": svo.levels,
            "resolution": 1u32 << svo.levels,
            "origin": svo.origin,
            "size": svo.size,
            "voxel": archive.cell_size(svo.levels),
            "leaves": svo.leaves,
            "nodes": svo.nodes,
            "emissive": svo.emissive == 1,
            "raw_bytes": svo_sizes.raw_bytes,
            "stored_bytes": svo_sizes.stored_bytes,
            "ratio": ratio(svo_sizes),
            "stored_bytes_per_leaf": svo_sizes.stored_bytes as f64 / svo.leaves as f64,
            "by_level": levels,
        },
        "rows": rows,
        "chunks": container.chunks().len(),
        "sections": sections,
    })
}

fn is_level(section: &Section, level: u32) -> bool {
    let name = section.id.name.as_str();
    name.starts_with("svo.") && name != name::SVO_INFO && section.id.item == level
}

fn text(archive: &Archive) -> String {
    let container = archive.container();
    let all = sizes(archive, |_| true);
    let mut text = format!(
        "{}: format {FORMAT_VERSION}, {}, {} in {}, {} smaller than raw\n",
        archive.name(),
        bytes(container.header().file_bytes),
        counted(container.chunks().len() as u64, "chunk"),
        counted(container.sections().len() as u64, "section"),
        ratio(all.raw_bytes, all.stored_bytes),
    );
    text.push_str(&scene_text(archive));
    text.push_str(&svo_text(archive));
    text.push_str(&rows_text(archive));
    text.push_str(&sections_text(archive));
    text
}

fn scene_text(archive: &Archive) -> String {
    let scene = archive.scene_info();
    let (min, max) = (scene.bounds_min, scene.bounds_max);
    format!(
        "\nscene   {} drawn, {}, {}, {}, {}\n        bounds ({:.3}, {:.3}, {:.3}) to ({:.3}, {:.3}, {:.3}) m: {} × {} × {}\n",
        counted(scene.triangles, "triangle"),
        count(scene.meshes) + if scene.meshes == 1 { " mesh" } else { " meshes" },
        counted(scene.instances, "instance"),
        counted(scene.materials, "material"),
        counted(scene.lights, "light"),
        min[0],
        min[1],
        min[2],
        max[0],
        max[1],
        max[2],
        length(max[0] - min[0]),
        length(max[1] - min[1]),
        length(max[2] - min[2]),
    )
}

fn svo_text(archive: &Archive) -> String {
    let svo = archive.svo_info();
    let sizes_all = group(archive, "svo.");
    let mut text = format!(
        "\noctree  {} ({}³), {} in {}{}\n        cube of {} from ({:.3}, {:.3}, {:.3}), voxels of {}\n        {} raw, {} stored: {}, {:.2} bytes a leaf\n\n",
        counted(svo.levels.into(), "level"),
        1u32 << svo.levels,
        if svo.leaves == 1 { "1 leaf".to_owned() } else { format!("{} leaves", count(svo.leaves)) },
        counted(svo.nodes, "node"),
        if svo.emissive == 1 { ", emissive" } else { "" },
        length(svo.size),
        svo.origin[0],
        svo.origin[1],
        svo.origin[2],
        length(archive.cell_size(svo.levels)),
        bytes(sizes_all.raw_bytes),
        bytes(sizes_all.stored_bytes),
        ratio(sizes_all.raw_bytes, sizes_all.stored_bytes),
        sizes_all.stored_bytes as f64 / svo.leaves as f64,
    );
    let mut table = Table::new(["level", "cell", "nodes", "filled", "raw", "stored", "ratio"]);
    for level in 0..=svo.levels {
        let nodes = archive.svo_node_count(level).unwrap_or_default();
        let level_sizes = sizes(archive, |s| is_level(s, level));
        let filled = nodes as f64 / f64::from(level).exp2().powi(3) * 100.0;
        table.row([
            level.to_string(),
            length(archive.cell_size(level)),
            count(nodes),
            format!("{filled:.3}%"),
            bytes(level_sizes.raw_bytes),
            bytes(level_sizes.stored_bytes),
            ratio(level_sizes.raw_bytes, level_sizes.stored_bytes),
        ]);
    }
    text.push_str(&table.render());
    text
}

fn rows_text(archive: &Archive) -> String {
    let Some((info, set)) = archive.rows_info().zip(archive.direction_set()) else {
        return "\nrows    none\n".to_owned();
    };
    let sizes = group(archive, "rows.");
    format!(
        "\nrows    {set}: {} of {}³, grid {}, from {}\n        {} raw, {} stored: {}, in {} of {}\n",
        counted(info.directions.into(), "direction"),
        1u32 << info.bits,
        grid(info),
        source(info),
        bytes(sizes.raw_bytes),
        bytes(sizes.stored_bytes),
        ratio(sizes.raw_bytes, sizes.stored_bytes),
        counted(archive.row_block_count().into(), "block"),
        counted(info.block_directions.into(), "direction"),
    )
}

/// Sections of a kind together: a bake has hundreds.
fn sections_text(archive: &Archive) -> String {
    let mut kinds: BTreeMap<&str, usize> = BTreeMap::new();
    for (order, section) in archive.container().sections().iter().enumerate() {
        kinds.entry(section.id.name.as_str()).or_insert(order);
    }
    let mut kinds: Vec<_> = kinds.into_iter().collect();
    kinds.sort_by_key(|(_, order)| *order);
    let leaves = archive.svo_info().leaves as f64;
    let mut table =
        Table::new(["section", "items", "chunks", "raw", "stored", "ratio", "bytes a leaf", "digest"]);
    for (kind, _) in kinds {
        let of_kind = sizes(archive, |section| section.id.name.as_str() == kind);
        // With several items there is no one digest to show; `--format json` has them all.
        let digest = archive
            .container()
            .section(kind, 0)
            .filter(|_| of_kind.sections == 1)
            .map_or_else(|| "…".to_owned(), |section| section.digest.to_string()[..16].to_owned());
        table.row([
            kind.to_owned(),
            count(of_kind.sections),
            count(of_kind.chunks),
            bytes(of_kind.raw_bytes),
            bytes(of_kind.stored_bytes),
            ratio(of_kind.raw_bytes, of_kind.stored_bytes),
            if kind.starts_with("svo.") {
                format!("{:.3}", of_kind.stored_bytes as f64 / leaves)
            } else {
                String::new()
            },
            digest,
        ]);
    }
    format!("\n{}\nindex   {}\n", table.render(), archive.container().header().index_digest)
}
