//! ManyLoDs on the GPU, by the stages' twins and on the CPU: the same maps.
//!
//! Without an adapter every test is reported as ignored, or as failed if `MANYVIEW_REQUIRE_GPU` is 1.
//! `MANYVIEW_ADAPTER` chooses among adapters.

mod support;

use libtest_mimic::Failed;
use manyview::gpu::GpuContext;
use manyview::manylods::{SvoCuts, SvoCutsGpu};
use manyview::views::{Depths, View, ViewError, ViewMaps, ViewRenderer, ViewSettings};
use manyview_shaders::scene_tree::SceneTree;
use std::f32::consts::{FRAC_PI_2, PI};
use std::sync::Arc;
use support::gpu::Check;
use support::{Numbers, octree};

fn main() {
    let checks: [(&str, Check); 2] =
        [("maps_are_alike", maps_are_alike), ("short_lists_change_nothing", short_lists_change_nothing)];
    support::gpu::run(checks)
}

fn tree(depth: u32, numbers: &mut Numbers) -> SceneTree {
    // The walls of a room, with things in it.
    let side = 1u32 << depth;
    let walls = (0..side.pow(3)).map(|i| [i % side, i / side % side, i / side / side]);
    let mut voxels: Vec<[u32; 3]> =
        walls.filter(|cell| cell.iter().any(|&c| c == 0 || c == side - 1)).collect();
    voxels.extend((0..300).map(|_| [(); 3].map(|()| (numbers.unit() * f64::from(side)) as u32)));
    SceneTree::new(&octree([-1.0, 2.0, 0.5], 8.0, depth, &voxels), false)
}

fn views(count: usize, numbers: &mut Numbers) -> Vec<View> {
    let mut views: Vec<View> = (0..count)
        .map(|i| {
            let mut number = |low: f32, high: f32| low + numbers.unit() as f32 * (high - low);
            let reach = if i % 7 == 6 { 12.0 } else { 0.0 };
            let position = [-1.0, 2.0, 0.5].map(|low| number(low - reach, low + 8.0 + reach));
            View::new(position, [(); 3].map(|()| number(-1.0, 1.0)), [PI, FRAC_PI_2, 0.6][i % 3])
        })
        .collect();
    views[2].position = views[1].position;
    views[4].position[1] = f32::NAN;
    views
}

/// Compares maps: GPUs may round roots and quotients otherwise, which decides about a node at the limit now and then and moves a
/// point to the texel beside. One texel in 500 may differ; distances in all others by a ten thousandth.
fn compare(a: &ViewMaps, b: &ViewMaps, what: &str) -> Result<(), Failed> {
    if (a.views(), a.map_of()) != (b.views(), b.map_of()) {
        return Err(format!("{what}: other views").into());
    }
    let (mut texels, mut other, mut empty) = (0, 0, 0);
    for place in 0..a.views().len() {
        for (a, b) in a.view_depths(place).into_iter().zip(b.view_depths(place)) {
            texels += 1;
            empty += usize::from(a == f32::INFINITY);
            other += usize::from(!(a == b || (a - b).abs() <= 1e-4 * b));
        }
    }
    if other * 500 > texels || empty * 4 > texels * 3 {
        return Err(format!("{what}: {other} of {texels} texels differ, {empty} are empty").into());
    }
    Ok(())
}

fn maps_are_alike(context: &GpuContext) -> Result<(), Failed> {
    let mut numbers = Numbers(41);
    for (depth, resolution, texels) in [(5, 8, 1.0), (6, 16, 1.0), (4, 32, 0.5), (3, 64, 2.0)] {
        let tree = Arc::new(tree(depth, &mut numbers));
        let cpu = SvoCuts::new(Arc::clone(&tree));
        let twins = SvoCutsGpu::on_twins(&tree)?;
        let gpu = SvoCutsGpu::on_gpu(context, &tree)?;
        let views = views(40, &mut numbers);
        for culling in [true, false] {
            let settings = ViewSettings { texels, culling, ..ViewSettings::new(resolution) };
            let expected = cpu.render_views(&views, &settings)?;
            let what = format!("{depth} levels, {resolution} texels, culling {culling}");
            compare(&twins.render_views(&views, &settings)?, &expected, &format!("twins, {what}"))?;
            compare(&gpu.render_views(&views, &settings)?, &expected, &format!("GPU, {what}"))?;
            let half = ViewSettings { half_depths: true, ..settings };
            let (full, found) = (gpu.render_views(&views, &settings)?, gpu.render_views(&views, &half)?);
            if !matches!(found.depths(), Depths::Half(_)) {
                return Err("depths in full, not halves".into());
            }
            for view in 0..views.len() {
                let pairs = full.view_depths(view).into_iter().zip(found.view_depths(view));
                // Halves have eleven bits.
                let mut off =
                    pairs.filter(|&(a, b)| a != b && ((a - b).abs() > a / 1024.0 || b.is_infinite()));
                if let Some((full, half)) = off.next() {
                    return Err(format!("{what}: {half} for {full}").into());
                }
            }
        }
        if gpu.render_passes(&[], &ViewSettings::new(16), &mut |_| panic!("no pass")).is_err() {
            return Err("no view is no error".into());
        }
        let colors = ViewSettings { with_colors: true, ..ViewSettings::new(16) };
        if !matches!(gpu.render_views(&views, &colors), Err(ViewError::Unsupported { .. })) {
            return Err("colours".into());
        }
    }
    Ok(())
}

fn short_lists_change_nothing(context: &GpuContext) -> Result<(), Failed> {
    let mut numbers = Numbers(43);
    let tree = tree(6, &mut numbers);
    let views = views(60, &mut numbers);
    let settings = ViewSettings::new(16);
    let methods: [Box<dyn ViewRenderer + '_>; 2] =
        [Box::new(SvoCutsGpu::on_twins(&tree)?), Box::new(SvoCutsGpu::on_gpu(context, &tree)?)];
    for method in methods {
        let all = method.render_views(&views, &settings)?;
        for budget_bytes in [100_000, 400_000, 2_000_000] {
            let (mut passes, mut together) = (0, ViewMaps::new(&settings));
            let tight = ViewSettings { budget_bytes, ..settings };
            method.render_passes(&views, &tight, &mut |pass| {
                passes += 1;
                together.append(pass);
                Ok(())
            })?;
            if together != all || passes < 2 && budget_bytes < 1_000_000 {
                return Err(format!("{budget_bytes} bytes: {passes} passes").into());
            }
        }
        for budget_bytes in [1000, 6000] {
            let tight = ViewSettings { budget_bytes, ..settings };
            if !matches!(method.render_passes(&views, &tight, &mut |_| Ok(())), Err(ViewError::Budget { .. }))
            {
                return Err(format!("{budget_bytes} bytes are enough").into());
            }
        }
    }
    Ok(())
}
