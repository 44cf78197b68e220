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
//! (`tests.rs` keeps that form; the GPU's stages are of it).
//!
//! Which of a pair is subdivided goes by the spheres ([`manyview_shaders::views::pair_step`]).

use super::view_tree::ViewTree;
use crate::simd::{SimdLevel, dispatched, prefetch};
use crate::views::splat::{Canvas, TexelDirections};
use half::f16;
use manyview_shaders::mega_views::NO_NUMBER;
use manyview_shaders::paraboloid::texel_count;
use manyview_shaders::scene_tree::{NodeRef, SPHERE_OF_CUBE, SceneTree};
use manyview_shaders::views::{PARALLAX, ViewNode, splits_views};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// View nodes with more leaves than that hand their children to other threads.
const LEAVES_PER_TASK: u32 = 32;

/// Octants that are tested together.
const LANES: usize = 8;
/// Points that are projected together.
const POINTS: usize = 64;
/// How far ahead scene nodes are asked for.
const AHEAD: usize = 16;
/// Stands for the mean of a leaf, which is its cell's middle.
const MEAN_OF_LEAF: u32 = u32::MAX;

/// What a traversal reads.
#[derive(Debug, Clone)]
pub(super) struct Traversal<'a> {
    pub(super) scene: &'a SceneTree,
    pub(super) views: &'a ViewTree,
    pub(super) texels: &'a TexelDirections,
    /// Resolution over the texels that a node may fill and still be drawn as a point.
    pub(super) scale: f32,
    pub(super) culling: bool,
    pub(super) with_nodes: bool,
    pub(super) simd: SimdLevel,
    /// The leaves to draw, counted depth first. Others are passed by, which changes no map.
    pub(super) leaves: Range<usize>,
    pub(super) counters: &'a Counters,
}

/// What a traversal did, counted by all threads.
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) view_nodes: AtomicU64,
    pub(super) points: AtomicU64,
    pub(super) near_leaves: AtomicU64,
    /// Points and near leaves, each times the views that it is drawn for.
    pub(super) drawn_for_views: AtomicU64,
    /// Time of all threads, nanoseconds.
    pub(super) draw_nanoseconds: AtomicU64,
    pub(super) fuse_nanoseconds: AtomicU64,
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
    /// A place for the map of every node of the view hierarchy, as it was drawn.
    Unfused(&'a [OnceLock<Box<[f32]>>]),
}

/// A view node on the way down.
#[derive(Debug, Clone, Copy)]
struct Place {
    index: usize,
    /// Leaves that come before it depth first.
    first_leaf: usize,
    /// Which of a thread's levels it draws in.
    depth: usize,
}

/// A map that is complete.
#[derive(Clone, Copy)]
struct Parent<'a> {
    center: [f32; 3],
    depths: &'a [f32],
    nodes: &'a [u32],
}

/// Scene nodes that a view node's children go on with.
#[derive(Debug, Default)]
pub(super) struct Pending {
    /// Middles of their cells.
    centers: [Vec<f32>; 3],
    edges: Vec<f32>,
    numbers: Vec<u32>,
}

impl Pending {
    fn root(scene: &SceneTree) -> Self {
        let mut root = Self::default();
        root.push(scene.cell_center(NodeRef::ROOT), scene.size, NodeRef::ROOT.0);
        root
    }

    #[inline(always)]
    fn push(&mut self, center: [f32; 3], edge: f32, number: u32) {
        for i in 0..3 {
            self.centers[i].push(center[i]);
        }
        self.edges.push(edge);
        self.numbers.push(number);
    }

    #[inline(always)]
    fn push_from(&mut self, other: &Self, at: usize) {
        let center = [other.centers[0][at], other.centers[1][at], other.centers[2][at]];
        self.push(center, other.edges[at], other.numbers[at]);
    }

    fn clear(&mut self) {
        self.centers.iter_mut().for_each(Vec::clear);
        self.edges.clear();
        self.numbers.clear();
    }
}

/// What one thread needs for each level of the view hierarchy.
#[derive(Default)]
struct Scratch {
    levels: Vec<Level>,
    queue: Vec<u32>,
}

#[derive(Default)]
pub(super) struct Level {
    depths: Vec<f32>,
    nodes: Vec<u32>,
    passed_down: Pending,
    points: u64,
    near_leaves: u64,
}

impl Traversal<'_> {
    /// Draws the maps of all leaves.
    pub(super) fn run(&self, output: Output<'_>) {
        let at = Place { index: 0, first_leaf: 0, depth: 0 };
        self.visit(at, &Pending::root(self.scene), None, output, &mut Scratch::default());
    }

    /// Draws the maps of all leaves below a view node, which goes on with the scene nodes `inherited`.
    fn visit(
        &self,
        at: Place,
        inherited: &Pending,
        parent: Option<Parent<'_>>,
        output: Output<'_>,
        scratch: &mut Scratch,
    ) {
        let Place { index, depth, .. } = at;
        let node = &self.views.nodes[index];
        if scratch.levels.len() <= depth {
            scratch.levels.push(Level::default());
        }
        let mut level = std::mem::take(&mut scratch.levels[depth]);
        let count = texel_count(self.texels.resolution());
        level.depths.clear();
        level.depths.resize(count, f32::INFINITY);
        level.nodes.clear();
        level.nodes.resize(if self.with_nodes { count } else { 0 }, NO_NUMBER);
        level.passed_down.clear();
        (level.points, level.near_leaves) = (0, 0);
        let clock = Instant::now();
        draw_node(self.simd, self, node, inherited, &mut level, &mut scratch.queue);
        let drawn = clock.elapsed();
        match (&output.depths, parent) {
            (DepthsMut::Unfused(maps), _) => _ = maps[index].set(level.depths.as_slice().into()),
            (_, Some(parent)) => self.fuse(node, parent, &mut level),
            (_, None) => {}
        }
        let add = |counter: &AtomicU64, more: u64| _ = counter.fetch_add(more, Ordering::Relaxed);
        add(&self.counters.view_nodes, 1);
        add(&self.counters.points, level.points);
        add(&self.counters.near_leaves, level.near_leaves);
        let views = u64::from(self.views.views_below[index]);
        add(&self.counters.drawn_for_views, (level.points + level.near_leaves) * views);
        add(&self.counters.draw_nanoseconds, drawn.as_nanos() as u64);
        add(&self.counters.fuse_nanoseconds, (clock.elapsed() - drawn).as_nanos() as u64);
        if node.is_leaf() {
            output.write(&level);
        } else {
            let parent = Parent { center: node.center, depths: &level.depths, nodes: &level.nodes };
            let children: Vec<Place> = self.children(at).collect();
            let parts = output.split(children.iter().map(|&child| self.wanted_leaves(child).len()), count);
            let jobs = children.iter().copied().zip(parts);
            if self.views.leaves_below[index] > LEAVES_PER_TASK {
                let jobs: Vec<_> = jobs.collect();
                jobs.into_par_iter().for_each_init(Scratch::default, |scratch, (child, output)| {
                    let child = Place { depth: 0, ..child };
                    self.visit(child, &level.passed_down, Some(parent), output, scratch);
                });
            } else {
                for (child, output) in jobs {
                    self.visit(child, &level.passed_down, Some(parent), output, scratch);
                }
            }
        }
        scratch.levels[depth] = level;
    }

    /// The children of a view node that have leaves to draw.
    fn children(&self, at: Place) -> impl Iterator<Item = Place> + '_ {
        let mut first_leaf = at.first_leaf;
        let places = self.views.nodes[at.index].range().map(move |index| {
            let place = Place { index, first_leaf, depth: at.depth + 1 };
            first_leaf += self.views.leaves_below[index] as usize;
            place
        });
        places.filter(|&child| !self.wanted_leaves(child).is_empty())
    }

    /// The leaves below a node that are to be drawn.
    fn wanted_leaves(&self, at: Place) -> Range<usize> {
        let end = at.first_leaf + self.views.leaves_below[at.index] as usize;
        at.first_leaf.max(self.leaves.start)..end.min(self.leaves.end)
    }

    /// All pairs of a view node.
    #[inline(always)]
    fn draw(&self, view: &ViewNode, inherited: &Pending, level: &mut Level, queue: &mut Vec<u32>) {
        let Level { depths, nodes, passed_down, points: point_count, near_leaves } = level;
        let mut canvas = Canvas { texels: self.texels, depths, nodes };
        let mut points = Points::new();
        for start in (0..inherited.numbers.len()).step_by(LANES) {
            let count = LANES.min(inherited.numbers.len() - start);
            let (mut offset, mut edges) = ([[0.0f32; LANES]; 3], [0.0f32; LANES]);
            edges[..count].copy_from_slice(&inherited.edges[start..start + count]);
            for i in 0..3 {
                offset[i][..count].copy_from_slice(&inherited.centers[i][start..start + count]);
                for lane in 0..LANES {
                    offset[i][lane] -= view.center[i];
                }
            }
            let (seen, small) = self.test(&offset, &edges, view);
            for lane in bits(seen & ((1 << count) - 1)) {
                let lane = lane as usize;
                let node = NodeRef(inherited.numbers[start + lane]);
                let (offset, edge) = ([offset[0][lane], offset[1][lane], offset[2][lane]], edges[lane]);
                if small >> lane & 1 == 1 {
                    let mean = if node.is_leaf() {
                        MEAN_OF_LEAF
                    } else {
                        self.scene.nodes[node.0 as usize].words[1]
                    };
                    points.push(&mut canvas, offset, mean, edge, node.0);
                } else if splits_views(edge * SPHERE_OF_CUBE, node.is_leaf(), view) {
                    passed_down.push_from(inherited, start + lane);
                } else if node.is_leaf() {
                    points.near_leaves += 1;
                    near(&mut canvas, offset, edge, node.0);
                } else {
                    queue.push(node.0);
                }
            }
        }
        // First come, first served, so that what comes is known a while before: octrees are larger than caches.
        let mut next = 0;
        while next < queue.len() {
            if let Some(&soon) = queue.get(next + AHEAD) {
                prefetch(&self.scene.nodes, soon as usize);
            }
            if let Some(&sooner) = queue.get(next + AHEAD / 2) {
                let children = self.scene.nodes[sooner as usize].first_child() as usize;
                prefetch(&self.scene.nodes, children);
                prefetch(&self.scene.nodes, children + 4);
            }
            self.expand(queue[next], view, &mut canvas, &mut points, passed_down, queue);
            next += 1;
        }
        queue.clear();
        points.flush(&mut canvas);
        (*point_count, *near_leaves) = (points.total, points.near_leaves);
    }

    /// The pairs of a scene node's children: the rule of [`manyview_shaders::views::pair_step`] for all eight octants at a time.
    #[inline(always)]
    fn expand(
        &self,
        index: u32,
        view: &ViewNode,
        canvas: &mut Canvas<'_>,
        points: &mut Points,
        passed_down: &mut Pending,
        queue: &mut Vec<u32>,
    ) {
        let node = &self.scene.nodes[index as usize];
        let level = node.level() + 1;
        let edge = self.scene.cell_size(level);
        let radius = edge * SPHERE_OF_CUBE;
        let leaves = level == self.scene.depth;
        let [x, y, z] = node.cell();
        let cell = [2 * x, 2 * y, 2 * z];
        let (mut centers, mut offset) = ([[0.0f32; LANES]; 3], [[0.0f32; LANES]; 3]);
        for i in 0..3 {
            for octant in 0..LANES {
                let cell = (cell[i] + (octant as u32 >> i & 1)) as f32;
                centers[i][octant] = self.scene.origin[i] + (cell + 0.5) * edge;
                offset[i][octant] = centers[i][octant] - view.center[i];
            }
        }
        let (seen, small) = self.test(&offset, &[edge; LANES], view);
        let mask = node.child_mask();
        let seen = seen & mask;
        let base = if leaves {
            NodeRef::LEAF | (index - self.scene.level_starts[self.scene.depth as usize - 1]) << 3
        } else {
            node.first_child()
        };
        let number = |octant: u32| match leaves {
            true => base | octant,
            false => base + (mask & ((1 << octant) - 1)).count_ones(),
        };
        for octant in bits(seen & small) {
            let number = number(octant);
            let mean = if leaves { MEAN_OF_LEAF } else { self.scene.nodes[number as usize].words[1] };
            let at = octant as usize;
            points.push(canvas, [offset[0][at], offset[1][at], offset[2][at]], mean, edge, number);
        }
        let split_views = splits_views(radius, leaves, view);
        for octant in bits(seen & !small) {
            let (number, at) = (number(octant), octant as usize);
            if split_views {
                passed_down.push([centers[0][at], centers[1][at], centers[2][at]], edge, number);
            } else if leaves {
                points.near_leaves += 1;
                near(canvas, [offset[0][at], offset[1][at], offset[2][at]], edge, number);
            } else {
                queue.push(number);
            }
        }
    }

    /// [`is_culled`] (negated) and [`is_small`] of eight scene nodes, a bit each.
    #[inline(always)]
    fn test(&self, offset: &[[f32; LANES]; 3], edges: &[f32; LANES], view: &ViewNode) -> (u32, u32) {
        let [x, y, z] = offset;
        let reach = PARALLAX * view.radius;
        let (mut small, mut seen) = (0, 0);
        for i in 0..LANES {
            let radius = edges[i] * SPHERE_OF_CUBE;
            let length = (x[i] * x[i] + y[i] * y[i] + z[i] * z[i]).sqrt();
            let larger = if radius > reach { radius } else { reach };
            let is_small = larger * self.scale * length < (length - view.radius) * (length + x[i].abs());
            small |= u32::from(is_small) << i;
            let along = x[i] * view.axis[0] + y[i] * view.axis[1] + z[i] * view.axis[2];
            let across = length * length - along * along;
            let across = if across > 0.0 { across } else { 0.0 }.sqrt();
            let outside = across * view.cos_psi - along * view.sin_psi;
            let facing = along * view.cos_psi + across * view.sin_psi;
            let distance = if facing < 0.0 { length } else { outside };
            let is_culled = outside > 0.0 && distance > radius + view.radius;
            seen |= u32::from(!is_culled) << i;
        }
        if !self.culling || view.cos_psi <= -1.0 {
            seen = (1 << LANES) - 1;
        }
        (seen, small)
    }

    /// Fills a map from its parent's.
    fn fuse(&self, view: &ViewNode, parent: Parent<'_>, level: &mut Level) {
        let offset = [0, 1, 2].map(|i| view.center[i] - parent.center[i]);
        if !self.with_nodes {
            fuse_maps(self.simd, self.texels, &mut level.depths, parent.depths, offset);
            return;
        }
        let own = level.depths.clone();
        fuse_maps(self.simd, self.texels, &mut level.depths, parent.depths, offset);
        for (t, node) in level.nodes.iter_mut().enumerate() {
            if level.depths[t] != own[t] {
                *node = parent.nodes[t];
            }
        }
    }
}

dispatched! {
    /// [`Traversal::draw`].
    draw_node = draw_node_body(
        traversal: &Traversal<'_>,
        view: &ViewNode,
        inherited: &Pending,
        level: &mut Level,
        queue: &mut Vec<u32>,
    )
}

#[inline(always)]
fn draw_node_body(
    traversal: &Traversal<'_>,
    view: &ViewNode,
    inherited: &Pending,
    level: &mut Level,
    queue: &mut Vec<u32>,
) {
    traversal.draw(view, inherited, level, queue);
}

dispatched! {
    /// [`TexelDirections::fuse`].
    fuse_maps = fuse_maps_body(texels: &TexelDirections, child: &mut [f32], parent: &[f32], offset: [f32; 3])
}

#[inline(always)]
fn fuse_maps_body(texels: &TexelDirections, child: &mut [f32], parent: &[f32], offset: [f32; 3]) {
    texels.fuse(child, parent, offset);
}

/// Places of set bits, the lowest first.
#[inline(always)]
fn bits(mut mask: u32) -> impl Iterator<Item = u32> {
    std::iter::from_fn(move || {
        let lowest = (mask != 0).then(|| mask.trailing_zeros());
        mask &= mask.wrapping_sub(1);
        lowest
    })
}

/// Scene nodes to be drawn as points, collected so that they are projected many at a time.
struct Points {
    count: usize,
    /// How many there were, and leaves that were no points.
    total: u64,
    near_leaves: u64,
    /// From the view node's middle to the cells'.
    offsets: [[f32; POINTS]; 3],
    /// [`manyview_shaders::scene_tree::SceneNode`]'s word 1, or [`MEAN_OF_LEAF`].
    means: [u32; POINTS],
    edges: [f32; POINTS],
    numbers: [u32; POINTS],
}

impl Points {
    #[inline(always)]
    fn new() -> Self {
        Self {
            count: 0,
            total: 0,
            near_leaves: 0,
            offsets: [[0.0; POINTS]; 3],
            means: [0; POINTS],
            edges: [0.0; POINTS],
            numbers: [0; POINTS],
        }
    }

    #[inline(always)]
    fn push(&mut self, canvas: &mut Canvas<'_>, offset: [f32; 3], mean: u32, edge: f32, number: u32) {
        let at = self.count;
        for i in 0..3 {
            self.offsets[i][at] = offset[i];
        }
        (self.means[at], self.edges[at], self.numbers[at]) = (mean, edge, number);
        self.count += 1;
        if self.count == POINTS {
            self.flush(canvas);
        }
    }

    /// [`Canvas::point`] for all of them.
    #[inline(always)]
    fn flush(&mut self, canvas: &mut Canvas<'_>) {
        let mut offsets = [[0.0f32; POINTS]; 3];
        for i in 0..3 {
            for at in 0..POINTS {
                let share =
                    (self.means[at] >> (10 * i) & 0x3ff) as f32 * (1.0 / 1024.0) + (0.5 / 1024.0 - 0.5);
                let share = if self.means[at] == MEAN_OF_LEAF { 0.0 } else { share };
                offsets[i][at] = self.offsets[i][at] + share * self.edges[at];
            }
        }
        canvas.points(&offsets, &self.numbers, self.count);
        self.total += self.count as u64;
        self.count = 0;
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
            DepthsMut::Unfused(_) => {}
        }
        self.nodes.copy_from_slice(&level.nodes);
    }

    /// Cut into parts of so many maps.
    fn split(self, maps: impl Iterator<Item = usize>, texels: usize) -> impl Iterator<Item = Output<'a>> {
        let Output { mut depths, mut nodes } = self;
        maps.map(move |maps| {
            let count = maps * texels;
            let part = match &mut depths {
                DepthsMut::Full(rest) => {
                    DepthsMut::Full(rest.split_off_mut(..count).expect("room for every leaf"))
                }
                DepthsMut::Half(rest) => {
                    DepthsMut::Half(rest.split_off_mut(..count).expect("room for every leaf"))
                }
                DepthsMut::Unfused(maps) => DepthsMut::Unfused(maps),
            };
            let count = count.min(nodes.len());
            let nodes = nodes.split_off_mut(..count).unwrap_or_default();
            Output { depths: part, nodes }
        })
    }
}
