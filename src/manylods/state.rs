//! Cuts that are kept from frame to frame.

use super::drawing::{Counts, CutSink, draw_children, mean_offset};
use super::octants::{Eye, Octants, Outcome, each_bit, octant_of};
use super::passes::{Plan, draw_pass};
use super::{CutStats, SvoCuts};
use crate::views::splat::{Canvas, TexelDirections};
use crate::views::{View, ViewError, ViewMaps, ViewSettings};
use manyview_shaders::scene_tree::{NodeRef, SceneTree};
use std::sync::{Mutex, PoisonError};

/// Parent of the root.
const NONE: u32 = u32::MAX;

/// How far a cut may move in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Steps {
    /// As far as it takes: \[ML\]'s *incremental*.
    All,
    /// So many edges of the hierarchy: \[ML\]'s *lazy*, with 1.
    AtMost(u32),
}

impl Steps {
    /// Most edges.
    pub(super) fn most(self) -> u32 {
        match self {
            Self::All => u32::MAX,
            Self::AtMost(steps) => steps,
        }
    }
}

/// Those children of an inner node that are in a cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Siblings {
    /// The inner node, or [`NONE`] with a mask of 1 for the root.
    parent: u32,
    /// Their octants.
    mask: u32,
}

const ROOT: Siblings = Siblings { parent: NONE, mask: 1 };

/// The cut of one view: all of the octree, by nodes none of which holds another, in depth-first order.
#[derive(Debug, Clone, PartialEq)]
struct ViewCut {
    entries: Vec<Siblings>,
    /// Merges since siblings were last put together.
    merges: usize,
}

impl Default for ViewCut {
    fn default() -> Self {
        Self { entries: vec![ROOT], merges: 0 }
    }
}

/// Cuts of some views, kept between frames. It belongs to one octree.
#[derive(Debug, Default)]
pub struct CutState {
    views: Vec<Mutex<ViewCut>>,
}

impl CutState {
    /// Cuts that are the root alone.
    pub fn new() -> Self {
        Self::default()
    }

    /// Bytes of the cuts.
    pub fn bytes(&self) -> u64 {
        let bytes = |cut: &Mutex<ViewCut>| {
            let cut = cut.lock().unwrap_or_else(PoisonError::into_inner);
            size_of::<Mutex<ViewCut>>() + cut.entries.capacity() * size_of::<Siblings>()
        };
        self.views.iter().map(bytes).sum::<usize>() as u64
    }
}

/// Parents of all inner nodes.
fn parents(tree: &SceneTree) -> Vec<u32> {
    let mut parents = vec![NONE; tree.nodes.len()];
    for index in 0..tree.level_starts[tree.depth as usize - 1] {
        let node = &tree.nodes[index as usize];
        let first = node.first_child() as usize;
        parents[first..first + node.child_mask().count_ones() as usize].fill(index);
    }
    parents
}

/// A frame of one view.
struct Frame<'a, S> {
    tree: &'a SceneTree,
    parents: &'a [u32],
    eye: &'a Eye,
    steps: u32,
    sink: &'a mut S,
    counts: Counts,
    out: Vec<Siblings>,
    merges: usize,
}

impl<S: CutSink> Frame<'_, S> {
    fn emit(&mut self, siblings: Siblings) {
        match self.out.last_mut() {
            Some(last) if last.parent == siblings.parent => last.mask |= siblings.mask,
            _ => self.out.push(siblings),
        }
    }

    fn test(&self, node: u32) -> Outcome {
        let node = &self.tree.nodes[node as usize];
        self.eye.test_node(self.tree, node.cell(), node.level())
    }

    /// Moves siblings by at most `steps` edges, and draws where they come to stand.
    fn advance(&mut self, siblings: Siblings, steps: u32) {
        let parent = siblings.parent;
        if parent == NONE {
            self.counts.visited[0] += 1;
            return match self.test(0) {
                Outcome::Large if steps > 0 => {
                    let mask = self.tree.nodes[0].child_mask();
                    self.split(Siblings { parent: 0, mask }, steps - 1);
                }
                outcome => self.stand(0, outcome),
            };
        }
        match self.test(parent) {
            Outcome::Large => self.split(siblings, steps),
            _ if steps == 0 => self.split(siblings, 0),
            mut outcome => {
                let (mut node, mut steps) = (parent, steps - 1);
                self.merges += 1;
                while steps > 0 && self.parents[node as usize] != NONE {
                    match self.test(self.parents[node as usize]) {
                        Outcome::Large => break,
                        valid => outcome = valid,
                    }
                    node = self.parents[node as usize];
                    steps -= 1;
                }
                self.stand(node, outcome);
            }
        }
    }

    /// Keeps one inner node and draws it, unless it was the last that was kept.
    fn stand(&mut self, node: u32, outcome: Outcome) {
        let inner = &self.tree.nodes[node as usize];
        let level = inner.level();
        let siblings = match self.parents[node as usize] {
            NONE => ROOT,
            parent => Siblings { parent, mask: 1 << octant_of(inner.cell()) },
        };
        let last = self.out.last();
        if last.is_some_and(|last| last.parent == siblings.parent && last.mask & siblings.mask != 0) {
            return;
        }
        self.emit(siblings);
        if outcome != Outcome::Culled {
            self.counts.drawn += 1;
            let offset = mean_offset(self.tree, inner, self.tree.cell_size(level), self.eye);
            self.sink.point(offset, NodeRef(node));
        }
    }

    /// Keeps and draws those siblings that are valid, whose parent is not, and goes on with the children of others.
    fn split(&mut self, siblings: Siblings, steps: u32) {
        let Siblings { parent, mask } = siblings;
        let node = &self.tree.nodes[parent as usize];
        let edge = self.tree.cell_size(node.level() + 1);
        let octants = Octants::new(self.tree.origin, node.cell(), edge, self.eye);
        let (mut split, mut children) = (0, [0; 8]);
        let subdivide = |octant: u32, child| {
            if steps > 0 {
                split |= 1 << octant;
                children[octant as usize] = child;
            }
            steps > 0
        };
        let at = (parent, node);
        let seen = (self.tree, self.eye);
        draw_children(seen, at, (mask, &octants), self.sink, &mut self.counts, subdivide);
        if mask & !split != 0 {
            self.emit(Siblings { parent, mask: mask & !split });
        }
        for octant in each_bit(split) {
            let child = children[octant as usize];
            let mask = self.tree.nodes[child as usize].child_mask();
            self.split(Siblings { parent: child, mask }, steps - 1);
        }
    }
}

/// Puts siblings together that merging has left apart.
fn tidy(tree: &SceneTree, entries: &mut Vec<Siblings>) {
    // Depth first: by the path from the root, a node before what it holds.
    entries.sort_by_cached_key(|entry| {
        if entry.parent == NONE {
            return (0, 0);
        }
        let node = &tree.nodes[entry.parent as usize];
        let (cell, level) = (node.cell(), node.level());
        let mut path = 0u64;
        for bit in (0..level).rev() {
            let at = |axis: usize| u64::from(cell[axis] >> bit & 1) << axis;
            path = path << 3 | at(0) | at(1) | at(2);
        }
        (path << (3 * (tree.depth - level)), level + 1)
    });
    let mut kept: Vec<Siblings> = Vec::with_capacity(entries.len());
    for &entry in entries.iter() {
        match kept.last_mut() {
            Some(last) if last.parent == entry.parent => last.mask |= entry.mask,
            _ => kept.push(entry),
        }
    }
    *entries = kept;
}

/// Moves the cut of a view by one frame.
fn advance(
    (tree, parents): (&SceneTree, &[u32]),
    eye: &Eye,
    steps: Steps,
    cut: &mut ViewCut,
    spare: &mut Vec<Siblings>,
    sink: &mut impl CutSink,
) -> Counts {
    let steps = steps.most();
    spare.clear();
    let out = std::mem::take(spare);
    let mut frame = Frame { tree, parents, eye, steps, sink, counts: Counts::default(), out, merges: 0 };
    for &siblings in &cut.entries {
        frame.advance(siblings, frame.steps);
    }
    let Frame { out, merges, counts, .. } = frame;
    cut.entries.clear();
    cut.entries.extend_from_slice(&out);
    *spare = out;
    cut.merges += merges;
    if cut.merges > cut.entries.len() / 4 {
        tidy(tree, &mut cut.entries);
        cut.merges = 0;
    }
    counts
}

impl SvoCuts {
    fn parents(&self) -> &[u32] {
        self.parents.get_or_init(|| parents(&self.tree))
    }

    /// Draws a frame of views that may have moved since the last one, from their last cuts. Views have the place in the list
    /// that they had. Maps and cuts have to fit the budget together.
    pub fn render_frame(
        &self,
        state: &mut CutState,
        views: &[View],
        settings: &ViewSettings,
        steps: Steps,
    ) -> Result<(ViewMaps, CutStats), ViewError> {
        self.check(settings)?;
        state.views.truncate(views.len());
        state.views.resize_with(views.len(), Mutex::default);
        let plan = Plan::new(settings, [0, 0])?;
        let needed_bytes = views.len() as u64 * (settings.map_bytes() + 20) + state.bytes();
        if plan.views < views.len() || needed_bytes > settings.budget_bytes {
            let what = "the maps and the cuts of a frame";
            return Err(settings.over_budget(what, needed_bytes));
        }
        let parents = self.parents();
        let texels = TexelDirections::new(settings.resolution);
        let sums = Mutex::new(Counts::default());
        let color_of = |node| self.color(node);
        let draw = |spare: &mut Vec<Siblings>, place: usize, view: &View, canvas: &mut Canvas<'_>| {
            let mut cut = state.views[place].lock().unwrap_or_else(PoisonError::into_inner);
            let eye = self.eye(view, settings);
            let counts = advance((&self.tree, parents), &eye, steps, &mut cut, spare, canvas);
            sums.lock().unwrap_or_else(PoisonError::into_inner).add(&counts);
        };
        let maps = draw_pass(views, 0, settings, &texels, &plan, &color_of, draw);
        let counts = sums.into_inner().unwrap_or_else(PoisonError::into_inner);
        Ok((maps, CutStats::new(&counts, state.bytes())))
    }

    /// Moves the kept cut of a view by one frame without drawing it, and returns the node-views that would be drawn.
    pub fn advance_cut(
        &self,
        state: &mut CutState,
        place: usize,
        view: &View,
        settings: &ViewSettings,
        steps: Steps,
    ) -> Vec<NodeRef> {
        if state.views.len() <= place {
            state.views.resize_with(place + 1, Mutex::default);
        }
        let mut nodes = Vec::new();
        if view.is_drawable() {
            let cut = state.views[place].get_mut().unwrap_or_else(PoisonError::into_inner);
            let eye = self.eye(view, settings);
            let tree = (&*self.tree, self.parents());
            advance(tree, &eye, steps, cut, &mut Vec::new(), &mut nodes);
        }
        nodes
    }
}
