//! manyview: thousands to a million lights and views without ray-tracing hardware.

pub mod archive;
#[cfg(feature = "bake")]
pub mod bench;
pub mod deform;
#[cfg(feature = "bake")]
pub mod exact;
pub mod gpu;
pub mod instances;
pub mod manylods;
pub mod megaviews;
pub mod npy;
pub mod preview;
#[cfg(feature = "bake")]
pub mod radiosity;
pub mod rays;
#[cfg(feature = "bake")]
pub mod reference;
pub mod reflect;
#[cfg(feature = "bake")]
pub mod render;
pub mod rivals;
pub mod scene_cpu;
mod simd;
pub mod views;
pub mod visibility;
pub mod wgsl;

#[doc = include_str!("../docs/load-a-bake.md")]
pub mod guide {}

pub use archive::{Archive, LoadError};
pub use gpu::{GpuScene, StreamOptions};
pub use scene_cpu::CpuScene;
