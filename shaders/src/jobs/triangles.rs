//! Triangles, masks and alpha planes cut into pieces that fit buffers.

use super::Workspace;
use crate::constants::{LARGE_ROWS, MAX_WORKGROUPS};
use crate::device::{DeviceError, TriangleBatch};
use crate::executor::{Binding, BufferId, ExecutorLimits, Recording};
use crate::masks::{AlphaPlane, TriangleMask, UNMASKED};
use crate::stages::Stage;
use crate::types::{EyeTriangle, LargeItem, PackedPlane, PackedTriangle, RasterParams, pack_planes};
use std::ops::Range;

/// Buffers of a piece, in the order of bindings 2 ..= 5 of the stages that rasterize.
#[derive(Clone, Copy)]
pub(super) struct TriangleBuffers {
    pub(super) triangles: BufferId,
    pub(super) masks: BufferId,
    pub(super) planes: BufferId,
    pub(super) alpha: BufferId,
}

/// What is done with a piece.
pub(super) type PieceJob<'a> =
    dyn FnMut(&mut Workspace, TriangleBuffers, &[PackedTriangle]) -> Result<(), DeviceError> + 'a;

/// Alpha planes that fit one buffer together.
pub(super) struct PlaneGroup {
    pub(super) range: Range<usize>,
    pub(super) planes: Vec<PackedPlane>,
    pub(super) alpha: Vec<u32>,
}

/// Most triangles of a piece: what buffers hold, and at most `wanted`.
pub(super) fn piece_triangles(limits: ExecutorLimits, wanted: usize) -> usize {
    let sizes = [size_of::<TriangleMask>(), size_of::<PackedTriangle>(), size_of::<EyeTriangle>()];
    let fits = limits.binding_bytes / sizes.into_iter().fold(0, usize::max) as u64;
    wanted.min(fits as usize).max(1)
}

/// Runs `job` on pieces of at most `piece` triangles. All of `batch` is covered; masks, planes and alpha are uploaded,
/// the piece's triangles are for `job` to upload.
pub(super) fn for_each_piece(
    work: &mut Workspace,
    batch: &TriangleBatch,
    piece: usize,
    job: &mut PieceJob,
) -> Result<(), DeviceError> {
    check(batch)?;
    let groups = plane_groups(batch.planes, work.executor.limits().binding_bytes)?;
    let piece = piece.min(batch.triangles.len()).max(1);
    let triangles = work.buffer("triangles", (piece * size_of::<PackedTriangle>()) as u64)?;
    let most_masks = if batch.mask_of.is_empty() { 0 } else { piece };
    let masks = work.buffer("masks", (most_masks * size_of::<TriangleMask>()) as u64)?;
    for (number, group) in groups.iter().enumerate() {
        let planes = work.buffer("alpha planes", size_of_val(&group.planes[..]) as u64)?;
        let alpha = work.buffer("alpha texels", size_of_val(&group.alpha[..]) as u64)?;
        let mut recording = Recording::new();
        recording.upload(planes, &group.planes);
        recording.upload(alpha, &group.alpha);
        work.executor.run(&recording)?;
        let buffers = TriangleBuffers { triangles, masks, planes, alpha };

        let mut packed = Vec::new();
        let mut packed_masks = Vec::new();
        for (index, vertices) in batch.triangles.iter().enumerate() {
            let mut mask = batch.mask_of.get(index).copied().unwrap_or(UNMASKED);
            if mask == UNMASKED {
                if number > 0 {
                    continue;
                }
            } else {
                let full = batch.masks[mask as usize];
                if !group.range.contains(&(full.plane as usize)) {
                    continue;
                }
                mask = packed_masks.len() as u32;
                packed_masks.push(TriangleMask { plane: full.plane - group.range.start as u32, ..full });
            }
            packed.push(PackedTriangle::new(vertices, mask, index as u32));
            if packed.len() == piece {
                run_piece(work, buffers, &mut packed, &mut packed_masks, job)?;
            }
        }
        if !packed.is_empty() {
            run_piece(work, buffers, &mut packed, &mut packed_masks, job)?;
        }
    }
    Ok(())
}

fn run_piece(
    work: &mut Workspace,
    buffers: TriangleBuffers,
    triangles: &mut Vec<PackedTriangle>,
    masks: &mut Vec<TriangleMask>,
    job: &mut PieceJob,
) -> Result<(), DeviceError> {
    if !masks.is_empty() {
        let mut recording = Recording::new();
        recording.upload(buffers.masks, masks);
        work.executor.run(&recording)?;
    }
    job(work, buffers, triangles)?;
    triangles.clear();
    masks.clear();
    Ok(())
}

/// Refuses references that lead nowhere: a shader would read zeros there instead of failing.
fn check(batch: &TriangleBatch) -> Result<(), DeviceError> {
    let fail = |text: String| Err(DeviceError::Failed(text));
    if !batch.mask_of.is_empty() && batch.mask_of.len() != batch.triangles.len() {
        return fail(format!("{} triangles have {} masks", batch.triangles.len(), batch.mask_of.len()));
    }
    if let Some(mask) = batch.mask_of.iter().find(|&&m| m != UNMASKED && m as usize >= batch.masks.len()) {
        return fail(format!("a triangle refers to mask {mask} of {}", batch.masks.len()));
    }
    if let Some(mask) = batch.masks.iter().find(|m| m.plane as usize >= batch.planes.len()) {
        return fail(format!("a mask refers to alpha plane {} of {}", mask.plane, batch.planes.len()));
    }
    for (i, plane) in batch.planes.iter().enumerate() {
        let [width, height] = [plane.width, plane.height];
        let sides_fit = [width, height].iter().all(|side| (1..=32_768).contains(side));
        if !sides_fit || plane.alpha.len() as u64 != u64::from(width) * u64::from(height) {
            return fail(format!("alpha plane {i} of {width} x {height} has {} bytes", plane.alpha.len()));
        }
    }
    Ok(())
}

/// Cuts planes into groups of at most `limit_bytes`; there is always one group.
pub(super) fn plane_groups(planes: &[AlphaPlane], limit_bytes: u64) -> Result<Vec<PlaneGroup>, DeviceError> {
    let padded = |plane: &AlphaPlane| plane.alpha.len().next_multiple_of(4) as u64;
    let mut groups = Vec::new();
    let mut first = 0;
    loop {
        let mut end = first;
        let mut bytes = 0;
        let fits = |end: usize, bytes: u64| {
            bytes <= limit_bytes && ((end - first) * size_of::<PackedPlane>()) as u64 <= limit_bytes
        };
        while end < planes.len() && fits(end + 1, bytes + padded(&planes[end])) {
            bytes += padded(&planes[end]);
            end += 1;
        }
        if end == first && end < planes.len() {
            let needed_bytes = padded(&planes[end]);
            return Err(DeviceError::TooLarge { what: "an alpha plane", needed_bytes, limit_bytes });
        }
        let (packed, alpha) = pack_planes(&planes[first..end]);
        groups.push(PlaneGroup { range: first..end, planes: packed, alpha });
        if end == planes.len() {
            return Ok(groups);
        }
        first = end;
    }
}

/// The two stages that together do all triangles of a piece, and the buffers they need besides the piece's.
pub(super) struct TwoPass {
    pub(super) small: &'static Stage,
    pub(super) large: &'static Stage,
    pub(super) params: BufferId,
    pub(super) frames: BufferId,
    pub(super) queue: BufferId,
    pub(super) out: BufferId,
}

/// Bytes of a queue that holds every axis of `pairs` pairs of a triangle and a direction.
pub(super) fn queue_bytes(pairs: usize) -> u64 {
    4 + (pairs * 3 * size_of::<LargeItem>()) as u64
}

/// Most pairs whose queue fits a buffer.
pub(super) fn queue_pairs(limits: ExecutorLimits) -> usize {
    ((limits.binding_bytes - 4) / (3 * size_of::<LargeItem>()) as u64) as usize
}

impl TwoPass {
    /// Does the small triangles, then the large ones that the first pass queued. `head` is written to the start of
    /// `out` first.
    pub(super) fn run(
        &self,
        work: &mut Workspace,
        buffers: TriangleBuffers,
        params: RasterParams,
        triangles: &[PackedTriangle],
        head: &[u32],
    ) -> Result<(), DeviceError> {
        let params = [RasterParams { triangles: triangles.len() as u32, ..params }];
        let bindings = [
            self.params,
            self.frames,
            buffers.triangles,
            buffers.masks,
            buffers.planes,
            buffers.alpha,
            self.queue,
            self.out,
        ]
        .map(Binding::from);
        let mut recording = Recording::new();
        recording.upload(self.params, &params);
        recording.upload(buffers.triangles, triangles);
        recording.upload(self.queue, &[0u32]);
        if !head.is_empty() {
            recording.upload(self.out, head);
        }
        let groups = params[0].triangles.div_ceil(64);
        recording.dispatch(self.small, [groups, params[0].directions.max(1), 1], &bindings);
        recording.download(self.queue, 1);
        let large = work.executor.run(&recording)?[0][0];
        if large > 0 {
            let side =
                (0..3).map(|i| params[0].clip_max[i] - params[0].clip_min[i]).max().unwrap_or(0) as u32;
            let groups =
                [large.min(MAX_WORKGROUPS), large.div_ceil(MAX_WORKGROUPS), side.div_ceil(LARGE_ROWS)];
            let mut recording = Recording::new();
            recording.dispatch(self.large, groups, &bindings);
            work.executor.run(&recording)?;
        }
        Ok(())
    }
}
