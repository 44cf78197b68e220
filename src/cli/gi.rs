//! `manyview render`, the part about point-based light over surfaces.

use std::str::FromStr;
use std::time::Instant;

use manyview::LoadError;
use manyview::megaviews::{MegaViews, Sharing};
use manyview::radiosity::MAX_VIRTUAL_LIGHTS;
use manyview::radiosity::points::{
    CodedLeaves, DEFAULT_VIEWS, LitTree, Places, coded_tree, irradiance, receivers,
};
use manyview::render::gbuffer::GBuffer;
use manyview::render::methods::Ingredients;
use manyview::views::{RayCast, ViewRenderer};
use manyview::visibility::Visibility;
use manyview_pipeline::scene::PunctualLight;
use serde_json::{Value, json};

use super::error::{CliError, Exit};
use super::gather::view_error;
use super::progress::Progress;
use super::render::render_error;

/// What `--gi` names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Points {
    /// How many pixels have views.
    views: u32,
    /// Views by exact casts at the octree's leaves.
    is_exact: bool,
}

impl FromStr for Points {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let usage = || {
            format!(
                "write points:VIEWS, or raycast:VIEWS, with 1 to {MAX_VIRTUAL_LIGHTS} views, such as points:{DEFAULT_VIEWS}"
            )
        };
        let (kind, views) = match text.split_once(':') {
            None => (text, DEFAULT_VIEWS),
            Some((kind, views)) => (kind, views.parse().map_err(|_| usage())?),
        };
        let is_exact = match kind {
            "points" => false,
            "raycast" => true,
            _ => return Err(usage()),
        };
        let is_possible = (1..=MAX_VIRTUAL_LIGHTS as u32).contains(&views);
        is_possible.then_some(Self { views, is_exact }).ok_or_else(usage)
    }
}

/// Irradiance of all pixels from surfaces that lights reach, and what to say about it.
pub(super) fn light_over_points(
    points: Points,
    ingredients: &Ingredients<'_>,
    gbuffer: &GBuffer,
    spread: f64,
    lights: &[PunctualLight],
    method: &dyn Visibility,
    progress: &Progress,
) -> Result<(Vec<[f32; 3]>, Value), CliError> {
    let Some(archive) = ingredients.archive else {
        return Err(CliError::new(Exit::Internal, anyhow::anyhow!("--gi points came without an archive")));
    };
    let svo = archive.svo().map_err(|error: LoadError| CliError::from(error))?;
    let clock = Instant::now();
    let lit = LitTree::new(&svo, ingredients.scene, lights, method, progress).map_err(render_error)?;
    let lit_seconds = clock.elapsed().as_secs_f64();
    let places = Places::choose(gbuffer, points.views as usize, spread);
    let receivers = receivers(gbuffer, &places);
    let voxel_metres = svo.voxel_size() as f32;
    let leaves = svo.node_count(svo.depth() as usize);
    let renderer: Box<dyn ViewRenderer> = match points.is_exact {
        true => Box::new(RayCast::new(CodedLeaves::new(&svo, &lit))),
        // A map is exact where it is drawn from; receivers that share one would step from voxel to voxel.
        false => Box::new(MegaViews::new(coded_tree(&svo, &lit).into()).with_sharing(Sharing::None)),
    };
    drop(svo);
    let chosen_seconds = clock.elapsed().as_secs_f64();
    let of_places = irradiance(&*renderer, &lit, &receivers, voxel_metres, &ingredients.maps, progress)
        .map_err(view_error)?;
    let drawn_seconds = clock.elapsed().as_secs_f64();
    let light = places.interpolate(gbuffer, &of_places);
    let report = json!({
        "views": places.pixels.len(),
        "leaves": leaves,
        "lit_level": lit.level(),
        "lit_nodes": lit.node_count(),
        "lit_samples": lit.sample_count(),
        "seconds": {
            "lit_tree": lit_seconds,
            "choice": chosen_seconds - lit_seconds,
            "maps": drawn_seconds - chosen_seconds,
            "interpolation": clock.elapsed().as_secs_f64() - drawn_seconds,
        },
    });
    Ok((light, report))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_are_a_sensible_number() {
        let of = |text: &str| text.parse::<Points>();
        assert_eq!(of("points"), Ok(Points { views: 4096, is_exact: false }));
        assert_eq!(of("points:1000000"), Ok(Points { views: 1_000_000, is_exact: false }));
        assert_eq!(of("raycast:7"), Ok(Points { views: 7, is_exact: true }));
        for text in
            ["", "point", "points:", "points:0", "points:-1", "points:1000001", "points:4294967297", "vpl:4"]
        {
            assert!(of(text).unwrap_err().contains("1 to 1000000 views"), "{text}");
        }
    }
}
