//! The frames of all directions, fitted to boxes around the surface, and refitted after a change of a few boxes.
//!
//! A frame follows from the extents of all boxes along some axes. A box that lies within the extents of others along
//! each of these axes has no part in that. So after a change, a direction in which neither the boxes that are gone nor
//! those that are new stick out of the rest keeps its frame, bit for bit.

use crate::rows::RowsOptions;
use manyview_shaders::directions::{
    DirectionFrame, Fit, GroupedBoxes, ROLLS, RowLattice, extents_along, rolled, rolled_to_fit,
};
use rayon::prelude::*;

type Box3 = [[i16; 3]; 2];

/// The frame of every direction, fitted to boxes around the surface ([`crate::points::coarse_boxes`]).
pub fn fit_frames(options: RowsOptions, lattice: &RowLattice, boxes: &[Box3]) -> Vec<DirectionFrame> {
    let boxes = GroupedBoxes::new(boxes);
    (0..options.directions.count()).into_par_iter().map(|d| fit_frame(options, lattice, &boxes, d)).collect()
}

/// The frame of one direction.
pub(crate) fn fit_frame(
    options: RowsOptions,
    lattice: &RowLattice,
    boxes: &GroupedBoxes,
    direction: u32,
) -> DirectionFrame {
    let axes = match options.fit {
        Fit::Cube => options.directions.frame(direction),
        Fit::Extent => rolled_to_fit(options.directions.frame(direction), lattice, boxes),
    };
    DirectionFrame::new(axes, lattice, options.fit, boxes.extents_along(axes, lattice))
}

/// What [`fit_frames`] gives for `boxes`, from what it gave for `old_boxes`.
pub(crate) fn refit_frames(
    options: RowsOptions,
    lattice: &RowLattice,
    boxes: &[Box3],
    old_boxes: &[Box3],
    old_frames: &[DirectionFrame],
) -> Vec<DirectionFrame> {
    if old_frames.len() != options.directions.count() as usize {
        return fit_frames(options, lattice, boxes);
    }
    let sorted = |boxes: &[Box3]| {
        let mut sorted = boxes.to_vec();
        sorted.sort_unstable();
        sorted
    };
    let (new, old) = (sorted(boxes), sorted(old_boxes));
    let is_in = |boxes: &[Box3], one: &Box3| boxes.binary_search(one).is_ok();
    let kept: Vec<Box3> = new.iter().filter(|b| is_in(&old, b)).copied().collect();
    let gone = old.iter().filter(|b| !is_in(&new, b));
    let changed: Vec<Box3> = new.iter().filter(|b| !is_in(&old, b)).chain(gone).copied().collect();
    let outer = outermost(&kept);
    let keeps = |direction: u32| {
        let axes = options.directions.frame(direction);
        let covers = |extents: [f64; 2], of: [f64; 2]| of[0] >= extents[0] && of[1] <= extents[1];
        let is_inside = |axes: [[f64; 3]; 2]| {
            let [outer, changed] = [&outer, &changed].map(|boxes| extents_along(axes, lattice, boxes));
            outer.into_iter().zip(changed).all(|(outer, changed)| covers(outer, changed))
        };
        // Both uses of a pair of axes: u and v of every roll, and w.
        (0..ROLLS).all(|roll| is_inside(rolled(axes, roll))) && is_inside([axes[2], axes[2]])
    };
    let boxes = GroupedBoxes::new(boxes);
    (0..options.directions.count())
        .into_par_iter()
        .zip(old_frames)
        .map(|(d, old)| {
            let is_kept = !outer.is_empty() && (changed.is_empty() || keeps(d));
            if is_kept { *old } else { fit_frame(options, lattice, &boxes, d) }
        })
        .collect()
}

/// Boxes that reach farthest to 26 sides: the others mostly lie between them.
fn outermost(boxes: &[Box3]) -> Vec<Box3> {
    let mut outermost: Vec<Box3> = Vec::new();
    for side in (0..27).filter(|side| *side != 13) {
        let toward = [side % 3 - 1, side / 3 % 3 - 1, side / 9 - 1];
        let reach = |b: &&Box3| -> i32 {
            (0..3).map(|i| toward[i] * i32::from(b[usize::from(toward[i] > 0)][i])).sum()
        };
        outermost.extend(boxes.iter().max_by_key(reach));
    }
    outermost.sort_unstable();
    outermost.dedup();
    outermost
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::RowsFrom;
    use manyview_shaders::directions::DirectionSet;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]

        #[test]
        fn refitted_frames_are_fitted_frames(
            places in prop::collection::vec(prop::array::uniform3(-16_000i16..15_000), 1..60),
            changes in prop::collection::vec((any::<u16>(), prop::array::uniform3(-16_000i16..15_000)), 0..4),
            is_extent: bool,
        ) {
            let around = |p: [i16; 3]| [p, p.map(|c| c + 900)];
            let old: Vec<Box3> = places.iter().copied().map(around).collect();
            let mut new = old.clone();
            for (index, place) in changes {
                let at = usize::from(index) % (new.len() + 1);
                if at == new.len() { new.push(around(place)) } else { new[at] = around(place) }
            }
            let options = RowsOptions {
                bits: 5,
                directions: DirectionSet::LatLong { thetas: 6, phis: 7 },
                fit: if is_extent { Fit::Extent } else { Fit::Cube },
                from: RowsFrom::Points,
            };
            let lattice = RowLattice::new([-3.0, 0.0, -5.0], [3.0, 4.0, 5.0]);
            let old_frames = fit_frames(options, &lattice, &old);
            let refitted = refit_frames(options, &lattice, &new, &old, &old_frames);
            prop_assert!(refitted == fit_frames(options, &lattice, &new));
        }
    }

    #[test]
    fn what_moves_among_others_changes_no_frame() {
        let at = |x: i16, y: i16, z: i16| [[x, y, z], [x + 500, y + 500, z + 500]];
        let corners = |i: i16| {
            at(
                [-16_000, 15_500][(i & 1) as usize],
                [-16_000, 15_500][(i >> 1 & 1) as usize],
                [-16_000, 15_500][(i >> 2) as usize],
            )
        };
        let boxes: Vec<Box3> = (0..8).map(corners).collect();
        assert_eq!(outermost(&boxes).len(), 8);
        let sorted = |mut boxes: Vec<Box3>| {
            boxes.sort_unstable();
            boxes
        };
        assert_eq!(outermost(&[&boxes[..], &[at(0, 0, 0)]].concat()), sorted(boxes));
    }
}
