//! Cuts through a hierarchy of points.

use super::drawing::Counts;
use super::octants::Eye;
use super::passes::{Plan, draw_pass, draw_passes};
use super::{BATCH, CutStats, Steps};
use crate::manylods::PointTree;
use crate::views::splat::{Canvas, TexelDirections, candidates};
use crate::views::{PassSink, View, ViewError, ViewMaps, ViewRenderer, ViewSettings};
use glam::Vec3;
use manyview_shaders::paraboloid::is_inside;
use manyview_shaders::scene_tree::SPHERE_OF_CUBE;
use manyview_shaders::views::{is_culled, is_small};
use std::sync::{Mutex, PoisonError};

/// Cuts through points bound to triangles, \[ML\]'s own hierarchy: method `manylods-points`. It draws no colours.
#[derive(Debug)]
pub struct PointCuts {
    tree: PointTree,
}

/// Cuts of some views through a [`PointTree`], kept between frames; it belongs to one tree, which may be updated.
#[derive(Debug, Default)]
pub struct PointCutState {
    views: Vec<Mutex<Vec<u32>>>,
}

impl PointCutState {
    /// Cuts that are the root alone.
    pub fn new() -> Self {
        Self::default()
    }

    /// Bytes of the cuts.
    pub fn bytes(&self) -> u64 {
        let bytes = |cut: &Mutex<Vec<u32>>| {
            size_of::<Mutex<Vec<u32>>>() + 4 * cut.lock().unwrap_or_else(PoisonError::into_inner).capacity()
        };
        self.views.iter().map(bytes).sum::<usize>() as u64
    }
}

/// What became of a node-view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Outcome {
    Culled,
    Small,
    Large,
}

#[derive(Debug, Default)]
struct Lists {
    waiting: Vec<u32>,
    batch: Vec<u32>,
}

impl PointCuts {
    /// Samples triangles of the world by 2^`depth` points. `None` if no triangle has an area, or `depth` exceeds 26.
    pub fn new(triangles: &[[Vec3; 3]], depth: u32, seed: u64) -> Option<Self> {
        PointTree::new(triangles, depth, seed).map(|tree| Self { tree })
    }

    /// The hierarchy.
    pub fn tree(&self) -> &PointTree {
        &self.tree
    }

    /// Follows triangles that have moved: once a frame, whatever the number of views.
    pub fn update(&mut self, triangles: &[[Vec3; 3]]) {
        self.tree.update(triangles);
    }

    fn test(&self, node: u32, eye: &Eye) -> Outcome {
        let (offset, length, radius) = self.seen(node, eye);
        if is_culled(offset, length, radius, &eye.view) {
            Outcome::Culled
        } else if is_small(offset, length, radius, 0.0, eye.scale) {
            Outcome::Small
        } else {
            Outcome::Large
        }
    }

    #[inline]
    fn seen(&self, node: u32, eye: &Eye) -> ([f32; 3], f32, f32) {
        let sphere = self.tree.spheres()[node as usize];
        let offset = sphere.center - Vec3::from_array(eye.view.center);
        (offset.to_array(), offset.length(), sphere.radius)
    }

    fn is_leaf(&self, node: u32) -> bool {
        node as usize >= self.tree.len()
    }

    fn draw(&self, node: u32, outcome: Outcome, eye: &Eye, canvas: &mut Canvas<'_>, counts: &mut Counts) {
        if outcome == Outcome::Culled {
            return;
        }
        counts.drawn += 1;
        let (offset, length, radius) = self.seen(node, eye);
        canvas.point(offset, node);
        if outcome == Outcome::Large && length > radius {
            counts.near_leaves += 1;
            disc(offset, length, radius, canvas);
        }
    }

    fn basic(&self, eye: &Eye, batch: usize, lists: &mut Lists, canvas: &mut Canvas<'_>) -> Counts {
        let mut counts = Counts::default();
        self.walk(eye, batch, lists, &mut counts, |node, outcome, counts| {
            self.draw(node, outcome, eye, canvas, counts);
        });
        counts
    }

    /// The basic cut.
    fn walk(
        &self,
        eye: &Eye,
        batch: usize,
        lists: &mut Lists,
        counts: &mut Counts,
        mut keep: impl FnMut(u32, Outcome, &mut Counts),
    ) {
        let Lists { waiting, batch: taken } = lists;
        waiting.clear();
        waiting.push(1);
        while !waiting.is_empty() {
            taken.clear();
            taken.extend_from_slice(&waiting[waiting.len().saturating_sub(batch)..]);
            waiting.truncate(waiting.len() - taken.len());
            counts.visit(taken.len());
            for &node in taken.iter() {
                match self.test(node, eye) {
                    Outcome::Large if !self.is_leaf(node) => waiting.extend([2 * node, 2 * node + 1]),
                    outcome => keep(node, outcome, counts),
                }
            }
            counts.list = counts.list.max(waiting.len() + taken.len());
        }
    }

    /// The basic cut of one view: its nodes, culled ones left out.
    pub fn cut(&self, view: &View, settings: &ViewSettings) -> Vec<u32> {
        let mut nodes = Vec::new();
        if view.is_drawable() {
            let (mut lists, mut counts) = (Lists::default(), Counts::default());
            self.walk(&eye(view, settings), BATCH as usize, &mut lists, &mut counts, |node, outcome, _| {
                if outcome != Outcome::Culled {
                    nodes.push(node);
                }
            });
        }
        nodes
    }

    /// Moves a kept cut by at most `steps` edges an entry. It stays in depth-first order, so that what a merged
    /// node holds comes right behind.
    fn advance(
        &self,
        cut: &mut Vec<u32>,
        spare: &mut Vec<u32>,
        eye: &Eye,
        steps: u32,
        mut keep: impl FnMut(u32, Outcome),
    ) -> u64 {
        let (mut visited, mut at) = (0, 0);
        let mut stack: Vec<(u32, u32)> = Vec::new();
        spare.clear();
        while at < cut.len() {
            let mut node = cut[at];
            at += 1;
            let (mut merged, mut left) = (None, steps);
            while left > 0 && node > 1 {
                visited += 1;
                match self.test(node / 2, eye) {
                    Outcome::Large => break,
                    valid => merged = Some(valid),
                }
                node /= 2;
                left -= 1;
            }
            if let Some(outcome) = merged {
                while at < cut.len() && is_below(cut[at], node) {
                    at += 1;
                }
                spare.push(node);
                keep(node, outcome);
                continue;
            }
            stack.push((node, steps));
            while let Some((node, left)) = stack.pop() {
                visited += 1;
                match self.test(node, eye) {
                    Outcome::Large if left > 0 && !self.is_leaf(node) => {
                        stack.extend([(2 * node + 1, left - 1), (2 * node, left - 1)]);
                    }
                    outcome => {
                        spare.push(node);
                        keep(node, outcome);
                    }
                }
            }
        }
        cut.clear();
        cut.extend_from_slice(spare);
        visited
    }

    /// Draws a frame of views from their last cuts; see [`super::SvoCuts::render_frame`].
    pub fn render_frame(
        &self,
        state: &mut PointCutState,
        views: &[View],
        settings: &ViewSettings,
        steps: Steps,
    ) -> Result<(ViewMaps, CutStats), ViewError> {
        check(settings)?;
        state.views.truncate(views.len());
        state.views.resize_with(views.len(), || Mutex::new(vec![1]));
        let plan = Plan::new(settings, [0, 0])?;
        let needed_bytes = views.len() as u64 * (settings.map_bytes() + 20) + state.bytes();
        if plan.views < views.len() || needed_bytes > settings.budget_bytes {
            let what = "the maps and the cuts of a frame";
            return Err(settings.over_budget(what, needed_bytes));
        }
        let texels = TexelDirections::new(settings.resolution);
        let sums = Mutex::new(Counts::default());
        let draw = |spare: &mut Vec<u32>, place: usize, view: &View, canvas: &mut Canvas<'_>| {
            let mut cut = state.views[place].lock().unwrap_or_else(PoisonError::into_inner);
            let (eye, mut counts) = (eye(view, settings), Counts::default());
            let visited = self.advance(&mut cut, spare, &eye, steps.most(), |node, outcome| {
                self.draw(node, outcome, &eye, canvas, &mut counts);
            });
            counts.visited[0] = visited;
            sums.lock().unwrap_or_else(PoisonError::into_inner).add(&counts);
        };
        let maps = draw_pass(views, 0, settings, &texels, &plan, &|_| [0; 4], draw);
        let counts = sums.into_inner().unwrap_or_else(PoisonError::into_inner);
        Ok((maps, CutStats::new(&counts, state.bytes())))
    }
}

/// Whether a node is below another.
fn is_below(node: u32, above: u32) -> bool {
    let levels = node.ilog2().saturating_sub(above.ilog2());
    levels > 0 && node >> levels == above
}

fn eye(view: &View, settings: &ViewSettings) -> Eye {
    Eye::new(view, settings.scale(), settings.culling)
}

fn check(settings: &ViewSettings) -> Result<(), ViewError> {
    settings.check()?;
    if settings.with_colors {
        let problem = "draws points without colours; use `manylods`";
        return Err(ViewError::Unsupported { method: "manylods-points", problem });
    }
    Ok(())
}

/// Draws a sphere that fills more than a texel as a disc that faces the view: texels whose middle ray meets it.
fn disc(offset: [f32; 3], length: f32, radius: f32, canvas: &mut Canvas<'_>) {
    let resolution = canvas.texels.resolution();
    let sine = radius / length;
    let cosine = (1.0 - sine * sine).max(0.0).sqrt();
    for half in 0..2 {
        let Some([columns, rows]) = candidates(half, offset, length, radius / SPHERE_OF_CUBE, resolution)
        else {
            continue;
        };
        for row in rows[0]..rows[1] {
            for column in columns[0]..columns[1] {
                let texel = (half * resolution + row) * resolution + column;
                if !is_inside(texel, resolution) {
                    continue;
                }
                let direction = canvas.texels.direction(texel as usize);
                let along: f32 = (0..3).map(|i| direction[i] * offset[i]).sum();
                if along >= cosine * length {
                    let kept = &mut canvas.depths[texel as usize];
                    *kept = kept.min(length);
                }
            }
        }
    }
}

impl ViewRenderer for PointCuts {
    fn name(&self) -> &'static str {
        "manylods-points"
    }

    fn render_passes(
        &self,
        views: &[View],
        settings: &ViewSettings,
        sink: &mut PassSink<'_>,
    ) -> Result<(), ViewError> {
        check(settings)?;
        // From a batch come at most twice as many, on each level.
        let list_bytes = |batch: u64| 4 * batch * (2 * u64::from(self.tree.len().ilog2() + 1) + 1);
        let plan = Plan::new(settings, [list_bytes(1), list_bytes(BATCH)])?;
        let batch = (plan.list_bytes / list_bytes(1)) as usize;
        let draw = |lists: &mut Lists, _, view: &View, canvas: &mut Canvas<'_>| {
            self.basic(&eye(view, settings), batch, lists, canvas);
        };
        draw_passes(views, settings, &plan, &|_| [0; 4], draw, sink)
    }
}
