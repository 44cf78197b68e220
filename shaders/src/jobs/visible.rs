//! Which triangle a camera sees in every pixel.

use super::Workspace;
use super::triangles::{piece_triangles, plane_groups};
use crate::device::DeviceError;
use crate::executor::{Binding, BufferId, DepthId, Executor, Recording};
use crate::masks::{AlphaPlane, TriangleMask, UNMASKED};
use crate::stages;
use crate::types::{EyeTriangle, ViewParams};

/// Triangles that are uploaded together.
const PIECE_TRIANGLES: usize = 1 << 20;

/// Triangles in front of a camera, and how alpha cuts them.
pub struct VisibleBatch<'a> {
    /// How many there are.
    pub count: usize,
    /// Vertices of a triangle along world axes, from the eye, metres.
    pub vertices: &'a dyn Fn(usize) -> [[f32; 3]; 3],
    /// Index of each triangle's mask, or [`UNMASKED`]; empty if there are no masks.
    pub mask_of: &'a [u32],
    /// The masks.
    pub masks: &'a [TriangleMask],
    /// The alpha that they read.
    pub planes: &'a [AlphaPlane],
}

/// Index of the nearest triangle for every pixel of `view`, row by row, `u32::MAX` where there is none; of equally near
/// triangles the one with the smallest index.
pub fn visible_triangles(
    executor: &mut dyn Executor,
    view: &ViewParams,
    batch: &VisibleBatch<'_>,
) -> Result<Vec<u32>, DeviceError> {
    let limits = executor.limits();
    let size = [view.width, view.height];
    let pixels = view.width as usize * view.height as usize;
    if size.iter().any(|&side| side > limits.depth_side) {
        let [width, height] = size;
        return Err(DeviceError::Failed(format!(
            "a picture of {width} × {height} pixels exceeds the limit of {} a side",
            limits.depth_side
        )));
    }
    let piece = piece_triangles(limits, PIECE_TRIANGLES).min(batch.count).max(1);
    let mut work = Workspace::new(executor);
    let params = work.buffer("the view", size_of::<ViewParams>() as u64)?;
    let triangles = work.buffer("triangles", (piece * size_of::<EyeTriangle>()) as u64)?;
    let most_masks = if batch.masks.is_empty() { 0 } else { piece };
    let masks = work.buffer("masks", (most_masks * size_of::<TriangleMask>()) as u64)?;
    let seen = work.buffer("visible triangles", 4 * pixels as u64)?;
    let images = [work.depth_image(size)?, work.depth_image(size)?];
    let groups = plane_groups(batch.planes, limits.binding_bytes)?;

    let nothing = vec![u32::MAX; pixels];
    let mut recording = Recording::new();
    recording.upload(seen, &nothing);
    recording.clear_depth(images[0], 1.0);
    recording.clear_depth(images[1], 1.0);
    work.executor.run(&recording)?;
    drop(nothing);
    // The nearest distances first, into the first image; the second is not looked at.
    for (collect, [target, nearest]) in [(0, images), (1, [images[1], images[0]])] {
        let view = [ViewParams { collect, ..*view }];
        for (number, group) in groups.iter().enumerate() {
            let planes = work.buffer("alpha planes", size_of_val(&group.planes[..]) as u64)?;
            let alpha = work.buffer("alpha texels", size_of_val(&group.alpha[..]) as u64)?;
            let mut recording = Recording::new();
            recording.upload(params, &view);
            recording.upload(planes, &group.planes);
            recording.upload(alpha, &group.alpha);
            work.executor.run(&recording)?;
            let bindings = [params, triangles, masks, planes, alpha].map(Binding::from);
            let bindings = [&bindings[..], &[nearest.into(), seen.into()]].concat();
            let mut pieces = Pieces {
                bindings: &bindings,
                target,
                triangles,
                masks,
                packed: Vec::new(),
                cuts: Vec::new(),
            };
            for index in 0..batch.count {
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
                    mask = pieces.cuts.len() as u32;
                    pieces.cuts.push(TriangleMask { plane: full.plane - group.range.start as u32, ..full });
                }
                pieces.packed.push(EyeTriangle::new((batch.vertices)(index), mask, index as u32));
                if pieces.packed.len() == piece {
                    pieces.draw(&mut work)?;
                }
            }
            pieces.draw(&mut work)?;
            work.release(planes);
            work.release(alpha);
        }
    }
    let mut recording = Recording::new();
    recording.download(seen, pixels);
    Ok(work.executor.run(&recording)?.remove(0))
}

/// Triangles on their way to the depth image.
struct Pieces<'a> {
    bindings: &'a [Binding],
    target: DepthId,
    triangles: BufferId,
    masks: BufferId,
    packed: Vec<EyeTriangle>,
    cuts: Vec<TriangleMask>,
}

impl Pieces<'_> {
    fn draw(&mut self, work: &mut Workspace) -> Result<(), DeviceError> {
        if self.packed.is_empty() {
            return Ok(());
        }
        let mut recording = Recording::new();
        recording.upload(self.triangles, &self.packed);
        if !self.cuts.is_empty() {
            recording.upload(self.masks, &self.cuts);
        }
        let vertices = 3 * self.packed.len() as u32;
        recording.draw(&stages::visible_triangles, [vertices, 1], self.bindings, self.target);
        work.executor.run(&recording)?;
        self.packed.clear();
        self.cuts.clear();
        Ok(())
    }
}
