//! The rows of one direction, seen along it.

use super::picture::{Extra, Picture, heat};

/// Each row becomes a square of about this many pixels in all directions' pictures: they are 512 high.
const PICTURE_SIDE: u32 = 512;

/// Draws the rows of one direction (of `2^bits` voxels a side): to the left the depth of each row's first voxel, near
/// is bright, behind a dark background where a row is empty; to the right how many voxels it has, on a logarithmic
/// scale, dark to bright. Axis u is to the right, v is up.
///
/// Layers `first` (voxels; +infinity for an empty row) and `voxels` (how many) hold the numbers.
pub fn picture_rows(rows: &[u32], bits: u32) -> Picture {
    let side = 1u32 << bits;
    let row_words = (side / 32) as usize;
    let scale = (PICTURE_SIDE / side).max(1);
    let gap = scale.max(4);
    let panel = side * scale;
    let (width, height) = (2 * panel + gap, panel);
    let mut color = vec![[0.0; 3]; (width * height) as usize];
    let mut first = vec![f32::INFINITY; color.len()];
    let mut voxels = vec![0.0; color.len()];
    let full = f64::from(side).ln_1p();
    for v in 0..side {
        for u in 0..side {
            let start = (v * side + u) as usize * row_words;
            let row = &rows[start..start + row_words];
            let count: u32 = row.iter().map(|word| word.count_ones()).sum();
            let depth =
                row.iter().position(|&word| word != 0).map(|at| at as u32 * 32 + row[at].trailing_zeros());
            let near = match depth {
                Some(depth) => {
                    let near = 1.0 - depth as f32 / side as f32;
                    [0.05 + 0.90 * near * near, 0.06 + 0.86 * near * near, 0.09 + 0.75 * near * near]
                }
                None => [0.004, 0.005, 0.008],
            };
            let dense = heat((f64::from(count).ln_1p() / full) as f32);
            for y in 0..scale {
                let line = ((side - 1 - v) * scale + y) * width;
                for x in 0..scale {
                    let left = (line + u * scale + x) as usize;
                    let right = left + (panel + gap) as usize;
                    color[left] = near;
                    color[right] = dense;
                    for at in [left, right] {
                        first[at] = depth.map_or(f32::INFINITY, |depth| depth as f32);
                        voxels[at] = count as f32;
                    }
                }
            }
        }
    }
    let mut picture = Picture::of_colors(width, height, color);
    picture.layers = vec![("first", Extra::Scalar(first)), ("voxels", Extra::Scalar(voxels))];
    picture
}
