use super::triangles::{TriangleBuffers, TwoPass, for_each_piece, piece_triangles, queue_bytes, queue_pairs};
use super::{Workspace, clip_size};
use crate::device::{DeviceError, PackedFragment, TriangleBatch};
use crate::executor::{BufferId, Executor, Recording};
use crate::raster::{Grid, VoxelBox};
use crate::stages;
use crate::types::{PackedTriangle, RasterParams};

/// Triangles of one dispatch.
const PIECE_TRIANGLES: usize = 1 << 18;
/// Words in front of a list's fragments: their count, and whether some were left out.
const HEAD_WORDS: usize = 2;

/// [`VoxelDevice::fragments`](crate::device::VoxelDevice::fragments) on an executor.
pub fn fragments(
    executor: &mut dyn Executor,
    grid: Grid,
    clip: &VoxelBox,
    batch: &TriangleBatch,
) -> Result<Vec<PackedFragment>, DeviceError> {
    if clip_size(clip)?.is_none() || batch.triangles.is_empty() {
        return Ok(Vec::new());
    }
    let limits = executor.limits();
    let piece = piece_triangles(limits, PIECE_TRIANGLES.min(batch.triangles.len()).min(queue_pairs(limits)));
    let mut list = List {
        params: RasterParams {
            clip_min: clip.min,
            grid_bits: grid.bits,
            clip_max: clip.max,
            sub_bits: grid.sub_bits,
            bit_stride: [0; 3],
            direction_stride: 0,
            triangles: 0,
            directions: 0,
            capacity: 0,
            reserved: 0,
        },
        most: ((limits.binding_bytes - 4 * HEAD_WORDS as u64) / 12) as u32,
        fragments: Vec::new(),
    };
    // Small triangles have a handful of fragments.
    let capacity = (8 * piece as u32).max(1024).min(list.most);
    let mut work = Workspace::new(executor);
    let mut pass = TwoPass {
        small: &stages::fragments,
        large: &stages::fragments_large,
        params: work.buffer("parameters", 64)?,
        frames: work.buffer("direction frames", 48)?,
        queue: work.buffer("large triangles", queue_bytes(piece))?,
        out: list.grow(&mut work, None, capacity)?,
    };
    for_each_piece(&mut work, batch, piece, &mut |work, buffers, triangles| {
        list.append(work, &mut pass, buffers, triangles)
    })?;
    Ok(list.fragments)
}

struct List {
    params: RasterParams,
    /// Most fragments that a buffer holds.
    most: u32,
    fragments: Vec<PackedFragment>,
}

impl List {
    fn grow(
        &mut self,
        work: &mut Workspace,
        old: Option<BufferId>,
        capacity: u32,
    ) -> Result<BufferId, DeviceError> {
        if let Some(old) = old {
            work.release(old);
        }
        self.params.capacity = capacity;
        work.buffer("fragments", 4 * HEAD_WORDS as u64 + 12 * u64::from(capacity))
    }

    fn append(
        &mut self,
        work: &mut Workspace,
        pass: &mut TwoPass,
        buffers: TriangleBuffers,
        triangles: &[PackedTriangle],
    ) -> Result<(), DeviceError> {
        loop {
            pass.run(work, buffers, self.params, triangles, &[0; HEAD_WORDS])?;
            let mut recording = Recording::new();
            recording.download(pass.out, HEAD_WORDS);
            let head = work.executor.run(&recording)?.remove(0);
            if head[1] == 0 {
                return self.read(work, pass.out, head[0]);
            }
            if self.params.capacity < self.most {
                let capacity = self.params.capacity.saturating_mul(4).min(self.most);
                pass.out = self.grow(work, Some(pass.out), capacity)?;
            } else if triangles.len() > 1 {
                let (first, second) = triangles.split_at(triangles.len() / 2);
                self.append(work, pass, buffers, first)?;
                return self.append(work, pass, buffers, second);
            } else {
                let sides = [0, 1, 2].map(|i| (self.params.clip_max[i] - self.params.clip_min[i]) as u64);
                return Err(DeviceError::TooLarge {
                    what: "the fragments of one triangle",
                    needed_bytes: 12 * (sides[0] * sides[1] + sides[1] * sides[2] + sides[2] * sides[0]),
                    limit_bytes: 12 * u64::from(self.most),
                });
            }
        }
    }

    fn read(&mut self, work: &mut Workspace, list: BufferId, count: u32) -> Result<(), DeviceError> {
        if count > 0 {
            let mut recording = Recording::new();
            recording.download(list, HEAD_WORDS + 3 * count as usize);
            let words = work.executor.run(&recording)?.remove(0);
            self.fragments.extend_from_slice(bytemuck::cast_slice(&words[HEAD_WORDS..]));
        }
        Ok(())
    }
}
