//! What every method of answering "is anything between two points?" has in common.
//!
//! Rows, exact ray tracing, brickmaps and shadow maps all answer the same two questions, so that commands, renderers
//! and tables take any of them: a batch of segments ([`Visibility::occluded`], [`Visibility::distances`]), and every
//! pair of a receiver and a light ([`Visibility::hidden_lights`]).

pub(crate) mod maps;
mod none;
pub(crate) mod parallel;
mod stage;

use manyview_shaders::device::DeviceError;
pub use manyview_shaders::types::{LightPoint, Receiver, Segment};
#[cfg(feature = "bake")]
pub(crate) use maps::LookUp;
pub use maps::{Bias, MapVisibility, is_hidden};
pub use none::NoShadows;
pub use stage::{MethodStages, StageVisibility};
use thiserror::Error;

/// Why a question was not answered.
#[derive(Debug, Error)]
pub enum VisibilityError {
    /// The method cannot answer this kind of question.
    #[error("`{method}` {problem}")]
    Unsupported {
        /// Name of the method.
        method: &'static str,
        /// What it cannot do, and what to use instead.
        problem: &'static str,
    },
    /// The GPU failed.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The lights' maps were not drawn.
    #[error(transparent)]
    Views(#[from] crate::views::ViewError),
}

/// A method of testing segments.
///
/// # Segments
/// A segment with a coordinate that is not finite, or whose ends are one point, is not occluded and hits nothing. Ends
/// may lie outside the scene's bounds. A normal of zero means that the origin is free, not on a surface.
pub trait Visibility: Sync {
    /// Its name as in `--method` and in tables.
    fn name(&self) -> &'static str;

    /// For each segment 1 where anything is between its ends, else 0.
    ///
    /// # Panics
    /// If the slices differ in length.
    fn occluded(&self, segments: &[Segment], occluded: &mut [u8]) -> Result<(), VisibilityError>;

    /// For each segment the distance in metres from its origin to the first hit, +infinity where there is none.
    ///
    /// # Panics
    /// If the slices differ in length.
    fn distances(&self, segments: &[Segment], distances: &mut [f32]) -> Result<(), VisibilityError>;

    /// Which lights each receiver does not see: bit `l % 32` of word `receiver * light_words(lights.len()) + l / 32`
    /// is set iff light l is hidden; bits beyond the last light are 0. A light that is not in front of a receiver's
    /// surface is hidden by that surface, without a test.
    ///
    /// # Panics
    /// If `hidden` has another length than `receivers.len() * light_words(lights.len())`.
    fn hidden_lights(
        &self,
        receivers: &[Receiver],
        lights: &[LightPoint],
        hidden: &mut [u32],
    ) -> Result<(), VisibilityError> {
        let words = light_words(lights.len());
        assert_eq!(hidden.len(), receivers.len() * words, "one bit for each receiver and light");
        let mut segments = Vec::with_capacity(lights.len());
        let mut occluded = vec![0; lights.len()];
        for (receiver, hidden) in receivers.iter().zip(hidden.chunks_mut(words.max(1))) {
            segments.clear();
            segments.extend(lights.iter().map(|light| light.segment_from(receiver)));
            self.occluded(&segments, &mut occluded)?;
            hidden.fill(0);
            for (light, &bit) in occluded.iter().enumerate() {
                let is_hidden = bit == 1 || lights[light].is_behind(receiver);
                hidden[light / 32] |= u32::from(is_hidden) << (light % 32);
            }
        }
        Ok(())
    }
}

/// Words that hold one bit for each of `lights` lights.
pub fn light_words(lights: usize) -> usize {
    lights.div_ceil(32)
}

impl<V: Visibility + ?Sized> Visibility for &V {
    fn name(&self) -> &'static str {
        (**self).name()
    }

    fn occluded(&self, segments: &[Segment], occluded: &mut [u8]) -> Result<(), VisibilityError> {
        (**self).occluded(segments, occluded)
    }

    fn distances(&self, segments: &[Segment], distances: &mut [f32]) -> Result<(), VisibilityError> {
        (**self).distances(segments, distances)
    }

    fn hidden_lights(
        &self,
        receivers: &[Receiver],
        lights: &[LightPoint],
        hidden: &mut [u32],
    ) -> Result<(), VisibilityError> {
        (**self).hidden_lights(receivers, lights, hidden)
    }
}
