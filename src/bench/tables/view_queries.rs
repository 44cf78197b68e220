//! \[MV\] §3.4: what fusion is worth. Single texels of random views, asked from fused maps and without fusion.

use super::views::{ViewKind, ViewSubject, ViewTableSettings, failed, rows_of_kinds};
use crate::bench::{BenchError, Cell, Random, Table};
use crate::megaviews::MegaViews;
use crate::views::{View, ViewError, ViewRenderer};
use manyview_pipeline::bake::Progress;
use manyview_shaders::paraboloid::texel_count;
use manyview_shaders::scene_tree::SceneTree;
use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

/// Queries that are timed, by one thread.
const QUERIES: usize = 1 << 20;

/// Drawing, memory and a query with and without fusion, against the number of views. Kinds whose maps do not fit are left
/// empty.
pub fn view_queries(
    subject: &ViewSubject,
    kinds: &[ViewKind<'_>],
    counts: &[u32],
    settings: &ViewTableSettings,
    progress: &dyn Progress,
) -> Result<Table, BenchError> {
    let title = format!("{}: queries of fused maps, and without fusion", subject.name);
    let columns = [
        "kind of views",
        "views",
        "fused ms",
        "unfused ms",
        "fused MiB",
        "unfused MiB",
        "fused ns a query",
        "unfused ns a query",
        "queries a view for equal time",
    ];
    let mut table = Table::new(format!("views-queries-{}", subject.name), title, &columns);
    let mega_views = MegaViews::new(Arc::new(SceneTree::new(&subject.svo, false)));
    table.rows = rows_of_kinds(kinds, counts, "queries", progress, |views| {
        match queried(&mega_views, views, settings) {
            Err(ViewError::Budget { .. }) => Ok(vec![Cell::None; columns.len() - 2]),
            cells => cells.map_err(|source| failed("megaviews", source)),
        }
    })?;
    Ok(table)
}

fn queried(
    mega_views: &MegaViews,
    views: &[View],
    settings: &ViewTableSettings,
) -> Result<Vec<Cell>, ViewError> {
    let drawing = &settings.drawing;
    let mut random = Random::new(7);
    let texels = texel_count(drawing.resolution);
    let queries: Vec<[usize; 2]> = (0..QUERIES)
        .map(|_| [views.len(), texels].map(|end| (random.unit() * end as f64) as usize))
        .collect();
    let begun = Instant::now();
    let fused = mega_views.render_views(views, drawing)?;
    let fused_seconds = begun.elapsed().as_secs_f64();
    let fused_query =
        seconds_a_query(&queries, |view, texel| fused.depth(fused.map_of()[view] as usize, texel));
    let fused_bytes = fused.bytes();
    drop(fused);
    let begun = Instant::now();
    let unfused = mega_views.render_unfused(views, drawing)?;
    let unfused_seconds = begun.elapsed().as_secs_f64();
    let unfused_query = seconds_a_query(&queries, |view, texel| unfused.depth(view, texel));
    let saved = (fused_seconds - unfused_seconds) / (unfused_query - fused_query) / views.len() as f64;
    let mib = |bytes: u64| Cell::Number(bytes as f64 / f64::from(1 << 20), 0);
    Ok(vec![
        Cell::Number(fused_seconds * 1e3, 0),
        Cell::Number(unfused_seconds * 1e3, 0),
        mib(fused_bytes),
        mib(unfused.bytes()),
        Cell::Number(fused_query * 1e9, 0),
        Cell::Number(unfused_query * 1e9, 0),
        Cell::Number(saved.max(0.0), 1),
    ])
}

fn seconds_a_query(queries: &[[usize; 2]], depth: impl Fn(usize, usize) -> f32) -> f64 {
    let begun = Instant::now();
    let sum: f64 = queries.iter().map(|&[view, texel]| f64::from(depth(view, texel).min(1e9))).sum();
    black_box(sum);
    begun.elapsed().as_secs_f64() / queries.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::BenchScene;
    use crate::views::ViewSettings;
    use manyview_pipeline::bake::Silent;
    use manyview_pipeline::generate::{SceneKind, generate};

    #[test]
    fn what_does_not_fit_has_empty_cells() {
        let scene = BenchScene::new("town".to_owned(), generate(SceneKind::Town, 2000, 1)).unwrap();
        let subject = ViewSubject::new(&scene, 6).unwrap();
        let drawing = ViewSettings { budget_bytes: 8 << 20, ..ViewSettings::new(8) };
        let settings = ViewTableSettings { drawing, ..ViewTableSettings::default() };
        let kinds = [subject.surface_views(1)];
        let table = view_queries(&subject, &kinds, &[9, 100_000], &settings, &Silent).unwrap();
        assert_eq!(table.rows.len(), 2);
        assert_eq!([2, 3].map(|column| table.rows[0][column] == Cell::None), [false; 2]);
        assert!(table.rows[1][2..].iter().all(|cell| *cell == Cell::None));
    }
}
