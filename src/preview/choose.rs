//! A camera that shows something, chosen by looking.
//!
//! Two questions are answered with a few thousand rays each. *Is this a building's inside?* A point is like one in a
//! room if almost all directions from it meet surfaces, and their front sides (inside a hollow statue one meets back
//! sides). If much of the scene is like that, the camera goes in. *Which view?* Of some candidates, the one that fills
//! most of the picture with the most varied depths.

use std::f64::consts::TAU;

use glam::DVec3;
use manyview_shaders::trig::sin_cos;
use rayon::prelude::*;

use super::camera::Camera;
use super::octree::Ray;
use super::scene::Scene;

/// Vertical field of view outdoors, degrees.
const OUTSIDE_FOV: f64 = 38.0;
/// Vertical field of view in rooms, degrees.
const INSIDE_FOV: f64 = 68.0;
/// Points that are probed for being in a room.
const PROBES: u32 = 192;
/// Rays of a probe.
const PROBE_RAYS: u32 = 64;
/// Share of the free points that must be in rooms for the scene to be shown from inside.
const ROOM_SHARE: f64 = 0.4;
/// Level whose cells are fitted into the picture.
const FITTED_LEVEL: u32 = 6;
/// Rays a row of a candidate's picture; it has as many rows as its aspect ratio asks for.
const TRIAL_WIDTH: u32 = 48;

/// From where a scene is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraChoice {
    /// From inside if it is mostly rooms, else from outside.
    Auto,
    /// From the best point within.
    Inside,
}

/// A point in the scene's free space, and what it is like there.
struct Probe {
    point: DVec3,
    /// Whether it is like a point in a room.
    is_room: bool,
    /// Whether it has much around it, and that shows its front; a yard or a street, say.
    is_sheltered: bool,
    /// Geometric mean of the distances to what is around, metres.
    openness: f64,
}

/// Chooses a camera for a scene within world bounds, for pictures of an aspect ratio (width / height).
pub fn choose_camera(scene: &Scene, bounds: [DVec3; 2], aspect: f64, choice: CameraChoice) -> Camera {
    let probes: Vec<Probe> =
        (0..PROBES).into_par_iter().filter_map(|number| probe(scene, bounds, number)).collect();
    let rooms = probes.iter().filter(|probe| probe.is_room).count() as f64;
    let inside = match choice {
        CameraChoice::Inside => true,
        CameraChoice::Auto => rooms >= ROOM_SHARE * probes.len() as f64 && rooms >= 4.0,
    };
    let inside = inside && !probes.is_empty();
    let candidates =
        if inside { inside_candidates(probes) } else { outside_candidates(scene, bounds, aspect) };
    let extent = (bounds[1] - bounds[0]).max_element();
    let score = |&(camera, bonus): &(Camera, f64)| {
        let (score, near) = score(scene, &camera, aspect);
        // Indoors, a view along a hall is better than one into a corner.
        score * bonus * if inside { (near / extent).powf(0.4) } else { 1.0 }
    };
    let scores: Vec<f64> = candidates.par_iter().map(score).collect();
    // The first of equals, whatever the threads did.
    let best = (0..candidates.len()).fold(0, |best, i| if scores[i] > scores[best] { i } else { best });
    candidates[best].0
}

/// Looks around from a point of a low-discrepancy sequence within the bounds; `None` if something is there.
fn probe(scene: &Scene, [min, max]: [DVec3; 2], number: u32) -> Option<Probe> {
    let at = |base: u32| radical_inverse(number + 1, base);
    // Between floor and ceiling of what is there; eyes are rarely at the very top.
    let share = DVec3::new(0.06 + 0.88 * at(2), 0.08 + 0.6 * at(3), 0.06 + 0.88 * at(5));
    let point = min + (max - min) * share;
    if scene.octree().node_at(point.to_array(), scene.octree().depth().min(6)).is_some() {
        return None;
    }
    let extent = (max - min).max_element();
    let (mut hits, mut faced, mut fronts, mut log_sum) = (0u32, 0u32, 0u32, 0.0);
    for i in 0..PROBE_RAYS {
        let direction = sphere_direction(i, PROBE_RAYS);
        let ray = Ray::new(point.to_array(), direction.to_array());
        let Some(hit) = scene.octree().intersect(&ray, u32::MAX) else {
            log_sum += extent.ln();
            continue;
        };
        hits += 1;
        log_sum += hit.t.max(1e-6 * extent).ln();
        if let Some(normal) = scene.stored_normal(&hit) {
            faced += 1;
            fronts += u32::from(normal.dot(direction) < 0.0);
        }
    }
    let shows_fronts = fronts * 4 >= faced * 3;
    let is_room = hits * 10 >= PROBE_RAYS * 9 && shows_fronts;
    let is_sheltered = hits * 10 >= PROBE_RAYS * 6 && shows_fronts;
    Some(Probe { point, is_room, is_sheltered, openness: (log_sum / f64::from(PROBE_RAYS)).exp() })
}

fn inside_candidates(mut probes: Vec<Probe>) -> Vec<(Camera, f64)> {
    let any_sheltered = probes.iter().any(|probe| probe.is_sheltered);
    probes.retain(|probe| probe.is_sheltered || !any_sheltered);
    probes.sort_by(|a, b| b.openness.total_cmp(&a.openness));
    let mut candidates = Vec::new();
    for probe in probes.iter().take(24) {
        for turn in 0..12 {
            let (sine, cosine) = sin_cos(f64::from(turn) / 12.0 * TAU);
            let forward = DVec3::new(cosine, -0.09, sine).normalize_or(DVec3::X);
            candidates.push((Camera::looking(probe.point, forward, INSIDE_FOV), 1.0));
        }
    }
    candidates
}

fn outside_candidates(scene: &Scene, [min, max]: [DVec3; 2], aspect: f64) -> Vec<(Camera, f64)> {
    let extent = max - min;
    let octree = scene.octree();
    let level = octree.depth().min(FITTED_LEVEL);
    let edge = octree.cell_size(level);
    let corners = octree.corners(level).into_iter().flat_map(|corner| {
        // A cell may reach beyond the scene.
        (0..8).map(move |c| (DVec3::from(corner) + corner_of_cube(c) * edge).clamp(min, max))
    });
    let corners: Vec<DVec3> = corners.collect();
    // Flat scenes are seen from higher up, or little of them is.
    let flat = extent.y < 0.25 * extent.x.max(extent.z);
    let mut candidates = Vec::new();
    for turn in 0..8 {
        for (height, height_bonus) in [(if flat { 0.55 } else { 0.42 }, 1.0), (0.25, 0.97)] {
            let (sine, cosine) = sin_cos((f64::from(turn) + 0.36) / 8.0 * TAU);
            let from = DVec3::new(cosine, height, sine).normalize_or(DVec3::Z);
            // glTF's front is +Z: of views that are about as good, one from there.
            let front_bonus = 1.0 + 0.12 * sine;
            let camera = Camera::fitted(&corners, from, OUTSIDE_FOV, aspect);
            candidates.push((camera, height_bonus * front_bonus));
        }
    }
    candidates
}

/// Corner `c` of the unit cube.
fn corner_of_cube(c: u32) -> DVec3 {
    DVec3::from([0, 1, 2].map(|i| f64::from(c >> i & 1)))
}

/// How much a camera sees: the share of its picture that is filled, weighted by how varied depths are and how much of
/// what it sees are front sides. Also returns the distance beyond which four fifths of it are, metres.
fn score(scene: &Scene, camera: &Camera, aspect: f64) -> (f64, f64) {
    const BINS: usize = 24;
    let height = ((f64::from(TRIAL_WIDTH) / aspect).round() as u32).clamp(1, 4 * TRIAL_WIDTH);
    let Ok(rays) = camera.ray_maker(TRIAL_WIDTH, height) else { return (0.0, 0.0) };
    let mut depths = Vec::new();
    let (mut faced, mut fronts) = (0u32, 0u32);
    for y in 0..height {
        for x in 0..TRIAL_WIDTH {
            let ray = rays.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let Some(hit) = scene.octree().intersect(&ray, u32::MAX) else { continue };
            depths.push(hit.t.max(1e-9).ln());
            if let Some(normal) = scene.stored_normal(&hit) {
                faced += 1;
                fronts += u32::from(normal.dot(ray.direction.into()) < 0.0);
            }
        }
    }
    let rays = f64::from(TRIAL_WIDTH * height);
    depths.sort_by(f64::total_cmp);
    let [Some(near), Some(far)] = [depths.first(), depths.last()] else { return (0.0, 0.0) };
    // Entropy of the depths over bins of an eighth of an octave or more: 0 for a wall, 1 for all depths alike.
    let width = ((far - near) / BINS as f64).max(0.09);
    let mut bins = [0u32; BINS];
    for depth in &depths {
        bins[(((depth - near) / width) as usize).min(BINS - 1)] += 1;
    }
    let entropy: f64 = bins
        .iter()
        .filter(|&&count| count > 0)
        .map(|&count| {
            let share = f64::from(count) / depths.len() as f64;
            -share * share.ln()
        })
        .sum();
    let variety = entropy / (BINS as f64).ln();
    let filled = depths.len() as f64 / rays;
    let front = if faced > 0 { f64::from(fronts) / f64::from(faced) } else { 0.5 };
    (filled * (0.3 + variety) * (0.25 + front), depths[depths.len() / 5].exp())
}

/// Direction `i` of `count` that cover the sphere evenly (a Fibonacci spiral).
fn sphere_direction(i: u32, count: u32) -> DVec3 {
    let y = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(count);
    let (sine, cosine) = sin_cos(f64::from(i) * 2.399_963_229_728_653);
    let radius = (1.0 - y * y).max(0.0).sqrt();
    DVec3::new(cosine * radius, y, sine * radius)
}

/// Number `i` of the van der Corput sequence in a base.
fn radical_inverse(mut i: u32, base: u32) -> f64 {
    let (mut value, mut digit) = (0.0, 1.0 / f64::from(base));
    while i > 0 {
        value += f64::from(i % base) * digit;
        i /= base;
        digit /= f64::from(base);
    }
    value
}
