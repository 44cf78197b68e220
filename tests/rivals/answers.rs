//! Scenes whose answers are known: a plane, a closed room, a sphere, two rooms with a door.

use crate::place::*;
use glam::{DVec3, Vec3};
use libtest_mimic::Failed;
use manyview::visibility::{Segment, Visibility};
use manyview_pipeline::scene::Mesh;
use manyview_shaders::cases::Random;

/// Compares a method with known distances (`None` where nothing is hit) within `tolerance` metres.
pub(crate) fn expect(
    method: &dyn Visibility,
    segments: &[Segment],
    known: &[Option<f64>],
    tolerance: f64,
) -> Result<(), Failed> {
    let mut occluded = vec![9; segments.len()];
    method.occluded(segments, &mut occluded)?;
    let mut distances = vec![0.0; segments.len()];
    method.distances(segments, &mut distances)?;
    for (((segment, known), occluded), distance) in segments.iter().zip(known).zip(occluded).zip(distances) {
        let name = method.name();
        ensure!(occluded == u8::from(known.is_some()), "{name}: {occluded}, not {known:?}: {segment:?}");
        match known {
            Some(known) => {
                let error = (f64::from(distance) - known).abs();
                ensure!(error <= tolerance, "{name}: {distance} m, not {known}: {segment:?}");
            }
            None => ensure!(distance == f32::INFINITY, "{name}: hit at {distance}: {segment:?}"),
        }
    }
    Ok(())
}

/// `known` of a segment, or `None` if an approximation by cells may answer either way.
pub(crate) type Known<'a> = dyn Fn(DVec3, DVec3, f64) -> Option<Option<f64>> + 'a;

/// Asks all methods of a place about the same segments. `known` is told how far from a border of things it must keep.
pub(crate) fn expect_all(
    place: &Place,
    [exact, cells]: &Methods,
    ends: &[(DVec3, DVec3)],
    known: &Known,
) -> Result<(), Failed> {
    for (methods, margin, tolerance) in
        [(exact, 1e-4, 1e-4), (cells, 3.0 * place.voxel(), 24.0 * place.voxel())]
    {
        let asked: Vec<_> =
            ends.iter().filter_map(|&(a, b)| known(a, b, margin).map(|k| (free(a, b), k))).collect();
        ensure!(asked.len() * 2 > ends.len(), "only {} of {} segments are certain", asked.len(), ends.len());
        let (segments, known): (Vec<_>, Vec<_>) = asked.into_iter().unzip();
        let hits = known.iter().flatten().count();
        ensure!(hits * 20 > known.len(), "only {hits} of {} segments hit anything", known.len());
        for method in methods {
            expect(&**method, &segments, &known, tolerance)?;
        }
    }
    Ok(())
}

pub(crate) fn plane() -> Result<Place, Failed> {
    // Off the borders of cells.
    let h = 0.013;
    Place::of_quads(&[[[-5.0, h, -5.0], [5.0, h, -5.0], [5.0, h, 5.0], [-5.0, h, 5.0]]], 8)
}

pub(crate) fn a_plane_hides_what_is_behind_it() -> Result<(), Failed> {
    let place = plane()?;
    let reference = place.reference();
    plane_answers(&place, &methods(&place, &reference)?)
}

pub(crate) fn plane_answers(place: &Place, methods: &Methods) -> Result<(), Failed> {
    let mut random = Random::new(1);
    let corner = DVec3::new(6.0, 4.0, 6.0);
    let ends: Vec<_> = (0..2000)
        .map(|_| (point_in(&mut random, -corner, corner), point_in(&mut random, -corner, corner)))
        .collect();
    expect_all(place, methods, &ends, &|a, b, margin| {
        let (from, to) = (a.y - 0.013, b.y - 0.013);
        if from.abs() < margin || to.abs() < margin {
            return None;
        }
        if from * to > 0.0 {
            return Some(None);
        }
        let share = from / (from - to);
        let at = a + (b - a) * share;
        let border = at.x.abs().max(at.z.abs()) - 5.0;
        // A flat ray stays long in the cells of the plane.
        let slope = (b - a).length() / (b.y - a.y).abs();
        let uncertain = border.abs() < margin * slope || slope > 8.0;
        (!uncertain).then_some((border < 0.0).then_some((at - a).length()))
    })
}

/// The six sides of a box, whose walls lie off the borders of cells.
pub(crate) fn box_quads(min: [f32; 3], max: [f32; 3]) -> Vec<[[f32; 3]; 4]> {
    let mut quads = Vec::new();
    for axis in 0..3 {
        for side in [min[axis], max[axis]] {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            quads.push([(min[u], min[v]), (max[u], min[v]), (max[u], max[v]), (min[u], max[v])].map(
                |(a, b)| {
                    let mut p = [side; 3];
                    (p[u], p[v]) = (a, b);
                    p
                },
            ));
        }
    }
    quads
}

pub(crate) fn room() -> Result<Place, Failed> {
    Place::of_quads(&box_quads([-2.0, -1.0, -1.5], [2.1, 1.3, 1.7]), 7)
}

pub(crate) fn a_closed_room_leaks_nothing() -> Result<(), Failed> {
    let place = room()?;
    let reference = place.reference();
    room_answers(&methods(&place, &reference)?)
}

pub(crate) fn room_answers(methods: &Methods) -> Result<(), Failed> {
    let mut random = Random::new(2);
    let (min, max) = (DVec3::new(-2.0, -1.0, -1.5), DVec3::new(2.1, 1.3, 1.7));
    let mut out = Vec::new();
    while out.len() < 20_000 {
        let from = point_in(&mut random, min * 0.9, max * 0.9);
        let to = point_in(&mut random, min * 3.0, max * 3.0);
        if (to - to.clamp(min, max)).length() > 0.2 {
            // Some along axes and into corners.
            let to = match out.len() % 8 {
                0 => DVec3::new(to.x, from.y, from.z).max(DVec3::new(2.5, from.y, from.z)),
                1 => from + (max - from) * 1.5,
                _ => to,
            };
            out.push(free(from, to));
            out.push(free(to, from));
        }
    }
    let within: Vec<Segment> = (0..5000)
        .map(|_| {
            free(point_in(&mut random, min * 0.9, max * 0.9), point_in(&mut random, min * 0.9, max * 0.9))
        })
        .collect();
    for method in methods.iter().flatten() {
        let mut occluded = vec![0; out.len()];
        method.occluded(&out, &mut occluded)?;
        if let Some(leak) = occluded.iter().position(|&o| o == 0) {
            return Err(format!("{}: {:?} leaks", method.name(), out[leak]).into());
        }
        let mut occluded = vec![0; within.len()];
        method.occluded(&within, &mut occluded)?;
        ensure!(!occluded.contains(&1), "{}: something is in the empty room", method.name());
    }
    Ok(())
}

pub(crate) fn a_sphere_is_hit_between_its_radii() -> Result<(), Failed> {
    // Meridians and parallels, radius 1.5: facets lie at most 1 % inside.
    let (rings, sectors) = (40u32, 80u32);
    let mut mesh = Mesh::default();
    for ring in 0..=rings {
        for sector in 0..=sectors {
            let (sine, cosine) = (std::f32::consts::PI * ring as f32 / rings as f32).sin_cos();
            let (s, c) = (std::f32::consts::TAU * sector as f32 / sectors as f32).sin_cos();
            mesh.positions.push(Vec3::new(sine * c, cosine, sine * s) * 1.5);
        }
    }
    for ring in 0..rings {
        for sector in 0..sectors {
            let at = ring * (sectors + 1) + sector;
            let below = at + sectors + 1;
            mesh.triangles.extend([[at, below, below + 1], [at, below + 1, at + 1]]);
        }
    }
    let place = Place::of_mesh(mesh, 8)?;
    let reference = place.reference();
    let methods = methods(&place, &reference)?;
    let mut random = Random::new(3);
    let corner = DVec3::splat(2.5);
    let ends: Vec<_> = (0..2000)
        .map(|_| (point_in(&mut random, -corner, corner), point_in(&mut random, -corner, corner)))
        .filter(|(a, b)| a.length() > 1.6 && b.length() > 1.6)
        .collect();
    expect_all(&place, &methods, &ends, &|a, b, margin| {
        let direction = (b - a).normalize();
        let along = -a.dot(direction);
        let nearest = (a + direction * along.clamp(0.0, (b - a).length())).length();
        if nearest > 1.5 + margin {
            return Some(None);
        }
        // Rays that graze the sphere may answer either way; those in the middle are known within the facets' sagitta,
        // which only the tolerance of cells covers, so that distances are compared with the exact method's.
        (nearest < 1.3).then(|| {
            let exact = reference.intersect(a, b - a, 1.0).expect("hits the sphere");
            let ideal = along - (1.5f64.powi(2) - nearest.powi(2)).sqrt();
            let found = exact.t * (b - a).length();
            assert!((found - ideal).abs() < 0.03, "{found} {ideal}");
            Some(found)
        })
    })
}

/// Two rooms side by side along x, and a door in the wall between them: x = 0.03, |z| < 0.5, y < 1.
pub(crate) fn two_rooms() -> Result<Place, Failed> {
    let mut quads = box_quads([-4.0, -1.0, -2.0], [4.1, 2.0, 2.1]);
    let x = 0.03;
    let wall =
        |y: [f32; 2], z: [f32; 2]| [[x, y[0], z[0]], [x, y[1], z[0]], [x, y[1], z[1]], [x, y[0], z[1]]];
    quads.extend([
        wall([-1.0, 2.0], [-2.0, -0.5]),
        wall([-1.0, 2.0], [0.5, 2.1]),
        wall([1.0, 2.0], [-0.5, 0.5]),
    ]);
    Place::of_quads(&quads, 8)
}

pub(crate) fn rooms_see_each_other_through_the_door() -> Result<(), Failed> {
    let place = two_rooms()?;
    let reference = place.reference();
    rooms_answers(&place, &methods(&place, &reference)?)
}

pub(crate) fn rooms_answers(place: &Place, methods: &Methods) -> Result<(), Failed> {
    let mut random = Random::new(4);
    let (min, max) = (DVec3::new(-3.8, -0.8, -1.8), DVec3::new(3.9, 1.8, 1.9));
    let ends: Vec<_> = (0..3000)
        .map(|_| {
            let mut from = point_in(&mut random, min, max);
            from.x = -from.x.abs().min(3.5) - 0.2;
            let mut to = point_in(&mut random, min, max);
            to.x = to.x.abs().min(3.5) + 0.2;
            if random.below(2) == 0 { (from, to) } else { (to, from) }
        })
        .collect();
    expect_all(place, methods, &ends, &|a, b, margin| {
        let share = (0.03 - a.x) / (b.x - a.x);
        let at = a + (b - a) * share;
        let slope = (b - a).length() / (b.x - a.x).abs();
        let outside = (at.z.abs() - 0.5).max(at.y - 1.0);
        let certain = outside.abs() > margin * slope && slope < 8.0;
        certain.then_some((outside > 0.0).then_some((at - a).length()))
    })
}
