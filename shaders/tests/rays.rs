//! The jobs that test rays, run by twins: cut into pieces, tried again with more steps, and refused. Needs no GPU.

use manyview_shaders::brickmap::{Brickmap, BrickmapBias};
use manyview_shaders::cases::Random;
use manyview_shaders::device::DeviceError;
use manyview_shaders::executor::{Binding, CpuBinding, CpuExecutor, Executor, ExecutorLimits, Recording};
use manyview_shaders::jobs::{MethodStage, hidden_lights, occluded_segments, segment_distances};
use manyview_shaders::stages::{self, Kind, Stage};
use manyview_shaders::testable::{is_behind, testable};
use manyview_shaders::types::{LightPoint, Receiver, Segment};

/// An executor that holds a brickmap, and the bindings for it.
fn loaded(map: &Brickmap, limits: ExecutorLimits) -> (CpuExecutor, Vec<Binding>) {
    let mut executor = CpuExecutor::new(limits);
    let params = [map.params];
    let mut recording = Recording::new();
    let mut bindings = Vec::new();
    let parts: [&[u8]; 4] = [
        bytemuck::cast_slice(&params),
        bytemuck::cast_slice(&map.coarse),
        bytemuck::cast_slice(&map.blocks),
        bytemuck::cast_slice(&map.bricks),
    ];
    for bytes in parts {
        let buffer = executor.buffer("a part of a brickmap", bytes.len() as u64).expect("small");
        recording.upload(buffer, bytes);
        bindings.push(buffer.into());
    }
    executor.run(&recording).expect("the CPU can");
    (executor, bindings)
}

fn method<'a>(stage: &'static Stage, bindings: &'a [Binding]) -> MethodStage<'a> {
    MethodStage { stage, bindings, rays_per_dispatch: 1 << 20 }
}

/// Three rows of cells in a grid of 2048 a side.
fn rods() -> Brickmap {
    let mut cells: Vec<[u16; 3]> = (0..2048).map(|x| [x, 8, 8]).collect();
    cells.extend((0..2048).filter(|y| *y != 8).map(|y| [2040, y, 8]));
    let key = |c: &[u16; 3]| {
        (0..16).map(|b| (0..3).map(|i| u64::from(c[i] >> b & 1) << (3 * b + i)).sum::<u64>()).sum::<u64>()
    };
    cells.sort_by_key(key);
    Brickmap::new([0.0; 3], 2048.0, 11, &cells, BrickmapBias { normal_cells: 0.25, skip_cells: 0.1 })
}

fn points(random: &mut Random, count: usize) -> Vec<[f32; 3]> {
    // Near the rods, some beyond the grid.
    let mut at = |low: i32, high: i32| random.range(low, high) as f32 / 8.0;
    (0..count).map(|_| [at(-800, 17_000), at(-20, 300), at(0, 160)]).collect()
}

fn receivers(random: &mut Random, count: usize) -> Vec<Receiver> {
    let mut receivers: Vec<Receiver> = points(random, count)
        .into_iter()
        .map(|position| Receiver { position, normal: [0.0, 0.6, 0.8] })
        .collect();
    receivers[1].normal = [0.0; 3];
    receivers[2].position[1] = f32::NAN;
    receivers[3].normal[0] = f32::INFINITY;
    receivers
}

fn lights(random: &mut Random, count: usize) -> Vec<LightPoint> {
    let mut lights: Vec<LightPoint> = points(random, count).into_iter().map(LightPoint::at).collect();
    lights[0] = LightPoint::directional([0.0, -0.6, -0.8], 4000.0);
    lights[1].offset[2] = f32::INFINITY;
    // Along the rods, one cell beside: thousands of steps.
    lights[2] = LightPoint::at([2047.5, 9.5, 8.5]);
    lights
}

#[test]
fn every_pair_of_a_receiver_and_a_light_is_a_segment() {
    let map = rods();
    let mut random = Random::new(3);
    let (mut receivers, lights) = (receivers(&mut random, 150), lights(&mut random, 70));
    receivers[0] = Receiver { position: [0.5, 9.5, 8.5], normal: [0.0; 3] };
    let mut expected = vec![0u32; receivers.len() * 3];
    let (mut hits, mut long) = (0, 0);
    for (r, receiver) in receivers.iter().enumerate() {
        for (l, light) in lights.iter().enumerate() {
            let Some(segment) = testable(&light.segment_from(receiver)) else { continue };
            let mut steps = u32::MAX;
            let hit = map.view().march(&segment, &mut steps).is_some();
            expected[r * 3 + l / 32] |= u32::from(hit || is_behind(&segment)) << (l % 32);
            hits += usize::from(hit);
            long += usize::from(u32::MAX - steps > 1_984);
        }
    }
    assert!((500..9000).contains(&hits), "{hits} of {}", 150 * 70);
    assert!(long > 0, "some ray takes more steps than an invocation of 32 lights has for it");
    // Bands of receivers and pieces of lights, down to one workgroup and 32 lights.
    for (binding_bytes, rays_per_dispatch) in [(128 << 20, 1 << 20), (128 << 20, 1), (8_500_000, 64 * 70)] {
        let (mut executor, bindings) = loaded(&map, ExecutorLimits { binding_bytes, depth_side: 8 });
        let mut hidden = vec![u32::MAX; expected.len()];
        let stage = MethodStage { rays_per_dispatch, ..method(&stages::brickmap_hidden_lights, &bindings) };
        hidden_lights(&mut executor, &stage, &receivers, &lights, &mut hidden).expect("the CPU can");
        assert!(hidden == expected, "{binding_bytes} bytes, {rays_per_dispatch} rays");
    }
}

#[test]
fn pieces_of_lights_are_put_together() {
    let map = Brickmap::new([0.0; 3], 16.0, 4, &[[8, 8, 8]], BrickmapBias::NONE);
    let mut random = Random::new(9);
    let lights = lights(&mut random, 200);
    let receivers = receivers(&mut random, 40);
    let ask = |binding_bytes| {
        let (mut executor, bindings) = loaded(&map, ExecutorLimits { binding_bytes, depth_side: 8 });
        let mut hidden = vec![0; 40 * 7];
        let stage = method(&stages::brickmap_hidden_lights, &bindings);
        hidden_lights(&mut executor, &stage, &receivers, &lights, &mut hidden).expect("the CPU can");
        hidden
    };
    assert_eq!(ask(1 << 20), ask(64 * 16), "64 lights and 42 receivers at a time");
}

#[test]
fn segments_are_answered_one_by_one() {
    let map = rods();
    let mut random = Random::new(4);
    let mut segments: Vec<Segment> = points(&mut random, 3000)
        .chunks(2)
        .map(|p| Segment { origin: p[0], target: p[1], normal: [0.0; 3] })
        .collect();
    segments[5].target = segments[5].origin;
    segments[6].origin[0] = f32::NAN;
    segments[7].target[1] = f32::INFINITY;
    let march = |s: &Segment| testable(s).and_then(|s| map.view().march(&s, &mut { u32::MAX }));
    let expected: Vec<Option<f32>> = segments.iter().map(march).collect();
    assert!(expected.iter().flatten().count() > 20 && expected[5..8] == [None; 3]);
    for rays_per_dispatch in [1, 1 << 20] {
        let (mut executor, bindings) = loaded(&map, ExecutorLimits::DEFAULT);
        let stage = MethodStage { rays_per_dispatch, ..method(&stages::brickmap_segments, &bindings) };
        let mut occluded = vec![7; segments.len()];
        occluded_segments(&mut executor, &stage, &segments, &mut occluded).expect("the CPU can");
        let mut distances = vec![0.0; segments.len()];
        segment_distances(&mut executor, &stage, &segments, &mut distances).expect("the CPU can");
        for ((expected, occluded), distance) in expected.iter().zip(occluded).zip(distances) {
            assert_eq!(u8::from(expected.is_some()), occluded);
            assert_eq!(expected.unwrap_or(f32::INFINITY), distance);
        }
    }
}

#[test]
fn nothing_asked_is_nothing_answered() {
    let map = Brickmap::new([0.0; 3], 16.0, 4, &[[8, 8, 8]], BrickmapBias::NONE);
    let (mut executor, bindings) = loaded(&map, ExecutorLimits::DEFAULT);
    let lights_stage = method(&stages::brickmap_hidden_lights, &bindings);
    let light = [LightPoint::at([9.0; 3])];
    hidden_lights(&mut executor, &lights_stage, &[], &light, &mut []).expect("no receivers");
    hidden_lights(&mut executor, &lights_stage, &[Receiver::default()], &[], &mut []).expect("no lights");
    let segments_stage = method(&stages::brickmap_segments, &bindings);
    occluded_segments(&mut executor, &segments_stage, &[], &mut []).expect("no segments");
}

#[test]
fn rays_that_never_end_are_an_error() {
    // A method whose every ray runs out of steps.
    fn twin(_: [u32; 3], bindings: &mut [CpuBinding]) {
        bindings.last_mut().expect("results").words_mut().fill(1);
    }
    let lights_stage = Stage {
        name: "endless",
        bindings: &stages::brickmap_hidden_lights.bindings[..4],
        kind: Kind::Compute { workgroup_size: [64, 1, 1], twin },
        files: &[],
    };
    let segments_stage = Stage { bindings: &stages::brickmap_segments.bindings[..3], ..lights_stage };
    let leaked = |stage| -> &'static Stage { Box::leak(Box::new(stage)) };
    let mut executor = CpuExecutor::default();
    let method_of = |stage| MethodStage { stage, bindings: &[], rays_per_dispatch: 1 << 20 };
    let light = [LightPoint::at([9.0; 3])];
    let error = hidden_lights(
        &mut executor,
        &method_of(leaked(lights_stage)),
        &[Receiver::default()],
        &light,
        &mut [0],
    );
    assert!(matches!(&error, Err(DeviceError::Failed(text)) if text.contains("endless")), "{error:?}");
    let error =
        occluded_segments(&mut executor, &method_of(leaked(segments_stage)), &[Segment::default()], &mut [0]);
    assert!(matches!(error, Err(DeviceError::Failed(_))), "{error:?}");
}
