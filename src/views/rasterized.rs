//! `polygons`: every triangle into the map of every view, one view after the other. What shadow mapping does for each
//! light, and what methods for many views are measured against (\[ML\], "shadow-mapping polygons").
//!
//! # Method
//! Lines are curves on a paraboloid, so triangles are not scan-converted: texels whose middle may lie in a triangle are
//! tested by the signs of three determinants, which two triangles with a common edge compute alike. The texels are those in
//! a circle: stereographic projection makes circles of circles, and so of the cone around a triangle's bounding sphere.
//!
//! \[ML\] Holländer et al., *ManyLoDs*, CGF 30(4), 2011.

use super::raycast::rays_of_texel;
use super::texels::{Piece, draw_passes};
use super::{PassSink, View, ViewError, ViewRenderer, ViewSettings};
use crate::reference::Reference;
use glam::DVec3;
use manyview_shaders::masks::UNMASKED;
use manyview_shaders::paraboloid::texel_count;
use manyview_shaders::views::{ViewNode, is_culled};

/// Draws all triangles into each view.
///
/// As for [`super::TriangleSurfaces`], what is nearer than the rounding of coordinates is not seen.
pub struct Polygons<'a> {
    reference: &'a Reference<'a>,
    /// Middle and radius of the sphere around each triangle, metres.
    spheres: Vec<(DVec3, f64)>,
    near_metres: f64,
}

impl<'a> Polygons<'a> {
    /// Borrows the triangles.
    pub fn new(reference: &'a Reference<'a>) -> Self {
        let sphere = |[a, b, c]: &[DVec3; 3]| {
            // Around the middle of the bounds it is at most a sixth too large.
            let middle = (a.min(*b).min(*c) + a.max(*b).max(*c)) * 0.5;
            let radius = [a, b, c].into_iter().map(|p| p.distance(middle)).fold(0.0, f64::max);
            // Rounded up, so that what touches a border is in it.
            (middle, radius * (1.0 + 1e-9))
        };
        let corners = reference.triangles().iter().flatten();
        let first = reference.triangles().first().map_or(DVec3::ZERO, |t| t[0]);
        let (min, max) = corners.fold((first, first), |(min, max), &p| (min.min(p), max.max(p)));
        let spheres = reference.triangles().iter().map(sphere).collect();
        Self { reference, spheres, near_metres: crate::exact::lift_metres(min, max) }
    }

    fn draw(&self, view: &View, directions: &[Option<DVec3>], settings: &ViewSettings, depths: &mut [f32]) {
        let resolution = settings.resolution;
        let position = DVec3::from_array(view.position.map(f64::from));
        let node = ViewNode::of_view(view, 0);
        for (index, (middle, radius)) in self.spheres.iter().enumerate() {
            let offset = middle - position;
            let length = offset.length();
            let small = offset.as_vec3().to_array();
            // 1e-5 of the length is more than `f32` rounds by.
            let reach = (radius + 1e-5 * length) as f32;
            if settings.culling && is_culled(small, length as f32, reach, &node) {
                continue;
            }
            let mut drawing = None;
            for half in 0..2 {
                let texels = circle(offset, length, *radius, half, resolution);
                for row in texels[1].clone() {
                    for column in texels[0].clone() {
                        let at = (half * resolution + row) * resolution + column;
                        let Some(direction) = directions[at as usize] else { continue };
                        let triangle = drawing.get_or_insert_with(|| self.triangle(index, position));
                        if let Some(distance) = self.hit(triangle, direction) {
                            let depth = &mut depths[at as usize];
                            *depth = depth.min(distance as f32);
                        }
                    }
                }
            }
        }
    }

    fn triangle(&self, index: usize, position: DVec3) -> Triangle {
        let [a, b, c] = self.reference.triangles()[index].map(|p| p - position);
        let edges = [b.cross(c), c.cross(a), a.cross(b)];
        // From the triangle's own edges: the sum of the three would cancel.
        let normal = (b - a).cross(c - a);
        Triangle { index: index as u32, edges, normal, volume: a.dot(normal) }
    }

    fn hit(&self, triangle: &Triangle, direction: DVec3) -> Option<f64> {
        let weights = triangle.edges.map(|edge| edge.dot(direction));
        let inside = weights.iter().all(|&w| w >= 0.0) || weights.iter().all(|&w| w <= 0.0);
        if !inside {
            return None;
        }
        let distance = triangle.volume / triangle.normal.dot(direction);
        // Not a number where the view lies in the triangle's plane.
        if !(distance > self.near_metres && distance.is_finite()) {
            return None;
        }
        if self.reference.mask_of(triangle.index) != UNMASKED {
            let sum: f64 = weights.iter().sum();
            let barycentric = [weights[1] / sum, weights[2] / sum];
            if !self.reference.exists(triangle.index, barycentric) {
                return None;
            }
        }
        Some(distance)
    }
}

/// A triangle seen from a view.
struct Triangle {
    index: u32,
    /// Normals of the planes through the view and each edge.
    edges: [DVec3; 3],
    normal: DVec3,
    /// Six times the volume between view and triangle.
    volume: f64,
}

/// Columns and rows of a half whose middles may lie within a sphere at `offset`.
fn circle(offset: DVec3, length: f64, radius: f64, half: u32, resolution: u32) -> [std::ops::Range<u32>; 2] {
    let all = [0..resolution, 0..resolution];
    let ahead = if half == 0 { offset.x } else { -offset.x };
    if ahead < -radius {
        return [0..0, 0..0];
    }
    // The length of the tangents from the view to the sphere.
    let tangent = (length - radius) * (length + radius);
    let below = ahead + tangent.max(0.0).sqrt();
    // The view inside, or the circle through the middle of the other half and beyond.
    if tangent <= 0.0 || below <= 1e-6 * length {
        return all;
    }
    [offset.y, offset.z].map(|middle| {
        let at = |c: f64| ((c / below + 1.0) * 0.5 * f64::from(resolution) - 0.5).clamp(-1e6, 1e6);
        // A thousandth of a texel for what is rounded here.
        let (first, last) = ((at(middle - radius) - 1e-3).ceil(), (at(middle + radius) + 1e-3).floor());
        let first = first.max(0.0) as u32;
        first..(last + 1.0).clamp(0.0, f64::from(resolution)) as u32
    })
}

impl ViewRenderer for Polygons<'_> {
    fn name(&self) -> &'static str {
        "polygons"
    }

    fn render_passes(
        &self,
        views: &[View],
        settings: &ViewSettings,
        sink: &mut PassSink<'_>,
    ) -> Result<(), ViewError> {
        settings.check()?;
        if settings.with_colors {
            let problem = "draws no colours: leave them out, or use `raycast`";
            return Err(ViewError::Unsupported { method: self.name(), problem });
        }
        let texels = texel_count(settings.resolution);
        let directions: Vec<Option<DVec3>> = (0..texels as u32)
            .map(|texel| rays_of_texel(texel, settings.resolution, 1).next().map(DVec3::from_array))
            .collect();
        draw_passes(views, settings, texels, sink, |Piece { view, depths, .. }| {
            self.draw(view, &directions, settings, depths);
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::scene::RenderScene;
    use crate::views::{RayCast, TriangleSurfaces};
    use manyview_pipeline::generate::{SceneKind, generate};

    #[test]
    fn every_triangle_is_drawn_where_rays_meet_it() {
        // A forest has cut-outs, a town near walls.
        for kind in [SceneKind::Forest, SceneKind::Town] {
            let scene = RenderScene::new(generate(kind, 2000, 3)).unwrap();
            let reference = scene.reference();
            let [min, max] = scene.bounds;
            let mut random = crate::bench::Random::new(4);
            let mut views: Vec<View> = (0..12)
                .map(|_| {
                    let share = DVec3::new(random.unit(), random.unit(), random.unit());
                    let position = min + (max - min) * (share * 1.4 - 0.2);
                    View::new(position.as_vec3().to_array(), random.direction().as_vec3().to_array(), 4.0)
                })
                .collect();
            // On a surface, and far away.
            let [a, b, c] = reference.triangles()[7];
            views.push(View::around(((a + b + c) / 3.0).as_vec3().to_array()));
            views.push(View::around((max + (max - min) * 3.0).as_vec3().to_array()));
            let settings = ViewSettings { culling: false, ..ViewSettings::new(32) };
            let drawn = Polygons::new(&reference).render_views(&views, &settings).unwrap();
            let cast =
                RayCast::new(TriangleSurfaces::new(&reference)).render_views(&views, &settings).unwrap();
            let (mut filled, mut different) = (0, 0);
            for place in 0..views.len() {
                for (a, b) in drawn.view_depths(place).into_iter().zip(cast.view_depths(place)) {
                    filled += usize::from(b.is_finite());
                    // Rays that graze an edge, or fall on another side of a cut-out's texel.
                    let same = a == b || (a / b - 1.0).abs() < 1e-5;
                    different += usize::from(!same);
                }
            }
            assert!(filled > 2000, "{filled}");
            assert!(different * 5000 <= filled, "{different} of {filled}");
        }
    }

    #[test]
    fn culling_leaves_what_is_in_the_field() {
        let scene = RenderScene::new(generate(SceneKind::Town, 2000, 3)).unwrap();
        let reference = scene.reference();
        let polygons = Polygons::new(&reference);
        let middle = ((scene.bounds[0] + scene.bounds[1]) * 0.5).as_vec3().to_array();
        let view = View::new(middle, [0.3, -1.0, 0.2], 0.6);
        let drawn = |culling| {
            let settings = ViewSettings { culling, ..ViewSettings::new(32) };
            polygons.render_views(&[view], &settings).unwrap().view_depths(0)
        };
        let (with, without) = (drawn(true), drawn(false));
        let (axis, [cosine, _]) = view.cone();
        let mut fewer = 0;
        for (texel, (with, without)) in with.into_iter().zip(without).enumerate() {
            let d = manyview_shaders::paraboloid::texel_direction(texel as u32, 32);
            if (0..3).map(|i| d[i] * axis[i]).sum::<f32>() > cosine {
                assert_eq!(with, without);
            }
            fewer += usize::from(with > without);
        }
        assert!(fewer > 100, "{fewer}");
    }
}
