//! manyview: thousands to a million lights and views without ray-tracing hardware.
pub mod gpu;
