//! The structs that shaders read and write, laid out as WGSL lays them out. [`GPU_STRUCTS`] lists every one, so that
//! a test can compare sizes and offsets with the compiler's.

use crate::device::PackedFragment;
use crate::directions::DirectionFrame;
use crate::masks::{AlphaPlane, TexelMap, TriangleMask, UNMASKED, WrapCode, wrap_texel};
use crate::mega_views::{LevelParams, PassParams, ScanParams, SceneParams, SortParams, ViewCone};
use crate::raster::{Grid, VoxelBox};
use crate::row_test::{PackedFrame, RowTestParams};
use crate::testable::{is_behind, testable};
use crate::views::ViewNode;
use bytemuck::{Pod, Zeroable};
use std::mem::offset_of;

/// What the stages that rasterize need to know, 64 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct RasterParams {
    /// Smallest voxel to fill.
    pub clip_min: [i32; 3],
    /// [`Grid::bits`].
    pub grid_bits: u32,
    /// One past the largest voxel to fill.
    pub clip_max: [i32; 3],
    /// [`Grid::sub_bits`].
    pub sub_bits: u32,
    /// Distance in bits between neighbouring voxels along each axis.
    pub bit_stride: [u32; 3],
    /// Distance in bits between directions.
    pub direction_stride: u32,
    /// Triangles in the buffer.
    pub triangles: u32,
    /// Directions, or 0 if vertices are in the grid's lattice already.
    pub directions: u32,
    /// Fragments there is room for.
    pub capacity: u32,
    /// Zero.
    pub reserved: u32,
}

impl RasterParams {
    /// The grid.
    pub fn grid(&self) -> Grid {
        Grid { bits: self.grid_bits, sub_bits: self.sub_bits }
    }

    /// The voxels to fill.
    pub fn clip(&self) -> VoxelBox {
        VoxelBox { min: self.clip_min, max: self.clip_max }
    }

    /// Index of a voxel's bit.
    pub fn bit(&self, direction: u32, voxel: [i32; 3]) -> u32 {
        let along = |i: usize| (voxel[i] - self.clip_min[i]) as u32 * self.bit_stride[i];
        direction * self.direction_stride + along(0) + along(1) + along(2)
    }
}

/// One triangle of a job, 28 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct PackedTriangle {
    /// Nine signed 16-bit coordinates, x y z of vertex 0 first, the first in the low half of a word; the last half
    /// word is 0. Vertex 0 at (1, −2, 3) starts with 0xFFFE_0001, 0x…_0003.
    pub words: [u32; 5],
    /// Index of its mask, or [`UNMASKED`].
    pub mask: u32,
    /// Index of the triangle in the job.
    pub index: u32,
}

impl PackedTriangle {
    /// Packs a triangle.
    pub fn new(vertices: &[[i16; 3]; 3], mask: u32, index: u32) -> Self {
        let mut words = [0u32; 5];
        for (i, &c) in vertices.as_flattened().iter().enumerate() {
            words[i / 2] |= u32::from(c as u16) << (16 * (i % 2));
        }
        Self { words, mask, index }
    }

    /// Its vertices.
    pub fn vertices(&self) -> [[i16; 3]; 3] {
        let at = |i: usize| (self.words[i / 2] >> (16 * (i % 2))) as u16 as i16;
        [0, 1, 2].map(|v| [at(3 * v), at(3 * v + 1), at(3 * v + 2)])
    }

    /// Whether the fragment at these weights exists.
    pub fn passes(
        &self,
        masks: &[TriangleMask],
        planes: &[PackedPlane],
        alpha: &[u32],
        weights: [u32; 2],
    ) -> bool {
        if self.mask == UNMASKED {
            return true;
        }
        masks[self.mask as usize].passes_packed(planes, alpha, weights)
    }
}

impl TriangleMask {
    /// [`TriangleMask::passes`] with planes as the GPU has them.
    #[inline]
    pub fn passes_packed(&self, planes: &[PackedPlane], alpha: &[u32], weights: [u32; 2]) -> bool {
        planes[self.plane as usize].alpha(alpha, self.map.at(weights)) >= self.threshold
    }
}

/// Planes one after the other, each from a whole word on, and where they lie.
pub fn pack_planes(planes: &[AlphaPlane]) -> (Vec<PackedPlane>, Vec<u32>) {
    let mut packed = Vec::with_capacity(planes.len());
    let mut alpha = Vec::new();
    for plane in planes {
        packed.push(PackedPlane::new(plane, alpha.len() as u32 * 4));
        alpha.extend(plane.alpha.chunks(4).map(|four| {
            let mut bytes = [0; 4];
            bytes[..four.len()].copy_from_slice(four);
            u32::from_le_bytes(bytes)
        }));
    }
    (packed, alpha)
}

/// Where an alpha plane lies in the buffer of all planes, 20 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct PackedPlane {
    /// Index of its first byte; four bytes are a word, the first in the lowest bits.
    pub first_texel: u32,
    /// Texels along u.
    pub width: u32,
    /// Texels along v.
    pub height: u32,
    /// [`WrapCode`] along u.
    pub wrap_u: u32,
    /// [`WrapCode`] along v.
    pub wrap_v: u32,
}

impl PackedPlane {
    /// Describes `plane`, whose bytes start at `first_texel`.
    pub fn new(plane: &AlphaPlane, first_texel: u32) -> Self {
        let [wrap_u, wrap_v] = plane.wrap.map(|w| w as u32);
        Self { first_texel, width: plane.width, height: plane.height, wrap_u, wrap_v }
    }

    fn alpha(&self, alpha: &[u32], texel: [i32; 2]) -> u32 {
        let [s, t] = [(texel[0], self.width, self.wrap_u), (texel[1], self.height, self.wrap_v)]
            .map(|(at, size, wrap)| wrap_texel(at, size, wrap_code(wrap)));
        let index = self.first_texel + t * self.width + s;
        alpha[index as usize / 4] >> (index % 4 * 8) & 255
    }
}

fn wrap_code(code: u32) -> WrapCode {
    [WrapCode::Repeat, WrapCode::Mirror, WrapCode::Clamp][code as usize]
}

/// A large triangle along one axis, left to workgroups, 12 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct LargeItem {
    /// Index in the buffer.
    pub triangle: u32,
    /// Index of the frame.
    pub direction: u32,
    /// Projection axis.
    pub axis: u32,
}

/// What `rotate_points` needs to know, 16 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct PointParams {
    /// Pairs of points.
    pub pairs: u32,
    /// log2 of voxels a side.
    pub grid_bits: u32,
    /// log2 of the bits from one row to the next: `grid_bits`, or more to leave room behind rows, as texels do.
    pub row_bits: u32,
    /// Zero.
    pub reserved: u32,
}

/// How views lie in a peeled depth image, 16 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct PeelParams {
    /// Side of a view's square cell, pixels.
    pub cell: u32,
    /// Cells side by side.
    pub columns: u32,
    /// Cells one above the other.
    pub rows: u32,
    /// Views.
    pub views: u32,
}

impl PeelParams {
    /// Pixel at the smallest corner of a view's cell.
    pub fn corner(&self, view: u32) -> [u32; 2] {
        [view % self.columns * self.cell, view / self.columns * self.cell]
    }
}

/// A window onto the pixels of one direction and axis, 16 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct PeelView {
    /// Index of the frame.
    pub direction: u32,
    /// Projection axis.
    pub axis: u32,
    /// Grid pixel at the cell's smallest corner.
    pub window_x: i32,
    /// Grid pixel at the cell's smallest corner.
    pub window_y: i32,
}

/// A camera's picture, 80 bytes. Vectors are along world axes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct ViewParams {
    /// From the eye to the middle of the picture at distance 1.
    pub forward: [f32; 3],
    /// What is nearer along `forward` is not drawn.
    pub near_metres: f32,
    /// From the middle of the picture to its right edge at distance 1.
    pub right: [f32; 3],
    /// Nothing is farther along `forward`.
    pub far_metres: f32,
    /// From the middle of the picture to its upper edge at distance 1.
    pub up: [f32; 3],
    /// Pixels a row.
    pub width: u32,
    /// `right` over its squared length.
    pub right_over_square: [f32; 3],
    /// Rows.
    pub height: u32,
    /// `up` over its squared length.
    pub up_over_square: [f32; 3],
    /// 0 to keep the nearest distances, 1 to collect the triangles there.
    pub collect: u32,
}

/// A triangle as it is seen from a camera, 44 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct EyeTriangle {
    /// Along world axes, from the eye, metres: x y z of vertex 0 first.
    pub vertices: [f32; 9],
    /// Index of its mask, or [`UNMASKED`].
    pub mask: u32,
    /// Its number, which is found where it is seen.
    pub index: u32,
}

impl EyeTriangle {
    /// Packs a triangle.
    pub fn new(vertices: [[f32; 3]; 3], mask: u32, index: u32) -> Self {
        let [[a, b, c], [d, e, f], [g, h, i]] = vertices;
        Self { vertices: [a, b, c, d, e, f, g, h, i], mask, index }
    }

    /// Its vertices.
    pub fn vertices(&self) -> [[f32; 3]; 3] {
        [0, 3, 6].map(|at| [0, 1, 2].map(|i| self.vertices[at + i]))
    }
}

/// What is asked of a segment test: is anything between two points? 36 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
pub struct Segment {
    /// World space, metres; on a surface, or free.
    pub origin: [f32; 3],
    /// World space, metres; free (a light, a camera).
    pub target: [f32; 3],
    /// Unit normal of the origin's surface on the target's side; zero where the origin is free.
    pub normal: [f32; 3],
}

/// A point that light falls on, 24 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
pub struct Receiver {
    /// World space, metres.
    pub position: [f32; 3],
    /// Unit normal on the viewer's side; zero for a point that is on no surface.
    pub normal: [f32; 3],
}

/// Where light comes from, 16 bytes: the segment from a receiver ends at `offset + position_weight · position`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
pub struct LightPoint {
    /// World space, metres: the light's position; for a directional light the way to it, long enough to leave the
    /// scene.
    pub offset: [f32; 3],
    /// 0 for a light at a position, 1 for a directional light.
    pub position_weight: f32,
}

impl LightPoint {
    /// A light at a world position, metres.
    pub fn at(position: [f32; 3]) -> Self {
        Self { offset: position, position_weight: 0.0 }
    }

    /// A light that shines along `direction` (unit length) from outside a scene whose bounds' diagonal is
    /// `scene_diameter` metres.
    pub fn directional(direction: [f32; 3], scene_diameter: f32) -> Self {
        Self { offset: direction.map(|c| -c * scene_diameter), position_weight: 1.0 }
    }

    /// The segment from a receiver to this light.
    #[inline]
    pub fn segment_from(&self, receiver: &Receiver) -> Segment {
        let target = [0, 1, 2].map(|i| self.offset[i] + self.position_weight * receiver.position[i]);
        Segment { origin: receiver.position, target, normal: receiver.normal }
    }

    /// Whether the receiver's own surface hides this light: it is not in front of it.
    #[inline]
    pub fn is_behind(&self, receiver: &Receiver) -> bool {
        testable(&self.segment_from(receiver)).is_some_and(|segment| is_behind(&segment))
    }
}

/// What stages with `lib_hidden_lights.wgsl` need to know, 32 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct HiddenLightsParams {
    /// Receivers of the band.
    pub receivers: u32,
    /// Lights of the piece.
    pub lights: u32,
    /// Words of one receiver.
    pub light_words: u32,
    /// Lights that one invocation tests; divides 32.
    pub lights_per_invocation: u32,
    /// Iterations that a ray may take.
    pub steps_per_ray: u32,
    /// Index of the word that is set to 1 if a ray needs more.
    pub exhausted_word: u32,
    /// Zero.
    pub reserved: [u32; 2],
}

/// What stages with `lib_segments.wgsl` need to know, 16 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct SegmentParams {
    /// Segments of the piece.
    pub segments: u32,
    /// 1 for distances, 0 for whether anything is there.
    pub wants_distance: u32,
    /// Iterations that a ray may take.
    pub steps_per_ray: u32,
    /// Index of the word that is set to 1 if a ray needs more.
    pub exhausted_word: u32,
}

/// Where a brickmap lies and how rays enter it, 32 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct BrickmapParams {
    /// World position of the smallest corner, metres.
    pub origin: [f32; 3],
    /// Cells per metre.
    pub cells_per_metre: f32,
    /// Cells a side, a power of two, at least 16.
    pub side: u32,
    /// log2 of coarse cells a side.
    pub coarse_bits: u32,
    /// How far a ray's origin is lifted along its normal, cells.
    pub normal_cells: f32,
    /// How far a ray's beginning is skipped, divided by the cosine between ray and normal, cells.
    pub skip_cells: f32,
}

/// What the stages that traverse a compressed wide BVH need to know, 32 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct WideBvhParams {
    /// World position that the tree's coordinates are relative to, metres.
    pub center: [f32; 3],
    /// How far a ray's origin is lifted along its normal, metres.
    pub lift: f32,
    /// Nodes of the tree.
    pub nodes: u32,
    /// Zero.
    pub reserved_a: u32,
    /// Zero.
    pub reserved_b: u32,
    /// Zero.
    pub reserved_c: u32,
}

/// A struct's layout as Rust has it.
#[derive(Debug)]
pub struct GpuStruct {
    /// Its name, in WGSL too.
    pub name: &'static str,
    /// Bytes.
    pub size: usize,
    /// Names and offsets of its fields.
    pub fields: &'static [(&'static str, usize)],
}

macro_rules! gpu_structs {
    ($($name:ident { $($field:ident),* $(,)? })*) => {
        /// Every struct that shaders share with Rust.
        pub const GPU_STRUCTS: &[GpuStruct] = &[$(GpuStruct {
            name: stringify!($name),
            size: size_of::<$name>(),
            fields: &[$((stringify!($field), offset_of!($name, $field))),*],
        }),*];
    };
}

gpu_structs! {
    RowTestParams {
        center, bits, steps_per_metre, normal_quarter, normal_steps, skip, split, consensus, zero, reserved,
    }
    PackedFrame { words }
    RasterParams {
        clip_min, grid_bits, clip_max, sub_bits, bit_stride, direction_stride, triangles, directions, capacity, reserved,
    }
    PackedTriangle { words, mask, index }
    PackedPlane { first_texel, width, height, wrap_u, wrap_v }
    PackedFragment { voxel, triangle, barycentric }
    LargeItem { triangle, direction, axis }
    PointParams { pairs, grid_bits, row_bits, reserved }
    PeelParams { cell, columns, rows, views }
    PeelView { direction, axis, window_x, window_y }
    DirectionFrame { row_from_lattice, offset }
    TriangleMask { plane, threshold, map, reserved }
    TexelMap { texel, step1, step2, shift }
    HiddenLightsParams {
        receivers, lights, light_words, lights_per_invocation, steps_per_ray, exhausted_word, reserved,
    }
    Receiver { position, normal }
    LightPoint { offset, position_weight }
    SegmentParams { segments, wants_distance, steps_per_ray, exhausted_word }
    WideBvhParams { center, lift, nodes, reserved_a, reserved_b, reserved_c }
    BrickmapParams { origin, cells_per_metre, side, coarse_bits, normal_cells, skip_cells }
    ViewParams {
        forward, near_metres, right, far_metres, up, width, right_over_square, height, up_over_square, collect,
    }
    EyeTriangle { vertices, mask, index }
    SceneParams { origin, size, depth, last_inner, key_cells_per_metre, reserved }
    ViewCone { position, cos_psi, axis, sin_psi }
    ViewNode { center, radius, axis, cos_psi, sin_psi, first, count, reserved }
    SortParams { count, digit, chunks, reserved }
    ScanParams { count, reserved_a, reserved_b, reserved_c }
    LevelParams { level, reserved_a, reserved_b, reserved_c }
    PassParams {
        resolution, texels, scale, culling, run_start, run_count, sharing, near_lanes, node_capacity, pair_capacity,
        near_capacity, half_depths, slices, with_numbers, draws_numbers, reserved,
    }
}
