//! Pictures of a scene in the light of thousands of lights: \[WMP\] Algorithm 3.
//!
//! # Theory
//! A G-buffer holds what is known of the surface in every pixel. For every pixel and every light, a method of testing
//! segments ([`crate::visibility::Visibility`]) says whether the light is hidden. The pixel's *shadow value* is
//! hidden lights / all lights; its radiance is the sum over the others.
//!
//! # Practice
//! [`scene`] prepares a scene, [`lights`] says where light comes from, [`gbuffer`] finds surfaces by rays on the CPU
//! or, on a GPU, by [`raster`]; [`image`] asks the method band by band and sums light by [`shade`]; [`glow`] draws the lights
//! themselves; [`methods`] is the
//! one place that makes methods from their names. [`compare`] measures how far two pictures are apart.
//!
//! Every picture depends on its inputs alone, not on threads; the G-buffers of CPU and GPU differ in pixels on edges.

pub mod compare;
pub mod gbuffer;
pub mod glow;
pub mod image;
pub mod lights;
mod lights_file;
pub mod methods;
pub mod raster;
pub mod read;
pub mod scene;
pub mod shade;
pub mod ssim;
mod textures;
