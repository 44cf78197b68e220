//! Numbers that Rust and WGSL share, written once: [`wgsl`] emits them as `const` lines.

use crate::brickmap::{BRICKMAP_EMPTY, MIN_COSINE, MIN_DIRECTION};
use crate::direction_table::TABLE_SIDE;
use crate::directions::{ROW_LATTICE, ROW_RAW_BITS};
use crate::masks::{UNMASKED, WrapCode};
use crate::mega_views::{
    CONE_SLACK, KEY_LEVELS, MOST_SHARED, NO_NUMBER, PAIR_SPLITS_VIEWS, PAIR_WHOLE, counter, flag, tree,
};
use crate::raster::BARYCENTRIC_ONE;
use crate::row_test::{LONGEST, MAX_HALVINGS, NEAR_STEPS, NORMAL_DROP, SHORTEST, TEST_RAW_BITS};
use crate::scene_tree::SPHERE_OF_CUBE;
use crate::testable::{MAX_NORMAL, MIN_LENGTH_SQUARED};
use crate::views::PARALLAX;
use crate::wide_bvh::BVH_STACK;

/// Pixels that one invocation visits for one triangle along one axis; a triangle with more is done by workgroups.
pub const SMALL_PIXELS: u32 = 256;
/// Invocations that share a large triangle.
pub const LARGE_LANES: u32 = 64;
/// Rows of pixels of a large triangle that one workgroup visits.
pub const LARGE_ROWS: u32 = 256;
/// Pairs of points that one invocation puts into one direction's grid.
pub const PAIRS_PER_INVOCATION: u32 = 16;
/// WebGPU's default limit of workgroups along one axis of a dispatch.
pub const MAX_WORKGROUPS: u32 = 65_535;
/// A peeled layer stores (voxel + 1) / `PEEL_DEPTHS`: exact in a float, and below 1 for the largest clip box.
pub const PEEL_DEPTHS: u32 = 2048;

/// Views that one invocation counts or puts in order while views are sorted.
pub const SORT_CHUNK: u32 = 256;
/// Values that one invocation of a prefix sum adds up.
pub const SCAN_CHUNK: u32 = 256;
/// Nodes of the view hierarchy that one invocation cuts.
pub const TREE_CHUNK: u32 = 32;
/// Texels of a map that one workgroup clears, fuses or packs.
pub const MAP_SLICE: u32 = 512;

/// The `const` lines that every shader starts with.
pub fn wgsl() -> String {
    let integers = [
        ("ROW_RAW_BITS", ROW_RAW_BITS),
        ("UNMASKED", UNMASKED),
        ("WRAP_MIRROR", WrapCode::Mirror as u32),
        ("WRAP_CLAMP", WrapCode::Clamp as u32),
        ("SMALL_PIXELS", SMALL_PIXELS),
        ("LARGE_LANES", LARGE_LANES),
        ("LARGE_ROWS", LARGE_ROWS),
        ("PAIRS_PER_INVOCATION", PAIRS_PER_INVOCATION),
        ("MAX_WORKGROUPS", MAX_WORKGROUPS),
        ("TEST_RAW_BITS", TEST_RAW_BITS),
        ("TABLE_SIDE", TABLE_SIDE),
        ("MAX_HALVINGS", MAX_HALVINGS),
        ("NORMAL_DROP", NORMAL_DROP),
        ("INFINITY_BITS", f32::INFINITY.to_bits()),
        ("BRICKMAP_EMPTY", BRICKMAP_EMPTY),
        ("BVH_STACK", BVH_STACK),
        ("SORT_CHUNK", SORT_CHUNK),
        ("SCAN_CHUNK", SCAN_CHUNK),
        ("TREE_CHUNK", TREE_CHUNK),
        ("MAP_SLICE", MAP_SLICE),
        ("KEY_LEVELS", KEY_LEVELS),
        ("MOST_SHARED", MOST_SHARED),
        ("TREE_LEVEL", tree::LEVEL as u32),
        ("TREE_NODES", tree::NODES as u32),
        ("TREE_LEAVES", tree::LEAVES as u32),
        ("TREE_FLAGS", tree::FLAGS as u32),
        ("TREE_NEEDED", tree::NEEDED as u32),
        ("TREE_STARTS", tree::STARTS as u32),
        ("TREE_NODE_ARGUMENTS", tree::NODE_ARGUMENTS as u32),
        ("TREE_LEAF_ARGUMENTS", tree::LEAF_ARGUMENTS as u32),
        ("TREE_ARGUMENTS", tree::ARGUMENTS as u32),
        ("TREE_LEVEL_ARGUMENTS", tree::LEVEL_ARGUMENTS as u32),
        ("COUNTER_PAIRS", counter::PAIRS as u32),
        ("COUNTER_QUEUED", counter::QUEUED as u32),
        ("COUNTER_NEAR", counter::NEAR as u32),
        ("COUNTER_FLAGS", counter::FLAGS as u32),
        ("COUNTER_MOST", counter::MOST as u32),
        ("FLAG_NODES", flag::NODES),
        ("FLAG_PAIRS", flag::PAIRS),
        ("FLAG_NEAR", flag::NEAR),
        ("NO_NUMBER", NO_NUMBER),
        ("PAIR_SPLITS_VIEWS", PAIR_SPLITS_VIEWS),
        ("PAIR_WHOLE", PAIR_WHOLE),
        ("PAIR_VIEW", PAIR_SPLITS_VIEWS - 1),
    ];
    let mut lines: String =
        integers.iter().map(|(name, value)| format!("const {name}: u32 = {value}u;\n")).collect();
    lines.push_str(&format!("const PEEL_DEPTHS: f32 = {PEEL_DEPTHS}.0;\n"));
    lines.push_str(&format!("const BARYCENTRIC_ONE: f32 = {BARYCENTRIC_ONE}.0;\n"));
    let floats = [
        ("MIN_LENGTH_SQUARED", MIN_LENGTH_SQUARED),
        ("MAX_NORMAL", MAX_NORMAL),
        ("ROW_LATTICE", ROW_LATTICE as f32),
        ("NEAR_STEPS", NEAR_STEPS),
        ("LONGEST", LONGEST),
        ("SHORTEST", SHORTEST),
        ("MIN_DIRECTION", MIN_DIRECTION),
        ("MIN_COSINE", MIN_COSINE),
        ("SPHERE_OF_CUBE", SPHERE_OF_CUBE),
        ("PARALLAX", PARALLAX),
        ("CONE_SLACK", CONE_SLACK),
        ("LARGEST", f32::MAX),
    ];
    lines.extend(floats.iter().map(|(name, value)| format!("const {name}: f32 = {value:e};\n")));
    lines
}
