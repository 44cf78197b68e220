//! Measurements: what the bake's approximations cost and how far they are from the truth.
//!
//! | table | question |
//! |---|---|
//! | [`rows`] | which directions, grids and sources of bits answer segments best, and how long do they take? |
//! | [`voxels`] | which voxels that the surface touches does the octree's raster miss? |
//! | [`tables`] | the paper's tables: error and time of all methods side by side |
//!
//! Errors are deterministic for a seed; times are of one run on the machine at hand.

pub mod overlap;
pub mod plot;
mod random;
pub mod rows;
mod run_info;
mod scene;
mod segments;
mod table;
pub mod tables;
pub mod variants;
pub mod voxels;

pub use random::Random;
pub use run_info::RunInfo;
pub use scene::{BenchScene, SceneSource, UnknownScene};
pub use table::{Cell, Table};

use crate::archive::LoadError;
use crate::views::ViewError;
use crate::visibility::VisibilityError;
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
    /// A method failed.
    #[error("{method}: {source}")]
    Method {
        /// Its name.
        method: String,
        /// What went wrong.
        source: VisibilityError,
    },
    /// A method of drawing views failed.
    #[error("{method}: {source}")]
    Views {
        /// Its name.
        method: String,
        /// What went wrong.
        source: ViewError,
    },
    /// The bake cannot be read back.
    #[error("{scene}: {source}")]
    Load {
        /// The scene's name.
        scene: String,
        /// What is wrong.
        source: Box<LoadError>,
    },
    /// No method has this name.
    #[error("there is no method `{name}`; choose of {known}")]
    NoSuchMethod {
        /// The name.
        name: String,
        /// All names.
        known: String,
    },
    /// The chosen view shows nothing.
    #[error(
        "{scene}: the view that was chosen shows no surface: check that the scene has closed or large surfaces"
    )]
    NothingSeen {
        /// The scene's name.
        scene: String,
    },
    /// The user asked to stop.
    #[error("cancelled")]
    Cancelled,
}
