use super::lib_scan::Inputs;
use crate::constants::PEEL_DEPTHS;
use crate::executor::{CpuBinding, DepthImage};
use crate::types::{PeelParams, PeelView};

pub(super) fn twin(counts: [u32; 2], bindings: &mut [CpuBinding], target: &mut DepthImage) {
    let [params, peel, inputs @ .., views, previous] = bindings else {
        unreachable!("checked against the table")
    };
    let [frames, triangles, masks, planes, alpha] = inputs else { unreachable!("checked against the table") };
    let inputs = Inputs {
        params: params.first(),
        frames: frames.slice(),
        triangles: triangles.slice(),
        masks: masks.slice(),
        planes: planes.slice(),
        alpha: alpha.words(),
    };
    let (peel, previous) = (peel.first::<PeelParams>(), previous.depth());
    for (instance, view) in views.slice::<PeelView>()[..counts[1] as usize].iter().enumerate() {
        let axis = view.axis as usize;
        let (x, y) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut clip = inputs.params.clip();
        clip.min[x] = clip.min[x].max(view.window_x);
        clip.min[y] = clip.min[y].max(view.window_y);
        clip.max[x] = clip.max[x].min(view.window_x + peel.cell as i32);
        clip.max[y] = clip.max[y].min(view.window_y + peel.cell as i32);
        let corner = peel.corner(instance as u32);
        for triangle in 0..counts[0] / 3 {
            let Some(raster) = inputs.project(triangle, view.direction, view.axis) else { continue };
            let packed = &inputs.triangles[triangle as usize];
            raster.fragments(&clip, |fragment| {
                if !packed.passes(inputs.masks, inputs.planes, inputs.alpha, fragment.barycentric) {
                    return;
                }
                let px = corner[0] + (fragment.voxel[x] - view.window_x) as u32;
                let py = corner[1] + (fragment.voxel[y] - view.window_y) as u32;
                let depth = (fragment.voxel[axis] - clip.min[axis] + 1) as f32 / PEEL_DEPTHS as f32;
                if depth > previous.at(px, py) {
                    target.keep_nearest(px, py, depth);
                }
            });
        }
    }
}
