//! A scene made ready for pictures.

use crate::preview::{self, Camera, CameraChoice, choose_camera};
use crate::reference::Reference;
use crate::{Archive, LoadError};
use glam::DVec3;
use manyview_pipeline::bake::{BakeError, BakeOptions, bake_in_memory};
use manyview_pipeline::scene::Scene;
use manyview_pipeline::triangles::{Cutouts, LatticeTriangles};
use thiserror::Error;

/// Depth of the octree that a camera is chosen by: rooms and streets are seen in it, and it is made in a moment.
const CAMERA_LEVELS: u32 = 8;

/// Why a scene cannot be drawn.
#[derive(Debug, Error)]
pub enum SceneError {
    /// It has no triangles, or none with a finite place.
    #[error(transparent)]
    Unusable(#[from] BakeError),
    /// The octree for choosing a camera cannot be read.
    #[error(transparent)]
    Load(#[from] LoadError),
}

/// A scene, and what rays and rasters need of it.
pub struct RenderScene {
    /// Meshes, materials, textures, lights.
    pub scene: Scene,
    /// Smallest and largest corner of what is drawn, metres.
    pub bounds: [DVec3; 2],
    cutouts: Cutouts,
    drawn: LatticeTriangles,
}

impl RenderScene {
    /// Takes a scene that draws something.
    pub fn new(scene: Scene) -> Result<Self, SceneError> {
        let Some((min, max)) = scene.bounds().filter(|_| scene.drawn_triangles() > 0) else {
            return Err(BakeError::Empty { warnings: scene.warnings }.into());
        };
        if manyview_pipeline::cube::SceneCube::around(min.to_array(), max.to_array()).is_none() {
            return Err(BakeError::Bounds { min: min.to_array(), max: max.to_array() }.into());
        }
        let cutouts = Cutouts::new(&scene);
        // Only the list of triangles is wanted, not their place on a lattice.
        let drawn = LatticeTriangles::new(&scene, &cutouts, |_| [0; 3]);
        if drawn.sources.is_empty() {
            return Err(BakeError::AllTransparent.into());
        }
        Ok(Self { scene, bounds: [min, max], cutouts, drawn })
    }

    /// The scene's triangles, ready for exact rays.
    pub fn reference(&self) -> Reference<'_> {
        Reference::new(&self.scene, &self.drawn, &self.cutouts)
    }

    /// Largest extent along an axis, metres.
    pub fn extent(&self) -> f64 {
        (self.bounds[1] - self.bounds[0]).max_element()
    }

    /// Radius of the sphere around the bounds, metres.
    pub fn radius(&self) -> f64 {
        (self.bounds[1] - self.bounds[0]).length() * 0.5
    }

    /// A camera that shows something, for pictures of an aspect ratio (width / height). It depends on the scene alone,
    /// not on any archive, so that pictures of several methods show the same.
    pub fn choose_camera(&self, aspect: f64, choice: CameraChoice) -> Result<Camera, SceneError> {
        let options = BakeOptions { levels: CAMERA_LEVELS, rows: None, ..BakeOptions::default() };
        let octree = Archive::from_bytes(bake_in_memory(&self.scene, &options)?)?.svo()?;
        Ok(choose_camera(&preview::Scene::new(octree), self.bounds, aspect, choice))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_without_triangles_is_refused() {
        let error = RenderScene::new(Scene::default()).err().unwrap();
        assert!(matches!(error, SceneError::Unusable(BakeError::Empty { .. })), "{error}");
    }
}
