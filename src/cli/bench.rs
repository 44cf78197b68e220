//! `manyview bench`.

use manyview::bench::variants::{Detail, variants};
use manyview::bench::{BenchError, BenchScene, SceneSource, Table, rows, voxels};
use manyview::rays::paper::OriginBias;
use manyview_pipeline::bake;
use std::path::PathBuf;

use super::Format;
use super::cancel;
use super::error::{CliError, CliResult, Exit};
use super::output::print;
use super::progress::Progress;

/// Options of `bench`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// What to measure; all tables if none is named
    #[arg(value_name = "TABLE", value_enum)]
    tables: Vec<TableName>,
    /// A .glb or .gltf file, or KIND:TRIANGLES for a generated scene; may be repeated
    #[arg(long = "scene", value_name = "SCENE", default_value = "town:100000")]
    scenes: Vec<SceneSource>,
    /// Folder for the tables as Markdown, CSV and JSON; without it they are printed
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Directions that are sampled for the rows
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=8100))]
    directions: u32,
    /// Rays per direction
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    rays: u32,
    /// Measure every combination of source, grid and direction set, not only those around the default
    #[arg(long)]
    full: bool,
    /// Seed of directions and rays
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
}

/// The tables there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum TableName {
    /// Octree occupancy against exact triangle-box overlap
    Voxels,
    /// Rows of every source, grid and direction set against exact rays
    Rows,
}

/// Runs the command.
pub(crate) fn run_command(args: &Args) -> CliResult {
    let progress = Progress::new(Format::Text, cancel::watch());
    let result = run(args, &progress, |text| _ = print(text));
    progress.finish();
    result?;
    Ok(Exit::Done)
}

/// Measures, hands every table to `print` as Markdown or writes it to the folder as soon as it is done.
pub(crate) fn run(
    args: &Args,
    progress: &dyn bake::Progress,
    mut print: impl FnMut(&str),
) -> Result<(), BenchError> {
    let wanted = |table| args.tables.is_empty() || args.tables.contains(&table);
    let mut done = |table: &Table| match &args.output {
        Some(folder) => table.write(folder),
        None => {
            print(&table.markdown());
            print("\n");
            Ok(())
        }
    };
    if wanted(TableName::Voxels) {
        done(&voxels::run(args.scenes.iter().map(BenchScene::load), progress)?)?;
    }
    if wanted(TableName::Rows) {
        let Args { directions, rays, seed, .. } = *args;
        let settings = rows::RowsSettings { directions, rays, seed, bias: OriginBias::default() };
        let detail = if args.full { Detail::Full } else { Detail::Brief };
        let variants = variants(detail);
        for source in &args.scenes {
            let scene = BenchScene::load(source)?;
            for table in rows::run(&scene, &variants, &settings, progress)? {
                done(&table)?;
            }
        }
    }
    Ok(())
}

impl From<BenchError> for CliError {
    fn from(error: BenchError) -> Self {
        let exit = match error {
            BenchError::Cancelled => Exit::Cancelled,
            _ => Exit::BadInput,
        };
        Self::new(exit, error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use manyview_pipeline::bake::Silent;

    #[derive(clap::Parser)]
    struct Command {
        #[command(flatten)]
        args: Args,
    }

    fn parse(arguments: &[&str]) -> Result<Args, clap::Error> {
        Command::try_parse_from(["bench"].iter().chain(arguments)).map(|command| command.args)
    }

    #[test]
    fn tables_and_scenes_are_named() {
        let args = parse(&["rows", "--scene", "a.glb", "--scene", "city:2000", "--rays", "9"]).unwrap();
        assert_eq!((args.tables, args.scenes.len(), args.rays), (vec![TableName::Rows], 2, 9));
        assert!(parse(&["columns"]).is_err() && parse(&["--scene", "city:x"]).is_err());
        assert!(parse(&["--directions", "0"]).is_err());
    }

    #[test]
    fn a_table_is_printed_or_written() {
        let mut printed = String::new();
        run(&parse(&["voxels", "--scene", "town:1000"]).unwrap(), &Silent, |text| printed += text).unwrap();
        assert!(printed.contains("| town:1000 | 7 |"), "{printed}");
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().to_str().unwrap();
        run(&parse(&["voxels", "--scene", "town:1000", "-o", out]).unwrap(), &Silent, |_| panic!()).unwrap();
        assert!(folder.path().join("voxels.csv").exists());
        let missing = run(&parse(&["voxels", "--scene", "no.glb"]).unwrap(), &Silent, |_| ());
        assert!(missing.unwrap_err().to_string().contains("no.glb"));
    }
}
