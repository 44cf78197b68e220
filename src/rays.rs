//! Constant-time segment tests against the rows of a bake, on the CPU.
//!
//! # Theory
//! \[WMP\] Algorithms 2 and 3. What a test computes, and where it departs from the paper, is in
//! [`manyview_shaders::row_test`]; the same text runs on GPUs (`lib_rows.wgsl`) and gives the same answers.
//!
//! # Practice
//! [`RowTester`] holds the rows and is a [`Visibility`](crate::visibility::Visibility). Lights are tested for 16 neighbouring receivers at a time
//! (`kernel`): most of them see a light in the same sampled direction, so that its frame is loaded once and all
//! arithmetic is done in vectors. Blocks of 32 lights over 16 receivers keep the touched rows in the first-level cache.
//! Batches of segments are brought into the order of their directions first.

mod kernel;
pub mod paper;
mod stage;
mod tester;
#[cfg(all(test, feature = "bake"))]
mod tests;

pub use crate::simd::SimdLevel;
pub use manyview_shaders::row_test::{Rows, TestSettings};
pub use stage::{RowTables, on_gpu, on_twins};
pub use tester::RowTester;
