//! Which directions of a bake a scene keeps, and in which order they are streamed.
//!
//! # Practice
//! - *Kept*: all directions if the budget and a texture hold them; else every 2nd along the set's first axis, then every
//!   2nd along both, every 4th along the first and 2nd along the second, and so on, down to 32 directions.
//! - *Order*: a bake stores neighbouring directions together, 4 MiB a chunk, and a chunk is decoded once for all of
//!   them: a *unit* is what one chunk holds of the directions kept. Units come in farthest-point order: each is the one
//!   whose middle direction is farthest from all directions before. So any part of the stream covers all directions
//!   about evenly, and the crowded ones (the poles of a latitude-longitude set) come last.
//! - The *coarse part* is the first sixteenth of the units, at least one.

use std::ops::Range;

use manyview_cache::archive::MAX_CHUNK_BYTES;
use manyview_shaders::directions::DirectionSet;
use manyview_shaders::rows_texture::RowsTexture;
use manyview_shaders::sections::RowsInfo;

/// No smaller part of a larger set is worth using.
const FEWEST_DIRECTIONS: u32 = 32;
/// One in so many units belongs to the coarse part.
const COARSE_SHARE: usize = 16;
/// Units that are put in farthest-point order; the others of huge sets follow as they are stored.
const MOST_ORDERED_UNITS: usize = 1024;
/// Directions that stand for a unit when distances are compared.
const UNIT_SAMPLES: usize = 5;

/// What is read and uploaded at once.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Unit {
    /// Directions to read, the first and the last of them kept.
    pub(super) directions: Range<u32>,
    /// Kept directions among them, as a range of [`Plan::kept`] and of tiles.
    pub(super) kept: Range<usize>,
}

/// What to stream.
#[derive(Debug)]
pub(super) struct Plan {
    /// Directions to keep, in the order of streaming. The place in this list is the tile in the texture, so that what
    /// comes first lies together.
    pub(super) kept: Vec<u32>,
    /// Where tiles lie.
    pub(super) layout: RowsTexture,
    /// In the order of streaming.
    pub(super) units: Vec<Unit>,
    /// How many units make up the coarse part.
    pub(super) coarse_units: usize,
}

impl Plan {
    /// The plan for the largest part that takes at most `budget_bytes` by `bytes_of` its layout, or else the bytes that
    /// the smallest part takes. `axes` are the directions of the set.
    pub(super) fn new(
        info: &RowsInfo,
        set: DirectionSet,
        axes: &[[f32; 3]],
        budget_bytes: u64,
        bytes_of: impl Fn(&RowsTexture) -> u64,
    ) -> Result<Self, u64> {
        let [lines, columns] = match set {
            DirectionSet::LatLong { thetas, phis } => [thetas, phis],
            DirectionSet::Octahedral { size } => [size, size],
        };
        let mut smallest_bytes = u64::MAX;
        for rung in 0.. {
            let steps = [1 << (rung / 2 + rung % 2), 1 << (rung / 2)];
            let count = lines.div_ceil(steps[0]) * columns.div_ceil(steps[1]);
            if rung > 0 && count < FEWEST_DIRECTIONS {
                break;
            }
            // A set too large for a texture is thinned out like one too large for the budget.
            let Ok(layout) = RowsTexture::new(info.bits, count) else { continue };
            smallest_bytes = bytes_of(&layout);
            if smallest_bytes <= budget_bytes {
                let kept = (0..set.count())
                    .filter(|d| {
                        (d / columns).is_multiple_of(steps[0]) && (d % columns).is_multiple_of(steps[1])
                    })
                    .collect();
                return Ok(Self::of(kept, layout, info, axes));
            }
        }
        Err(smallest_bytes)
    }

    fn of(kept: Vec<u32>, layout: RowsTexture, info: &RowsInfo, axes: &[[f32; 3]]) -> Self {
        let block = info.block_directions;
        // As the bake cuts chunks; other cuts cost time, not correctness.
        let a_chunk = (MAX_CHUNK_BYTES / info.direction_bytes()).max(1) as u32;
        let chunk_of = |direction: u32| (direction / block, direction % block / a_chunk);
        let mut units: Vec<Unit> = Vec::new();
        for (place, &direction) in kept.iter().enumerate() {
            match units.last_mut() {
                Some(unit) if chunk_of(unit.directions.start) == chunk_of(direction) => {
                    unit.directions.end = direction + 1;
                    unit.kept.end = place + 1;
                }
                _ => units.push(Unit { directions: direction..direction + 1, kept: place..place + 1 }),
            }
        }
        let coarse_units = units.len().div_ceil(COARSE_SHARE);
        let mut units = in_farthest_point_order(units, &kept, axes);
        let mut in_order = Vec::with_capacity(kept.len());
        for unit in &mut units {
            let first = in_order.len();
            in_order.extend_from_slice(&kept[unit.kept.clone()]);
            unit.kept = first..in_order.len();
        }
        Self { kept: in_order, layout, units, coarse_units }
    }
}

fn in_farthest_point_order(units: Vec<Unit>, kept: &[u32], axes: &[[f32; 3]]) -> Vec<Unit> {
    let axis_at = |place: usize| axes[kept[place] as usize];
    let middles: Vec<[f32; 3]> =
        units.iter().map(|unit| axis_at((unit.kept.start + unit.kept.end) / 2)).collect();
    // For each unit the largest cosine between its middle and any direction before; more than 1 once it is taken.
    let mut nearest = vec![-1.0f32; units.len()];
    let mut order = Vec::with_capacity(units.len());
    while order.len() < units.len().min(MOST_ORDERED_UNITS) {
        let (next, _) = (0..).zip(&nearest).fold((0, f32::INFINITY), |(unit, least), (other, &cosine)| {
            if cosine < least { (other, cosine) } else { (unit, least) }
        });
        let places = &units[next].kept;
        let last = places.len() - 1;
        let samples = [0; UNIT_SAMPLES]
            .iter()
            .enumerate()
            .map(|(i, _)| axis_at(places.start + last * i / (UNIT_SAMPLES - 1)));
        for sample in samples {
            for (nearest, middle) in nearest.iter_mut().zip(&middles) {
                let cosine = sample[0] * middle[0] + sample[1] * middle[1] + sample[2] * middle[2];
                *nearest = nearest.max(cosine.abs());
            }
        }
        nearest[next] = 2.0;
        order.push(next);
    }
    let left = (0..units.len()).filter(|&unit| nearest[unit] < 2.0);
    let order: Vec<usize> = order.iter().copied().chain(left).collect();
    order.into_iter().map(|unit| units[unit].clone()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn info(bits: u32, set: DirectionSet) -> RowsInfo {
        let mut info = RowsInfo { bits, directions: set.count(), ..RowsInfo::zeroed() };
        info.block_directions = (MAX_CHUNK_BYTES / info.direction_bytes()) as u32;
        info
    }

    fn axes(set: DirectionSet) -> Vec<[f32; 3]> {
        (0..set.count()).map(|d| set.frame(d)[2].map(|c| c as f32)).collect()
    }

    fn plan(bits: u32, set: DirectionSet, budget: u64) -> Result<Plan, u64> {
        Plan::new(&info(bits, set), set, &axes(set), budget, RowsTexture::bytes)
    }

    const PAPER: DirectionSet = DirectionSet::LatLong { thetas: 90, phis: 90 };

    /// Every kept direction is in one unit, and no unit reads more than a chunk.
    fn check(plan: &Plan, bits: u32) {
        let mut seen = vec![false; plan.kept.len()];
        assert_eq!(plan.kept.iter().collect::<std::collections::BTreeSet<_>>().len(), plan.kept.len());
        for unit in &plan.units {
            assert!(plan.kept[unit.kept.clone()].is_sorted());
            assert_eq!(plan.kept[unit.kept.start], unit.directions.start);
            assert_eq!(plan.kept[unit.kept.end - 1] + 1, unit.directions.end);
            assert!(unit.directions.len() << (3 * bits - 3) <= MAX_CHUNK_BYTES);
            for place in unit.kept.clone() {
                assert!(!std::mem::replace(&mut seen[place], true));
            }
        }
        assert!(seen.into_iter().all(|seen| seen));
        assert_eq!(plan.layout.directions() as usize, plan.kept.len());
        assert!(plan.coarse_units >= 1 && plan.coarse_units <= plan.units.len().div_ceil(10).max(1));
    }

    #[test]
    fn all_is_kept_where_it_fits() {
        let plan = plan(7, PAPER, 2 << 30).unwrap();
        let mut kept = plan.kept.clone();
        kept.sort_unstable();
        assert_eq!(kept, (0..8100).collect::<Vec<u32>>());
        assert_eq!(plan.units.len(), 507);
        check(&plan, 7);
    }

    #[test]
    fn a_smaller_budget_keeps_every_second_and_so_on() {
        for (budget, kept) in [
            ((2u64 << 30) - 1, 45 * 90),
            (1 << 30, 45 * 90),
            (600 << 20, 45 * 45),
            (500 << 20, 23 * 45),
            (20 << 20, 6 * 12),
            (9 << 20, 6 * 6),
        ] {
            let plan = plan(7, PAPER, budget).unwrap();
            assert_eq!(plan.kept.len(), kept, "{budget} bytes");
            assert!(plan.layout.bytes() <= budget);
            check(&plan, 7);
        }
        let needed = plan(7, PAPER, 8 << 20).unwrap_err();
        assert_eq!(needed, 36 * (128 * 128 * 16));
        assert!(plan(7, PAPER, needed).is_ok() && plan(7, PAPER, needed - 1).is_err());
    }

    #[test]
    fn small_sets_are_kept_whole_or_not_at_all() {
        let set = DirectionSet::LatLong { thetas: 5, phis: 6 };
        assert_eq!(plan(5, set, u64::MAX).unwrap().kept.len(), 30);
        assert_eq!(plan(5, set, 30 * 32 * 32 * 16 - 1).unwrap_err(), 30 * 32 * 32 * 16);
    }

    #[test]
    fn a_set_beyond_a_texture_is_thinned_out() {
        let set = DirectionSet::Octahedral { size: 512 };
        let plan = plan(8, set, u64::MAX).unwrap();
        assert_eq!(plan.kept.len(), 1 << 17);
        assert!(plan.kept.contains(&0) && !plan.kept.contains(&512) && plan.kept.contains(&1024));
    }

    #[test]
    fn the_coarse_part_covers_all_directions() {
        for (bits, set) in [(7, PAPER), (7, DirectionSet::Octahedral { size: 90 }), (8, PAPER)] {
            let plan = plan(bits, set, u64::MAX).unwrap();
            let axes = axes(set);
            let coarse: Vec<[f32; 3]> = plan.units[..plan.coarse_units]
                .iter()
                .flat_map(|unit| unit.kept.clone().map(|place| axes[plan.kept[place] as usize]))
                .collect();
            let cosine = |a: &[f32; 3], b: &[f32; 3]| (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]).abs();
            let worst = axes
                .iter()
                .map(|axis| coarse.iter().map(|c| cosine(axis, c)).fold(0.0, f32::max))
                .fold(1.0, f32::min)
                .acos()
                .to_degrees();
            assert!(worst < 18.0, "{set} of {bits} bits: {worst}°");
        }
    }
}
