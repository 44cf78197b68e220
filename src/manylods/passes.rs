//! Views in passes that keep to the budget: what all forms of this method share.

use crate::views::splat::{Canvas, TexelDirections};
use crate::views::{Depths, PassSink, View, ViewError, ViewMaps, ViewSettings};
use half::f16;
use manyview_shaders::paraboloid::texel_count;
use rayon::prelude::*;

/// Bytes of a view beside its map: center, index, map number.
const VIEW_BYTES: u64 = 20;

/// How views are cut into passes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Plan {
    /// Views of a pass.
    pub(super) views: usize,
    /// Whether one thread alone fits the budget.
    pub(super) sequential: bool,
    /// Bytes of lists that each thread may use.
    pub(super) list_bytes: u64,
}

impl Plan {
    /// Divides the budget. A thread's lists take `min_list_bytes` at least and never need more than `max_list_bytes`.
    pub(super) fn new(
        settings: &ViewSettings,
        [min_list_bytes, max_list_bytes]: [u64; 2],
    ) -> Result<Self, ViewError> {
        let texels = texel_count(settings.resolution) as u64;
        let directions = 24 * texels + 8 * u64::from(settings.resolution);
        let depths = if settings.half_depths { 4 * texels } else { 0 };
        let thread = depths + if settings.with_colors { 4 * texels } else { 0 };
        let view = settings.map_bytes() + VIEW_BYTES;
        for threads in [rayon::current_num_threads() as u64, 1] {
            let fixed = directions + threads * (thread + min_list_bytes);
            let Some(left) = settings.budget_bytes.checked_sub(fixed + view) else { continue };
            // A quarter of the rest is enough for lists; maps are what counts.
            let list_bytes = (min_list_bytes + left / 4 / threads).min(max_list_bytes);
            let lists = threads * (list_bytes - min_list_bytes);
            let views = 1 + (left - lists) / view;
            return Ok(Self { views: views as usize, sequential: threads == 1, list_bytes });
        }
        let needed_bytes = directions + thread + min_list_bytes + view;
        Err(settings.over_budget("the map of one view and the lists of one thread", needed_bytes))
    }
}

/// Where colours of nodes are found, by the number that [`Canvas`] keeps.
pub(super) type ColorOf<'a> = dyn Fn(u32) -> [u8; 4] + Sync + 'a;

/// Draws the views of one pass: `draw(scratch, place, view, canvas)` for each that can be drawn.
pub(super) fn draw_pass<S: Default>(
    views: &[View],
    first: u32,
    settings: &ViewSettings,
    texels: &TexelDirections,
    plan: &Plan,
    color_of: &ColorOf<'_>,
    draw: impl Fn(&mut S, usize, &View, &mut Canvas<'_>) + Sync,
) -> ViewMaps {
    let drawable: Vec<u32> =
        (0..).zip(views).filter(|(_, view)| view.is_drawable()).map(|(i, _)| i).collect();
    let mut map_of = vec![ViewMaps::NO_MAP; views.len()];
    for (map, &place) in (0..).zip(&drawable) {
        map_of[place as usize] = map;
    }
    let centers: Vec<[f32; 3]> = drawable.iter().map(|&place| views[place as usize].position).collect();
    let size = texel_count(settings.resolution);
    let mut full = vec![f32::INFINITY; if settings.half_depths { 0 } else { drawable.len() * size }];
    let mut half = vec![f16::INFINITY; if settings.half_depths { drawable.len() * size } else { 0 }];
    let mut colors = vec![[0u8; 4]; if settings.with_colors { drawable.len() * size } else { 0 }];
    let jobs = drawable.iter().zip(Slices::new(&mut full, size)).zip(Slices::new(&mut half, size));
    let jobs = jobs.zip(Slices::new(&mut colors, size));
    let run = |scratch: &mut Scratch<S>, (((place, full), half), colors): Job<'_>| {
        let Scratch { lists, depths, nodes } = scratch;
        let depths = match half.is_empty() {
            true => full,
            false => {
                depths.clear();
                depths.resize(size, f32::INFINITY);
                &mut depths[..]
            }
        };
        nodes.clear();
        nodes.resize(colors.len(), u32::MAX);
        let view = &views[*place as usize];
        draw(lists, *place as usize, view, &mut Canvas { texels, depths, nodes });
        half.iter_mut().zip(depths.iter()).for_each(|(half, &depth)| *half = f16::from_f32(depth));
        for (color, &node) in colors.iter_mut().zip(nodes.iter()).filter(|(_, node)| **node != u32::MAX) {
            *color = color_of(node);
        }
    };
    match plan.sequential {
        true => {
            let mut scratch = Scratch::default();
            jobs.for_each(|job| run(&mut scratch, job));
        }
        false => {
            let jobs: Vec<Job<'_>> = jobs.collect();
            jobs.into_par_iter().for_each_init(Scratch::default, run);
        }
    }
    let depths = if settings.half_depths { Depths::Half(half) } else { Depths::Full(full) };
    let numbers = (first..).take(views.len()).collect();
    ViewMaps::from_parts(settings.resolution, numbers, map_of, centers, depths, colors)
}

/// Draws views pass after pass; see [`draw_pass`].
pub(super) fn draw_passes<S: Default>(
    views: &[View],
    settings: &ViewSettings,
    plan: &Plan,
    color_of: &ColorOf<'_>,
    draw: impl Fn(&mut S, usize, &View, &mut Canvas<'_>) + Sync,
    sink: &mut PassSink<'_>,
) -> Result<(), ViewError> {
    let texels = TexelDirections::new(settings.resolution);
    let mut first = 0;
    for views in views.chunks(plan.views) {
        sink(draw_pass(views, first as u32, settings, &texels, plan, color_of, |s, place, view, canvas| {
            draw(s, first + place, view, canvas);
        }))?;
        first += views.len();
    }
    Ok(())
}

type Job<'a> = (((&'a u32, &'a mut [f32]), &'a mut [f16]), &'a mut [[u8; 4]]);

/// What a thread keeps from view to view.
#[derive(Default)]
struct Scratch<S> {
    lists: S,
    depths: Vec<f32>,
    nodes: Vec<u32>,
}

/// Pieces of one size, or without end empty ones of an empty list.
struct Slices<'a, T> {
    rest: &'a mut [T],
    size: usize,
}

impl<'a, T> Slices<'a, T> {
    fn new(rest: &'a mut [T], size: usize) -> Self {
        Self { rest, size }
    }
}

impl<'a, T> Iterator for Slices<'a, T> {
    type Item = &'a mut [T];

    fn next(&mut self) -> Option<Self::Item> {
        let rest = std::mem::take(&mut self.rest);
        let (piece, rest) = rest.split_at_mut(self.size.min(rest.len()));
        self.rest = rest;
        Some(piece)
    }
}
