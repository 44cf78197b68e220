//! Pictures of scenes whose light is known.
#![cfg(feature = "bake")]

use glam::{DMat4, DVec3, Vec3, Vec4};
use manyview::exact::ExactRays;
use manyview::preview::Camera;
use manyview::render::gbuffer::GBuffer;
use manyview::render::glow::{MOST_GLOW, glow};
use manyview::render::image::{Exposure, LitImage, Provenance, picture, render};
use manyview::render::lights::point_light;
use manyview::render::methods::{Ingredients, Method, visibility};
use manyview::render::scene::RenderScene;
use manyview::render::shade::Lighting;
use manyview_pipeline::bake::{Progress, Silent};
use manyview_pipeline::estimate::Estimate;
use manyview_pipeline::scene::{Instance, Material, Mesh, PunctualLight, Scene};
use std::f32::consts::PI;
use std::sync::atomic::{AtomicU64, Ordering};

const ALBEDO: [f32; 3] = [0.8, 0.4, 0.2];

/// A scene of quads, of one material.
fn quads(quads: &[[Vec3; 4]]) -> RenderScene {
    let mut mesh = Mesh::default();
    for quad in quads {
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(quad);
        mesh.triangles.extend([[0, 1, 2], [0, 2, 3]].map(|t| t.map(|v: u32| first + v)));
    }
    let [r, g, b] = ALBEDO;
    RenderScene::new(Scene {
        meshes: vec![mesh],
        instances: vec![Instance { mesh: 0, world_from_object: DMat4::IDENTITY }],
        materials: vec![Material { base_color: Vec4::new(r, g, b, 1.0), ..Material::default() }],
        ..Scene::default()
    })
    .unwrap()
}

/// A horizontal square around the origin.
fn floor(half: f32, y: f32) -> [Vec3; 4] {
    [[-half, -half], [half, -half], [half, half], [-half, half]].map(|[x, z]| Vec3::new(x, y, z))
}

/// The six sides of a box.
fn sides(min: Vec3, max: Vec3) -> [[Vec3; 4]; 6] {
    let corner = |c: usize| Vec3::from([0, 1, 2].map(|i| if c >> i & 1 == 1 { max[i] } else { min[i] }));
    [[0, 2, 6, 4], [1, 3, 7, 5], [0, 1, 5, 4], [2, 3, 7, 6], [0, 1, 3, 2], [4, 5, 7, 6]]
        .map(|side| side.map(corner))
}

/// Straight down from above, `metres` wide and high at the floor.
fn from_above(metres: f64) -> Camera {
    let eye = DVec3::new(0.0, 40.0, 0.0);
    let fov_degrees = 2.0 * (metres * 0.5 / eye.y).atan().to_degrees();
    Camera { eye, target: DVec3::ZERO, up: DVec3::NEG_Z, fov_degrees }
}

fn draw(
    scene: &RenderScene,
    camera: &Camera,
    size: [u32; 2],
    lights: &[PunctualLight],
) -> (GBuffer, LitImage, Vec<u32>) {
    let exact = ExactRays::new(scene.reference());
    let ingredients = Ingredients {
        scene,
        exact: &exact,
        archive: None,
        gpu: None,
        maps: manyview::views::ViewSettings::default(),
    };
    let method = visibility(Method::RayTrace, &ingredients).unwrap();
    let gbuffer = GBuffer::cast(scene, exact.reference(), camera, size, &Silent).unwrap();
    let mut bits = Vec::new();
    let mut sink = |words: &[u32]| {
        bits.extend_from_slice(words);
        Ok(())
    };
    let image = render(scene, &gbuffer, lights, &*method, Some(&mut sink), &Silent).unwrap();
    (gbuffer, image, bits)
}

#[test]
fn a_point_light_over_a_plane_gives_the_closed_form() {
    let scene = quads(&[floor(50.0, 0.0)]);
    let light = point_light(Vec3::new(1.0, 3.0, -2.0), Vec3::new(90.0, 60.0, 30.0));
    let (gbuffer, image, bits) = draw(&scene, &from_above(16.0), [32, 32], &[light]);
    let ambient = Lighting::new(&[light], &scene).ambient();
    for (pixel, radiance) in gbuffer.pixels.iter().zip(&image.radiance) {
        let [x, y, z] = pixel.position;
        assert!(y.abs() < 1e-5 && pixel.normal == [0.0, 1.0, 0.0] && (pixel.depth >= 40.0));
        let distance2 = (x - 1.0).powi(2) + 9.0 + (z + 2.0).powi(2);
        for c in 0..3 {
            let irradiance = ambient[c] + light.intensity[c] * 3.0 / distance2.powf(1.5);
            let expected = ALBEDO[c] / PI * irradiance;
            assert!((radiance[c] - expected).abs() < 1e-4 * expected, "{radiance:?} {expected}");
        }
    }
    // Row 16, column 16: its centre is a quarter metre from the middle along both axes.
    assert!((gbuffer.pixels[16 * 32 + 16].position[0] - 0.25).abs() < 1e-4);
    assert!((gbuffer.pixels[16 * 32 + 16].position[2] - 0.25).abs() < 1e-4);
    assert!(image.shadow.iter().all(|&shadow| shadow == 0.0));
    assert_eq!(bits, vec![0; 32 * 32]);
}

#[test]
fn a_box_casts_the_shadow_that_its_corners_say() {
    // A cube of two metres that floats a metre above the floor, and a light four metres above its lid.
    let cube = sides(Vec3::new(-1.0, 1.0, -1.0), Vec3::new(1.0, 3.0, 1.0));
    let scene = quads(&[&[floor(50.0, 0.0)], &cube[..]].concat());
    let lights = [
        point_light(Vec3::new(0.0, 7.0, 0.0), Vec3::splat(9.0)),
        point_light(Vec3::new(6.0, 9.0, 0.0), Vec3::ONE),
    ];
    let (gbuffer, image, bits) = draw(&scene, &from_above(16.0), [160, 160], &lights[..1]);
    // The lid's edges, at 4/7 of the light's height, throw the outline.
    let half = 7.0 / 4.0;
    let mut counts = [0; 2];
    for (i, pixel) in gbuffer.pixels.iter().enumerate() {
        let [x, y, z] = pixel.position;
        if y > 0.5 {
            // The light is above the lid.
            assert_eq!(image.shadow[i], 0.0);
            continue;
        }
        let farther = x.abs().max(z.abs());
        if (farther - half).abs() < 1e-3 {
            continue;
        }
        let expected = farther < half;
        assert_eq!(
            (image.shadow[i], bits[i]),
            (f32::from(u8::from(expected)), u32::from(expected)),
            "{x} {z}"
        );
        counts[usize::from(expected)] += 1;
    }
    assert!(counts[0] > 10_000 && counts[1] > 200, "{counts:?}");
    // With another light that reaches half of the shadow, the shadow value is a half there.
    let (gbuffer, image, bits) = draw(&scene, &from_above(16.0), [160, 160], &lights);
    let at = |x: f32, z: f32| {
        let distance = |p: &[f32; 3]| (p[0] - x).powi(2) + (p[2] - z).powi(2) + p[1].powi(2);
        let pixels = gbuffer.pixels.iter().enumerate();
        let (i, _) =
            pixels.min_by(|a, b| distance(&a.1.position).total_cmp(&distance(&b.1.position))).unwrap();
        (image.shadow[i], bits[i])
    };
    assert_eq!(at(1.5, 0.0), (0.5, 1), "only the first is hidden");
    assert_eq!(at(5.0, 5.0), (0.0, 0));
    assert_eq!(at(-1.5, 0.0), (1.0, 3), "the cube is in the way of both");
}

#[test]
fn light_comes_through_a_door_and_nowhere_else() {
    // Two rooms of 4 × 3 × 4 metres in one hull; between them, at x = 0, a wall with a door of one metre (z from -0.5)
    // up to 2 metres. No lid, so that the camera sees in; the light hangs below the edge.
    let wall = |z0: f32, z1: f32, y0: f32, y1: f32| {
        [[y0, z0], [y0, z1], [y1, z1], [y1, z0]].map(|[y, z]| Vec3::new(0.0, y, z))
    };
    let mut all = sides(Vec3::new(-4.0, 0.0, -2.0), Vec3::new(4.0, 3.0, 2.0)).to_vec();
    all.remove(3);
    all.extend([wall(-2.0, -0.5, 0.0, 3.0), wall(0.5, 2.0, 0.0, 3.0), wall(-0.5, 0.5, 2.0, 3.0)]);
    let scene = quads(&all);
    let light = Vec3::new(-2.0, 1.0, 0.0);
    let (gbuffer, image, _) =
        draw(&scene, &from_above(9.0), [180, 90], &[point_light(light, Vec3::splat(9.0))]);
    let mut counts = [0; 2];
    for (i, pixel) in gbuffer.pixels.iter().enumerate() {
        let [x, y, z] = pixel.position;
        // The floor of the dark room.
        if !(y.abs() < 1e-4 && x > 0.01 && x < 3.99 && z.abs() < 1.99) {
            continue;
        }
        // Where the way from the light crosses the wall.
        let crossing = light + (Vec3::new(x, y, z) - light) * (2.0 / (x + 2.0));
        if (crossing.z.abs() - 0.5).abs() < 1e-3 {
            continue;
        }
        let expected = crossing.z.abs() > 0.5;
        assert_eq!(image.shadow[i], f32::from(u8::from(expected)), "{x} {z}");
        counts[usize::from(expected)] += 1;
    }
    assert!(counts.iter().all(|&count| count > 500), "{counts:?}");
}

#[test]
fn nothing_leaks_into_a_closed_room() {
    let scene = quads(&sides(Vec3::new(-2.0, -1.0, -3.0), Vec3::new(2.0, 1.5, 3.0)));
    let camera = Camera {
        eye: DVec3::new(1.2, 0.3, 2.0),
        target: DVec3::new(-1.0, -0.4, -1.0),
        up: DVec3::Y,
        fov_degrees: 100.0,
    };
    // Outside, a little outside each wall, and two within the wall itself and far away.
    let mut lights: Vec<PunctualLight> = [
        [2.001, 0.0, 0.0],
        [-2.5, 1.0, 1.0],
        [0.0, 1.51, 0.0],
        [0.0, -90.0, 3.0],
        [1.0, 1.0, 3.001],
        [1e6, 1e6, 1e6],
    ]
    .map(|p| point_light(p.into(), Vec3::splat(1e4)))
    .to_vec();
    let (gbuffer, image, bits) = draw(&scene, &camera, [96, 64], &lights);
    let mut behind = 0;
    for (pixel, &bits) in gbuffer.pixels.iter().zip(&bits) {
        for (l, light) in lights.iter().enumerate() {
            // A wall is no obstacle between its own outer side and a light before that.
            let to_light = light.position - Vec3::from(pixel.position);
            match to_light.dot(Vec3::from(pixel.geometric_normal)) > 0.0 {
                true => assert_eq!(bits >> l & 1, 1, "light {l} at {:?}", pixel.position),
                false => behind += 1,
            }
        }
    }
    assert!(behind * 3 < bits.len() * lights.len(), "{behind} of all pairs are behind a wall");
    assert!(image.direct.iter().all(|&direct| direct == 0.0));
    // A light inside reaches everything.
    lights.push(point_light(Vec3::ZERO, Vec3::ONE));
    let (_, image, bits) = draw(&scene, &camera, [96, 64], &lights);
    assert!(bits.iter().all(|bits| bits >> 6 == 0));
    assert!(image.direct.iter().all(|&direct| direct > 0.0));
}

#[test]
fn without_lights_there_is_ambient_light_alone() {
    let scene = quads(&[floor(5.0, 0.0)]);
    // Wide enough to see past the floor.
    let (gbuffer, image, bits) = draw(&scene, &from_above(20.0), [20, 20], &[]);
    assert!(bits.is_empty());
    for (pixel, radiance) in gbuffer.pixels.iter().zip(&image.radiance) {
        let expected = if pixel.is_surface() { ALBEDO.map(|c| c / PI * 0.03) } else { [0.0; 3] };
        assert!((0..3).all(|c| (radiance[c] - expected[c]).abs() < 1e-6), "{radiance:?}");
    }
    assert_eq!(gbuffer.surface_count(), 100);
    assert!(image.stops(Exposure::Auto).is_finite());
    let provenance = Provenance { visibility: "raytrace", lights: 0, exposure_stops: 0.0 };
    assert_eq!(picture(&gbuffer, image, &[], &provenance).display[0], [0, 0, 0]);
}

#[test]
fn lights_are_drawn_where_nothing_hides_them() {
    let scene = quads(&[floor(5.0, 0.0)]);
    let lights = [[2.0, 1.0, 0.0], [-2.0, -1.0, 0.0], [0.0, 90.0, 0.0]]
        .map(|p| point_light(p.into(), Vec3::new(2.0, 1.0, 0.0)));
    let camera = from_above(10.0);
    let (gbuffer, image, _) = draw(&scene, &camera, [100, 100], &lights);
    let glow = glow(&gbuffer, &camera, &lights, scene.radius()).unwrap();
    // The first is a metre nearer to the eye than the floor.
    let column = (50.0 + 20.0 * 40.0 / 39.0) as usize;
    assert_eq!(glow[50 * 100 + column], [1.0, 0.5, 0.0]);
    let drawn: Vec<usize> = (0..glow.len()).filter(|&i| glow[i] != [0.0; 3]).collect();
    assert!(drawn.iter().all(|i| (i % 100).abs_diff(column) < 5 && (i / 100).abs_diff(50) < 5), "{drawn:?}");
    let provenance = Provenance { visibility: "raytrace", lights: 3, exposure_stops: -20.0 };
    let picture = picture(&gbuffer, image, &glow, &provenance);
    assert_eq!(picture.display[50 * 100 + column], [255, 188, 0]);
    assert!(picture.color[50 * 100 + column][0] < 2.0, "no glow in the radiance");
}

#[test]
fn thousands_of_drawn_lights_leave_the_picture_to_be_seen() {
    let scene = quads(&[floor(5.0, 0.0)]);
    let camera = from_above(10.0);
    let lights = |side: i32| -> Vec<_> {
        let at = |i: i32| (f64::from(i) / f64::from(side) - 0.5) as f32 * 6.0;
        let place = |i: i32| Vec3::new(at(i % side), 1.0, at(i / side));
        (0..side * side).map(|i| point_light(place(i), Vec3::new(2.0, 1.0, 0.0))).collect()
    };
    let (gbuffer, _, _) = draw(&scene, &camera, [100, 100], &[]);
    let mean = |count: i32| {
        let glow = glow(&gbuffer, &camera, &lights(count), scene.radius()).unwrap();
        assert!(glow.iter().flatten().all(|c| (0.0..=1.0).contains(c)));
        glow.iter().map(|light| f64::from(light[0])).sum::<f64>() / 1e4
    };
    // Few are as they were: 1.7 π radius² each.
    let (one, four) = (mean(1), mean(2));
    assert!(one > 1e-4 && (four / one - 4.0).abs() < 0.8, "{one} {four}");
    for side in [10, 30, 100] {
        let mean = mean(side);
        assert!(mean > MOST_GLOW * 0.3 && mean < MOST_GLOW * 1.001, "{side}²: {mean}");
    }
}

/// Cancels after some progress.
struct Impatient(AtomicU64);

impl Progress for Impatient {
    fn begin(&self, _: &'static str, _: u64, _: &'static str) {}
    fn advance(&self, units: u64) {
        _ = self.0.fetch_add(units, Ordering::Relaxed);
    }
    fn estimate(&self, _: &Estimate) {}
    fn cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed) > 0
    }
}

#[test]
fn a_picture_is_given_up_between_bands() {
    let scene = quads(&[floor(5.0, 0.0)]);
    let exact = ExactRays::new(scene.reference());
    let gbuffer = GBuffer::cast(&scene, exact.reference(), &from_above(9.0), [64, 64], &Silent).unwrap();
    // More pairs than fit the first band.
    let lights = vec![point_light(Vec3::Y, Vec3::ONE); 600];
    let result = render(&scene, &gbuffer, &lights, &exact, None, &Impatient(AtomicU64::new(0)));
    assert_eq!(result.unwrap_err().to_string(), "cancelled");
}

#[test]
fn bits_come_in_the_order_of_pixels_whatever_the_tiles() {
    // Lights in a row under a roof over half the floor; more pixels than one tile is wide, more lights than a word holds.
    let roof = floor(5.0, 2.0).map(|p| if p.x > 0.0 { Vec3::new(0.0, p.y, p.z) } else { p });
    let scene = quads(&[floor(5.0, 0.0), roof]);
    let lights: Vec<PunctualLight> =
        (0..40).map(|i| point_light(Vec3::new(i as f32 * 0.2 - 4.0, 3.0, 0.0), Vec3::ONE)).collect();
    let (gbuffer, image, bits) = draw(&scene, &from_above(12.0), [70, 30], &lights);
    let exact = ExactRays::new(scene.reference());
    for (i, pixel) in gbuffer.pixels.iter().enumerate() {
        let words = &bits[2 * i..2 * i + 2];
        if !pixel.is_surface() {
            assert_eq!(words, [0, 0]);
            continue;
        }
        let origin = Vec3::from(pixel.position).as_dvec3() + DVec3::Y * 1e-4;
        let mut hidden = 0;
        for (l, light) in lights.iter().enumerate() {
            let expected = exact.reference().is_occluded(origin, light.position.as_dvec3());
            assert_eq!(words[l / 32] >> (l % 32) & 1, u32::from(expected), "pixel {i} light {l}");
            hidden += u32::from(expected);
        }
        assert_eq!(image.shadow[i], hidden as f32 / 40.0);
    }
    assert!(image.shadow.iter().any(|&s| s > 0.2 && s < 0.8));
}
