//! `bvh`: ray tracing on the CPU as one would do it today.
//!
//! # Practice
//! [`BvhVisibility`] is what throughput is compared with. It uses the `obvhs` crate as its documentation recommends for
//! speed: a compressed wide BVH ([`BUILD`]) with SIMD node tests, triangles with precomputed edges and normals
//! in the tree's order, and the traversal that ends at the first hit where only that is asked.
//! Receivers are spread over all threads, lights are the inner loop. Alpha-masked triangles that are hit look their
//! texel up.
//!
//! The judge is another: [`ExactRays`](crate::exact::ExactRays).

use crate::reference::{Reference, fixed_point, tree_ray};
use crate::visibility::parallel;
use crate::visibility::{Visibility, VisibilityError};
use glam::{DVec3, Vec3A};
use manyview_pipeline::triangles::Cutouts;
use manyview_shaders::masks::UNMASKED;
use manyview_shaders::types::{LightPoint, Receiver, Segment};
use obvhs::BvhBuildParams;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::ray::{Ray, RayHit};
use obvhs::rt_triangle::RtTriangle;
use obvhs::triangle::Triangle;
use std::time::Duration;

/// How the trees of the rivals are built: `obvhs`' slowest preset, whose trees are traversed fastest, without splitting
/// triangles beforehand, which makes foliage slower by a quarter.
pub const BUILD: BvhBuildParams = BvhBuildParams { pre_split: false, ..BvhBuildParams::very_slow_build() };

/// How far origins on a surface are lifted along their normal, as a share of the scene's half diagonal: some hundred
/// times what rounding to `f32` moves them.
const LIFT_SHARE: f64 = 1e-5;

/// A tree over a scene's triangles in `f32`, relative to the scene's centre.
pub(super) struct Tree {
    pub(super) bvh: CwBvh,
    pub(super) triangles: Vec<Triangle>,
    pub(super) half_diagonal: f64,
}

impl Tree {
    pub(super) fn new(reference: &Reference, build: BvhBuildParams) -> Self {
        let center = reference.center();
        let mut half_diagonal = 0.0f64;
        let mut local = |p: DVec3| {
            half_diagonal = half_diagonal.max((p - center).length());
            Vec3A::from((p - center).as_vec3())
        };
        let triangles: Vec<Triangle> = reference
            .triangles()
            .iter()
            .map(|t| {
                let [v0, v1, v2] = t.map(&mut local);
                Triangle { v0, v1, v2 }
            })
            .collect();
        let bvh = match triangles.is_empty() {
            true => CwBvh::default(),
            false => build_cwbvh_from_tris(&triangles, build, &mut Duration::default()),
        };
        Self { bvh, triangles, half_diagonal }
    }

    /// See [`LIFT_SHARE`].
    pub(super) fn lift(&self) -> f32 {
        (self.half_diagonal * LIFT_SHARE) as f32
    }
}

/// See the module.
pub struct BvhVisibility<'a> {
    bvh: CwBvh,
    /// In the tree's order.
    triangles: Vec<RtTriangle>,
    /// In the tree's order; empty if no triangle is cut.
    masks: Vec<u32>,
    cutouts: &'a Cutouts,
    center: Vec3A,
    lift: f32,
}

impl<'a> BvhVisibility<'a> {
    /// Builds a tree over the reference's triangles.
    pub fn new(reference: &Reference<'a>) -> Self {
        Self::with_build(reference, BUILD)
    }

    /// Builds a tree in another way.
    pub fn with_build(reference: &Reference<'a>, build: BvhBuildParams) -> Self {
        let tree = Tree::new(reference, build);
        let lift = tree.lift();
        let order = &tree.bvh.primitive_indices;
        let triangles = order.iter().map(|&i| (&tree.triangles[i as usize]).into()).collect();
        let masks = match reference.cutouts().masks.is_empty() {
            true => Vec::new(),
            false => order.iter().map(|&i| reference.mask_of(i)).collect(),
        };
        let center = Vec3A::from(reference.center().as_vec3());
        Self { bvh: tree.bvh, triangles, masks, cutouts: reference.cutouts(), center, lift }
    }

    #[inline]
    fn ray(&self, segment: &Segment) -> Option<Ray> {
        let origin =
            (Vec3A::from_array(segment.origin) - self.center) + Vec3A::from_array(segment.normal) * self.lift;
        let along = (Vec3A::from_array(segment.target) - self.center) - origin;
        (!self.triangles.is_empty()).then(|| tree_ray(origin, along, 1.0))
    }

    #[inline]
    fn intersect(&self, ray: &Ray, primitive: usize) -> f32 {
        let triangle = &self.triangles[primitive];
        let t = triangle.intersect(ray);
        if t < ray.tmax
            && let Some(&mask) = self.masks.get(primitive)
            && mask != UNMASKED
        {
            let weights = triangle.compute_barycentric(ray).as_dvec2().to_array();
            if !self.cutouts.masks[mask as usize].passes(&self.cutouts.planes, fixed_point(weights)) {
                return f32::INFINITY;
            }
        }
        t
    }

    fn is_occluded(&self, segment: &Segment) -> bool {
        let Some(ray) = self.ray(segment) else { return false };
        !self.bvh.ray_traverse_miss(ray, |ray, primitive| self.intersect(ray, primitive))
    }

    fn distance(&self, segment: &Segment) -> Option<f32> {
        let ray = self.ray(segment)?;
        let mut hit = RayHit::none();
        self.bvh
            .ray_traverse(ray, &mut hit, |ray, primitive| self.intersect(ray, primitive))
            .then(|| hit.t * ray.direction.length())
    }
}

impl Visibility for BvhVisibility<'_> {
    fn name(&self) -> &'static str {
        "bvh"
    }

    fn occluded(&self, segments: &[Segment], occluded: &mut [u8]) -> Result<(), VisibilityError> {
        parallel::occluded(segments, occluded, |segment| self.is_occluded(segment));
        Ok(())
    }

    fn distances(&self, segments: &[Segment], distances: &mut [f32]) -> Result<(), VisibilityError> {
        parallel::distances(segments, distances, |segment| self.distance(segment));
        Ok(())
    }

    fn hidden_lights(
        &self,
        receivers: &[Receiver],
        lights: &[LightPoint],
        hidden: &mut [u32],
    ) -> Result<(), VisibilityError> {
        parallel::hidden_lights(receivers, lights, hidden, |segment| self.is_occluded(segment));
        Ok(())
    }
}
