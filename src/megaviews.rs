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
//! | §3.4 fusion, unfused queries | [`crate::views::splat::TexelDirections::fuse`], [`UnfusedMaps`] |
//! | §3.5 multi-pass | [`MegaViews`]: runs of the hierarchy's leaves |

pub mod gpu;
mod traverse;
mod unfused;
pub mod view_tree;

use crate::simd::SimdLevel;
use crate::views::splat::TexelDirections;
use crate::views::{Depths, PassSink, View, ViewError, ViewMaps, ViewRenderer, ViewSettings};
use half::f16;
use manyview_shaders::mega_views::NO_NUMBER;
use manyview_shaders::paraboloid::texel_count;
use manyview_shaders::scene_tree::{NodeRef, SceneTree};
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;
use traverse::{Counters, DepthsMut, Output, Traversal};
use view_tree::{SortedViews, ViewTree};

pub use unfused::UnfusedMaps;
pub use view_tree::Sharing;

/// Bytes that a view takes beside its map: key, order, its share of the hierarchy while that is built.
const BYTES_PER_VIEW: u64 = 200;
/// Levels of a view hierarchy for which every thread may have a map on its way down.
const MAPS_PER_THREAD: u64 = 24;

/// MegaViews on all threads of the CPU.
#[derive(Debug, Clone)]
pub struct MegaViews {
    scene: Arc<SceneTree>,
    sharing: Sharing,
    simd: SimdLevel,
}

impl MegaViews {
    /// Draws a scene.
    pub fn new(scene: Arc<SceneTree>) -> Self {
        Self { scene, sharing: Sharing::default(), simd: SimdLevel::detect() }
    }

    /// Chooses which views share a map.
    #[must_use]
    pub fn with_sharing(self, sharing: Sharing) -> Self {
        Self { sharing, ..self }
    }

    /// Keeps to these vector instructions, if the CPU has them; the maps are the same.
    #[must_use]
    pub fn with_simd(self, simd: SimdLevel) -> Self {
        Self { simd, ..self }
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
        self.render_counted(views, settings, sink).map(|_| ())
    }
}

/// What drawing came to.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct DrawStats {
    /// Views that were drawn.
    pub views: u64,
    /// Nodes of the view hierarchy, once a pass that they are in.
    pub view_nodes: u64,
    /// Scene nodes drawn as points.
    pub points: u64,
    /// Leaves drawn as what they are.
    pub near_leaves: u64,
    /// Views that a drawn node is drawn for, on average: the sharing factor.
    pub sharing: f64,
    /// Sorting views and building their hierarchy.
    pub hierarchy_seconds: f64,
    /// Culling, subdivision and drawing: time of all threads together.
    pub draw_seconds: f64,
    /// Handing maps down: time of all threads together.
    pub fuse_seconds: f64,
}

impl MegaViews {
    /// As [`ViewRenderer::render_passes`], and says what it came to.
    pub fn render_counted(
        &self,
        views: &[View],
        settings: &ViewSettings,
        sink: &mut PassSink<'_>,
    ) -> Result<DrawStats, ViewError> {
        settings.check()?;
        let clock = Instant::now();
        if settings.with_colors && self.scene.colors.is_empty() {
            let problem = "was given a scene without colours; load it with them";
            return Err(ViewError::Unsupported { method: "megaviews", problem });
        }
        let texels = TexelDirections::new(settings.resolution);
        let sorted = SortedViews::new(views, &self.scene);
        let undrawable = undrawable(views);
        if !undrawable.is_empty() {
            sink(ViewMaps::without_maps(settings, undrawable))?;
        }
        if sorted.order.is_empty() {
            return Ok(DrawStats::default());
        }
        let leaves_per_pass = leaves_per_pass(views.len(), settings)?;
        let tree = ViewTree::new(views, &sorted.order, &sorted.keys, self.scene.depth, self.sharing);
        let leaves = leaves_depth_first(&tree);
        let hierarchy_seconds = clock.elapsed().as_secs_f64();
        let counters = Counters::default();
        let frame =
            Frame { tree: &tree, order: &sorted.order, settings, texels: &texels, counters: &counters };
        for (pass, leaves) in leaves.chunks(leaves_per_pass).enumerate() {
            sink(self.pass(&frame, leaves, pass * leaves_per_pass))?;
        }
        Ok(counters.stats(sorted.order.len() as u64, hierarchy_seconds))
    }
}

impl Counters {
    fn stats(&self, views: u64, hierarchy_seconds: f64) -> DrawStats {
        let [view_nodes, points, near_leaves, drawn_for_views, draw, fuse] = [
            &self.view_nodes,
            &self.points,
            &self.near_leaves,
            &self.drawn_for_views,
            &self.draw_nanoseconds,
            &self.fuse_nanoseconds,
        ]
        .map(|counter| counter.load(Ordering::Relaxed));
        DrawStats {
            views,
            view_nodes,
            points,
            near_leaves,
            sharing: drawn_for_views as f64 / (points + near_leaves).max(1) as f64,
            hierarchy_seconds,
            draw_seconds: draw as f64 * 1e-9,
            fuse_seconds: fuse as f64 * 1e-9,
        }
    }
}

fn undrawable(views: &[View]) -> Vec<u32> {
    (0u32..).zip(views).filter(|(_, view)| !view.is_drawable()).map(|(i, _)| i).collect()
}

/// What the passes of one drawing have in common.
#[derive(Clone, Copy)]
struct Frame<'a> {
    tree: &'a ViewTree,
    order: &'a [u32],
    settings: &'a ViewSettings,
    texels: &'a TexelDirections,
    counters: &'a Counters,
}

/// How many maps fit the budget at once.
fn leaves_per_pass(views: usize, settings: &ViewSettings) -> Result<usize, ViewError> {
    let texels = texel_count(settings.resolution) as u64;
    let node_numbers = if settings.with_colors { 4 * texels } else { 0 };
    let map_bytes = settings.map_bytes() + node_numbers;
    let scratch_bytes = rayon::current_num_threads() as u64 * MAPS_PER_THREAD * (4 * texels + node_numbers);
    let fixed_bytes = views as u64 * BYTES_PER_VIEW + scratch_bytes;
    match settings.budget_bytes.saturating_sub(fixed_bytes) / map_bytes {
        0 => Err(settings.over_budget("the hierarchy of the views and one map", fixed_bytes + map_bytes)),
        fit => Ok(usize::try_from(fit).unwrap_or(usize::MAX)),
    }
}

impl MegaViews {
    fn traversal<'a>(
        &'a self,
        views: &'a ViewTree,
        settings: &ViewSettings,
        texels: &'a TexelDirections,
        counters: &'a Counters,
        leaves: Range<usize>,
    ) -> Traversal<'a> {
        Traversal {
            scene: &self.scene,
            views,
            texels,
            scale: settings.scale(),
            culling: settings.culling,
            with_nodes: settings.with_colors,
            simd: self.simd,
            leaves,
            counters,
        }
    }

    /// The maps of a run of the hierarchy's leaves, of which the first is number `first`.
    fn pass(&self, frame: &Frame<'_>, leaves: &[u32], first: usize) -> ViewMaps {
        let Frame { tree, order, settings, texels, counters } = *frame;
        let count = leaves.len() * texel_count(settings.resolution);
        let mut nodes = vec![NO_NUMBER; if settings.with_colors { count } else { 0 }];
        let run = first..first + leaves.len();
        let traversal = self.traversal(tree, settings, texels, counters, run);
        let depths = if settings.half_depths {
            let mut depths = vec![f16::ZERO; count];
            traversal.run(Output { depths: DepthsMut::Half(&mut depths), nodes: &mut nodes });
            Depths::Half(depths)
        } else {
            let mut depths = vec![0.0; count];
            traversal.run(Output { depths: DepthsMut::Full(&mut depths), nodes: &mut nodes });
            Depths::Full(depths)
        };
        let colors = colors(&self.scene, &nodes);
        let (mut views, mut map_of) = (Vec::new(), Vec::new());
        let mut centers = Vec::with_capacity(leaves.len());
        for &leaf in leaves {
            let node = &tree.nodes[leaf as usize];
            views.extend_from_slice(&order[node.range()]);
            map_of.resize(views.len(), centers.len() as u32);
            centers.push(node.center);
        }
        ViewMaps::from_parts(settings.resolution, views, map_of, centers, depths, colors)
    }
}

/// The colours of scene nodes that texels show.
fn colors(scene: &SceneTree, numbers: &[u32]) -> Vec<[u8; 4]> {
    let color = |&number: &u32| match number {
        NO_NUMBER => [0; 4],
        number => scene.colors[scene.color_index(NodeRef(number))],
    };
    numbers.iter().map(color).collect()
}

/// Indices of the leaves, which have the maps, in the order of a walk depth first.
fn leaves_depth_first(tree: &ViewTree) -> Vec<u32> {
    let mut leaves = Vec::with_capacity(tree.leaf_count());
    let mut stack = vec![0];
    while let Some(index) = stack.pop() {
        let node = &tree.nodes[index];
        if node.is_leaf() {
            leaves.push(index as u32);
        } else {
            stack.extend(node.range().rev());
        }
    }
    leaves
}

#[cfg(test)]
mod tests;
