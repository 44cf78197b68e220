//! Surfaces of pixels by our own rasterizer on a GPU.
//!
//! # Practice
//! The GPU finds the triangle of every pixel ([`visible_triangles`]); [`GBuffer::resolve`](super::gbuffer::GBuffer::resolve)
//! does the rest. Positions go to the GPU from the eye, so that scenes far from the origin lose nothing.

use super::scene::RenderScene;
use crate::gpu::{GpuContext, WgpuExecutor};
use crate::preview::{Camera, CameraError};
use crate::reference::Reference;
use glam::DVec3;
use manyview_shaders::device::DeviceError;
use manyview_shaders::executor::{Executor, ExecutorLimits};
use manyview_shaders::jobs::{VisibleBatch, visible_triangles};
use manyview_shaders::types::ViewParams;
use thiserror::Error;

/// What is nearer than this share of the scene's extent is not drawn.
const NEAR_SHARE: f64 = 1e-6;

/// Why no triangles were found.
#[derive(Debug, Error)]
pub enum RasterError {
    /// The camera cannot see.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The GPU failed.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

/// Index of the triangle that each pixel shows, or [`NO_TRIANGLE`](super::gbuffer::NO_TRIANGLE).
pub fn triangles(
    gpu: &GpuContext,
    scene: &RenderScene,
    reference: &Reference<'_>,
    camera: &Camera,
    size: [u32; 2],
) -> Result<Vec<u32>, RasterError> {
    triangles_on(&mut WgpuExecutor::new(gpu, ExecutorLimits::DEFAULT), scene, reference, camera, size)
}

/// [`triangles`] on any executor.
pub fn triangles_on(
    executor: &mut dyn Executor,
    scene: &RenderScene,
    reference: &Reference<'_>,
    camera: &Camera,
    size: [u32; 2],
) -> Result<Vec<u32>, RasterError> {
    let rays = camera.ray_maker(size[0], size[1])?;
    let [right, up] = rays.half_axes();
    let single = |v: DVec3| v.as_vec3().to_array();
    // The sphere around the scene ends before this.
    let far = (camera.eye - (scene.bounds[0] + scene.bounds[1]) * 0.5).length() + scene.radius();
    let view = ViewParams {
        forward: single(rays.forward()),
        near_metres: (scene.extent() * NEAR_SHARE) as f32,
        right: single(right),
        far_metres: (far * 1.001) as f32,
        up: single(up),
        width: size[0],
        right_over_square: single(right / right.length_squared()),
        height: size[1],
        up_over_square: single(up / up.length_squared()),
        collect: 0,
    };
    let from_eye = |index: usize| reference.triangles()[index].map(|p| single(p - camera.eye));
    let cutouts = reference.cutouts();
    let batch = VisibleBatch {
        count: reference.triangles().len(),
        vertices: &from_eye,
        mask_of: reference.mask_indices(),
        masks: &cutouts.masks,
        planes: &cutouts.planes,
    };
    Ok(visible_triangles(executor, &view, &batch)?)
}
