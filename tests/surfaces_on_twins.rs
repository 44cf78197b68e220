//! The surfaces of a picture's pixels by the rasterizer's CPU twin against rays. Needs no GPU.
#![cfg(feature = "bake")]

mod surfaces;

use manyview_shaders::executor::{CpuExecutor, ExecutorLimits};
use surfaces::{cases, expect_agreement, seen};

#[test]
fn the_twin_and_rays_see_the_same_triangles() {
    for case in cases() {
        expect_agreement(&case, &seen(&mut CpuExecutor::default(), &case)).unwrap();
    }
}

#[test]
fn small_buffers_change_nothing() {
    let limits = ExecutorLimits { binding_bytes: 90_000, ..ExecutorLimits::DEFAULT };
    for case in cases().into_iter().skip(2).take(1) {
        assert_eq!(
            seen(&mut CpuExecutor::new(limits), &case),
            seen(&mut CpuExecutor::default(), &case),
            "{}",
            case.name
        );
    }
}
