//! The commands: each parses its options, calls the library, and prints. Results go to stdout, all else to stderr.

mod against;
mod bake;
mod bench;
mod cache;
mod camera_file;
mod cancel;
mod compare;
mod diff;
mod error;
mod gather;
mod gi;
mod inspect;
mod output;
mod overwrite;
mod preview;
mod progress;
mod rays;
mod render;
mod scene;
mod verify;
mod views;
mod voxels;

use std::panic;
use std::process::ExitCode;

use clap::{Parser, Subcommand, ValueEnum};

use error::Exit;

/// Bakes 3D scenes for thousands to a million lights and views, and looks into bakes.
#[derive(Debug, Parser)]
#[command(name = "manyview", version, about, arg_required_else_help = true, after_help = EXIT_CODES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const EXIT_CODES: &str = "Exit codes: 0 done, 1 internal error (for `diff` and `verify --against`: \
they differ), 2 usage, 3 bad input or an output that cannot be written, 4 over budget, 5 corrupt archive or cache, 130 cancelled.";

#[derive(Debug, Subcommand)]
enum Command {
    /// Bakes a glTF scene into an archive: octree and rows
    Bake(bake::Options),
    /// Makes a scene by code, of any size
    Scene(scene::Options),
    /// Shows what is inside an archive: counts, sizes, ratios, bounds, digests
    Inspect(inspect::Options),
    /// Checks every byte and every structure of an archive
    Verify(verify::Options),
    /// Compares two archives section by section
    Diff(diff::Options),
    /// Writes the occupied cells of an octree level as a NumPy array
    Voxels(voxels::Options),
    /// Tests segments: is anything between two points, or how far is the first hit?
    Rays(rays::Options),
    /// Draws what many views see: a map of distances in all directions for each
    Views(views::Options),
    /// Looks after the cache: where it is, what is in it, making room, checking it
    Cache(cache::Options),
    /// Measures voxels and rows against exact references
    Bench(bench::Args),
    /// Draws a scene in the light of many lights
    Render(render::Options),
    /// Measures how far two pictures are apart
    Compare(compare::Options),
    /// Draws the octree, a slice of it, or the rows of a direction
    Preview(preview::Options),
}

/// How results are printed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Format {
    /// For people.
    Text,
    /// For programs: one JSON document.
    Json,
}

/// Parses the arguments and runs the command they name.
pub(crate) fn main() -> ExitCode {
    // Exits with 2 where the arguments are wrong.
    let cli = Cli::parse();
    start_log();
    cancel::catch_interrupt();
    cancel::survive_file_size_limits();
    let result = panic::catch_unwind(|| match &cli.command {
        Command::Bake(options) => bake::run(options),
        Command::Scene(options) => scene::run(options),
        Command::Inspect(options) => inspect::run(options),
        Command::Verify(options) => verify::run(options),
        Command::Diff(options) => diff::run(options),
        Command::Voxels(options) => voxels::run(options),
        Command::Rays(options) => rays::run(options),
        Command::Views(options) => views::run(options),
        Command::Bench(options) => bench::run_command(options),
        Command::Cache(options) => cache::run(options),
        Command::Preview(options) => preview::run(options),
        Command::Render(options) => render::run(options),
        Command::Compare(options) => compare::run(options),
    });
    match result {
        Ok(Ok(exit)) => exit.into(),
        Ok(Err(error)) => {
            error.tell(match &cli.command {
                Command::Bake(options) => options.format(),
                _ => Format::Text,
            });
            error.exit().into()
        }
        // The panic's message was printed when it began.
        Err(_) => {
            eprintln!(
                "error: this is a bug in manyview; please report it with the command and the lines above"
            );
            Exit::Internal.into()
        }
    }
}

/// Log lines of the library go to stderr: warnings, or what `MANYVIEW_LOG` asks for (such as `debug`).
fn start_log() {
    let filter = tracing_subscriber::EnvFilter::try_from_env("MANYVIEW_LOG")
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("warn"));
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).without_time();
    // Fails only where a log was started before, which then goes on.
    _ = log.try_init();
}
