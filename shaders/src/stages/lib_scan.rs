//! What the twins of the stages that rasterize share, as `lib_scan.wgsl` does.

use crate::constants::{LARGE_ROWS, MAX_WORKGROUPS, SMALL_PIXELS};
use crate::device::grid_point;
use crate::directions::DirectionFrame;
use crate::executor::CpuBinding;
use crate::masks::TriangleMask;
use crate::raster::{Fragment, Raster};
use crate::types::{LargeItem, PackedPlane, PackedTriangle, RasterParams};

/// Bindings 0 ..= 5 of the stages that rasterize.
pub(super) struct Inputs<'a> {
    pub(super) params: RasterParams,
    pub(super) frames: &'a [DirectionFrame],
    pub(super) triangles: &'a [PackedTriangle],
    pub(super) masks: &'a [TriangleMask],
    pub(super) planes: &'a [PackedPlane],
    pub(super) alpha: &'a [u32],
}

impl<'a> Inputs<'a> {
    pub(super) fn new(bindings: &'a [CpuBinding]) -> Self {
        Self {
            params: bindings[0].first(),
            frames: bindings[1].slice(),
            triangles: bindings[2].slice(),
            masks: bindings[3].slice(),
            planes: bindings[4].slice(),
            alpha: bindings[5].words(),
        }
    }

    pub(super) fn project(&self, triangle: u32, direction: u32, axis: u32) -> Option<Raster> {
        let vertices = self.triangles[triangle as usize].vertices();
        let vertices = match self.params.directions {
            0 => vertices.map(|p| p.map(i32::from)),
            _ => vertices.map(|p| grid_point(&self.frames[direction as usize], self.params.grid(), p)),
        };
        Raster::new(self.params.grid(), &vertices, axis as usize)
    }

    /// One invocation of a stage that does small triangles: every axis is either scanned or queued.
    pub(super) fn scan_small(
        &self,
        workgroups: [u32; 3],
        queue: &mut [u32],
        mut emit: impl FnMut(u32, u32, Fragment),
    ) {
        for direction in 0..workgroups[1] {
            for triangle in 0..self.params.triangles.min(workgroups[0] * 64) {
                for axis in 0..3 {
                    let Some(raster) = self.project(triangle, direction, axis) else { continue };
                    let [min, max] = raster.pixels(&self.params.clip());
                    if min[0] > max[0] || min[1] > max[1] {
                        continue;
                    }
                    if (max[0] - min[0] + 1) as u32 * (max[1] - min[1] + 1) as u32 <= SMALL_PIXELS {
                        self.scan(&raster, triangle, direction, &mut emit);
                    } else {
                        let at = 1 + 3 * queue[0] as usize;
                        let item = LargeItem { triangle, direction, axis };
                        queue[at..at + 3].copy_from_slice(bytemuck::cast_slice(&[item]));
                        queue[0] += 1;
                    }
                }
            }
        }
    }

    /// One workgroup of a stage that does large triangles.
    pub(super) fn scan_large(
        &self,
        workgroups: [u32; 3],
        queue: &CpuBinding,
        mut emit: impl FnMut(u32, u32, Fragment),
    ) {
        let (&count, items) = queue.words().split_first().expect("a queue has a count");
        for index in 0..count.min(workgroups[1] * MAX_WORKGROUPS + workgroups[0]) {
            let item: LargeItem = bytemuck::cast_slice(&items[3 * index as usize..][..3])[0];
            let raster = self.project(item.triangle, item.direction, item.axis).expect("queued");
            let first_row = raster.pixels(&self.params.clip())[0][1];
            let y = (item.axis as usize + 2) % 3;
            for strip in 0..workgroups[2] {
                let mut clip = self.params.clip();
                clip.min[y] = first_row + (strip * LARGE_ROWS) as i32;
                clip.max[y] = clip.max[y].min(clip.min[y] + LARGE_ROWS as i32);
                raster.fragments(&clip, |fragment| {
                    self.keep_visible(item.triangle, item.direction, fragment, &mut emit);
                });
            }
        }
    }

    fn scan(
        &self,
        raster: &Raster,
        triangle: u32,
        direction: u32,
        emit: &mut impl FnMut(u32, u32, Fragment),
    ) {
        raster.fragments(&self.params.clip(), |fragment| {
            self.keep_visible(triangle, direction, fragment, emit);
        });
    }

    fn keep_visible(
        &self,
        triangle: u32,
        direction: u32,
        fragment: Fragment,
        emit: &mut impl FnMut(u32, u32, Fragment),
    ) {
        let packed = &self.triangles[triangle as usize];
        if packed.passes(self.masks, self.planes, self.alpha, fragment.barycentric) {
            emit(triangle, direction, fragment);
        }
    }

    /// Sets a fragment's bit, as `lib_emit_bit.wgsl` does.
    pub(super) fn emit_bit(&self, bits: &mut [u32], direction: u32, fragment: Fragment) {
        let bit = self.params.bit(direction, fragment.voxel);
        bits[bit as usize / 32] |= 1 << (bit % 32);
    }

    /// Appends a fragment to a list, as `lib_emit_fragment.wgsl` does.
    pub(super) fn emit_fragment(&self, list: &mut [u32], triangle: u32, fragment: Fragment) {
        if list[0] >= self.params.capacity {
            list[1] = 1;
            return;
        }
        let at = 2 + 3 * list[0] as usize;
        let packed = crate::device::PackedFragment::new(
            fragment,
            self.params.clip_min,
            self.triangles[triangle as usize].index,
        );
        list[at..at + 3].copy_from_slice(bytemuck::cast_slice(&[packed]));
        list[0] += 1;
    }
}
