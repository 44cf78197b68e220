//! What MegaViews does for so many views: pairs, sharing, and time by component; and what the lists of ManyLoDs would take.

use super::views::{ViewKind, ViewSubject, ViewTableSettings, failed, rows_of_kinds};
use crate::bench::{BenchError, Cell, Table};
use crate::manylods::SvoCuts;
use crate::megaviews::MegaViews;
use manyview_pipeline::bake::Progress;
use manyview_shaders::scene_tree::SceneTree;
use std::sync::Arc;
use std::time::Instant;

/// Views whose lists of ManyLoDs stand for those of all.
const LISTED_VIEWS: usize = 512;

/// Work and time by component against the number of views.
pub fn view_work(
    subject: &ViewSubject,
    kinds: &[ViewKind<'_>],
    counts: &[u32],
    settings: &ViewTableSettings,
    progress: &dyn Progress,
) -> Result<Table, BenchError> {
    let title = format!("{}: work of MegaViews, and the lists of ManyLoDs", subject.name);
    let mut table = Table::new(
        format!("views-work-{}", subject.name),
        title,
        &[
            "kind of views",
            "views",
            "maps",
            "view nodes",
            "points a view",
            "near leaves a view",
            "views a drawn node",
            "hierarchy s",
            "draw s of all threads",
            "fuse s of all threads",
            "whole s",
            "maps MiB",
            "ManyLoDs points a view",
            "ManyLoDs maps and lists MiB",
        ],
    );
    let scene = Arc::new(SceneTree::new(&subject.svo, false));
    let mega_views = MegaViews::new(Arc::clone(&scene));
    let many_lods = SvoCuts::new(scene);
    table.rows = rows_of_kinds(kinds, counts, "work", progress, |views| {
        let drawing = &settings.drawing;
        let (mut maps, mut bytes) = (0u64, 0u64);
        let clock = Instant::now();
        let stats = mega_views
            .render_counted(views, drawing, &mut |pass| {
                maps += pass.centers().len() as u64;
                bytes += pass.bytes();
                Ok(())
            })
            .map_err(|source| failed("megaviews", source))?;
        let seconds = clock.elapsed().as_secs_f64();
        let step = views.len().div_ceil(LISTED_VIEWS).max(1);
        let some: Vec<_> = views.iter().copied().step_by(step).collect();
        let lists = many_lods
            .render_counted(&some, drawing, &mut |_| Ok(()))
            .map_err(|source| failed("manylods", source))?;
        let a_view = |count: u64| Cell::Number(count as f64 / views.len().max(1) as f64, 1);
        let listed = some.len().max(1) as f64;
        let many_lods_bytes =
            views.len() as f64 * (drawing.map_bytes() as f64 + lists.paper_list_bytes as f64 / listed);
        let mib = |bytes: f64| Cell::Number(bytes / f64::from(1 << 20), 0);
        Ok(vec![
            Cell::Count(maps),
            Cell::Count(stats.view_nodes),
            a_view(stats.points),
            a_view(stats.near_leaves),
            Cell::Number(stats.sharing, 1),
            Cell::Number(stats.hierarchy_seconds, 3),
            Cell::Number(stats.draw_seconds, 2),
            Cell::Number(stats.fuse_seconds, 2),
            Cell::Number(seconds, 2),
            mib(bytes as f64),
            Cell::Number(lists.drawn as f64 / listed, 0),
            mib(many_lods_bytes),
        ])
    })?;
    Ok(table)
}
