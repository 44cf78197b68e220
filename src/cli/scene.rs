//! `manyview scene`.

use std::io::{BufWriter, Write as _};
use std::path::PathBuf;
use std::str::FromStr;

use manyview_cache::atomic::AtomicFile;
use manyview_pipeline::generate::{MAX_TRIANGLES, MIN_TRIANGLES, SceneKind, generate};
use manyview_pipeline::glb::write_glb;

use super::cancel;
use super::error::{CliError, CliResult, Exit};
use super::output::{bytes, counted, print};

/// Options of `scene`.
#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// town, city, forest, hairball or park
    #[arg(value_name = "KIND", value_parser = SceneKind::from_str)]
    kind: SceneKind,
    /// About how many triangles, instances counted
    #[arg(long, value_name = "N", default_value_t = 100_000,
          value_parser = clap::value_parser!(u64).range(MIN_TRIANGLES..=MAX_TRIANGLES))]
    triangles: u64,
    /// Another seed gives another scene of the same kind
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// The scene
    #[arg(short, long, value_name = "S.glb")]
    output: PathBuf,
}

/// Runs the command.
pub(crate) fn run(options: &Options) -> CliResult {
    // An output that cannot be written is known before the long work, which an interrupt ends at once.
    drop(AtomicFile::create(&options.output)?);
    eprintln!("{:>12}  {} of {}", "generating", options.kind, counted(options.triangles, "triangle"));
    let scene = generate(options.kind, options.triangles, options.seed);
    let fail =
        |error: &dyn std::fmt::Display| CliError::bad_input(format!("{}: {error}", options.output.display()));
    _ = cancel::watch();
    let mut out = BufWriter::with_capacity(1 << 20, AtomicFile::create(&options.output)?);
    write_glb(&scene, &mut out).map_err(|e| fail(&e))?;
    out.flush().map_err(|e| fail(&e))?;
    let file = out.into_inner().map_err(|e| fail(&e))?;
    cancel::check()?;
    file.commit()?;
    let size = fs_err::metadata(&options.output).map_err(|e| fail(&e))?.len();
    let triangles = counted(scene.drawn_triangles(), "triangle");
    print(&format!("{}: {triangles}, {}\n", options.output.display(), bytes(size)))?;
    Ok(Exit::Done)
}
