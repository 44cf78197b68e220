//! MegaViews: a million views that share work.
//!
//! # Theory
//! T. R. Kol, P. Bauszat, S. Lee, E. Eisemann, *MegaViews: Scalable Many-View Rendering With Concurrent Scene-View
//! Hierarchy Traversal*, Computer Graphics Forum 2018, doi 10.1111/cgf.13527. What looks the same from many views is
//! drawn once for all of them: a hierarchy over the views is walked together with the scene's, and a scene node that fills
//! a texel for all views of a view node is drawn into that node's map. Maps of inner nodes are then handed down.
//!
//! | section | where |
//! |---|---|
//! | §3.1 view hierarchy | [`view_tree`] |
//! | §3.2 image | [`manyview_shaders::paraboloid`] |
//! | §3.3 traversal | `traverse.rs` (CPU), tests in [`manyview_shaders::views`] |
//! | §3.3 near geometry | [`crate::views::splat`] |
//! | §3.4 fusion | [`crate::views::splat::TexelDirections::fuse`] |
//! | §3.5 multi-pass | [`MegaViews`] |

pub mod gpu;
mod traverse;
pub mod view_tree;

use crate::views::splat::TexelDirections;
use crate::views::{Depths, PassSink, View, ViewError, ViewMaps, ViewRenderer, ViewSettings};
use half::f16;
use manyview_shaders::paraboloid::texel_count;
use manyview_shaders::scene_tree::{NodeRef, SceneTree};
use std::sync::Arc;
use traverse::{DepthsMut, Output, Traversal};
use view_tree::{SortedViews, ViewTree};

pub use view_tree::Sharing;

/// Bytes that a view takes beside its map: key, order, its share of the hierarchy and of the scratch while it is built.
const BYTES_PER_VIEW: u64 = 200;
/// Fewest views of a pass that is not the only one, if the budget allows: smaller ones share too little.
const FEWEST_VIEWS: u64 = 1;

/// MegaViews on all threads of the CPU.
#[derive(Debug, Clone)]
pub struct MegaViews {
    scene: Arc<SceneTree>,
    sharing: Sharing,
}

impl MegaViews {
    /// Draws a scene.
    pub fn new(scene: Arc<SceneTree>) -> Self {
        Self { scene, sharing: Sharing::default() }
    }

    /// Chooses which views share a map.
    #[must_use]
    pub fn with_sharing(self, sharing: Sharing) -> Self {
        Self { sharing, ..self }
    }

    /// The scene.
    pub fn scene(&self) -> &SceneTree {
        &self.scene
    }
}

impl ViewRenderer for MegaViews {
    fn name(&self) -> &'static str {
        "megaviews"
    }

    fn render_passes(
        &self,
        views: &[View],
        settings: &ViewSettings,
        sink: &mut PassSink<'_>,
    ) -> Result<(), ViewError> {
        settings.check()?;
        if settings.with_colors && self.scene.colors.is_empty() {
            let problem = "was given a scene without colours; load it with them";
            return Err(ViewError::Unsupported { method: "megaviews", problem });
        }
        let texels = TexelDirections::new(settings.resolution);
        let sorted = SortedViews::new(views, &self.scene);
        let undrawable = undrawable(views);
        if !undrawable.is_empty() {
            let count = undrawable.len();
            let mut pass = ViewMaps::new(settings);
            let none = vec![ViewMaps::NO_MAP; count];
            let empty = pass.depths().clone();
            pass = ViewMaps::from_parts(settings.resolution, undrawable, none, Vec::new(), empty, Vec::new());
            sink(pass)?;
        }
        let run = self.views_per_pass(settings)?;
        let runs = sorted.order.chunks(run).zip(sorted.keys.chunks(run));
        for (order, keys) in runs {
            let tree = ViewTree::new(views, order, keys, self.scene.depth, self.sharing);
            sink(self.pass(&tree, order, settings, &texels))?;
        }
        Ok(())
    }
}

fn undrawable(views: &[View]) -> Vec<u32> {
    (0u32..).zip(views).filter(|(_, view)| !view.is_drawable()).map(|(i, _)| i).collect()
}

impl MegaViews {
    /// How many views fit the budget at once, if none shares its map.
    fn views_per_pass(&self, settings: &ViewSettings) -> Result<usize, ViewError> {
        let texels = texel_count(settings.resolution) as u64;
        let nodes = if settings.with_colors { 4 * texels } else { 0 };
        let view_bytes = settings.map_bytes() + nodes + BYTES_PER_VIEW;
        // Maps on the way down, in every thread.
        let scratch = rayon::current_num_threads() as u64 * 24 * (4 * texels + nodes);
        let fit = settings.budget_bytes.saturating_sub(scratch) / view_bytes;
        if fit < FEWEST_VIEWS {
            let needed_bytes = scratch + view_bytes * FEWEST_VIEWS;
            let (budget_bytes, what) = (settings.budget_bytes, "one view");
            return Err(ViewError::Budget { budget_bytes, what, needed_bytes });
        }
        Ok(usize::try_from(fit).unwrap_or(usize::MAX))
    }

    fn pass(
        &self,
        tree: &ViewTree,
        order: &[u32],
        settings: &ViewSettings,
        texels: &TexelDirections,
    ) -> ViewMaps {
        let count = tree.leaf_count() * texel_count(settings.resolution);
        let mut nodes = vec![u32::MAX; if settings.with_colors { count } else { 0 }];
        let traversal = Traversal {
            scene: &self.scene,
            views: tree,
            texels,
            scale: settings.resolution as f32 / settings.texels,
            culling: settings.culling,
            with_nodes: settings.with_colors,
        };
        let depths = if settings.half_depths {
            let mut depths = vec![f16::ZERO; count];
            traversal.run(Output { depths: DepthsMut::Half(&mut depths), nodes: &mut nodes });
            Depths::Half(depths)
        } else {
            let mut depths = vec![0.0; count];
            traversal.run(Output { depths: DepthsMut::Full(&mut depths), nodes: &mut nodes });
            Depths::Full(depths)
        };
        let color = |&node: &u32| match node {
            u32::MAX => [0; 4],
            node => self.scene.colors[self.scene.color_index(NodeRef(node))],
        };
        let colors = nodes.iter().map(color).collect();
        let (map_of, centers) = leaf_maps(tree, order.len());
        ViewMaps::from_parts(settings.resolution, order.to_vec(), map_of, centers, depths, colors)
    }
}

/// For each place of a run the map of its leaf, and the middles of all maps: in the order of a walk depth first.
fn leaf_maps(tree: &ViewTree, places: usize) -> (Vec<u32>, Vec<[f32; 3]>) {
    let mut map_of = vec![ViewMaps::NO_MAP; places];
    let mut centers = Vec::with_capacity(tree.leaf_count());
    let mut stack = vec![0];
    while let Some(index) = stack.pop() {
        let node = &tree.nodes[index];
        if node.is_leaf() {
            map_of[node.range()].fill(centers.len() as u32);
            centers.push(node.center);
        } else {
            stack.extend(node.range().rev());
        }
    }
    (map_of, centers)
}
