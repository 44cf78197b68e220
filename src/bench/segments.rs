//! Segments to test, with their exact answers.

use super::Random;
use crate::rays::paper::ExactSegment as Segment;
use crate::reference::{Reference, area_normal};
use glam::DVec3;
use manyview_shaders::directions::{DirectionSet, RowLattice};
use rayon::prelude::*;

/// Segments whose nearest sampled direction is the same one.
pub(super) struct Bundle {
    /// The direction.
    pub(super) index: u32,
    /// Each with its exact answer: whether it is occluded.
    pub(super) segments: Vec<(Segment, bool)>,
}

/// Bundles of `rays` segments for about `count` directions of `set`, so that all segments together are spread evenly
/// over the sphere: directions are drawn by the area of their cells, and within a cell every ray is as likely.
///
/// Segments start on the surface, drawn by area, on the side that their direction looks to. One half ends at the
/// scene's bounds, the other at a uniform share of the way there.
pub(super) fn bundles(
    set: DirectionSet,
    count: u32,
    rays: u32,
    seed: u64,
    reference: &Reference<'_>,
    lattice: &RowLattice,
) -> Vec<Bundle> {
    // The same directions for every set, so that sets differ by their cells alone.
    let mut random = Random::new(seed);
    let mut chosen: Vec<u32> =
        (0..count).map(|_| set.nearest(random.direction().as_vec3().to_array())).collect();
    chosen.sort_unstable();
    chosen.dedup();
    let mut area = 0.0;
    let areas: Vec<f64> = reference
        .triangles()
        .iter()
        .map(|t| {
            area += area_normal(t).length();
            area
        })
        .collect();
    chosen
        .into_par_iter()
        .map(|index| {
            let mut random = Random::new(seed ^ (u64::from(index) + 1).wrapping_mul(0xd1b5_4a32_d192_ed03));
            let segments = (0..rays)
                .map(|i| {
                    let direction = direction_in_cell(set, index, &mut random);
                    let share = if i % 2 == 0 { 1.0 } else { random.unit() };
                    let segment = segment(direction, share, &areas, reference, lattice, &mut random);
                    (segment, reference.is_occluded(segment.origin, segment.target))
                })
                .collect();
            Bundle { index, segments }
        })
        .collect()
}

/// A unit vector whose nearest direction is `index`, all of them equally likely.
fn direction_in_cell(set: DirectionSet, index: u32, random: &mut Random) -> DVec3 {
    let steps = match set {
        DirectionSet::LatLong { thetas, phis } => thetas.min(phis),
        DirectionSet::Octahedral { size } => size,
    };
    // Tested: no cell of a set of n steps reaches 180°/n from its direction.
    let radius = (std::f64::consts::PI / f64::from(steps)).min(1.5);
    let [u, v, w] = set.frame(index).map(DVec3::from_array);
    // Cells at the poles of a latitude-longitude set are thin: many tries, but only there.
    for _ in 0..100_000 {
        let (a, b) = (random.signed(), random.signed());
        if a * a + b * b > 1.0 {
            continue;
        }
        // Uniform over a small disc of the tangent plane is uniform over the sphere but for cos³ of its radius.
        let direction = (w + (u * a + v * b) * radius).normalize();
        if set.nearest(direction.as_vec3().to_array()) == index {
            return if random.unit() < 0.5 { direction } else { -direction };
        }
    }
    w
}

fn segment(
    direction: DVec3,
    share: f64,
    areas: &[f64],
    reference: &Reference<'_>,
    lattice: &RowLattice,
    random: &mut Random,
) -> Segment {
    let half = DVec3::from_array(lattice.half_extent);
    let center = DVec3::from_array(lattice.center);
    let mut tries = 0;
    let (surface, normal) = loop {
        let at = random.unit() * areas.last().copied().unwrap_or(0.0);
        let index = areas.partition_point(|&a| a <= at).min(areas.len() - 1);
        let (mut b1, mut b2) = (random.unit(), random.unit());
        if b1 + b2 > 1.0 {
            (b1, b2) = (1.0 - b1, 1.0 - b2);
        }
        let triangle = &reference.triangles()[index];
        tries += 1;
        // Where alpha cuts nearly everything away, a point of a hole is as good as any.
        if reference.exists(index as u32, [b1, b2]) || tries > 1000 {
            let [a, b, c] = triangle;
            break (*a + (*b - *a) * b1 + (*c - *a) * b2, area_normal(triangle).normalize_or_zero());
        }
    };
    let normal = if normal.dot(direction) < 0.0 { -normal } else { normal };
    let origin = surface + normal * (half.length() * 1e-6);
    let to_bounds = |i: usize| match direction[i] {
        d if d > 0.0 => (center[i] + half[i] - origin[i]).max(0.0) / d,
        d if d < 0.0 => (center[i] - half[i] - origin[i]).min(0.0) / d,
        _ => f64::INFINITY,
    };
    let reach = to_bounds(0).min(to_bounds(1)).min(to_bounds(2));
    Segment { origin, target: origin + direction * (reach * share), normal }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::BenchScene;
    use manyview_pipeline::generate::{SceneKind, generate};

    #[test]
    fn segments_stay_in_their_cell_and_in_the_scene() {
        let scene = BenchScene::new("town".to_owned(), generate(SceneKind::Town, 2000, 1)).unwrap();
        let reference = Reference::new(&scene.scene, &scene.row_triangles, &scene.cutouts);
        for set in [DirectionSet::LatLong { thetas: 30, phis: 30 }, DirectionSet::Octahedral { size: 20 }] {
            let bundles = bundles(set, 12, 40, 9, &reference, &scene.lattice);
            assert!(bundles.len() > 8, "few of 12 random directions are the same");
            let mut occluded = 0;
            for bundle in &bundles {
                assert_eq!(bundle.segments.len(), 40);
                for (segment, answer) in &bundle.segments {
                    let ray = segment.target - segment.origin;
                    assert!(segment.normal.dot(ray) >= 0.0);
                    if ray.length() > 1e-3 {
                        assert_eq!(set.nearest(ray.as_vec3().to_array()), bundle.index);
                    }
                    let beyond = (segment.target - DVec3::from_array(scene.lattice.center)).abs()
                        - DVec3::from_array(scene.lattice.half_extent);
                    assert!(beyond.max_element() < 1e-3, "{beyond}");
                    occluded += usize::from(*answer);
                }
            }
            let all = bundles.len() * 40;
            assert!((all / 20..all * 19 / 20).contains(&occluded), "{occluded} of {all}");
        }
    }

    #[test]
    fn cells_reach_less_far_than_the_disc_that_is_sampled() {
        let mut random = Random::new(4);
        for (set, steps) in [
            (DirectionSet::LatLong { thetas: 90, phis: 90 }, 90.0),
            (DirectionSet::LatLong { thetas: 30, phis: 60 }, 30.0),
            (DirectionSet::Octahedral { size: 90 }, 90.0),
        ] {
            for _ in 0..20_000 {
                let d = random.direction();
                let w = DVec3::from_array(set.frame(set.nearest(d.as_vec3().to_array()))[2]);
                let sine = d.cross(w).length();
                assert!(sine < manyview_shaders::trig::sin_cos(std::f64::consts::PI / steps).0, "{set} {d}");
            }
        }
    }
}
