//! Exact rays as a method among others.

use crate::reference::Reference;
use crate::visibility::{LightPoint, Receiver, Segment, Visibility, VisibilityError, parallel};
use glam::DVec3;
use std::borrow::Borrow;
use std::marker::PhantomData;

/// The exact ray tracer behind [`Visibility`]: method `exact`.
///
/// A segment that starts on a surface does not hit it there: only hits strictly between the ends count, and an origin
/// with a normal is lifted along it by [`LIFT`] of the scene's diagonal, which is what `f32` coordinates of a surface
/// point may lie below it.
pub struct ExactRays<'a, R = Reference<'a>> {
    reference: R,
    scene: PhantomData<&'a ()>,
    /// Corners of a box around the scene, with room to spare.
    around: [DVec3; 2],
    lift_metres: f64,
}

/// How far origins with a normal are lifted, as a share of the scene's diagonal. The rounding of a coordinate is less
/// than 1e-7 of it.
pub const LIFT: f64 = 1e-6;
/// Or this share of the scene's largest coordinate, if that is more: four times what `f32` rounds it by.
const ROUNDING: f64 = 2.4e-7;

/// How far origins on surfaces are lifted in a scene of these bounds.
pub(crate) fn lift_metres(min: DVec3, max: DVec3) -> f64 {
    // Far from the origin of the world, coordinates are rounded to more than a share of the diagonal.
    let rounding = min.abs().max(max.abs()).max_element() * ROUNDING;
    ((max - min).length() * LIFT).max(rounding)
}

impl<'a, R: Borrow<Reference<'a>>> ExactRays<'a, R> {
    /// Takes the ray tracer, or borrows it.
    pub fn new(reference: R) -> Self {
        let triangles = reference.borrow().triangles();
        let first = triangles.first().map_or(DVec3::ZERO, |t| t[0]);
        let (min, max) =
            triangles.iter().flatten().fold((first, first), |(min, max), &p| (min.min(p), max.max(p)));
        let diagonal = (max - min).length();
        let around = [min - diagonal * 0.01, max + diagonal * 0.01];
        Self { reference, scene: PhantomData, around, lift_metres: lift_metres(min, max) }
    }

    /// The ray tracer.
    pub fn reference(&self) -> &Reference<'a> {
        self.reference.borrow()
    }

    /// How far an origin with a normal is lifted along it, metres.
    pub fn lift_metres(&self) -> f64 {
        self.lift_metres
    }

    /// Both ends of a testable segment in `f64`, the origin lifted; `None` where it passes the scene by. Ends
    /// outside are brought to the scene's bounds, since the BVH's `f32` cannot tell far ones apart; the number is how
    /// far the origin has come, metres.
    fn ends(&self, segment: &Segment) -> Option<([DVec3; 2], f64)> {
        let [origin, target, normal] =
            [segment.origin, segment.target, segment.normal].map(|v| DVec3::from_array(v.map(f64::from)));
        let origin = origin + normal.normalize_or_zero() * self.lift_metres;
        let way = target - origin;
        let (mut enter, mut leave) = (0.0f64, 1.0f64);
        for axis in 0..3 {
            let to = |corner: DVec3| (corner[axis] - origin[axis]) / way[axis];
            let (a, b) = (to(self.around[0]), to(self.around[1]));
            // Not a number where the segment runs within a face: then the other axes decide.
            (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
        }
        let at = |t: f64| if t == 1.0 { target } else { origin + way * t };
        (enter <= leave).then(|| ([at(enter), at(leave)], enter * way.length()))
    }

    fn is_occluded(&self, segment: &Segment) -> bool {
        self.ends(segment).is_some_and(|([origin, target], _)| self.reference().is_occluded(origin, target))
    }
}

impl<'a, R: Borrow<Reference<'a>> + Sync> Visibility for ExactRays<'a, R> {
    fn name(&self) -> &'static str {
        "exact"
    }

    fn occluded(&self, segments: &[Segment], occluded: &mut [u8]) -> Result<(), VisibilityError> {
        parallel::occluded(segments, occluded, |segment| self.is_occluded(segment));
        Ok(())
    }

    fn distances(&self, segments: &[Segment], distances: &mut [f32]) -> Result<(), VisibilityError> {
        parallel::distances(segments, distances, |segment| {
            let ([origin, target], before) = self.ends(segment)?;
            let direction = (target - origin).normalize_or_zero();
            let hit = self.reference().intersect(origin, direction, (target - origin).length())?;
            Some((before + hit.t) as f32)
        });
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

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat4, Vec3};
    use manyview_pipeline::scene::{Instance, Mesh, Scene};
    use manyview_pipeline::triangles::{Cutouts, LatticeTriangles};

    #[test]
    fn a_wall_hides_what_is_behind_it_and_not_what_is_on_it() {
        let square = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        let scene = Scene {
            meshes: vec![Mesh {
                positions: square.iter().map(|&[x, y]| Vec3::new(x, y, 0.0)).collect(),
                triangles: vec![[0, 1, 2], [0, 2, 3]],
                ..Mesh::default()
            }],
            instances: vec![Instance { mesh: 0, world_from_object: DMat4::from_scale(DVec3::splat(0.1)) }],
            ..Scene::default()
        };
        let cutouts = Cutouts::new(&scene);
        let drawn = LatticeTriangles::new(&scene, &cutouts, |_| [0; 3]);
        let exact = ExactRays::new(Reference::new(&scene, &drawn, &cutouts));
        let segment = |from: f32, to: f32, normal: f32| Segment {
            origin: [0.01, 0.02, from],
            target: [0.01, 0.02, to],
            normal: [0.0, 0.0, normal],
        };
        let below = -5e-9;
        let cases = [
            (segment(1.0, -1.0, 0.0), 1, 1.0),
            (segment(1.0, 0.5, 0.0), 0, f32::INFINITY),
            (segment(-2.0, 1.0, 0.0), 1, 2.0),
            (segment(below, 1.0, 1.0), 0, f32::INFINITY),
            (segment(below, 1.0, 0.0), 1, -below),
            (segment(1.0, 1.0, 0.0), 0, f32::INFINITY),
            (segment(f32::NAN, -1.0, 0.0), 0, f32::INFINITY),
            (segment(1.0, f32::NEG_INFINITY, 0.0), 0, f32::INFINITY),
            (segment(1.0, -f32::MAX, 0.0), 0, f32::INFINITY),
            (segment(1.0, -1e18, f32::NAN), 1, 1.0),
            (segment(1e6, -1e6, 0.0), 1, 1e6),
            (segment(1e6, 1e5, 0.0), 0, f32::INFINITY),
        ];
        let segments = cases.map(|case| case.0);
        let (mut occluded, mut distances) = ([7; 12], [7.0; 12]);
        exact.occluded(&segments, &mut occluded).unwrap();
        exact.distances(&segments, &mut distances).unwrap();
        assert_eq!(occluded, cases.map(|case| case.1));
        assert_eq!(distances, cases.map(|case| case.2));
        let receivers = [Receiver { position: [0.0, 0.0, -0.01], normal: [0.0; 3] }];
        let lights = [LightPoint::at([0.0, 0.0, 3.0]), LightPoint::at([0.0, 0.0, -3.0])];
        let mut hidden = [u32::MAX];
        exact.hidden_lights(&receivers, &lights, &mut hidden).unwrap();
        assert_eq!(hidden, [1]);
    }
}
