use crate::constants::PAIRS_PER_INVOCATION;
use crate::directions::DirectionFrame;
use crate::executor::CpuBinding;
use crate::types::PointParams;

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let [params, frames, points, bits] = bindings else { unreachable!("checked against the table") };
    let (params, frames, bits) =
        (params.first::<PointParams>(), frames.slice::<DirectionFrame>(), bits.words_mut());
    let points = points.slice::<[[i16; 3]; 2]>();
    for direction in 0..workgroups[1] {
        for pair in &points[..params.pairs.min(workgroups[0] * 64 * PAIRS_PER_INVOCATION) as usize] {
            for &point in pair {
                let [u, v, w] = frames[direction as usize].voxel(point, params.grid_bits);
                let b = params.grid_bits;
                let bit = (((direction << b | v) << b | u) << params.row_bits) | w;
                bits[bit as usize / 32] |= 1 << (bit % 32);
            }
        }
    }
}
