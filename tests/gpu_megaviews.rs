//! MegaViews on the GPU, by the stages' twins and by the CPU's own hierarchy: the same hierarchies, pairs and maps.
//!
//! Without an adapter every test is reported as ignored, or as failed if `MANYVIEW_REQUIRE_GPU` is 1.
//! `MANYVIEW_ADAPTER` chooses among adapters.
//!
//! # Tolerances
//! Keys, order, ranges of nodes and boxes are exact. Square roots and fused products of a GPU may round otherwise: radii and
//! cones agree to 10⁻⁵; a pair whose test is decided by the last bit is drawn by one and subdivided by the other, and a ray along
//! the edge of a leaf hits for one alone. So depths agree to 10⁻⁴ of their length but in one texel of a thousand. What a texel
//! shows is another node there, and where two nodes are as near but for the last bit: three texels of a thousand. On one device
//! numbers are exact: every texel with a depth shows what has that very depth, however often it is drawn.

mod support;

use libtest_mimic::Failed;
use manyview::gpu::{GpuContext, WgpuExecutor};
use manyview::megaviews::MegaViews;
use manyview::megaviews::gpu::MegaViewsGpu;
use manyview::megaviews::view_tree::{SortedViews, ViewTree};
use manyview::views::{View, ViewError, ViewMaps, ViewRenderer, ViewSettings};
use manyview_shaders::executor::{CpuExecutor, ExecutorLimits};
use manyview_shaders::jobs::mega_views::{
    MegaViewsDevice, MegaViewsSettings, PassMaps, PassResult, Room, SortedOrder,
};
use manyview_shaders::mega_views::{NO_NUMBER, ViewCone};
use manyview_shaders::scene_tree::SceneTree;
use std::sync::Arc;
use std::time::Instant;
use support::gpu::Check;
use support::{Numbers, octree};

fn main() {
    let checks: [(&str, Check); 6] = [
        ("hierarchies_are_those_of_the_cpu", hierarchies_are_those_of_the_cpu),
        ("pairs_and_maps_are_those_of_the_twins", pairs_and_maps_are_those_of_the_twins),
        ("colours_are_those_of_the_cpu", colours_are_those_of_the_cpu),
        ("little_room_changes_nothing_but_the_passes", little_room_changes_nothing_but_the_passes),
        ("large_maps_of_few_views_are_complete", large_maps_of_few_views_are_complete),
        ("a_baked_scene_is_drawn_and_timed", a_baked_scene_is_drawn_and_timed),
    ];
    support::gpu::run(checks)
}

fn ensure(holds: bool, what: impl FnOnce() -> String) -> Result<(), Failed> {
    if holds { Ok(()) } else { Err(what().into()) }
}

/// Hills over a cube of edge 10, with a wall: about 3 · 4^depth voxels.
fn scene(depth: u32) -> SceneTree {
    let side = 1u32 << depth;
    let mut voxels = Vec::new();
    for x in 0..side {
        for z in 0..side {
            let [u, v] = [x, z].map(|c| f64::from(c) / f64::from(side) * 9.0);
            let wave = (u * (2.0 - u / 9.0)).min(v) % 1.5 / 6.0;
            voxels.push([x, ((0.2 + wave) * f64::from(side)) as u32, z]);
            voxels.push([x, z, side / 3]);
        }
    }
    SceneTree::new(&octree([-5.0; 3], 10.0, depth, &voxels), true)
}

fn views(count: usize, seed: u64) -> Vec<View> {
    let mut numbers = Numbers(seed);
    let mut vector = |reach: f64| [(); 3].map(|()| ((numbers.unit() * 2.0 - 1.0) * reach) as f32);
    let mut views: Vec<View> = (0..count)
        .map(|i| View::new(vector(if i % 50 == 0 { 20.0 } else { 5.0 }), vector(1.0), (i % 4) as f32))
        .collect();
    // Some in one place, some in one voxel.
    for i in 0..count / 10 {
        views[i].position = [1.0, 2.0, 3.0];
        views[count - 1 - i].position = [1.0 + 0.001 * i as f32, -1.0, 3.0];
    }
    views
}

const SETTINGS: MegaViewsSettings = MegaViewsSettings::new(16);
const ROOM: Room = Room { nodes: 8000, pairs: 1 << 20, near: 1 << 20 };

fn draw(
    device: &mut MegaViewsDevice<'_>,
    views: &[View],
    settings: &MegaViewsSettings,
) -> Result<(SortedOrder, PassMaps), Failed> {
    let cones: Vec<ViewCone> = views.iter().map(ViewCone::from).collect();
    let sorted = device.sort(&cones)?;
    match device.pass(0, views.len() as u32, settings, ROOM)? {
        PassResult::Maps(maps) => Ok((sorted, maps)),
        PassResult::NoRoom(flags) => Err(format!("no room: {flags}").into()),
    }
}

fn on_gpu<'a>(context: &'a GpuContext, scene: &SceneTree) -> Result<MegaViewsDevice<'a>, Failed> {
    Ok(MegaViewsDevice::new(Box::new(WgpuExecutor::new(context, ExecutorLimits::DEFAULT)), scene)?)
}

fn close(a: f32, b: f32, tolerance: f32) -> bool {
    a == b || (a - b).abs() <= tolerance * (1.0 + b.abs())
}

fn hierarchies_are_those_of_the_cpu(context: &GpuContext) -> Result<(), Failed> {
    let scene = scene(5);
    for count in [1, 2, 300, 5000] {
        let views = views(count, 3 + count as u64);
        let expected = SortedViews::new(&views, &scene);
        for sharing in [true, false] {
            let settings = MegaViewsSettings { sharing, resolution: 8, ..SETTINGS };
            let (sorted, found) = draw(&mut on_gpu(context, &scene)?, &views, &settings)?;
            let keys: Vec<u64> =
                sorted.keys.iter().map(|&[low, high]| u64::from(high) << 30 | u64::from(low)).collect();
            let differing = keys.iter().zip(&expected.keys).filter(|(a, b)| a != b).count();
            ensure(keys == expected.keys && sorted.order == expected.order, || {
                format!("{differing} of {count} keys differ")
            })?;
            let sharing = match sharing {
                true => manyview::megaviews::view_tree::Sharing::Voxel,
                false => manyview::megaviews::view_tree::Sharing::None,
            };
            let tree = ViewTree::new(&views, &sorted.order, &keys, scene.depth, sharing);
            ensure(tree.level_starts == found.level_starts, || {
                format!("levels {:?} instead of {:?}", found.level_starts, tree.level_starts)
            })?;
            for (a, b) in found.nodes.iter().zip(&tree.nodes) {
                let numbers = |n: &manyview_shaders::views::ViewNode| {
                    [n.radius, n.axis[0], n.axis[1], n.axis[2], n.cos_psi]
                };
                let same = a.first == b.first && a.count == b.count && a.center == b.center;
                let near = numbers(a).into_iter().zip(numbers(b)).all(|(a, b)| close(a, b, 1e-5));
                // A sine near 0 magnifies what its cosine is off.
                let sine = close(a.sin_psi, b.sin_psi, 4e-3);
                ensure(same && near && sine, || format!("{a:?} instead of {b:?}"))?;
            }
        }
    }
    Ok(())
}

/// Share of texels whose distances differ.
fn differing(found: &[u32], expected: &[u32]) -> f64 {
    let wrong = found.iter().zip(expected).filter(|&(&a, &b)| {
        let [a, b] = [a, b].map(f32::from_bits);
        a != b && ((a - b).abs() > 1e-4 * b || (a - b).is_nan())
    });
    wrong.count() as f64 / expected.len() as f64
}

fn pairs_and_maps_are_those_of_the_twins(context: &GpuContext) -> Result<(), Failed> {
    for depth in [1, 4, 6] {
        let scene = scene(depth);
        let mut twins = MegaViewsDevice::new(Box::new(CpuExecutor::default()), &scene)?;
        let mut device = on_gpu(context, &scene)?;
        for settings in [
            SETTINGS,
            MegaViewsSettings { culling: false, sharing: false, ..SETTINGS },
            MegaViewsSettings { resolution: 32, texels: 0.5, ..SETTINGS },
            MegaViewsSettings { resolution: 8, texels: 4.0, ..SETTINGS },
        ] {
            let views = views(400, 17);
            let (order, expected) = draw(&mut twins, &views, &settings)?;
            let (gpu_order, found) = draw(&mut device, &views, &settings)?;
            let what = || format!("depth {depth}, {settings:?}");
            ensure(order == gpu_order && found.level_starts == expected.level_starts, what)?;
            for (a, b) in found.pairs.into_iter().zip(expected.pairs) {
                let off = a.abs_diff(b);
                ensure(f64::from(off) <= 1e-3 * f64::from(b) + 2.0, || {
                    format!("{a} pairs instead of {b}: {}", what())
                })?;
            }
            let share = differing(&found.depths, &expected.depths);
            ensure(share <= 1e-3, || format!("{share} of all texels differ: {}", what()))?;
            // The order in which pairs are queued shows nowhere.
            let (_, again) = draw(&mut device, &views, &settings)?;
            ensure(again == found, || format!("another time, another result: {}", what()))?;
            check_numbers(&mut twins, &mut device, &views, &settings, &found)?;
            let half = MegaViewsSettings { half_depths: true, ..settings };
            let (_, half) = draw(&mut device, &views, &half)?;
            let packed = found.depths.chunks(2).map(|pair| {
                let [low, high] = [0, 1].map(|i| manyview_shaders::mega_views::half_bits(pair[i]));
                low | high << 16
            });
            ensure(packed.eq(half.depths.iter().copied()), || format!("halves: {}", what()))?;
        }
    }
    Ok(())
}

/// Numbers of scene nodes beside depths that are as without them.
fn check_numbers(
    twins: &mut MegaViewsDevice<'_>,
    device: &mut MegaViewsDevice<'_>,
    views: &[View],
    settings: &MegaViewsSettings,
    without: &PassMaps,
) -> Result<(), Failed> {
    let settings = MegaViewsSettings { with_numbers: true, ..*settings };
    let (_, expected) = draw(twins, views, &settings)?;
    let (_, found) = draw(device, views, &settings)?;
    let what = || format!("{settings:?}");
    ensure(without.numbers.is_empty() && found.depths == without.depths, || {
        format!("numbers change depths: {}", what())
    })?;
    let empty = |maps: &PassMaps| {
        let texels = maps.depths.iter().zip(&maps.numbers);
        texels.filter(|&(&bits, &number)| (bits == f32::INFINITY.to_bits()) != (number == NO_NUMBER)).count()
    };
    ensure(found.numbers.len() == found.depths.len() && empty(&found) == 0, || {
        format!("{} depths without a number or numbers without a depth: {}", empty(&found), what())
    })?;
    let differing = found.numbers.iter().zip(&expected.numbers).filter(|(a, b)| a != b).count();
    let share = differing as f64 / expected.numbers.len() as f64;
    ensure(share <= 3e-3, || format!("{share} of all texels show something else: {}", what()))?;
    let (_, again) = draw(device, views, &settings)?;
    ensure(again == found, || format!("another time, other numbers: {}", what()))?;
    let (_, half) = draw(device, views, &MegaViewsSettings { half_depths: true, ..settings })?;
    ensure(half.numbers == found.numbers && 2 * half.depths.len() == found.depths.len(), || {
        format!("numbers beside halves: {}", what())
    })
}

fn colours_are_those_of_the_cpu(context: &GpuContext) -> Result<(), Failed> {
    let scene = scene(6);
    let views = views(500, 29);
    let settings = ViewSettings { with_colors: true, ..ViewSettings::new(16) };
    let found = MegaViewsGpu::on_gpu(context, &scene)?.render_views(&views, &settings)?;
    let expected = MegaViews::new(Arc::new(scene.clone())).render_views(&views, &settings)?;
    let texels = found.colors().len() / found.centers().len();
    let (mut differing, mut filled) = (0, 0);
    for view in 0..views.len() {
        let [found, expected] = [&found, &expected].map(|maps| {
            let map = maps.map_of()[view] as usize;
            &maps.colors()[map * texels..][..texels]
        });
        differing += found.iter().zip(expected).filter(|(a, b)| a != b).count();
        filled += expected.iter().filter(|&&color| color != [0; 4]).count();
    }
    let all = views.len() * texels;
    ensure(filled > all / 4 && differing as f64 <= 3e-3 * all as f64, || {
        format!("{differing} colours of {filled} differ")
    })?;
    let uncolored = SceneTree { colors: Vec::new(), ..scene };
    let refused = MegaViewsGpu::on_gpu(context, &uncolored)?.render_views(&views, &settings);
    ensure(matches!(refused, Err(ViewError::Unsupported { .. })), || "a scene without colours".to_owned())
}

/// A pass is exactly what its views give if they are drawn alone, whether it was planned or drawn again in halves.
fn little_room_changes_nothing_but_the_passes(context: &GpuContext) -> Result<(), Failed> {
    let scene = scene(5);
    let views = views(600, 23);
    let settings = ViewSettings { with_colors: true, ..ViewSettings::new(16) };
    let whole = MegaViewsGpu::on_gpu(context, &scene)?;
    let mut runs = Vec::new();
    let mut count_runs = |pass: ViewMaps| {
        runs.push(pass.views().len());
        Ok(())
    };
    whole.render_passes(&views, &settings, &mut count_runs)?;
    ensure(runs == [600], || format!("{runs:?}"))?;
    let most = Room { nodes: u32::MAX, pairs: u32::MAX, near: u32::MAX };
    for room in [Room { pairs: 9000, ..most }, Room { near: 9000, ..most }, Room { nodes: 200, ..most }] {
        let limited = MegaViewsGpu::on_gpu(context, &scene)?.with_most_room(room);
        let mut passes = Vec::new();
        limited.render_passes(&views, &settings, &mut |pass| {
            passes.push(pass);
            Ok(())
        })?;
        let mut seen: Vec<u32> = passes.iter().flat_map(|pass| pass.views().to_vec()).collect();
        seen.sort_unstable();
        ensure(passes.len() > 1 && seen.into_iter().eq(0..600), || format!("{room:?}: the passes' views"))?;
        for pass in &passes {
            let of_pass: Vec<View> = pass.views().iter().map(|&view| views[view as usize]).collect();
            let alone = whole.render_views(&of_pass, &settings)?;
            for place in 0..of_pass.len() {
                ensure(alone.view_depths(place) == pass.view_depths(place), || {
                    format!("{room:?}: view {} of a pass of {}", pass.views()[place], of_pass.len())
                })?;
            }
            ensure(alone.colors() == pass.colors() && !pass.colors().is_empty(), || {
                format!("{room:?}: colours of a pass of {}", of_pass.len())
            })?;
        }
    }
    Ok(())
}

fn large_maps_of_few_views_are_complete(context: &GpuContext) -> Result<(), Failed> {
    // Near leaves fill more texels than one invocation may loop over.
    let scene = scene(1);
    let views = [View::around([0.3, 4.2, 0.1])];
    for resolution in [512, 1024] {
        let settings = MegaViewsSettings { resolution, with_numbers: true, ..SETTINGS };
        let room = Room { nodes: 2, pairs: 1000, near: 1000 };
        let cones: Vec<ViewCone> = views.iter().map(ViewCone::from).collect();
        let mut results = Vec::new();
        let mut devices =
            [on_gpu(context, &scene)?, MegaViewsDevice::new(Box::new(CpuExecutor::default()), &scene)?];
        for device in &mut devices {
            device.sort(&cones)?;
            match device.pass(0, 1, &settings, room)? {
                PassResult::Maps(maps) => results.push(maps),
                PassResult::NoRoom(flags) => return Err(format!("no room: {flags}").into()),
            }
        }
        let share = differing(&results[0].depths, &results[1].depths);
        let finite = results[1].depths.iter().filter(|&&bits| bits != f32::INFINITY.to_bits()).count();
        ensure(share < 1e-3 && finite > 1 << 17, || format!("{resolution}: {share} of texels, {finite}"))?;
        let [found, expected] = &results[..] else { unreachable!("two devices") };
        let others = found.numbers.iter().zip(&expected.numbers).filter(|(a, b)| a != b).count();
        ensure(others < found.numbers.len() / 300, || format!("{resolution}: {others} other numbers"))?;
    }
    Ok(())
}

/// Times of the parts of a frame over the octree of the archive that `MANYVIEW_TIME_BAKE` names; nothing without one.
fn a_baked_scene_is_drawn_and_timed(context: &GpuContext) -> Result<(), Failed> {
    let Ok(path) = std::env::var("MANYVIEW_TIME_BAKE") else { return Ok(()) };
    let archive = manyview::Archive::open(&path)?;
    let scene = SceneTree::new(&archive.svo()?, true);
    eprintln!("{} inner nodes, {} leaves", scene.nodes.len(), scene.leaf_count());
    for count in [1024, 4096, 16_384, 65_536] {
        let mut numbers = Numbers(7);
        // On random surfaces, as virtual lights are.
        let views: Vec<View> = (0..count)
            .map(|_| {
                let node = (numbers.unit() * scene.nodes.len() as f64) as usize;
                let mean = scene.mean(manyview_shaders::scene_tree::NodeRef(node as u32));
                let axis = [(); 3].map(|()| (numbers.unit() * 2.0 - 1.0) as f32);
                View::new(mean, axis, std::f32::consts::FRAC_PI_2)
            })
            .collect();
        let renderer = MegaViewsGpu::on_gpu(context, &scene)?;
        for (timed, with_colors) in
            [(false, false), (true, false), (false, false), (true, true), (false, true)]
        {
            let settings = ViewSettings { with_colors, ..ViewSettings::new(16) };
            if timed {
                renderer.take_times();
            }
            let start = Instant::now();
            let mut passes = 0;
            renderer.render_passes(&views, &settings, &mut |_| {
                passes += 1;
                Ok(())
            })?;
            let colors = if with_colors { " with colours" } else { "" };
            eprintln!("{count} views{colors}, {passes} passes: {:.0?}", start.elapsed());
            let mut parts: Vec<(&str, std::time::Duration)> = Vec::new();
            for (name, time) in renderer.timings() {
                match parts.iter_mut().find(|(other, _)| *other == name) {
                    Some((_, sum)) => *sum += time,
                    None => parts.push((name, time)),
                }
            }
            if timed {
                eprintln!("  {parts:.1?}");
            }
        }
    }
    Ok(())
}
