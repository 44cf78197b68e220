//! Drawing the node-views of a cut, and cutting anew.

use super::octants::{Eye, Octants, Outcome, each_bit};
use crate::views::splat::Canvas;
use manyview_shaders::scene_tree::{NodeRef, SceneNode, SceneTree};

/// Takes the node-views of a cut.
pub(super) trait CutSink {
    /// A node that fills less than a texel, whose mean is at `offset` from the view.
    fn point(&mut self, offset: [f32; 3], node: NodeRef);

    /// A leaf that fills more, whose middle is at `offset` from the view.
    fn leaf(&mut self, offset: [f32; 3], edge: f32, node: NodeRef);
}

impl CutSink for Canvas<'_> {
    #[inline(always)]
    fn point(&mut self, offset: [f32; 3], node: NodeRef) {
        Canvas::point(self, offset, node.0);
    }

    #[inline(always)]
    fn leaf(&mut self, offset: [f32; 3], edge: f32, node: NodeRef) {
        Canvas::leaf(self, offset, edge, node.0);
    }
}

/// Collects the node-views alone.
impl CutSink for Vec<NodeRef> {
    fn point(&mut self, _: [f32; 3], node: NodeRef) {
        self.push(node);
    }

    fn leaf(&mut self, _: [f32; 3], _: f32, node: NodeRef) {
        self.push(node);
    }
}

/// How many node-views there were.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Counts {
    /// Tested, by level.
    pub(super) visited: [u64; 16],
    /// Drawn.
    pub(super) drawn: u64,
    /// Of those, leaves that fill more than a texel.
    pub(super) near_leaves: u64,
    /// Longest list, node-views.
    pub(super) list: usize,
}

impl Counts {
    /// Counts node-views whose level does not matter.
    pub(super) fn visit(&mut self, count: usize) {
        self.visited[0] += count as u64;
    }

    /// Takes those of other views in.
    pub(super) fn add(&mut self, other: &Self) {
        self.visited.iter_mut().zip(other.visited).for_each(|(sum, count)| *sum += count);
        self.drawn += other.drawn;
        self.near_leaves += other.near_leaves;
        self.list = self.list.max(other.list);
    }
}

/// Active lists of a thread.
#[derive(Debug, Default)]
pub(super) struct Lists {
    waiting: Vec<u32>,
    batch: Vec<u32>,
}

/// From the view to the mean of an inner node in `cell` of an edge.
#[inline(always)]
pub(super) fn mean_offset(tree: &SceneTree, node: &SceneNode, edge: f32, eye: &Eye) -> [f32; 3] {
    let mean = node.mean();
    [0, 1, 2].map(|i: usize| tree.origin[i] + mean[i] * edge - eye.view.center[i])
}

/// Draws those children of an inner node in `mask` that are not culled, and hands those that have to be subdivided to
/// `subdivide`, or draws them too if there is no more time for it.
#[inline(always)]
pub(super) fn draw_children(
    (tree, eye): (&SceneTree, &Eye),
    (index, node): (u32, &SceneNode),
    (mask, octants): (u32, &Octants),
    sink: &mut impl CutSink,
    counts: &mut Counts,
    mut subdivide: impl FnMut(u32, u32) -> bool,
) {
    let level = node.level() + 1;
    let edge = tree.cell_size(level);
    counts.visited[level as usize] += u64::from(mask.count_ones());
    if level == tree.depth {
        let place = NodeRef::LEAF | (index - tree.level_starts[tree.depth as usize - 1]) << 3;
        let small = mask & octants.small;
        counts.drawn += u64::from(small.count_ones());
        for octant in each_bit(small) {
            sink.point(octants.offset(octant), NodeRef(place | octant));
        }
        for octant in each_bit(mask & !octants.small & !octants.culled) {
            let offset = octants.offset(octant);
            // What the view is in would hide all else.
            if offset.iter().any(|c| c.abs() > edge * 0.5) {
                counts.drawn += 1;
                counts.near_leaves += 1;
                sink.leaf(offset, edge, NodeRef(place | octant));
            }
        }
        return;
    }
    let all = node.child_mask();
    for octant in each_bit(mask & !octants.culled) {
        let child = node.first_child() + (all & ((1 << octant) - 1)).count_ones();
        if octants.small >> octant & 1 == 1 || !subdivide(octant, child) {
            counts.drawn += 1;
            sink.point(mean_offset(tree, &tree.nodes[child as usize], edge, eye), NodeRef(child));
        }
    }
}

/// \[ML\]'s basic cut of one view: breadth first from the root. At most `batch` node-views are subdivided at a time, which
/// bounds the list.
pub(super) fn basic_cut(
    tree: &SceneTree,
    eye: &Eye,
    batch: usize,
    lists: &mut Lists,
    sink: &mut impl CutSink,
) -> Counts {
    let mut counts = Counts::default();
    counts.visited[0] = 1;
    let Lists { waiting, batch: taken } = lists;
    waiting.clear();
    match eye.test_node(tree, [0; 3], 0) {
        Outcome::Culled => return counts,
        Outcome::Small => {
            counts.drawn = 1;
            sink.point(mean_offset(tree, &tree.nodes[0], tree.size, eye), NodeRef::ROOT);
            return counts;
        }
        Outcome::Large => waiting.push(0),
    }
    while !waiting.is_empty() {
        taken.clear();
        taken.extend_from_slice(&waiting[waiting.len().saturating_sub(batch)..]);
        waiting.truncate(waiting.len() - taken.len());
        for &index in taken.iter() {
            let node = &tree.nodes[index as usize];
            let edge = tree.cell_size(node.level() + 1);
            let octants = Octants::new(tree.origin, node.cell(), edge, eye);
            let mask = node.child_mask();
            let subdivide = |_, child| {
                waiting.push(child);
                true
            };
            draw_children((tree, eye), (index, node), (mask, &octants), sink, &mut counts, subdivide);
        }
        counts.list = counts.list.max(waiting.len() + taken.len());
    }
    counts
}
