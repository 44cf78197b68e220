//! Walking both hierarchies at once, on the CPU.
//!
//! # Theory
//! \[MV\] §3.3: a pair of a scene node s and a view node v is dropped if s is outside all fields of view of v, drawn into v's
//! map if s fills less than a texel for all of them, and else subdivided, the larger of the two first. §3.4: a child's
//! empty texels are then filled from its parent's map.
//!
//! # Differences from the paper
//! The paper goes breadth first: a queue of pairs, and maps of all view nodes. Here the view hierarchy is walked depth first:
//! all pairs of a view node are done together, its map is complete before its children's begin, and they inherit the
//! list of scene nodes to go on with. So there is no queue to overflow, inner maps live only on the way down, no two
//! threads draw into one map, and the result depends on no order. The pairs drawn are those of the breadth-first form
//! ([`super::pairs`], which keeps that form, and the GPU's stages).
//!
//! Which of a pair is subdivided goes by the spheres: v's as long as it is larger than the spheres of s's children, so that
//! views never move by more than a node that is drawn for all of them is large.

use super::view_tree::ViewTree;
use crate::views::splat::{Canvas, TexelDirections};
use half::f16;
use manyview_shaders::paraboloid::texel_count;
use manyview_shaders::scene_tree::{NodeRef, SPHERE_OF_CUBE, SceneTree};
use manyview_shaders::views::{ViewNode, is_culled, is_small};
use rayon::prelude::*;

/// View nodes with more leaves than that hand their children to other threads.
const LEAVES_PER_TASK: u32 = 32;

/// What a traversal reads.
#[derive(Debug, Clone, Copy)]
pub(super) struct Traversal<'a> {
    pub(super) scene: &'a SceneTree,
    pub(super) views: &'a ViewTree,
    pub(super) texels: &'a TexelDirections,
    /// Resolution over the texels that a node may fill and still be drawn as a point.
    pub(super) scale: f32,
    pub(super) culling: bool,
    pub(super) with_nodes: bool,
}

/// Where the maps of a view node's leaves go.
pub(super) struct Output<'a> {
    pub(super) depths: DepthsMut<'a>,
    /// Node numbers of all texels, or empty.
    pub(super) nodes: &'a mut [u32],
}

/// Depths of a run of maps.
pub(super) enum DepthsMut<'a> {
    Full(&'a mut [f32]),
    Half(&'a mut [f16]),
}

/// A map that is complete.
#[derive(Clone, Copy)]
struct Parent<'a> {
    center: [f32; 3],
    depths: &'a [f32],
    nodes: &'a [u32],
}

/// What one thread needs for each level of the view hierarchy.
#[derive(Default)]
struct Scratch {
    levels: Vec<Level>,
    stack: Vec<u32>,
}

#[derive(Default)]
struct Level {
    depths: Vec<f32>,
    nodes: Vec<u32>,
    /// Scene nodes that go on with the children.
    passed_down: Vec<NodeRef>,
}

/// What a pair comes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
    /// Outside all fields of view.
    Drop,
    /// A point in v's map.
    Point,
    /// Two leaves: s is drawn as what it is.
    Near,
    /// On with the children of s.
    SplitScene,
    /// On with the children of v.
    SplitViews,
}

/// What a pair comes to whose scene node has its middle at `offset` from the view node's. The rule of every form of the
/// traversal.
#[inline(always)]
pub(super) fn step(
    offset: [f32; 3],
    radius: f32,
    scene_is_leaf: bool,
    view: &ViewNode,
    scale: f32,
    culling: bool,
) -> Step {
    let length = (offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]).sqrt();
    if culling && is_culled(offset, length, radius, view) {
        return Step::Drop;
    }
    if is_small(offset, length, radius.max(view.radius), view.radius, scale) {
        return Step::Point;
    }
    match (scene_is_leaf, view.is_leaf()) {
        (true, true) => Step::Near,
        (false, true) => Step::SplitScene,
        (true, false) => Step::SplitViews,
        (false, false) if 2.0 * view.radius > radius => Step::SplitViews,
        (false, false) => Step::SplitScene,
    }
}

impl Traversal<'_> {
    /// Draws the maps of all leaves.
    pub(super) fn run(&self, output: Output<'_>) {
        self.visit(0, &[NodeRef::ROOT], None, output, &mut Scratch::default(), 0);
    }

    /// Draws the maps of all leaves below a view node, which goes on with the scene nodes `inherited`.
    fn visit(
        &self,
        index: usize,
        inherited: &[NodeRef],
        parent: Option<Parent<'_>>,
        output: Output<'_>,
        scratch: &mut Scratch,
        depth: usize,
    ) {
        let node = &self.views.nodes[index];
        if scratch.levels.len() <= depth {
            scratch.levels.push(Level::default());
        }
        let mut level = std::mem::take(&mut scratch.levels[depth]);
        let count = texel_count(self.texels.resolution());
        level.depths.clear();
        level.depths.resize(count, f32::INFINITY);
        level.nodes.clear();
        level.nodes.resize(if self.with_nodes { count } else { 0 }, u32::MAX);
        level.passed_down.clear();
        self.draw(node, inherited, &mut level, &mut scratch.stack);
        if let Some(parent) = parent {
            self.fuse(node, parent, &mut level);
        }
        if node.is_leaf() {
            output.write(&level);
        } else {
            let parent = Parent { center: node.center, depths: &level.depths, nodes: &level.nodes };
            let parts = output.split(node.range().map(|child| self.views.leaves_below[child]), count);
            let jobs = node.range().zip(parts);
            if self.views.leaves_below[index] > LEAVES_PER_TASK {
                let jobs: Vec<_> = jobs.collect();
                jobs.into_par_iter().for_each_init(Scratch::default, |scratch, (child, output)| {
                    self.visit(child, &level.passed_down, Some(parent), output, scratch, 0);
                });
            } else {
                for (child, output) in jobs {
                    self.visit(child, &level.passed_down, Some(parent), output, scratch, depth + 1);
                }
            }
        }
        scratch.levels[depth] = level;
    }

    /// All pairs of a view node.
    fn draw(&self, view: &ViewNode, inherited: &[NodeRef], level: &mut Level, stack: &mut Vec<u32>) {
        let Level { depths, nodes, passed_down } = level;
        let mut canvas = Canvas { texels: self.texels, depths, nodes };
        for &scene_node in inherited {
            let (cell, scene_level) = self.scene.cell(scene_node);
            let edge = self.scene.cell_size(scene_level);
            let offset = self.offset(cell, edge, view);
            let leaf = scene_node.is_leaf();
            match step(offset, edge * SPHERE_OF_CUBE, leaf, view, self.scale, self.culling) {
                Step::Drop => {}
                Step::Point => canvas.point(self.mean_offset(scene_node, view), scene_node.0),
                Step::Near => near(&mut canvas, offset, edge, scene_node.0),
                Step::SplitViews => passed_down.push(scene_node),
                Step::SplitScene => stack.push(scene_node.0),
            }
        }
        while let Some(index) = stack.pop() {
            self.expand(index, view, &mut canvas, passed_down, stack);
        }
    }

    /// The pairs of a scene node's children.
    #[inline]
    fn expand(
        &self,
        index: u32,
        view: &ViewNode,
        canvas: &mut Canvas<'_>,
        passed_down: &mut Vec<NodeRef>,
        stack: &mut Vec<u32>,
    ) {
        let node = &self.scene.nodes[index as usize];
        let level = node.level() + 1;
        let edge = self.scene.cell_size(level);
        let radius = edge * SPHERE_OF_CUBE;
        let cell = node.cell();
        let leaves = level == self.scene.depth;
        let mut child = node.first_child();
        let mut mask = node.child_mask();
        while mask != 0 {
            let octant = mask.trailing_zeros();
            mask &= mask - 1;
            let offset = self.offset([0, 1, 2].map(|i| cell[i] * 2 + (octant >> i & 1)), edge, view);
            let scene_node = if leaves {
                let place = index - self.scene.level_starts[self.scene.depth as usize - 1];
                NodeRef(NodeRef::LEAF | place << 3 | octant)
            } else {
                NodeRef(child)
            };
            child += 1;
            match step(offset, radius, leaves, view, self.scale, self.culling) {
                Step::Drop => {}
                Step::Point if leaves => canvas.point(offset, scene_node.0),
                Step::Point => canvas.point(self.mean_offset(scene_node, view), scene_node.0),
                Step::Near => near(canvas, offset, edge, scene_node.0),
                Step::SplitViews => passed_down.push(scene_node),
                Step::SplitScene => stack.push(scene_node.0),
            }
        }
    }

    /// From a view node's middle to a cell's.
    #[inline(always)]
    fn offset(&self, cell: [u32; 3], edge: f32, view: &ViewNode) -> [f32; 3] {
        [0, 1, 2].map(|i| self.scene.origin[i] + (cell[i] as f32 + 0.5) * edge - view.center[i])
    }

    #[inline(always)]
    fn mean_offset(&self, node: NodeRef, view: &ViewNode) -> [f32; 3] {
        let mean = self.scene.mean(node);
        [0, 1, 2].map(|i| mean[i] - view.center[i])
    }

    /// Fills a map from its parent's.
    fn fuse(&self, view: &ViewNode, parent: Parent<'_>, level: &mut Level) {
        let offset = [0, 1, 2].map(|i| view.center[i] - parent.center[i]);
        if !self.with_nodes {
            self.texels.fuse(&mut level.depths, parent.depths, offset);
            return;
        }
        let own = level.depths.clone();
        self.texels.fuse(&mut level.depths, parent.depths, offset);
        for (t, node) in level.nodes.iter_mut().enumerate() {
            if level.depths[t] != own[t] {
                *node = parent.nodes[t];
            }
        }
    }
}

/// Draws a leaf as what it is, unless the middle of the map is inside: from there nothing else would be seen.
#[inline(always)]
fn near(canvas: &mut Canvas<'_>, offset: [f32; 3], edge: f32, node: u32) {
    if !offset.iter().all(|c| c.abs() <= edge * 0.5) {
        canvas.leaf(offset, edge, node);
    }
}

impl<'a> Output<'a> {
    fn write(self, level: &Level) {
        match self.depths {
            DepthsMut::Full(depths) => depths.copy_from_slice(&level.depths),
            DepthsMut::Half(depths) => {
                half::slice::HalfFloatSliceExt::convert_from_f32_slice(depths, &level.depths);
            }
        }
        self.nodes.copy_from_slice(&level.nodes);
    }

    /// Cut into parts of so many maps.
    fn split(self, maps: impl Iterator<Item = u32>, texels: usize) -> impl Iterator<Item = Output<'a>> {
        let Output { mut depths, mut nodes } = self;
        maps.map(move |maps| {
            let count = maps as usize * texels;
            let part = match &mut depths {
                DepthsMut::Full(rest) => {
                    DepthsMut::Full(rest.split_off_mut(..count).expect("room for every leaf"))
                }
                DepthsMut::Half(rest) => {
                    DepthsMut::Half(rest.split_off_mut(..count).expect("room for every leaf"))
                }
            };
            let count = count.min(nodes.len());
            let nodes = nodes.split_off_mut(..count).unwrap_or_default();
            Output { depths: part, nodes }
        })
    }
}
