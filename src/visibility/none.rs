//! `none`: nothing hides anything.

use crate::visibility::{Segment, Visibility, VisibilityError};

/// Light without shadows: only a receiver's own surface hides what is behind it.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoShadows;

impl Visibility for NoShadows {
    fn name(&self) -> &'static str {
        "none"
    }

    fn occluded(&self, segments: &[Segment], occluded: &mut [u8]) -> Result<(), VisibilityError> {
        assert_eq!(segments.len(), occluded.len(), "one answer for each segment");
        occluded.fill(0);
        Ok(())
    }

    fn distances(&self, segments: &[Segment], distances: &mut [f32]) -> Result<(), VisibilityError> {
        assert_eq!(segments.len(), distances.len(), "one answer for each segment");
        distances.fill(f32::INFINITY);
        Ok(())
    }
}
