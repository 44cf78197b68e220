//! The sections of an archive: their names, and the structs at the head of each group.
//!
//! The container (`manyview-cache`) carries named byte sections; this module says what their bytes mean. Every struct
//! is plain little-endian data without padding. In file order:
//!
//! | section | item | content |
//! |---|---|---|
//! | `scene.info` | 0 | one [`SceneInfo`] |
//! | `scene.lights` | 0 | [`Light`]s, 64 bytes each |
//! | `svo.info` | 0 | one [`SvoInfo`] |
//! | `rows.info` | 0 | one [`RowsInfo`] (absent in a bake without rows) |
//! | `svo.masks` | level 0 .. deepest | one byte per inner node |
//! | `svo.coverages` | level 0 .. deepest | one byte per inner node |
//! | `svo.colors` | level 0 ..= deepest | three planes (r, g, b) of one byte per node |
//! | `svo.normals` | level 0 ..= deepest | two planes of one signed byte per node |
//! | `svo.cones` | level 0 ..= deepest | one byte per node |
//! | `svo.emissive` | level 0 ..= deepest | four planes (bytes 0 … 3 of [`crate::rgb9e5`]) of one byte per node; absent in a scene that emits nothing |
//! | `rows.frames` | 0 | one [`DirectionFrame`](crate::directions::DirectionFrame) per direction |
//! | `rows.bits` | block | rows of [`RowsInfo::block_directions`] directions (the last block may have fewer): direction by direction, v by v, u by u, one row of `2^bits` bits; bit w of a row is bit `w % 32` of its word `w / 32` |
//!
//! Bytes of one kind stand together ("planes") because they compress better so.

use bytemuck::{Pod, Zeroable};

/// Names of sections.
pub mod name {
    /// [`super::SceneInfo`].
    pub const SCENE_INFO: &str = "scene.info";
    /// [`super::Light`]s.
    pub const SCENE_LIGHTS: &str = "scene.lights";
    /// [`super::SvoInfo`].
    pub const SVO_INFO: &str = "svo.info";
    /// Child masks of a level.
    pub const SVO_MASKS: &str = "svo.masks";
    /// Coverages of a level.
    pub const SVO_COVERAGES: &str = "svo.coverages";
    /// Colours of a level.
    pub const SVO_COLORS: &str = "svo.colors";
    /// Normals of a level.
    pub const SVO_NORMALS: &str = "svo.normals";
    /// Normal cones of a level.
    pub const SVO_CONES: &str = "svo.cones";
    /// Emitted radiance of a level.
    pub const SVO_EMISSIVE: &str = "svo.emissive";
    /// [`super::RowsInfo`].
    pub const ROWS_INFO: &str = "rows.info";
    /// Direction frames.
    pub const ROWS_FRAMES: &str = "rows.frames";
    /// A block of rows.
    pub const ROWS_BITS: &str = "rows.bits";
}

/// Counts and bounds of the imported scene, 88 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct SceneInfo {
    /// Triangles drawn, instances counted.
    pub triangles: u64,
    /// Distinct meshes (glTF primitives).
    pub meshes: u64,
    /// Placements of meshes.
    pub instances: u64,
    /// Materials.
    pub materials: u64,
    /// Punctual lights.
    pub lights: u64,
    /// World bounds of the drawn triangles, metres.
    pub bounds_min: [f64; 3],
    /// World bounds of the drawn triangles, metres.
    pub bounds_max: [f64; 3],
}

/// A punctual light in world space, 64 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Light {
    /// Metres; meaningless for directional lights.
    pub position: [f32; 3],
    /// 0 directional, 1 point, 2 spot.
    pub kind: u32,
    /// Unit direction in which it shines; meaningless for point lights.
    pub direction: [f32; 3],
    /// Metres; infinity if unlimited.
    pub range: f32,
    /// Linear colour times intensity: candela (point, spot) or lux (directional).
    pub intensity: [f32; 3],
    /// Radians from the axis where the falloff starts (spot).
    pub inner_angle: f32,
    /// Radians from the axis where the light ends (spot).
    pub outer_angle: f32,
    /// Zero.
    pub reserved: [u32; 3],
}

/// Where the octree lies and how large it is, 56 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct SvoInfo {
    /// Smallest corner of the scene cube, metres.
    pub origin: [f64; 3],
    /// Edge of the scene cube, metres.
    pub size: f64,
    /// Number of the deepest level; voxels a side are `2^levels`.
    pub levels: u32,
    /// 1 if `svo.emissive` is there.
    pub emissive: u32,
    /// Nodes at the deepest level.
    pub leaves: u64,
    /// Nodes at all levels, leaves included.
    pub nodes: u64,
}

/// What the rows are, 80 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct RowsInfo {
    /// log2 of voxels a side (5, 6, 7 or 8).
    pub bits: u32,
    /// 0 latitude-longitude, 1 hemi-octahedral.
    pub set_kind: u32,
    /// Thetas, or cells a side.
    pub set_a: u32,
    /// Phis, or 0.
    pub set_b: u32,
    /// 0 cube, 1 extent.
    pub fit: u32,
    /// 0 peel, 1 rotate, 2 points.
    pub source: u32,
    /// Number of directions.
    pub directions: u32,
    /// Directions per `rows.bits` block.
    pub block_directions: u32,
    /// [`RowLattice`](crate::directions::RowLattice): centre, metres.
    pub center: [f64; 3],
    /// [`RowLattice`](crate::directions::RowLattice): half extent, metres.
    pub half_extent: [f64; 3],
}

impl RowsInfo {
    /// Bytes of one direction's rows.
    pub fn direction_bytes(&self) -> usize {
        (1usize << (3 * self.bits)) / 8
    }
}
