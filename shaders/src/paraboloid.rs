//! The dual paraboloid: how the maps of views hold all directions.
//!
//! # Theory
//! \[MV\] §3.2 renders every node of the view hierarchy into an omnidirectional map, all in one global orientation. The
//! front half holds the directions with x ≥ 0, the back half the others; a half is the stereographic projection of its
//! hemisphere, which keeps angles: a texel is as wide as it is high everywhere, R/4 texels a radian in the middle of
//! a half and R/2 at its rim.
//!
//! # Layout
//! With (a, b) = (d.y, d.z) / (1 + |d.x|) of a unit direction d, the texel lies in column i = floor((a + 1)/2 · R) and row
//! j = floor((b + 1)/2 · R) of half h (0: d.x ≥ 0); its index is (h · R + j) · R + i. Texels outside the unit disc belong to
//! directions of the other hemisphere and stay empty.

/// Texels of a map of two halves of `resolution` texels a side.
#[inline]
pub fn texel_count(resolution: u32) -> usize {
    2 * resolution as usize * resolution as usize
}

/// Half (0: front), and column and row in texels, not rounded, of an offset of length `length`, which is not 0.
#[inline]
pub fn project(offset: [f32; 3], length: f32, resolution: u32) -> (u32, [f32; 2]) {
    let scale = 1.0 / (length + offset[0].abs());
    let half_side = resolution as f32 * 0.5;
    let half = u32::from(offset[0] < 0.0);
    (half, [(offset[1] * scale + 1.0) * half_side, (offset[2] * scale + 1.0) * half_side])
}

/// Index of the texel that an offset of length `length`, which is not 0, falls in.
#[inline]
pub fn texel(offset: [f32; 3], length: f32, resolution: u32) -> u32 {
    let (half, at) = project(offset, length, resolution);
    // Casts cut off at 0; rounding may reach the far rim.
    let [column, row] = at.map(|c| (c as u32).min(resolution - 1));
    (half * resolution + row) * resolution + column
}

/// Unit direction of a place on a half, in texels (a texel's middle is at half a texel). Places outside the unit disc
/// give directions of the other hemisphere.
#[inline]
pub fn direction(half: u32, at: [f32; 2], resolution: u32) -> [f32; 3] {
    let [a, b] = at.map(|c| c / resolution as f32 * 2.0 - 1.0);
    let square = a * a + b * b;
    let scale = 1.0 / (1.0 + square);
    let x = (1.0 - square) * scale;
    [if half == 0 { x } else { -x }, 2.0 * a * scale, 2.0 * b * scale]
}

/// Unit direction of the middle of a texel.
#[inline]
pub fn texel_direction(index: u32, resolution: u32) -> [f32; 3] {
    let (row, column) = (index / resolution, index % resolution);
    let (half, row) = (row / resolution, row % resolution);
    direction(half, [column as f32 + 0.5, row as f32 + 0.5], resolution)
}

/// Whether the middle of a texel lies in the disc that its half fills: other texels are always empty.
#[inline]
pub fn is_inside(index: u32, resolution: u32) -> bool {
    let (row, column) = (index / resolution % resolution, index % resolution);
    let [a, b] = [column, row].map(|c| (2 * c + 1) as i64 - i64::from(resolution));
    a * a + b * b <= i64::from(resolution) * i64::from(resolution)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn length(v: [f32; 3]) -> f32 {
        (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
    }

    #[test]
    fn texels_are_where_the_contract_says() {
        for (offset, half, row, column) in [
            ([3.0, 0.0, 0.0], 0, 8, 8),
            ([-3.0, 0.0, 0.0], 1, 8, 8),
            ([0.0, 2.0, 0.0], 0, 8, 15),
            ([0.0, -2.0, 0.0], 0, 8, 0),
            ([-0.6, 0.0, -0.8], 1, 4, 8),
            // (a, b) = (0.8, 0) / 1.6
            ([0.6, 0.8, 0.0], 0, 8, 12),
        ] {
            assert_eq!(texel(offset, length(offset), 16), (half * 16 + row) * 16 + column, "{offset:?}");
        }
    }

    #[test]
    fn texels_and_directions_are_each_others_inverse() {
        for resolution in [8, 16, 64] {
            for index in 0..texel_count(resolution) as u32 {
                let d = texel_direction(index, resolution);
                assert!((length(d) - 1.0).abs() < 1e-6);
                if is_inside(index, resolution) {
                    assert_eq!(texel(d, length(d), resolution), index);
                }
            }
        }
    }

    #[test]
    fn a_texel_is_a_quarter_as_wide_in_the_middle_as_the_rule_of_thumb_says() {
        let r = 256;
        let middle = direction(0, [128.0, 128.0], r);
        let beside = direction(0, [129.0, 128.0], r);
        let angle = length([0, 1, 2].map(|i| middle[i] - beside[i]));
        assert!((angle * 256.0 / 4.0 - 1.0).abs() < 1e-2, "{angle}");
    }
}
