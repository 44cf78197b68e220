//! A ball of thin curved tubes that grow from a small sphere: many triangles, no flat place, deep occlusion.

use glam::{DMat4, Vec3};

use super::model::{Model, place};
use super::palette::Palette;
use super::rng::Rng;
use crate::scene::Scene;

/// Metres of the sphere that the hairs grow from.
const CORE_RADIUS: f32 = 0.5;
/// Metres of the ball, about.
const BALL_RADIUS: f32 = 2.5;
/// Triangles in one mesh, about: more meshes rather than larger ones.
const MESH_TRIANGLES: u64 = 1 << 19;

/// Builds a hairball of `triangles`.
pub(super) fn hairball(scene: &mut Scene, triangles: u64, seed: u64) {
    let palette = Palette::new(scene);
    let mut rng = Rng::new(seed, 4);
    let (sides, segments) = match triangles {
        0..20_000 => (3, 12),
        20_000..400_000 => (3, 32),
        _ => (4, 64),
    };
    let hair_triangles = u64::from(2 * sides * segments);
    let hairs = triangles.div_ceil(hair_triangles);
    // Thinner hairs the more there are: the ball stays about as dense as yarn.
    let radius = (0.6 / (hairs as f32).sqrt()).clamp(0.002, 0.03);
    let mut model = Model::default();
    let mut left = triangles;
    for hair in 0..hairs {
        let segments = segments.min((left / u64::from(2 * sides)) as u32);
        let points = hair_points(segments, &mut rng);
        let radii: Vec<_> =
            (0..points.len()).map(|i| radius * (1.0 - 0.7 * i as f32 / points.len() as f32)).collect();
        model.tube(palette.wood, &points, &radii, sides);
        left -= u64::from(2 * sides * segments);
        if model.triangles() >= MESH_TRIANGLES || hair + 1 == hairs {
            let meshes = std::mem::take(&mut model).into_scene(scene, "hair");
            place(scene, meshes, DMat4::IDENTITY);
        }
    }
}

/// A path that leaves the core, wanders and is drawn back to the ball's surface.
fn hair_points(segments: u32, rng: &mut Rng) -> Vec<Vec3> {
    let mut position = rng.direction() * CORE_RADIUS;
    let mut heading = (position + rng.direction() * 0.3).normalize_or(Vec3::Y);
    let mut turning = rng.direction();
    let step = 6.0 / segments.max(1) as f32;
    let mut points = Vec::with_capacity(segments as usize + 1);
    points.push(position);
    for _ in 0..segments {
        turning = (turning + rng.direction() * 0.5).normalize_or(Vec3::X);
        let radius = position.length();
        let inwards = if radius > 0.8 * BALL_RADIUS { -2.0 * (radius / BALL_RADIUS - 0.8) } else { 0.0 };
        let pull = position.normalize_or_zero() * inwards * 5.0;
        heading = (heading + (turning * 1.2 + pull) * step).normalize_or(heading);
        position += heading * step;
        points.push(position);
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hairs_stay_in_the_ball() {
        let mut rng = Rng::new(0, 0);
        for _ in 0..500 {
            for point in hair_points(64, &mut rng) {
                assert!(point.length() < 1.5 * BALL_RADIUS);
            }
        }
    }
}
