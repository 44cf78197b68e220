//! Slices: one layer of cells, seen along an axis.

use manyview_shaders::svo::Svo;

use super::picture::{Picture, linear};

/// A world axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// +X; its slices show +Z to the right and +Y up.
    X,
    /// +Y; its slices show +X to the right and +Z down, as a floor plan does.
    Y,
    /// +Z; its slices show +X to the right and +Y up.
    Z,
}

/// The cells of `level` whose coordinate along `axis` is `index`, one pixel each, in their base colours; empty cells
/// are dark.
pub fn picture_slice(svo: &Svo, level: u32, axis: Axis, index: u32) -> Picture {
    let side = 1u32 << level;
    let mut color = vec![[0.012, 0.013, 0.018]; (side as usize).pow(2)];
    let normal_axis = axis as usize;
    // (index, cell) of the nodes that the slice cuts; down from the root, so that the rest is never visited.
    let mut nodes = vec![(0u32, [0u32; 3])];
    for l in 0..level as usize {
        let first = svo.first_children(l);
        let half = u32::from(index >> (level as usize - 1 - l) & 1 == 1);
        let mut children = Vec::new();
        for (node, cell) in nodes {
            let mask = u32::from(svo.levels[l].child_masks[node as usize]);
            for child in (0..8u32).filter(|c| mask >> c & 1 == 1 && c >> normal_axis & 1 == half) {
                let before = (mask & ((1 << child) - 1)).count_ones();
                let cell = [0, 1, 2].map(|i| cell[i] * 2 + (child >> i & 1));
                children.push((first[node as usize] + before, cell));
            }
        }
        nodes = children;
    }
    for (node, [x, y, z]) in nodes {
        let (column, row) = match axis {
            Axis::X => (z, side - 1 - y),
            Axis::Y => (x, z),
            Axis::Z => (x, side - 1 - y),
        };
        // Black surfaces must not look like nothing.
        let surface = linear(svo.levels[level as usize].colors[node as usize]);
        color[(row * side + column) as usize] = surface.map(|c| 0.04 + 0.96 * c);
    }
    Picture::of_colors(side, side, color)
}
