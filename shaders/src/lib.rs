//! The GPU contract: what the bake writes and the runtime reads, every WGSL stage and its CPU twin. Knows no GPU API.
pub mod cases;
pub mod constants;
pub mod cpu_device;
pub mod device;
pub mod directions;
pub mod executor;
pub mod jobs;
pub mod masks;
pub mod octahedral;
pub mod raster;
pub mod rgb9e5;
pub mod sections;
pub mod srgb;
pub mod stages;
pub mod svo;
pub mod trig;
pub mod types;
