//! manyview: thousands to a million lights and views without ray-tracing hardware.

#[cfg(feature = "bake")]
pub mod bench;
pub mod rays;
#[cfg(feature = "bake")]
pub mod reference;
