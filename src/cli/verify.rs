//! `manyview verify`.

use std::path::PathBuf;

use manyview::{Archive, LoadError};
use manyview_cache::archive::ArchiveErrorKind;
use manyview_pipeline::reduce::reduce_level;
use manyview_shaders::svo::{Svo, SvoLevel};
use serde_json::{Value, json};

use super::Format;
use super::against::{self, Against, Comparison};
use super::error::{CliError, CliResult, Exit};
use super::output::{bytes, count, counted, print, print_json};

/// Failures that are printed in full; the rest is counted.
const SHOWN_FAILURES: usize = 20;

/// Options of `verify`.
#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The archive
    #[arg(value_name = "A.mvb")]
    archive: PathBuf,
    #[command(flatten)]
    against: Against,
    /// How to print the summary
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// One kind of check: what was looked at, and what is wrong.
struct Check {
    name: &'static str,
    /// What was looked at, for people.
    summary: String,
    failures: Vec<String>,
}

/// Runs `verify`.
pub(crate) fn run(options: &Options) -> CliResult {
    let archive = Archive::open(&options.archive).map_err(|error| match &error {
        // What cannot even be told from another file is no sound archive, which is the question here.
        LoadError::Container(container)
            if matches!(container.kind(), ArchiveErrorKind::NotAnArchive { .. }) =>
        {
            CliError::new(Exit::Corrupt, error)
        }
        _ => error.into(),
    })?;
    let mut checks = vec![check_container(&archive)];
    // The structure of broken bytes tells nothing new.
    if checks[0].failures.is_empty() {
        checks.push(check_scene(&archive)?);
        checks.extend(check_octree(&archive)?);
        checks.extend(check_rows(&archive)?);
    }
    let is_sound = checks.iter().all(|check| check.failures.is_empty());
    let comparison =
        if is_sound { against::compare(&archive, &options.against, options.format)? } else { None };
    report(&archive, &checks, comparison.as_ref(), options.format)
}

fn report(archive: &Archive, checks: &[Check], comparison: Option<&Comparison>, format: Format) -> CliResult {
    let failures: Vec<&String> = checks.iter().flat_map(|check| &check.failures).collect();
    match format {
        Format::Json => {
            let checks: Vec<Value> = checks
                .iter()
                .map(|check| json!({ "check": check.name, "summary": check.summary, "failures": check.failures }))
                .collect();
            print_json(&json!({
                "archive": archive.name(),
                "sound": failures.is_empty(),
                "checks": checks,
                "against": comparison.map(Comparison::json),
            }))?;
        }
        Format::Text => {
            let mut text = String::new();
            for check in checks {
                let verdict = if check.failures.is_empty() { "ok" } else { "BAD" };
                text.push_str(&format!("{verdict:<4} {:<10} {}\n", check.name, check.summary));
            }
            let verdict = if failures.is_empty() { "sound" } else { "corrupt" };
            text.push_str(&format!("{}: {verdict}\n", archive.name()));
            if let Some(comparison) = comparison {
                text.push_str(&format!("{}: {}\n", archive.name(), comparison.text()));
            }
            print(&text)?;
        }
    }
    if failures.is_empty() {
        let is_same = comparison.is_none_or(Comparison::is_same);
        return Ok(if is_same { Exit::Done } else { Exit::DIFFERENT });
    }
    for failure in failures.iter().skip(1).take(SHOWN_FAILURES) {
        eprintln!("also: {failure}");
    }
    if failures.len() > SHOWN_FAILURES + 1 {
        eprintln!("also: {} more", failures.len() - SHOWN_FAILURES - 1);
    }
    Err(CliError::new(Exit::Corrupt, anyhow::anyhow!("{}", failures[0])))
}

fn check_container(archive: &Archive) -> Check {
    let report = archive.container().verify();
    Check {
        name: "container",
        summary: format!(
            "{} and {}: hashes, digests and padding; {} of content in {}",
            counted(report.chunks as u64, "chunk"),
            counted(report.sections as u64, "section"),
            bytes(report.raw_bytes),
            bytes(report.file_bytes),
        ),
        failures: report.failures.iter().map(ToString::to_string).collect(),
    }
}

/// A check whose only possible failure is `result`; what is not the archive's fault is an error.
fn check_of<T>(
    name: &'static str,
    result: Result<T, LoadError>,
    summary: impl FnOnce(&T) -> String,
) -> Result<(Check, Option<T>), LoadError> {
    match result {
        Ok(value) => Ok((Check { name, summary: summary(&value), failures: Vec::new() }, Some(value))),
        Err(error) if error.is_corruption() => {
            let failures = vec![error.to_string()];
            Ok((Check { name, summary: "could not be loaded".to_owned(), failures }, None))
        }
        Err(error) => Err(error),
    }
}

fn check_scene(archive: &Archive) -> Result<Check, LoadError> {
    let scene = archive.scene_info();
    let lights = archive.lights();
    let summary =
        |_: &_| format!("{} drawn, {}", counted(scene.triangles, "triangle"), counted(scene.lights, "light"));
    Ok(check_of("scene", lights, summary)?.0)
}

fn check_octree(archive: &Archive) -> Result<Vec<Check>, LoadError> {
    let info = archive.svo_info();
    let (structure, svo) = check_of("octree", archive.svo(), |_| {
        let (leaves, nodes) = (count(info.leaves), count(info.nodes));
        format!(
            "{}, {leaves} leaves, {nodes} nodes: every child has its place",
            counted(info.levels.into(), "level")
        )
    })?;
    let inner = svo.map(|svo| Check {
        name: "averages",
        summary: format!("{} inner nodes: each follows from its children", count(info.nodes - info.leaves)),
        failures: inner_failures(archive, &svo),
    });
    Ok([Some(structure), inner].into_iter().flatten().collect())
}

/// What is wrong with inner nodes: each must be what the bake makes of its children.
fn inner_failures(archive: &Archive, svo: &Svo) -> Vec<String> {
    let mut failures = Vec::new();
    for (l, pair) in svo.levels.windows(2).enumerate() {
        let [level, children] = pair else { continue };
        if let Some(node) = level.coverages.iter().position(|&coverage| coverage == 0) {
            failures.push(format!(
                "{}: section svo.coverages[{l}]: coverage of node {node}: expected 1 to 255, found 0",
                archive.name()
            ));
        }
        // Without weight there is no mean.
        if children.coverages.contains(&0) {
            continue;
        }
        let expected = reduce_level(level.child_masks.clone(), children);
        failures.extend(
            first_differences(level, &expected)
                .into_iter()
                .map(|(kind, difference)| format!("{}: section {kind}[{l}]: {difference}", archive.name())),
        );
    }
    failures
}

fn first_differences(level: &SvoLevel, expected: &SvoLevel) -> Vec<(&'static str, String)> {
    fn first<T: PartialEq + std::fmt::Debug>(
        kind: &'static str,
        found: &[T],
        expected: &[T],
    ) -> Option<(&'static str, String)> {
        let node = (0..found.len()).find(|&node| found.get(node) != expected.get(node))?;
        let count = found.iter().zip(expected).filter(|(found, expected)| found != expected).count();
        let message = format!(
            "node {node} does not follow from its children: expected {:?}, found {:?} ({count} such nodes in this level)",
            expected.get(node),
            found[node]
        );
        Some((kind, message))
    }
    use manyview_shaders::sections::name;
    [
        first(name::SVO_COVERAGES, &level.coverages, &expected.coverages),
        first(name::SVO_COLORS, &level.colors, &expected.colors),
        first(name::SVO_NORMALS, &level.normals, &expected.normals),
        first(name::SVO_CONES, &level.cones, &expected.cones),
        first(name::SVO_EMISSIVE, &level.emissive, &expected.emissive),
    ]
    .into_iter()
    .flatten()
    .collect()
}

fn check_rows(archive: &Archive) -> Result<Option<Check>, LoadError> {
    let Some((info, set)) = archive.rows_info().zip(archive.direction_set()) else { return Ok(None) };
    let (mut check, frames) = check_of("rows", archive.frames(), |frames| {
        format!("{set}: {} in range, of {}³", counted(frames.len() as u64, "frame"), 1u32 << info.bits)
    })?;
    if frames.is_none() {
        return Ok(Some(check));
    }
    let mut bits = 0u64;
    let mut empty = 0;
    for block in 0..archive.row_block_count() {
        // Each block's size was checked when the archive was opened.
        let rows = archive.row_block(block)?;
        bits += rows.iter().map(|word| u64::from(word.count_ones())).sum::<u64>();
        empty += rows.chunks(info.direction_bytes() / 4).filter(|rows| rows.iter().all(|&w| w == 0)).count();
    }
    check.summary.push_str(&format!(", {} voxels set", count(bits)));
    if empty > 0 {
        // All that is thinner than a voxel may pass between the samples.
        check.summary.push_str(&format!(", {} without any", counted(empty as u64, "direction")));
    }
    Ok(Some(check))
}
