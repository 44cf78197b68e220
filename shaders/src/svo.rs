//! The sparse voxel octree, level by level.
//!
//! # Theory
//! \[MV\] §3 takes an SVO as scene hierarchy: nodes with averaged colour, normal cone and a bounding sphere that follows
//! from the cell. Here it is kept breadth first: level l lists its nodes in Morton order, with one child mask each;
//! the children of a level's nodes, in order, are the next level. Positions and child indices follow from the masks,
//! so that geometry alone is one byte per inner node.
//!
//! Morton order: bit 0 of a child's number is x, bit 1 is y, bit 2 is z.

use std::collections::BTreeMap;
use thiserror::Error;

/// Deepest level there can be: voxel coordinates stay below 2^13.
pub const MAX_LEVELS: u32 = 13;

/// One level's nodes, arrays in Morton order.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SvoLevel {
    /// Which of the eight children exist, never 0; empty at the deepest level.
    pub child_masks: Vec<u8>,
    /// Averaged base colour, sRGB-encoded.
    pub colors: Vec<[u8; 3]>,
    /// Averaged normal ([`crate::octahedral`]), the axis of the normal cone.
    pub normals: Vec<[i8; 2]>,
    /// Half angle of the normal cone ([`crate::octahedral::encode_cone`]).
    pub cones: Vec<u8>,
    /// Share of the cell's cross sections along x, y, z that is covered, of 255; empty at the deepest level (all 255).
    pub coverages: Vec<u8>,
    /// Averaged emitted radiance ([`crate::rgb9e5`]); empty in a scene that emits nothing.
    pub emissive: Vec<u32>,
}

impl SvoLevel {
    /// A level of `nodes` nodes with these child masks, empty at the deepest level: geometry alone, all attributes 0 and
    /// all cells covered.
    pub fn of_masks(child_masks: Vec<u8>, nodes: usize) -> Self {
        Self {
            coverages: vec![255; child_masks.len()],
            child_masks,
            colors: vec![[0; 3]; nodes],
            normals: vec![[0; 2]; nodes],
            cones: vec![0; nodes],
            emissive: Vec::new(),
        }
    }

    /// Takes the nodes of `next`, which come behind these in Morton order.
    pub fn append(&mut self, next: Self) {
        self.child_masks.extend(next.child_masks);
        self.colors.extend(next.colors);
        self.normals.extend(next.normals);
        self.cones.extend(next.cones);
        self.coverages.extend(next.coverages);
        self.emissive.extend(next.emissive);
    }
}

/// A sparse voxel octree over a scene cube.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Svo {
    /// World position of the cube's smallest corner, metres.
    pub origin: [f64; 3],
    /// Edge of the cube, metres.
    pub size: f64,
    /// Levels 0 (the root) to the deepest; `levels.len() - 1` is the number that `--levels` names.
    pub levels: Vec<SvoLevel>,
}

/// What [`Svo::validate`] counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SvoStats {
    /// Nodes at the deepest level.
    pub leaves: u64,
    /// Nodes at all levels, leaves included.
    pub nodes: u64,
}

/// What is wrong with an [`Svo`].
#[derive(Debug, Error, PartialEq, Eq)]
#[error("octree level {level}: {rule} (found {found}, expected {expected})")]
pub struct SvoError {
    /// The level at fault.
    pub level: usize,
    /// The rule it breaks.
    pub rule: &'static str,
    /// The value there.
    pub found: u64,
    /// The value by the rule.
    pub expected: u64,
}

impl Svo {
    /// The geometry of the octree with these cells at level `depth`, of which there must be one; a cell may come twice.
    pub fn of_cells(
        origin: [f64; 3],
        size: f64,
        depth: u32,
        cells: impl IntoIterator<Item = [u32; 3]>,
    ) -> Self {
        let code = |cell: [u32; 3]| {
            (0..3 * depth)
                .fold(0, |code, bit| code | u64::from(cell[bit as usize % 3] >> (bit / 3) & 1) << bit)
        };
        let mut codes: Vec<u64> = cells.into_iter().map(code).collect();
        codes.sort_unstable();
        codes.dedup();
        let mut levels = vec![SvoLevel::of_masks(Vec::new(), codes.len())];
        for _ in 0..depth {
            let mut masks: BTreeMap<u64, u8> = BTreeMap::new();
            for code in codes {
                *masks.entry(code >> 3).or_default() |= 1 << (code & 7);
            }
            levels.push(SvoLevel::of_masks(masks.values().copied().collect(), masks.len()));
            codes = masks.into_keys().collect();
        }
        levels.reverse();
        Self { origin, size, levels }
    }

    /// The number of the deepest level (`--levels`).
    pub fn depth(&self) -> u32 {
        self.levels.len() as u32 - 1
    }

    /// Edge of a cell of the deepest level, metres.
    pub fn voxel_size(&self) -> f64 {
        self.size / f64::from(1u32 << self.depth())
    }

    /// Nodes of a level.
    pub fn node_count(&self, level: usize) -> usize {
        self.levels[level].colors.len()
    }

    /// For every node of an inner level, the index of its first child in the next level; one more entry at the end.
    pub fn first_children(&self, level: usize) -> Vec<u32> {
        let mut next = 0;
        let mut first = Vec::with_capacity(self.levels[level].child_masks.len() + 1);
        for mask in &self.levels[level].child_masks {
            first.push(next);
            next += mask.count_ones();
        }
        first.push(next);
        first
    }

    /// Coordinates of every node of `level`, in Morton order, in cells of that level.
    pub fn cells(&self, level: usize) -> Vec<[u16; 3]> {
        let mut cells = vec![[0u16; 3]];
        for masks in self.levels[..level].iter().map(|l| &l.child_masks) {
            let mut children = Vec::with_capacity(masks.iter().map(|m| m.count_ones() as usize).sum());
            for (cell, &mask) in cells.iter().zip(masks) {
                for child in (0..8).filter(|c| mask >> c & 1 == 1) {
                    children.push([0, 1, 2].map(|i| cell[i] * 2 + (child >> i & 1)));
                }
            }
            cells = children;
        }
        cells
    }

    /// Visits the whole structure: every array as long as its level, every mask with a child, every child counted.
    pub fn validate(&self) -> Result<SvoStats, SvoError> {
        let check = |level: usize, rule: &'static str, found: usize, expected: usize| {
            if found == expected {
                Ok(())
            } else {
                Err(SvoError { level, rule, found: found as u64, expected: expected as u64 })
            }
        };
        if self.levels.is_empty() || self.levels.len() > MAX_LEVELS as usize + 1 {
            let expected = u64::from(MAX_LEVELS);
            return Err(SvoError {
                level: 0,
                rule: "number of levels",
                found: self.levels.len() as u64,
                expected,
            });
        }
        let deepest = self.levels.len() - 1;
        let emits = !self.levels[0].emissive.is_empty();
        let mut nodes = 1;
        let mut total = 0;
        for (l, level) in self.levels.iter().enumerate() {
            total += nodes as u64;
            let inner = if l < deepest { nodes } else { 0 };
            check(l, "child masks of a level", level.child_masks.len(), inner)?;
            check(l, "colours of a level", level.colors.len(), nodes)?;
            check(l, "normals of a level", level.normals.len(), nodes)?;
            check(l, "normal cones of a level", level.cones.len(), nodes)?;
            check(l, "coverages of a level", level.coverages.len(), inner)?;
            check(l, "emitted radiances of a level", level.emissive.len(), if emits { nodes } else { 0 })?;
            if let Some(at) = level.child_masks.iter().position(|&m| m == 0) {
                return Err(SvoError {
                    level: l,
                    rule: "an inner node without children, at index",
                    found: at as u64,
                    expected: 0,
                });
            }
            if l < deepest {
                nodes = level.child_masks.iter().map(|m| m.count_ones() as usize).sum();
            }
        }
        Ok(SvoStats { leaves: nodes as u64, nodes: total })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_leaves() -> Svo {
        let nodes = |n: usize, mask: &[u8]| SvoLevel {
            child_masks: mask.to_vec(),
            colors: vec![[1, 2, 3]; n],
            normals: vec![[0, 0]; n],
            cones: vec![0; n],
            coverages: vec![255; mask.len()],
            emissive: Vec::new(),
        };
        Svo {
            origin: [0.0; 3],
            size: 1.0,
            levels: vec![nodes(1, &[0b1000_0001]), nodes(2, &[0b10, 0b100]), nodes(2, &[])],
        }
    }

    #[test]
    fn cells_follow_the_masks_in_morton_order() {
        let svo = two_leaves();
        assert_eq!(svo.validate(), Ok(SvoStats { leaves: 2, nodes: 5 }));
        assert_eq!(svo.cells(1), [[0, 0, 0], [1, 1, 1]]);
        assert_eq!(svo.cells(2), [[1, 0, 0], [2, 3, 2]]);
        assert_eq!(svo.first_children(0), [0, 2]);
    }

    #[test]
    fn an_octree_of_cells_has_these_and_no_others() {
        let svo = Svo::of_cells([0.0; 3], 1.0, 2, [[2, 3, 2], [1, 0, 0], [2, 3, 2]]);
        assert_eq!(svo.validate(), Ok(SvoStats { leaves: 2, nodes: 5 }));
        assert_eq!(svo.cells(2), [[1, 0, 0], [2, 3, 2]]);
        let masks = |level: usize| &svo.levels[level].child_masks;
        assert_eq!(
            (masks(0), masks(1)),
            (&two_leaves().levels[0].child_masks, &two_leaves().levels[1].child_masks)
        );
    }

    #[test]
    fn validate_names_the_level_and_the_rule() {
        let mut svo = two_leaves();
        svo.levels[1].child_masks[1] = 0b11;
        assert_eq!(svo.validate().unwrap_err().level, 2, "a third leaf is missing");
        let mut svo = two_leaves();
        svo.levels[1].child_masks[0] = 0;
        assert!(svo.validate().unwrap_err().to_string().contains("without children"));
        let mut svo = two_leaves();
        svo.levels[0].coverages.clear();
        assert_eq!(svo.validate().unwrap_err().level, 0);
        assert!(Svo::default().validate().is_err());
    }
}
