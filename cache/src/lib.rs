//! Bytes at rest: the archive container, digests and atomic files. Knows nothing of voxels.

pub mod archive;
pub mod atomic;
pub mod digest;
