//! `manyview voxels`.

use std::io;
use std::path::PathBuf;

use manyview::{Archive, npy};
use manyview_cache::atomic::{AtomicFile, AtomicFileError};

use super::cancel;
use super::error::{CliError, CliResult, Exit};
use super::output::{count, counted, length};
use super::overwrite::check_outputs;

/// Options of `voxels`.
#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The archive
    #[arg(value_name = "A.mvb")]
    archive: PathBuf,
    /// Level of the octree: 0 is the root, the deepest one has the voxels (see `inspect`)
    #[arg(long, value_name = "L")]
    level: u32,
    /// The NumPy file: int32 (n, 3), cell coordinates x, y, z in Morton order (x fastest)
    #[arg(short, long, value_name = "V.npy")]
    output: PathBuf,
}

/// Runs `voxels`.
pub(crate) fn run(options: &Options) -> CliResult {
    check_outputs(&[("A.mvb", &*options.archive)], &[("--output", &*options.output)])?;
    let archive = Archive::open(&options.archive)?;
    let level = options.level;
    let levels = archive.svo_info().levels;
    if level > levels {
        let message = format!("{}: there is no level {level}; use --level 0 to {levels}", archive.name());
        return Err(CliError::usage(message));
    }
    _ = cancel::watch();
    // The output first: what cannot be written is not worth the work.
    let mut file = AtomicFile::create(&options.output)?;
    let svo = archive.svo_levels(..=level)?;
    let cells: Vec<[i32; 3]> =
        svo.cells(level as usize).into_iter().map(|cell| cell.map(i32::from)).collect();
    let write = |file: &mut AtomicFile| -> io::Result<()> {
        npy::write_header::<i32>(file, &[cells.len(), 3])?;
        npy::write_elements(file, cells.as_flattened())
    };
    write(&mut file).map_err(|source| AtomicFileError {
        path: options.output.clone(),
        action: "write it",
        source,
    })?;
    cancel::check()?;
    file.commit()?;
    eprintln!(
        "{}: {} of level {level} in a grid of {}³ from ({}, {}, {}), {} each",
        options.output.display(),
        counted(cells.len() as u64, "cell"),
        count(1 << level),
        svo.origin[0],
        svo.origin[1],
        svo.origin[2],
        length(archive.cell_size(level)),
    );
    Ok(Exit::Done)
}
