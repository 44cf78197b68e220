//! Our segment test for your shader: WGSL to put in front of it, and the bindings that it reads.
//!
//! [`rows`] gives the text. It defines two functions (and others, whose names are then taken):
//!
//! ```wgsl
//! // Whether anything is between two points (world space, metres). `normal` is the unit normal of the surface that
//! // `origin` is on, on the side of `end`; zero if it is on none.
//! fn is_hidden(origin: vec3<f32>, end: vec3<f32>, normal: vec3<f32>) -> bool
//! // Metres to the first voxel between them; negative if there is none.
//! fn hit_distance(origin: vec3<f32>, end: vec3<f32>, normal: vec3<f32>) -> f32
//! ```
//!
//! The bindings are five in a row, in the group and from the number that you choose:
//!
//! | binding | what | size for the paper's set |
//! |---|---|---|
//! | first | uniform buffer [`RowTestParams`] | 64 B |
//! | + 1 | read-only storage buffer: the direction table, two 16-bit directions a word | 384 KiB |
//! | + 2 | read-only storage buffer: for each direction the tile that answers for it ([`GpuScene::tile_table`]) | 32 KiB |
//! | + 3 | read-only storage buffer: a [`PackedFrame`] a tile | 380 KiB |
//! | + 4 | `texture_2d_array<u32>` of format `rgba32uint`: the rows ([`GpuScene::rows_view`]) | 2 GiB |
//!
//! [`RowBindings`] makes the first, second and fourth and describes all of them. While a scene still arrives the same
//! bindings stay valid: the tile table changes in place.
//!
//! A whole program is in the guide *Load a bake in your viewer* ([`crate::guide`]).

use crate::gpu::GpuScene;
use crate::rays::{RowTables, TestSettings};
use bytemuck::Pod;
use manyview_shaders::device::DeviceError;
pub use manyview_shaders::row_test::{PackedFrame, RowTestParams};

/// Bindings that [`rows`] reads.
pub const ROW_BINDINGS: u32 = 5;

/// The functions of the [module](self), which read bindings `first_binding` to `first_binding + 4` of `group`.
pub fn rows(group: u32, first_binding: u32) -> String {
    let functions = include_str!("../shaders/lib_rows.wgsl")
        .replace("@group(0)", &format!("@group({group})"))
        .replace("METHOD_BINDING", &format!("{first_binding}u"));
    let constants = manyview_shaders::constants::wgsl();
    // Only what the functions use: every name is one less for the caller.
    let used = constants.lines().filter(|line| {
        let name = line.strip_prefix("const ").and_then(|rest| rest.split(':').next());
        name.is_some_and(|name| functions.contains(name))
    });
    used.flat_map(|line| [line, "\n"]).chain([functions.as_str()]).collect()
}

/// The buffers that [`rows`] reads beside those of the [`GpuScene`].
#[derive(Debug, Clone)]
pub struct RowBindings {
    params: wgpu::Buffer,
    cells: wgpu::Buffer,
    frames: wgpu::Buffer,
}

impl RowBindings {
    /// Makes and fills them on the scene's device: less than 1 MiB.
    pub fn new(scene: &GpuScene, settings: &TestSettings) -> Result<Self, DeviceError> {
        let lattice = scene.row_lattice();
        let tables =
            RowTables::new(scene.direction_set(), &lattice, scene.layout(), scene.frames(), settings);
        let storage = wgpu::BufferUsages::STORAGE;
        Ok(Self {
            params: filled(scene, "row test parameters", wgpu::BufferUsages::UNIFORM, &[tables.params])?,
            cells: filled(scene, "direction table", storage, &tables.cells)?,
            frames: filled(scene, "row test frames", storage, &tables.frames)?,
        })
    }

    /// How to declare the bindings.
    pub fn layout_entries(
        first_binding: u32,
        visibility: wgpu::ShaderStages,
    ) -> [wgpu::BindGroupLayoutEntry; ROW_BINDINGS as usize] {
        let buffer = |ty| wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None };
        let storage = buffer(wgpu::BufferBindingType::Storage { read_only: true });
        let texture = wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Uint,
            view_dimension: wgpu::TextureViewDimension::D2Array,
            multisampled: false,
        };
        let mut binding = first_binding;
        [buffer(wgpu::BufferBindingType::Uniform), storage, storage, storage, texture].map(|ty| {
            let entry = wgpu::BindGroupLayoutEntry { binding, visibility, ty, count: None };
            binding += 1;
            entry
        })
    }

    /// What to bind.
    pub fn entries<'a>(
        &'a self,
        scene: &'a GpuScene,
        first_binding: u32,
    ) -> [wgpu::BindGroupEntry<'a>; ROW_BINDINGS as usize] {
        let mut binding = first_binding;
        [
            self.params.as_entire_binding(),
            self.cells.as_entire_binding(),
            scene.tile_table().as_entire_binding(),
            self.frames.as_entire_binding(),
            wgpu::BindingResource::TextureView(scene.rows_view()),
        ]
        .map(|resource| {
            let entry = wgpu::BindGroupEntry { binding, resource };
            binding += 1;
            entry
        })
    }
}

fn filled<T: Pod>(
    scene: &GpuScene,
    what: &'static str,
    usage: wgpu::BufferUsages,
    data: &[T],
) -> Result<wgpu::Buffer, DeviceError> {
    let bytes: &[u8] = bytemuck::cast_slice(data);
    let context = scene.context();
    context.guarded(what, bytes.len() as u64, || {
        let buffer = context.device().create_buffer(&wgpu::BufferDescriptor {
            label: Some(what),
            size: bytes.len() as u64,
            usage: usage | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        context.queue().write_buffer(&buffer, 0, bytes);
        buffer
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_text_is_valid_in_any_group_and_with_a_shader_behind_it() {
        for (group, first) in [(0, 0), (2, 7)] {
            let text = rows(group, first)
                + "
                @group(1) @binding(0) var<storage, read_write> hidden: array<u32>;
                @compute @workgroup_size(64)
                fn main(@builtin(global_invocation_id) id: vec3<u32>) {
                    let point = vec3<f32>(f32(id.x), 0.0, 0.0);
                    hidden[id.x] = u32(is_hidden(point, vec3<f32>(9.0), vec3<f32>(0.0, 1.0, 0.0)));
                }";
            let module =
                naga::front::wgsl::parse_str(&text).unwrap_or_else(|e| panic!("{}", e.emit_to_string(&text)));
            let bound: Vec<_> = module.global_variables.iter().filter_map(|(_, v)| v.binding).collect();
            for binding in first..first + ROW_BINDINGS {
                let at = naga::ResourceBinding { group, binding };
                assert_eq!(bound.iter().filter(|bound| **bound == at).count(), 1, "{at:?}");
            }
            assert_eq!(bound.len(), 6);
            let mut validator = naga::valid::Validator::new(
                naga::valid::ValidationFlags::all(),
                naga::valid::Capabilities::empty(),
            );
            validator.validate(&module).unwrap();
        }
    }
}
