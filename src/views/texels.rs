//! Maps drawn texel by texel, each view on its own: what ray casting and brute force have in common.

use super::{Depths, PassSink, View, ViewError, ViewMaps, ViewSettings};
use half::f16;
use manyview_shaders::paraboloid::texel_count;
use rayon::prelude::*;
use std::ops::Range;

/// Texels of a pass at most, whatever the budget: a second's work or two, so that callers can stop between passes.
const TEXELS_PER_PASS: usize = 1 << 20;

/// Some texels of one view's map, to be filled: depths begin as +infinity, colours as black.
pub(super) struct Piece<'a> {
    /// Whose map it is.
    pub(super) view: &'a View,
    /// Which texels.
    pub(super) texels: Range<u32>,
    /// Their depths, metres.
    pub(super) depths: &'a mut [f32],
    /// Their colours, or nothing if none are wanted.
    pub(super) colors: &'a mut [[u8; 4]],
}

/// Draws views one by one in passes that keep to the budget, pieces of `piece_texels` texels on all threads.
pub(super) fn draw_passes(
    views: &[View],
    settings: &ViewSettings,
    piece_texels: usize,
    sink: &mut PassSink<'_>,
    draw: impl Fn(Piece<'_>) + Sync,
) -> Result<(), ViewError> {
    settings.check()?;
    let texels = texel_count(settings.resolution);
    // Depths are drawn in full, and rounded afterwards.
    let working = if settings.half_depths { 4 * texels as u64 } else { 0 };
    let needed_bytes = settings.map_bytes() + working + 20;
    let budget_bytes = settings.budget_bytes;
    if needed_bytes > budget_bytes && !views.is_empty() {
        return Err(settings.over_budget("the map of one view", needed_bytes));
    }
    let fitting = usize::try_from(budget_bytes / needed_bytes).unwrap_or(usize::MAX);
    let per_pass = fitting.min(TEXELS_PER_PASS / texels).max(1);
    for (number, pass) in views.chunks(per_pass).enumerate() {
        let first = (number * per_pass) as u32;
        let drawn: Vec<&View> = pass.iter().filter(|view| view.is_drawable()).collect();
        let mut depths = vec![f32::INFINITY; drawn.len() * texels];
        let mut colors = vec![[0; 4]; if settings.with_colors { depths.len() } else { 0 }];
        let pieces = texels / piece_texels;
        let of_piece = |index: usize| {
            let start = (index % pieces * piece_texels) as u32;
            (drawn[index / pieces], start..start + piece_texels as u32)
        };
        let depth_pieces = depths.par_chunks_mut(piece_texels).enumerate();
        if settings.with_colors {
            depth_pieces.zip(colors.par_chunks_mut(piece_texels)).for_each(|((index, depths), colors)| {
                let (view, texels) = of_piece(index);
                draw(Piece { view, texels, depths, colors });
            });
        } else {
            depth_pieces.for_each(|(index, depths)| {
                let (view, texels) = of_piece(index);
                draw(Piece { view, texels, depths, colors: &mut [] });
            });
        }
        let mut maps = 0;
        let map_of = pass.iter().map(|view| match view.is_drawable() {
            true => {
                maps += 1;
                maps - 1
            }
            false => ViewMaps::NO_MAP,
        });
        let map_of = map_of.collect();
        let centers = drawn.iter().map(|view| view.position).collect();
        let depths = match settings.half_depths {
            true => Depths::Half(depths.iter().map(|&depth| f16::from_f32(depth)).collect()),
            false => Depths::Full(depths),
        };
        let indices = (first..first + pass.len() as u32).collect();
        sink(ViewMaps::from_parts(settings.resolution, indices, map_of, centers, depths, colors))?;
    }
    Ok(())
}
