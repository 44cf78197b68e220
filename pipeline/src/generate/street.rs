//! Lamps, benches, a fountain: small things that stand about.

use glam::{Vec3, vec3};

use super::model::{Frame, Hidden, Model};
use super::palette::Palette;
use crate::scene::{LightKind, PunctualLight, Scene};

/// A street lamp 4.6 m high with an arm along +z: 116 triangles. Its light is at [`LAMP_LIGHT`].
pub(super) fn lamp(palette: &Palette) -> Model {
    let mut model = Model::default();
    let frame = Frame::at(Vec3::ZERO);
    model.lathe(palette.stone, &frame, &[(0.22, -0.6), (0.22, 0.25), (0.12, 0.4)], 6);
    let bend = [vec3(0.0, 0.3, 0.0), vec3(0.0, 3.9, 0.0), vec3(0.0, 4.5, 0.3), vec3(0.0, 4.6, 0.9)];
    model.tube(palette.metal, &bend, &[0.08, 0.06, 0.05, 0.04], 6);
    let head = frame.moved(vec3(0.0, 4.45, 1.05));
    model.lathe(palette.metal, &head, &[(0.0, 0.0), (0.42, 0.0), (0.12, 0.22), (0.0, 0.24)], 8);
    model.lathe(palette.lamp, &head, &[(0.0, -0.16), (0.2, -0.08), (0.26, 0.0)], 8);
    model
}

/// Where the lamp's light is in the lamp's space: just below the head, so that the head does not shadow it.
pub(super) const LAMP_LIGHT: Vec3 = vec3(0.0, 4.2, 1.05);

/// Adds the light of a lamp that stands in `frame`.
pub(super) fn light_lamp(scene: &mut Scene, frame: &Frame) {
    scene.lights.push(PunctualLight {
        position: frame.point(LAMP_LIGHT),
        direction: Vec3::NEG_Y,
        intensity: vec3(256.0, 176.0, 88.0),
        range: f32::INFINITY,
        kind: LightKind::Point,
    });
}

/// A bench that looks along +z: 86 triangles.
pub(super) fn bench(palette: &Palette) -> Model {
    let mut model = Model::default();
    let frame = Frame::at(Vec3::ZERO);
    for x in [-0.75, 0.69] {
        model.block(palette.metal, &frame, vec3(x, -0.1, -0.22), vec3(x + 0.06, 0.42, 0.24), Hidden::Bottom);
        model.block(palette.metal, &frame, vec3(x, 0.42, -0.26), vec3(x + 0.06, 0.86, -0.2), Hidden::Nothing);
    }
    for z in [-0.2, -0.03, 0.14] {
        let (low, high) = (vec3(-0.9, 0.42, z), vec3(0.9, 0.46, z + 0.13));
        model.block(palette.wood, &frame, low, high, Hidden::Bottom);
    }
    model.block(palette.wood, &frame, vec3(-0.9, 0.62, -0.2), vec3(0.9, 0.84, -0.16), Hidden::Nothing);
    model
}

/// A round fountain 7 m across with two bowls.
pub(super) fn fountain(palette: &Palette) -> Model {
    let mut model = Model::default();
    let frame = Frame::at(Vec3::ZERO);
    let steps =
        [(4.2, -0.5), (4.2, 0.15), (3.6, 0.15), (3.6, 0.75), (3.3, 0.8), (3.2, 0.75), (3.2, 0.2), (0.0, 0.2)];
    model.lathe(palette.stone, &frame, &steps, 24);
    model.lathe(palette.water, &frame, &[(3.21, 0.6), (0.0, 0.6)], 24);
    let column = [(0.7, 0.2), (0.45, 0.5), (0.3, 0.9), (0.28, 1.7), (0.5, 1.95)];
    model.lathe(palette.stone, &frame, &column, 12);
    let bowl = [(0.5, 1.9), (1.4, 2.2), (1.55, 2.4), (1.4, 2.4), (0.0, 2.25)];
    model.lathe(palette.stone, &frame, &bowl, 20);
    model.lathe(palette.water, &frame, &[(1.42, 2.36), (0.0, 2.36)], 20);
    model.lathe(palette.stone, &frame, &[(0.25, 2.2), (0.14, 2.6), (0.16, 3.2), (0.3, 3.3)], 10);
    model.lathe(palette.stone, &frame, &[(0.3, 3.25), (0.7, 3.45), (0.75, 3.55), (0.0, 3.5)], 16);
    model.ellipsoid(palette.stone, &frame.moved(vec3(0.0, 3.75, 0.0)), Vec3::splat(0.28), 10, 6);
    // Eight jets that fall from the upper bowl.
    for jet in 0..8 {
        let (sin, cos) = manyview_shaders::trig::sin_cos_turns(jet, 8);
        let at = |radius: f32, height: f32| vec3(sin as f32 * radius, height, cos as f32 * radius);
        let points = [at(0.7, 3.56), at(1.0, 3.7), at(1.3, 3.3), at(1.6, 2.3), at(1.9, 0.6)];
        model.tube(palette.water, &points, &[0.03, 0.035, 0.04, 0.05, 0.07], 4);
    }
    model
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_those_of_the_descriptions() {
        let mut scene = Scene::default();
        let palette = Palette::new(&mut scene);
        assert_eq!(lamp(&palette).triangles(), 24 + 36 + 32 + 24);
        assert_eq!(bench(&palette).triangles(), 2 * (10 + 12) + 3 * 10 + 12);
    }

    #[test]
    fn the_lamps_light_is_in_free_air() {
        let mut scene = Scene::default();
        let palette = Palette::new(&mut scene);
        let meshes = lamp(&palette).into_scene(&mut scene, "lamp");
        let nearest = meshes
            .flat_map(|mesh| scene.meshes[mesh as usize].positions.clone())
            .fold(f32::MAX, |nearest, p| nearest.min((p - LAMP_LIGHT).length()));
        assert!(nearest > 0.08, "{nearest} m");
    }
}
