//! The obvious version of the bake's voxel jobs: plain loops over [`crate::raster`], one thread. What every other
//! backend is compared with.

use crate::device::{DeviceError, PackedFragment, TriangleBatch, VoxelDevice, grid_point};
use crate::directions::DirectionFrame;
use crate::masks::UNMASKED;
use crate::raster::{Fragment, Grid, Raster, VoxelBox};

/// See the module.
#[derive(Debug, Clone, Copy, Default)]
pub struct CpuDevice;

/// Visits every fragment that exists of every triangle along one axis, with the triangle's index.
fn visit(
    grid: Grid,
    clip: &VoxelBox,
    frame: Option<&DirectionFrame>,
    batch: &TriangleBatch,
    axis: usize,
    mut visit: impl FnMut(usize, Fragment),
) {
    for (index, triangle) in batch.triangles.iter().enumerate() {
        let vertices = match frame {
            Some(frame) => triangle.map(|p| grid_point(frame, grid, p)),
            None => triangle.map(|p| p.map(i32::from)),
        };
        let mask = match batch.mask_of.get(index) {
            None | Some(&UNMASKED) => None,
            Some(&mask) => Some(&batch.masks[mask as usize]),
        };
        if let Some(raster) = Raster::new(grid, &vertices, axis) {
            raster.fragments(clip, |fragment| {
                if mask.is_none_or(|mask| mask.passes(batch.planes, fragment.barycentric)) {
                    visit(index, fragment);
                }
            });
        }
    }
}

/// Peels all layers along all axes and visits their voxels.
fn peel_layers(
    grid: Grid,
    clip: &VoxelBox,
    frame: Option<&DirectionFrame>,
    batch: &TriangleBatch,
    mut found: impl FnMut([i32; 3]),
) {
    for axis in 0..3 {
        let (x, y) = ((axis + 1) % 3, (axis + 2) % 3);
        let [width, height] = [x, y].map(|i| (clip.max[i] - clip.min[i]).max(0) as usize);
        let pixel =
            |voxel: [i32; 3]| (voxel[y] - clip.min[y]) as usize * width + (voxel[x] - clip.min[x]) as usize;
        let mut previous = vec![i32::MIN; width * height];
        loop {
            let mut layer = vec![i32::MAX; width * height];
            visit(grid, clip, frame, batch, axis, |_, fragment| {
                let (depth, pixel) = (fragment.voxel[axis], pixel(fragment.voxel));
                if depth > previous[pixel] {
                    layer[pixel] = layer[pixel].min(depth);
                }
            });
            let mut empty = true;
            for (pixel, &depth) in layer.iter().enumerate().filter(|&(_, &depth)| depth != i32::MAX) {
                empty = false;
                let mut voxel = [depth; 3];
                voxel[x] = clip.min[x] + (pixel % width) as i32;
                voxel[y] = clip.min[y] + (pixel / width) as i32;
                found(voxel);
            }
            if empty {
                break;
            }
            previous = layer;
        }
    }
}

fn set(bits: &mut [u32], index: usize) {
    bits[index / 32] |= 1 << (index % 32);
}

fn row_bit(bits: u32, [u, v, w]: [u32; 3]) -> usize {
    ((((v << bits) | u) << bits) | w) as usize
}

impl VoxelDevice for CpuDevice {
    fn name(&self) -> String {
        "plain loops on one thread".to_owned()
    }

    fn fragments(
        &self,
        grid: Grid,
        clip: &VoxelBox,
        batch: &TriangleBatch,
    ) -> Result<Vec<PackedFragment>, DeviceError> {
        let mut fragments = Vec::new();
        for axis in 0..3 {
            visit(grid, clip, None, batch, axis, |index, fragment| {
                fragments.push(PackedFragment::new(fragment, clip.min, index as u32));
            });
        }
        Ok(fragments)
    }

    fn peel(&self, grid: Grid, clip: &VoxelBox, batch: &TriangleBatch) -> Result<Vec<u32>, DeviceError> {
        let size = [0, 1, 2].map(|i| (clip.max[i] - clip.min[i]).max(0) as usize);
        let mut bits = vec![0; (size[0] * size[1] * size[2]).div_ceil(32)];
        peel_layers(grid, clip, None, batch, |voxel| {
            let [x, y, z] = [0, 1, 2].map(|i| (voxel[i] - clip.min[i]) as usize);
            set(&mut bits, (z * size[1] + y) * size[0] + x);
        });
        Ok(bits)
    }

    fn rotate_points(
        &self,
        bits: u32,
        frames: &[DirectionFrame],
        points: &[[i16; 3]],
    ) -> Result<Vec<u32>, DeviceError> {
        let words = (1usize << (3 * bits)) / 32;
        let mut rows = vec![0; words * frames.len()];
        for (frame, rows) in frames.iter().zip(rows.chunks_mut(words.max(1))) {
            for &point in points {
                set(rows, row_bit(bits, frame.voxel(point, bits)));
            }
        }
        Ok(rows)
    }

    fn raster_rows(
        &self,
        bits: u32,
        frames: &[DirectionFrame],
        batch: &TriangleBatch,
        peel: bool,
    ) -> Result<Vec<u32>, DeviceError> {
        let (grid, words) = (Grid::new(bits), (1usize << (3 * bits)) / 32);
        let clip = VoxelBox::whole(grid);
        let mut rows = vec![0; words * frames.len()];
        for (frame, rows) in frames.iter().zip(rows.chunks_mut(words.max(1))) {
            let mut found = |voxel: [i32; 3]| set(rows, row_bit(bits, voxel.map(|c| c as u32)));
            if peel {
                peel_layers(grid, &clip, Some(frame), batch, found);
            } else {
                for axis in 0..3 {
                    visit(grid, &clip, Some(frame), batch, axis, |_, fragment| found(fragment.voxel));
                }
            }
        }
        Ok(rows)
    }
}
