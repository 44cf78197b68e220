//! Pixels in groups that one choice of lights serves.

use super::light_tree::Group;
use crate::render::gbuffer::GBuffer;
use glam::Vec3;
use manyview_shaders::views::ViewNode;

/// Pixels a side of a tile.
pub(super) const TILE: u32 = 8;
/// The least cosine between normals of a group.
const LEAST_COSINE: f32 = 0.7;
/// Pixels of a group are within this many tile widths of the first.
const REACH_TILES: f32 = 3.0;

/// Pixels close to each other that face about one way, as indices in the picture.
#[derive(Debug, Clone)]
pub(super) struct Receivers {
    pub(super) pixels: Vec<u32>,
    pub(super) group: Group,
}

/// Number of tiles of a picture.
pub(super) fn tile_count(gbuffer: &GBuffer) -> u32 {
    gbuffer.width.div_ceil(TILE) * gbuffer.height.div_ceil(TILE)
}

/// The groups of a tile; `spread` is the width of a pixel, metres per metre of distance.
pub(super) fn groups(gbuffer: &GBuffer, tile: u32, spread: f32) -> Vec<Receivers> {
    let columns = gbuffer.width.div_ceil(TILE);
    let (x0, y0) = (tile % columns * TILE, tile / columns * TILE);
    let mut found: Vec<(Vec3, Vec3, Vec<u32>)> = Vec::new();
    for y in y0..(y0 + TILE).min(gbuffer.height) {
        for x in x0..(x0 + TILE).min(gbuffer.width) {
            let index = y * gbuffer.width + x;
            let pixel = &gbuffer.pixels[index as usize];
            if !pixel.is_surface() {
                continue;
            }
            let (at, normal) = (Vec3::from(pixel.position), Vec3::from(pixel.geometric_normal));
            let reach = pixel.depth * spread * TILE as f32 * REACH_TILES;
            let like =
                found.iter_mut().find(|(p, n, _)| n.dot(normal) > LEAST_COSINE && p.distance(at) <= reach);
            match like {
                Some((_, _, pixels)) => pixels.push(index),
                None => found.push((at, normal, vec![index])),
            }
        }
    }
    found.into_iter().map(|(_, _, pixels)| Receivers { group: group(gbuffer, &pixels), pixels }).collect()
}

/// The sphere around pixels, and the directions in front of any of them.
fn group(gbuffer: &GBuffer, pixels: &[u32]) -> Group {
    let of = |&index: &u32| &gbuffer.pixels[index as usize];
    let (mut low, mut high, mut normals) = (Vec3::INFINITY, Vec3::NEG_INFINITY, Vec3::ZERO);
    for pixel in pixels.iter().map(of) {
        (low, high) = (low.min(pixel.position.into()), high.max(pixel.position.into()));
        normals += Vec3::from(pixel.geometric_normal);
    }
    let center = (low + high) * 0.5;
    let axis = normals.normalize_or(Vec3::Y);
    let (mut radius, mut cosine) = (0.0f32, 1.0f32);
    for pixel in pixels.iter().map(of) {
        radius = radius.max(center.distance(pixel.position.into()));
        cosine = cosine.min(axis.dot(pixel.geometric_normal.into()));
    }
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    // The cone of normals and a right angle more.
    let (cos_psi, sin_psi) = if cosine > 0.0 { (-sine, cosine) } else { (-1.0, 0.0) };
    Group {
        view: ViewNode {
            center: center.to_array(),
            radius,
            axis: axis.to_array(),
            cos_psi,
            sin_psi,
            first: 0,
            count: 0,
            reserved: 0,
        },
    }
}
