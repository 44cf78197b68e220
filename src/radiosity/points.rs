//! Point-based light over surfaces: a lit tree, and small pictures of it from a few points of the large one.
//!
//! # Theory
//! P. Christensen, *Point-Based Approximate Color Bleeding*, 2008, lights points that stand for the scene's surface once, and
//! finds the light that falls on a receiver by drawing them into a small map around it. \[ML\] (Applications) draws all maps
//! at once, from cuts of one [lit tree](LitTree); \[MV\]'s hierarchy of views does it with less work. The irradiance of a
//! receiver with normal n is the integral of L cos ω over the hemisphere; of a map it is
//! π Σ L cos ω Ω / Σ cos ω Ω over its texels, which stand for solid angles Ω.
//!
//! # Practice
//! A renderer of views knows colours of four bytes. Here these hold no colour but the number of a node ([`codes`]), so that
//! radiance is looked up in 32-bit floats, for the side of the node that the view sees. Texels where nothing is are black. Light
//! goes over one surface: that of lamps, suns and what glows.
//!
//! Receivers are a few pixels ([`Places`]); the others take the mean of those around them on the same surface.
//!
//! \[ML\] Holländer et al., *ManyLoDs*, CGF 30(4), 2011. \[MV\] Kol et al., *MegaViews*, CGF 2018.

mod lit_tree;
mod surfaces;
mod views;

pub use lit_tree::{LitTree, MOST_LIT_NODES};
pub use surfaces::CodedLeaves;
pub use views::Places;

use super::VIEW_LIFT_VOXELS;
use crate::render::gbuffer::GBuffer;
use crate::views::{View, ViewError, ViewMaps, ViewRenderer, ViewSettings};
use glam::Vec3;
use manyview_pipeline::bake::Progress;
use manyview_shaders::paraboloid::{is_inside, texel_count, texel_direction};
use manyview_shaders::scene_tree::SceneTree;
use manyview_shaders::svo::Svo;
use rayon::prelude::*;
use std::f32::consts::{FRAC_PI_2, PI};

/// The number of views that is taken unless another one is asked for: \[ML\]'s.
pub const DEFAULT_VIEWS: u32 = 4096;

/// What a receiver is: position, metres, and unit normals of its surface and for shading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointReceiver {
    /// Metres.
    pub position: Vec3,
    /// Unit normal of the surface, turned to where light comes from.
    pub geometric_normal: Vec3,
    /// Unit normal for shading.
    pub normal: Vec3,
}

/// Four bytes for every node of an octree, in the order of [`SceneTree::colors`]: 1 + the number of the lit node that tells
/// its light, lowest byte first. 0 is where nothing is.
pub fn codes(svo: &Svo, lit: &LitTree) -> Vec<[u8; 4]> {
    lit.node_of(svo).into_iter().map(|node| (node + 1).to_le_bytes()).collect()
}

/// An octree for renderers of views whose colours are [`codes`].
pub fn coded_tree(svo: &Svo, lit: &LitTree) -> SceneTree {
    let mut tree = SceneTree::new(svo, false);
    tree.colors = codes(svo, lit);
    // An octree of one leaf has eight in the tree.
    let last = tree.colors.last().copied().unwrap_or_default();
    tree.colors.resize(tree.nodes.len() + tree.leaf_count() as usize, last);
    tree
}

/// The receivers of some pixels, which show surfaces.
pub fn receivers(gbuffer: &GBuffer, places: &Places) -> Vec<PointReceiver> {
    let of = |&index: &u32| {
        let pixel = &gbuffer.pixels[index as usize];
        PointReceiver {
            position: pixel.position.into(),
            geometric_normal: pixel.geometric_normal.into(),
            normal: pixel.normal.into(),
        }
    };
    places.pixels.iter().map(of).collect()
}

/// Irradiance of receivers by the maps that `renderer` draws of a tree with [`codes`] for colours, whose voxels are
/// `voxel_metres` wide. Views are a little off the surface, so that they do not see its own voxels.
pub fn irradiance(
    renderer: &dyn ViewRenderer,
    lit: &LitTree,
    receivers: &[PointReceiver],
    voxel_metres: f32,
    settings: &ViewSettings,
    progress: &dyn Progress,
) -> Result<Vec<Vec3>, ViewError> {
    let settings = ViewSettings { with_colors: true, half_depths: true, ..*settings };
    let lift = VIEW_LIFT_VOXELS * voxel_metres;
    let view = |receiver: &PointReceiver| {
        let position = receiver.position + receiver.geometric_normal * lift;
        View::new(position.to_array(), receiver.normal.to_array(), FRAC_PI_2)
    };
    let views: Vec<View> = receivers.iter().map(view).collect();
    let texels = Texel::all(settings.resolution);
    let mut found = vec![Vec3::ZERO; receivers.len()];
    progress.begin("light over points", views.len() as u64, "views");
    renderer.render_passes(&views, &settings, &mut |maps| {
        if progress.cancelled() {
            return Err(ViewError::Cancelled);
        }
        let places: Vec<(u32, u32)> =
            maps.views().iter().copied().zip(maps.map_of().iter().copied()).collect();
        let of = |&(view, map): &(u32, u32)| match map {
            ViewMaps::NO_MAP => Vec3::ZERO,
            map => of_map(&maps, map, receivers[view as usize].normal, lit, &texels),
        };
        let sums: Vec<Vec3> = places.par_iter().map(of).collect();
        places.iter().zip(sums).for_each(|(&(view, _), sum)| found[view as usize] = sum);
        progress.advance(places.len() as u64);
        Ok(())
    })?;
    Ok(found)
}

/// A texel that directions fall in.
struct Texel {
    index: usize,
    direction: Vec3,
    /// Steradians.
    solid_angle: f32,
}

impl Texel {
    fn all(resolution: u32) -> Vec<Self> {
        let inside = (0..texel_count(resolution) as u32).filter(|&index| is_inside(index, resolution));
        let of = |index: u32| Self {
            index: index as usize,
            direction: texel_direction(index, resolution).into(),
            solid_angle: solid_angle(index, resolution),
        };
        inside.map(of).collect()
    }
}

/// Solid angle of a texel's part of the unit disc, steradians: a stereographic projection scales areas by 4 / (1 + r²)².
fn solid_angle(index: u32, resolution: u32) -> f32 {
    /// Parts a side: the rim cuts through texels.
    const PARTS: u32 = 8;
    let (row, column) = (index / resolution % resolution, index % resolution);
    let edge = 2.0 / (resolution * PARTS) as f32;
    let part = |part: u32| {
        let at = |texel: u32, part: u32| ((texel * PARTS + part) as f32 + 0.5) * edge - 1.0;
        let (a, b) = (at(column, part % PARTS), at(row, part / PARTS));
        let square = a * a + b * b;
        if square <= 1.0 { 4.0 * edge * edge / ((1.0 + square) * (1.0 + square)) } else { 0.0 }
    };
    (0..PARTS * PARTS).map(part).sum()
}

fn of_map(maps: &ViewMaps, map: u32, normal: Vec3, lit: &LitTree, texels: &[Texel]) -> Vec3 {
    let first = map as usize * texel_count(maps.resolution());
    let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
    for texel in texels {
        let cosine = normal.dot(texel.direction);
        if cosine <= 0.0 {
            continue;
        }
        let weight = cosine * texel.solid_angle;
        weights += weight;
        let code = u32::from_le_bytes(maps.colors()[first + texel.index]);
        if code != 0 {
            sum += lit.radiance(code - 1, -texel.direction) * weight;
        }
    }
    if weights > 0.0 { sum * (PI / weights) } else { Vec3::ZERO }
}

#[cfg(test)]
mod tests;
