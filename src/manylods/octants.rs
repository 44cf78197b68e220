//! The test of a node-view, for all eight octants of a node at once.

use manyview_shaders::scene_tree::{SPHERE_OF_CUBE, SceneTree};
use manyview_shaders::views::{View, ViewNode, is_culled, is_small};

/// What a cut is made for: one view, and how large its texels are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Eye {
    /// The view as a node of radius 0.
    pub(super) view: ViewNode,
    /// Resolution over the texels that a node may fill.
    pub(super) scale: f32,
}

/// What became of a node-view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Outcome {
    /// Outside the view's field.
    Culled,
    /// Less than a texel: drawn as a point.
    Small,
    /// Has to be subdivided, if it can be.
    Large,
}

impl Eye {
    /// `scale` is the resolution over the texels that a node may fill.
    pub(super) fn new(view: &View, scale: f32, culling: bool) -> Self {
        let mut view = ViewNode::of_view(view, 0);
        if !culling {
            view.cos_psi = -1.0;
        }
        Self { view, scale }
    }

    /// Tests a cell at `offset` with an edge in metres.
    #[inline(always)]
    fn test(&self, offset: [f32; 3], edge: f32) -> Outcome {
        let length = (offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]).sqrt();
        let radius = SPHERE_OF_CUBE * edge;
        if is_culled(offset, length, radius, &self.view) {
            Outcome::Culled
        } else if is_small(offset, length, radius, 0.0, self.scale) {
            Outcome::Small
        } else {
            Outcome::Large
        }
    }

    /// Tests an inner node.
    #[inline]
    pub(super) fn test_node(&self, tree: &SceneTree, cell: [u32; 3], level: u32) -> Outcome {
        let edge = tree.cell_size(level);
        let position = self.view.center;
        let offset = [0, 1, 2].map(|i: usize| tree.origin[i] + (cell[i] as f32 + 0.5) * edge - position[i]);
        self.test(offset, edge)
    }
}

/// The octants of a node before one view.
#[derive(Debug, Clone, Copy)]
pub(super) struct Octants {
    /// From the view to the middles of the lower and of the upper octants, along each axis.
    at: [[f32; 2]; 3],
    /// Octants that are outside the view's field, a bit each, and those among the others that fill less than a texel.
    pub(super) culled: u32,
    /// See [`Octants::culled`].
    pub(super) small: u32,
}

impl Octants {
    /// Tests the octants of the cell, whose own edge is twice `edge`, metres.
    #[inline(always)]
    pub(super) fn new(origin: [f32; 3], cell: [u32; 3], edge: f32, eye: &Eye) -> Self {
        let at = [0, 1, 2].map(|i: usize| {
            [0, 1].map(|bit| origin[i] + ((2 * cell[i] + bit) as f32 + 0.5) * edge - eye.view.center[i])
        });
        let radius = SPHERE_OF_CUBE * edge;
        let offsets: [[f32; 3]; 8] = std::array::from_fn(|octant| offset(&at, octant));
        let lengths: [f32; 8] = std::array::from_fn(|octant| {
            let [x, y, z] = offsets[octant];
            (x * x + y * y + z * z).sqrt()
        });
        let small: [bool; 8] =
            std::array::from_fn(|octant| is_small(offsets[octant], lengths[octant], radius, 0.0, eye.scale));
        let culled = match eye.view.cos_psi <= -1.0 {
            true => 0,
            false => bits(std::array::from_fn(|octant| {
                is_culled(offsets[octant], lengths[octant], radius, &eye.view)
            })),
        };
        Self { at, culled, small: bits(small) & !culled }
    }

    /// From the view to the middle of an octant.
    #[inline(always)]
    pub(super) fn offset(&self, octant: u32) -> [f32; 3] {
        offset(&self.at, octant as usize)
    }
}

#[inline(always)]
fn offset(at: &[[f32; 2]; 3], octant: usize) -> [f32; 3] {
    [at[0][octant & 1], at[1][octant >> 1 & 1], at[2][octant >> 2]]
}

#[inline(always)]
fn bits(flags: [bool; 8]) -> u32 {
    let mut bits = 0;
    for (i, flag) in flags.into_iter().enumerate() {
        bits |= u32::from(flag) << i;
    }
    bits
}

/// The bits that are set, lowest first.
#[inline(always)]
pub(super) fn each_bit(mut bits: u32) -> impl Iterator<Item = u32> {
    std::iter::from_fn(move || {
        (bits != 0).then(|| {
            let bit = bits.trailing_zeros();
            bits &= bits - 1;
            bit
        })
    })
}

/// Which octant of its parent a cell is.
#[inline]
pub(super) fn octant_of(cell: [u32; 3]) -> u32 {
    cell[0] & 1 | (cell[1] & 1) << 1 | (cell[2] & 1) << 2
}

#[cfg(test)]
mod tests {
    use super::*;
    use manyview_shaders::cases::Random;

    #[test]
    fn octants_are_tested_as_each_alone() {
        let mut random = Random::new(8);
        let mut found = [0; 3];
        for i in 0..3000 {
            let mut number = || random.range(-4000, 4000) as f32 / 1000.0;
            let (origin, position) = ([number(), number(), number()], [number(), number(), number()]);
            let axis = [number(), number(), number()];
            let half_angle = [0.4, 1.6, 3.2][i % 3];
            let eye = Eye::new(&View::new(position, axis, half_angle), [2.0, 16.0, 64.0][i / 3 % 3], true);
            let cell = [0; 3].map(|_| random.below(8));
            let edge = 0.4;
            let octants = Octants::new(origin, cell, edge, &eye);
            for octant in 0..8 {
                let outcome = eye.test(octants.offset(octant), edge);
                found[outcome as usize] += 1;
                assert_eq!(octants.culled >> octant & 1 == 1, outcome == Outcome::Culled);
                assert_eq!(octants.small >> octant & 1 == 1, outcome == Outcome::Small);
            }
        }
        assert!(found.iter().all(|&count| count > 1000), "{found:?}");
    }
}
