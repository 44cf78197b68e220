//! The view hierarchy.
//!
//! # Theory
//! \[MV\] §3.1: an octree over the views, of the same cube as the scene's, built anew every frame; nodes hold the sphere
//! around their views and a cone around all their fields of view, merged bottom-up.
//!
//! # Differences from the paper
//! - Nodes with one child are left out: a node's children are the views' runs by the highest digit of their Morton keys in
//!   which they differ. A single view is a leaf however large its cell is.
//! - Spheres are around the views, not around cells: a lone view's map is drawn from where it is.
//! - All views in one voxel are a leaf and share a map, as in the paper, or ([`Sharing::None`]) every view is a leaf.
//!
//! # Practice
//! Views are sorted once ([`SortedViews`]); any run of them in that order is a tree of its own ([`ViewTree`]), which is how
//! work is cut into passes.

use manyview_shaders::mega_views::{KEY_LEVELS, MOST_SHARED, SceneParams};
use manyview_shaders::scene_tree::SceneTree;
use manyview_shaders::views::{View, ViewNode, merged_cone};
use rayon::prelude::*;
use std::ops::Range;

/// Which views share a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sharing {
    /// All in one voxel of the scene's octree: \[MV\]'s.
    #[default]
    Voxel,
    /// None: the map of every view is from its own position.
    None,
    /// Not even work is shared: every view begins at the scene's root. \[ML\]'s cuts, by the means of \[MV\].
    Alone,
}

/// Drawable views in Morton order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SortedViews {
    /// Index of each in the list that was given.
    pub order: Vec<u32>,
    /// Its Morton key: bits 3l, 3l + 1, 3l + 2 are bit l of its cell's x, y, z in 1/8192 of the scene cube.
    pub keys: Vec<u64>,
}

impl SortedViews {
    /// Sorts the drawable ones among `views`; of views in one cell the first comes first.
    pub fn new(views: &[View], scene: &SceneTree) -> Self {
        let params = SceneParams::new(scene);
        let mut pairs: Vec<(u64, u32)> = views
            .par_iter()
            .enumerate()
            .filter(|(_, view)| view.is_drawable())
            .map(|(i, view)| (params.morton_key(view.position), i as u32))
            .collect();
        pairs.par_sort_unstable();
        let (keys, order) = pairs.into_par_iter().unzip();
        Self { order, keys }
    }
}

/// The Morton key of a position, moved into the scene cube if it lies outside.
pub fn morton_key(position: [f32; 3], scene: &SceneTree) -> u64 {
    SceneParams::new(scene).morton_key(position)
}

/// A view hierarchy over a run of [`SortedViews`].
#[derive(Debug, Clone, PartialEq)]
pub struct ViewTree {
    /// Nodes breadth first, the root first; views of leaves are places in the run.
    pub nodes: Vec<ViewNode>,
    /// Index of the first node of each level of the tree, and the number of nodes.
    pub level_starts: Vec<u32>,
    /// For each node how many leaves are below it, itself included.
    pub leaves_below: Vec<u32>,
    /// For each node how many views are below it.
    pub views_below: Vec<u32>,
}

impl ViewTree {
    /// The tree over the views `order` of `views`, whose keys are `keys`, in a scene of `depth` levels. There must be one
    /// view at least.
    pub fn new(views: &[View], order: &[u32], keys: &[u64], depth: u32, sharing: Sharing) -> Self {
        assert!(!order.is_empty() && order.len() == keys.len(), "a key for each of some views");
        if sharing == Sharing::Alone {
            return Self::flat(views, order);
        }
        let shift = 3 * (KEY_LEVELS - depth.min(KEY_LEVELS));
        let is_leaf = |range: &Range<usize>| {
            let shares = sharing == Sharing::Voxel
                && range.len() <= MOST_SHARED as usize
                && keys[range.start] >> shift == keys[range.end - 1] >> shift;
            range.len() == 1 || shares
        };
        let mut nodes: Vec<ViewNode> = Vec::new();
        let mut views_below = Vec::new();
        let mut level_starts = vec![0];
        let whole: Range<usize> = 0..order.len();
        let mut level = Vec::from([whole]);
        while !level.is_empty() {
            let next_start = (nodes.len() + level.len()) as u32;
            let split: Vec<Children> = level
                .par_iter()
                .with_min_len(256)
                .map(|range| if is_leaf(range) { Children::default() } else { children(keys, range.clone()) })
                .collect();
            let mut next = Vec::new();
            for (range, children) in level.iter().zip(&split) {
                let mut node = ViewNode::of_view(&View::around([0.0; 3]), 0);
                if children.count == 0 {
                    node.first = range.start as u32;
                    node.count = ViewNode::LEAF | range.len() as u32;
                } else {
                    node.first = next_start + next.len() as u32;
                    node.count = children.count as u32;
                    next.extend(children.ranges());
                }
                nodes.push(node);
                views_below.push(range.len() as u32);
            }
            level_starts.push(nodes.len() as u32);
            level = next;
        }
        let mut tree = Self { leaves_below: vec![1; nodes.len()], nodes, level_starts, views_below };
        tree.merge(views, order);
        tree
    }

    /// A root that nothing can be drawn for, and every view below it.
    fn flat(views: &[View], order: &[u32]) -> Self {
        let count = order.len() as u32;
        let all = View::around(views[order[0] as usize].position);
        let mut nodes = vec![ViewNode { radius: f32::INFINITY, count, ..ViewNode::of_view(&all, 1) }];
        nodes
            .extend((0..count).map(|place| ViewNode::of_view(&views[order[place as usize] as usize], place)));
        let mut below = vec![1; nodes.len()];
        below[0] = count;
        Self {
            level_starts: vec![0, 1, nodes.len() as u32],
            nodes,
            leaves_below: below.clone(),
            views_below: below,
        }
    }

    /// Spheres and cones, bottom-up.
    fn merge(&mut self, views: &[View], order: &[u32]) {
        let mut boxes = vec![[[0.0f32; 3]; 2]; self.nodes.len()];
        for level in self.level_starts.windows(2).rev() {
            let [start, end] = [level[0] as usize, level[1] as usize];
            let (own, below) = self.nodes[start..].split_at_mut(end - start);
            let (own_boxes, boxes_below) = boxes[start..].split_at_mut(end - start);
            let (own_leaves, leaves_below) = self.leaves_below[start..].split_at_mut(end - start);
            (own, own_boxes, own_leaves).into_par_iter().with_min_len(256).for_each(
                |(node, bounds, leaves)| {
                    if node.is_leaf() {
                        let inside = order[node.range()].iter().map(|&view| &views[view as usize]);
                        *bounds = hull(inside.clone().map(|view| [view.position; 2]));
                        (node.axis, [node.cos_psi, node.sin_psi]) = merged_cone(inside.map(View::cone));
                    } else {
                        let children = node.range().start - end..node.range().end - end;
                        *bounds = hull(boxes_below[children.clone()].iter().copied());
                        let cones = below[children.clone()]
                            .iter()
                            .map(|child| (child.axis, [child.cos_psi, child.sin_psi]));
                        (node.axis, [node.cos_psi, node.sin_psi]) = merged_cone(cones);
                        *leaves = leaves_below[children].iter().sum();
                    }
                    let [min, max] = *bounds;
                    node.center = [0, 1, 2].map(|i| (min[i] + max[i]) * 0.5);
                    let half = [0, 1, 2].map(|i| (max[i] - min[i]) * 0.5);
                    node.radius = (half[0] * half[0] + half[1] * half[1] + half[2] * half[2]).sqrt();
                    if node.is_leaf() && node.len() == 1 {
                        (node.center, node.radius) = (min, 0.0);
                    }
                },
            );
        }
    }

    /// Number of leaves, which is that of maps.
    pub fn leaf_count(&self) -> usize {
        self.leaves_below[0] as usize
    }

    /// Levels of the tree.
    pub fn height(&self) -> usize {
        self.level_starts.len() - 1
    }
}

/// Runs of children: child i begins where child i − 1 ends.
#[derive(Debug, Clone, Copy, Default)]
struct Children {
    bounds: [usize; 9],
    count: usize,
}

impl Children {
    fn ranges(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        self.bounds[..=self.count].windows(2).map(|bounds| bounds[0]..bounds[1])
    }
}

/// Cuts a run by the highest digit in which its keys differ, or if they do not into eight parts.
fn children(keys: &[u64], range: Range<usize>) -> Children {
    let mut children = Children { bounds: [range.start; 9], count: 0 };
    let mut add = |end: usize| {
        children.count += 1;
        children.bounds[children.count] = end;
    };
    let differing = keys[range.start] ^ keys[range.end - 1];
    if differing == 0 {
        let size = range.len().div_ceil(8);
        let mut end = range.start;
        while end < range.end {
            end = (end + size).min(range.end);
            add(end);
        }
        return children;
    }
    let shift = differing.ilog2() / 3 * 3;
    let mut start = range.start;
    while start < range.end {
        let digit = keys[start] >> shift;
        start += keys[start..range.end].partition_point(|key| key >> shift <= digit);
        add(start);
    }
    children
}

fn hull(boxes: impl Iterator<Item = [[f32; 3]; 2]>) -> [[f32; 3]; 2] {
    boxes.fold([[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]], |[min, max], [low, high]| {
        [[0, 1, 2].map(|i| min[i].min(low[i])), [0, 1, 2].map(|i| max[i].max(high[i]))]
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use manyview_shaders::cases::Random;
    use manyview_shaders::svo::Svo;

    fn scene() -> SceneTree {
        let cells = (0..8).map(|i| [i & 1, i >> 1 & 1, i >> 2].map(|c: u32| 4 * c));
        SceneTree::new(&Svo::of_cells([-4.0; 3], 8.0, 3, cells), false)
    }

    fn random_views(count: usize, seed: u64) -> Vec<View> {
        let mut random = Random::new(seed);
        let mut vector = |reach: i32| [0; 3].map(|_| random.range(-reach, reach) as f32 / 1000.0);
        (0..count).map(|_| View::new(vector(5000), vector(1000), 1.2)).collect()
    }

    fn tree(views: &[View], sharing: Sharing) -> (SortedViews, ViewTree) {
        let scene = scene();
        let sorted = SortedViews::new(views, &scene);
        let tree = ViewTree::new(views, &sorted.order, &sorted.keys, scene.depth, sharing);
        (sorted, tree)
    }

    /// Every view in exactly one leaf, spheres and cones around what is below, children behind their parents.
    fn validate(views: &[View], sorted: &SortedViews, tree: &ViewTree) {
        let mut seen = vec![0; sorted.order.len()];
        for (index, node) in tree.nodes.iter().enumerate() {
            assert!(!node.is_empty());
            let mut stack = vec![index];
            let mut leaves = 0;
            while let Some(at) = stack.pop() {
                let inner = &tree.nodes[at];
                if !inner.is_leaf() {
                    assert!(inner.range().start > at && inner.len() > 1 && inner.len() <= 8);
                    stack.extend(inner.range());
                    continue;
                }
                leaves += 1;
                for place in inner.range() {
                    seen[place] += u32::from(index == 0);
                    let view = &views[sorted.order[place] as usize];
                    let d = [0, 1, 2].map(|i| view.position[i] - node.center[i]);
                    let distance = d.iter().map(|c| c * c).sum::<f32>().sqrt();
                    assert!(distance <= node.radius * 1.0001 + 1e-5);
                    let (axis, [cosine, _]) = view.cone();
                    if node.cos_psi > -1.0 {
                        let dot = (0..3).map(|i| axis[i] * node.axis[i]).sum::<f32>().clamp(-1.0, 1.0);
                        assert!(dot.acos() + cosine.acos() <= node.cos_psi.acos() + 2e-3);
                    }
                }
            }
            assert_eq!(leaves, tree.leaves_below[index]);
        }
        assert!(seen.iter().all(|&count| count == 1));
    }

    #[test]
    fn every_view_is_in_one_leaf_and_nodes_enclose_what_they_hold() {
        for count in [1, 2, 9, 500] {
            for sharing in [Sharing::Voxel, Sharing::None] {
                let views = random_views(count, count as u64);
                let (sorted, tree) = tree(&views, sharing);
                validate(&views, &sorted, &tree);
                assert!(sharing == Sharing::Voxel || tree.leaf_count() == count);
                assert!(tree.nodes.len() < 2 * count);
            }
        }
    }

    #[test]
    fn views_of_a_voxel_share_a_leaf() {
        let views: Vec<View> = (0..100).map(|i| View::around([0.1 + i as f32 * 0.005, 0.3, 0.2])).collect();
        let (_, shared) = tree(&views, Sharing::Voxel);
        assert_eq!((shared.nodes.len(), shared.leaf_count()), (1, 1));
        assert!((shared.nodes[0].radius - 0.2475).abs() < 1e-4 && shared.nodes[0].cos_psi == -1.0);
        let (_, single) = tree(&views, Sharing::None);
        assert_eq!(single.leaf_count(), 100);
    }

    #[test]
    fn views_at_one_point_make_no_deep_tree() {
        let views = vec![View::around([1.0, 1.0, 1.0]); 20_000];
        let (sorted, tree) = tree(&views, Sharing::Voxel);
        validate(&views[..], &sorted, &tree);
        assert_eq!((tree.leaf_count(), tree.height()), (8, 2), "eight leaves of 2500");
    }

    #[test]
    fn what_cannot_be_drawn_is_left_out_and_keys_keep_to_the_cube() {
        let scene = scene();
        let far = View::around([1e9, -1e9, 0.0]);
        let views = [View::around([f32::NAN, 0.0, 0.0]), far, View::around([0.0, f32::INFINITY, 0.0])];
        let sorted = SortedViews::new(&views, &scene);
        assert_eq!(sorted.order, [1]);
        assert_eq!(morton_key([-4.0; 3], &scene), 0);
        assert_eq!(morton_key([4.0; 3], &scene), (1 << 39) - 1);
        assert_eq!(morton_key([3.9999, -4.0, -4.0], &scene), 0o1111111111111);
    }
}
