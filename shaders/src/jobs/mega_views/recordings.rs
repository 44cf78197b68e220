//! What a pass records: its hierarchy, its traversal and its maps.

use super::MegaViewsDevice;
use crate::executor::{Binding, Recording};
use crate::mega_views::{KEY_LEVELS, MOST_SHARED, MOST_TREE_LEVELS, tree};
use crate::stages;

impl MegaViewsDevice<'_> {
    pub(super) fn record_hierarchy(&self, levels: usize) -> [(&'static str, Recording<'static>); 2] {
        let [scene, pass, head, keys, ranges, sums, nodes, links, views, boxes] = self.bindings([
            "scene parameters",
            "pass parameters",
            "view hierarchy",
            "sorted keys",
            "ranges",
            "sums of chunks",
            "view nodes",
            "links",
            "sorted views",
            "boxes",
        ]);
        let arguments = self.kept("view hierarchy");
        let at = |level: usize| (tree::ARGUMENTS + level * tree::LEVEL_ARGUMENTS) as u32;
        let mut cut = Recording::new();
        for level in 0..levels {
            let bindings = [scene, pass, head, keys, ranges, sums];
            cut.dispatch_indirect(&stages::tree_count, arguments, at(level), &bindings);
            cut.dispatch(&stages::tree_scan, [1; 3], &[pass, head, sums]);
            let bindings = [scene, pass, head, keys, sums, ranges, nodes, links];
            cut.dispatch_indirect(&stages::tree_emit, arguments, at(level), &bindings);
        }
        let mut merge = Recording::new();
        for level in (0..levels).rev() {
            let bindings = [pass, self.levels[level].into(), head, views, nodes, boxes];
            merge.dispatch_indirect(&stages::tree_merge, arguments, at(level) + 3, &bindings);
        }
        [("cut views", cut), ("merge views", merge)]
    }

    /// The walk that draws depths, and if wanted the one that draws numbers.
    pub(super) fn record_traversal(
        &self,
        steps: usize,
        with_numbers: bool,
    ) -> Vec<(&'static str, Recording<'static>)> {
        let [pass, of_numbers, head, counters, pairs, maps] = self.bindings([
            "pass parameters",
            "parameters of numbers",
            "view hierarchy",
            "counters",
            "pairs",
            "maps",
        ]);
        let mut clear = Recording::new();
        let of_nodes = tree::NODE_ARGUMENTS as u32;
        clear.dispatch_indirect(
            &stages::maps_clear,
            self.kept("view hierarchy"),
            of_nodes,
            &[pass, head, maps],
        );
        let mut parts = vec![
            ("clear maps", clear),
            ("traverse", self.walk(pass, steps)),
            ("near leaves", self.near(pass)),
        ];
        if with_numbers {
            let mut walk = Recording::new();
            walk.dispatch(&stages::pairs_restart, [1; 3], &[counters, pairs]);
            walk.append(self.walk(of_numbers, steps));
            parts.extend([("traverse again", walk), ("near leaves again", self.near(of_numbers))]);
        }
        parts
    }

    fn walk(&self, pass: Binding, steps: usize) -> Recording<'static> {
        let [scene, head, links, places, nodes, counters, near, maps] = self.bindings([
            "scene parameters",
            "view hierarchy",
            "scene nodes",
            "scene places",
            "view nodes",
            "counters",
            "near pairs",
            "maps",
        ]);
        let mut queues: [Binding; 2] = self.bindings(["pairs", "queued pairs"]);
        let arguments = self.kept("arguments");
        let mut walk = Recording::new();
        let prepare = [pass, head, counters, arguments.into()];
        for _ in 0..steps {
            walk.dispatch(&stages::pairs_prepare, [1; 3], &prepare);
            let bindings = [scene, pass, links, places, nodes, queues[0], counters, queues[1], near, maps];
            walk.dispatch_indirect(&stages::pairs_step, arguments, 0, &bindings);
            queues.swap(0, 1);
        }
        walk.dispatch(&stages::pairs_prepare, [1; 3], &prepare);
        walk
    }

    fn near(&self, pass: Binding) -> Recording<'static> {
        let [scene, places, nodes, counters, near, maps] = self.bindings([
            "scene parameters",
            "scene places",
            "view nodes",
            "counters",
            "near pairs",
            "maps",
        ]);
        let mut leaves = Recording::new();
        let bindings = [scene, pass, places, nodes, counters, near, maps];
        leaves.dispatch_indirect(&stages::pairs_near, self.kept("arguments"), 3, &bindings);
        leaves
    }

    pub(super) fn record_maps(&self, levels: usize) -> [(&'static str, Recording<'static>); 2] {
        let [pass, head, nodes, links, maps, packed] =
            self.bindings(["pass parameters", "view hierarchy", "view nodes", "links", "maps", "leaf maps"]);
        let arguments = self.kept("view hierarchy");
        let mut fuse = Recording::new();
        for level in 1..levels {
            let at = (tree::ARGUMENTS + level * tree::LEVEL_ARGUMENTS + 6) as u32;
            let bindings = [pass, self.levels[level].into(), head, nodes, links, maps];
            fuse.dispatch_indirect(&stages::maps_fuse, arguments, at, &bindings);
        }
        let mut pack = Recording::new();
        let bindings = [pass, head, links, maps, packed];
        pack.dispatch_indirect(&stages::maps_pack, arguments, tree::LEAF_ARGUMENTS as u32, &bindings);
        [("fuse", fuse), ("pack", pack)]
    }
}

/// Most levels that the hierarchy over so many views can have: one for each octal digit, then eighths of views in one
/// place, and the leaves.
pub(super) fn most_levels(views: u32, sharing: bool) -> usize {
    let mut eighths = 0;
    let mut views = if sharing { views.div_ceil(MOST_SHARED) } else { views };
    while views > 1 {
        views = views.div_ceil(8);
        eighths += 1;
    }
    (KEY_LEVELS as usize + eighths + 1).min(MOST_TREE_LEVELS)
}

/// The buffer `view hierarchy` with a root that is to be cut.
pub(super) fn first_node(slices: u32) -> [u32; tree::WORDS] {
    let mut words = [0; tree::WORDS];
    words[tree::NODES] = 1;
    words[tree::STARTS + 1] = 1;
    for at in [tree::ARGUMENTS, tree::ARGUMENTS + 3] {
        words[at..at + 3].fill(1);
    }
    for at in [tree::ARGUMENTS + 6, tree::NODE_ARGUMENTS] {
        words[at..at + 3].copy_from_slice(&[1, 1, slices]);
    }
    words
}
