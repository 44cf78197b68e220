//! The voxel jobs as recordings of stages, run by the stages' twins, against plain loops. Needs no GPU.

use manyview_shaders::cases::{Case, Job, Random, cases, mask, random_triangles};
use manyview_shaders::cpu_device::CpuDevice;
use manyview_shaders::device::{DeviceError, PackedFragment, TriangleBatch, VoxelDevice};
use manyview_shaders::directions::DirectionFrame;
use manyview_shaders::executor::{CpuExecutor, ExecutorLimits};
use manyview_shaders::jobs;
use manyview_shaders::raster::{Grid, VoxelBox};

/// The jobs on twins.
struct TwinDevice(ExecutorLimits);

impl VoxelDevice for TwinDevice {
    fn name(&self) -> String {
        "twins".to_owned()
    }

    fn fragments(
        &self,
        grid: Grid,
        clip: &VoxelBox,
        batch: &TriangleBatch,
    ) -> Result<Vec<PackedFragment>, DeviceError> {
        jobs::fragments(&mut CpuExecutor::new(self.0), grid, clip, batch)
    }

    fn peel(&self, grid: Grid, clip: &VoxelBox, batch: &TriangleBatch) -> Result<Vec<u32>, DeviceError> {
        jobs::peel(&mut CpuExecutor::new(self.0), grid, clip, batch)
    }

    fn rotate_points(
        &self,
        bits: u32,
        frames: &[DirectionFrame],
        points: &[[i16; 3]],
    ) -> Result<Vec<u32>, DeviceError> {
        jobs::rotate_points(&mut CpuExecutor::new(self.0), bits, frames, points)
    }

    fn raster_rows(
        &self,
        bits: u32,
        frames: &[DirectionFrame],
        batch: &TriangleBatch,
        peel: bool,
    ) -> Result<Vec<u32>, DeviceError> {
        jobs::raster_rows(&mut CpuExecutor::new(self.0), bits, frames, batch, peel)
    }
}

#[test]
fn twins_agree_with_plain_loops() {
    let twins = TwinDevice(ExecutorLimits::DEFAULT);
    let mut set = 0;
    for case in cases() {
        let expected = case.run(&CpuDevice).expect("the CPU can");
        let found = case.run(&twins).unwrap_or_else(|e| panic!("{}: {e}", case.name));
        assert!(found == expected, "{}", case.name);
        set += usize::from(expected.iter().any(|&word| word != 0));
    }
    assert!(set > 100, "only {set} cases have any voxel");
}

#[test]
fn small_buffers_change_nothing() {
    // Lists and queues overflow, planes need groups, views need several images and windows.
    let twins = TwinDevice(ExecutorLimits { binding_bytes: 40_000, depth_side: 24 });
    for case in cases() {
        let bits = match case.job {
            Job::Fragments(grid, _) | Job::Peel(grid, _) => grid.bits,
            Job::RotatePoints(bits, _) | Job::RasterRows(bits, ..) => bits,
        };
        if bits <= 5 {
            let expected = case.run(&CpuDevice).expect("the CPU can");
            let found = case.run(&twins).unwrap_or_else(|e| panic!("{}: {e}", case.name));
            assert!(found == expected, "{}", case.name);
        }
    }
}

fn masked_case() -> Case {
    let mut case =
        cases().into_iter().find(|c| c.name.starts_with("fragments: small")).expect("there is one");
    mask(&mut Random::new(1), &mut case.geometry, 5);
    case
}

#[test]
fn what_does_not_fit_is_an_error() {
    let mut case = masked_case();
    let limit = case.geometry.planes.iter().map(|p| p.alpha.len()).max().expect("planes") as u64 - 4;
    let error = case.run(&TwinDevice(ExecutorLimits { binding_bytes: limit.max(128), depth_side: 64 }));
    assert!(matches!(error, Err(DeviceError::TooLarge { .. })), "{error:?}");

    let grid = Grid::new(7);
    case.job = Job::Peel(grid, VoxelBox::whole(grid));
    let error = case.run(&TwinDevice(ExecutorLimits { binding_bytes: 1 << 17, depth_side: 64 }));
    assert!(matches!(error, Err(DeviceError::TooLarge { .. })), "{error:?}");

    case.job = Job::Fragments(Grid::new(11), VoxelBox { min: [0; 3], max: [1025, 8, 8] });
    assert!(matches!(case.run(&TwinDevice(ExecutorLimits::DEFAULT)), Err(DeviceError::Failed(_))));
}

#[test]
fn wrong_references_are_errors() {
    let twins = TwinDevice(ExecutorLimits::DEFAULT);
    let mut case = masked_case();
    case.geometry.masks[0].plane = 99;
    assert!(case.run(&twins).is_err());
    let mut case = masked_case();
    case.geometry.masks.truncate(3);
    assert!(case.run(&twins).is_err());
    let mut case = masked_case();
    case.geometry.planes[0].alpha.pop();
    assert!(case.run(&twins).is_err());
    let mut case = masked_case();
    case.geometry.mask_of.pop();
    assert!(case.run(&twins).is_err());
}

#[test]
fn the_comparison_sees_a_single_wrong_voxel() {
    let mut case = masked_case();
    case.geometry.mask_of.clear();
    case.geometry.triangles = random_triangles(&mut Random::new(5), 50, 0, 2047, 1000);
    let before = case.run(&CpuDevice).expect("the CPU can");
    case.geometry.triangles[17][1][2] += 300;
    assert!(case.run(&CpuDevice).expect("the CPU can") != before);
}
