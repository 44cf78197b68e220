//! Instant radiosity: light that surfaces send on, from up to a million virtual point lights.
//!
//! # Theory
//! A. Keller, *Instant Radiosity*, SIGGRAPH 1997: paths from the scene's lights leave a *virtual point light* wherever they
//! hit a surface; those light the picture as that surface would. \[MV\] (Applications) draws a small map of depths for each of
//! them, so that a million can cast shadows, and lights every pixel by a random few of them.
//!
//! # Practice
//! [`Primaries`] are the lights that paths begin at, [`trace`] makes virtual lights, [`LightTree`] puts them in order,
//! [`Gather`] lights the pixels of a G-buffer by them, [`filter()`] takes the noise out. The same gather takes other lights at
//! positions, glowing particles say, which is why a [`VirtualLight`] may shine all around. [`points`] is another way to the same
//! light, without virtual lights.
//!
//! Every picture depends on its inputs alone, not on threads.
//!
//! \[MV\] Kol et al., *MegaViews*, CGF 2018, doi 10.1111/cgf.13527.

mod emission;
mod filter;
mod gather;
mod light_tree;
pub mod points;
mod receivers;
mod vpl;

pub use emission::Primaries;
pub use filter::{FilterOptions, filter};
pub use gather::{Gather, GatherOptions, Gathered, Samples, VIEW_LIFT_VOXELS};
pub use light_tree::LightTree;
pub use vpl::{MAX_BOUNCES, VirtualLights, VplOptions, trace};

use crate::views::View;
use glam::Vec3;
use manyview_pipeline::scene::{LightKind, PunctualLight};

/// The most virtual lights, or other lights that are gathered from.
pub const MAX_VIRTUAL_LIGHTS: usize = 1_000_000;

/// A small light that the picture is lit by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VirtualLight {
    /// Metres; a little off the surface that it stands for.
    pub position: [f32; 3],
    /// Unit normal of that surface, on the lit side; zero for a light that shines all around.
    pub normal: [f32; 3],
    /// Along the normal, candela; less by the cosine to the sides, so that the flux is π times as much. Without a normal the
    /// same all around.
    pub intensity: [f32; 3],
}

impl VirtualLight {
    /// A punctual light, if it is one that shines all around without end.
    pub fn from_point(light: &PunctualLight) -> Option<Self> {
        let is_plain = light.kind == LightKind::Point && light.range == f32::INFINITY;
        is_plain.then(|| Self {
            position: light.position.to_array(),
            normal: [0.0; 3],
            intensity: light.intensity.to_array(),
        })
    }

    /// Flux, lumens.
    pub fn flux(&self) -> Vec3 {
        let solid_angle = if self.normal == [0.0; 3] { 4.0 } else { 1.0 };
        Vec3::from(self.intensity) * std::f32::consts::PI * solid_angle
    }

    /// What it sees: the half space in front of it, from `lift_metres` off its surface.
    pub fn view(&self, lift_metres: f32) -> View {
        if self.normal == [0.0; 3] {
            return View::around(self.position);
        }
        let position = [0, 1, 2].map(|i| self.position[i] + self.normal[i] * lift_metres);
        View::new(position, self.normal, std::f32::consts::FRAC_PI_2)
    }
}
