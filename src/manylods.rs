//! ManyLoDs: many cuts through one hierarchy.
//!
//! # Theory
//! \[ML\] draws every view from nodes that are just fine enough for it. A pair of a node and a view, a *node-view*, is
//! valid if the node fills less than a texel of the view's map or is outside its field. The *cut* of a view holds the
//! node-views that are valid while their parents are not; those in the field are drawn as points. The cuts of all views are
//! found side by side, either from the root (*basic*) or from the cut of the frame before, from which each entry moves
//! towards the root or away from it (*incremental*), one step a frame if that will do (*lazy*).
//!
//! | type | hierarchy | from |
//! |---|---|---|
//! | [`SvoCuts`] | the octree of a bake | the root, or the last frame's cut ([`CutState`]) |
//! | [`PointCuts`] | points bound to triangles, which may move ([`PointTree`]) | the root, or the last frame's cut ([`PointCutState`]) |
//! | [`SvoCutsGpu`] | the octree | the root, on a GPU or by the stages' twins |
//!
//! It is what [`crate::megaviews`] is measured against: the same octree, maps and tests, but every view starts at the
//! octree's root.
//!
//! # Differences from the paper
//! - A thread takes one view after the other, so that lists name nodes alone and stay in its cache; the paper has one list of
//!   64-bit node-views for all. [`CutStats::paper_list_bytes`] says what those would take. On GPUs lists are the paper's.
//! - A node's children are tested together, in vectors, when it is subdivided. Lists therefore hold only what has to be
//!   subdivided: an eighth to a quarter of the paper's.
//! - A list is worked off from its end in batches, so that its length is bounded however fine the cut.
//! - Leaves that fill more than a texel are drawn as the cubes they are ([`crate::views::splat::Canvas::leaf`]).
//! - In [`CutState`] siblings stand together as one entry of a parent and a mask. The first child's special part in merging is
//!   then no more needed.
//!
//! \[ML\] Holländer, Ritschel, Eisemann, Boubekeur, *ManyLoDs: Parallel Many-View Level-of-Detail Selection for
//! Real-Time Global Illumination*, CGF 30(4), 2011, doi 10.1111/j.1467-8659.2011.01982.x.

mod drawing;
mod gpu;
mod octants;
mod passes;
mod point_cuts;
mod point_tree;
mod state;

pub use gpu::SvoCutsGpu;
pub use point_cuts::{PointCutState, PointCuts};
pub use point_tree::{NormalCone, PointTree, Sample, Sphere};
pub use state::{CutState, Steps};

use crate::views::splat::Canvas;
use crate::views::{PassSink, View, ViewError, ViewRenderer, ViewSettings};
use drawing::{Counts, Lists, basic_cut};
use manyview_shaders::scene_tree::{NodeRef, SceneTree};
use octants::Eye;
use passes::{Plan, draw_passes};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Most node-views that a thread subdivides at a time.
const BATCH: u64 = 4096;

/// What finding cuts took.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CutStats {
    /// Node-views that were drawn.
    pub drawn: u64,
    /// Of those, leaves that fill more than a texel.
    pub near_leaves: u64,
    /// Node-views that were tested.
    pub visited: u64,
    /// Bytes of all lists at their longest, or of a kept cut.
    pub list_bytes: u64,
    /// Bytes of the paper's lists for the same views at once: 8 for each node-view of the longest active list, of the one that
    /// follows it, and of the cut.
    pub paper_list_bytes: u64,
}

impl CutStats {
    fn new(counts: &Counts, list_bytes: u64) -> Self {
        let visited = counts.visited;
        let active = visited.windows(2).map(|pair| pair[0] + pair[1]).max().unwrap_or(0);
        Self {
            drawn: counts.drawn,
            near_leaves: counts.near_leaves,
            visited: visited.iter().sum(),
            list_bytes,
            paper_list_bytes: 8 * (active + counts.drawn),
        }
    }
}

/// Cuts through the octree of a bake: method `manylods`.
#[derive(Debug)]
pub struct SvoCuts {
    tree: Arc<SceneTree>,
    /// Parents of inner nodes, made when first needed.
    parents: OnceLock<Vec<u32>>,
}

impl SvoCuts {
    /// Takes an octree, with colours if maps shall have some.
    pub fn new(tree: Arc<SceneTree>) -> Self {
        Self { tree, parents: OnceLock::new() }
    }

    /// The octree.
    pub fn tree(&self) -> &Arc<SceneTree> {
        &self.tree
    }

    fn check(&self, settings: &ViewSettings) -> Result<(), ViewError> {
        settings.check()?;
        if settings.with_colors && self.tree.colors.is_empty() {
            let problem = "needs an octree with colours to draw some";
            return Err(ViewError::Unsupported { method: "manylods", problem });
        }
        Ok(())
    }

    fn eye(&self, view: &View, settings: &ViewSettings) -> Eye {
        Eye::new(view, settings.scale(), settings.culling)
    }

    fn color(&self, node: u32) -> [u8; 4] {
        self.tree.colors[self.tree.color_index(NodeRef(node))]
    }

    /// [`ViewRenderer::render_passes`], with what it took. Lists are those of all threads together.
    pub fn render_counted(
        &self,
        views: &[View],
        settings: &ViewSettings,
        sink: &mut PassSink<'_>,
    ) -> Result<CutStats, ViewError> {
        self.check(settings)?;
        // From a batch come at most eight times as many on the next level; so much waits on every level.
        let list_bytes = |batch: u64| 4 * batch * (8 * u64::from(self.tree.depth) + 1);
        let plan = Plan::new(settings, [list_bytes(1), list_bytes(BATCH)])?;
        let batch = (plan.list_bytes / list_bytes(1)) as usize;
        let sums = Mutex::new(Counts::default());
        let color_of = |node| self.color(node);
        let draw = |lists: &mut Lists, _, view: &View, canvas: &mut Canvas<'_>| {
            let counts = basic_cut(&self.tree, &self.eye(view, settings), batch, lists, canvas);
            sums.lock().unwrap_or_else(PoisonError::into_inner).add(&counts);
        };
        draw_passes(views, settings, &plan, &color_of, draw, sink)?;
        let counts = sums.into_inner().unwrap_or_else(PoisonError::into_inner);
        let threads = if plan.sequential { 1 } else { rayon::current_num_threads() as u64 };
        Ok(CutStats::new(&counts, 4 * counts.list as u64 * threads.min(views.len() as u64)))
    }

    /// The basic cut of a view without drawing it: its node-views in the order in which they are found. Empty for a view
    /// that cannot be drawn.
    pub fn cut(&self, view: &View, settings: &ViewSettings) -> Vec<NodeRef> {
        let mut nodes = Vec::new();
        if view.is_drawable() {
            let eye = self.eye(view, settings);
            basic_cut(&self.tree, &eye, BATCH as usize, &mut Lists::default(), &mut nodes);
        }
        nodes
    }
}

impl ViewRenderer for SvoCuts {
    fn name(&self) -> &'static str {
        "manylods"
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
