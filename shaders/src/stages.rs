//! The stage table: every shader, what it is given, and its CPU twin.
//!
//! # Practice
//! A stage is three things: `shaders/<stem>.wgsl`, its twin `shaders/src/stages/<stem>.rs` with the same bindings in
//! the same order, and its line in the table below. Fragments without an entry point (`lib_*.wgsl`) are named in the
//! line and put in front; [`crate::constants`] come before all. A missing file or twin does not compile; tests
//! compare the table with what the shader compiler sees.

mod lib_keep;
mod lib_rays;
mod lib_scan;
mod lib_view_tree;

use crate::executor::{CpuBinding, DepthImage};

/// What a stage does with a binding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BindingKind {
    /// A small struct that all invocations read.
    Uniform,
    /// A buffer to read.
    Read,
    /// A buffer to read and write; of a depth stage by its fragments alone.
    ReadWrite,
    /// A depth image to read.
    Depth,
    /// The rows of all directions to read ([`crate::rows_texture`]): a `texture_2d_array<u32>`.
    Rows,
}

/// The CPU twin of a compute stage, given the number of workgroups along each axis.
pub type ComputeTwin = fn([u32; 3], &mut [CpuBinding]);
/// The CPU twin of a depth stage, given the number of vertices and instances and the image drawn to.
pub type DepthTwin = fn([u32; 2], &mut [CpuBinding], &mut DepthImage);

/// How a stage runs.
#[derive(Debug, Clone, Copy)]
pub enum Kind {
    /// Entry point `main`, dispatched.
    Compute {
        /// Invocations along x, y, z of a workgroup.
        workgroup_size: [u32; 3],
        /// The same on the CPU.
        twin: ComputeTwin,
    },
    /// Entry points `vertex` and `fragment`, drawn to a depth image that keeps the smallest depth.
    Depth {
        /// The same on the CPU.
        twin: DepthTwin,
    },
}

/// One line of the table.
#[derive(Debug)]
pub struct Stage {
    /// Stem of its file and of its twin's.
    pub name: &'static str,
    /// What it is given: bindings 0, 1, … of group 0.
    pub bindings: &'static [BindingKind],
    /// How it runs.
    pub kind: Kind,
    /// Names and texts of the files that make up its shader, its own last.
    pub files: &'static [(&'static str, &'static str)],
}

impl Stage {
    /// The whole shader.
    pub fn wgsl(&self) -> String {
        let mut text = crate::constants::wgsl();
        for (_, file) in self.files {
            text.push_str(file);
        }
        text
    }
}

macro_rules! file {
    ($name:ident) => {
        (stringify!($name), include_str!(concat!("../", stringify!($name), ".wgsl")))
    };
}

macro_rules! stages {
    ($($name:ident($($lib:ident),*) [$($binding:ident),*] $kind:ident $({ $($field:ident: $value:expr),* })?;)*) => {
        $(mod $name;)*

        $(
            #[doc = concat!("`", stringify!($name), ".wgsl`: see there.")]
            #[allow(non_upper_case_globals, reason = "one name for the file, the twin and the stage")]
            pub static $name: Stage = Stage {
                name: stringify!($name),
                bindings: &[$(BindingKind::$binding),*],
                kind: Kind::$kind { $($($field: $value,)*)? twin: $name::twin },
                files: &[$(file!($lib),)* file!($name)],
            };
        )*

        /// Every stage.
        pub static STAGES: &[&Stage] = &[$(&$name),*];
    };
}

stages! {
    rotate_points(lib_frames) [Uniform, Read, Read, ReadWrite] Compute { workgroup_size: [64, 1, 1] };
    voxelize(
        lib_params, lib_raster, lib_masks, lib_frames, lib_triangles, lib_scan, lib_scan_small, lib_emit_bit
    ) [Uniform, Read, Read, Read, Read, Read, ReadWrite, ReadWrite] Compute { workgroup_size: [64, 1, 1] };
    voxelize_large(
        lib_params, lib_raster, lib_masks, lib_frames, lib_triangles, lib_scan, lib_scan_large, lib_emit_bit
    ) [Uniform, Read, Read, Read, Read, Read, Read, ReadWrite] Compute { workgroup_size: [64, 1, 1] };
    fragments(
        lib_params, lib_raster, lib_masks, lib_frames, lib_triangles, lib_scan, lib_scan_small, lib_emit_fragment
    ) [Uniform, Read, Read, Read, Read, Read, ReadWrite, ReadWrite] Compute { workgroup_size: [64, 1, 1] };
    fragments_large(
        lib_params, lib_raster, lib_masks, lib_frames, lib_triangles, lib_scan, lib_scan_large, lib_emit_fragment
    ) [Uniform, Read, Read, Read, Read, Read, Read, ReadWrite] Compute { workgroup_size: [64, 1, 1] };
    peel(lib_params, lib_raster, lib_masks, lib_frames, lib_triangles, lib_views)
        [Uniform, Uniform, Read, Read, Read, Read, Read, Read, Depth] Depth;
    peel_collect(lib_params, lib_raster, lib_views)
        [Uniform, Uniform, Read, Depth, ReadWrite, ReadWrite] Compute { workgroup_size: [8, 8, 1] };
    brickmap_hidden_lights(lib_rays, lib_hidden_lights, lib_brickmap)
        [Uniform, Read, Read, ReadWrite, Uniform, Read, Read, Read] Compute { workgroup_size: [64, 1, 1] };
    brickmap_segments(lib_rays, lib_segments, lib_brickmap)
        [Uniform, Read, ReadWrite, Uniform, Read, Read, Read] Compute { workgroup_size: [64, 1, 1] };
    rows_hidden_lights(lib_rays, lib_hidden_lights, lib_rows)
        [Uniform, Read, Read, ReadWrite, Uniform, Read, Read, Read, Rows] Compute { workgroup_size: [64, 1, 1] };
    rows_segments(lib_rays, lib_segments, lib_rows)
        [Uniform, Read, ReadWrite, Uniform, Read, Read, Read, Rows] Compute { workgroup_size: [64, 1, 1] };
    wide_bvh_hidden_lights(lib_rays, lib_hidden_lights, lib_masks, lib_wide_bvh)
        [Uniform, Read, Read, ReadWrite, Uniform, Read, Read, Read, Read, Read]
        Compute { workgroup_size: [64, 1, 1] };
    wide_bvh_segments(lib_rays, lib_segments, lib_masks, lib_wide_bvh)
        [Uniform, Read, ReadWrite, Uniform, Read, Read, Read, Read, Read] Compute { workgroup_size: [64, 1, 1] };
    view_keys(lib_scene_tree, lib_grid, lib_sort, lib_view_cones)
        [Uniform, Uniform, Read, ReadWrite, ReadWrite] Compute { workgroup_size: [64, 1, 1] };
    sort_count(lib_sort) [Uniform, Read, Read, ReadWrite] Compute { workgroup_size: [64, 1, 1] };
    scan_sums(lib_sums) [Uniform, Read, ReadWrite] Compute { workgroup_size: [64, 1, 1] };
    scan_apply(lib_sums) [Uniform, Read, ReadWrite] Compute { workgroup_size: [64, 1, 1] };
    sort_scatter(lib_sort) [Uniform, Read, Read, ReadWrite, ReadWrite] Compute { workgroup_size: [64, 1, 1] };
    sort_gather(lib_grid, lib_sort, lib_view_cones)
        [Uniform, Read, Read, Read, ReadWrite, ReadWrite] Compute { workgroup_size: [64, 1, 1] };
    tree_count(lib_scene_tree, lib_pass, lib_view_tree)
        [Uniform, Uniform, Read, Read, Read, ReadWrite] Compute { workgroup_size: [64, 1, 1] };
    tree_scan(lib_pass, lib_grid) [Uniform, ReadWrite, ReadWrite] Compute { workgroup_size: [1, 1, 1] };
    tree_emit(lib_scene_tree, lib_pass, lib_view_nodes, lib_view_tree)
        [Uniform, Uniform, Read, Read, Read, ReadWrite, ReadWrite, ReadWrite]
        Compute { workgroup_size: [64, 1, 1] };
    tree_merge(lib_pass, lib_level, lib_view_cones, lib_view_nodes)
        [Uniform, Uniform, Read, Read, ReadWrite, ReadWrite] Compute { workgroup_size: [64, 1, 1] };
    maps_clear(lib_pass, lib_grid) [Uniform, Read, ReadWrite] Compute { workgroup_size: [64, 1, 1] };
    maps_fuse(lib_pass, lib_level, lib_grid, lib_paraboloid, lib_view_nodes)
        [Uniform, Uniform, Read, Read, Read, ReadWrite] Compute { workgroup_size: [64, 1, 1] };
    maps_pack(lib_pass, lib_grid) [Uniform, Read, Read, Read, ReadWrite] Compute { workgroup_size: [64, 1, 1] };
    pairs_prepare(lib_pass, lib_grid)
        [Uniform, Read, ReadWrite, ReadWrite] Compute { workgroup_size: [1, 1, 1] };
    pairs_restart() [ReadWrite, ReadWrite] Compute { workgroup_size: [1, 1, 1] };
    pairs_step(lib_scene_tree, lib_pass, lib_grid, lib_paraboloid, lib_view_nodes, lib_keep)
        [Uniform, Uniform, Read, Read, Read, Read, ReadWrite, ReadWrite, ReadWrite, ReadWrite]
        Compute { workgroup_size: [64, 1, 1] };
    pairs_near(lib_scene_tree, lib_pass, lib_grid, lib_paraboloid, lib_view_nodes, lib_near_leaf, lib_keep)
        [Uniform, Uniform, Read, Read, Read, Read, ReadWrite] Compute { workgroup_size: [64, 1, 1] };
    visible_triangles(lib_masks) [Uniform, Read, Read, Read, Read, Depth, ReadWrite] Depth;
}
