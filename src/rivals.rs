//! What the row method is measured against: exact ray tracing, a brickmap, imperfect shadow maps.
//!
//! | name | what it is | runs on |
//! |---|---|---|
//! | `bvh` | [`bvh::BvhVisibility`]: obvhs' compressed wide BVH over the scene's triangles, as its authors use it | CPU |
//! | `wgsl-bvh` | [`wide_bvh`]: the same tree, traversed by our own shader | GPU, or its twin |
//! | `brickmap` | [`brickmap`]: marching through the octree's cells at a level | CPU, GPU |
//! | `ism` | [`ism`]: imperfect shadow maps | CPU |
//!
//! The judge is none of them: it is [`crate::reference::Reference`], in `f64`.

pub mod brickmap;
#[cfg(feature = "bake")]
pub mod bvh;
#[cfg(feature = "bake")]
pub mod ism;
#[cfg(feature = "bake")]
pub mod wide_bvh;
