//! Reflections from maps: one view for each mirror.
//!
//! # Theory
//! \[ML\] (Applications) draws an environment map for each of hundreds of objects at once; \[MV\] names reflections from
//! omnidirectional colour maps. A map is drawn from its object's middle, but a reflected ray starts on the object's surface,
//! so that looking its direction up shows what is far away only: the ray has to be met with the surface that the map's
//! depths describe (L. Szirmay-Kalos, B. Aszódi, I. Lazányi, M. Premecz, *Approximate Ray-Tracing on the GPU with Distance
//! Impostors*, CGF 24(3), 2005).
//!
//! # Practice
//! Seen from the map's middle a ray runs along a great circle, from the direction of its start to its own. It is walked in
//! equal angles of about half a texel; where it has first come behind the map's surface the place is bisected. Distances
//! along the ray follow from the law of sines. Colours are mixed between four texels in linear light.
//!
//! [`Mirrors`] are many spheres that see each other too: `examples/reflections.rs`.
//!
//! What is hidden from the middle is in no map: a ray that passes behind something stops at it as if it had no end.
//!
//! \[ML\] Holländer et al., *ManyLoDs*, CGF 30(4), 2011. \[MV\] Kol et al., *MegaViews*, CGF 2018.

mod mirrors;

pub use mirrors::{Mirrors, Sphere};

use crate::views::ViewMaps;
use glam::Vec3;
use manyview_shaders::paraboloid::{direction as texel_place, project, texel};
use manyview_shaders::srgb;

/// Halvings of the last step.
const BISECTIONS: u32 = 6;

/// What a mirror shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reflected {
    /// Linear colour.
    pub color: Vec3,
    /// Metres from the ray's start; +infinity where it is too far to tell.
    pub distance: f32,
}

/// What a ray from `point` along the unit vector `direction` meets by a map with colours that was drawn from `center`;
/// `None` where the map shows nothing.
///
/// # Panics
/// If the map does not exist or has no colours.
pub fn reflected_color(
    maps: &ViewMaps,
    map: usize,
    center: Vec3,
    point: Vec3,
    direction: Vec3,
) -> Option<Reflected> {
    let start = point - center;
    let length = start.length();
    let sine_of = |a: Vec3, b: Vec3| a.cross(b).length();
    let from = start.normalize_or(direction);
    let cosine = from.dot(direction).clamp(-1.0, 1.0);
    let angle = sine_of(from, direction).atan2(cosine);
    // On the line through the middle the whole ray is one direction.
    if angle < 1e-3 || length == 0.0 {
        let depth = maps.distance(map, direction.to_array());
        let distance = if depth < f32::INFINITY { (depth - length).max(0.0) } else { depth };
        return color_in(maps, map, direction).map(|color| Reflected { color, distance });
    }
    let across = (direction - from * cosine).normalize_or_zero();
    // After a turn by `turn`: the direction from the middle, the ray's distance from the middle and from its start.
    let at = |turn: f32| {
        let toward = from * turn.cos() + across * turn.sin();
        let rest = (angle - turn).sin();
        let scale = if rest > 1e-6 { length / rest } else { f32::INFINITY };
        (toward, scale * angle.sin(), scale * turn.sin())
    };
    let is_behind = |turn: f32| {
        let (toward, away, _) = at(turn);
        maps.distance(map, toward.to_array()) <= away
    };
    let is_behind_at_end = maps.distance(map, direction.to_array()) < f32::INFINITY;
    // Texels are at least 2 / R radians wide.
    let steps = (angle * maps.resolution() as f32).ceil().max(1.0);
    let mut before = 0.0;
    let mut found = None;
    for step in 1..=steps as u32 {
        let turn = angle * step as f32 / steps;
        let is_last = step == steps as u32;
        if if is_last { is_behind_at_end } else { is_behind(turn) } {
            found = Some(turn);
            break;
        }
        before = turn;
    }
    let mut behind = found?;
    for _ in 0..BISECTIONS {
        let middle = (before + behind) * 0.5;
        if is_behind(middle) { behind = middle } else { before = middle }
    }
    let (toward, _, distance) = at(behind);
    color_in(maps, map, toward).map(|color| Reflected { color, distance })
}

/// The linear colour of a map in a direction, mixed between the four texels around it that are not empty.
fn color_in(maps: &ViewMaps, map: usize, direction: Vec3) -> Option<Vec3> {
    let resolution = maps.resolution();
    let first = map * manyview_shaders::paraboloid::texel_count(resolution);
    let (half, place) = project(direction.to_array(), direction.length(), resolution);
    let low = place.map(|c| (c - 0.5).floor());
    let share = [0, 1].map(|i| place[i] - 0.5 - low[i]);
    let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
    for corner in 0..4usize {
        let step = [corner & 1, corner >> 1];
        let weight: f32 = (0..2).map(|i| if step[i] == 1 { share[i] } else { 1.0 - share[i] }).product();
        // Beyond the rim the direction lies in the other half.
        let middle = [0, 1].map(|i| low[i] + step[i] as f32 + 0.5);
        let index = texel(texel_place(half, middle, resolution), 1.0, resolution) as usize;
        if maps.depth(map, index) < f32::INFINITY {
            let [r, g, b, _] = maps.colors()[first + index];
            let linear = [r, g, b].map(srgb::linear);
            sum += Vec3::from(linear) * weight;
            weights += weight;
        }
    }
    (weights > 1e-6).then(|| sum / weights)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::views::{Depths, View, ViewRenderer, ViewSettings};
    use manyview_shaders::cases::Random;
    use manyview_shaders::paraboloid::{texel_count, texel_direction};

    /// Walls at ±1 along x, ±2 along y, ±3 along z.
    const ROOM: [f32; 3] = [1.0, 2.0, 3.0];
    const WALLS: [[u8; 4]; 6] = [
        [255, 0, 0, 0],
        [0, 255, 0, 0],
        [0, 0, 255, 0],
        [255, 255, 0, 0],
        [0, 255, 255, 0],
        [255, 0, 255, 0],
    ];

    /// Distance to the wall that a ray inside meets, and which it is.
    fn wall(from: Vec3, direction: Vec3) -> (f32, usize) {
        let to = |axis: usize| (direction[axis].signum() * ROOM[axis] - from[axis]) / direction[axis];
        let axis = (0..3).min_by(|&a, &b| to(a).total_cmp(&to(b))).unwrap();
        (to(axis), 2 * axis + usize::from(direction[axis] < 0.0))
    }

    fn room(resolution: u32, center: Vec3) -> ViewMaps {
        let seen: Vec<(f32, usize)> = (0..texel_count(resolution) as u32)
            .map(|index| wall(center, texel_direction(index, resolution).into()))
            .collect();
        let depths = Depths::Full(seen.iter().map(|seen| seen.0).collect());
        let colors = seen.iter().map(|seen| WALLS[seen.1]).collect();
        ViewMaps::from_parts(resolution, vec![0], vec![0], vec![center.to_array()], depths, colors)
    }

    fn unit(random: &mut Random) -> Vec3 {
        loop {
            let v = Vec3::from([0; 3].map(|_| random.range(-1000, 1000) as f32 / 1000.0));
            if (0.1..1.0).contains(&v.length()) {
                return v.normalize_or_zero();
            }
        }
    }

    fn wall_of(color: Vec3) -> usize {
        let linear = |wall: [u8; 4]| Vec3::new(wall[0].into(), wall[1].into(), wall[2].into()) / 255.0;
        let error = |wall: usize| linear(WALLS[wall]).distance(color);
        (0..6).min_by(|&a, &b| error(a).total_cmp(&error(b))).unwrap()
    }

    /// Shares of rays from a sphere that show the right wall, with parallax and without, and the mean error of distances.
    fn agreement(maps: &ViewMaps, center: Vec3, radius: f32) -> (f64, f64, f32) {
        let mut random = Random::new(9);
        let (mut right, mut plain, mut error) = (0, 0, 0.0);
        const COUNT: u32 = 4000;
        for _ in 0..COUNT {
            let (normal, mut direction) = (unit(&mut random), unit(&mut random));
            if direction.dot(normal) < 0.0 {
                direction = -direction;
            }
            let point = center + normal * radius;
            let (distance, expected) = wall(point, direction);
            let seen = reflected_color(maps, 0, center, point, direction).expect("a room is closed");
            right += u32::from(wall_of(seen.color) == expected);
            error += (seen.distance - distance).abs() / distance;
            plain += u32::from(wall(center, direction).1 == expected);
        }
        (f64::from(right) / f64::from(COUNT), f64::from(plain) / f64::from(COUNT), error / COUNT as f32)
    }

    #[test]
    fn a_mirror_in_a_room_shows_the_wall_that_rays_meet() {
        let center = Vec3::new(0.1, -0.3, 0.5);
        let (right, plain, error) = agreement(&room(64, center), center, 0.6);
        assert!(right >= 0.97, "{right}");
        assert!(error < 0.05, "{error}");
        assert!(plain < 0.9, "without parallax it is seldom right: {plain}");
    }

    #[test]
    fn maps_from_an_octree_agree_with_rays() {
        use crate::megaviews::MegaViews;
        use manyview_shaders::scene_tree::{NodeRef, SceneTree};
        // Walls of 64 voxels a side around the inner room, whose middle is the world's.
        let svo = shell(6);
        let mut tree = SceneTree::new(&svo, true);
        let centers: Vec<(usize, Vec3)> = leaves(&tree)
            .map(|leaf: NodeRef| (tree.color_index(leaf), Vec3::from(tree.cell_center(leaf))))
            .collect();
        for (index, at) in centers {
            tree.colors[index] = WALLS[cube_wall(Vec3::ZERO, at).1];
        }
        let center = Vec3::new(0.1, -0.2, 0.15);
        let settings = ViewSettings { with_colors: true, texels: 1.0, ..ViewSettings::new(64) };
        let maps = MegaViews::new(tree.into()).render_views(&[View::around(center.to_array())], &settings);
        let maps = maps.unwrap();
        let mut random = Random::new(4);
        let mut right = 0;
        for _ in 0..2000 {
            let (normal, mut direction) = (unit(&mut random), unit(&mut random));
            if direction.dot(normal) < 0.0 {
                direction = -direction;
            }
            let point = center + normal * 0.3;
            let seen = reflected_color(&maps, 0, center, point, direction);
            right += u32::from(seen.is_some_and(|seen| wall_of(seen.color) == cube_wall(point, direction).1));
        }
        assert!(right >= 1900, "{right} of 2000");
    }

    fn cube_wall(from: Vec3, direction: Vec3) -> (f32, usize) {
        let to = |axis: usize| (direction[axis].signum() - from[axis]) / direction[axis];
        let axis = (0..3).min_by(|&a, &b| to(a).total_cmp(&to(b))).unwrap();
        (to(axis), 2 * axis + usize::from(direction[axis] < 0.0))
    }

    fn leaves(
        tree: &manyview_shaders::scene_tree::SceneTree,
    ) -> impl Iterator<Item = manyview_shaders::scene_tree::NodeRef> {
        use manyview_shaders::scene_tree::NodeRef;
        let parents = tree.level_starts[tree.depth as usize - 1]..tree.level_starts[tree.depth as usize];
        parents.flat_map(move |parent| tree.children(NodeRef(parent))).collect::<Vec<_>>().into_iter()
    }

    /// The outermost voxels of a cube from -1 to 1, `2^depth` a side.
    fn shell(depth: u32) -> manyview_shaders::svo::Svo {
        let side = 1u32 << depth;
        let cells = (0..side.pow(3)).map(|i| [i % side, i / side % side, i / side / side]);
        let outermost = cells.filter(|cell| cell.iter().any(|&c| c == 0 || c == side - 1));
        let svo = manyview_shaders::svo::Svo::of_cells([-1.0; 3], 2.0, depth, outermost);
        svo.validate().unwrap();
        svo
    }

    #[test]
    fn where_nothing_is_nothing_is_seen() {
        let depths = Depths::Full(vec![f32::INFINITY; texel_count(16)]);
        let colors = vec![[0; 4]; texel_count(16)];
        let maps = ViewMaps::from_parts(16, vec![0], vec![0], vec![[0.0; 3]], depths, colors);
        for direction in [Vec3::X, Vec3::Y, Vec3::NEG_ONE.normalize_or_zero()] {
            assert_eq!(reflected_color(&maps, 0, Vec3::ZERO, Vec3::X * 0.1, direction), None);
        }
    }
}
