//! What the twins of MegaViews' stages share, as `lib_grid.wgsl` and `lib_view_tree.wgsl` do.

use crate::constants::{MAX_WORKGROUPS, TREE_CHUNK};
use crate::mega_views::{KEY_LEVELS, MOST_SHARED, PassParams, SceneParams, tree};
use std::ops::Range;

/// Number of workgroups of rows of [`MAX_WORKGROUPS`].
pub(super) fn flat_groups(workgroups: [u32; 3]) -> u32 {
    if workgroups[0] == MAX_WORKGROUPS { workgroups[0] * workgroups[1] } else { workgroups[0] }
}

/// Workgroups along x and y of `count` in all.
pub(super) fn grid_of(count: u32) -> [u32; 2] {
    [count.min(MAX_WORKGROUPS), count.div_ceil(MAX_WORKGROUPS)]
}

/// The nodes of each chunk of a level.
pub(super) fn chunks(tree: &[u32], level: usize, workgroups: [u32; 3]) -> Vec<Range<u32>> {
    let [start, end] = [tree[tree::STARTS + level], tree[tree::STARTS + level + 1]];
    (0..workgroups[0] * 64)
        .map(|chunk| start + chunk * TREE_CHUNK)
        .take_while(|&first| first < end)
        .map(|first| first..(first + TREE_CHUNK).min(end))
        .collect()
}

/// The keys of a run and how they are cut into nodes.
pub(super) struct Run<'a> {
    pub(super) keys: &'a [[u32; 2]],
    pub(super) depth: u32,
    pub(super) sharing: bool,
}

impl<'a> Run<'a> {
    pub(super) fn new(scene: &SceneParams, pass: &PassParams, keys: &'a [[u32; 2]]) -> Self {
        let keys = &keys[pass.run_start as usize..][..pass.run_count as usize];
        Self { keys, depth: scene.depth, sharing: pass.sharing == 1 }
    }

    fn key(&self, view: u32) -> u64 {
        let [low, high] = self.keys[view as usize];
        u64::from(high) << 30 | u64::from(low)
    }

    /// The children of a range, or `None` for a leaf.
    pub(super) fn children(&self, [start, end]: [u32; 2]) -> Option<Vec<[u32; 2]>> {
        let differing = self.key(start) ^ self.key(end - 1);
        let digit = differing.checked_ilog2().map(|bit| bit / 3);
        let in_voxel = digit.is_none_or(|digit| digit + self.depth < KEY_LEVELS);
        if end - start == 1 || self.sharing && end - start <= MOST_SHARED && in_voxel {
            return None;
        }
        let part = (end - start).div_ceil(8);
        let mut children = Vec::new();
        let mut from = start;
        while from < end {
            let to = match digit {
                None => (from + part).min(end),
                Some(digit) => {
                    let own = self.key(from) >> (3 * digit);
                    (from..end).find(|&view| self.key(view) >> (3 * digit) != own).unwrap_or(end)
                }
            };
            children.push([from, to]);
            from = to;
        }
        Some(children)
    }
}
