//! The paper's tables on scenes of ours: error and time of every method, side by side in one run.
//!
//! | table | name | question |
//! |---|---|---|
//! | I | [`scenes`] | how wrong and how fast is each method, scene by scene? |
//! | II | [`lights`] | do error and time change with the number of lights? |
//! | III | [`resolution`] | error against voxels a side |
//! | IV | [`directions`] | error against sampled directions |
//! | V | [`dynamic`], [`deforming_rows`] | moving and deforming objects |
//! | VI | [`throughput`] | rays a second against triangles |
//! | 1 of \[ML\] | [`manylods()`] | time and lists of the maps of many lights |
//! | 2 of \[ML\] | [`manylods_single`] | a tree of points, and its cut for one view |
//!
//! and, of methods that draw many views, [`view_growth`], [`view_work`], [`view_queries`], [`view_agreement`],
//! [`view_resolutions`], [`view_levels`] and [`view_culling`].
//!
//! # Practice
//! Receivers are the surface points that a camera sees ([`Subject`]); every receiver is asked about every light, as a
//! renderer would. Exact rays ([`crate::exact`]) are the truth, and the time for them is the time of method `bvh`.
//! Where that would take too long, receivers are thinned out evenly, for all methods alike.

mod actors;
mod bakes;
mod dynamic;
mod errors;
mod images;
mod manylods;
mod measure;
mod methods;
mod subject;
mod view_measure;
mod view_queries;
mod view_work;
mod views;

pub use bakes::{BakeCase, BakeCost, Growth, MeasureBake, MeasuredBake, bake_estimates, bake_growth};
pub use dynamic::{DynamicSettings, deforming_rows, dynamic};
pub use errors::Errors;
pub use images::{directions, lights, resolution, scenes, throughput};
pub use manylods::{manylods, manylods_single};
pub use measure::{Measured, Measurement};
pub use methods::{Method, MethodSource, OurMethods};
pub use subject::Subject;
pub use view_measure::Drawn;
pub use view_queries::view_queries;
pub use view_work::view_work;
pub use views::{
    NamedRenderer, Renderers, ViewKind, ViewSubject, ViewTableSettings, view_agreement, view_culling,
    view_growth, view_levels, view_resolutions,
};

use crate::bench::BenchError;
use manyview_pipeline::bake::BakeOptions;
use manyview_pipeline::rows::RowsOptions;

/// What tables are measured with.
#[derive(Debug, Clone, PartialEq)]
pub struct TableSettings {
    /// Pixels of the picture whose surface points are the receivers.
    pub size: [u32; 2],
    /// Lights, where they are not what is varied.
    pub lights: u32,
    /// Seed of the lights.
    pub seed: u64,
    /// Receivers are thinned out until there are no more pairs with lights than this.
    pub most_pairs: u64,
    /// How often each method is timed; the shortest time counts.
    pub repeats: u32,
    /// Levels of the octree that octree methods work on.
    pub levels: u32,
    /// Names of the methods to compare; all if empty.
    pub methods: Vec<String>,
}

impl Default for TableSettings {
    /// 160 × 90 pixels, 1,024 lights, seed 1, at most 20 million pairs, the best of three times, 9 levels, all methods.
    fn default() -> Self {
        Self {
            size: [1920, 1080],
            lights: 1024,
            seed: 1,
            most_pairs: 20_000_000,
            repeats: 3,
            levels: 9,
            methods: Vec::new(),
        }
    }
}

impl TableSettings {
    /// The methods to compare.
    fn chosen(&self, source: &dyn MethodSource) -> Result<Vec<String>, BenchError> {
        let known = source.names();
        if self.methods.is_empty() {
            return Ok(known.into_iter().map(str::to_owned).collect());
        }
        match self.methods.iter().find(|name| !known.contains(&name.as_str())) {
            Some(name) => Err(BenchError::NoSuchMethod { name: name.clone(), known: known.join(", ") }),
            None => Ok(self.methods.clone()),
        }
    }
}

/// The bake's own settings of rows.
fn default_rows() -> RowsOptions {
    BakeOptions::default().rows.expect("a bake has rows unless told otherwise")
}
