//! Trees with an exact number of triangles, and planting them.

use glam::{Vec3, vec2, vec3};

use super::model::{Brush, Frame, Model, place, sin_cos_f32};
use super::palette::{FOLIAGE, Palette};
use super::rng::Rng;
use crate::scene::Scene;

/// How a tree's leaves are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Leaves {
    /// Squares cut out by the mask texture.
    Cards,
    /// One rhomb of two triangles a leaf.
    Geometry,
}

/// Where a tree stands.
#[derive(Debug, Clone, Copy)]
pub(super) struct Spot {
    /// Foot of the trunk.
    pub(super) foot: Vec3,
    /// Uniform scale.
    pub(super) scale: f32,
    /// Radians about +Y.
    pub(super) turn: f32,
}

/// Plants `spots` with trees that take `triangles` in all but for a remainder below two a spot, and returns what is
/// left. Every model is used `copies` times.
pub(super) fn plant(
    scene: &mut Scene,
    palette: &Palette,
    spots: &[Spot],
    triangles: u64,
    copies: usize,
    leaves: &[Leaves],
    rng: &mut Rng,
) -> u64 {
    if spots.is_empty() {
        return triangles;
    }
    let mut left = triangles;
    let mut spots_left = spots.len() as u64;
    for (index, group) in spots.chunks(copies.max(1)).enumerate() {
        let allowance = (left / spots_left).min(u64::from(u32::MAX / 8)) as u32;
        let kind = leaves[index % leaves.len()];
        let model = tree(palette, allowance, kind, rng);
        left -= model.triangles() * group.len() as u64;
        spots_left -= group.len() as u64;
        let meshes = model.into_scene(scene, &format!("tree {index}"));
        for spot in group {
            let matrix = Frame::turned(spot.foot, spot.turn).world_from_object(spot.scale);
            place(scene, meshes.clone(), matrix);
        }
    }
    left
}

/// A tree about 6.5 m high with its foot in the origin: `triangles` in all, or one less if that is odd.
fn tree(palette: &Palette, triangles: u32, leaves: Leaves, rng: &mut Rng) -> Model {
    let mut model = Model::default();
    let height = rng.range(5.4, 7.6);
    let crown_width = rng.range(1.7, 2.5);
    let crown = Frame::at(vec3(rng.range(-0.2, 0.2), height * 0.66, rng.range(-0.2, 0.2)));
    let crown_radii = vec3(crown_width, height * 0.36, crown_width * rng.range(0.85, 1.15));
    // Wood takes at most a quarter, or the trunk alone.
    let (sides, steps) = if triangles < 60 {
        (3, 1)
    } else if triangles < 400 {
        (5, 2)
    } else {
        (7, 4)
    };
    let trunk_triangles = 2 * sides * steps;
    if trunk_triangles <= triangles {
        let bend = vec3(rng.range(-0.3, 0.3), 0.0, rng.range(-0.3, 0.3));
        let at = |t: f32| bend * (t * (1.0 - t)) * 2.0 + crown.origin * t * vec3(1.0, 1.12, 1.0);
        let points: Vec<_> = (0..=steps).map(|i| at(i as f32 / steps as f32)).collect();
        let radii: Vec<_> = (0..=steps).map(|i| 0.2 - 0.15 * i as f32 / steps as f32).collect();
        model.tube(palette.bark, &points, &radii, sides);
    }
    let branch_sides = if triangles < 2_000 { 3 } else { 5 };
    let branch_triangles = 2 * branch_sides * 3;
    let branches = (triangles / 4).saturating_sub(trunk_triangles) / branch_triangles;
    let branches = branches.min(8 + triangles / 600).min(160);
    let mut tips = Vec::with_capacity(branches as usize);
    for branch in 0..branches {
        let share = (branch as f32 + 0.5) / branches as f32;
        let start = crown.origin * vec3(1.0, 0.55 + 0.5 * share, 1.0);
        let tip = crown.point(on_crown(rng) * 0.8 * crown_radii);
        let sag = Vec3::Y * -0.12 * (tip - start).length();
        let at = |t: f32| start + (tip - start) * t + sag * (4.0 * t * (1.0 - t)) * 0.5;
        let points = [at(0.0), at(0.33), at(0.66), at(1.0)];
        model.tube(palette.bark, &points, &[0.06, 0.045, 0.03, 0.01], branch_sides);
        tips.push(tip);
    }
    let leaf_count = (u64::from(triangles) - model.triangles()) / 2;
    let tint = rng.pick(&FOLIAGE);
    for _ in 0..leaf_count {
        // Half of the leaves sit around the tips, half anywhere in the outer crown.
        let unit = on_crown(rng);
        let position = if !tips.is_empty() && rng.chance(0.5) {
            rng.pick(&tips) + unit * 0.5
        } else {
            crown.point(unit * (1.0 - 0.45 * rng.unit() * rng.unit()) * crown_radii)
        };
        let brightness = rng.range(0.75, 1.3);
        let tint = tint.map(|channel| (f32::from(channel) * brightness).min(255.0) as u8);
        let outward = (position - crown.origin).normalize_or(Vec3::Y);
        let normal = (outward + rng.direction() * 0.9).normalize_or(Vec3::Y);
        match leaves {
            Leaves::Cards => {
                // The crown stays as full whatever the count.
                let size = (150.0 / leaf_count as f32).sqrt().clamp(0.2, 2.4) * rng.range(0.85, 1.2);
                card(&mut model, palette.leaf_cards.tinted(tint), position, normal, size, rng);
            }
            Leaves::Geometry => {
                let size = (110.0 / leaf_count as f32).sqrt().clamp(0.06, 2.0) * rng.range(0.8, 1.2);
                rhomb(&mut model, palette.leaves.tinted(tint), position, normal, size, rng);
            }
        }
    }
    model
}

/// A direction with more of the upper half.
fn on_crown(rng: &mut Rng) -> Vec3 {
    let d = rng.direction();
    if d.y < -0.55 { vec3(d.x, -d.y, d.z) } else { d }
}

/// Two perpendicular vectors in the plane of `normal`, turned by chance.
fn in_plane(normal: Vec3, rng: &mut Rng) -> (Vec3, Vec3) {
    let frame = Frame::along(Vec3::ZERO, normal);
    let (sin, cos) = sin_cos_f32(rng.range(0.0, std::f32::consts::TAU));
    let x = frame.x * cos + frame.z * sin;
    (x, normal.cross(x))
}

/// A square of the mask texture.
fn card(model: &mut Model, brush: Brush, centre: Vec3, normal: Vec3, size: f32, rng: &mut Rng) {
    let (x, y) = in_plane(normal, rng);
    let (x, y) = (x * (0.5 * size), y * (0.5 * size));
    let corners = [centre - x - y, centre + x - y, centre + x + y, centre - x + y];
    model.quad_with_uvs(brush, corners, [vec2(0.0, 1.0), vec2(1.0, 1.0), vec2(1.0, 0.0), vec2(0.0, 0.0)]);
}

/// A leaf as a rhomb bent along its middle.
fn rhomb(model: &mut Model, brush: Brush, centre: Vec3, normal: Vec3, size: f32, rng: &mut Rng) {
    let (x, y) = in_plane(normal, rng);
    let (base, tip) = (centre - y * (0.5 * size), centre + y * (0.5 * size));
    let fold = normal * (0.12 * size);
    let (left, right) = (centre - x * (0.3 * size) + fold, centre + x * (0.3 * size) + fold);
    model.triangle(brush, [base, right, tip]);
    model.triangle(brush, [base, tip, left]);
}

/// Blades of grass of one triangle each.
pub(super) fn blades(
    model: &mut Model,
    palette: &Palette,
    count: u64,
    rng: &mut Rng,
    mut foot: impl FnMut(&mut Rng) -> Vec3,
) {
    for _ in 0..count {
        let at = foot(rng);
        let (sin, cos) = sin_cos_f32(rng.range(0.0, std::f32::consts::TAU));
        let side = vec3(cos, 0.0, sin) * rng.range(0.02, 0.05);
        let lean = vec3(rng.range(-0.1, 0.1), rng.range(0.15, 0.4), rng.range(-0.1, 0.1));
        let green = 96 + rng.below(50) as u8;
        let tint = [green / 2 + rng.below(24) as u8, green, 24];
        model.triangle(palette.leaves.tinted(tint), [at - side, at + side, at + lean]);
    }
}
