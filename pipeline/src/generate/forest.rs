//! A forest: trees of masked cards and trees with a rhomb for every leaf, on hilly ground with grass.

use glam::{DMat4, vec2, vec3};

use super::model::{Model, place};
use super::palette::Palette;
use super::rng::Rng;
use super::terrain::Terrain;
use super::tree::{Leaves, Spot, blades, plant};
use crate::scene::Scene;

/// Triangles of one tree, about.
const TREE_TRIANGLES: u64 = 4_000;
/// Metres between trees, about.
const SPACING: f32 = 5.5;

/// Builds a forest of `triangles`.
pub(super) fn forest(scene: &mut Scene, triangles: u64, seed: u64) {
    let palette = Palette::new(scene);
    let mut rng = Rng::new(seed, 3);
    let side = ((triangles / TREE_TRIANGLES) as f32).sqrt().round().max(2.0) as u32;
    let half_extent = 0.5 * SPACING * (side as f32 + 1.0);
    let terrain = Terrain::new(seed, 24.0, 4.5, 4.0);

    // At most a tenth for the ground.
    let cells = (((triangles / 20) as f32).sqrt() as u32).clamp(1, 4 * side);
    let mut ground = Model::default();
    let line = |i: u32| (i as f32 / cells as f32 * 2.0 - 1.0) * half_extent;
    for row in 0..cells {
        for column in 0..cells {
            let low = vec2(line(column), line(row));
            let high = vec2(line(column + 1), line(row + 1));
            let repeats = palette.grass.repeats_per_metre.unwrap_or(0.0);
            let (corners, uvs) = terrain.cell(low, high, repeats);
            ground.quad_with_uvs(palette.grass, corners, uvs);
        }
    }
    let meshes = ground.into_scene(scene, "ground");
    place(scene, meshes, DMat4::IDENTITY);

    let spots: Vec<_> = (0..side * side)
        .map(|i| {
            let jitter = vec2(rng.range(-0.4, 0.4), rng.range(-0.4, 0.4));
            let at = |i: u32, jitter: f32| (i as f32 + 0.5 - 0.5 * side as f32 + jitter) * SPACING;
            let (x, z) = (at(i % side, jitter.x), at(i / side, jitter.y));
            Spot {
                foot: terrain.point(x, z) - vec3(0.0, 0.15, 0.0),
                scale: rng.range(0.9, 1.9),
                turn: rng.range(0.0, std::f32::consts::TAU),
            }
        })
        .collect();
    let left = triangles.saturating_sub(scene.drawn_triangles());
    let grass = left / 12;
    let rest = plant(scene, &palette, &spots, left - grass, 3, &[Leaves::Geometry, Leaves::Cards], &mut rng);
    let mut undergrowth = Model::default();
    blades(&mut undergrowth, &palette, grass + rest, &mut rng, |rng| {
        terrain.point(rng.range(-half_extent, half_extent), rng.range(-half_extent, half_extent))
    });
    let meshes = undergrowth.into_scene(scene, "undergrowth");
    place(scene, meshes, DMat4::IDENTITY);
}
