//! Where alpha cuts holes into a triangle, decided in integers.
//!
//! Foliage, fences and chains are triangles whose texture says what is there. A fragment of such a triangle exists
//! only if the alpha of the nearest texel reaches the triangle's threshold. Texel coordinates come from the
//! fragment's integer barycentric weights, so that every backend and every projection reads the same texel.

use crate::raster::BARYCENTRIC_ONE;
use bytemuck::{Pod, Zeroable};

/// What happens outside a texture, as the GPU sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum WrapCode {
    /// Tile.
    Repeat = 0,
    /// Tile, every other one mirrored.
    Mirror = 1,
    /// The border texel goes on.
    Clamp = 2,
}

/// Texel coordinates over one triangle, 28 bytes: at weights (b1, b2) the texel is
/// `(texel + ((b1 · step1 + b2 · step2) >> 15)) >> shift`, before wrapping.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable, Default)]
pub struct TexelMap {
    /// Coordinates at vertex 0, in texels times `2^shift`.
    pub texel: [i32; 2],
    /// Difference at vertex 1, below 2^15 in magnitude.
    pub step1: [i32; 2],
    /// Difference at vertex 2, below 2^15 in magnitude.
    pub step2: [i32; 2],
    /// Fractional bits, 0 ..= 8.
    pub shift: u32,
}

impl TexelMap {
    /// The map for texture coordinates `uvs` at the three vertices of a texture of `size` texels. A triangle that
    /// spans more than 32,767 texels is clamped to that.
    pub fn new(uvs: [[f64; 2]; 3], size: [u32; 2], wrap: [WrapCode; 2]) -> Self {
        let mut at = [[0.0; 2]; 3];
        let mut largest = 0.0f64;
        for i in 0..2 {
            let base = match wrap[i] {
                // Whole periods do not matter; small numbers keep their fractions.
                WrapCode::Repeat | WrapCode::Mirror => (uvs[0][i] / 2.0).floor() * 2.0,
                WrapCode::Clamp => 0.0,
            };
            for v in 0..3 {
                at[v][i] = ((uvs[v][i] - base) * f64::from(size[i])).clamp(-1e9, 1e9);
                largest = largest.max((at[v][i] - at[0][i]).abs());
            }
        }
        let mut shift = 8;
        while shift > 0 && largest * f64::from(1u32 << shift) >= 32766.0 {
            shift -= 1;
        }
        let scale = f64::from(1u32 << shift);
        let texel = at[0].map(|c| (c * scale).floor().clamp(-1e9, 1e9) as i32);
        let step = |v: usize| {
            [0, 1].map(|i| ((at[v][i] - at[0][i]) * scale + 0.5).floor().clamp(-32767.0, 32767.0) as i32)
        };
        Self { texel, step1: step(1), step2: step(2), shift }
    }

    /// The texel at weights (b1, b2), before wrapping.
    #[inline]
    pub fn at(&self, barycentric: [u32; 2]) -> [i32; 2] {
        let [b1, b2] = barycentric.map(|b| b as i32);
        [0, 1].map(|i| (self.texel[i] + ((b1 * self.step1[i] + b2 * self.step2[i]) >> 15)) >> self.shift)
    }
}

const _: () = assert!(BARYCENTRIC_ONE == 1 << 15);

/// Brings a texel coordinate into `0 .. size`.
#[inline]
pub fn wrap_texel(texel: i32, size: u32, wrap: WrapCode) -> u32 {
    let n = size as i32;
    match wrap {
        WrapCode::Repeat => texel.rem_euclid(n) as u32,
        WrapCode::Mirror => {
            let t = texel.rem_euclid(2 * n);
            t.min(2 * n - 1 - t) as u32
        }
        WrapCode::Clamp => texel.clamp(0, n - 1) as u32,
    }
}

/// The alpha of one texture: `width · height` bytes, row by row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AlphaPlane {
    /// Texels along u, 1 ..= 32768.
    pub width: u32,
    /// Texels along v, 1 ..= 32768.
    pub height: u32,
    /// Wrap along u and v.
    pub wrap: [WrapCode; 2],
    /// One byte per texel.
    pub alpha: Vec<u8>,
}

/// How one triangle is cut, 40 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct TriangleMask {
    /// Index of the alpha plane.
    pub plane: u32,
    /// A fragment exists iff its texel's alpha is at least this; 256 is never.
    pub threshold: u32,
    /// Texel coordinates over the triangle.
    pub map: TexelMap,
    /// Zero.
    pub reserved: u32,
}

/// Index that stands for "this triangle is not cut".
pub const UNMASKED: u32 = u32::MAX;

impl TriangleMask {
    /// Whether the fragment at weights (b1, b2) exists.
    #[inline]
    pub fn passes(&self, planes: &[AlphaPlane], barycentric: [u32; 2]) -> bool {
        let plane = &planes[self.plane as usize];
        let [s, t] = self.map.at(barycentric);
        let (s, t) = (wrap_texel(s, plane.width, plane.wrap[0]), wrap_texel(t, plane.height, plane.wrap[1]));
        u32::from(plane.alpha[(t * plane.width + s) as usize]) >= self.threshold
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_an_edge_reads_the_middle_texel() {
        let map = TexelMap::new([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], [64, 32], [WrapCode::Repeat; 2]);
        assert_eq!(map.at([0, 0]), [0, 0]);
        assert_eq!(map.at([BARYCENTRIC_ONE / 2, 0]), [32, 0]);
        assert_eq!(map.at([0, BARYCENTRIC_ONE / 2]), [0, 16]);
        assert_eq!(map.at([BARYCENTRIC_ONE / 4, BARYCENTRIC_ONE / 4]), [16, 8]);
    }

    #[test]
    fn far_tiles_read_as_the_first_one_does() {
        let uvs = [[0.25, 0.5], [0.75, 0.25], [0.5, 1.0]];
        let far = uvs.map(|[u, v]| [u + 4000.0, v - 36.0]);
        let size = [128, 128];
        assert_eq!(
            TexelMap::new(uvs, size, [WrapCode::Repeat; 2]),
            TexelMap::new(far, size, [WrapCode::Repeat; 2])
        );
    }

    #[test]
    fn absurd_coordinates_stay_defined() {
        let map = TexelMap::new([[1e30, -1e30], [-1e30, 1e30], [0.0, 0.0]], [4096, 1], [WrapCode::Clamp; 2]);
        for b in [[0, 0], [BARYCENTRIC_ONE, 0], [0, BARYCENTRIC_ONE]] {
            let [s, t] = map.at(b);
            assert!(wrap_texel(s, 4096, WrapCode::Clamp) < 4096 && wrap_texel(t, 1, WrapCode::Mirror) < 1);
        }
    }

    #[test]
    fn wrapping_follows_gltf() {
        let at = |wrap| [-5, -1, 0, 3, 4, 7, 8].map(|t| wrap_texel(t, 4, wrap));
        assert_eq!(at(WrapCode::Repeat), [3, 3, 0, 3, 0, 3, 0]);
        assert_eq!(at(WrapCode::Mirror), [3, 0, 0, 3, 3, 0, 0]);
        assert_eq!(at(WrapCode::Clamp), [0, 0, 0, 3, 3, 3, 3]);
    }

    #[test]
    fn thresholds_cut_where_alpha_is_below() {
        let plane = AlphaPlane { width: 2, height: 1, wrap: [WrapCode::Clamp; 2], alpha: vec![10, 200] };
        let map = TexelMap::new([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], [2, 1], plane.wrap);
        let mask = |threshold| TriangleMask { plane: 0, threshold, map, reserved: 0 };
        let planes = [plane];
        let (left, right) = ([BARYCENTRIC_ONE / 4, 0], [3 * BARYCENTRIC_ONE / 4, 0]);
        assert!(!mask(128).passes(&planes, left) && mask(128).passes(&planes, right));
        assert!(mask(10).passes(&planes, left) && !mask(256).passes(&planes, right));
    }
}
