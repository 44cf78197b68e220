//! \[ML\] Tables 1 and 2: the time of the maps of 1,024 virtual point lights, method by method, and what lists take; and
//! a tree of points, made, moved and cut for a single view.

use super::TableSettings;
use super::subject::Subject;
use crate::bench::table::{Cell, Table};
use crate::bench::{BenchError, BenchScene, Random, SceneSource};
use crate::manylods::{CutState, CutStats, PointCutState, PointCuts, Steps, SvoCuts};
use crate::reference::{Reference, area_normal};
use crate::rivals::ism::{IsmOptions, IsmVisibility};
use crate::views::{Polygons, View, ViewError, ViewMaps, ViewRenderer, ViewSettings};
use crate::visibility::{LightPoint, Receiver, Visibility, light_words};
use glam::{DVec3, Quat, Vec3};
use manyview_pipeline::bake::Progress;
use manyview_shaders::scene_tree::SceneTree;
use std::f32::consts::FRAC_PI_2;
use std::sync::Arc;
use std::time::Instant;

/// Frames that kept cuts are timed over.
const FRAMES: usize = 8;

/// Time and memory of the maps of [`TableSettings::lights`] views that lie on surfaces, a half space each, and move slowly.
pub fn manylods(
    scenes: &[SceneSource],
    settings: &TableSettings,
    progress: &dyn Progress,
) -> Result<Table, BenchError> {
    let title = format!("Maps of {} lights on surfaces", settings.lights);
    let columns = [
        "scene",
        "leaves",
        "method",
        "ms",
        "us a view",
        "drawn a view",
        "tested a view",
        "list KiB",
        "paper's KiB",
    ];
    let mut table = Table::new("manylods", title, &columns);
    progress.begin("maps", scenes.len() as u64, "scenes");
    for source in scenes {
        if progress.cancelled() {
            return Err(BenchError::Cancelled);
        }
        let scene = BenchScene::load(source)?;
        one_scene(&scene, settings, &mut table)?;
        progress.advance(1);
    }
    Ok(table)
}

fn one_scene(scene: &BenchScene, settings: &TableSettings, table: &mut Table) -> Result<(), BenchError> {
    let subject = Subject::new(scene, settings.levels, [64, 64])?;
    let failed = |source: ViewError| BenchError::Views { method: "manylods".to_owned(), source };
    let load = |error| BenchError::Load { scene: scene.name.clone(), source: Box::new(error) };
    let cuts = SvoCuts::new(Arc::new(SceneTree::new(&subject.archive.svo().map_err(load)?, false)));
    let reference = subject.judge.reference();
    let frames = on_surfaces(reference, &cuts, settings);
    let leaves = u64::from(cuts.tree().leaf_count());
    let mut push = |method: &str, seconds: f64, stats: Option<CutStats>| {
        let a_view = |count: u64| Cell::Number(count as f64 / f64::from(settings.lights), 1);
        let kib = |bytes: u64| Cell::Number(bytes as f64 / 1024.0, 1);
        let mut row = vec![Cell::Text(scene.name.clone()), Cell::Count(leaves), method.into()];
        row.push(Cell::Number(1e3 * seconds, 2));
        row.push(Cell::Number(1e6 * seconds / f64::from(settings.lights), 2));
        row.extend(match stats {
            Some(s) => [a_view(s.drawn), a_view(s.visited), kib(s.list_bytes), kib(s.paper_list_bytes)],
            None => [Cell::None, Cell::None, Cell::None, Cell::None],
        });
        table.push(row);
    };
    let maps = ViewSettings::new(16);

    let polygons = Polygons::new(reference);
    let seconds = best_of(settings.repeats, || polygons.render_views(&frames[0], &maps).map(|_| ()))
        .map_err(|source| BenchError::Views { method: "polygons".to_owned(), source })?;
    push("polygons", seconds, None);
    let ism = IsmVisibility::new(reference, IsmOptions { resolution: 16, ..IsmOptions::default() });
    let lights: Vec<LightPoint> = frames[0].iter().map(|view| LightPoint::at(view.position)).collect();
    // One receiver: the time is that of the maps.
    let receiver = [Receiver { position: frames[0][0].position, normal: [0.0; 3] }];
    let mut hidden = vec![0; light_words(lights.len())];
    let mut seconds = f64::INFINITY;
    for _ in 0..settings.repeats {
        let begun = Instant::now();
        ism.hidden_lights(&receiver, &lights, &mut hidden)
            .map_err(|source| BenchError::Method { method: "ism".to_owned(), source })?;
        seconds = seconds.min(begun.elapsed().as_secs_f64());
    }
    push("imperfect shadow maps, 8,192 points", seconds, None);

    let mut stats = CutStats::default();
    let seconds = best_of(settings.repeats, || {
        stats = cuts.render_counted(&frames[0], &maps, &mut |_| Ok(()))?;
        Ok(())
    })
    .map_err(failed)?;
    push("octree, basic", seconds, Some(stats));
    for (name, steps) in [("octree, incremental", Steps::All), ("octree, lazy", Steps::AtMost(1))] {
        let mut state = CutState::new();
        cuts.render_frame(&mut state, &frames[0], &maps, Steps::All).map_err(failed)?;
        let frame = |views: &Vec<View>| cuts.render_frame(&mut state, views, &maps, steps);
        let (seconds, stats) = mean_of(&frames[1..], frame).map_err(failed)?;
        push(name, seconds, Some(stats));
    }
    let Some(points) = PointCuts::new(&moved(reference, 0.0), POINTS_DEPTH, settings.seed) else {
        return Ok(());
    };
    let seconds =
        best_of(settings.repeats, || points.render_views(&frames[0], &maps).map(|_| ())).map_err(failed)?;
    push("points, basic", seconds, None);
    for (name, steps) in [("points, incremental", Steps::All), ("points, lazy", Steps::AtMost(1))] {
        let mut state = PointCutState::new();
        points.render_frame(&mut state, &frames[0], &maps, Steps::All).map_err(failed)?;
        let frame = |views: &Vec<View>| points.render_frame(&mut state, views, &maps, steps);
        let (seconds, stats) = mean_of(&frames[1..], frame).map_err(failed)?;
        push(name, seconds, Some(stats));
    }
    Ok(())
}

/// log2 of the number of points: about a million.
const POINTS_DEPTH: u32 = 20;
/// Texels a side of the single view's halves: its front half has as many as a large picture.
const SINGLE_RESOLUTION: u32 = 1024;
/// Sizes in texels below which a node of the single view's cut counts as a point.
const SINGLE_TEXELS: [f32; 3] = [1.0, 2.0, 4.0];

/// \[ML\] Table 2: time to make a tree of points, to follow triangles that have moved, and to cut it for a single view.
pub fn manylods_single(
    scenes: &[SceneSource],
    settings: &TableSettings,
    progress: &dyn Progress,
) -> Result<Table, BenchError> {
    let columns = [
        "scene",
        "triangles",
        "points",
        "build s",
        "update ms",
        "cut at 1 texel ms",
        "at 2",
        "at 4",
        "nodes at 1 texel",
        "at 2 texels",
        "at 4 texels",
    ];
    let mut table = Table::new("manylods-single", "A tree of points and a single view", &columns);
    progress.begin("single views", scenes.len() as u64, "scenes");
    for source in scenes {
        if progress.cancelled() {
            return Err(BenchError::Cancelled);
        }
        let scene = BenchScene::load(source)?;
        let reference = Reference::new(&scene.scene, &scene.row_triangles, &scene.cutouts);
        let triangles = moved(&reference, 0.0);
        let begun = Instant::now();
        let Some(mut points) = PointCuts::new(&triangles, POINTS_DEPTH, settings.seed) else { continue };
        let build = begun.elapsed().as_secs_f64();
        let after = moved(&reference, 0.01);
        let mut update = f64::INFINITY;
        for _ in 0..settings.repeats.max(1) {
            let begun = Instant::now();
            points.update(&after);
            update = update.min(begun.elapsed().as_secs_f64());
        }
        let (center, half) = (DVec3::from(scene.lattice.center), DVec3::from(scene.lattice.half_extent));
        let eye = (center + half * 2.0).as_vec3();
        let forward = (center.as_vec3() - eye).normalize_or(Vec3::NEG_Z);
        let view = View::new(eye.to_array(), forward.to_array(), FRAC_PI_2);
        let mut row = vec![
            Cell::Text(scene.name.clone()),
            Cell::Count(triangles.len() as u64),
            Cell::Count(points.tree().len() as u64),
            Cell::Number(build, 2),
            Cell::Number(1e3 * update, 1),
        ];
        let mut counts = Vec::new();
        for texels in SINGLE_TEXELS {
            let drawing = ViewSettings { texels, ..ViewSettings::new(SINGLE_RESOLUTION) };
            let mut nodes = 0;
            let seconds = best_of(settings.repeats, || {
                nodes = points.cut(&view, &drawing).len();
                Ok(())
            });
            let seconds =
                seconds.map_err(|source| BenchError::Views { method: "points".to_owned(), source })?;
            row.push(Cell::Number(1e3 * seconds, 2));
            counts.push(Cell::Count(nodes as u64));
        }
        row.extend(counts);
        table.push(row);
        progress.advance(1);
    }
    Ok(table)
}

/// The triangles, each corner turned about the vertical axis by `angle` for each metre above the middle.
fn moved(reference: &Reference<'_>, angle: f32) -> Vec<[Vec3; 3]> {
    let center = reference.center().as_vec3();
    let turn = |p: DVec3| {
        let p = p.as_vec3() - center;
        Quat::from_rotation_y(angle * p.y) * p + center
    };
    reference.triangles().iter().map(|triangle| triangle.map(turn)).collect()
}

/// Seconds a frame, and what the last one did.
fn mean_of(
    frames: &[Vec<View>],
    mut draw: impl FnMut(&Vec<View>) -> Result<(ViewMaps, CutStats), ViewError>,
) -> Result<(f64, CutStats), ViewError> {
    let mut stats = CutStats::default();
    let begun = Instant::now();
    for views in frames {
        (_, stats) = draw(views)?;
    }
    Ok((begun.elapsed().as_secs_f64() / frames.len() as f64, stats))
}

fn best_of(times: u32, mut work: impl FnMut() -> Result<(), ViewError>) -> Result<f64, ViewError> {
    let mut best = f64::INFINITY;
    for _ in 0..times.max(1) {
        let begun = Instant::now();
        work()?;
        best = best.min(begun.elapsed().as_secs_f64());
    }
    Ok(best)
}

/// Views two voxels off surfaces, every spot as likely; from frame to frame each moves by a quarter of a voxel.
fn on_surfaces(reference: &Reference<'_>, cuts: &SvoCuts, settings: &TableSettings) -> Vec<Vec<View>> {
    let mut area = 0.0;
    let areas: Vec<f64> = reference
        .triangles()
        .iter()
        .map(|triangle| {
            area += area_normal(triangle).length();
            area
        })
        .collect();
    let mut random = Random::new(settings.seed);
    let voxel = f64::from(cuts.tree().voxel_size());
    let mut frames = vec![Vec::new(); FRAMES + 1];
    for _ in 0..settings.lights {
        let at = random.unit() * area;
        let [a, b, c] = reference.triangles()[areas.partition_point(|&a| a <= at).min(areas.len() - 1)];
        let (mut s, mut t) = (random.unit(), random.unit());
        if s + t > 1.0 {
            (s, t) = (1.0 - s, 1.0 - t);
        }
        let normal = area_normal(&[a, b, c]).normalize_or_zero();
        let along = (b - a).normalize_or(DVec3::X) * voxel * 0.25;
        let start = a + (b - a) * s + (c - a) * t + normal * voxel * 2.0;
        for (number, views) in frames.iter_mut().enumerate() {
            let position = start + along * number as f64;
            views.push(View::new(position.as_vec3().to_array(), normal.as_vec3().to_array(), FRAC_PI_2));
        }
    }
    frames
}

#[cfg(test)]
mod tests {
    use super::*;
    use manyview_pipeline::bake::Silent;

    #[test]
    fn every_method_has_a_row() {
        let settings = TableSettings { lights: 20, levels: 6, repeats: 1, ..TableSettings::default() };
        let town = ["town:2000".parse().unwrap()];
        let table = manylods(&town, &settings, &Silent).unwrap();
        assert_eq!(table.rows.len(), 8);
        assert!(table.rows.iter().all(|row| matches!(row[3], Cell::Number(ms, _) if ms > 0.0)));
        let single = manylods_single(&town, &settings, &Silent).unwrap();
        let [row] = single.rows.as_slice() else { panic!("one row") };
        let nodes = [8, 9, 10].map(|column| match row[column] {
            Cell::Count(count) => count,
            _ => 0,
        });
        assert!(nodes[0] > nodes[1] && nodes[1] > nodes[2] && nodes[2] > 0, "{nodes:?}");
    }
}
