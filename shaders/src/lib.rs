//! The GPU contract.
pub mod raster;
