//! Small tiling textures made in code.

use super::rng::mix;
use crate::scene::{Texture, Wrap};

/// Texels along each side of every texture here.
const SIZE: u32 = 128;

/// Calls `texel(u, v)` for every texel centre, u and v in [0, 1).
fn paint(wrap: Wrap, texel: impl Fn(f32, f32) -> [u8; 4]) -> Texture {
    let centre = |i: u32| (i as f32 + 0.5) / SIZE as f32;
    let texels = (0..SIZE * SIZE).map(|i| texel(centre(i % SIZE), centre(i / SIZE))).collect();
    Texture { width: SIZE, height: SIZE, texels, wrap: [wrap; 2] }
}

/// Uniform in [0, 1) for each cell of a lattice.
fn cell_noise(x: u32, y: u32, stream: u64) -> f32 {
    (mix((u64::from(x) << 32 | u64::from(y)) ^ mix(stream)) >> 40) as f32 / 16_777_216.0
}

/// Fine grain, one value a texel.
fn grain(u: f32, v: f32, stream: u64) -> f32 {
    cell_noise((u * SIZE as f32) as u32, (v * SIZE as f32) as u32, stream)
}

/// Smooth noise that tiles, `cells` lattice cells a side, in [0, 1).
fn tiling_noise(u: f32, v: f32, cells: u32, stream: u64) -> f32 {
    let (x, y) = (u * cells as f32, v * cells as f32);
    let (column, row) = (x as u32, y as u32);
    let smooth = |t: f32| t * t * (3.0 - 2.0 * t);
    let (tx, ty) = (smooth(x - column as f32), smooth(y - row as f32));
    let at = |dx: u32, dy: u32| cell_noise((column + dx) % cells, (row + dy) % cells, stream);
    let low = at(0, 0) + (at(1, 0) - at(0, 0)) * tx;
    let high = at(0, 1) + (at(1, 1) - at(0, 1)) * tx;
    low + (high - low) * ty
}

/// sRGB bytes scaled by `light`.
fn shade(color: [f32; 3], light: f32) -> [u8; 4] {
    let [r, g, b] = color.map(|channel| (channel * light).clamp(0.0, 255.0) as u8);
    [r, g, b, 255]
}

/// Bricks in running bond: 4 columns, 8 courses.
pub(super) fn bricks() -> Texture {
    paint(Wrap::Repeat, |u, v| {
        let y = v * 8.0;
        let course = y as u32;
        let x = u * 4.0 + if course % 2 == 1 { 0.5 } else { 0.0 };
        let (in_x, in_y) = (x - x.floor(), y - y.floor());
        if in_x < 0.06 || in_y < 0.12 {
            return shade([186.0, 178.0, 166.0], 0.9 + 0.1 * grain(u, v, 1));
        }
        let kind = cell_noise(x as u32 % 4, course, 2);
        let color = [158.0 + 40.0 * kind, 82.0 + 34.0 * kind, 62.0 + 22.0 * kind];
        shade(color, 0.88 + 0.12 * grain(u, v, 3))
    })
}

/// Round-ended roof tiles in overlapping rows, to be multiplied by a colour.
pub(super) fn roof_tiles() -> Texture {
    paint(Wrap::Repeat, |u, v| {
        let y = v * 6.0;
        let row = y as u32;
        let x = u * 6.0 + if row % 2 == 1 { 0.5 } else { 0.0 };
        let (in_x, in_y) = (x - x.floor() - 0.5, y - y.floor());
        let rounded = in_y - 0.45 * in_x * in_x * 4.0 * 0.35;
        let light = if rounded < 0.14 || in_x.abs() > 0.46 { 0.5 } else { 0.78 + 0.22 * rounded };
        let kind = cell_noise(x as u32 % 6, row, 4);
        shade(
            [225.0 + 30.0 * kind, 215.0 + 30.0 * kind, 205.0 + 30.0 * kind],
            light * (0.94 + 0.06 * grain(u, v, 5)),
        )
    })
}

/// Rounded paving stones, grey: the nearest of jittered lattice points, dark where two are equally near.
pub(super) fn cobbles() -> Texture {
    const CELLS: u32 = 8;
    paint(Wrap::Repeat, |u, v| {
        let (x, y) = (u * CELLS as f32, v * CELLS as f32);
        let (mut nearest, mut second, mut stone) = (9.0_f32, 9.0_f32, 0.0);
        for dy in [CELLS - 1, 0, 1] {
            for dx in [CELLS - 1, 0, 1] {
                let (column, row) = ((x as u32 + dx) % CELLS, (y as u32 + dy) % CELLS);
                let shift = |d: u32| if d == CELLS - 1 { -1.0 } else { d as f32 };
                let centre_x = x.floor() + shift(dx) + 0.25 + 0.5 * cell_noise(column, row, 6);
                let centre_y = y.floor() + shift(dy) + 0.25 + 0.5 * cell_noise(column, row, 7);
                let distance = ((x - centre_x) * (x - centre_x) + (y - centre_y) * (y - centre_y)).sqrt();
                if distance < nearest {
                    (second, nearest, stone) = (nearest, distance, cell_noise(column, row, 8));
                } else if distance < second {
                    second = distance;
                }
            }
        }
        let gap = ((second - nearest) * 5.0).min(1.0);
        let light = (0.45 + 0.55 * gap) * (0.75 + 0.25 * stone) * (0.93 + 0.07 * grain(u, v, 9));
        shade([196.0, 190.0, 180.0], light)
    })
}

/// Lawn: greens of two scales.
pub(super) fn grass() -> Texture {
    paint(Wrap::Repeat, |u, v| {
        let patch = 0.6 * tiling_noise(u, v, 6, 10) + 0.4 * tiling_noise(u, v, 21, 11);
        let color = [92.0 + 40.0 * patch, 128.0 + 22.0 * patch, 58.0 + 12.0 * patch];
        shade(color, 0.78 + 0.22 * grain(u, v, 12))
    })
}

/// Bark or weathered boards: streaks along v.
pub(super) fn bark() -> Texture {
    paint(Wrap::Repeat, |u, v| {
        let bent = u + 0.05 * tiling_noise(u, v, 4, 13);
        let streak = tiling_noise(bent - bent.floor(), v * 0.25, 16, 14);
        shade([150.0, 122.0, 96.0], (0.55 + 0.45 * streak) * (0.9 + 0.1 * grain(u, v, 15)))
    })
}

/// A twig with leaves on a transparent ground, stem at v = 1: the mask of leaf cards. Grey, to be multiplied by a colour.
pub(super) fn leaves() -> Texture {
    /// Leaf base, tip (texture space) and half width.
    const LEAVES: [([f32; 2], [f32; 2], f32); 9] = [
        ([0.50, 0.30], [0.50, 0.02], 0.085),
        ([0.50, 0.42], [0.22, 0.14], 0.080),
        ([0.50, 0.40], [0.79, 0.13], 0.080),
        ([0.50, 0.58], [0.10, 0.36], 0.085),
        ([0.50, 0.55], [0.90, 0.37], 0.085),
        ([0.50, 0.72], [0.06, 0.62], 0.080),
        ([0.50, 0.70], [0.94, 0.63], 0.080),
        ([0.50, 0.84], [0.18, 0.90], 0.070),
        ([0.50, 0.82], [0.82, 0.91], 0.070),
    ];
    paint(Wrap::ClampToEdge, |u, v| {
        // Transparent texels keep a leaf's colour: filtering must not bring in another at the edge.
        let mut texel = [150, 160, 140, 0];
        if (u - 0.5).abs() < 0.014 && v > 0.25 {
            texel = [130, 118, 96, 255];
        }
        for (index, (base, tip, half_width)) in LEAVES.iter().enumerate() {
            let (ax, ay) = (tip[0] - base[0], tip[1] - base[1]);
            let length_squared = ax * ax + ay * ay;
            let (px, py) = (u - base[0], v - base[1]);
            let along = (px * ax + py * ay) / length_squared;
            let across = (px * ay - py * ax) / length_squared.sqrt();
            if !(0.0..=1.0).contains(&along) {
                continue;
            }
            // Widest at two fifths, pointed at the tip.
            let shape =
                6.75 * along * (1.0 - along) * (1.0 - along) * 0.66 + 0.34 * 4.0 * along * (1.0 - along);
            if across.abs() <= half_width * shape {
                let vein = if across.abs() < 0.006 { 0.82 } else { 1.0 };
                let light =
                    vein * (0.84 + 0.16 * cell_noise(index as u32, 0, 16)) * (0.9 + 0.1 * grain(u, v, 17));
                texel = shade([226.0, 236.0, 210.0], light);
            }
        }
        texel
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_leaf_mask_is_partly_open_and_has_clear_edges() {
        let leaves = leaves();
        let solid = leaves.texels.iter().filter(|texel| texel[3] == 255).count();
        let share = solid as f32 / leaves.texels.len() as f32;
        assert!((0.2..0.7).contains(&share), "{share} of the mask is leaf");
        assert!(leaves.texels.iter().all(|texel| texel[3] == 0 || texel[3] == 255));
        assert!((0..SIZE as usize).all(|i| leaves.texels[i * SIZE as usize][3] == 0));
    }

    #[test]
    fn opaque_textures_are_opaque_and_not_uniform() {
        for texture in [bricks(), roof_tiles(), cobbles(), grass(), bark()] {
            assert_eq!(texture.texels.len(), (texture.width * texture.height) as usize);
            assert!(texture.texels.iter().all(|texel| texel[3] == 255));
            assert!(texture.texels.iter().any(|texel| *texel != texture.texels[0]));
        }
    }
}
