//! Scenes made by code: for the examples, and for measurements of how costs grow with the number of triangles.
//!
//! Each kind can be made with any number of triangles. Larger scenes cover more ground and hold more different geometry,
//! not only more instances of the same. The same kind, number and seed give the same scene on every host: random numbers
//! are integers, and floating point goes no further than the operations that IEEE 754 defines exactly.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;

use crate::scene::Scene;

mod city;
mod forest;
mod hairball;
mod house;
mod model;
mod palette;
mod park;
mod rng;
mod street;
mod terrain;
mod texture;
mod town;
mod tree;

#[cfg(test)]
mod tests;

/// Smallest number of triangles that [`generate`] aims at; fewer do not make a scene.
pub const MIN_TRIANGLES: u64 = 1_000;

/// Largest number of triangles that the command line and recipes ask for.
pub const MAX_TRIANGLES: u64 = 1_000_000_000;

/// What [`generate`] can make.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum SceneKind {
    /// Houses with gardens around a square with a church and a fountain; street lamps, lit windows, trees with masked
    /// leaves.
    Town,
    /// Towers with grids of windows, many of them lit.
    City,
    /// Trees, of masked leaf cards and of real leaves, with undergrowth.
    Forest,
    /// Thin curved tubes around a sphere.
    Hairball,
    /// Lawns, paths, trees, benches, and many people.
    Park,
}

impl SceneKind {
    /// Every kind.
    pub const fn all() -> [SceneKind; 5] {
        [SceneKind::Town, SceneKind::City, SceneKind::Forest, SceneKind::Hairball, SceneKind::Park]
    }

    /// The name that [`FromStr`] reads.
    pub const fn name(self) -> &'static str {
        match self {
            SceneKind::Town => "town",
            SceneKind::City => "city",
            SceneKind::Forest => "forest",
            SceneKind::Hairball => "hairball",
            SceneKind::Park => "park",
        }
    }
}

impl fmt::Display for SceneKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// A name that is no [`SceneKind`].
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("no scene is called {name:?}: use town, city, forest, hairball or park")]
pub struct UnknownSceneKind {
    /// What was asked for.
    pub name: String,
}

impl FromStr for SceneKind {
    type Err = UnknownSceneKind;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let kind = Self::all().into_iter().find(|kind| kind.name() == name);
        kind.ok_or_else(|| UnknownSceneKind { name: name.to_owned() })
    }
}

/// Makes a scene that draws `triangles` (instances counted) to within a few per cent, from [`MIN_TRIANGLES`] upwards;
/// smaller numbers count as that.
///
/// ```
/// use manyview_pipeline::generate::{SceneKind, generate};
///
/// let scene = generate(SceneKind::Town, 20_000, 1);
/// assert!(scene.drawn_triangles().abs_diff(20_000) < 600);
/// ```
pub fn generate(kind: SceneKind, triangles: u64, seed: u64) -> Scene {
    let triangles = triangles.max(MIN_TRIANGLES);
    let mut scene = Scene::default();
    match kind {
        SceneKind::Town => town::town(&mut scene, triangles, seed),
        SceneKind::City => city::city(&mut scene, triangles, seed),
        SceneKind::Forest => forest::forest(&mut scene, triangles, seed),
        SceneKind::Hairball => hairball::hairball(&mut scene, triangles, seed),
        SceneKind::Park => park::park(&mut scene, triangles, seed),
    }
    palette::drop_unused(&mut scene);
    scene
}
