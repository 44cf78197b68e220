//! Sampled ray directions, and the row frame of each.
//!
//! # Theory
//! \[WMP\] §3 samples all ray directions (a direction and its opposite share rows) and voxelizes the scene once per
//! direction, in a frame whose third axis is the direction: *rows* run along it. A ray then lies almost inside one
//! row of the voxelization whose direction is nearest.
//!
//! # Differences from the paper
//! - [`DirectionSet::LatLong`] is the paper's set: equal steps of theta and phi, crowded at the poles.
//!   [`DirectionSet::Octahedral`] spreads the same number of directions almost evenly and needs no trigonometry.
//! - The paper puts one cube around the bounding sphere. [`Fit::Extent`] shrinks each direction's grid to the scene's
//!   extent along each axis of its frame, at no cost in memory.
//! - Frames are integers ([`DirectionFrame`]), so that every backend puts every point into the same voxel.
//!
//! # Practice
//! The bake computes frames once and stores them in the archive; readers never compute them again.

use crate::trig::sin_cos_turns;
use bytemuck::{Pod, Zeroable};

/// Half the width of the row lattice: the scene's bounds span `-ROW_LATTICE ..= ROW_LATTICE` along each world axis.
pub const ROW_LATTICE: i32 = 1 << 14;
/// Bits of a raw row coordinate: the grid of any direction spans `0 .. 2^ROW_RAW_BITS` along each of its axes.
pub const ROW_RAW_BITS: u32 = 29;

/// A set of sampled directions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DirectionSet {
    /// Theta (from +Y) and phi (from +X towards +Z) in equal steps over [0°, 180°) each; index `theta * phis + phi`.
    /// The paper's set has 90 × 90.
    LatLong {
        /// Steps of theta.
        thetas: u32,
        /// Steps of phi.
        phis: u32,
    },
    /// Cell centres of an n × n hemi-octahedral map of the upper half space; index `row * n + column`.
    Octahedral {
        /// Cells a side.
        size: u32,
    },
}

impl DirectionSet {
    /// Number of directions.
    pub fn count(self) -> u32 {
        match self {
            DirectionSet::LatLong { thetas, phis } => thetas * phis,
            DirectionSet::Octahedral { size } => size * size,
        }
    }

    /// The orthonormal frame of direction `index`: world-space unit vectors u, v, w with rows along w.
    /// Same bits on every host.
    pub fn frame(self, index: u32) -> [[f64; 3]; 3] {
        match self {
            DirectionSet::LatLong { thetas, phis } => {
                let (sin_t, cos_t) = sin_cos_turns(index / phis, 2 * thetas);
                let (sin_p, cos_p) = sin_cos_turns(index % phis, 2 * phis);
                [
                    [-sin_p, 0.0, cos_p],
                    [cos_t * cos_p, -sin_t, cos_t * sin_p],
                    [sin_t * cos_p, cos_t, sin_t * sin_p],
                ]
            }
            DirectionSet::Octahedral { size } => {
                let at = |i: u32| (f64::from(i) + 0.5) / f64::from(size) * 2.0 - 1.0;
                let (s, t) = (at(index % size), at(index / size));
                let (x, z) = ((s + t) / 2.0, (s - t) / 2.0);
                let w = normalized([x, 1.0 - x.abs() - z.abs(), z]);
                let horizontal = w[0] * w[0] + w[2] * w[2];
                let u = if horizontal > 1e-20 { normalized([-w[2], 0.0, w[0]]) } else { [1.0, 0.0, 0.0] };
                let v = [u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0]];
                [u, v, w]
            }
        }
    }

    /// Index of the sampled direction nearest to `direction` (any length, either sign; not zero) by the map's own
    /// rounding. The answer for a zero or non-finite vector is some valid index.
    pub fn nearest(self, direction: [f32; 3]) -> u32 {
        match self {
            DirectionSet::LatLong { thetas, phis } => {
                let [mut x, mut y, mut z] = direction;
                if z < 0.0 || (z == 0.0 && x < 0.0) {
                    [x, y, z] = [-x, -y, -z];
                }
                let theta = (x * x + z * z).sqrt().atan2(y) / std::f32::consts::PI * thetas as f32;
                let phi = z.atan2(x) / std::f32::consts::PI * phis as f32;
                let (mut theta, mut phi) = (theta.round() as u32, phi.round() as u32);
                if phi >= phis {
                    // (theta, 180°) is the opposite of (180° − theta, 0°).
                    phi = 0;
                    theta = thetas - theta.min(thetas);
                }
                (theta % thetas) * phis + phi
            }
            DirectionSet::Octahedral { size } => {
                let [x, y, z] = direction;
                let scale = 1.0 / (x.abs() + y.abs() + z.abs()) * if y < 0.0 { -1.0 } else { 1.0 };
                let (x, z) = (x * scale, z * scale);
                // `as` saturates and turns NaN into 0.
                let cell = |a: f32| (((a + 1.0) * 0.5 * size as f32) as u32).min(size - 1);
                cell(x - z) * size + cell(x + z)
            }
        }
    }
}

impl std::fmt::Display for DirectionSet {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            DirectionSet::LatLong { thetas, phis } => write!(f, "latlong:{thetas}x{phis}"),
            DirectionSet::Octahedral { size } => write!(f, "octahedral:{size}"),
        }
    }
}

impl std::str::FromStr for DirectionSet {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |s: &str| s.parse::<u32>().ok().filter(|n| (1..=512).contains(n));
        let set = match text.split_once(':') {
            Some(("latlong", size)) => size
                .split_once('x')
                .and_then(|(t, p)| Some(DirectionSet::LatLong { thetas: number(t)?, phis: number(p)? })),
            Some(("octahedral", size)) => number(size).map(|size| DirectionSet::Octahedral { size }),
            _ => None,
        };
        set.ok_or_else(|| {
            format!("`{text}` is no direction set: write latlong:THETASxPHIS or octahedral:N, each 1 to 512")
        })
    }
}

fn normalized(v: [f64; 3]) -> [f64; 3] {
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    v.map(|c| c / length)
}

/// How a direction's grid lies around the scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fit {
    /// A cube around the bounding sphere, the same for every direction (the paper's).
    Cube,
    /// A box around the scene's extent along each axis of the direction's frame, which is turned about the direction
    /// to make it small.
    Extent,
}

/// World space to the integer lattice that all row frames start from: per world axis, the scene's bounds span
/// `-ROW_LATTICE ..= ROW_LATTICE`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RowLattice {
    /// Centre of the scene's bounds, metres.
    pub center: [f64; 3],
    /// Half the extent of the scene's bounds, metres; never zero.
    pub half_extent: [f64; 3],
}

impl RowLattice {
    /// The lattice over world bounds. An axis gets at least 1/64 of the largest extent: the segment test cuts segments
    /// after a number of steps ([`crate::row_test`]), and in finer ones those from a flat scene's ground would end
    /// below what they are lifted off it.
    pub fn new(min: [f64; 3], max: [f64; 3]) -> Self {
        let half = [0, 1, 2].map(|i| (max[i] - min[i]) * 0.5);
        let floor = half[0].max(half[1]).max(half[2]) / 64.0;
        Self { center: [0, 1, 2].map(|i| (min[i] + max[i]) * 0.5), half_extent: half.map(|h| h.max(floor)) }
    }

    /// Nearest lattice point, clamped to the lattice. NaN becomes 0.
    #[inline]
    pub fn snap(&self, world: [f64; 3]) -> [i16; 3] {
        let limit = f64::from(ROW_LATTICE);
        [0, 1, 2].map(|i| {
            let steps = ((world[i] - self.center[i]) / self.half_extent[i] * limit + 0.5).floor();
            steps.clamp(-limit, limit) as i16
        })
    }

    /// World position of a lattice point.
    pub fn world(&self, point: [i16; 3]) -> [f64; 3] {
        [0, 1, 2].map(|i| self.center[i] + f64::from(point[i]) / f64::from(ROW_LATTICE) * self.half_extent[i])
    }
}

/// One direction's integer transform, 48 bytes: `raw = row_from_lattice · p + offset` for a lattice point p, each raw
/// coordinate clamped to `0 .. 2^29`; the voxel is its top bits: `raw >> (29 - bits)`.
///
/// Every entry of the matrix is below 2^15 and every lattice coordinate at most 2^14 in magnitude, so that no sum
/// leaves an `i32`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct DirectionFrame {
    /// Rows of the matrix: axes u, v, w (rows of voxels run along w).
    pub row_from_lattice: [[i32; 3]; 3],
    /// Added to each raw coordinate.
    pub offset: [i32; 3],
}

impl DirectionFrame {
    /// The frame with world-space unit vectors `axes` (u, v, w). `extents` are the scene's smallest and largest
    /// coordinates along them relative to the lattice's centre, in metres (from [`extents_along`]).
    pub fn new(axes: [[f64; 3]; 3], lattice: &RowLattice, fit: Fit, extents: [[f64; 2]; 3]) -> Self {
        let mut frame = Self { row_from_lattice: [[0; 3]; 3], offset: [0; 3] };
        let diameter = 2.0 * lattice.half_extent.iter().map(|h| h * h).sum::<f64>().sqrt();
        for a in 0..3 {
            let steep = (0..3).map(|i| (axes[a][i] * lattice.half_extent[i]).abs()).fold(0.0, f64::max);
            let (middle, range) = match fit {
                Fit::Cube => (0.0, diameter * (1.0 + 1.0 / 256.0)),
                Fit::Extent => {
                    let [lo, hi] = extents[a];
                    ((lo + hi) * 0.5, ((hi - lo) * (1.0 + 1.0 / 256.0)).max(steep * (1.0 + 1.0 / 256.0)))
                }
            };
            let raw_per_metre = f64::from(1u32 << ROW_RAW_BITS) / range;
            for i in 0..3 {
                let entry = axes[a][i] * lattice.half_extent[i] / f64::from(ROW_LATTICE) * raw_per_metre;
                frame.row_from_lattice[a][i] = ((entry + 0.5).floor() as i32).clamp(-32767, 32767);
            }
            let half = f64::from(1u32 << (ROW_RAW_BITS - 1));
            frame.offset[a] = (half - middle * raw_per_metre + 0.5).floor() as i32;
        }
        frame
    }

    /// Raw coordinates along u, v, w of a lattice point, each in `0 .. 2^29`.
    #[inline]
    pub fn raw(&self, p: [i16; 3]) -> [i32; 3] {
        let p = p.map(i32::from);
        [0, 1, 2].map(|a| {
            let m = self.row_from_lattice[a];
            (m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + self.offset[a]).clamp(0, (1 << ROW_RAW_BITS) - 1)
        })
    }

    /// Voxel (u, v, w) of a lattice point in a grid of `2^bits` voxels a side.
    #[inline]
    pub fn voxel(&self, p: [i16; 3], bits: u32) -> [u32; 3] {
        self.raw(p).map(|raw| raw as u32 >> (ROW_RAW_BITS - bits))
    }

    /// The transform in floats: voxel coordinates (u, v, w) of a world position are
    /// `matrix · (world − lattice.center) + offset`, row by row.
    pub fn voxel_from_world(&self, lattice: &RowLattice, bits: u32) -> ([[f64; 3]; 3], [f64; 3]) {
        let scale = 1.0 / f64::from(1u32 << (ROW_RAW_BITS - bits));
        let matrix = self.row_from_lattice.map(|row| {
            [0, 1, 2].map(|i| f64::from(row[i]) * f64::from(ROW_LATTICE) / lattice.half_extent[i] * scale)
        });
        (matrix, self.offset.map(|o| f64::from(o) * scale))
    }
}

/// Smallest and largest coordinate along each axis of `axes` over `boxes` (min and max corners in lattice points, of
/// tight boxes around parts of the scene), in metres from the lattice's centre. Conservative; the smaller the boxes
/// the tighter.
pub fn extents_along<const N: usize>(
    axes: [[f64; 3]; N],
    lattice: &RowLattice,
    boxes: &[[[i16; 3]; 2]],
) -> [[f64; 2]; N] {
    axes.map(|axis| {
        let metres = metres_along(axis, lattice);
        let extent = boxes.iter().fold(NO_EXTENT, |extent, b| joined(extent, extent_of(b, metres)));
        if extent[0] > extent[1] { [0.0, 0.0] } else { extent }
    })
}

const NO_EXTENT: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];

/// Metres along an axis of one lattice step along x, y and z.
fn metres_along(axis: [f64; 3], lattice: &RowLattice) -> [f64; 3] {
    [0, 1, 2].map(|i| axis[i] * lattice.half_extent[i] / f64::from(ROW_LATTICE))
}

/// The extent of a box. Rounding keeps the order of numbers, so that a box within another never sticks out of it here.
fn extent_of([min, max]: &[[i16; 3]; 2], metres: [f64; 3]) -> [f64; 2] {
    let mut extent = [0.0; 2];
    for i in 0..3 {
        let (a, b) = (metres[i] * f64::from(min[i]), metres[i] * f64::from(max[i]));
        extent = [extent[0] + a.min(b), extent[1] + a.max(b)];
    }
    extent
}

fn joined(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// Boxes in groups of neighbours. Most groups lie between others along any axis, and are not looked into.
pub struct GroupedBoxes<'a> {
    boxes: &'a [[[i16; 3]; 2]],
    /// A box around each [`Self::GROUP`] of them.
    groups: Vec<[[i16; 3]; 2]>,
}

impl<'a> GroupedBoxes<'a> {
    const GROUP: usize = 16;

    /// `boxes` as for [`extents_along`], in an order that keeps neighbours together.
    pub fn new(boxes: &'a [[[i16; 3]; 2]]) -> Self {
        let around = |group: &[[[i16; 3]; 2]]| {
            group.iter().fold(group[0], |[lo, hi], [min, max]| {
                [[0, 1, 2].map(|i| lo[i].min(min[i])), [0, 1, 2].map(|i| hi[i].max(max[i]))]
            })
        };
        Self { boxes, groups: boxes.chunks(Self::GROUP).map(around).collect() }
    }

    /// What [`extents_along`] gives for all of the boxes, bit for bit.
    pub fn extents_along<const N: usize>(&self, axes: [[f64; 3]; N], lattice: &RowLattice) -> [[f64; 2]; N] {
        axes.map(|axis| {
            let metres = metres_along(axis, lattice);
            let mut outermost = [(f64::INFINITY, 0), (f64::NEG_INFINITY, 0)];
            for (index, group) in self.groups.iter().enumerate() {
                let [lo, hi] = extent_of(group, metres);
                outermost = [
                    if lo < outermost[0].0 { (lo, index) } else { outermost[0] },
                    if hi > outermost[1].0 { (hi, index) } else { outermost[1] },
                ];
            }
            let with_group = |extent, index: usize| {
                let start = index * Self::GROUP;
                let group = &self.boxes[start..(start + Self::GROUP).min(self.boxes.len())];
                group.iter().fold(extent, |extent, b| joined(extent, extent_of(b, metres)))
            };
            if self.groups.is_empty() {
                return [0.0; 2];
            }
            let mut extent =
                outermost.iter().fold(NO_EXTENT, |extent, (_, index)| with_group(extent, *index));
            for (index, group) in self.groups.iter().enumerate() {
                let [lo, hi] = extent_of(group, metres);
                if lo < extent[0] || hi > extent[1] {
                    extent = with_group(extent, index);
                }
            }
            extent
        })
    }
}

/// Rolls that [`rolled_to_fit`] tries within a quarter turn.
pub const ROLLS: u32 = 24;

/// Axes u and v turned about w by a roll of [`ROLLS`] in a quarter turn.
pub fn rolled([u, v, _]: [[f64; 3]; 3], roll: u32) -> [[f64; 3]; 2] {
    let (sin, cos) = sin_cos_turns(roll, 4 * ROLLS);
    [[0, 1, 2].map(|i| cos * u[i] + sin * v[i]), [0, 1, 2].map(|i| cos * v[i] - sin * u[i])]
}

/// `axes` turned about w so that the scene's extents along u and v enclose the smallest area: a long scene seen along
/// its diagonal would else leave most rows empty.
pub fn rolled_to_fit(axes: [[f64; 3]; 3], lattice: &RowLattice, boxes: &GroupedBoxes) -> [[f64; 3]; 3] {
    let mut best = (f64::INFINITY, axes);
    for roll in 0..ROLLS {
        let [u, v] = rolled(axes, roll);
        let [[u_min, u_max], [v_min, v_max]] = boxes.extents_along([u, v], lattice);
        let area = (u_max - u_min) * (v_max - v_min);
        if area < best.0 {
            best = (area, [u, v, axes[2]]);
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn grouped_boxes_reach_as_far_bit_for_bit(
            boxes in prop::collection::vec((prop::array::uniform3(-16384i16..16384), 0i16..9000), 0..200),
            directions in prop::array::uniform3(0u32..8100),
            size in prop::array::uniform3(0.0f64..50.0),
        ) {
            let around = |(p, size): ([i16; 3], i16)| [p, p.map(|c| c.saturating_add(size).min(16384))];
            let boxes: Vec<_> = boxes.into_iter().map(around).collect();
            let lattice = RowLattice::new([0.0; 3], size);
            for direction in directions {
                let axes = SETS[0].frame(direction);
                let grouped = GroupedBoxes::new(&boxes).extents_along(axes, &lattice);
                prop_assert_eq!(
                    grouped.map(|e| e.map(f64::to_bits)),
                    extents_along(axes, &lattice, &boxes).map(|e| e.map(f64::to_bits))
                );
            }
        }
    }

    const SETS: [DirectionSet; 4] = [
        DirectionSet::LatLong { thetas: 90, phis: 90 },
        DirectionSet::LatLong { thetas: 7, phis: 12 },
        DirectionSet::Octahedral { size: 90 },
        DirectionSet::Octahedral { size: 5 },
    ];

    #[test]
    fn frames_are_orthonormal() {
        for set in SETS {
            for index in 0..set.count() {
                let f = set.frame(index);
                for a in 0..3 {
                    for b in 0..3 {
                        let dot: f64 = (0..3).map(|i| f[a][i] * f[b][i]).sum();
                        assert!((dot - f64::from(u8::from(a == b))).abs() < 1e-12, "{set} {index}");
                    }
                }
            }
        }
    }

    #[test]
    fn every_direction_is_its_own_nearest_in_both_signs() {
        for set in SETS {
            for index in 0..set.count() {
                let w = set.frame(index)[2].map(|c| c as f32);
                for sign in [1.0, -1.0] {
                    let found = set.nearest(w.map(|c| c * sign));
                    let found_w = set.frame(found)[2];
                    let dot: f64 = (0..3).map(|i| found_w[i] * f64::from(w[i])).sum();
                    // At a pole all phi are one direction.
                    assert!(dot.abs() > 1.0 - 1e-6, "{set} {index} found {found}");
                }
            }
        }
    }

    #[test]
    fn the_nearest_direction_is_within_a_step() {
        for (set, degrees) in [(SETS[0], 1.5), (SETS[2], 1.8)] {
            for i in 0..2000u32 {
                let a = f64::from(i) * 2.399_963;
                let y = 1.0 - 2.0 * (f64::from(i) + 0.5) / 2000.0;
                let (s, c) = crate::trig::sin_cos(a);
                let r = (1.0 - y * y).sqrt();
                let d = [r * c, y, r * s];
                let w = set.frame(set.nearest(d.map(|c| c as f32)))[2];
                let dot: f64 = (0..3).map(|i| w[i] * d[i]).sum();
                assert!(dot.abs().min(1.0).acos().to_degrees() < degrees, "{set} {d:?}: {dot}");
            }
        }
    }

    #[test]
    fn corner_points_stay_inside_and_round_trip() {
        let lattice = RowLattice::new([-10.0, 0.0, -300.0], [30.0, 2.0, 200.0]);
        let corners: Vec<[i16; 3]> =
            (0..8).map(|c| [0, 1, 2].map(|i| if c >> i & 1 == 1 { 16384 } else { -16384i16 })).collect();
        let boxes = [[corners[0], corners[7]]];
        for fit in [Fit::Cube, Fit::Extent] {
            for index in 0..SETS[0].count() {
                let extents = extents_along(SETS[0].frame(index), &lattice, &boxes);
                let frame = DirectionFrame::new(SETS[0].frame(index), &lattice, fit, extents);
                let (matrix, offset) = frame.voxel_from_world(&lattice, 7);
                for &p in &corners {
                    let world = lattice.world(p);
                    assert_eq!(lattice.snap(world), p);
                    for a in 0..3 {
                        let float: f64 =
                            (0..3).map(|i| matrix[a][i] * (world[i] - lattice.center[i])).sum::<f64>()
                                + offset[a];
                        assert!((0.0..=128.0).contains(&float), "{fit:?} {index} {a}: {float}");
                        assert_eq!(frame.voxel(p, 7)[a], (float.floor() as u32).min(127));
                    }
                }
            }
        }
    }

    #[test]
    fn a_diagonal_strip_is_seen_square() {
        // A thin strip along x = z, looked at from above: turned by 45 degrees it fills its grid.
        let lattice = RowLattice::new([0.0; 3], [10.0, 1.0, 10.0]);
        let boxes: Vec<_> =
            (-16..16).map(|i| [[i * 1000, 0, i * 1000], [i * 1000 + 900, 9, i * 1000 + 900]]).collect();
        let axes = SETS[0].frame(0);
        let area = |axes| {
            let [u, v, _] = extents_along(axes, &lattice, &boxes);
            (u[1] - u[0]) * (v[1] - v[0])
        };
        let rolled = rolled_to_fit(axes, &lattice, &GroupedBoxes::new(&boxes));
        assert!(area(rolled) < area(axes) / 10.0);
        assert_eq!(rolled[2], axes[2], "rows still run along the direction");
    }

    #[test]
    fn names_round_trip() {
        for set in SETS {
            assert_eq!(set.to_string().parse(), Ok(set));
        }
        assert!("latlong:0x3".parse::<DirectionSet>().is_err());
        assert!("octahedral:100000".parse::<DirectionSet>().is_err());
        assert!("sphere".parse::<DirectionSet>().is_err());
    }
}
