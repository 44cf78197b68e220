//! Scenes to measure: files, or generated ones.

use super::BenchError;
use manyview_pipeline::bake::BakeError;
use manyview_pipeline::generate::{MAX_TRIANGLES, MIN_TRIANGLES, SceneKind, generate};
use manyview_pipeline::import::{ImportOptions, import};
use manyview_pipeline::scene::Scene;
use manyview_pipeline::triangles::{Cutouts, LatticeTriangles};
use manyview_shaders::directions::RowLattice;
use std::path::PathBuf;
use std::str::FromStr;
use thiserror::Error;

/// Where a scene comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SceneSource {
    /// A glTF file.
    File(PathBuf),
    /// A generated scene of about so many triangles, seed 1.
    Generated {
        /// What it shows.
        kind: SceneKind,
        /// How many triangles it draws.
        triangles: u64,
    },
}

/// A text that names no scene.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum UnknownScene {
    /// Neither a path nor a kind with a number.
    #[error(
        "`{text}` is no scene: write the path of a .glb or .gltf file, or KIND:TRIANGLES such as town:100000"
    )]
    Text {
        /// The text.
        text: String,
    },
    /// So few or many triangles are not made.
    #[error(
        "`{text}`: generated scenes have {MIN_TRIANGLES} to {MAX_TRIANGLES} triangles, such as town:100000"
    )]
    Triangles {
        /// The text.
        text: String,
    },
}

impl FromStr for SceneSource {
    type Err = UnknownScene;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        if let Some((kind, triangles)) = text.split_once(':')
            && let Ok(kind) = kind.parse()
        {
            return match triangles.parse() {
                Ok(triangles @ MIN_TRIANGLES..=MAX_TRIANGLES) => Ok(Self::Generated { kind, triangles }),
                Ok(_) => Err(UnknownScene::Triangles { text: text.to_owned() }),
                Err(_) => Err(UnknownScene::Text { text: text.to_owned() }),
            };
        }
        match text.is_empty() {
            true => Err(UnknownScene::Text { text: text.to_owned() }),
            false => Ok(Self::File(text.into())),
        }
    }
}

/// A scene with what every measurement needs of it.
pub struct BenchScene {
    /// File name without extension, or kind and triangles; for tables.
    pub name: String,
    /// The scene.
    pub scene: Scene,
    /// How alpha cuts it.
    pub cutouts: Cutouts,
    /// World to row lattice.
    pub lattice: RowLattice,
    /// The drawn triangles on the row lattice.
    pub row_triangles: LatticeTriangles,
}

impl BenchScene {
    /// Loads or makes a scene.
    pub fn load(source: &SceneSource) -> Result<Self, BenchError> {
        match source {
            SceneSource::File(path) => {
                let name = path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
                Self::new(name, import(path, &ImportOptions::default())?.scene)
            }
            SceneSource::Generated { kind, triangles } => {
                Self::new(format!("{kind}:{triangles}"), generate(*kind, *triangles, 1))
            }
        }
    }

    /// Prepares a scene.
    pub fn new(name: String, scene: Scene) -> Result<Self, BenchError> {
        let refuse = |source| BenchError::Scene { scene: name.clone(), source };
        let bounds = scene.bounds().map(|(min, max)| (min.to_array(), max.to_array()));
        let Some((min, max)) = bounds.filter(|_| scene.drawn_triangles() > 0) else {
            return Err(refuse(BakeError::Empty { warnings: scene.warnings.clone() }));
        };
        if manyview_pipeline::cube::SceneCube::around(min, max).is_none() {
            return Err(refuse(BakeError::Bounds { min, max }));
        }
        let lattice = RowLattice::new(min, max);
        let cutouts = Cutouts::new(&scene);
        let row_triangles = LatticeTriangles::new(&scene, &cutouts, |p| lattice.snap(p.to_array()));
        if row_triangles.triangles.is_empty() {
            return Err(refuse(BakeError::AllTransparent));
        }
        Ok(Self { name, scene, cutouts, lattice, row_triangles })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_are_files_or_kinds() {
        assert_eq!("a/b.glb".parse(), Ok(SceneSource::File("a/b.glb".into())));
        assert_eq!(
            "city:5000".parse(),
            Ok(SceneSource::Generated { kind: SceneKind::City, triangles: 5000 })
        );
        assert_eq!("C:\\x.glb".parse(), Ok(SceneSource::File("C:\\x.glb".into())));
        for text in ["town:0", "town:999", "town:1000000001"] {
            assert_eq!(text.parse::<SceneSource>(), Err(UnknownScene::Triangles { text: text.to_owned() }));
        }
        assert!("town:1000".parse::<SceneSource>().is_ok());
        assert!("city:many".parse::<SceneSource>().is_err() && "".parse::<SceneSource>().is_err());
    }

    #[test]
    fn a_scene_without_triangles_is_refused_by_name() {
        let error = BenchScene::new("void".to_owned(), Scene::default()).err().unwrap();
        assert!(error.to_string().starts_with("void: "), "{error}");
    }
}
