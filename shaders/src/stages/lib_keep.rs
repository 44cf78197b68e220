//! What a texel keeps of what is drawn into it; see `lib_keep.wgsl`.

use crate::mega_views::PassParams;

pub(super) fn keep(pass: &PassParams, maps: &mut [u32], [map, texel]: [u32; 2], distance: f32, node: u32) {
    let at = (map * pass.texels + texel) as usize;
    let bits = distance.to_bits();
    if pass.draws_numbers == 0 {
        maps[at] = maps[at].min(bits);
    } else if maps[at] == bits {
        let number = &mut maps[pass.number_at(at)];
        *number = (*number).min(node);
    }
}
