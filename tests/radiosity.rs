//! Light that is known, from virtual lights.
#![cfg(feature = "bake")]

use glam::{DMat4, DVec3, Vec3, Vec4};
use manyview::exact::ExactRays;
use manyview::preview::Camera;
use manyview::radiosity::{FilterOptions, VIEW_LIFT_VOXELS};
use manyview::radiosity::{
    Gather, GatherOptions, Gathered, LightTree, Primaries, Samples, VirtualLight, VplOptions, filter, trace,
};
use manyview::render::gbuffer::GBuffer;
use manyview::render::lights::point_light;
use manyview::render::scene::RenderScene;
use manyview::views::{Depths, PassSink, View, ViewError, ViewMaps, ViewRenderer, ViewSettings};
use manyview::visibility::{Bias, NoShadows, Segment, Visibility};
use manyview_pipeline::bake::Silent;
use manyview_pipeline::scene::{Instance, Material, Mesh, Scene};
use manyview_shaders::paraboloid::{texel_count, texel_direction};
use std::f32::consts::PI;

/// Maps by exact rays, in passes of so many views.
struct Rays<'a> {
    exact: &'a ExactRays<'a>,
    at_once: usize,
}

impl ViewRenderer for Rays<'_> {
    fn name(&self) -> &'static str {
        "rays"
    }

    fn render_passes(
        &self,
        views: &[View],
        settings: &ViewSettings,
        sink: &mut PassSink<'_>,
    ) -> Result<(), ViewError> {
        let indices: Vec<u32> = (0..views.len() as u32).rev().collect();
        for run in indices.chunks(self.at_once) {
            let of = |&view: &u32| {
                let origin = views[view as usize].position;
                (0..texel_count(settings.resolution) as u32).map(move |texel| {
                    let d = texel_direction(texel, settings.resolution);
                    Segment { origin, target: [0, 1, 2].map(|i| origin[i] + d[i] * 1e3), normal: [0.0; 3] }
                })
            };
            let segments: Vec<Segment> = run.iter().flat_map(of).collect();
            let mut depths = vec![0.0; segments.len()];
            self.exact.distances(&segments, &mut depths).unwrap();
            let centers = run.iter().map(|&view| views[view as usize].position).collect();
            let maps = (0..run.len() as u32).collect();
            let depths = Depths::Full(depths);
            sink(ViewMaps::from_parts(settings.resolution, run.to_vec(), maps, centers, depths, Vec::new()))?;
        }
        Ok(())
    }
}

fn scene(triangles: Vec<[Vec3; 3]>, albedo: f32) -> RenderScene {
    let count = triangles.len() as u32;
    let mesh = Mesh {
        positions: triangles.into_iter().flatten().collect(),
        triangles: (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        ..Mesh::default()
    };
    let base_color = Vec4::new(albedo, albedo, albedo, 1.0);
    RenderScene::new(Scene {
        meshes: vec![mesh],
        instances: vec![Instance { mesh: 0, world_from_object: DMat4::IDENTITY }],
        materials: vec![Material { base_color, ..Material::default() }],
        ..Scene::default()
    })
    .unwrap()
}

/// A horizontal square of `half` metres to each side at `y`, moved along x.
fn square(half: f32, y: f32, x: f32) -> Vec<[Vec3; 3]> {
    let [a, b, c, d] = [[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]]
        .map(|[u, v]| Vec3::new(x + u * half, y, v * half));
    vec![[a, b, c], [a, c, d]]
}

/// A sphere of radius 1, its triangles cut in four so many times.
fn sphere(cuts: u32) -> Vec<[Vec3; 3]> {
    let mut triangles = Vec::new();
    for [x, y, z] in
        [[1, 1, 1], [1, 1, -1], [1, -1, 1], [1, -1, -1], [-1, 1, 1], [-1, 1, -1], [-1, -1, 1], [-1, -1, -1]]
            .map(|side| side.map(|c: i32| c as f32))
    {
        triangles.push([Vec3::X * x, Vec3::Y * y, Vec3::Z * z]);
    }
    for _ in 0..cuts {
        triangles = triangles
            .into_iter()
            .flat_map(|[a, b, c]| {
                let [ab, bc, ca] = [a + b, b + c, c + a].map(Vec3::normalize_or_zero);
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    triangles
}

const SIZE: [u32; 2] = [24, 16];

fn seen(scene: &RenderScene, exact: &ExactRays<'_>, camera: &Camera) -> (GBuffer, f64) {
    let gbuffer = GBuffer::cast(scene, exact.reference(), camera, SIZE, &Silent).unwrap();
    (gbuffer, camera.ray_maker(SIZE[0], SIZE[1]).unwrap().pixel_spread())
}

fn from_above() -> Camera {
    Camera { eye: DVec3::Y * 10.0, target: DVec3::ZERO, up: DVec3::NEG_Z, fov_degrees: 20.0 }
}

fn all() -> GatherOptions {
    GatherOptions { samples: Samples::All, ..GatherOptions::default() }
}

#[test]
fn a_light_over_a_plane_gives_what_it_should_in_every_pixel() {
    let scene = scene(square(20.0, 0.0, 0.0), 0.5);
    let exact = ExactRays::new(scene.reference());
    let (gbuffer, spread) = seen(&scene, &exact, &from_above());
    let down =
        VirtualLight { position: [0.3, 2.0, -0.1], normal: [0.0, -1.0, 0.0], intensity: [3.0, 2.0, 1.0] };
    let around = VirtualLight { normal: [0.0; 3], ..down };
    let up = VirtualLight { normal: [0.0, 1.0, 0.0], ..down };
    let below = VirtualLight { position: [0.0, -1.0, 0.0], ..around };
    for (light, power) in [(down, Some(4)), (around, Some(3)), (up, None), (below, None)] {
        for (clamp_metres, cutoff_metres) in [(0.0, f32::INFINITY), (2.1, f32::INFINITY), (0.0, 2.2)] {
            let tree = LightTree::new(&[light]);
            let options = GatherOptions { clamp_metres, cutoff_metres, ..GatherOptions::default() };
            let gather = Gather::new(&gbuffer, &tree, spread, options);
            let by_segments = gather.by_segments(&exact, 0.0, &Silent).unwrap();
            let settings = ViewSettings::new(64);
            let maps = Rays { exact: &exact, at_once: 9 };
            let by_maps = gather.by_maps(&maps, &settings, &Bias::new(0.01), &Silent).unwrap();
            assert_eq!(by_maps.passes, 1);
            for (i, pixel) in gbuffer.pixels.iter().enumerate() {
                let distance = Vec3::from(pixel.position).distance(light.position.into());
                // Both cosines are 2 / distance.
                let expected = match power {
                    Some(power) if distance <= cutoff_metres => {
                        let cosines = (2.0 / distance).powi(power - 2);
                        cosines / distance.max(clamp_metres).powi(2)
                    }
                    _ => 0.0,
                };
                for found in [&by_segments, &by_maps, &gather.unshadowed()] {
                    let [r, g, b] = found.irradiance[i];
                    assert!((r / 3.0 - expected).abs() < 1e-5 && (g / 2.0 - expected).abs() < 1e-5);
                    assert!((b - expected).abs() < 1e-5, "{i} {light:?}: {b} {expected}");
                    assert_eq!(found.tests[i], [u32::from(expected > 0.0), 0]);
                }
            }
        }
    }
}

#[test]
fn a_board_hides_a_light_from_what_is_behind_it() {
    // Over the left half, half way to the light.
    let board = square(5.0, 1.0, -5.0);
    let scene = scene([square(20.0, 0.0, 0.0), board].concat(), 0.5);
    let exact = ExactRays::new(scene.reference());
    // Between floor and board, from the side.
    let camera =
        Camera { eye: DVec3::new(0.0, 0.9, 7.0), target: DVec3::ZERO, up: DVec3::Y, fov_degrees: 40.0 };
    let (gbuffer, spread) = seen(&scene, &exact, &camera);
    let light = VirtualLight { position: [0.0, 2.0, 0.0], normal: [0.0, -1.0, 0.0], intensity: [1.0; 3] };
    let tree = LightTree::new(&[light; 3]);
    let gather = Gather::new(&gbuffer, &tree, spread, all());
    let maps = Rays { exact: &exact, at_once: 2 };
    let by_maps = gather.by_maps(&maps, &ViewSettings::new(256), &Bias::new(0.01), &Silent).unwrap();
    assert_eq!(by_maps.passes, 2);
    let by_segments = gather.by_segments(&exact, 0.0, &Silent).unwrap();
    let mut counts = [0; 2];
    for (i, pixel) in gbuffer.pixels.iter().enumerate() {
        let [x, y, _] = pixel.position;
        if y > 0.01 || x.abs() < 0.1 || !pixel.is_surface() || pixel.depth > 15.0 {
            continue;
        }
        let hidden = x < 0.0;
        counts[usize::from(hidden)] += 1;
        for found in [&by_maps, &by_segments] {
            assert_eq!(found.tests[i], [3, if hidden { 3 } else { 0 }], "{:?}", pixel.position);
            assert_eq!(found.irradiance[i] == [0.0; 3], hidden);
        }
    }
    assert!(counts[0] > 30 && counts[1] > 30, "{counts:?}");
}

/// Inside a sphere of radius r all surfaces give all others the same: after the first bounce of a light in the middle every
/// spot has albedo · intensity / r².
#[test]
fn a_sphere_s_first_bounce_is_even() {
    let scene = scene(sphere(4), 0.6);
    let exact = ExactRays::new(scene.reference());
    let camera = Camera { eye: DVec3::Z * 0.5, target: DVec3::ZERO, up: DVec3::Y, fov_degrees: 70.0 };
    let (gbuffer, spread) = seen(&scene, &exact, &camera);
    let light = point_light(Vec3::ZERO, Vec3::splat(2.0));
    let primaries = Primaries::new(&scene, exact.reference(), &[light]);
    let traced = |count, bounces| {
        let options = VplOptions { count, bounces, seed: 3, indirect_only: false };
        trace(&scene, &exact, &primaries, &options).lights
    };
    let mean =
        |found: &Gathered| found.irradiance.iter().map(|c| c[0]).sum::<f32>() / found.irradiance.len() as f32;
    // albedo, then albedo + albedo² + …
    for (bounces, expected) in [(1, 0.6 * 2.0), (3, (0.6 + 0.36 + 0.216) * 2.0)] {
        let lights = traced(3000, bounces);
        let flux: f32 = lights.iter().map(|light| light.flux().x).sum();
        assert!((flux / (4.0 * PI * expected) - 1.0).abs() < 1e-3);
        let tree = LightTree::new(&lights);
        let every = Gather::new(&gbuffer, &tree, spread, all()).by_segments(&exact, 0.0, &Silent).unwrap();
        assert!((mean(&every) / expected - 1.0).abs() < 0.02, "{} {expected}", mean(&every));
        // A choice gives the same on average: without bias, and with less noise once filtered.
        for by_importance in [false, true] {
            let samples = Samples::Count(32);
            let options = GatherOptions { samples, by_importance, ..GatherOptions::default() };
            let gather = Gather::new(&gbuffer, &tree, spread, options);
            let some = gather.by_segments(&exact, 0.0, &Silent).unwrap();
            assert!((mean(&some) / mean(&every) - 1.0).abs() < 0.02, "{}", mean(&some));
            let noise = |irradiance: &[[f32; 3]]| {
                let square = |(a, b): (&[f32; 3], &[f32; 3])| (a[0] - b[0]).powi(2);
                irradiance.iter().zip(&every.irradiance).map(square).sum::<f32>()
            };
            let smooth = filter(&gbuffer, &some.irradiance, &FilterOptions { radius: 4, spread });
            assert!(noise(&smooth) < 0.3 * noise(&some.irradiance));
        }
    }
}

#[test]
fn a_choice_does_not_depend_on_passes_or_threads() {
    let scene = scene(sphere(3), 0.6);
    let exact = ExactRays::new(scene.reference());
    let camera = Camera { eye: DVec3::Z * 0.5, target: DVec3::ZERO, up: DVec3::Y, fov_degrees: 70.0 };
    let (gbuffer, spread) = seen(&scene, &exact, &camera);
    let primaries =
        Primaries::new(&scene, exact.reference(), &[point_light(Vec3::splat(0.2), Vec3::splat(2.0))]);
    let options = VplOptions { count: 200, bounces: 2, seed: 3, indirect_only: false };
    let tree = LightTree::new(&trace(&scene, &exact, &primaries, &options).lights);
    let options = GatherOptions { samples: Samples::Count(16), ..GatherOptions::default() };
    let gather = Gather::new(&gbuffer, &tree, spread, options);
    let in_passes = |at_once| {
        let maps = Rays { exact: &exact, at_once };
        gather.by_maps(&maps, &ViewSettings::new(16), &Bias::new(0.01), &Silent).unwrap()
    };
    let (one, many) = (in_passes(1000), in_passes(7));
    assert_eq!((one.passes, many.passes, &one.tests), (1, 29, &many.tests));
    for (a, b) in one.irradiance.iter().zip(&many.irradiance) {
        assert!((0..3).all(|i| (a[i] - b[i]).abs() <= 1e-5 * a[i].abs()), "{a:?} {b:?}");
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(pool.install(|| in_passes(7)).irradiance, many.irradiance);
    // In a convex room nothing is hidden, whatever the maps say of their own surface.
    let hidden: u32 = one.tests.iter().map(|tests| tests[1]).sum();
    let tested: u32 = one.tests.iter().map(|tests| tests[0]).sum();
    assert!(hidden * 50 < tested, "{hidden} of {tested}");
    assert_eq!(gather.unshadowed().tests, gather.by_segments(&NoShadows, 0.0, &Silent).unwrap().tests);
    const { assert!(VIEW_LIFT_VOXELS > 1.0) };
}

#[test]
fn nothing_to_see_and_no_lights() {
    let scene = scene(square(1.0, 0.0, 0.0), 0.5);
    let exact = ExactRays::new(scene.reference());
    let away = Camera { target: DVec3::Y * 20.0, up: DVec3::X, ..from_above() };
    let light = VirtualLight { position: [0.0, 2.0, 0.0], normal: [0.0; 3], intensity: [1.0; 3] };
    let maps = Rays { exact: &exact, at_once: 9 };
    for (camera, lights) in [(away, vec![light]), (from_above(), vec![]), (away, vec![])] {
        let (gbuffer, spread) = seen(&scene, &exact, &camera);
        let tree = LightTree::new(&lights);
        for options in [GatherOptions::default(), all()] {
            let gather = Gather::new(&gbuffer, &tree, spread, options);
            let by_maps = gather.by_maps(&maps, &ViewSettings::new(16), &Bias::new(0.01), &Silent).unwrap();
            for found in [by_maps, gather.by_segments(&exact, 0.0, &Silent).unwrap(), gather.unshadowed()] {
                assert!(found.irradiance.iter().all(|c| *c == [0.0; 3]));
                let smooth = filter(&gbuffer, &found.irradiance, &FilterOptions { radius: 3, spread });
                assert_eq!(smooth, found.irradiance);
            }
        }
    }
}
