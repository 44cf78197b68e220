//! A city: blocks of towers whose facades are grids of windows.

use glam::{DMat4, Vec3, vec2, vec3};

use super::model::{Brush, Frame, Hidden, Model, place};
use super::palette::{PLASTER, Palette};
use super::rng::Rng;
use super::street::{lamp, light_lamp};
use super::tree::{Leaves, Spot, blades, plant};
use crate::scene::Scene;

/// Metres from one tower's centre to the next.
const PITCH: f32 = 34.0;
/// Metres from the grid line to the facades.
const HALF_STREET: f32 = 6.0;
/// Lamps at most: beyond, the towers' windows are the lights.
const MAX_LAMPS: u64 = 20_000;

/// Builds a city of `triangles`.
pub(super) fn city(scene: &mut Scene, triangles: u64, seed: u64) {
    let palette = Palette::new(scene);
    let mut rng = Rng::new(seed, 2);
    let side = ((triangles / 2_500) as f32).sqrt().round().max(2.0) as u32;
    let half_extent = 0.5 * side as f32 * PITCH;
    let centre = |i: u32| (i as f32 + 0.5) * PITCH - half_extent;

    ground(scene, &palette, side, half_extent);
    lamps(scene, &palette, side, half_extent, triangles / 12);

    let spots: Vec<_> = (0..(side * side / 8).max(1))
        .map(|_| Spot {
            foot: vec3(centre(rng.below(side)) + 13.5, 0.0, centre(rng.below(side)) + rng.range(-12.0, 12.0)),
            scale: rng.range(0.6, 1.0),
            turn: rng.range(0.0, std::f32::consts::TAU),
        })
        .collect();
    let tree_budget = triangles / 12;

    let mut left = triangles.saturating_sub(scene.drawn_triangles() + tree_budget);
    for index in 0..side * side {
        let (x, z) = (centre(index % side), centre(index / side));
        let allowance = left / u64::from(side * side - index);
        let distance = (x * x + z * z).sqrt() / half_extent;
        let mut model = Model::default();
        tower(&mut model, &palette, allowance, distance, &mut rng);
        left -= model.triangles().min(left);
        let meshes = model.into_scene(scene, &format!("tower {index}"));
        place(scene, meshes, Frame::at(vec3(x, 0.0, z)).world_from_object(1.0));
    }
    let rest = plant(scene, &palette, &spots, tree_budget + left, 2, &[Leaves::Cards], &mut rng);
    let mut verge = Model::default();
    blades(&mut verge, &palette, rest.min(triangles / 50), &mut rng, |rng| {
        vec3(centre(rng.below(side)) + rng.range(12.0, 14.0), 0.0, rng.range(-half_extent, half_extent))
    });
    let meshes = verge.into_scene(scene, "verge");
    place(scene, meshes, DMat4::IDENTITY);
}

/// Roads, and a kerbed plot for every tower.
fn ground(scene: &mut Scene, palette: &Palette, side: u32, half_extent: f32) {
    let mut model = Model::default();
    let reach = half_extent + HALF_STREET;
    let uv = |x: f32, z: f32| vec2(x, z) * palette.cobbles.repeats_per_metre.unwrap_or(0.0);
    model.quad_with_uvs(
        palette.cobbles,
        [
            vec3(-reach, 0.0, reach),
            vec3(reach, 0.0, reach),
            vec3(reach, 0.0, -reach),
            vec3(-reach, 0.0, -reach),
        ],
        [uv(-reach, reach), uv(reach, reach), uv(reach, -reach), uv(-reach, -reach)],
    );
    for index in 0..side * side {
        let at = |i: u32| (i as f32 + 0.5) * PITCH - half_extent;
        let frame = Frame::at(vec3(at(index % side), 0.0, at(index / side)));
        let half = 0.5 * PITCH - HALF_STREET + 3.5;
        model.block(palette.stone, &frame, vec3(-half, -0.2, -half), vec3(half, 0.15, half), Hidden::Bottom);
    }
    let meshes = model.into_scene(scene, "ground");
    place(scene, meshes, DMat4::IDENTITY);
}

fn lamps(scene: &mut Scene, palette: &Palette, side: u32, half_extent: f32, budget: u64) {
    let model = lamp(palette);
    let count = (budget / model.triangles()).min(u64::from(2 * side * side)).min(MAX_LAMPS) as u32;
    let meshes = model.into_scene(scene, "lamp");
    for index in 0..count {
        let cell = index / 2;
        let corner = |i: u32| i as f32 * PITCH - half_extent;
        let along = if index % 2 == 0 { 0.3 } else { 0.8 } * PITCH;
        let position = vec3(corner(cell % side) + along, 0.0, corner(cell / side % side) + 2.6);
        let frame = Frame::quarter_turned(position, 2);
        place(scene, meshes.clone(), frame.world_from_object(1.0));
        light_lamp(scene, &frame);
    }
}

/// A tower of one to three stacked boxes of about `allowance` triangles; `distance` is 0 downtown, 1 at the edge.
fn tower(model: &mut Model, palette: &Palette, allowance: u64, distance: f32, rng: &mut Rng) {
    let wall: Brush = match rng.below(4) {
        0 => palette.bricks,
        1 => palette.stone,
        _ => palette.plaster.tinted(rng.pick(&PLASTER).map(|channel| channel / 2 + 40)),
    };
    let tall = (1.3 - distance).max(0.15);
    let mut height = rng.range(14.0, 40.0) + 90.0 * tall * tall * rng.unit();
    let mut half = vec2(rng.range(7.5, 11.0), rng.range(7.5, 11.0));
    let tiers = if allowance < 400 { 1 } else { 1 + rng.below(3) };
    let mut foot = 0.0;
    let mut left = allowance;
    for tier in 0..tiers {
        let here = left / u64::from(tiers - tier);
        let low = vec3(-half.x, foot, -half.y);
        model.block(wall, &Frame::at(Vec3::ZERO), low, vec3(half.x, foot + height, half.y), Hidden::Bottom);
        let spent = 10 + roof_plant(model, palette, foot + height, half, here, rng);
        let windows = here.saturating_sub(spent) / WINDOW_TRIANGLES;
        let facades = windows_on(model, palette, foot, height, half, windows, rng);
        left = left.saturating_sub(spent + facades * WINDOW_TRIANGLES);
        foot += height;
        height *= rng.range(0.3, 0.7);
        half *= rng.range(0.6, 0.85);
    }
}

/// Boxes of machinery on a roof; returns their triangles.
fn roof_plant(
    model: &mut Model,
    palette: &Palette,
    roof: f32,
    half: glam::Vec2,
    allowance: u64,
    rng: &mut Rng,
) -> u64 {
    let boxes = (allowance / 200).min(6);
    for _ in 0..boxes {
        let at = Frame::at(vec3(rng.range(-0.8, 0.8) * half.x, roof, rng.range(-0.8, 0.8) * half.y));
        let size = vec3(rng.range(0.5, 1.4), rng.range(0.8, 2.6), rng.range(0.5, 1.4));
        model.block(palette.metal, &at, vec3(-size.x, 0.0, -size.z), size, Hidden::Bottom);
    }
    boxes * 10
}

/// A projecting frame without its back, and a pane.
const WINDOW_TRIANGLES: u64 = 12;

/// A grid of at most `count` windows over the four facades of a tier, as dense as `count` allows; returns how many.
fn windows_on(
    model: &mut Model,
    palette: &Palette,
    foot: f32,
    height: f32,
    half: glam::Vec2,
    count: u64,
    rng: &mut Rng,
) -> u64 {
    // Rows and columns of nearly square cells whose number is just below `count`.
    let around = 4.0 * (half.x + half.y);
    let cell = (around * height / count.max(1) as f32).sqrt();
    let rows = ((height / cell).round() as u64).clamp(1, count.max(1));
    let columns_around = count / rows;
    if columns_around == 0 {
        return 0;
    }
    let mut placed = 0;
    for side in 0..4_u32 {
        let (span, distance) = if side % 2 == 0 { (half.x, half.y) } else { (half.y, half.x) };
        // Columns are dealt so that the four sides sum up.
        let columns = columns_around * u64::from(side + 1) / 4 - columns_around * u64::from(side) / 4;
        let wall = Frame::at(vec3(0.0, foot, 0.0)).side(Vec3::ZERO, side).moved(vec3(0.0, 0.0, distance));
        for row in 0..rows {
            for column in 0..columns {
                let width = 2.0 * span / columns as f32;
                let storey = height / rows as f32;
                let at = wall.moved(vec3((column as f32 + 0.5) * width - span, storey * row as f32, 0.0));
                let (w, low, high) = (0.36 * width, 0.25 * storey, 0.85 * storey);
                model.block(palette.trim, &at, vec3(-w, low, 0.0), vec3(w, high, 0.1), Hidden::Back);
                let glass = match rng.below(10) {
                    0..3 => palette.lit_glass,
                    3 => palette.cool_glass,
                    _ => palette.dark_glass,
                };
                let (w, low, high) = (0.9 * w, low + 0.05 * storey, high - 0.05 * storey);
                let p = |x: f32, y: f32| at.point(vec3(x, y, 0.12));
                model.quad(glass, [p(-w, low), p(w, low), p(w, high), p(-w, high)]);
                placed += 1;
            }
        }
    }
    placed
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tower_takes_about_its_allowance() {
        let mut scene = Scene::default();
        let palette = Palette::new(&mut scene);
        for allowance in [200, 1_000, 2_500, 20_000] {
            let mut sum = 0;
            for seed in 0..50 {
                let mut model = Model::default();
                tower(&mut model, &palette, allowance, 0.5, &mut Rng::new(seed, 0));
                assert!(model.triangles() <= allowance);
                sum += model.triangles();
            }
            let mean = sum as f64 / 50.0 / allowance as f64;
            assert!(mean > 0.75, "{mean} of {allowance}");
        }
    }
}
