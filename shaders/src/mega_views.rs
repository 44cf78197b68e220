//! What the stages of MegaViews share with the code that runs them: parameters, and where numbers stand in their buffers.
//!
//! # Theory
//! \[MV\] Kol, Bauszat, Lee, Eisemann, *MegaViews: Scalable Many-View Rendering With Concurrent Scene-View Hierarchy
//! Traversal*, CGF 2018, doi 10.1111/cgf.13527: §3.1 the view hierarchy, §3.3 the traversal, §3.4 fusion.
//!
//! # Stages
//! | job | stages |
//! |---|---|
//! | Morton order of views | `view_keys`; five times `sort_count`, a prefix sum by `scan_sums` and `scan_apply`, `sort_scatter`; `sort_gather` |
//! | hierarchy over a run of them, level by level | `tree_count`, `tree_scan`, `tree_emit`; upwards `tree_merge` |
//! | traversal, step by step | `pairs_prepare`, `pairs_step`; then `pairs_near`; for colours all once more, after `pairs_restart` |
//! | maps | `maps_clear`; downwards `maps_fuse`; `maps_pack` |
//!
//! All but the sort run from indirect dispatches: how many nodes and pairs there are stays on the GPU. No invocation loops
//! more often than some drivers let it (65,535 times in all).
//!
//! # Colours
//! What a texel shows is the scene node whose depth won, of equally near ones that of the smallest number ([`NO_NUMBER`] if
//! there is none). Depth and number are two words, which no atomic operation keeps together. So the traversal is walked
//! twice: once for depths, then by the same stages for the numbers of what has the depth that was kept. An invocation computes
//! a depth by the same instructions both times, so that equal bits are all that there is to ask for.
//!
//! # Differences from the paper
//! A queued pair is one to be subdivided: its children are looked at before they are queued, so that what is dropped or
//! drawn never takes a place in the queue.

use crate::scene_tree::SceneTree;
use crate::views::View;
use bytemuck::{Pod, Zeroable};

/// Levels of Morton keys: cells of 1/8192 of the scene cube.
pub const KEY_LEVELS: u32 = 13;
/// Most views that share a map.
pub const MOST_SHARED: u32 = 4096;
/// Cones are wider than computed by this much of their cosine, against rounding.
pub const CONE_SLACK: f32 = 1e-6;
/// Most levels of a view hierarchy.
pub const MOST_TREE_LEVELS: usize = 32;
/// Set in the view node of a pair whose view node is to be subdivided.
pub const PAIR_SPLITS_VIEWS: u32 = 1 << 30;
/// The node number of a texel that shows nothing.
pub const NO_NUMBER: u32 = u32::MAX;
/// Set in the view node of a pair that is to be looked at itself.
pub const PAIR_WHOLE: u32 = 1 << 31;

/// Words of the buffer `tree`.
pub mod tree {
    /// Number of nodes so far.
    pub const NODES: usize = 0;
    /// The level that is cut next.
    pub const LEVEL: usize = 1;
    /// Number of leaves so far.
    pub const LEAVES: usize = 2;
    /// [`super::flag`]s.
    pub const FLAGS: usize = 3;
    /// How many nodes there should have been room for.
    pub const NEEDED: usize = 4;
    /// Index of the first node of each level, and one more.
    pub const STARTS: usize = 8;
    /// Workgroups for the maps of all nodes.
    pub const NODE_ARGUMENTS: usize = 48;
    /// Workgroups for the maps of all leaves.
    pub const LEAF_ARGUMENTS: usize = 52;
    /// For each level: workgroups for its chunks, its nodes and its nodes' maps.
    pub const ARGUMENTS: usize = 64;
    /// Words of a level's.
    pub const LEVEL_ARGUMENTS: usize = 9;
    /// All words.
    pub const WORDS: usize = ARGUMENTS + LEVEL_ARGUMENTS * (super::MOST_TREE_LEVELS + 2);
}

/// Words of the buffer `counters`.
pub mod counter {
    /// Pairs of this step.
    pub const PAIRS: usize = 0;
    /// Pairs queued for the next one.
    pub const QUEUED: usize = 1;
    /// Near pairs so far.
    pub const NEAR: usize = 2;
    /// [`super::flag`]s.
    pub const FLAGS: usize = 3;
    /// Most pairs of any step.
    pub const MOST: usize = 4;
    /// All words.
    pub const WORDS: usize = 8;
}

/// What a pass had no room for.
pub mod flag {
    /// Nodes of the view hierarchy, or their maps.
    pub const NODES: u32 = 1;
    /// Pairs in the queue.
    pub const PAIRS: u32 = 2;
    /// Near pairs.
    pub const NEAR: u32 = 4;
}

/// Where the scene hierarchy lies, 32 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct SceneParams {
    /// Smallest corner of the scene cube, metres.
    pub origin: [f32; 3],
    /// Edge of the scene cube, metres.
    pub size: f32,
    /// Level of the leaves.
    pub depth: u32,
    /// Index of the first node of the last inner level.
    pub last_inner: u32,
    /// Cells of the last level of Morton keys per metre.
    pub key_cells_per_metre: f32,
    /// Zero.
    pub reserved: u32,
}

impl SceneParams {
    /// Those of a scene.
    pub fn new(scene: &SceneTree) -> Self {
        Self {
            origin: scene.origin,
            size: scene.size,
            depth: scene.depth,
            last_inner: scene.level_starts[scene.depth as usize - 1],
            key_cells_per_metre: (1u32 << KEY_LEVELS) as f32 / scene.size,
            reserved: 0,
        }
    }

    /// Morton key of a position, moved into the cube if it lies outside: its low 30 bits and its high 9.
    pub fn key(&self, position: [f32; 3]) -> [u32; 2] {
        let last = ((1u32 << KEY_LEVELS) - 1) as f32;
        let cell = [0, 1, 2]
            .map(|i| ((position[i] - self.origin[i]) * self.key_cells_per_metre).clamp(0.0, last) as u32);
        let bits = |from: u32, to: u32| {
            (from..to).fold(0, |key, l| {
                let digit = (0..3).fold(0, |digit, i| digit | (cell[i] >> l & 1) << i);
                key | digit << (3 * (l - from))
            })
        };
        [bits(0, 10), bits(10, KEY_LEVELS)]
    }

    /// [`SceneParams::key`] as one number: bits 3l, 3l + 1, 3l + 2 are bit l of the cell's x, y, z.
    pub fn morton_key(&self, position: [f32; 3]) -> u64 {
        let [low, high] = self.key(position);
        u64::from(low) | u64::from(high) << 30
    }
}

/// A view as stages read it, 32 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct ViewCone {
    /// Metres.
    pub position: [f32; 3],
    /// Cosine of half its field of view; −1 if it sees all around.
    pub cos_psi: f32,
    /// Unit axis.
    pub axis: [f32; 3],
    /// Sine of half its field of view.
    pub sin_psi: f32,
}

impl From<&View> for ViewCone {
    fn from(view: &View) -> Self {
        let (axis, [cos_psi, sin_psi]) = view.cone();
        Self { position: view.position, cos_psi, axis, sin_psi }
    }
}

/// What stages that sort need to know, 16 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct SortParams {
    /// Views.
    pub count: u32,
    /// Which 8 bits, from the lowest.
    pub digit: u32,
    /// Runs of [`crate::constants::SORT_CHUNK`] views.
    pub chunks: u32,
    /// Zero.
    pub reserved: u32,
}

/// 8-bit digits of a Morton key.
pub const SORT_DIGITS: u32 = 5;

/// Bits 8 `digit` and on of a key.
pub fn sort_digit(key: [u32; 2], digit: u32) -> u32 {
    let key = u64::from(key[1]) << 30 | u64::from(key[0]);
    (key >> (8 * digit) & 0xff) as u32
}

/// What stages of a prefix sum need to know, 16 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct ScanParams {
    /// Values.
    pub count: u32,
    /// Zero.
    pub reserved_a: u32,
    /// Zero.
    pub reserved_b: u32,
    /// Zero.
    pub reserved_c: u32,
}

/// What stages that do one level of the view hierarchy need to know, 16 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct LevelParams {
    /// The level, 0 for the root.
    pub level: u32,
    /// Zero.
    pub reserved_a: u32,
    /// Zero.
    pub reserved_b: u32,
    /// Zero.
    pub reserved_c: u32,
}

/// What the stages of a pass need to know, 64 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct PassParams {
    /// Texels a side of each half of a map.
    pub resolution: u32,
    /// Texels of a map.
    pub texels: u32,
    /// Resolution over the texels that a node may fill and still be drawn as a point.
    pub scale: f32,
    /// 1 to drop what is outside all fields of view.
    pub culling: u32,
    /// First of the sorted views that the pass is of.
    pub run_start: u32,
    /// How many it is of.
    pub run_count: u32,
    /// 1 if all views in one voxel share a map.
    pub sharing: u32,
    /// Invocations that share a near pair; a power of two, at most 64.
    pub near_lanes: u32,
    /// Room for nodes of the view hierarchy and their maps.
    pub node_capacity: u32,
    /// Room for pairs in the queue.
    pub pair_capacity: u32,
    /// Room for near pairs.
    pub near_capacity: u32,
    /// 1 to pack depths as 16-bit floats.
    pub half_depths: u32,
    /// Workgroups that share a map where it is cleared, fused or packed.
    pub slices: u32,
    /// 1 if behind the depths of all maps there is room for, `maps` holds a number of a scene node for each.
    pub with_numbers: u32,
    /// 1 to draw those numbers: all depths are known.
    pub draws_numbers: u32,
    /// Zero.
    pub reserved: u32,
}

impl PassParams {
    /// Where the node number of a texel stands in the maps, of which `at` is the depth.
    pub fn number_at(&self, at: usize) -> usize {
        self.node_capacity as usize * self.texels as usize + at
    }
}

/// The nearest 16-bit float of a 32-bit one that is not negative; of two equally near ones the even.
pub fn half_bits(bits: u32) -> u32 {
    if bits >= 0x477f_f000 {
        0x7c00
    } else if bits < 0x3880_0000 {
        // Multiples of 2^-24, which are the last places of a sum with a half.
        (f32::from_bits(bits) + 0.5).to_bits() - 0x3f00_0000
    } else {
        (bits - 0x3800_0000 + 0xfff + (bits >> 13 & 1)) >> 13
    }
}
