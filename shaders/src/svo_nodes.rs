//! Octree nodes as shaders read them.

use crate::svo::SvoLevel;
use bytemuck::{Pod, Zeroable};

/// One node of a level, 16 bytes. The level's nodes are an array in Morton order.
///
/// | word | bits | content |
/// |---|---|---|
/// | 0 | 0–31 | index of its first child in the next level; the others follow in the order of the mask's bits |
/// | 1 | 0–7 | child mask; 0 at the deepest level |
/// | 1 | 8–15 | coverage, of 255 |
/// | 1 | 16–23 | half angle of the normal cone ([`crate::octahedral::encode_cone`]) |
/// | 2 | 0–23 | base colour: red, green, blue, sRGB-encoded |
/// | 2 | 24–31 | zero |
/// | 3 | 0–15 | normal ([`crate::octahedral`]), two signed bytes |
/// | 3 | 16–31 | zero |
///
/// A node whose children begin at 7, with the children 0 and 7, half covered, all normals alike: words 0 and 1 are `7, 0x0000_8081`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct SvoNode {
    /// See the table.
    pub words: [u32; 4],
}

impl SvoNode {
    /// The nodes of a level; emitted radiance is left out. At the deepest level all are covered.
    pub fn of_level(level: &SvoLevel) -> Vec<Self> {
        let mut first_child = 0;
        (0..level.colors.len())
            .map(|i| {
                let mask = level.child_masks.get(i).copied().unwrap_or(0);
                let coverage = level.coverages.get(i).copied().unwrap_or(255);
                let [red, green, blue] = level.colors[i];
                let normal = level.normals[i].map(|c| c as u8);
                let words = [
                    first_child,
                    u32::from_le_bytes([mask, coverage, level.cones[i], 0]),
                    u32::from_le_bytes([red, green, blue, 0]),
                    u32::from_le_bytes([normal[0], normal[1], 0, 0]),
                ];
                first_child += mask.count_ones();
                Self { words }
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_are_packed_as_documented() {
        let level = SvoLevel {
            child_masks: vec![0b111, 0b1000_0001],
            colors: vec![[1, 2, 3], [0xff, 0x80, 0]],
            normals: vec![[0, 0], [-1, 2]],
            cones: vec![0, 9],
            coverages: vec![255, 0x80],
            emissive: Vec::new(),
        };
        let nodes = SvoNode::of_level(&level);
        assert_eq!(nodes[0].words, [0, 0x0000_ff07, 0x03_0201, 0]);
        assert_eq!(nodes[1].words, [3, 0x0009_8081, 0x80ff, 0x02ff]);
        let leaves = SvoLevel { child_masks: Vec::new(), coverages: Vec::new(), ..level };
        assert_eq!(SvoNode::of_level(&leaves)[1].words, [0, 0x0009_ff00, 0x80ff, 0x02ff]);
    }
}
