//! The scene hierarchy as traversals read it: the octree's inner nodes, each with the middle of what it holds.
//!
//! # Theory
//! \[MV\] §3 gives a node of the scene hierarchy an averaged position and a bounding sphere around its cubical cell. Cell
//! and sphere follow from level and coordinates; the averaged position is the mean of the cell's leaves, computed here
//! when a bake is loaded, since it follows from the child masks.
//!
//! # Layout
//! Leaves are not stored: a leaf is an inner node of the last level and an octant ([`NodeRef`]), so that octrees of tens of
//! millions of leaves fit WebGPU's default limits. Inner nodes stand breadth first, level after level, in Morton order.

use crate::svo::Svo;
use bytemuck::{Pod, Zeroable};

/// Radius of the sphere around a cube of edge 1.
pub const SPHERE_OF_CUBE: f32 = 0.866_025_4;

/// An inner node, 16 bytes.
///
/// | word | bits | content |
/// |---|---|---|
/// | 0 | 0–31 | index of its first child: in [`SceneTree::nodes`], or on the last inner level among the leaves |
/// | 1 | 0–29 | the mean of its leaves' middles: x, y, z in 1024ths of the cell's edge, 10 bits each |
/// | 2 | 0–12, 13–25, 26–31 | the cell's x, y and the low six bits of z, in cells of its level |
/// | 3 | 0–6 | the high seven bits of z |
/// | 3 | 8–11 | level |
/// | 3 | 16–23 | child mask |
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct SceneNode {
    /// See the table.
    pub words: [u32; 4],
}

impl SceneNode {
    fn new(first_child: u32, mean: [u32; 3], cell: [u32; 3], level: u32, mask: u8) -> Self {
        let [x, y, z] = cell;
        let place = [x | y << 13 | z << 26, z >> 6 | level << 8 | u32::from(mask) << 16];
        Self { words: [first_child, mean[0] | mean[1] << 10 | mean[2] << 20, place[0], place[1]] }
    }

    /// See the table.
    #[inline]
    pub fn first_child(&self) -> u32 {
        self.words[0]
    }

    /// The cell, in cells of its level.
    #[inline]
    pub fn cell(&self) -> [u32; 3] {
        let [_, _, low, high] = self.words;
        [low & 0x1fff, low >> 13 & 0x1fff, low >> 26 | (high & 0x7f) << 6]
    }

    /// Its level, 0 for the root.
    #[inline]
    pub fn level(&self) -> u32 {
        self.words[3] >> 8 & 0xf
    }

    /// Which of the eight children exist, never 0.
    #[inline]
    pub fn child_mask(&self) -> u32 {
        self.words[3] >> 16 & 0xff
    }

    /// The mean of its leaves in cells of its level, from the cube's corner.
    #[inline]
    pub fn mean(&self) -> [f32; 3] {
        let cell = self.cell();
        let mean = self.words[1];
        [0, 1, 2].map(|i| cell[i] as f32 + ((mean >> (10 * i) & 0x3ff) as f32 + 0.5) * (1.0 / 1024.0))
    }
}

/// A node of a [`SceneTree`]: the index of an inner node, or with [`NodeRef::LEAF`] set 8 times the place of a leaf's
/// parent in the last inner level plus the leaf's octant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct NodeRef(pub u32);

impl NodeRef {
    /// Set in references to leaves.
    pub const LEAF: u32 = 1 << 31;
    /// The root.
    pub const ROOT: Self = Self(0);

    /// Whether it is a leaf.
    #[inline]
    pub fn is_leaf(self) -> bool {
        self.0 & Self::LEAF != 0
    }
}

/// An octree's geometry for traversals.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneTree {
    /// Smallest corner of the scene cube, metres.
    pub origin: [f32; 3],
    /// Edge of the scene cube, metres.
    pub size: f32,
    /// Level of the leaves, at least 1.
    pub depth: u32,
    /// Inner nodes, breadth first.
    pub nodes: Vec<SceneNode>,
    /// Index of the first node of every inner level, and the number of all inner nodes.
    pub level_starts: Vec<u32>,
    /// sRGB colours with an empty fourth byte: of inner nodes, then of leaves in Morton order. Empty unless wanted.
    pub colors: Vec<[u8; 4]>,
}

impl SceneTree {
    /// Takes a validated octree. One without inner nodes is a cube of eight leaves.
    pub fn new(svo: &Svo, with_colors: bool) -> Self {
        let depth = svo.depth().max(1);
        let masks = |level: u32| match svo.depth() {
            0 => &[0xff][..],
            _ => &svo.levels[level as usize].child_masks[..],
        };
        let mut level_starts = vec![0u32];
        for level in 0..depth {
            level_starts.push(level_starts[level as usize] + masks(level).len() as u32);
        }
        let mut nodes = vec![SceneNode::zeroed(); level_starts[depth as usize] as usize];
        // Sums of the middles of a node's leaves from its corner, in half voxels, and how many there are.
        let mut below: Vec<([u64; 3], u64)> = Vec::new();
        for level in (0..depth).rev() {
            let half_edge = 1u64 << (depth - level - 1);
            let mut first_child = 0usize;
            let mut sums = Vec::with_capacity(masks(level).len());
            for (i, &mask) in masks(level).iter().enumerate() {
                let (mut sum, mut count) = ([0u64; 3], 0u64);
                let children = (0..8).filter(|octant| mask >> octant & 1 == 1);
                for (k, octant) in children.enumerate() {
                    let (child, leaves) = below.get(first_child + k).copied().unwrap_or(([1; 3], 1));
                    for axis in 0..3 {
                        sum[axis] += child[axis] + (octant >> axis & 1) * 2 * half_edge * leaves;
                    }
                    count += leaves;
                }
                // The edge is 4 half_edge half voxels.
                let mean = sum.map(|s| (s * 1024 / (4 * half_edge * count)).min(1023) as u32);
                let next = if level + 1 < depth { level_starts[level as usize + 1] } else { 0 };
                nodes[level_starts[level as usize] as usize + i] =
                    SceneNode::new(next + first_child as u32, mean, [0; 3], level, mask);
                first_child += mask.count_ones() as usize;
                sums.push((sum, count));
            }
            below = sums;
        }
        let mut tree = Self {
            origin: svo.origin.map(|c| c as f32),
            size: svo.size as f32,
            depth,
            nodes,
            level_starts,
            colors: Vec::new(),
        };
        tree.place_cells();
        if with_colors {
            tree.colors =
                svo.levels.iter().flat_map(|level| &level.colors).map(|&[r, g, b]| [r, g, b, 0]).collect();
            // An octree of one leaf has eight here.
            let count = tree.nodes.len() + tree.leaf_count() as usize;
            let last = tree.colors.last().copied().unwrap_or_default();
            tree.colors.resize(count, last);
        }
        tree
    }

    /// Hands the cells down from the root.
    fn place_cells(&mut self) {
        for i in 0..self.level_starts[self.depth as usize - 1] as usize {
            let node = self.nodes[i];
            let (cell, mut child) = (node.cell(), node.first_child() as usize);
            for octant in (0..8u32).filter(|octant| node.child_mask() >> octant & 1 == 1) {
                let [x, y, z] = [0, 1, 2].map(|axis| cell[axis] * 2 + (octant >> axis & 1));
                let words = &mut self.nodes[child].words;
                words[2] = x | y << 13 | z << 26;
                words[3] = words[3] & !0x7f | z >> 6;
                child += 1;
            }
        }
    }

    /// Number of leaves.
    pub fn leaf_count(&self) -> u32 {
        self.nodes.last().map_or(0, |node| node.first_child() + node.child_mask().count_ones())
    }

    /// Edge of a cell at a level, metres.
    #[inline]
    pub fn cell_size(&self, level: u32) -> f32 {
        self.size / (1u32 << level) as f32
    }

    /// Edge of a leaf, metres.
    #[inline]
    pub fn voxel_size(&self) -> f32 {
        self.cell_size(self.depth)
    }

    /// Level of a node.
    #[inline]
    pub fn level(&self, node: NodeRef) -> u32 {
        if node.is_leaf() { self.depth } else { self.nodes[node.0 as usize].level() }
    }

    /// Middle of a node's cell, metres in the world.
    #[inline]
    pub fn cell_center(&self, node: NodeRef) -> [f32; 3] {
        let (cell, level) = self.cell(node);
        let edge = self.cell_size(level);
        [0, 1, 2].map(|i| self.origin[i] + (cell[i] as f32 + 0.5) * edge)
    }

    /// A node's cell in cells of its level, and the level.
    #[inline]
    pub fn cell(&self, node: NodeRef) -> ([u32; 3], u32) {
        if !node.is_leaf() {
            let node = &self.nodes[node.0 as usize];
            return (node.cell(), node.level());
        }
        let parent = &self.nodes[self.leaf_parent(node)];
        let (cell, octant) = (parent.cell(), node.0 & 7);
        ([0, 1, 2].map(|i| cell[i] * 2 + (octant >> i & 1)), self.depth)
    }

    /// Mean of a node's leaves, metres in the world.
    #[inline]
    pub fn mean(&self, node: NodeRef) -> [f32; 3] {
        if node.is_leaf() {
            return self.cell_center(node);
        }
        let node = &self.nodes[node.0 as usize];
        let (mean, edge) = (node.mean(), self.cell_size(node.level()));
        [0, 1, 2].map(|i| self.origin[i] + mean[i] * edge)
    }

    /// Index of a leaf's parent in [`SceneTree::nodes`].
    #[inline]
    pub fn leaf_parent(&self, leaf: NodeRef) -> usize {
        ((leaf.0 & !NodeRef::LEAF) >> 3) as usize + self.level_starts[self.depth as usize - 1] as usize
    }

    /// A node's children; a leaf has none.
    #[inline]
    pub fn children(&self, node: NodeRef) -> impl Iterator<Item = NodeRef> + use<> {
        let (mut left, first, are_leaves) = if node.is_leaf() {
            (0, 0, false)
        } else {
            let inner = &self.nodes[node.0 as usize];
            if inner.level() + 1 == self.depth {
                let place = node.0 - self.level_starts[self.depth as usize - 1];
                (inner.child_mask(), NodeRef::LEAF | place << 3, true)
            } else {
                (inner.child_mask(), inner.first_child(), false)
            }
        };
        let mut number = 0;
        std::iter::from_fn(move || {
            if left == 0 {
                return None;
            }
            let octant = left.trailing_zeros();
            left &= left - 1;
            number += 1;
            Some(NodeRef(if are_leaves { first | octant } else { first + number - 1 }))
        })
    }

    /// Where a node's colour stands in [`SceneTree::colors`].
    #[inline]
    pub fn color_index(&self, node: NodeRef) -> usize {
        if !node.is_leaf() {
            return node.0 as usize;
        }
        let parent = &self.nodes[self.leaf_parent(node)];
        let before = parent.child_mask() & ((1 << (node.0 & 7)) - 1);
        self.nodes.len() + (parent.first_child() + before.count_ones()) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::svo::SvoLevel;

    fn level(masks: &[u8], count: usize) -> SvoLevel {
        let colors = (0..count).map(|i| [i as u8, 0, 1]).collect();
        SvoLevel { colors, ..SvoLevel::of_masks(masks.to_vec(), count) }
    }

    fn svo() -> Svo {
        Svo {
            origin: [1.0, 2.0, 3.0],
            size: 4.0,
            levels: vec![level(&[0b1000_0001], 1), level(&[0b11, 0b1_0000], 2), level(&[], 3)],
        }
    }

    #[test]
    fn children_cells_and_colours_follow_the_masks() {
        let tree = SceneTree::new(&svo(), true);
        assert_eq!((tree.depth, tree.leaf_count(), tree.level_starts.clone()), (2, 3, vec![0, 1, 3]));
        let children: Vec<_> = tree.children(NodeRef::ROOT).collect();
        assert_eq!(children, [NodeRef(1), NodeRef(2)]);
        assert_eq!(tree.cell(NodeRef(2)), ([1, 1, 1], 1));
        let leaves: Vec<_> = children.iter().flat_map(|&child| tree.children(child)).collect();
        let cells: Vec<_> = leaves.iter().map(|&leaf| tree.cell(leaf)).collect();
        assert_eq!(cells, [([0, 0, 0], 2), ([1, 0, 0], 2), ([2, 2, 3], 2)]);
        assert!(leaves.iter().all(|&leaf| leaf.is_leaf() && tree.children(leaf).next().is_none()));
        let colors: Vec<u8> = leaves.iter().map(|&leaf| tree.colors[tree.color_index(leaf)][0]).collect();
        assert_eq!(colors, [0, 1, 2]);
        assert_eq!(tree.cell_center(leaves[1]), [2.5, 2.5, 3.5]);
    }

    #[test]
    fn a_node_is_where_its_leaves_are_on_average() {
        let tree = SceneTree::new(&svo(), false);
        let close = |a: [f32; 3], b: [f32; 3]| (0..3).all(|i| (a[i] - b[i]).abs() < 0.01);
        assert!(close(tree.mean(NodeRef(1)), [2.0, 2.5, 3.5]), "{:?}", tree.mean(NodeRef(1)));
        assert!(close(tree.mean(NodeRef(2)), [3.5, 4.5, 6.5]));
        // (0.5 + 1.5 + 2.5) / 3, (0.5 + 0.5 + 2.5) / 3, (0.5 + 0.5 + 3.5) / 3 from the corner
        assert!(close(tree.mean(NodeRef::ROOT), [2.5, 2.0 + 3.5 / 3.0, 4.5]));
    }

    #[test]
    fn the_deepest_coordinates_fit() {
        let node = SceneNode::new(7, [1, 2, 1023], [8191, 4095, 8190], 12, 0x81);
        assert_eq!((node.cell(), node.level(), node.child_mask()), ([8191, 4095, 8190], 12, 0x81));
        assert_eq!(node.first_child(), 7);
    }

    #[test]
    fn an_octree_of_one_leaf_is_eight_leaves() {
        let svo = Svo { origin: [0.0; 3], size: 1.0, levels: vec![level(&[], 1)] };
        let tree = SceneTree::new(&svo, true);
        assert_eq!((tree.depth, tree.leaf_count(), tree.colors.len()), (1, 8, 9));
    }
}
