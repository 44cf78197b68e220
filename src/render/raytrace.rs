//! Exact ray tracing as a method: the judge of the others.

use crate::reference::Reference;
use crate::visibility::{Segment, Visibility, VisibilityError};
use crate::visibility::{LightPoint, Receiver, light_words};
use glam::DVec3;
use rayon::prelude::*;

/// The origin leaves its surface by this share of the scene's half diagonal.
const LIFT_SHARE: f64 = 1e-6;
/// A coordinate is rounded to `f32` by up to 2^-24 of its value; this is safely more.
const ROUNDING_SHARE: f64 = 2.5e-7;

/// Exact rays over the scene's triangles, alpha cut-outs included ([`Reference`]).
///
/// An origin on a surface is lifted along its normal by a millionth of the scene's half diagonal, or a little more
/// than what rounding may have pushed it below the surface, whichever is larger.
pub struct RayTraced<'a> {
    reference: &'a Reference<'a>,
    lift: f64,
}

impl<'a> RayTraced<'a> {
    /// Rays in a scene within `bounds`, metres.
    pub fn new(reference: &'a Reference<'a>, bounds: [DVec3; 2]) -> Self {
        let farthest = bounds[0].abs().max(bounds[1].abs()).max_element();
        let lift = ((bounds[1] - bounds[0]).length() * 0.5 * LIFT_SHARE).max(farthest * ROUNDING_SHARE);
        Self { reference, lift }
    }

    fn origin(&self, segment: &Segment) -> DVec3 {
        point(segment.origin) + point(segment.normal) * self.lift
    }

    fn is_occluded(&self, segment: &Segment) -> bool {
        let target = point(segment.target);
        point(segment.origin) != target && self.reference.is_occluded(self.origin(segment), target)
    }
}

fn point(p: [f32; 3]) -> DVec3 {
    DVec3::from_array(p.map(f64::from))
}

impl Visibility for RayTraced<'_> {
    fn name(&self) -> &'static str {
        "raytrace"
    }

    fn occluded(&self, segments: &[Segment], occluded: &mut [u8]) -> Result<(), VisibilityError> {
        assert_eq!(segments.len(), occluded.len(), "an answer for each segment");
        segments
            .par_iter()
            .zip(occluded)
            .for_each(|(segment, answer)| *answer = u8::from(self.is_occluded(segment)));
        Ok(())
    }

    fn distances(&self, segments: &[Segment], distances: &mut [f32]) -> Result<(), VisibilityError> {
        assert_eq!(segments.len(), distances.len(), "an answer for each segment");
        segments.par_iter().zip(distances).for_each(|(segment, distance)| {
            let way = point(segment.target) - point(segment.origin);
            let hit = match way == DVec3::ZERO {
                true => None,
                false => self.reference.intersect(self.origin(segment), point(segment.target) - self.origin(segment), 1.0),
            };
            *distance = hit.map_or(f32::INFINITY, |hit| (hit.t * way.length()) as f32);
        });
        Ok(())
    }

    fn hidden_lights(
        &self,
        receivers: &[Receiver],
        lights: &[LightPoint],
        hidden: &mut [u32],
    ) -> Result<(), VisibilityError> {
        let words = light_words(lights.len());
        assert_eq!(hidden.len(), receivers.len() * words, "one bit for each receiver and light");
        if words > 0 {
            receivers.par_iter().zip(hidden.par_chunks_mut(words)).for_each(|(receiver, hidden)| {
                for (word, lights) in hidden.iter_mut().zip(lights.chunks(32)) {
                    *word = lights.iter().enumerate().fold(0, |bits, (i, light)| {
                        bits | u32::from(self.is_occluded(&light.segment_from(receiver))) << i
                    });
                }
            });
        }
        Ok(())
    }
}
