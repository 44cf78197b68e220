//! Sixteen segments at a time.
//!
//! The loops over lanes below are plain Rust without branches, so that the compiler turns them into vector code; they
//! are compiled three times, for AVX-512, AVX2 and whatever the target has, and chosen at run time. There is no other
//! arithmetic than that of [`manyview_shaders::row_test`], so that all three give the same answers.

use manyview_shaders::direction_table::table_cell;
use manyview_shaders::row_bits::{DirectionBits, row_mask, row_of_128};
use manyview_shaders::row_test::{
    LatticeSegment, NEAR_STEPS, RowPart, RowTestParams, TestFrame, all_within, cut_far_segment, cut_segment,
    plan_any, plan_rows, whole,
};
use manyview_shaders::row_view::first_share;
use manyview_shaders::testable::{MAX_NORMAL, MIN_LENGTH_SQUARED, testable};
use manyview_shaders::types::{LightPoint, Receiver, Segment};

use crate::simd::{SimdLevel, dispatched, prefetch};

/// Segments that are tested together.
pub(super) const LANES: usize = 16;
type Lanes<T> = [T; LANES];

/// What tests need, borrowed for a call.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    pub(super) params: &'a RowTestParams,
    pub(super) frames: &'a [TestFrame],
    pub(super) table: &'a [u16],
    pub(super) rows: &'a [u32],
}

impl<'a> View<'a> {
    /// What a lane looks at, and where.
    #[inline(always)]
    fn part(&self, parts: &Parts, lane: usize) -> (DirectionBits<'a>, RowPart) {
        let rows_bits = 2 * self.params.bits;
        let part = RowPart {
            row: parts.row[lane] & ((1 << rows_bits) - 1),
            first: parts.first[lane],
            last: parts.last[lane],
            sides: parts.sides[lane],
        };
        (self.direction(parts.row[lane] >> rows_bits), part)
    }

    /// The rows of a direction.
    #[inline(always)]
    fn direction(&self, direction: u32) -> DirectionBits<'a> {
        let words = 1usize << (3 * self.params.bits - 5);
        let first = direction as usize * words;
        DirectionBits {
            words: &self.rows[first..first + words],
            bits: self.params.bits,
            consensus: self.params.consensus == 1,
        }
    }
}

/// Origins of up to 16 segments, and what all tests from them share.
struct Origins {
    count: usize,
    position: [Lanes<f32>; 3],
    normal: [Lanes<f32>; 3],
    /// In lattice steps.
    steps: [Lanes<i32>; 3],
    normal_steps: [Lanes<i32>; 3],
    /// Lanes that [`cut_segment`] cannot do.
    far: u16,
    /// Lanes on a surface.
    on_surface: u16,
}

impl Origins {
    #[inline(always)]
    fn new(params: &RowTestParams, points: impl Iterator<Item = ([f32; 3], [f32; 3])>) -> Self {
        let mut origins = Self {
            count: 0,
            position: [[0.0; LANES]; 3],
            normal: [[0.0; LANES]; 3],
            steps: [[0; LANES]; 3],
            normal_steps: [[0; LANES]; 3],
            far: 0,
            on_surface: 0,
        };
        for (lane, (position, normal)) in points.enumerate().take(LANES) {
            let lattice = params.lattice_from_world(position);
            let is_near = all_within(lattice, NEAR_STEPS);
            let is_usable = all_within(normal, MAX_NORMAL);
            let normal = if is_usable { normal } else { [0.0; 3] };
            let steps = if is_near { lattice.map(|c| whole(c.floor())) } else { [0; 3] };
            let normal_steps = params.normal_in_steps(normal);
            for i in 0..3 {
                origins.position[i][lane] = position[i];
                origins.normal[i][lane] = normal[i];
                origins.steps[i][lane] = steps[i];
                origins.normal_steps[i][lane] = normal_steps[i];
            }
            origins.far |= u16::from(!is_near) << lane;
            origins.on_surface |= u16::from(normal != [0.0; 3]) << lane;
            origins.count = lane + 1;
        }
        origins
    }
}

/// Ways to targets.
struct Ways {
    /// World space, metres.
    world: [Lanes<f32>; 3],
    /// In lattice steps, cut to the scene's surroundings.
    steps: [Lanes<i32>; 3],
    share: Lanes<f32>,
    cell: Lanes<u32>,
    /// Lanes that hold a segment.
    valid: u16,
    /// Lanes whose target is in front of the origin's surface.
    facing: u16,
}

/// `target(lane)` is where each lane's segment ends.
#[inline(always)]
fn ways(params: &RowTestParams, origins: &Origins, target: impl Fn(usize) -> [f32; 3]) -> Ways {
    let mut ways = Ways {
        world: [[0.0; LANES]; 3],
        steps: [[0; LANES]; 3],
        share: [0.0; LANES],
        cell: [0; LANES],
        valid: 0,
        facing: 0,
    };
    let (mut valid, mut facing) = ([0u32; LANES], [0u32; LANES]);
    for lane in 0..LANES {
        let target = target(lane);
        let at = |i: usize| target[i] - origins.position[i][lane];
        let world = [at(0), at(1), at(2)];
        let steps = params.steps_per_metre;
        let way = [world[0] * steps[0], world[1] * steps[1], world[2] * steps[2]];
        // The origin is there already.
        let segment = cut_segment([0.0; 3], way);
        let normal = [origins.normal[0][lane], origins.normal[1][lane], origins.normal[2][lane]];
        for i in 0..3 {
            ways.world[i][lane] = world[i];
            ways.steps[i][lane] = segment.way[i];
        }
        ways.share[lane] = segment.share;
        ways.cell[lane] = table_cell(world);
        let [x, y, z] = world;
        let squared = x * x + y * y + z * z;
        let is_long = (squared > MIN_LENGTH_SQUARED) & (squared < f32::INFINITY);
        valid[lane] = u32::from(segment.is_valid & is_long);
        facing[lane] = u32::from(is_in_front(world, normal));
    }
    ways.valid = gathered(&valid);
    ways.facing = gathered(&facing);
    ways
}

/// A bit for every lane that is 1, not 0.
#[inline(always)]
fn gathered(flags: &Lanes<u32>) -> u16 {
    let mut bits = [0u32; LANES];
    for lane in 0..LANES {
        bits[lane] = flags[lane] << lane;
    }
    bits.iter().fold(0, |all, bit| all | bit) as u16
}

/// Whether a way leads to a surface's front.
#[inline(always)]
fn is_in_front(way: [f32; 3], normal: [f32; 3]) -> bool {
    way[0] * normal[0] + way[1] * normal[1] + way[2] * normal[2] > 0.0
}

/// Where lanes look.
struct Parts {
    /// The row's place among all rows of all directions.
    row: Lanes<u32>,
    first: Lanes<i32>,
    last: Lanes<i32>,
    sides: Lanes<u32>,
}

impl Parts {
    const EMPTY: Self = Self { row: [0; LANES], first: [0; LANES], last: [-1; LANES], sides: [0; LANES] };

    #[inline(always)]
    fn set(&mut self, lane: usize, part: RowPart, first_row: u32, is_mine: bool) {
        let or = |mine: i32, old: i32| if is_mine { mine } else { old };
        self.row[lane] = or((part.row + first_row) as i32, self.row[lane] as i32) as u32;
        self.first[lane] = or(part.first, self.first[lane]);
        self.last[lane] = or(part.last, self.last[lane]);
        self.sides[lane] = or(part.sides as i32, self.sides[lane] as i32) as u32;
    }
}

/// The parts of 16 tests, each in its own direction.
struct Plans {
    near: Parts,
    far: Parts,
}

impl Plans {
    const EMPTY: Self = Self { near: Parts::EMPTY, far: Parts::EMPTY };
}

#[inline(always)]
fn lattice_segment(origins: &Origins, ways: &Ways, lane: usize) -> LatticeSegment {
    let three = |v: &[Lanes<i32>; 3]| [v[0][lane], v[1][lane], v[2][lane]];
    LatticeSegment { origin: three(&origins.steps), way: three(&ways.steps), ..LatticeSegment::default() }
}

#[inline(always)]
fn normal_of(origins: &Origins, lane: usize) -> [i32; 3] {
    [origins.normal_steps[0][lane], origins.normal_steps[1][lane], origins.normal_steps[2][lane]]
}

/// Plans the tests of the `active` lanes, a direction at a time: neighbours mostly have the same.
#[inline(always)]
fn plan<const SPLIT: bool>(view: &View, origins: &Origins, ways: &Ways, mut active: u16, plans: &mut Plans) {
    let mut directions = [0u32; LANES];
    for lane in 0..LANES {
        directions[lane] = u32::from(view.table[ways.cell[lane] as usize]);
    }
    while active != 0 {
        let direction = directions[active.trailing_zeros() as usize];
        let frame = &view.frames[direction as usize];
        let first_row = direction << (2 * view.params.bits);
        let mut same = [0u32; LANES];
        for lane in 0..LANES {
            let is_mine = directions[lane] == direction;
            same[lane] = u32::from(is_mine);
            let segment = lattice_segment(origins, ways, lane);
            let plan = plan_rows::<SPLIT>(view.params, frame, &segment, normal_of(origins, lane));
            plans.near.set(lane, plan.near, first_row, is_mine);
            if SPLIT {
                plans.far.set(lane, plan.far, first_row, is_mine);
            }
        }
        active &= !gathered(&same);
    }
}

fn lanes(mut mask: u16) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = (mask != 0).then_some(mask.trailing_zeros() as usize)?;
        mask &= mask - 1;
        Some(lane)
    })
}

/// Every how many lanes a row is fetched ahead; those between mostly lie in the same cache lines.
const PREFETCH_STEP: usize = 2;

/// Lanes of `active` with a bit in their parts.
#[inline(always)]
fn hit_lanes(view: &View, parts: &Parts, active: u16) -> u16 {
    let bits = view.params.bits;
    if bits != 7 {
        let mut hits = 0;
        for lane in lanes(active) {
            let (direction, part) = view.part(parts, lane);
            hits |= u16::from(direction.any(&part)) << lane;
        }
        return hits;
    }
    let mut masks = [[0u64; LANES]; 2];
    for lane in 0..LANES {
        let mask = row_mask(parts.first[lane], parts.last[lane]);
        masks[0][lane] = mask[0];
        masks[1][lane] = mask[1];
    }
    // No branch here, so that many loads are on their way at once.
    let mut hits = 0u32;
    for lane in 0..LANES {
        let row = row_of_128(view.rows, parts.row[lane] as usize);
        hits |= u32::from((row[0] & masks[0][lane]) | (row[1] & masks[1][lane]) != 0) << lane;
    }
    let hits = hits as u16 & active;
    if view.params.consensus == 0 {
        return hits;
    }
    let mut agreed = 0;
    for lane in lanes(hits) {
        let (direction, part) = view.part(parts, lane);
        let mask = [masks[0][lane], masks[1][lane]];
        agreed |= u16::from(direction.agreed_of_128(part.row, part.sides, mask)) << lane;
    }
    agreed
}

/// The slow way for an origin far outside the scene: distance in shares of the segment of the first bit, if any.
fn far_hit(view: &View, segment: &Segment) -> Option<f32> {
    let [origin, target] = [segment.origin, segment.target].map(|p| view.params.lattice_from_world(p));
    testable(segment)?;
    let cut = cut_far_segment(origin, target);
    let way = [0, 1, 2].map(|i| segment.target[i] - segment.origin[i]);
    if !cut.is_valid {
        return None;
    }
    let direction = view.table[table_cell(way) as usize];
    // So far away no surface is the origin's.
    let plan = plan_any(view.params, &view.frames[usize::from(direction)], &cut, [0; 3]);
    let share = first_share(&view.direction(u32::from(direction)), &plan)?;
    Some(cut.cut + cut.share * share)
}

/// [`crate::visibility::Visibility::hidden_lights`].
#[inline(always)]
fn hidden_lights_of(view: &View, receivers: &[Receiver], lights: &[LightPoint], hidden: &mut [u32]) {
    if view.params.split == 1 {
        hidden_lights_by::<true>(view, receivers, lights, hidden);
    } else {
        hidden_lights_by::<false>(view, receivers, lights, hidden);
    }
}

#[inline(always)]
fn hidden_lights_by<const SPLIT: bool>(
    view: &View,
    receivers: &[Receiver],
    lights: &[LightPoint],
    hidden: &mut [u32],
) {
    let words = lights.len().div_ceil(32);
    let mut plans = [const { Plans::EMPTY }; 32];
    for (receivers, hidden) in receivers.chunks(LANES).zip(hidden.chunks_mut(LANES * words)) {
        let origins = Origins::new(view.params, receivers.iter().map(|r| (r.position, r.normal)));
        let all = u16::MAX >> (LANES - origins.count);
        for (block, lights) in lights.chunks(32).enumerate() {
            let mut hits = [0u16; 32];
            let mut seen = [0u16; 32];
            for (bit, light) in lights.iter().enumerate() {
                let ways = ways(view.params, &origins, |lane| {
                    let at = |i: usize| light.offset[i] + light.position_weight * origins.position[i][lane];
                    [at(0), at(1), at(2)]
                });
                // What is behind a surface is hidden by it.
                let in_front = ways.facing | !origins.on_surface;
                hits[bit] = all & !in_front & ways.valid;
                seen[bit] = all & in_front & ways.valid & !origins.far;
                plan::<SPLIT>(view, &origins, &ways, seen[bit], &mut plans[bit]);
                // They are looked at when all 32 lights are planned: by then the rows have arrived.
                if seen[bit] != 0 && view.params.bits == 7 {
                    for lane in (0..LANES).step_by(PREFETCH_STEP) {
                        prefetch(view.rows, plans[bit].near.row[lane] as usize * 4);
                    }
                }
            }
            for bit in 0..lights.len() {
                hits[bit] |= hit_lanes(view, &plans[bit].near, seen[bit]);
            }
            if SPLIT {
                for bit in 0..lights.len() {
                    let left = seen[bit] & !hits[bit];
                    if left != 0 {
                        hits[bit] |= hit_lanes(view, &plans[bit].far, left);
                    }
                }
            }
            for lane in lanes(origins.far & all) {
                for (bit, light) in lights.iter().enumerate() {
                    if !light.is_behind(&receivers[lane]) {
                        let segment = light.segment_from(&receivers[lane]);
                        hits[bit] |= u16::from(far_hit(view, &segment).is_some()) << lane;
                    }
                }
            }
            for (lane, hidden) in hidden.chunks_mut(words).enumerate() {
                hidden[block] =
                    (0..).zip(hits).fold(0, |word, (bit, hits)| word | u32::from(hits >> lane & 1) << bit);
            }
        }
    }
}

/// [`crate::visibility::Visibility::occluded`], for the segments that `order` lists.
#[inline(always)]
fn occluded_of(view: &View, segments: &[Segment], order: &[u32], mut found: impl FnMut(u32, bool)) {
    for order in order.chunks(LANES) {
        let at = |i: &u32| &segments[*i as usize];
        let origins = Origins::new(view.params, order.iter().map(|i| (at(i).origin, at(i).normal)));
        let all = u16::MAX >> (LANES - origins.count);
        let mut targets = [[0.0; 3]; LANES];
        order.iter().zip(&mut targets).for_each(|(i, target)| *target = at(i).target);
        let ways = ways(view.params, &origins, |lane| targets[lane]);
        let active = all & ways.valid & !origins.far;
        let mut plans = Plans::EMPTY;
        let is_split = view.params.split == 1;
        if is_split {
            plan::<true>(view, &origins, &ways, active, &mut plans);
        } else {
            plan::<false>(view, &origins, &ways, active, &mut plans);
        }
        let mut occluded = hit_lanes(view, &plans.near, active);
        if is_split {
            occluded |= hit_lanes(view, &plans.far, active & !occluded);
        }
        for lane in lanes(origins.far & all) {
            occluded |= u16::from(far_hit(view, at(&order[lane])).is_some()) << lane;
        }
        for (lane, &index) in order.iter().enumerate() {
            found(index, occluded >> lane & 1 == 1);
        }
    }
}

/// [`crate::visibility::Visibility::distances`], for the segments that `order` lists.
#[inline(always)]
fn distances_of(view: &View, segments: &[Segment], order: &[u32], mut found: impl FnMut(u32, f32)) {
    for order in order.chunks(LANES) {
        let at = |i: &u32| &segments[*i as usize];
        let origins = Origins::new(view.params, order.iter().map(|i| (at(i).origin, at(i).normal)));
        let all = u16::MAX >> (LANES - origins.count);
        let mut targets = [[0.0; 3]; LANES];
        order.iter().zip(&mut targets).for_each(|(i, target)| *target = at(i).target);
        let ways = ways(view.params, &origins, |lane| targets[lane]);
        let mut shares = [None; LANES];
        let active = all & ways.valid & !origins.far;
        for lane in lanes(active) {
            let direction = u32::from(view.table[ways.cell[lane] as usize]);
            let (segment, normal) = (lattice_segment(&origins, &ways, lane), normal_of(&origins, lane));
            let plan = plan_any(view.params, &view.frames[direction as usize], &segment, normal);
            let share = first_share(&view.direction(direction), &plan);
            shares[lane] = share.map(|share| share * ways.share[lane]);
        }
        for lane in lanes(origins.far & all) {
            shares[lane] = far_hit(view, at(&order[lane]));
        }
        for (lane, &index) in order.iter().enumerate() {
            let [x, y, z] = [0, 1, 2].map(|i| f64::from(ways.world[i][lane]));
            let length = (x * x + y * y + z * z).sqrt();
            found(index, shares[lane].map_or(f32::INFINITY, |share| (f64::from(share) * length) as f32));
        }
    }
}

/// The direction-table cells of segments, for sorting.
#[inline(always)]
fn cells_of(segments: &[Segment], cells: &mut [u32]) {
    for (segment, cell) in segments.iter().zip(cells) {
        let way = [0, 1, 2].map(|i| segment.target[i] - segment.origin[i]);
        *cell = table_cell(way);
    }
}

dispatched! {
    /// Bits of hidden lights for each receiver.
    hidden_lights = hidden_lights_of(view: &View, receivers: &[Receiver], lights: &[LightPoint], hidden: &mut [u32])
}
dispatched! {
    /// Whether each listed segment is occluded.
    occluded = occluded_of(view: &View, segments: &[Segment], order: &[u32], found: &mut dyn FnMut(u32, bool))
}
dispatched! {
    /// How far each listed segment reaches.
    distances = distances_of(view: &View, segments: &[Segment], order: &[u32], found: &mut dyn FnMut(u32, f32))
}
dispatched! {
    /// The direction-table cell of each segment.
    cells = cells_of(segments: &[Segment], cells: &mut [u32])
}
