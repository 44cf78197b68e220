//! Houses with gabled roofs, and a church.

use glam::{Vec3, vec3};

use super::model::{Brush, Frame, Hidden, Model};
use super::palette::{PAINTS, PLASTER, Palette, ROOFS};
use super::rng::Rng;

/// Metres from floor to floor.
const STOREY: f32 = 2.8;

/// A building's body: walls below a gabled roof whose ridge runs along the frame's x axis.
struct Body {
    /// Metres along the ridge.
    length: f32,
    /// Metres from eave to eave.
    width: f32,
    /// Metres from the foundation's top to the eaves.
    wall_height: f32,
    /// Height of the ridge above the eaves over half the width.
    pitch: f32,
}

impl Body {
    /// Metres of the ridge above the eaves.
    fn ridge_rise(&self) -> f32 {
        0.5 * self.width * self.pitch
    }

    /// The four walls (with both gables) and the roof: 10 and 24 triangles.
    fn build(&self, model: &mut Model, frame: &Frame, walls: Brush, roof: Brush) {
        let (x, z) = (0.5 * self.length, 0.5 * self.width);
        let (eaves, ridge) = (self.wall_height, self.wall_height + self.ridge_rise());
        let p = |x: f32, y: f32, z: f32| frame.point(vec3(x, y, z));
        model.quad(walls, [p(-x, 0.0, z), p(x, 0.0, z), p(x, eaves, z), p(-x, eaves, z)]);
        model.quad(walls, [p(x, 0.0, -z), p(-x, 0.0, -z), p(-x, eaves, -z), p(x, eaves, -z)]);
        model.quad(walls, [p(x, 0.0, z), p(x, 0.0, -z), p(x, eaves, -z), p(x, eaves, z)]);
        model.quad(walls, [p(-x, 0.0, -z), p(-x, 0.0, z), p(-x, eaves, z), p(-x, eaves, -z)]);
        model.triangle(walls, [p(x, eaves, z), p(x, eaves, -z), p(x, ridge, 0.0)]);
        model.triangle(walls, [p(-x, eaves, -z), p(-x, eaves, z), p(-x, ridge, 0.0)]);
        let slope_length = (z * z + self.ridge_rise() * self.ridge_rise()).sqrt();
        for side in [0, 2] {
            let slope = frame.side(Vec3::ZERO, side);
            // From the ridge down the slope.
            let down = (slope.z * z - slope.y * self.ridge_rise()) / slope_length;
            let slab = Frame { origin: p(0.0, ridge, 0.0), x: slope.x, y: down.cross(slope.x), z: down };
            let (low, high) = (vec3(-x - 0.35, 0.0, -0.02), vec3(x + 0.35, 0.16, slope_length + 0.45));
            model.block(roof, &slab, low, high, Hidden::Nothing);
        }
    }
}

/// A pane in a projecting frame with bars and a sill; `wall` has its z axis outwards and its origin at the wall's foot.
/// 26 triangles, 20 more with shutters.
fn window(
    model: &mut Model,
    palette: &Palette,
    wall: &Frame,
    [x, y]: [f32; 2],
    [width, height]: [f32; 2],
    glass: Brush,
    shutters: Option<Brush>,
) {
    let at = wall.moved(vec3(x, y, 0.0));
    let half = 0.5 * width;
    model.block(
        palette.trim,
        &at,
        vec3(-half - 0.1, -0.02, 0.0),
        vec3(half + 0.1, height + 0.12, 0.06),
        Hidden::Back,
    );
    let p = |x: f32, y: f32, z: f32| at.point(vec3(x, y, z));
    model.quad(
        glass,
        [p(-half, 0.06, 0.07), p(half, 0.06, 0.07), p(half, height, 0.07), p(-half, height, 0.07)],
    );
    let bar = [p(-0.03, 0.06, 0.09), p(0.03, 0.06, 0.09), p(0.03, height, 0.09), p(-0.03, height, 0.09)];
    model.quad(palette.trim, bar);
    let middle = 0.62 * height;
    model.quad(
        palette.trim,
        [
            p(-half, middle, 0.09),
            p(half, middle, 0.09),
            p(half, middle + 0.06, 0.09),
            p(-half, middle + 0.06, 0.09),
        ],
    );
    model.block(
        palette.stone,
        &at,
        vec3(-half - 0.16, -0.12, 0.0),
        vec3(half + 0.16, 0.0, 0.2),
        Hidden::Back,
    );
    if let Some(shutters) = shutters {
        for left in [-half - 0.1 - 0.5 * width, half + 0.1] {
            let high = vec3(left + 0.5 * width, height + 0.08, 0.07);
            model.block(shutters, &at, vec3(left, 0.0, 0.0), high, Hidden::Back);
        }
    }
}

/// A window as nothing but its glass, just off the wall: 2 triangles.
fn pane(model: &mut Model, wall: &Frame, [x, y]: [f32; 2], [width, height]: [f32; 2], glass: Brush) {
    let p = |dx: f32, dy: f32| wall.point(vec3(x + dx * width, y + dy * height, 0.03));
    model.quad(glass, [p(-0.5, 0.0), p(0.5, 0.0), p(0.5, 1.0), p(-0.5, 1.0)]);
}

/// Dark, warm or cool: what one sees in a window at dusk.
fn glass(palette: &Palette, rng: &mut Rng) -> Brush {
    match rng.below(20) {
        0..7 => palette.lit_glass,
        7 => palette.cool_glass,
        _ => palette.dark_glass,
    }
}

/// A house whose front faces the frame's +z; its lot is `[width, depth]` metres around the origin. 200 to 2,000
/// triangles, or 60 to 250 if it is to be plain.
pub(super) fn house(
    model: &mut Model,
    palette: &Palette,
    frame: &Frame,
    lot: [f32; 2],
    plain: bool,
    rng: &mut Rng,
) {
    let (front, depth) = (lot[0] - rng.range(0.6, 2.4), lot[1] - rng.range(0.0, 1.6));
    let storeys = 1 + u32::from(rng.chance(0.8)) + u32::from(rng.chance(0.15));
    let gable_to_street = rng.chance(0.35);
    let (length, width) = if gable_to_street { (depth, front) } else { (front, depth) };
    let wall_height = storeys as f32 * STOREY + 0.2;
    let body = Body { length, width, wall_height, pitch: rng.range(0.75, 1.15) };
    let walls = if rng.chance(0.3) { palette.bricks } else { palette.plaster.tinted(rng.pick(&PLASTER)) };
    let roof = palette.roof.tinted(rng.pick(&ROOFS));
    let paint = palette.paint.tinted(rng.pick(&PAINTS));
    let shutters = rng.chance(0.45).then_some(paint);

    // The foundation reaches into sloping ground.
    let plinth = 0.45;
    let (half_front, half_depth) = (0.5 * front + 0.06, 0.5 * depth + 0.06);
    let low = vec3(-half_front, -2.5, -half_depth);
    model.block(palette.stone, frame, low, vec3(half_front, plinth, half_depth), Hidden::Bottom);
    let base = frame.moved(vec3(0.0, plinth, 0.0));
    let ridge_frame = base.side(Vec3::ZERO, u32::from(gable_to_street));
    body.build(model, &ridge_frame, walls, roof);

    // Two chimneys at most, on the ridge's ends.
    for end in [-0.3, 0.32] {
        if rng.chance(0.6) {
            let at =
                ridge_frame.moved(vec3(end * length, wall_height + body.ridge_rise(), rng.range(-0.5, 0.5)));
            model.block(palette.bricks, &at, vec3(-0.4, -1.2, -0.4), vec3(0.4, 1.1, 0.4), Hidden::Bottom);
            model.block(palette.stone, &at, vec3(-0.48, 1.1, -0.48), vec3(0.48, 1.24, 0.48), Hidden::Nothing);
        }
    }

    for side in 0..4 {
        let (span, distance) = if side % 2 == 0 { (front, 0.5 * depth) } else { (depth, 0.5 * front) };
        let out = base.side(Vec3::ZERO, side);
        let wall = out.moved(vec3(0.0, 0.0, distance));
        let columns = ((span - 1.0) / if side % 2 == 0 { 2.5 } else { 3.6 }).max(1.0) as u32;
        let door = if side == 0 { Some(columns / 2) } else { None };
        for storey in 0..storeys {
            for column in 0..columns {
                let x = ((column as f32 + 0.5) / columns as f32 - 0.5) * (span - 0.8);
                let y = storey as f32 * STOREY + 0.85;
                if storey == 0 && door == Some(column) {
                    let at = wall.moved(vec3(x, 0.0, 0.0));
                    if plain {
                        model.block(paint, &at, vec3(-0.5, -plinth, 0.0), vec3(0.5, 2.0, 0.13), Hidden::Back);
                    } else {
                        entrance(model, palette, &at, plinth, paint, rng);
                    }
                } else if side == 0 || rng.chance(0.75) {
                    let shutters = if side % 2 == 0 { shutters } else { None };
                    let glass = glass(palette, rng);
                    if plain {
                        pane(model, &wall, [x, y], [0.95, 1.35], glass);
                    } else {
                        window(model, palette, &wall, [x, y], [0.95, 1.35], glass, shutters);
                    }
                }
            }
        }
        // The attic's window in each gable.
        if !plain && side % 2 == u32::from(!gable_to_street) {
            window(model, palette, &wall, [0.0, wall_height + 0.25], [0.7, 0.9], glass(palette, rng), None);
        }
    }
}

/// A door with a frame, two steps, a canopy, and sometimes a lit pane above.
fn entrance(model: &mut Model, palette: &Palette, at: &Frame, plinth: f32, paint: Brush, rng: &mut Rng) {
    model.block(palette.trim, at, vec3(-0.65, 0.0, 0.0), vec3(0.65, 2.45, 0.08), Hidden::Back);
    model.block(paint, at, vec3(-0.5, 0.0, 0.0), vec3(0.5, 1.98, 0.13), Hidden::Back);
    let p = |x: f32, y: f32| at.point(vec3(x, y, 0.1));
    let pane = if rng.chance(0.6) { palette.lit_glass } else { palette.dark_glass };
    model.quad(pane, [p(-0.5, 2.04), p(0.5, 2.04), p(0.5, 2.34), p(-0.5, 2.34)]);
    model.block(palette.stone, at, vec3(-0.8, -plinth - 1.5, 0.0), vec3(0.8, -0.02, 0.55), Hidden::Back);
    model.block(
        palette.stone,
        at,
        vec3(-0.9, -plinth - 1.5, 0.55),
        vec3(0.9, -0.5 * plinth, 1.0),
        Hidden::Back,
    );
    model.block(palette.wood, at, vec3(-0.95, 2.6, 0.0), vec3(0.95, 2.7, 0.9), Hidden::Back);
}

/// A church whose tower faces the frame's +z: about 700 triangles.
pub(super) fn church(model: &mut Model, palette: &Palette, frame: &Frame) {
    let walls = palette.plaster.tinted([206, 196, 172]);
    let roof = palette.roof.tinted(ROOFS[3]);
    model.block(palette.stone, frame, vec3(-6.2, -2.0, -20.2), vec3(6.2, 0.5, 3.2), Hidden::Bottom);
    let base = frame.moved(vec3(0.0, 0.5, -9.0));
    let nave = base.side(Vec3::ZERO, 1);
    Body { length: 22.0, width: 11.6, wall_height: 8.0, pitch: 1.25 }.build(model, &nave, walls, roof);
    for side in [1, 3] {
        let wall = base.side(Vec3::ZERO, side).moved(vec3(0.0, 0.0, 5.8));
        for column in 0..5 {
            let x = (column as f32 - 2.0) * 4.1;
            window(model, palette, &wall, [x, 2.2], [1.3, 4.4], palette.lit_glass, None);
            model.block(palette.stone, &wall, vec3(x + 1.7, 0.0, 0.0), vec3(x + 2.4, 6.6, 0.7), Hidden::Back);
        }
    }
    let tower = frame.moved(vec3(0.0, 0.5, 3.0));
    model.block(palette.stone, &tower, vec3(-3.3, -2.5, -3.3), vec3(3.3, 0.6, 3.3), Hidden::Bottom);
    model.block(walls, &tower, vec3(-3.0, 0.6, -3.0), vec3(3.0, 19.0, 3.0), Hidden::Bottom);
    for height in [7.0, 13.0, 18.6] {
        let (low, high) = (vec3(-3.2, height, -3.2), vec3(3.2, height + 0.4, 3.2));
        model.block(palette.stone, &tower, low, high, Hidden::Nothing);
    }
    model.lathe(
        roof,
        &tower.moved(vec3(0.0, 19.0, 0.0)),
        &[(0.0, 0.0), (4.4, 0.0), (2.0, 4.2), (0.0, 16.0)],
        8,
    );
    let top = tower.moved(vec3(0.0, 34.6, 0.0));
    model.block(palette.metal, &top, vec3(-0.09, 0.0, -0.09), vec3(0.09, 2.6, 0.09), Hidden::Nothing);
    model.block(palette.metal, &top, vec3(-0.7, 1.5, -0.08), vec3(0.7, 1.68, 0.08), Hidden::Nothing);
    for side in 0..4 {
        let wall = tower.side(Vec3::ZERO, side).moved(vec3(0.0, 0.0, 3.0));
        for x in [-1.1, 1.1] {
            window(model, palette, &wall, [x, 14.2], [1.1, 3.2], palette.dark_glass, None);
        }
        window(model, palette, &wall, [0.0, 8.2], [0.9, 2.4], palette.lit_glass, None);
        // The clock's dial and hands.
        let dial = wall.moved(vec3(0.0, 12.0, 0.06));
        let flat = Frame { origin: dial.origin, x: dial.x, y: dial.z, z: -dial.y };
        model.lathe(palette.trim, &flat, &[(0.85, -0.06), (0.85, 0.1), (0.0, 0.1)], 16);
        let hand = |width: f32, up: f32| (vec3(-width, -0.06, 0.1), vec3(width, up, 0.14));
        let (low, high) = hand(0.05, 0.68);
        model.block(palette.metal, &dial, low, high, Hidden::Back);
        let (low, high) = hand(0.07, 0.42);
        model.block(palette.metal, &dial.rolled(), low, high, Hidden::Back);
    }
    let door = tower.moved(vec3(0.0, 0.6, 3.0));
    model.block(palette.stone, &door, vec3(-1.5, -0.6, 0.0), vec3(1.5, 3.7, 0.35), Hidden::Back);
    model.block(palette.wood, &door, vec3(-1.1, -0.6, 0.0), vec3(1.1, 3.2, 0.45), Hidden::Back);
    model.block(palette.stone, &door, vec3(-2.0, -1.2, 0.3), vec3(2.0, -0.6, 1.6), Hidden::Back);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    #[test]
    fn houses_are_in_their_documented_range_of_triangles() {
        let mut scene = Scene::default();
        let palette = Palette::new(&mut scene);
        for (plain, range) in [(true, 60..250), (false, 200..2_000)] {
            for seed in 0..200 {
                let mut model = Model::default();
                let frame = Frame::at(Vec3::ZERO);
                house(&mut model, &palette, &frame, [10.0, 10.0], plain, &mut Rng::new(seed, 0));
                assert!(range.contains(&model.triangles()), "{} triangles", model.triangles());
            }
        }
    }

    #[test]
    fn the_roof_covers_the_gables() {
        let mut scene = Scene::default();
        let palette = Palette::new(&mut scene);
        let mut model = Model::default();
        let body = Body { length: 10.0, width: 8.0, wall_height: 5.0, pitch: 1.0 };
        body.build(&mut model, &Frame::at(Vec3::ZERO), palette.bricks, palette.roof.tinted(ROOFS[0]));
        assert_eq!(model.triangles(), 10 + 24);
        let meshes = model.into_scene(&mut scene, "house");
        let highest =
            |mesh: u32| scene.meshes[mesh as usize].positions.iter().fold(f32::MIN, |high, p| high.max(p.y));
        assert_eq!(highest(meshes.start), 9.0);
        assert!(highest(meshes.start + 1) > 9.0);
    }
}
