//! Measurements: what the bake's approximations cost and how far they are from the truth.
//!
//! | table | question |
//! |---|---|
//! | [`rows`] | which directions, grids and sources of bits answer segments best, and how long do they take? |
//! | [`voxels`] | which voxels that the surface touches does the octree's raster miss? |
//!
//! Errors are deterministic for a seed; times are of one run on the machine at hand.

pub mod overlap;
mod random;
pub mod rows;
mod scene;
mod segments;
mod table;
pub mod variants;
pub mod voxels;

pub use random::Random;
pub use scene::{BenchScene, SceneSource, UnknownScene};
pub use table::{Cell, Table};

use manyview_pipeline::bake::BakeError;
use manyview_pipeline::import::ImportError;
use std::path::PathBuf;
use thiserror::Error;

/// Why there is no measurement.
#[derive(Debug, Error)]
pub enum BenchError {
    /// The scene cannot be imported.
    #[error(transparent)]
    Import(#[from] ImportError),
    /// The scene cannot be baked.
    #[error("{scene}: {source}")]
    Scene {
        /// Its name.
        scene: String,
        /// What the bake says.
        source: BakeError,
    },
    /// A result cannot be written.
    #[error("{}: {source}: choose a folder that can be written to", path.display())]
    Output {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The user asked to stop.
    #[error("cancelled")]
    Cancelled,
}
