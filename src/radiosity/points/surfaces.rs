//! The leaves of an octree with the numbers of their lit nodes, for exact rays: the judge of maps by other methods.

use super::{LitTree, codes};
use crate::views::{OctreeSurfaces, Seen, Surfaces};
use manyview_shaders::svo::Svo;

/// What [`crate::views::RayCast`] casts at in place of a [`super::coded_tree`].
#[derive(Debug, Clone)]
pub struct CodedLeaves {
    leaves: OctreeSurfaces,
    codes: Vec<[u8; 4]>,
}

impl CodedLeaves {
    /// Takes the leaves of a validated octree.
    pub fn new(svo: &Svo, lit: &LitTree) -> Self {
        let count = svo.node_count(svo.depth() as usize);
        let mut codes = codes(svo, lit);
        codes.drain(..codes.len() - count);
        Self { leaves: OctreeSurfaces::new(svo, false), codes }
    }
}

impl Surfaces for CodedLeaves {
    fn name(&self) -> &'static str {
        self.leaves.name()
    }

    fn has_colors(&self) -> bool {
        true
    }

    fn cast(&self, origin: [f64; 3], direction: [f64; 3]) -> Option<Seen> {
        let (distance, leaf) = self.leaves.leaf(origin, direction)?;
        Some(Seen { distance, color: self.codes[leaf as usize] })
    }
}
