//! Methods that are stages: on the GPU, or by their twins.

use crate::visibility::{Visibility, VisibilityError};
use manyview_shaders::device::DeviceError;
use manyview_shaders::executor::{Binding, Executor, Recording};
use manyview_shaders::jobs::{MethodStage, hidden_lights, occluded_segments, segment_distances};
use manyview_shaders::stages::Stage;
use manyview_shaders::types::{LightPoint, Receiver, Segment};
use std::sync::{Mutex, PoisonError};

/// The two stages of a method.
#[derive(Debug, Clone, Copy)]
pub struct MethodStages {
    /// As in `--method` and in tables.
    pub name: &'static str,
    /// With `lib_hidden_lights.wgsl`.
    pub hidden_lights: &'static Stage,
    /// With `lib_segments.wgsl`.
    pub segments: &'static Stage,
    /// Rays of one dispatch.
    pub rays_per_dispatch: u64,
}

/// A method that runs as stages, with what it reads resident on an executor.
pub struct StageVisibility<'a> {
    stages: MethodStages,
    bindings: Vec<Binding>,
    executor: Mutex<Box<dyn Executor + Send + 'a>>,
}

impl<'a> StageVisibility<'a> {
    /// Uploads what the method reads: names and bytes of its bindings, in order. What exceeds the executor's largest
    /// binding is an error that names it.
    pub fn new(
        stages: MethodStages,
        mut executor: Box<dyn Executor + Send + 'a>,
        parts: &[(&'static str, &[u8])],
    ) -> Result<Self, DeviceError> {
        let mut bindings = Vec::with_capacity(parts.len());
        let mut recording = Recording::new();
        for &(what, bytes) in parts {
            let buffer = executor.buffer(what, bytes.len() as u64)?;
            recording.upload(buffer, bytes);
            bindings.push(buffer.into());
        }
        executor.run(&recording)?;
        Ok(Self::with_bindings(stages, executor, bindings))
    }

    /// Takes what the method reads from where it is on the executor already.
    pub fn with_bindings(
        stages: MethodStages,
        executor: Box<dyn Executor + Send + 'a>,
        bindings: Vec<Binding>,
    ) -> Self {
        Self { stages, bindings, executor: Mutex::new(executor) }
    }

    fn run(
        &self,
        stage: &'static Stage,
        job: impl FnOnce(&mut dyn Executor, &MethodStage) -> Result<(), DeviceError>,
    ) -> Result<(), VisibilityError> {
        let rays_per_dispatch = self.stages.rays_per_dispatch;
        let method = MethodStage { stage, bindings: &self.bindings, rays_per_dispatch };
        let mut executor = self.executor.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(job(&mut **executor, &method)?)
    }
}

impl Visibility for StageVisibility<'_> {
    fn name(&self) -> &'static str {
        self.stages.name
    }

    fn occluded(&self, segments: &[Segment], occluded: &mut [u8]) -> Result<(), VisibilityError> {
        self.run(self.stages.segments, |executor, method| {
            occluded_segments(executor, method, segments, occluded)
        })
    }

    fn distances(&self, segments: &[Segment], distances: &mut [f32]) -> Result<(), VisibilityError> {
        self.run(self.stages.segments, |executor, method| {
            segment_distances(executor, method, segments, distances)
        })
    }

    fn hidden_lights(
        &self,
        receivers: &[Receiver],
        lights: &[LightPoint],
        hidden: &mut [u32],
    ) -> Result<(), VisibilityError> {
        self.run(self.stages.hidden_lights, |executor, method| {
            hidden_lights(executor, method, receivers, lights, hidden)
        })
    }
}
