//! Segment tests on the GPU, by the stages' twins and by the CPU's kernels: the same answers, bit for bit.
//!
//! Without an adapter every test is reported as ignored, or as failed if `MANYVIEW_REQUIRE_GPU` is 1.
//! `MANYVIEW_ADAPTER` chooses among adapters.

mod support;

use libtest_mimic::Failed;
use manyview::gpu::{GpuContext, GpuScene, StreamOptions};
use manyview::rays::{RowTester, Rows, TestSettings, on_gpu, on_twins};
use manyview::visibility::{LightPoint, Receiver, Segment, Visibility, light_words};
use manyview::{Archive, CpuScene};
use support::gpu::Check;
use support::{Numbers, bake_rows};

fn main() {
    let checks: [(&str, Check); 3] = [
        ("segments_are_answered_alike", segments_are_answered_alike),
        ("lights_are_hidden_alike", lights_are_hidden_alike),
        ("a_scene_that_still_arrives_answers_by_its_nearest_directions", a_scene_still_arriving),
    ];
    support::gpu::run(checks)
}

fn ensure(holds: bool, what: impl FnOnce() -> String) -> Result<(), Failed> {
    if holds { Ok(()) } else { Err(what().into()) }
}

const SETTINGS: [TestSettings; 4] = [
    TestSettings::NO_BIAS,
    TestSettings::FAST,
    TestSettings { rows: Rows::Split, ..TestSettings::FAST },
    TestSettings::EXACT,
];

/// A point in and around the scene.
fn point(scene: &CpuScene, numbers: &mut Numbers, reach: f64) -> [f32; 3] {
    let lattice = scene.row_lattice();
    [0, 1, 2].map(|i| {
        let away = (numbers.unit() * 2.0 - 1.0) * reach;
        (lattice.center[i] + away * lattice.half_extent[i]) as f32
    })
}

fn normal(numbers: &mut Numbers) -> [f32; 3] {
    let v = [(); 3].map(|()| numbers.unit() * 2.0 - 1.0);
    let length = v.iter().map(|c| c * c).sum::<f64>().sqrt();
    v.map(|c| (c / length) as f32)
}

/// Segments within the scene, out of it, from far away, along axes, and what is none.
fn segments(scene: &CpuScene, count: usize) -> Vec<Segment> {
    let mut numbers = Numbers(77);
    let mut segments: Vec<Segment> = (0..count)
        .map(|i| {
            let reach = [0.9, 0.9, 1.2, 3.0, 40.0, 1e6][i % 6];
            let origin = point(scene, &mut numbers, if i % 5 == 4 { reach } else { 0.9 });
            let mut target = point(scene, &mut numbers, reach);
            if i % 7 == 0 {
                target[i % 3] = origin[i % 3];
                target[(i + 1) % 3] = origin[(i + 1) % 3];
            }
            let normal = if i % 3 == 0 { [0.0; 3] } else { normal(&mut numbers) };
            Segment { origin, target, normal }
        })
        .collect();
    for (i, bad) in [f32::NAN, f32::INFINITY, -f32::INFINITY, f32::MAX, 1e25].into_iter().enumerate() {
        segments[i].origin[i % 3] = bad;
        segments[5 + i].target[i % 3] = bad;
        segments[10 + i].normal[i % 3] = bad;
    }
    segments[15].target = segments[15].origin;
    segments
}

fn load(bits: u32) -> Result<(Archive, CpuScene), Failed> {
    let archive = Archive::from_bytes(bake_rows(bits, 5, 1 << 22))?;
    let scene = CpuScene::load(&archive)?;
    Ok((archive, scene))
}

fn segments_are_answered_alike(context: &GpuContext) -> Result<(), Failed> {
    for bits in 5..=8 {
        let (archive, scene) = load(bits)?;
        let options = StreamOptions::new(2 << 30);
        let on_device = GpuScene::stream(context.device(), context.queue(), &archive, options)?;
        on_device.finish()?;
        let segments = segments(&scene, 6000);
        for settings in SETTINGS {
            let ask = |method: &dyn Visibility| -> Result<_, Failed> {
                let (mut occluded, mut distances) = (vec![9; segments.len()], vec![-1.0; segments.len()]);
                method.occluded(&segments, &mut occluded)?;
                method.distances(&segments, &mut distances)?;
                Ok((occluded, distances))
            };
            let (occluded, distances) = ask(&RowTester::of(&scene).with_settings(settings))?;
            let hits = occluded.iter().filter(|hit| **hit == 1).count();
            ensure(hits > 60 && hits < segments.len() - 60, || format!("{bits} bits: {hits} hits"))?;
            let methods: [(&str, &dyn Visibility); 2] =
                [("twins", &on_twins(&scene, &settings)?), ("GPU", &on_gpu(context, &on_device, &settings)?)];
            for (name, method) in methods {
                let found = ask(method)?;
                for (i, segment) in segments.iter().enumerate() {
                    let what = || format!("{name}, {bits} bits, {settings:?}: {segment:?}");
                    ensure(found.0[i] == occluded[i], what)?;
                    let (a, b) = (found.1[i], distances[i]);
                    ensure(a == b || (a - b).abs() <= 1e-5 * b, || format!("{a} not {b}, {}", what()))?;
                }
            }
        }
    }
    Ok(())
}

fn lights_are_hidden_alike(context: &GpuContext) -> Result<(), Failed> {
    let (archive, scene) = load(7)?;
    let on_device =
        GpuScene::stream(context.device(), context.queue(), &archive, StreamOptions::new(2 << 30))?;
    on_device.finish()?;
    let mut numbers = Numbers(5);
    let receivers: Vec<Receiver> = (0..301)
        .map(|i| Receiver {
            position: point(&scene, &mut numbers, if i == 300 { 90.0 } else { 0.95 }),
            normal: if i % 4 == 0 { [0.0; 3] } else { normal(&mut numbers) },
        })
        .collect();
    let mut lights: Vec<LightPoint> =
        (0..77).map(|_| LightPoint::at(point(&scene, &mut numbers, 1.5))).collect();
    lights[3] = LightPoint::directional([0.6, -0.8, 0.0], 500.0);
    lights[4] = LightPoint::at([f32::NAN, 0.0, 0.0]);
    lights[5] = LightPoint::at(receivers[7].position);
    for settings in SETTINGS {
        let ask = |method: &dyn Visibility| -> Result<_, Failed> {
            let mut hidden = vec![u32::MAX; receivers.len() * light_words(lights.len())];
            method.hidden_lights(&receivers, &lights, &mut hidden)?;
            Ok(hidden)
        };
        let expected = ask(&RowTester::of(&scene).with_settings(settings))?;
        ensure(ask(&on_twins(&scene, &settings)?)? == expected, || format!("twins, {settings:?}"))?;
        ensure(ask(&on_gpu(context, &on_device, &settings)?)? == expected, || format!("GPU, {settings:?}"))?;
    }
    Ok(())
}

fn a_scene_still_arriving(context: &GpuContext) -> Result<(), Failed> {
    let (archive, scene) = load(6)?;
    let on_device =
        GpuScene::stream(context.device(), context.queue(), &archive, StreamOptions::new(2 << 30))?;
    let segments = segments(&scene, 3000);
    let ask = |method: &dyn Visibility| -> Result<_, Failed> {
        let mut occluded = vec![9; segments.len()];
        method.occluded(&segments, &mut occluded)?;
        Ok(occluded)
    };
    let settings = TestSettings::FAST;
    let method = on_gpu(context, &on_device, &settings)?;
    let early = ask(&method)?;
    ensure(early.contains(&1), || "nothing is occluded by the coarse part".to_owned())?;
    on_device.finish()?;
    // The same method sees what has arrived since.
    let late = ask(&method)?;
    ensure(late == ask(&RowTester::of(&scene).with_settings(settings))?, || "differs".to_owned())
}
