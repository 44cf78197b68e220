//! A binary bounding volume hierarchy over boxes that move.

use glam::{DVec3, Vec3};

/// What became of the hierarchy when boxes moved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TreeUpdate {
    /// Its boxes were fitted to the new bounds.
    Refitted,
    /// It was built anew.
    Rebuilt,
}

/// An axis-aligned box in world space, rounded outwards.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bounds {
    min: Vec3,
    max: Vec3,
}

impl Bounds {
    pub(super) const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    /// The smallest such box around two corners.
    pub(super) fn around(min: DVec3, max: DVec3) -> Self {
        let down = |v: f64| (v as f32).next_down();
        let up = |v: f64| (v as f32).next_up();
        Self {
            min: Vec3::from_array(min.to_array().map(down)),
            max: Vec3::from_array(max.to_array().map(up)),
        }
    }

    pub(super) fn union(&self, other: &Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    pub(super) fn diagonal(&self) -> f32 {
        (self.max - self.min).length()
    }

    fn center(&self) -> Vec3 {
        self.min * 0.5 + self.max * 0.5
    }

    fn half_area(&self) -> f32 {
        let size = (self.max - self.min).max(Vec3::ZERO);
        size.x * size.y + size.y * size.z + size.z * size.x
    }
}

/// A node: its left child follows it.
#[derive(Debug, Clone, Copy)]
struct Node {
    bounds: Bounds,
    /// The right child, or of a leaf the first of its items.
    next: u32,
    /// Items of a leaf; 0 for an inner node.
    count: u32,
}

/// The hierarchy.
#[derive(Debug, Default)]
pub(super) struct Tree {
    nodes: Vec<Node>,
    items: Vec<u32>,
    /// Sum of the inner nodes' areas over the root's when it was built: what a segment costs.
    built_cost: f32,
}

const LEAF_ITEMS: usize = 2;
const BINS: usize = 12;
/// The hierarchy is built anew once segments cost this many times more than at first.
const WORST_COST: f32 = 1.6;

impl Tree {
    /// A hierarchy over the boxes of `items`, which index `bounds`.
    pub(super) fn new(items: Vec<u32>, bounds: &[Bounds]) -> Self {
        let mut tree = Self { nodes: Vec::with_capacity(items.len()), items, built_cost: 0.0 };
        let count = tree.items.len();
        if count > 0 {
            let mut items = std::mem::take(&mut tree.items);
            tree.build(&mut items, 0, bounds);
            tree.items = items;
            tree.built_cost = tree.cost();
        }
        tree
    }

    pub(super) fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    fn build(&mut self, items: &mut [u32], first: usize, bounds: &[Bounds]) {
        let all = items.iter().fold(Bounds::EMPTY, |all, &item| all.union(&bounds[item as usize]));
        let node = self.nodes.len();
        self.nodes.push(Node { bounds: all, next: first as u32, count: items.len() as u32 });
        if items.len() <= LEAF_ITEMS {
            return;
        }
        let middle = split(items, bounds);
        let (left, right) = items.split_at_mut(middle);
        self.build(left, first, bounds);
        let right_node = self.nodes.len() as u32;
        self.build(right, first + middle, bounds);
        self.nodes[node] = Node { bounds: all, next: right_node, count: 0 };
    }

    /// Fits the boxes to new ones, or says that the hierarchy has to be built anew.
    pub(super) fn refit(&mut self, bounds_of: impl Fn(u32) -> Bounds) -> TreeUpdate {
        for index in (0..self.nodes.len()).rev() {
            let node = self.nodes[index];
            self.nodes[index].bounds = if node.count > 0 {
                let items = &self.items[node.next as usize..(node.next + node.count) as usize];
                items.iter().fold(Bounds::EMPTY, |all, &item| all.union(&bounds_of(item)))
            } else {
                self.nodes[index + 1].bounds.union(&self.nodes[node.next as usize].bounds)
            };
        }
        // Written so that a cost that is not a number rebuilds too.
        if self.is_empty() || self.cost() <= self.built_cost * WORST_COST {
            TreeUpdate::Refitted
        } else {
            TreeUpdate::Rebuilt
        }
    }

    fn cost(&self) -> f32 {
        let root = self.nodes[0].bounds.half_area().max(f32::MIN_POSITIVE);
        self.nodes.iter().map(|node| node.bounds.half_area() / root).sum()
    }

    /// The items whose boxes a segment goes through, with the share of its way where it enters, nearest first.
    pub(super) fn candidates(&self, origin: DVec3, target: DVec3, stack: &mut Vec<u32>) -> Vec<(f64, u32)> {
        let way = target - origin;
        let inverse = way.recip();
        let mut found = Vec::new();
        stack.clear();
        if !self.nodes.is_empty() {
            stack.push(0);
        }
        while let Some(index) = stack.pop() {
            let node = &self.nodes[index as usize];
            let Some(enter) = enters(&node.bounds, origin, way, inverse) else { continue };
            if node.count == 0 {
                stack.push(node.next);
                stack.push(index + 1);
                continue;
            }
            // The boxes of a leaf's few items are not kept: each is clipped exactly later.
            let items = &self.items[node.next as usize..(node.next + node.count) as usize];
            found.extend(items.iter().map(|&item| (enter, item)));
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        found
    }
}

fn enters(bounds: &Bounds, origin: DVec3, way: DVec3, inverse: DVec3) -> Option<f64> {
    let (min, max) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
    let (mut enter, mut leave) = (0.0f64, 1.0f64);
    for axis in 0..3 {
        if way[axis] == 0.0 {
            if origin[axis] < min[axis] || origin[axis] > max[axis] {
                return None;
            }
            continue;
        }
        let (a, b) = ((min[axis] - origin[axis]) * inverse[axis], (max[axis] - origin[axis]) * inverse[axis]);
        (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
    }
    (enter <= leave).then_some(enter)
}

/// Orders items so that the first ones go left, and returns how many: where the areas of both sides, weighed by their
/// items, are least over bins of all three axes.
fn split(items: &mut [u32], bounds: &[Bounds]) -> usize {
    let centers = items.iter().map(|&item| bounds[item as usize].center());
    let (low, high) = centers.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), c| (l.min(c), h.max(c)));
    let bin_of = |item: u32, axis: usize| {
        let share = (bounds[item as usize].center()[axis] - low[axis]) / (high[axis] - low[axis]);
        ((share * BINS as f32) as usize).min(BINS - 1)
    };
    let mut best: Option<(f32, usize, usize)> = None;
    for axis in (0..3).filter(|&axis| high[axis] > low[axis]) {
        let mut bins = [(0usize, Bounds::EMPTY); BINS];
        for &item in items.iter() {
            let bin = &mut bins[bin_of(item, axis)];
            *bin = (bin.0 + 1, bin.1.union(&bounds[item as usize]));
        }
        let sum = |a: (usize, Bounds), b: &(usize, Bounds)| (a.0 + b.0, a.1.union(&b.1));
        let mut right = [(0, Bounds::EMPTY); BINS];
        for bin in (0..BINS - 1).rev() {
            right[bin] = sum(right[bin + 1], &bins[bin + 1]);
        }
        let mut left = (0, Bounds::EMPTY);
        for bin in 0..BINS - 1 {
            left = sum(left, &bins[bin]);
            if left.0 == 0 || right[bin].0 == 0 {
                continue;
            }
            let cost = left.0 as f32 * left.1.half_area() + right[bin].0 as f32 * right[bin].1.half_area();
            if best.is_none_or(|(least, ..)| cost < least) {
                best = Some((cost, axis, bin));
            }
        }
    }
    let Some((_, axis, last)) = best else { return items.len() / 2 };
    // A stable order, so that the same boxes always give the same hierarchy.
    items.sort_by_key(|&item| bin_of(item, axis) > last);
    items.partition_point(|&item| bin_of(item, axis) <= last)
}

#[cfg(all(test, feature = "bake"))]
mod tests {
    use super::*;
    use crate::bench::Random;

    fn boxes(count: usize, seed: u64) -> Vec<Bounds> {
        let mut random = Random::new(seed);
        let mut point = || DVec3::new(random.signed(), random.signed(), random.signed());
        (0..count)
            .map(|_| {
                let (center, half) = (point() * 50.0, point().abs() * 5.0);
                Bounds::around(center - half, center + half)
            })
            .collect()
    }

    fn check(tree: &Tree, bounds: &[Bounds]) {
        let mut random = Random::new(9);
        let mut stack = Vec::new();
        let mut hits = 0;
        for case in 0..300 {
            let mut point = || DVec3::new(random.signed(), random.signed(), random.signed()) * 60.0;
            let (origin, mut target) = (point(), point());
            if case % 10 == 0 {
                (target.x, target.y) = (origin.x, origin.y);
            }
            let found = tree.candidates(origin, target, &mut stack);
            assert!(found.is_sorted_by(|a, b| a.0 <= b.0));
            let way = target - origin;
            for (item, bounds) in bounds.iter().enumerate() {
                if enters(bounds, origin, way, way.recip()).is_some() {
                    hits += 1;
                    assert!(found.iter().any(|&(_, found)| found == item as u32), "{item} of case {case}");
                }
            }
        }
        assert!(hits > 100, "{hits}");
    }

    #[test]
    fn no_box_that_a_segment_goes_through_is_missed_before_and_after_moving() {
        let bounds = boxes(1000, 1);
        let mut tree = Tree::new((0..1000).collect(), &bounds);
        check(&tree, &bounds);
        let moved: Vec<_> = bounds
            .iter()
            .map(|b| Bounds {
                min: b.min + Vec3::new(0.5, -0.5, 0.25),
                max: b.max + Vec3::new(0.75, 0.0, 0.25),
            })
            .collect();
        assert_eq!(tree.refit(|item| moved[item as usize]), TreeUpdate::Refitted);
        check(&tree, &moved);
        let elsewhere = boxes(1000, 2);
        assert_eq!(tree.refit(|item| elsewhere[item as usize]), TreeUpdate::Rebuilt);
        check(&tree, &elsewhere);
    }

    #[test]
    fn boxes_in_one_place_and_no_boxes_are_fine() {
        let bounds = vec![Bounds::around(DVec3::ZERO, DVec3::ONE); 500];
        let tree = Tree::new((0..500).collect(), &bounds);
        let found = tree.candidates(DVec3::splat(-1.0), DVec3::splat(2.0), &mut Vec::new());
        assert_eq!(found.len(), 500);
        let mut none = Tree::new(Vec::new(), &[]);
        assert!(none.is_empty() && none.candidates(DVec3::ZERO, DVec3::ONE, &mut Vec::new()).is_empty());
        assert_eq!(none.refit(|_| Bounds::EMPTY), TreeUpdate::Refitted);
    }
}
