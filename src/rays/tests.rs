use super::*;
use crate::bench::Random;
use crate::visibility::{LightPoint, Receiver, Segment, Visibility, light_words};
use glam::{DVec3, Vec3};
use manyview_shaders::direction_table::{DirectionTable, TABLE_SIDE, table_cell};
use manyview_shaders::directions::{DirectionFrame, DirectionSet, Fit, RowLattice};
use std::sync::Arc;

const LATTICE: RowLattice = RowLattice { center: [5.0, -2.0, 0.5], half_extent: [16.0, 4.0, 10.0] };
const SET: DirectionSet = DirectionSet::LatLong { thetas: 5, phis: 6 };

fn frames(set: DirectionSet) -> Vec<DirectionFrame> {
    (0..set.count())
        .map(|index| {
            let axes = set.frame(index);
            let extents = axes.map(|axis| {
                let reach: f64 = (0..3).map(|i| (axis[i] * LATTICE.half_extent[i]).abs()).sum();
                [-reach, reach]
            });
            DirectionFrame::new(axes, &LATTICE, Fit::Extent, extents)
        })
        .collect()
}

/// Rows with about one bit in `sparsity` set.
fn random_rows(bits: u32, sparsity: u64) -> Vec<u32> {
    let mut random = Random::new(3);
    let mut rows = vec![0u32; (SET.count() as usize) << (3 * bits - 5)];
    let bits = rows.len() as u64 * 32;
    for _ in 0..bits / sparsity {
        let bit = random.bits() % bits;
        rows[(bit / 32) as usize] |= 1 << (bit % 32);
    }
    rows
}

fn tester(bits: u32, sparsity: u64) -> RowTester {
    RowTester::new(SET, LATTICE, bits, &frames(SET), Arc::new(random_rows(bits, sparsity)))
}

fn within(random: &mut Random, times: f64) -> DVec3 {
    let at = |i: usize, r: &mut Random| LATTICE.center[i] + r.signed() * times * LATTICE.half_extent[i];
    DVec3::new(at(0, random), at(1, random), at(2, random))
}

fn segments(count: usize, times: f64, seed: u64) -> Vec<Segment> {
    let mut random = Random::new(seed);
    (0..count)
        .map(|i| {
            let (origin, target) = (within(&mut random, times), within(&mut random, times));
            let normal = if i % 3 == 0 { DVec3::ZERO } else { random.direction() };
            let normal = if normal.dot(target - origin) < 0.0 { -normal } else { normal };
            let [origin, target, normal] = [origin, target, normal].map(|v| v.as_vec3().to_array());
            Segment { origin, target, normal }
        })
        .collect()
}

fn occluded(tester: &RowTester, segments: &[Segment]) -> Vec<u8> {
    let mut occluded = vec![9; segments.len()];
    tester.occluded(segments, &mut occluded).unwrap();
    occluded
}

fn distances(tester: &RowTester, segments: &[Segment]) -> Vec<f32> {
    let mut distances = vec![-1.0; segments.len()];
    tester.distances(segments, &mut distances).unwrap();
    distances
}

const SETTINGS: [TestSettings; 4] = [
    TestSettings::NO_BIAS,
    TestSettings::FAST,
    TestSettings { rows: Rows::Split, ..TestSettings::FAST },
    TestSettings::EXACT,
];

#[test]
fn the_table_holds_the_nearest_direction() {
    for set in [DirectionSet::LatLong { thetas: 90, phis: 90 }, DirectionSet::Octahedral { size: 90 }] {
        let table = DirectionTable::new(set, |direction| direction);
        let mut random = Random::new(8);
        for _ in 0..20_000 {
            let d = random.direction();
            let found = DVec3::from_array(set.frame(table.nearest(d.as_vec3().to_array()))[2]);
            // Half a cell of the table more than the farthest direction of the set.
            assert!(d.cross(found).length() < 2.1f64.to_radians(), "{set} {d}");
            let length = 10f64.powf(random.signed() * 9.0);
            let scaled = (-d * length).as_vec3().to_array();
            assert_eq!(table_cell(scaled), table_cell((-d).as_vec3().to_array()).max(table_cell(scaled)));
            assert!(table_cell(scaled) < 3 * TABLE_SIDE * TABLE_SIDE);
        }
    }
}

#[test]
fn answers_are_those_of_the_bits() {
    for bits in [5, 6, 7, 8] {
        let tester = tester(bits, 400).with_settings(TestSettings::NO_BIAS);
        let rows = random_rows(bits, 400);
        let table = DirectionTable::new(SET, |direction| direction);
        let frames = frames(SET);
        let segments = segments(4000, 0.95, 5);
        let (occluded, distances) = (occluded(&tester, &segments), distances(&tester, &segments));
        let (mut compared, mut hits) = (0, 0);
        for (i, segment) in segments.iter().enumerate() {
            let [origin, target] = [segment.origin, segment.target].map(|p| Vec3::from_array(p).as_dvec3());
            let direction = table.nearest((target - origin).as_vec3().to_array()) as usize;
            let (matrix, offset) = frames[direction].voxel_from_world(&LATTICE, bits);
            let voxel = |p: DVec3| -> DVec3 {
                let p = p - DVec3::from_array(LATTICE.center);
                DVec3::from_array([0, 1, 2].map(|a| DVec3::from_array(matrix[a]).dot(p) + offset[a]))
            };
            let (from, to) = (voxel(origin), voxel(target));
            let middle = from + (to - from) * (3.0 / 16.0);
            // Where rounding may choose, both answers are right.
            let is_clear = |c: f64| (c - c.round()).abs() > 0.1;
            if ![middle.x, middle.y, from.z, to.z].into_iter().all(is_clear) {
                continue;
            }
            let [u, v] = [middle.x as usize, middle.y as usize];
            let is_set = |w: usize| {
                let bit = ((direction << bits | v) << bits | u) << bits | w;
                rows[bit / 32] >> (bit % 32) & 1 == 1
            };
            let (low, high) = (from.z.min(to.z) as usize, from.z.max(to.z) as usize);
            let mut extent: Vec<usize> = (low..=high).filter(|&w| is_set(w)).collect();
            if to.z < from.z {
                extent.reverse();
            }
            assert_eq!(occluded[i] == 1, !extent.is_empty(), "{bits} {segment:?}");
            assert_eq!(distances[i].is_finite(), !extent.is_empty());
            if let Some(&first) = extent.first() {
                let face = if to.z < from.z { first as f64 + 1.0 } else { first as f64 };
                let share = ((face - from.z) / (to.z - from.z)).clamp(0.0, 1.0);
                let exact = share * (target - origin).length();
                assert!(
                    (f64::from(distances[i]) - exact).abs() < 0.1 * LATTICE.half_extent[0],
                    "{segment:?}"
                );
                hits += 1;
            }
            compared += 1;
        }
        assert!(compared > 1000 && hits > 30 && hits < compared - 30, "{bits}: {hits} of {compared}");
    }
}

#[test]
fn all_levels_agree() {
    for bits in [6, 7] {
        let mut tester = tester(bits, 30);
        let mut all = segments(3001, 0.9, 1);
        all.extend(segments(500, 30.0, 2));
        for settings in SETTINGS {
            tester = tester.with_settings(settings).with_simd(SimdLevel::Portable);
            let portable = (occluded(&tester, &all), distances(&tester, &all));
            let hits = portable.0.iter().filter(|hit| **hit == 1).count();
            assert!(hits > 10 && hits < all.len() - 100, "{hits}");
            for (hit, distance) in portable.0.iter().zip(&portable.1) {
                assert_eq!(*hit == 1, distance.is_finite());
            }
            for level in [SimdLevel::Avx2, SimdLevel::Avx512] {
                // One that the machine lacks becomes the next lower one.
                tester = RowTester::clone(&tester).with_simd(level);
                assert_eq!(portable, (occluded(&tester, &all), distances(&tester, &all)), "{level:?}");
            }
        }
    }
}

#[test]
fn lights_and_segments_say_the_same() {
    for settings in SETTINGS {
        let tester = tester(7, 30).with_settings(settings);
        let mut random = Random::new(11);
        let receivers: Vec<Receiver> = segments(77, 1.0, 4)
            .iter()
            .map(|s| Receiver { position: s.origin, normal: s.normal })
            .chain([Receiver { position: [900.0, 3.0, -50.0], normal: [-1.0, 0.0, 0.0] }])
            .collect();
        let mut lights: Vec<LightPoint> =
            (0..70).map(|_| LightPoint::at(within(&mut random, 1.5).as_vec3().to_array())).collect();
        lights.push(LightPoint::directional([0.6, -0.8, 0.0], 80.0));
        lights.push(LightPoint::at([f32::NAN, 0.0, 0.0]));
        let words = light_words(lights.len());
        let mut hidden = vec![u32::MAX; receivers.len() * words];
        tester.hidden_lights(&receivers, &lights, &mut hidden).unwrap();
        for (receiver, bits) in receivers.iter().zip(hidden.chunks(words)) {
            assert_eq!(bits[words - 1] >> (lights.len() % 32), 0, "no light, no bit");
            for (l, light) in lights.iter().enumerate() {
                let expected =
                    light.is_behind(receiver) || occluded(&tester, &[light.segment_from(receiver)]) == [1];
                assert_eq!(bits[l / 32] >> (l % 32) & 1 == 1, expected, "light {l} of {receiver:?}");
            }
        }
        let mut none = vec![];
        tester.hidden_lights(&receivers, &[], &mut none).unwrap();
        tester.hidden_lights(&[], &lights, &mut none).unwrap();
    }
}

#[test]
fn what_is_no_segment_hits_nothing() {
    let full = RowTester::new(SET, LATTICE, 5, &frames(SET), Arc::new(vec![u32::MAX; 30 << 10]));
    let center = LATTICE.center.map(|c| c as f32);
    let mut broken = vec![Segment { origin: center, target: center, normal: [0.0; 3] }];
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX] {
        for axis in 0..3 {
            for far in [center, [900.0; 3]] {
                let mut other = far;
                other[axis] = bad;
                broken.push(Segment { origin: other, target: center, normal: [0.0, 1.0, 0.0] });
                broken.push(Segment { origin: center, target: other, normal: [0.0, 1.0, 0.0] });
                broken.push(Segment { origin: other, target: other, normal: [0.0, 1.0, 0.0] });
            }
        }
    }
    for settings in SETTINGS {
        let full = RowTester::clone(&full).with_settings(settings);
        assert_eq!(occluded(&full, &broken), vec![0; broken.len()]);
        assert_eq!(distances(&full, &broken), vec![f32::INFINITY; broken.len()]);
    }
    // A normal that is none is left out; the segment is still one.
    let normal = [f32::NAN, 0.0, 0.0];
    let segment = Segment { origin: center, target: [9.0, -1.0, 2.0], normal };
    assert_eq!(occluded(&full, &[segment]), [1]);
}

#[test]
fn segments_from_far_away_reach_the_scene() {
    let set = DirectionSet::LatLong { thetas: 90, phis: 90 };
    let full = RowTester::new(set, LATTICE, 5, &frames(set), Arc::new(vec![u32::MAX; 8100 << 10]))
        .with_settings(TestSettings::NO_BIAS);
    let center = DVec3::from_array(LATTICE.center);
    let mut random = Random::new(21);
    for _ in 0..2000 {
        let inside = within(&mut random, 0.5);
        let d = random.direction();
        let [near, far] = [random.unit(), random.unit()].map(|r| 10f64.powf(r * 7.0 + 2.0));
        // Through a point inside, from far away to far away, from there to here, and from here to there.
        let through = [inside - d * near, inside + d * far];
        for [from, to] in [through, [through[0], inside], [inside, through[1]]] {
            let [origin, target] = [from, to].map(|p| p.as_vec3().to_array());
            let segment = Segment { origin, target, normal: [0.0; 3] };
            // In single precision a far end misses by metres; the rest of the segment does not.
            if near.max(far) < 1e5 {
                assert_eq!(occluded(&full, &[segment]), [1], "{segment:?}");
                let found = f64::from(distances(&full, &[segment])[0]);
                let entry = (from - center).length() - 40.0;
                assert!(found >= entry - 1e-3 * entry.abs() && found <= (from - inside).length() + 20.0);
            }
            // The same, moved aside by more than the scene's size.
            let aside = d.cross(DVec3::Y).normalize_or(DVec3::X) * (45.0 + 1e-5 * near.max(far));
            let [origin, target] = [from + aside, to + aside].map(|p| p.as_vec3().to_array());
            let missed = Segment { origin, target, normal: [0.0; 3] };
            assert_eq!(occluded(&full, &[missed]), [0], "{missed:?}");
        }
    }
}

#[test]
fn a_floor_does_not_hide_what_is_above_it() {
    // Rows along +Y over a floor that fills the lowest voxels; only the vertical direction is asked.
    let bits = 5;
    let frames = frames(SET);
    let up = DVec3::Y;
    let vertical = DirectionTable::new(SET, |d| d).nearest([0.0, 1.0, 0.0]) as usize;
    let mut rows = vec![0u32; 30 << 10];
    let (matrix, offset) = frames[vertical].voxel_from_world(&LATTICE, bits);
    let w = |y: f64| matrix[2][1] * (y - LATTICE.center[1]) + offset[2];
    let floor = w(-4.0) as u32;
    rows[vertical << 10..(vertical + 1) << 10].fill(1 << floor);
    let tester = RowTester::new(SET, LATTICE, bits, &frames, Arc::new(rows));
    let voxel = 1.0 / matrix[2][1].abs();
    let from = |height: f64, normal: DVec3| Segment {
        origin: [5.0, (-4.0 + height * voxel) as f32, 0.5],
        target: [5.0, 1.5, 0.5],
        normal: normal.as_vec3().to_array(),
    };
    for settings in [TestSettings::FAST, TestSettings { rows: Rows::Split, ..TestSettings::FAST }] {
        let tester = RowTester::clone(&tester).with_settings(settings);
        assert_eq!(occluded(&tester, &[from(0.1, up)]), [0], "its own floor");
        assert_eq!(occluded(&tester, &[from(-2.5, up)]), [1], "a floor above it");
        assert_eq!(occluded(&tester, &[from(0.1, DVec3::ZERO)]), [1], "a free point inside the voxel");
    }
}

/// The share of lights above a floor of 8 m × 8 m that it hides from itself, in rows over bounds of some height.
fn hidden_by_a_floor(height: f64, settings: TestSettings) -> f64 {
    const BITS: u32 = 6;
    let set = DirectionSet::LatLong { thetas: 40, phis: 40 };
    let bounds = [DVec3::new(-4.0, 0.0, -4.0), DVec3::new(4.0, height, 4.0)];
    let mut rows = crate::deform::DeformingRows::new(set, BITS, Fit::Extent, bounds).unwrap();
    // Two points a voxel edge.
    let at = |i: u32| (i as f32 / 128.0 - 0.5) * 8.0;
    let points: Vec<[f32; 3]> = (0..129 * 129).map(|i| [at(i % 129), 0.0, at(i / 129)]).collect();
    rows.refill(&points);
    let words = Arc::new(rows.rows().to_vec());
    let tester = RowTester::new(set, rows.lattice(), BITS, rows.frames(), words).with_settings(settings);
    let mut random = Random::new(11);
    let segments: Vec<Segment> = (0..20_000)
        .map(|_| {
            let origin = DVec3::new(random.signed() * 3.9, 0.0, random.signed() * 3.9);
            let light = DVec3::new(random.signed() * 4.0, 0.2 + 2.0 * random.unit(), random.signed() * 4.0);
            let [origin, target] = [origin, light].map(|p| p.as_vec3().to_array());
            Segment { origin, target, normal: [0.0, 1.0, 0.0] }
        })
        .collect();
    occluded(&tester, &segments).iter().map(|&hit| f64::from(hit)).sum::<f64>() / segments.len() as f64
}

#[test]
fn a_floor_hides_nothing_from_itself_however_flat_its_bounds() {
    // Some lights stand so low that the directions are too coarse for them.
    let thick = hidden_by_a_floor(0.25, TestSettings::EXACT);
    assert!(thick < 0.025, "{thick}");
    for height in [0.0, 0.03, 0.1] {
        let flat = hidden_by_a_floor(height, TestSettings::EXACT);
        assert!(flat < 0.035, "{height} m: {flat}, {thick} where it is not flat");
    }
}
