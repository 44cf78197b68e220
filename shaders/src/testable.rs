//! Which segments can be tested at all: the rules of [`Segment`]s that are no segments, the same for every method.

use crate::row_test::all_within;
use crate::types::Segment;

/// The shortest segment that is tested, metres squared: below it a square is no longer exact.
pub const MIN_LENGTH_SQUARED: f32 = 1e-30;

/// Coordinates of unit normals are at most that, with room for rounding.
pub const MAX_NORMAL: f32 = 2.0;

/// Whether a [`testable`] segment's target is not in front of the surface that its origin is on.
#[inline]
pub fn is_behind(segment: &Segment) -> bool {
    let along = [0, 1, 2].map(|i| segment.target[i] - segment.origin[i]);
    let n = segment.normal;
    n != [0.0; 3] && along[0] * n[0] + along[1] * n[1] + along[2] * n[2] <= 0.0
}

/// The segment as methods take it, or `None` if nothing can be between its ends: a coordinate is not finite, the ends
/// are one point (or closer than 10⁻¹⁵ m), or farther apart than an `f32` can square (10¹⁹ m). A normal with a
/// coordinate that is not finite or beyond [`MAX_NORMAL`] counts as none.
#[inline]
pub fn testable(segment: &Segment) -> Option<Segment> {
    let finite = |v: &[f32; 3]| v.iter().all(|c| c.is_finite());
    let along = [0, 1, 2].map(|i| segment.target[i] - segment.origin[i]);
    let length_squared = along[0] * along[0] + along[1] * along[1] + along[2] * along[2];
    let usable = finite(&segment.origin)
        && finite(&segment.target)
        && length_squared.is_finite()
        && length_squared > MIN_LENGTH_SQUARED;
    let normal = if all_within(segment.normal, MAX_NORMAL) { segment.normal } else { [0.0; 3] };
    usable.then_some(Segment { normal, ..*segment })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_segment_is_not_tested() {
        let up = |from: f32, to: f32| Segment {
            origin: [0.0, from, 0.0],
            target: [0.0, to, 0.0],
            normal: [0.0, 1.0, 0.0],
        };
        assert!(testable(&up(0.0, 1.0)).is_some() && testable(&up(1e-9, 0.0)).is_some());
        for (from, to) in [
            (1.0, 1.0),
            (0.0, 1e-20),
            (f32::NAN, 1.0),
            (0.0, f32::INFINITY),
            (f32::NEG_INFINITY, f32::INFINITY),
            (-3e38, 3e38),
        ] {
            assert_eq!(testable(&up(from, to)), None, "{from} to {to}");
        }
        let strange = Segment { normal: [f32::NAN, 1.0, 0.0], ..up(0.0, 1.0) };
        assert_eq!(testable(&strange).map(|s| s.normal), Some([0.0; 3]));
    }
}
