//! Many views at once: what every method of drawing them has in common.
//!
//! A view's map holds the distance to what it sees in every direction, as a dual paraboloid
//! ([`manyview_shaders::paraboloid`]). [`ViewRenderer`]s are `megaviews` ([`crate::megaviews`]), `manylods`
//! ([`crate::manylods`]) and the exact `raycast`, so that commands, pictures and tables take any of them.

pub mod agreement;
#[cfg(feature = "bake")]
pub mod files;
mod maps;
pub mod methods;
#[cfg(feature = "bake")]
mod rasterized;
mod raycast;
#[cfg(feature = "bake")]
pub mod sample;
pub mod splat;
mod surfaces;
mod texels;

#[cfg(feature = "bake")]
pub use rasterized::Polygons;
pub use raycast::RayCast;
#[cfg(feature = "bake")]
pub use surfaces::TriangleSurfaces;
pub use surfaces::{OctreeSurfaces, Seen, Surfaces};

pub use manyview_shaders::views::View;
pub use maps::{Depths, ViewMaps};

use manyview_shaders::device::DeviceError;
use std::ops::RangeInclusive;
use thiserror::Error;

/// Sides of a map's halves that there can be, texels.
pub const RESOLUTIONS: RangeInclusive<u32> = 8..=1024;

/// How views are drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewSettings {
    /// Texels a side of each half: a power of two of [`RESOLUTIONS`].
    pub resolution: u32,
    /// Whether maps have colours beside depths.
    pub with_colors: bool,
    /// Keep depths as 16-bit floats: half the memory, and 0.05 % of error.
    pub half_depths: bool,
    /// What maps, queues and hierarchies may take together, bytes; views that do not fit at once are drawn in passes.
    pub budget_bytes: u64,
    /// How many texels across a node's sphere may be for it to be drawn as a point: less is more exact and slower. The
    /// papers' 1 takes twice as long as 1.5, where a node's cube still fills less than a texel.
    pub texels: f32,
    /// Drop what is outside the views' fields of view.
    pub culling: bool,
}

impl Default for ViewSettings {
    fn default() -> Self {
        Self {
            resolution: 16,
            with_colors: false,
            half_depths: false,
            budget_bytes: 4 << 30,
            texels: 1.5,
            culling: true,
        }
    }
}

impl ViewSettings {
    /// Settings of maps of this resolution, else the default.
    pub fn new(resolution: u32) -> Self {
        Self { resolution, ..Self::default() }
    }

    /// Checks what a user may have set.
    pub fn check(&self) -> Result<(), ViewError> {
        if !RESOLUTIONS.contains(&self.resolution) || !self.resolution.is_power_of_two() {
            return Err(ViewError::Resolution { resolution: self.resolution });
        }
        if !(self.texels > 0.0 && self.texels <= 64.0) {
            return Err(ViewError::Texels { texels: self.texels });
        }
        Ok(())
    }

    /// What [`manyview_shaders::views::is_small`] takes: the resolution over the texels that a node may fill.
    pub fn scale(&self) -> f32 {
        self.resolution as f32 / self.texels
    }

    /// The error of what takes more than the budget.
    pub fn over_budget(&self, what: &'static str, needed_bytes: u64) -> ViewError {
        ViewError::Budget { budget_bytes: self.budget_bytes, what, needed_bytes }
    }

    /// Bytes of one map as it is kept.
    pub fn map_bytes(&self) -> u64 {
        let texel = if self.half_depths { 2 } else { 4 } + if self.with_colors { 4 } else { 0 };
        manyview_shaders::paraboloid::texel_count(self.resolution) as u64 * texel
    }
}

/// Why views were not drawn.
#[derive(Debug, Error)]
pub enum ViewError {
    /// A resolution that is none.
    #[error("maps of {resolution} texels a side cannot be drawn: use 8, 16, 32, 64, 128, 256, 512 or 1024")]
    Resolution {
        /// The one asked for.
        resolution: u32,
    },
    /// A size of points that is none.
    #[error("points of {texels} texels cannot be drawn: use more than 0 and at most 64")]
    Texels {
        /// The one asked for.
        texels: f32,
    },
    /// Not even the smallest part fits.
    #[error(
        "the budget of {budget_bytes} bytes is too small for {what}, which takes {needed_bytes}: raise it, or lower the \
         resolution"
    )]
    Budget {
        /// The limit.
        budget_bytes: u64,
        /// What does not fit.
        what: &'static str,
        /// What that takes.
        needed_bytes: u64,
    },
    /// The method cannot do what was asked for.
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
    /// The caller asked to stop.
    #[error("cancelled")]
    Cancelled,
}

/// Takes the maps of one pass after the other. An error ends the drawing.
pub type PassSink<'a> = dyn FnMut(ViewMaps) -> Result<(), ViewError> + 'a;

/// A method of drawing views.
///
/// # Views
/// A view whose position is not finite has an empty map. An axis or angle that is no number sees all around. Views may lie
/// outside the scene cube. No view at all is no pass at all.
pub trait ViewRenderer: Sync {
    /// Its name as in `--method` and in tables.
    fn name(&self) -> &'static str;

    /// Draws the views in passes that keep to the budget; each view is in exactly one of them.
    fn render_passes(
        &self,
        views: &[View],
        settings: &ViewSettings,
        sink: &mut PassSink<'_>,
    ) -> Result<(), ViewError>;

    /// Draws all views at once; [`ViewError::Budget`] if their maps do not fit the budget.
    fn render_views(&self, views: &[View], settings: &ViewSettings) -> Result<ViewMaps, ViewError> {
        let mut all = ViewMaps::new(settings);
        self.render_passes(views, settings, &mut |pass| {
            let needed_bytes = all.bytes() + pass.bytes();
            if needed_bytes > settings.budget_bytes {
                let what = "all maps at once";
                return Err(settings.over_budget(what, needed_bytes));
            }
            all.append(pass);
            Ok(())
        })?;
        all.sort();
        Ok(all)
    }
}

impl<R: ViewRenderer + ?Sized> ViewRenderer for Box<R> {
    fn name(&self) -> &'static str {
        (**self).name()
    }

    fn render_passes(
        &self,
        views: &[View],
        settings: &ViewSettings,
        sink: &mut PassSink<'_>,
    ) -> Result<(), ViewError> {
        (**self).render_passes(views, settings, sink)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_that_make_no_sense_are_refused_with_the_way_out() {
        for resolution in [0, 4, 12, 2048] {
            let error = ViewSettings::new(resolution).check().unwrap_err().to_string();
            assert!(error.contains("use 8, 16"), "{error}");
        }
        for texels in [0.0, -1.0, f32::NAN, 65.0] {
            assert!(ViewSettings { texels, ..ViewSettings::default() }.check().is_err());
        }
        for resolution in [8, 16, 1024] {
            assert!(ViewSettings::new(resolution).check().is_ok());
        }
    }
}
