//! Recipes: a bake's settings in a TOML file, to be committed beside the scene.
//!
//! ```toml
//! scene = "../scenes/village.glb"       # or: generate = { kind = "town", triangles = 100000, seed = 1 }
//! output = "out/village.mvb"
//! preview = "out/village.png"           # a picture of the result
//! camera = "village.camera.toml"        # from here, as `manyview preview --camera` reads it
//! levels = 11
//! rows = 128                            # voxels a side, 0 for none
//! directions = "latlong:90x90"
//! grid = "extent"                       # or "cube"
//! rows_from = "points"                  # or "peel", "rotate"
//! cube = { origin = [-64.0, -8.0, -64.0], size = 128.0 }
//! ```
//!
//! Every key may be left out. Paths are relative to the recipe. An unknown key is an error.

use crate::bake::{BakeOptions, RowsFrom};
use crate::cube::SceneCube;
use crate::generate::{MAX_TRIANGLES, MIN_TRIANGLES, SceneKind};
use crate::rows::RowsOptions;
use manyview_shaders::directions::Fit;
use serde::Deserialize;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Where the triangles come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SceneSource {
    /// A `.glb` or `.gltf` file.
    File(PathBuf),
    /// Made by code ([`crate::generate`]).
    Generated {
        /// What to make.
        kind: SceneKind,
        /// About how many triangles.
        triangles: u64,
        /// Another seed gives another scene of the same kind.
        seed: u64,
    },
}

/// A parsed recipe; paths are relative to the current folder.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Recipe {
    /// The scene.
    pub scene: Option<SceneSource>,
    /// The archive.
    pub output: Option<PathBuf>,
    /// A picture of the result.
    pub preview: Option<PathBuf>,
    /// The camera of that picture; fitted to the scene if there is none.
    pub camera: Option<PathBuf>,
    /// Settings: the defaults where the recipe says nothing.
    pub options: BakeOptions,
    /// Time of the animation, seconds.
    pub time_seconds: Option<f64>,
}

/// What is wrong with a recipe.
#[derive(Debug, Error)]
#[error("recipe {path}: {reason}")]
pub struct RecipeError {
    /// The recipe file.
    pub path: PathBuf,
    /// The place, the rule, the fix.
    pub reason: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    scene: Option<PathBuf>,
    generate: Option<Generate>,
    output: Option<PathBuf>,
    preview: Option<PathBuf>,
    camera: Option<PathBuf>,
    levels: Option<u32>,
    rows: Option<u32>,
    directions: Option<String>,
    grid: Option<String>,
    rows_from: Option<String>,
    cube: Option<Cube>,
    time: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Generate {
    kind: String,
    triangles: u64,
    #[serde(default)]
    seed: u64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Cube {
    origin: [f64; 3],
    size: f64,
}

impl Recipe {
    /// Reads the recipe at `path`.
    pub fn read(path: &Path) -> Result<Self, RecipeError> {
        let fail = |reason: String| RecipeError { path: path.to_owned(), reason };
        let text = fs_err::read_to_string(path)
            .map_err(|e| fail(format!("{e}; check that the file is there and readable")))?;
        Self::parse(&text, path.parent().unwrap_or(Path::new(""))).map_err(fail)
    }

    /// Parses a recipe whose paths are relative to `folder`. Errors name the line or the key.
    pub fn parse(text: &str, folder: &Path) -> Result<Self, String> {
        let file: File = toml::from_str(text).map_err(|e| e.to_string())?;
        let defaults = BakeOptions::default();
        let default_rows = defaults.rows.expect("rows are baked by default");
        let scene = match (file.scene, file.generate) {
            (Some(_), Some(_)) => {
                return Err("`scene` and `generate` exclude each other: keep one".to_owned());
            }
            (Some(scene), None) => Some(SceneSource::File(folder.join(scene))),
            (None, Some(Generate { kind, triangles, seed })) => {
                let kind = kind.parse().map_err(|e| format!("generate.kind: {e}"))?;
                if !(MIN_TRIANGLES..=MAX_TRIANGLES).contains(&triangles) {
                    return Err(format!(
                        "generate.triangles is {triangles}, it must be {MIN_TRIANGLES} to {MAX_TRIANGLES}"
                    ));
                }
                Some(SceneSource::Generated { kind, triangles, seed })
            }
            (None, None) => None,
        };
        let rows = RowsOptions {
            bits: default_rows.bits,
            directions: match file.directions {
                Some(directions) => directions.parse().map_err(|e| format!("directions: {e}"))?,
                None => default_rows.directions,
            },
            fit: match file.grid {
                Some(grid) => parse_fit(&grid).map_err(|e| format!("grid: {e}"))?,
                None => default_rows.fit,
            },
            from: match file.rows_from {
                Some(from) => parse_rows_from(&from).map_err(|e| format!("rows_from: {e}"))?,
                None => default_rows.from,
            },
        };
        let size = file.rows.unwrap_or(1 << rows.bits);
        let rows =
            parse_rows_size(size).map_err(|e| format!("rows: {e}"))?.map(|bits| RowsOptions { bits, ..rows });
        let cube = file.cube.map(|c| SceneCube { origin: c.origin, size: c.size });
        if cube
            .is_some_and(|c| !(c.size.is_finite() && c.size > 0.0 && c.origin.iter().all(|o| o.is_finite())))
        {
            return Err("cube: the size must be positive and all numbers finite".to_owned());
        }
        Ok(Self {
            scene,
            output: file.output.map(|p| folder.join(p)),
            preview: file.preview.map(|p| folder.join(p)),
            camera: file.camera.map(|p| folder.join(p)),
            options: BakeOptions { levels: file.levels.unwrap_or(defaults.levels), rows, cube, ..defaults },
            time_seconds: file.time,
        })
    }
}

/// log2 of the voxels a side of a row grid; `None` for 0, no rows.
pub fn parse_rows_size(size: u32) -> Result<Option<u32>, String> {
    match size {
        0 => Ok(None),
        32 | 64 | 128 | 256 => Ok(Some(size.ilog2())),
        _ => Err(format!("{size} voxels a side are not possible: use 32, 64, 128 or 256, or 0 for no rows")),
    }
}

/// `extent` or `cube`.
pub fn parse_fit(text: &str) -> Result<Fit, String> {
    match text {
        "extent" => Ok(Fit::Extent),
        "cube" => Ok(Fit::Cube),
        _ => Err(format!("`{text}` is no grid: use extent or cube")),
    }
}

/// `points`, `peel` or `rotate`.
pub fn parse_rows_from(text: &str) -> Result<RowsFrom, String> {
    RowsFrom::ALL
        .iter()
        .find(|(_, name)| *name == text)
        .map(|(from, _)| *from)
        .ok_or_else(|| format!("`{text}` is no way to make rows: use points, peel or rotate"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use manyview_shaders::directions::DirectionSet;

    #[test]
    fn an_empty_recipe_is_the_defaults() {
        assert_eq!(Recipe::parse("", Path::new("a")), Ok(Recipe::default()));
    }

    #[test]
    fn every_key_is_read() {
        let text = r#"
            generate = { kind = "town", triangles = 5000, seed = 3 }
            output = "out/t.mvb"
            preview = "t.png"
            camera = "c.toml"
            levels = 9
            rows = 64
            directions = "octahedral:30"
            grid = "cube"
            rows_from = "rotate"
            cube = { origin = [-1.0, 0.0, -1.0], size = 2.0 }
            time = 1.5
        "#;
        let recipe = Recipe::parse(text, Path::new("a")).unwrap();
        assert_eq!(
            recipe.scene,
            Some(SceneSource::Generated { kind: SceneKind::Town, triangles: 5000, seed: 3 })
        );
        assert_eq!(recipe.output.as_deref(), Some(Path::new("a/out/t.mvb")));
        assert_eq!(recipe.camera.as_deref(), Some(Path::new("a/c.toml")));
        assert_eq!(recipe.options.levels, 9);
        let rows = recipe.options.rows.unwrap();
        assert_eq!((rows.bits, rows.directions), (6, DirectionSet::Octahedral { size: 30 }));
        assert_eq!((rows.fit, rows.from), (Fit::Cube, RowsFrom::Rotate));
        assert_eq!(recipe.options.cube, Some(SceneCube { origin: [-1.0, 0.0, -1.0], size: 2.0 }));
        assert_eq!(recipe.time_seconds, Some(1.5));
    }

    #[test]
    fn mistakes_are_named() {
        for (text, needle) in [
            ("level = 3", "unknown field `level`"),
            ("rows = 100", "rows: 100"),
            ("directions = \"sphere\"", "directions: `sphere`"),
            ("grid = \"ball\"", "grid: `ball`"),
            ("rows_from = \"magic\"", "rows_from: `magic`"),
            ("scene = \"a.glb\"\ngenerate = { kind = \"town\", triangles = 1 }", "exclude each other"),
            ("generate = { kind = \"sea\", triangles = 1 }", "generate.kind"),
            ("generate = { kind = \"town\", triangles = 999 }", "generate.triangles is 999"),
            ("cube = { origin = [0.0, 0.0, nan], size = 1.0 }", "cube"),
        ] {
            let error = Recipe::parse(text, Path::new("")).unwrap_err();
            assert!(error.contains(needle), "{text}: {error}");
        }
    }
}
