//! manyview: thousands to a million lights and views without ray-tracing hardware.

pub mod archive;
pub mod gpu;
pub mod npy;
pub mod preview;

pub use archive::{Archive, LoadError};
