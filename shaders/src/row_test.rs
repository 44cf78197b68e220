//! The constant-time segment test in integers: what `lib_rows.wgsl` computes, line by line.
//!
//! # Theory
//! \[WMP\] Algorithm 2: the sampled direction nearest to the segment, one row of its voxelization, all bits outside the
//! segment's extent cleared; the segment is occluded iff a bit is left.
//!
//! # Differences from the paper
//! - *Which row.* The paper takes the row through the segment's midpoint, which leaves the segment by up to a voxel and
//!   a half at its ends. Near its origin lies the surface that it starts from, near its target mostly air: so the row is
//!   taken through the point at [`Rows::Single`]'s 3/16 of the way. [`Rows::Split`] takes two rows, one for the first
//!   quarter and one for the rest.
//! - *Consensus.* A voxel is set where a surface touches any part of it, which makes everything half a voxel fatter.
//!   With it a bit counts only if the row's neighbours on the segment's side have one next to it.
//! - *Bias.* The origin moves off its own surface along the surface's normal, by a length that lifts the voxels which
//!   the surface touches out of the row, whatever its slope in the direction's grid.
//! - *Direction look-up.* A table over a cube's faces ([`DirectionTable`](crate::direction_table::DirectionTable)) holds the nearest direction of any set: no
//!   trigonometry, the same cost for every set.
//! - *Integers.* From the lattice on, everything is in `i32`, and no float operation before that can be rounded in two
//!   ways: all processors agree on every bit, whether they fuse multiplications and additions or not.

use crate::directions::{DirectionFrame, ROW_LATTICE, ROW_RAW_BITS, RowLattice};
use bytemuck::{Pod, Zeroable};

/// Bits of a coordinate along a row frame's axis: the grid spans `0 .. 2^TEST_RAW_BITS`. Three fewer than the bake's,
/// so that ends far outside the grid have room.
pub const TEST_RAW_BITS: u32 = 26;
/// Origins within so many lattice steps of the centre (twice the scene's half extent) take the short way.
pub const NEAR_STEPS: f32 = 2.0 * ROW_LATTICE as f32;
/// Segments longer or shorter than this, in metres or lattice steps, are not segments: `1e30` and `1e-30`.
pub const LONGEST: f32 = 1e30;
/// See [`LONGEST`].
pub const SHORTEST: f32 = 1e-30;
/// Unit normals in lattice space have at most this many steps along an axis.
pub const NORMAL_STEPS: f32 = 4096.0;
/// What is dropped of a normal before it is scaled by a voxel's edges.
pub const NORMAL_DROP: u32 = 14;
/// Halvings of a segment whose ends are both far outside the scene, until it is near or missed.
pub const MAX_HALVINGS: u32 = 128;

/// One direction of the rows as the test needs it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TestFrame {
    /// Rows of the matrix from lattice steps to raw coordinates along u, v, w; each entry at most 2^12.
    pub raw_from_lattice: [[i32; 3]; 3],
    /// Added to each raw coordinate.
    pub offset: [i32; 3],
    /// A voxel's edge along u, v and w, squared, in a unit of the direction's own: at most 2^15. The inverse transpose
    /// of a matrix with orthogonal axes is the matrix times these, which turns normals.
    pub edge_squared: [i32; 3],
}

/// A [`TestFrame`] for shaders, with the corner of its tile, 48 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct PackedFrame {
    /// Nine matrix entries row by row and the first of the squared edges, 16 bits each, the first in the low half; the
    /// other two squared edges; the three offsets; the corner's x and, in the upper half, y; its layer; zero.
    pub words: [u32; 12],
}

impl TestFrame {
    /// The frame of the bake, in fewer bits.
    pub fn new(frame: &DirectionFrame, lattice: &RowLattice) -> Self {
        let drop = ROW_RAW_BITS - TEST_RAW_BITS;
        let rounded = |c: i32| (c + (1 << (drop - 1))) >> drop;
        let (matrix, _) = frame.voxel_from_world(lattice, 7);
        let edges = matrix.map(|row| {
            let squared: f64 = row.iter().map(|c| c * c).sum();
            if squared > 0.0 { 1.0 / squared } else { 0.0 }
        });
        let largest = edges.iter().fold(f64::MIN_POSITIVE, |a, b| a.max(*b));
        Self {
            raw_from_lattice: frame.row_from_lattice.map(|row| row.map(rounded)),
            offset: frame.offset.map(rounded),
            edge_squared: edges.map(|edge| ((edge / largest * 32767.0) as i32).max(1)),
        }
    }

    /// For shaders; `corner` is the texel (x, y, layer) at the corner of the direction's tile.
    pub fn packed(&self, corner: [u32; 3]) -> PackedFrame {
        let mut words = [0u32; 12];
        let halves = self.raw_from_lattice.as_flattened().iter().chain(&self.edge_squared);
        for (i, &half) in halves.enumerate() {
            words[i / 2] |= u32::from(half as u16) << (16 * (i % 2));
        }
        words[6..9].copy_from_slice(&self.offset.map(|c| c as u32));
        words[9] = corner[0] | corner[1] << 16;
        words[10] = corner[2];
        PackedFrame { words }
    }
}

impl PackedFrame {
    /// As it was packed.
    pub fn unpacked(&self) -> TestFrame {
        let half = |i: usize| i32::from((self.words[i / 2] >> (16 * (i % 2))) as i16);
        TestFrame {
            raw_from_lattice: [0, 3, 6].map(|i| [half(i), half(i + 1), half(i + 2)]),
            offset: [6, 7, 8].map(|i| self.words[i] as i32),
            edge_squared: [half(9), half(10), half(11)],
        }
    }
}

/// Which rows a test looks at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Rows {
    /// One, through the point at 3/16 of the segment.
    #[default]
    Single,
    /// Two: for the first quarter one through 1/8, for the rest one through 5/8 of the segment.
    Split,
}

/// How segments are tested.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TestSettings {
    /// Which rows are looked at.
    pub rows: Rows,
    /// Whether a bit needs bits beside it.
    pub consensus: bool,
    /// The origin moves this far along its normal, in voxels: so far along the axis of the direction's grid that the
    /// normal is closest to, and in proportion along the others. At most 16.
    pub normal_voxels: f32,
    /// Then the row is skipped for this far, in voxels. At most 16.
    pub skip_voxels: f32,
}

impl TestSettings {
    /// Nothing is left out: for origins that are on no surface.
    pub const NO_BIAS: Self =
        Self { rows: Rows::Single, consensus: false, normal_voxels: 0.0, skip_voxels: 0.0 };
    /// The cheapest: one row.
    pub const FAST: Self = Self { normal_voxels: 1.0, skip_voxels: 0.5, ..Self::NO_BIAS };
    /// The most exact.
    pub const EXACT: Self = Self { rows: Rows::Split, consensus: true, ..Self::FAST };
}

impl Default for TestSettings {
    fn default() -> Self {
        Self::EXACT
    }
}

/// What the test needs to know of an archive, 64 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct RowTestParams {
    /// Centre of the row lattice, metres.
    pub center: [f32; 3],
    /// log2 of voxels a side.
    pub bits: u32,
    /// Lattice steps per metre.
    pub steps_per_metre: [f32; 3],
    /// [`TestSettings::normal_voxels`], a quarter of it, in raw steps.
    pub normal_quarter: i32,
    /// Steps of a unit normal along each axis of the lattice, at most [`NORMAL_STEPS`].
    pub normal_steps: [f32; 3],
    /// [`TestSettings::skip_voxels`] in raw steps.
    pub skip: i32,
    /// 1 for [`Rows::Split`].
    pub split: u32,
    /// [`TestSettings::consensus`].
    pub consensus: u32,
    /// Zero. Shaders combine floats with it where a compiler must not fuse a product with a sum.
    pub zero: u32,
    /// Zero.
    pub reserved: u32,
}

impl RowTestParams {
    /// For rows of `2^bits` voxels a side over `lattice`.
    pub fn new(lattice: &RowLattice, bits: u32, settings: &TestSettings) -> Self {
        let voxel = (1u32 << (TEST_RAW_BITS - bits)) as f32;
        let raw = |voxels: f32| (voxels.clamp(0.0, 16.0) * voxel) as i32;
        let smallest = lattice.half_extent.iter().fold(f64::INFINITY, |a, b| a.min(*b));
        Self {
            center: lattice.center.map(|c| c as f32),
            bits,
            steps_per_metre: lattice.half_extent.map(|h| (f64::from(ROW_LATTICE) / h) as f32),
            normal_steps: lattice.half_extent.map(|h| (f64::from(NORMAL_STEPS) * smallest / h) as f32),
            normal_quarter: raw(settings.normal_voxels) / 4,
            skip: raw(settings.skip_voxels),
            split: u32::from(settings.rows == Rows::Split),
            consensus: u32::from(settings.consensus),
            zero: 0,
            reserved: 0,
        }
    }

    /// A unit normal in steps, as a normal is turned by the lattice's inverse.
    #[inline(always)]
    pub fn normal_in_steps(&self, normal: [f32; 3]) -> [i32; 3] {
        [0, 1, 2].map(|i| whole((normal[i] * self.normal_steps[i]).floor()))
    }

    /// A world position in lattice steps from the centre.
    #[inline(always)]
    pub fn lattice_from_world(&self, position: [f32; 3]) -> [f32; 3] {
        // A difference, then a product: nothing that could be fused.
        [0, 1, 2].map(|i| (position[i] - self.center[i]) * self.steps_per_metre[i])
    }
}

/// Whether a float is finite and at most `limit` in magnitude; decided on its bits, because shader compilers may assume
/// that there is no NaN.
#[inline(always)]
pub fn is_within(value: f32, limit: f32) -> bool {
    value.to_bits() & 0x7fff_ffff <= limit.to_bits()
}

/// [`is_within`] for every coordinate.
#[inline(always)]
pub fn all_within(v: [f32; 3], limit: f32) -> bool {
    is_within(v[0], limit) & is_within(v[1], limit) & is_within(v[2], limit)
}

#[inline(always)]
fn max_abs(v: [f32; 3]) -> f32 {
    let [x, y, z] = v.map(f32::abs);
    let xy = if x > y { x } else { y };
    if xy > z { xy } else { z }
}

/// A segment in lattice steps, cut to the scene's surroundings.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LatticeSegment {
    /// Of the origin.
    pub origin: [i32; 3],
    /// To the target.
    pub way: [i32; 3],
    /// Which share of the segment was cut off before the origin.
    pub cut: f32,
    /// Which share of the segment is left.
    pub share: f32,
    /// Whether it is a segment at all, and not sure to miss the scene.
    pub is_valid: bool,
}

/// The factor that brings a vector of largest coordinate `length` below 2^16 steps, but not below 2^15: a power of two.
#[inline(always)]
pub fn shortening(length: f32) -> f32 {
    let exponent = (length.to_bits() >> 23) as i32 - 127;
    let k = if exponent > 15 { exponent - 15 } else { 0 };
    f32::from_bits(((127 - k) as u32) << 23)
}

/// A float without a fraction, below 2^22 in magnitude, as an integer; anything for others. `as i32` would ask for the
/// cases that cannot be, one lane after the other.
#[inline(always)]
pub fn whole(value: f32) -> i32 {
    // From 2^23 on, floats are a unit apart, so that their bits count.
    const UNIT: f32 = 12_582_912.0;
    ((value + UNIT).to_bits() as i32).wrapping_sub(UNIT.to_bits() as i32)
}

#[inline(always)]
fn to_steps(v: [f32; 3]) -> [i32; 3] {
    v.map(|c| whole(c.floor()))
}

/// The segment from `origin` along `way`, both in lattice steps. An origin farther than [`NEAR_STEPS`] takes
/// [`cut_far_segment`] instead.
#[inline(always)]
pub fn cut_segment(origin: [f32; 3], way: [f32; 3]) -> LatticeSegment {
    let length = max_abs(way);
    let share = shortening(length);
    LatticeSegment {
        origin: to_steps(origin),
        // What is cut off lies outside the scene: the origin is within two half extents, the rest at least three away.
        way: to_steps(way.map(|c| c * share)),
        cut: 0.0,
        share,
        is_valid: all_within(way, LONGEST) & !all_within(way, SHORTEST),
    }
}

/// The same for an origin anywhere. Ends are moved towards a point near the scene by powers of two, which rounds the
/// same everywhere; where both are far away, that point is looked for by halving.
pub fn cut_far_segment(origin: [f32; 3], target: [f32; 3]) -> LatticeSegment {
    let none = LatticeSegment::default();
    if !all_within(origin, LONGEST) || !all_within(target, LONGEST) {
        return none;
    }
    let edge = ROW_LATTICE as f32;
    let beyond = |a: [f32; 3], b: [f32; 3]| {
        (0..3).any(|i| (a[i] > edge && b[i] > edge) || (a[i] < -edge && b[i] < -edge))
    };
    let (mut from, mut to) = (origin, target);
    // The kept piece is [cut, cut + share] of the segment.
    let (mut cut, mut share) = (0.0f32, 1.0f32);
    let mut pivot = target;
    let mut pivot_at = 1.0f32;
    if max_abs(target) > NEAR_STEPS {
        let mut halvings = 0;
        loop {
            if halvings == MAX_HALVINGS || beyond(from, to) {
                return none;
            }
            halvings += 1;
            let middle = [0, 1, 2].map(|i| from[i] * 0.5 + to[i] * 0.5);
            let half = share * 0.5;
            if max_abs(middle) <= NEAR_STEPS {
                pivot = middle;
                pivot_at = cut + half;
                break;
            }
            // The middle is beyond some face, and then so is one of the ends, with all between them.
            if beyond(from, middle) {
                from = middle;
                cut += half;
            } else {
                to = middle;
            }
            share = half;
        }
    }
    let before = [0, 1, 2].map(|i| from[i] - pivot[i]);
    let after = [0, 1, 2].map(|i| to[i] - pivot[i]);
    let (s, e) = (shortening(max_abs(before)), shortening(max_abs(after)));
    let start = [0, 1, 2].map(|i| pivot[i] + before[i] * s);
    let way = [0, 1, 2].map(|i| after[i] * e - before[i] * s);
    let start_at = pivot_at - (pivot_at - cut) * s;
    LatticeSegment {
        origin: to_steps(start),
        way: to_steps(way),
        cut: start_at,
        share: pivot_at + (cut + share - pivot_at) * e - start_at,
        is_valid: true,
    }
}

/// Part of a row to look at. Empty if `first > last`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RowPart {
    /// The row's place among the direction's rows: `v << bits | u`.
    pub row: u32,
    /// First bit.
    pub first: i32,
    /// Last bit.
    pub last: i32,
    /// 1 if the segment is on the larger side of the row along u, in bit 0; along v, in bit 1.
    pub sides: u32,
}

/// The parts of a test, and what makes distances of bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RowPlan {
    /// The row, or the first of two.
    pub near: RowPart,
    /// The second row; empty if there is one only.
    pub far: RowPart,
    /// Raw coordinate along w of the origin before it was moved.
    pub origin_w: i32,
    /// Raw way along w.
    pub way_w: i32,
}

#[inline(always)]
fn dot(a: [i32; 3], b: [i32; 3]) -> i32 {
    a[0].wrapping_mul(b[0]).wrapping_add(a[1].wrapping_mul(b[1])).wrapping_add(a[2].wrapping_mul(b[2]))
}

/// How far an origin moves along an axis: its share of the normal in quarters, times a quarter of the bias.
#[inline(always)]
fn lifted(normal: i32, largest: i32, quarter: i32) -> i32 {
    let eight = normal.wrapping_abs().wrapping_mul(8);
    let at_least = |eighths: i32| i32::from(eight > largest * eighths);
    let quarters = at_least(1) + at_least(3) + at_least(5) + at_least(7);
    let shift = quarters * quarter;
    if normal < 0 { -shift } else { shift }
}

/// Which rows a segment looks at in its direction, and which bits.
///
/// `SPLIT` is [`RowTestParams::split`], known when compiled. `normal` is [`RowTestParams::normal_in_steps`]; zero for a
/// free origin.
#[inline(always)]
pub fn plan_rows<const SPLIT: bool>(
    params: &RowTestParams,
    frame: &TestFrame,
    segment: &LatticeSegment,
    normal: [i32; 3],
) -> RowPlan {
    let raw = frame.raw_from_lattice.map(|row| dot(row, segment.origin));
    let raw = [0, 1, 2].map(|a| raw[a].wrapping_add(frame.offset[a]));
    let way = frame.raw_from_lattice.map(|row| dot(row, segment.way));
    let turned = frame.raw_from_lattice.map(|row| dot(row, normal) >> NORMAL_DROP);
    let normal = [0, 1, 2].map(|a| turned[a].wrapping_mul(frame.edge_squared[a]));
    let [a, b, c] = normal.map(i32::wrapping_abs);
    let ab = if a > b { a } else { b };
    let largest = if ab > c { ab } else { c };
    let from = [0, 1, 2].map(|i| raw[i].wrapping_add(lifted(normal[i], largest, params.normal_quarter)));
    let skip = if largest == 0 { 0 } else { params.skip };
    let to = [0, 1, 2].map(|i| raw[i].wrapping_add(way[i]));
    let way_from = [0, 1, 2].map(|i| to[i].wrapping_sub(from[i]));
    let upwards = way[2] >= 0;
    let start = from[2].wrapping_add(if upwards { skip } else { -skip });
    let border = from[2].wrapping_add(way_from[2] >> 2);
    let near_end = if SPLIT { border } else { to[2] };
    let single = |i: usize| from[i].wrapping_add(way_from[i] >> 3).wrapping_add(way_from[i] >> 4);
    let first = |i: usize| from[i].wrapping_add(way_from[i] >> 3);
    let second = |i: usize| from[i].wrapping_add(way_from[i] >> 1).wrapping_add(way_from[i] >> 3);
    let near = [0, 1].map(|i| if SPLIT { first(i) } else { single(i) });
    let far = [0, 1].map(second);
    // Where skipping the origin's surface skips the first row's piece, it goes on in the second.
    let is_skipped = if upwards { start > border } else { start < border };
    let far_start = if is_skipped { start } else { border };
    let mut far = row_part(params.bits, far, far_start, to[2], upwards);
    far.last = if SPLIT { far.last } else { -1 };
    RowPlan {
        near: row_part(params.bits, near, start, near_end, upwards),
        far,
        origin_w: raw[2],
        way_w: way[2],
    }
}

/// [`plan_rows`] as the parameters ask for.
#[inline]
pub fn plan_any(
    params: &RowTestParams,
    frame: &TestFrame,
    segment: &LatticeSegment,
    normal: [i32; 3],
) -> RowPlan {
    match params.split {
        1 => plan_rows::<true>(params, frame, segment, normal),
        _ => plan_rows::<false>(params, frame, segment, normal),
    }
}

/// The row at raw coordinates (u, v), from `start` to `end` along w.
#[inline(always)]
fn row_part(bits: u32, at: [i32; 2], start: i32, end: i32, upwards: bool) -> RowPart {
    let shift = TEST_RAW_BITS - bits;
    let [u, v] = at.map(|c| c >> shift);
    let size = 1i32 << bits;
    let (low, high) = if upwards { (start, end) } else { (end, start) };
    // An extent that was skipped in whole is turned around: it must not become one voxel.
    let is_inside = ((u | v) & !(size - 1) == 0) & (low <= high);
    let (low, high) = (low >> shift, high >> shift);
    let first = if low > 0 { low } else { 0 };
    let last = if high < size - 1 { high } else { size - 1 };
    let side = |c: i32| (c as u32) >> (shift - 1) & 1;
    RowPart {
        row: ((v & (size - 1)) as u32) << bits | (u & (size - 1)) as u32,
        first: if is_inside { first } else { 1 },
        last: if is_inside { last } else { 0 },
        sides: side(at[0]) | side(at[1]) << 1,
    }
}
