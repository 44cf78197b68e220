//! A park: lawn, paths, trees, benches, lamps and many people.

use glam::{DMat4, Vec3, vec2, vec3};

use super::model::{Frame, Model, place};
use super::palette::{PAINTS, Palette};
use super::rng::Rng;
use super::street::{bench, fountain, lamp, light_lamp};
use super::terrain::Terrain;
use super::tree::{Leaves, Spot, blades, plant};
use crate::scene::Scene;

/// Metres between the crossing paths.
const PITCH: f32 = 26.0;
/// Half of a path's width in metres.
const HALF_PATH: f32 = 2.0;
/// Cells of lawn between two paths.
const LAWN_CELLS: u32 = 4;

/// Builds a park of `triangles`.
pub(super) fn park(scene: &mut Scene, triangles: u64, seed: u64) {
    let palette = Palette::new(scene);
    let mut rng = Rng::new(seed, 5);
    let side = ((triangles / 25_000) as f32).sqrt().round().max(1.0) as u32;
    let half_extent = 0.5 * side as f32 * PITCH + HALF_PATH;
    let terrain = Terrain::new(seed, 40.0, 2.5, 9.0);
    ground(scene, &palette, &terrain, side);

    let path = |index: u32| index as f32 * PITCH - 0.5 * side as f32 * PITCH;
    if triangles >= 20_000 {
        // Where the first two lawns' paths meet nearest to the centre.
        let at = path(side / 2);
        let meshes = fountain(&palette).into_scene(scene, "fountain");
        place(scene, meshes, Frame::at(terrain.point(at, at)).world_from_object(0.6));
    }
    furniture(scene, &palette, &terrain, side, triangles / 10);
    people(scene, &palette, &terrain, half_extent, triangles * 45 / 100, &mut rng);

    let spots: Vec<_> = (0..(side * side * 5).max(2))
        .map(|_| {
            let lawn = |rng: &mut Rng| path(rng.below(side)) + rng.range(4.0, PITCH - 4.0);
            let (x, z) = (lawn(&mut rng), lawn(&mut rng));
            Spot {
                foot: terrain.point(x, z) - vec3(0.0, 0.1, 0.0),
                scale: rng.range(0.8, 1.5),
                turn: rng.range(0.0, std::f32::consts::TAU),
            }
        })
        .collect();
    let left = triangles.saturating_sub(scene.drawn_triangles());
    let grass = left / 8;
    let rest = plant(scene, &palette, &spots, left - grass, 3, &[Leaves::Cards, Leaves::Geometry], &mut rng);
    let mut lawn = Model::default();
    blades(&mut lawn, &palette, grass + rest, &mut rng, |rng| {
        let at = |rng: &mut Rng| path(rng.below(side)) + rng.range(HALF_PATH, PITCH - HALF_PATH);
        let (x, z) = (at(rng), at(rng));
        terrain.point(x, z)
    });
    let meshes = lawn.into_scene(scene, "grass");
    place(scene, meshes, DMat4::IDENTITY);
}

fn ground(scene: &mut Scene, palette: &Palette, terrain: &Terrain, side: u32) {
    let mut lines = Vec::new();
    for index in 0..=side {
        let centre = index as f32 * PITCH - 0.5 * side as f32 * PITCH;
        lines.push((centre - HALF_PATH, true));
        lines.push((centre + HALF_PATH, false));
        for cell in 1..LAWN_CELLS {
            let step = (PITCH - 2.0 * HALF_PATH) / LAWN_CELLS as f32;
            lines.push((centre + HALF_PATH + step * cell as f32, false));
        }
    }
    // Past the last path there is no lawn.
    lines.truncate(lines.len() - (LAWN_CELLS as usize - 1));
    let mut model = Model::default();
    for rows in lines.windows(2) {
        for columns in lines.windows(2) {
            let is_path = rows[0].1 || columns[0].1;
            let brush = if is_path { palette.cobbles } else { palette.grass };
            let (low, high) = (vec2(columns[0].0, rows[0].0), vec2(columns[1].0, rows[1].0));
            let (corners, uvs) = terrain.cell(low, high, brush.repeats_per_metre.unwrap_or(0.0));
            model.quad_with_uvs(brush, corners, uvs);
        }
    }
    let meshes = model.into_scene(scene, "ground");
    place(scene, meshes, DMat4::IDENTITY);
}

/// A bench and a lamp for each stretch of path, as far as `budget` reaches.
fn furniture(scene: &mut Scene, palette: &Palette, terrain: &Terrain, side: u32, budget: u64) {
    let (bench, lamp) = (bench(palette), lamp(palette));
    let pairs = budget / (bench.triangles() + lamp.triangles());
    let bench = bench.into_scene(scene, "bench");
    let lamp = lamp.into_scene(scene, "lamp");
    for index in 0..pairs.min(u64::from(side * side)) as u32 {
        let at = |i: u32| i as f32 * PITCH - 0.5 * side as f32 * PITCH;
        let (x, z) = (at(index % side), at(index / side) + 0.5 * PITCH);
        let bench_frame = Frame::quarter_turned(terrain.point(x + HALF_PATH + 0.6, z), 3);
        place(scene, bench.clone(), bench_frame.world_from_object(1.0));
        let lamp_frame = Frame::quarter_turned(terrain.point(x + HALF_PATH + 0.4, z + 2.5), 3);
        place(scene, lamp.clone(), lamp_frame.world_from_object(1.0));
        light_lamp(scene, &lamp_frame);
    }
}

/// People everywhere, as many as `budget` allows. Every figure has its own pose, and is used twice.
fn people(
    scene: &mut Scene,
    palette: &Palette,
    terrain: &Terrain,
    half_extent: f32,
    budget: u64,
    rng: &mut Rng,
) {
    let detail = u32::from(budget >= 20_000);
    let mut left = budget;
    for index in 0.. {
        let model = figure(palette, detail, rng);
        let cost = 2 * model.triangles();
        if cost > left {
            break;
        }
        left -= cost;
        let meshes = model.into_scene(scene, &format!("figure {index}"));
        for _ in 0..2 {
            let mut at = || rng.range(0.5 - half_extent, half_extent - 0.5);
            let foot = terrain.point(at(), at());
            let frame = Frame::turned(foot, rng.range(0.0, std::f32::consts::TAU));
            place(scene, meshes.clone(), frame.world_from_object(rng.range(0.9, 1.08)));
        }
    }
}

/// Somebody 1.75 m tall who walks along +z.
fn figure(palette: &Palette, detail: u32, rng: &mut Rng) -> Model {
    let (around, rings, sides) = if detail == 0 { (5, 3, 4) } else { (8, 6, 6) };
    let skin =
        palette.skin.tinted(rng.pick(&[[205, 140, 104], [130, 78, 50], [70, 40, 26], [222, 168, 132]]));
    let hair = palette.paint.tinted(rng.pick(&[[24, 16, 10], [92, 58, 26], [150, 118, 60], [110, 110, 110]]));
    let shirt = palette.paint.tinted(rng.pick(&PAINTS));
    let trousers = palette.paint.tinted(rng.pick(&PAINTS));
    let mut model = Model::default();
    let at = |p: Vec3| Frame::at(p);
    model.ellipsoid(skin, &at(vec3(0.0, 1.62, 0.0)), vec3(0.095, 0.125, 0.11), around, rings);
    model.ellipsoid(hair, &at(vec3(0.0, 1.665, -0.025)), vec3(0.105, 0.105, 0.11), around, rings);
    model.ellipsoid(shirt, &at(vec3(0.0, 1.22, 0.0)), vec3(0.2, 0.31, 0.13), around, rings);
    model.ellipsoid(trousers, &at(vec3(0.0, 0.93, 0.0)), vec3(0.17, 0.15, 0.125), around, rings);
    let stride = rng.range(-0.3, 0.3);
    for side in [-1.0, 1.0] {
        let swing = stride * side;
        let leg = [
            vec3(0.09 * side, 0.95, 0.0),
            vec3(0.1 * side, 0.5, 0.5 * swing + 0.05),
            vec3(0.1 * side, 0.05, swing),
        ];
        model.tube(trousers, &leg, &[0.09, 0.065, 0.05], sides);
        let shoe = at(vec3(0.1 * side, 0.045, swing + 0.06));
        model.ellipsoid(palette.metal, &shoe, vec3(0.05, 0.045, 0.13), around, rings);
        let lift = rng.range(0.0, 0.25);
        let arm = [
            vec3(0.2 * side, 1.42, 0.0),
            vec3(0.27 * side, 1.15, -0.5 * swing),
            vec3(0.27 * side, 0.9 + lift, 0.12 - swing),
        ];
        model.tube(shirt, &arm, &[0.06, 0.05, 0.035], sides);
        model.ellipsoid(skin, &at(arm[2]), Vec3::splat(0.05), around, rings);
    }
    model
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_stands_on_the_ground() {
        let mut scene = Scene::default();
        let palette = Palette::new(&mut scene);
        let meshes = figure(&palette, 1, &mut Rng::new(1, 1)).into_scene(&mut scene, "figure");
        place(&mut scene, meshes, DMat4::IDENTITY);
        let (low, high) = scene.bounds().unwrap();
        assert!((-0.01..0.03).contains(&low.y), "feet at {} m", low.y);
        assert!((1.7..1.8).contains(&high.y), "head at {} m", high.y);
    }
}
