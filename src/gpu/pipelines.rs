use super::GpuContext;
use manyview_shaders::device::DeviceError;
use manyview_shaders::stages::{BindingKind, Kind, Stage};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Format of depth images.
pub(super) const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// A stage made ready for a device.
pub(super) struct StagePipeline {
    pub(super) layout: wgpu::BindGroupLayout,
    pub(super) runs: Runs,
}

/// What runs it.
pub(super) enum Runs {
    Compute(wgpu::ComputePipeline),
    Depth(wgpu::RenderPipeline),
}

/// Pipelines by the name of their stage, made when first used.
#[derive(Default)]
pub(super) struct Pipelines(Mutex<BTreeMap<&'static str, Arc<StagePipeline>>>);

impl Pipelines {
    pub(super) fn get(
        &self,
        context: &GpuContext,
        stage: &'static Stage,
    ) -> Result<Arc<StagePipeline>, DeviceError> {
        let mut made = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(pipeline) = made.get(stage.name) {
            return Ok(Arc::clone(pipeline));
        }
        let pipeline = Arc::new(context.guarded(stage.name, 0, || make(context.device(), stage))?);
        made.insert(stage.name, Arc::clone(&pipeline));
        Ok(pipeline)
    }
}

fn make(device: &wgpu::Device, stage: &Stage) -> StagePipeline {
    let label = Some(stage.name);
    let visibility = match stage.kind {
        Kind::Compute { .. } => wgpu::ShaderStages::COMPUTE,
        Kind::Depth { .. } => wgpu::ShaderStages::VERTEX_FRAGMENT,
    };
    let buffer = |ty| wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None };
    let entries: Vec<_> = (0..)
        .zip(stage.bindings)
        .map(|(binding, kind)| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: match (stage.kind, kind) {
                (Kind::Depth { .. }, BindingKind::ReadWrite) => wgpu::ShaderStages::FRAGMENT,
                _ => visibility,
            },
            ty: match kind {
                BindingKind::Uniform => buffer(wgpu::BufferBindingType::Uniform),
                BindingKind::Read => buffer(wgpu::BufferBindingType::Storage { read_only: true }),
                BindingKind::ReadWrite => buffer(wgpu::BufferBindingType::Storage { read_only: false }),
                BindingKind::Depth => wgpu::BindingType::Texture {
                    sample_type: wgpu::TextureSampleType::Depth,
                    view_dimension: wgpu::TextureViewDimension::D2,
                    multisampled: false,
                },
                BindingKind::Rows => wgpu::BindingType::Texture {
                    sample_type: wgpu::TextureSampleType::Uint,
                    view_dimension: wgpu::TextureViewDimension::D2Array,
                    multisampled: false,
                },
            },
            count: None,
        })
        .collect();
    let layout =
        device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label, entries: &entries });
    let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label,
        bind_group_layouts: &[Some(&layout)],
        immediate_size: 0,
    });
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label,
        source: wgpu::ShaderSource::Wgsl(stage.wgsl().into()),
    });
    let runs = match stage.kind {
        Kind::Compute { .. } => {
            Runs::Compute(device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label,
                layout: Some(&pipeline_layout),
                module: &module,
                entry_point: Some("main"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache: None,
            }))
        }
        Kind::Depth { .. } => Runs::Depth(device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label,
            layout: Some(&pipeline_layout),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("vertex"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: Some(wgpu::DepthStencilState {
                format: DEPTH_FORMAT,
                depth_write_enabled: Some(true),
                depth_compare: Some(wgpu::CompareFunction::Less),
                stencil: wgpu::StencilState::default(),
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("fragment"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &[],
            }),
            multiview_mask: None,
            cache: None,
        })),
    };
    StagePipeline { layout, runs }
}
