//! Maps of all nodes of a view hierarchy, as they were drawn: queries without fusion.
//!
//! # Theory
//! \[MV\] §3.4: what a view sees in a texel is in its own map or in that of a node above it. Fusion hands maps down once;
//! without it every query walks the hierarchy. The paper found such queries about ten times slower, and they need the maps
//! of all nodes. They are for what asks few texels of many views, and to see what fusion is worth.
//!
//! # Differences from the paper
//! The paper's walk takes the deepest map that shows anything. Here, as in fusion, the nearest distance counts, each corrected
//! for the way between the nodes' middles: a query gives exactly what [`super::MegaViews`] has in its fused maps.

use super::traverse::{Counters, DepthsMut, Output};
use super::view_tree::{SortedViews, ViewTree};
use super::{BYTES_PER_VIEW, MegaViews};
use crate::views::splat::{TexelDirections, moved_depth};
use crate::views::{View, ViewError, ViewSettings};
use manyview_shaders::paraboloid::texel_count;
use std::sync::OnceLock;

/// What views see, asked texel by texel.
#[derive(Debug, Clone)]
pub struct UnfusedMaps {
    texels: TexelDirections,
    nodes: Vec<Node>,
    /// The maps of all nodes, metres.
    depths: Vec<Box<[f32]>>,
    /// For each view the node that has its map, or [`UnfusedMaps::NONE`].
    node_of: Vec<u32>,
}

/// A node of the view hierarchy.
#[derive(Debug, Clone, Copy)]
struct Node {
    parent: u32,
    center: [f32; 3],
}

impl UnfusedMaps {
    /// What the root has above it, and a view without a map.
    const NONE: u32 = u32::MAX;

    /// The distance that view number `view` sees in a texel, metres; +infinity if nothing is there or the view cannot be
    /// drawn.
    pub fn depth(&self, view: usize, texel: usize) -> f32 {
        match self.node_of[view] {
            Self::NONE => f32::INFINITY,
            node => self.depth_of(node as usize, texel),
        }
    }

    fn depth_of(&self, node: usize, texel: usize) -> f32 {
        let own = self.depths[node][texel];
        let Node { parent, center } = self.nodes[node];
        if parent == Self::NONE {
            return own;
        }
        let offset = [0, 1, 2].map(|i| center[i] - self.nodes[parent as usize].center[i]);
        let moved = moved_depth(self.texels.direction(texel), self.depth_of(parent as usize, texel), offset);
        if moved < own { moved } else { own }
    }

    /// Bytes of all maps.
    pub fn bytes(&self) -> u64 {
        self.depths.iter().map(|map| size_of_val::<[f32]>(map) as u64).sum()
    }
}

impl MegaViews {
    /// Draws views without handing maps down. All maps are there at once: there are no passes, no 16-bit depths and no
    /// colours.
    ///
    /// # Errors
    /// [`ViewError::Budget`] if the maps of all nodes of the view hierarchy do not fit.
    pub fn render_unfused(&self, views: &[View], settings: &ViewSettings) -> Result<UnfusedMaps, ViewError> {
        settings.check()?;
        let texels = TexelDirections::new(settings.resolution);
        let sorted = SortedViews::new(views, &self.scene);
        let mut maps = UnfusedMaps {
            texels,
            nodes: vec![],
            depths: vec![],
            node_of: vec![UnfusedMaps::NONE; views.len()],
        };
        if sorted.order.is_empty() {
            return Ok(maps);
        }
        let tree = ViewTree::new(views, &sorted.order, &sorted.keys, self.scene.depth, self.sharing);
        let map_bytes = 4 * texel_count(settings.resolution) as u64;
        let needed_bytes = tree.nodes.len() as u64 * map_bytes + views.len() as u64 * BYTES_PER_VIEW;
        if needed_bytes > settings.budget_bytes {
            return Err(
                settings.over_budget("the maps of all nodes of the hierarchy of the views", needed_bytes)
            );
        }
        let kept: Vec<OnceLock<Box<[f32]>>> = tree.nodes.iter().map(|_| OnceLock::new()).collect();
        let counters = Counters::default();
        let leaves = 0..tree.leaf_count();
        let settings = &ViewSettings { with_colors: false, ..*settings };
        self.traversal(&tree, settings, &maps.texels, &counters, leaves)
            .run(Output { depths: DepthsMut::Unfused(&kept), nodes: &mut [] });
        maps.depths = kept.into_iter().map(|map| map.into_inner().expect("a map of each node")).collect();
        maps.nodes =
            tree.nodes.iter().map(|node| Node { parent: UnfusedMaps::NONE, center: node.center }).collect();
        for (index, node) in (0u32..).zip(&tree.nodes) {
            if node.is_leaf() {
                sorted.order[node.range()].iter().for_each(|&view| maps.node_of[view as usize] = index);
            } else {
                maps.nodes[node.range()].iter_mut().for_each(|child| child.parent = index);
            }
        }
        Ok(maps)
    }
}
