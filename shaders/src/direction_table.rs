//! The sampled direction nearest to a vector, for any set, without trigonometry: a table over the faces of a cube.

use crate::directions::DirectionSet;
use crate::row_test::whole;

/// Cells along each side of a face of the [`DirectionTable`]; they are about 0.35° wide.
pub const TABLE_SIDE: u32 = 256;

/// Two cells a word, the first in the low half: how shaders read the table.
pub fn packed_cells(directions: &[u16]) -> Vec<u32> {
    directions.as_chunks().0.iter().map(|&[a, b]| u32::from(a) | u32::from(b) << 16).collect()
}

/// Index of the [`DirectionTable`]'s cell for a vector in world space, of any length but zero, in either sense.
#[inline(always)]
pub fn table_cell(d: [f32; 3]) -> u32 {
    let [ax, ay, az] = d.map(f32::abs);
    let (x_major, y_major) = ((ax >= ay) & (ax >= az), ay >= az);
    let face = if x_major {
        0
    } else if y_major {
        1
    } else {
        2
    };
    let major = if x_major {
        d[0]
    } else if y_major {
        d[1]
    } else {
        d[2]
    };
    let p = if x_major {
        d[1]
    } else if y_major {
        d[2]
    } else {
        d[0]
    };
    let q = if x_major {
        d[2]
    } else if y_major {
        d[0]
    } else {
        d[1]
    };
    let sign = if major < 0.0 { -1.0 } else { 1.0 };
    let major = major * sign;
    (face * TABLE_SIDE + table_column(p * sign, major)) * TABLE_SIDE + table_column(q * sign, major)
}

/// The column c whose borders hold `minor`: `border(c) · major ≤ minor < border(c + 1) · major`, border(c) = c/128 − 1.
/// The quotient only proposes it, so that a division with an error (GPUs have one) does no harm.
#[inline(always)]
fn table_column(minor: f32, major: f32) -> u32 {
    const HALF: f32 = (TABLE_SIDE / 2) as f32;
    let proposed = whole(((minor / major + 1.0) * HALF).floor()).clamp(0, TABLE_SIDE as i32 - 1);
    let border = |c: i32| (c as f32 * (1.0 / HALF) - 1.0) * major;
    let down = i32::from(minor < border(proposed));
    let up = i32::from(minor >= border(proposed + 1));
    (proposed - down + up).clamp(0, TABLE_SIDE as i32 - 1) as u32
}

/// The nearest direction for every cell of three faces of a cube; a direction and its opposite share a cell.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DirectionTable {
    /// Face by face (the largest coordinate is x, y, z), each `TABLE_SIDE²` cells.
    pub directions: Vec<u16>,
}

impl DirectionTable {
    /// For a set of at most 2^16 directions. `resident` replaces a direction by another, which is for a bake that is
    /// not yet loaded in full.
    pub fn new(set: DirectionSet, resident: impl Fn(u32) -> u32) -> Self {
        let at = |i: u32| (i as f32 + 0.5) / (TABLE_SIDE / 2) as f32 - 1.0;
        let mut directions = Vec::with_capacity((3 * TABLE_SIDE * TABLE_SIDE) as usize);
        for face in 0..3 {
            for p in 0..TABLE_SIDE {
                for q in 0..TABLE_SIDE {
                    let mut d = [0.0; 3];
                    d[face] = 1.0;
                    d[(face + 1) % 3] = at(p);
                    d[(face + 2) % 3] = at(q);
                    directions.push(resident(set.nearest(d)) as u16);
                }
            }
        }
        Self { directions }
    }

    /// The direction for a vector of any length but zero.
    #[inline(always)]
    pub fn nearest(&self, d: [f32; 3]) -> u32 {
        u32::from(self.directions[table_cell(d) as usize])
    }
}
