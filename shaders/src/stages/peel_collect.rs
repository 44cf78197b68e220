use crate::constants::PEEL_DEPTHS;
use crate::executor::CpuBinding;
use crate::types::{PeelParams, PeelView, RasterParams};

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let [params, peel, views, layer, count, bits] = bindings else {
        unreachable!("checked against the table")
    };
    let (params, peel) = (params.first::<RasterParams>(), peel.first::<PeelParams>());
    let (views, layer) = (views.slice::<PeelView>(), layer.depth());
    for y in 0..(workgroups[1] * 8).min(layer.size[1]) {
        for x in 0..(workgroups[0] * 8).min(layer.size[0]) {
            let index = y / peel.cell * peel.columns + x / peel.cell;
            if x / peel.cell >= peel.columns || index >= peel.views || layer.at(x, y) >= 1.0 {
                continue;
            }
            let view = views[index as usize];
            let (axis, corner) = (view.axis as usize, peel.corner(index));
            let mut voxel = [0; 3];
            voxel[(axis + 1) % 3] = (x - corner[0]) as i32 + view.window_x;
            voxel[(axis + 2) % 3] = (y - corner[1]) as i32 + view.window_y;
            voxel[axis] = (layer.at(x, y) * PEEL_DEPTHS as f32) as i32 - 1 + params.clip_min[axis];
            let bit = params.bit(view.direction, voxel);
            bits.words_mut()[bit as usize / 32] |= 1 << (bit % 32);
            count.words_mut()[0] += 1;
        }
    }
}
