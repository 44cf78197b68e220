//! Ray traversal of the octree against exact answers and against every leaf's box.
#![cfg(feature = "bake")]

mod support;

use manyview::preview::{Octree, Ray};
use support::{Numbers, octree};

/// The hit by definition: over all cells of a level, the smallest entry distance of a ray into a cell that it passes
/// through over some length.
fn brute_force(octree: &Octree, ray: &Ray, level: u32) -> Option<f64> {
    let edge = octree.cell_size(level);
    let mut nearest: Option<f64> = None;
    for corner in octree.corners(level) {
        let (mut enter, mut exit) = (ray.t_min, ray.t_max);
        for (i, corner) in corner.into_iter().enumerate() {
            let (low, high) = (corner - ray.origin[i], corner + edge - ray.origin[i]);
            if ray.direction[i] == 0.0 {
                // Half open: the smallest face belongs to the cell.
                if !(low <= 0.0 && high > 0.0) {
                    exit = f64::NEG_INFINITY;
                }
            } else {
                let (a, b) = (low / ray.direction[i], high / ray.direction[i]);
                enter = enter.max(a.min(b));
                exit = exit.min(a.max(b));
            }
        }
        if enter < exit {
            nearest = Some(nearest.map_or(enter, |t| t.min(enter)));
        }
    }
    nearest
}

fn box_of_voxels(min: u32, max: u32) -> Vec<[u32; 3]> {
    let mut voxels = Vec::new();
    for x in min..max {
        for y in min..max {
            voxels.extend((min..max).map(|z| [x, y, z]));
        }
    }
    voxels
}

/// A solid box from 2 to 6 of 8 voxels, which are a quarter of a metre and begin at (10, -4, 1).
fn solid_box() -> Octree {
    Octree::new(&octree([10.0, -4.0, 1.0], 2.0, 3, &box_of_voxels(2, 6)))
}

#[test]
fn a_solid_box_is_hit_at_its_faces() {
    let octree = solid_box();
    // The box spans 10.5 … 11.5, -3.5 … -2.5, 1.5 … 2.5.
    for (origin, direction, t, face) in [
        ([0.0, -3.0, 2.0], [1.0, 0.0, 0.0], 10.5, (0, -1.0)),
        ([20.0, -3.0, 2.0], [-1.0, 0.0, 0.0], 8.5, (0, 1.0)),
        ([11.0, 7.5, 2.0], [0.0, -2.0, 0.0], 5.0, (1, 1.0)),
        ([11.0, -3.0, -1.5], [0.0, 0.0, 1.0], 3.0, (2, -1.0)),
        ([9.5, -3.0, 2.0], [1.0, 0.25, 0.125], 1.0, (0, -1.0)),
    ] {
        let hit = octree.intersect(&Ray::new(origin, direction), 3).unwrap();
        assert_eq!((hit.t, hit.face, hit.level), (t, Some(face), 3), "{origin:?} {direction:?}");
    }
    assert_eq!(octree.intersect(&Ray::new([0.0, -3.0, 2.0], [-1.0, 0.0, 0.0]), 3), None, "behind");
    assert_eq!(octree.intersect(&Ray::new([0.0, -2.4, 2.0], [1.0, 0.0, 0.0]), 3), None, "beside");
    // At level 1 the box is the whole cube.
    assert_eq!(octree.intersect(&Ray::new([0.0, -2.4, 2.0], [1.0, 0.0, 0.0]), 1).unwrap().t, 10.0);
}

#[test]
fn rays_from_inside_hit_where_they_begin() {
    let octree = solid_box();
    let hit = octree.intersect(&Ray::new([11.0, -3.0, 2.0], [0.3, -0.4, 0.5]), 3).unwrap();
    assert_eq!((hit.t, hit.face), (0.0, None));
    let ray = Ray { t_min: 10.75, ..Ray::new([0.0, -3.0, 2.0], [1.0, 0.0, 0.0]) };
    assert_eq!(octree.intersect(&ray, 3).unwrap().t, 10.75);
    // Out of a hollow shell, from its middle.
    let shell: Vec<_> =
        box_of_voxels(0, 8).into_iter().filter(|v| v.iter().any(|&c| c == 0 || c == 7)).collect();
    let shell = Octree::new(&support::octree([0.0; 3], 8.0, 3, &shell));
    for direction in [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, -1.0]] {
        assert_eq!(shell.intersect(&Ray::new([4.0; 3], direction), 3).unwrap().t, 3.0, "{direction:?}");
    }
}

#[test]
fn segments_end() {
    let octree = solid_box();
    let ray = |t_max: f64| Ray { t_max, ..Ray::new([0.0, -3.0, 2.0], [1.0, 0.0, 0.0]) };
    assert!(!octree.is_occluded(&ray(10.5)), "touching is not enough");
    assert!(octree.is_occluded(&ray(10.500_001)));
    assert!(!octree.is_occluded(&Ray { t_min: 11.5, ..ray(f64::INFINITY) }), "it begins behind the box");
}

#[test]
fn rays_in_borders_between_cells_belong_to_the_upper_cell() {
    let octree = solid_box();
    let along_x = |y: f64, z: f64| octree.is_occluded(&Ray::new([0.0, y, z], [1.0, 0.0, 0.0]));
    assert!(along_x(-3.5, 1.5), "the smallest faces belong to the box");
    assert!(along_x(-3.25, 2.0), "borders inside the box");
    assert!(!along_x(-2.5, 2.0) && !along_x(-3.0, 2.5), "the largest faces do not");
    // The cube's own faces.
    let full = Octree::new(&support::octree([0.0; 3], 1.0, 0, &[[0; 3]]));
    assert!(full.is_occluded(&Ray::new([-1.0, 0.0, 0.0], [1.0, 0.0, 0.0])));
    assert!(!full.is_occluded(&Ray::new([-1.0, 1.0, 0.0], [1.0, 0.0, 0.0])));
}

#[test]
fn rays_through_edges_and_corners_do_not_leak() {
    // A diagonal wall: cells that share edges only with the gaps closed by a second layer.
    let mut voxels = Vec::new();
    for x in 0..8u32 {
        for z in 0..8 {
            voxels.push([x, 7 - x, z]);
            voxels.extend((x < 7).then(|| [x, 6 - x, z]));
        }
    }
    let wall = Octree::new(&octree([0.0; 3], 8.0, 3, &voxels));
    for i in 0..=16 {
        let along = f64::from(i) * 0.5;
        // Straight at the wall's edges and corners.
        for z in [0.0, 1.0, 3.5, 4.0] {
            let ray = Ray::new([along - 8.0, -along, z], [1.0, 1.0, 0.0]);
            let hit = wall.intersect(&ray, 3).map(|hit| hit.t);
            assert_eq!(hit, brute_force(&wall, &ray, 3), "{ray:?}");
        }
    }
}

#[test]
fn what_is_not_a_ray_hits_nothing() {
    let octree = solid_box();
    let good = Ray::new([0.0, -3.0, 2.0], [1.0, 0.0, 0.0]);
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for axis in 0..3 {
            let mut ray = good;
            ray.origin[axis] = bad;
            assert_eq!(octree.intersect(&ray, 3), None);
            let mut ray = good;
            ray.direction[axis] = bad;
            assert_eq!(octree.intersect(&ray, 3), None);
        }
    }
    assert_eq!(octree.intersect(&Ray { t_min: f64::NAN, ..good }, 3), None);
    assert_eq!(octree.intersect(&Ray { t_max: f64::NAN, ..good }, 3).map(|h| h.t), Some(10.5));
    // Without a direction a ray is a point.
    assert_eq!(octree.intersect(&Ray::new([0.0; 3], [0.0; 3]), 3), None);
    assert_eq!(octree.intersect(&Ray::new([11.0, -3.0, 2.0], [0.0; 3]), 3).unwrap().t, 0.0);
    // Far away, and as good as parallel to two axes.
    assert!(octree.is_occluded(&Ray::new([-1e15, -3.0, 2.0], [1.0, 1e-310, -1e-310])));
}

#[test]
fn traversal_agrees_with_testing_every_leaf() {
    let mut hits = 0;
    for seed in 1..=12u64 {
        let mut numbers = Numbers(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let depth = 2 + (seed % 4) as u32;
        let side = 1u64 << depth;
        let count = 1 + numbers.next() % 60;
        let voxels: Vec<[u32; 3]> =
            (0..count).map(|_| [(); 3].map(|()| (numbers.next() % side) as u32)).collect();
        let octree = Octree::new(&octree([-1.0, 2.0, 0.5], side as f64 * 0.5, depth, &voxels));
        for _ in 0..1500 {
            let mut origin = [(); 3].map(|()| numbers.unit() * 12.0 - 4.0);
            let mut direction = [(); 3].map(|()| numbers.unit() * 2.0 - 1.0);
            match numbers.next() % 4 {
                // On the lattice of cells, parallel to one or two axes.
                0 => {
                    origin = origin.map(|c| (c * 2.0).round() * 0.5);
                    direction = direction.map(|c| c.round());
                }
                1 => direction[(numbers.next() % 3) as usize] = 0.0,
                _ => {}
            }
            let level = 1 + (numbers.next() % u64::from(depth)) as u32;
            let ray = Ray::new(origin, direction);
            let found = octree.intersect(&ray, level);
            match (found, brute_force(&octree, &ray, level)) {
                (None, None) => {}
                (Some(hit), Some(t)) => {
                    hits += 1;
                    assert!((hit.t - t).abs() <= 1e-12 * (1.0 + t), "seed {seed}: {ray:?} {hit:?} {t}");
                    let corner = octree.corners(level)[hit.node as usize];
                    let at = ray.at(hit.t);
                    for i in 0..3 {
                        let place = (at[i] - corner[i]) / octree.cell_size(level);
                        assert!(
                            (-1e-9..=1.0 + 1e-9).contains(&place),
                            "seed {seed}: {ray:?} is not in its cell"
                        );
                    }
                }
                (found, expected) => panic!("seed {seed}: {ray:?}: found {found:?}, expected {expected:?}"),
            }
        }
    }
    assert!(hits > 1000, "only {hits} hits");
}

#[test]
fn a_wide_ray_stops_at_cells_of_its_width() {
    let octree = solid_box();
    let ray = |spread: f64| Ray { spread, ..Ray::new([0.0, -3.0, 2.0], [1.0, 0.0, 0.0]) };
    // 10 m away; cells of levels 0 … 3 are 2, 1, 0.5 and 0.25 m wide.
    for (spread, level) in [(0.0, 3), (0.024, 3), (0.051, 2), (0.11, 1), (0.21, 0)] {
        assert_eq!(octree.intersect(&ray(spread), 3).unwrap().level, level, "{spread}");
    }
}

#[test]
fn points_find_their_nodes() {
    let voxels = [[0, 0, 0], [3, 1, 2], [7, 7, 7]];
    let octree = Octree::new(&octree([1.0, 1.0, 1.0], 8.0, 3, &voxels));
    assert!(octree.contains([1.0, 1.0, 1.0]) && octree.contains([4.5, 2.5, 3.5]));
    assert!(!octree.contains([2.0, 1.0, 1.0]) && !octree.contains([9.0, 9.0, 9.0]));
    assert!(!octree.contains([f64::NAN, 1.0, 1.0]));
    assert_eq!(octree.node_at([8.9, 8.9, 8.9], 1), Some(1));
    assert_eq!(octree.corners(3), [[1.0; 3], [4.0, 2.0, 3.0], [8.0; 3]]);
}
