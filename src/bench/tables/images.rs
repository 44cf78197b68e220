//! Tables I to IV and VI: what one picture's receivers see of the lights.

use super::{Measured, Measurement, MethodSource, Subject, TableSettings, default_rows};
use crate::bench::plot::{Across, Plot, Scale, Series};
use crate::bench::{BenchError, BenchScene, Cell, SceneSource, Table};
use manyview_pipeline::bake::Progress;
use manyview_pipeline::generate::SceneKind;
use manyview_pipeline::rows::RowsOptions;
use manyview_shaders::directions::DirectionSet;

/// The paper's Table I: kinds of scenes that stand in for its own, method, eps_v % and eps_s %.
const PAPER: [(SceneKind, &str, f64, f64); 6] = [
    (SceneKind::City, "rows", 1.2, 0.5),
    (SceneKind::City, "ism", 5.9, 3.2),
    (SceneKind::Forest, "rows", 4.0, 2.1),
    (SceneKind::Forest, "ism", 7.5, 4.7),
    (SceneKind::Park, "rows", 5.7, 2.2),
    (SceneKind::Park, "ism", 16.0, 8.8),
];

fn papers(source: &SceneSource, method: &str) -> [Cell; 2] {
    let SceneSource::Generated { kind, .. } = source else { return [Cell::None, Cell::None] };
    let method = if method.starts_with("rows") { "rows" } else { method };
    let found = PAPER.iter().find(|row| row.0 == *kind && row.1 == method);
    found.map_or([Cell::None, Cell::None], |row| [Cell::Number(row.2, 1), Cell::Number(row.3, 1)])
}

/// Table I: every method on every scene.
pub fn scenes(
    sources: &[SceneSource],
    methods: &dyn MethodSource,
    settings: &TableSettings,
    progress: &dyn Progress,
) -> Result<Table, BenchError> {
    let names = settings.chosen(methods)?;
    let title = format!("Table I: error and time of each method, {} lights", settings.lights);
    let more = ["the paper's eps_v %", "the paper's eps_s %"];
    let mut table = Table::new("table-1-scenes", title, &columns(&["scene", "triangles"], &more));
    let mut groups = Vec::new();
    let mut all = Vec::new();
    progress.begin("scenes", (sources.len() * names.len()) as u64, "methods");
    for source in sources {
        let scene = BenchScene::load(source)?;
        let subject = Subject::new(&scene, settings.levels, settings.size)?;
        let measurement = Measurement::new(&subject, settings.lights, settings)?;
        for name in &names {
            let measured = step(progress, || measurement.of(methods, name, default_rows()))?;
            let head = [Cell::Text(scene.name.clone()), Cell::Count(scene.scene.drawn_triangles())];
            table.push([&head, measured.cells().as_slice(), &papers(source, name)].concat());
            all.push((groups.len() as f64, measured));
        }
        groups.push(scene.name);
    }
    for (what, label, value) in [
        ("errors", "visibility error eps_v, %", (|m: &Measured| m.errors.eps_v()) as fn(&Measured) -> f64),
        ("speed", "million rays a second", |m| m.rays_per_second() * 1e-6),
    ] {
        table.plots.push(Plot {
            name: format!("table-1-{what}"),
            title: format!("{label}, {} lights", settings.lights),
            x_label: String::new(),
            y_label: label.to_owned(),
            across: Across::Names(groups.clone()),
            y_scale: Scale::Linear,
            series: series(&names, &all, value),
        });
    }
    Ok(table)
}

/// Table II: error and time of every method against the number of lights.
pub fn lights(
    source: &SceneSource,
    counts: &[u32],
    methods: &dyn MethodSource,
    settings: &TableSettings,
    progress: &dyn Progress,
) -> Result<Table, BenchError> {
    let names = settings.chosen(methods)?;
    let scene = BenchScene::load(source)?;
    let title = format!("Table II: {}, error and time against lights", scene.name);
    let mut table =
        Table::new(format!("table-2-lights-{}", scene.name), title, &columns(&["lights"], &["ns a ray"]));
    let subject = Subject::new(&scene, settings.levels, settings.size)?;
    let mut all = Vec::new();
    progress.begin("lights", (counts.len() * names.len()) as u64, "methods");
    for &count in counts {
        let measurement = Measurement::new(&subject, count, settings)?;
        for name in &names {
            let measured = step(progress, || measurement.of(methods, name, default_rows()))?;
            let ns = Cell::Number(1e9 / measured.rays_per_second(), 1);
            table.push([&[Cell::Count(u64::from(count))], measured.cells().as_slice(), &[ns]].concat());
            all.push((f64::from(count), measured));
        }
    }
    let plot = |what: &str, label: &str, y_scale, value: fn(&Measured) -> f64| Plot {
        name: format!("table-2-{what}-{}", scene.name),
        title: format!("{}: {label} against lights", scene.name),
        x_label: "lights".to_owned(),
        y_label: label.to_owned(),
        across: Across::Numbers(Scale::Log),
        y_scale,
        series: series(&names, &all, value),
    };
    table.plots.push(plot("errors", "eps_v, %", Scale::Linear, |m| m.errors.eps_v()));
    table.plots.push(plot("time", "ns a ray and thread pool", Scale::Log, |m| 1e9 / m.rays_per_second()));
    Ok(table)
}

/// Table III: error of rows against voxels a side (as log2).
pub fn resolution(
    sources: &[SceneSource],
    bits: &[u32],
    methods: &dyn MethodSource,
    settings: &TableSettings,
    progress: &dyn Progress,
) -> Result<Table, BenchError> {
    let variants: Vec<_> = bits
        .iter()
        .map(|&bits| {
            (f64::from(1 << bits), (1u32 << bits).to_string(), RowsOptions { bits, ..default_rows() })
        })
        .collect();
    let words = ["table-3-resolution", "Table III: error of rows against voxels a side", "voxels a side"];
    rows_variants(words, &variants, sources, methods, settings, progress)
}

/// Table IV: error of rows against the sampled directions; latitude-longitude sets of `steps` × `steps`.
pub fn directions(
    sources: &[SceneSource],
    steps: &[u32],
    methods: &dyn MethodSource,
    settings: &TableSettings,
    progress: &dyn Progress,
) -> Result<Table, BenchError> {
    let variants: Vec<_> = steps
        .iter()
        .map(|&steps| {
            let directions = DirectionSet::LatLong { thetas: steps, phis: steps };
            (f64::from(steps), directions.to_string(), RowsOptions { directions, ..default_rows() })
        })
        .collect();
    let words = [
        "table-4-directions",
        "Table IV: error of rows against directions",
        "directions along theta and phi",
    ];
    rows_variants(words, &variants, sources, methods, settings, progress)
}

fn rows_variants(
    [name, title, x_label]: [&'static str; 3],
    variants: &[(f64, String, RowsOptions)],
    sources: &[SceneSource],
    methods: &dyn MethodSource,
    settings: &TableSettings,
    progress: &dyn Progress,
) -> Result<Table, BenchError> {
    let names: Vec<_> =
        settings.chosen(methods)?.into_iter().filter(|name| name.starts_with("rows")).collect();
    let mut table = Table::new(name, title, &columns(&["scene", x_label], &[]));
    let mut lines: Vec<Series> = Vec::new();
    progress.begin("rows", (sources.len() * names.len() * variants.len()) as u64, "variants");
    for source in sources {
        let scene = BenchScene::load(source)?;
        let subject = Subject::new(&scene, settings.levels, settings.size)?;
        let measurement = Measurement::new(&subject, settings.lights, settings)?;
        for name in &names {
            let mut line = Series { name: format!("{} {name}", scene.name), points: Vec::new() };
            for (x, text, rows) in variants {
                let measured = step(progress, || measurement.of(methods, name, *rows))?;
                let head = [Cell::Text(scene.name.clone()), Cell::Text(text.clone())];
                table.push([&head, measured.cells().as_slice()].concat());
                line.points.push((*x, measured.errors.eps_v()));
            }
            lines.push(line);
        }
    }
    table.plots.push(Plot {
        name: name.to_owned(),
        title: title.to_owned(),
        x_label: x_label.to_owned(),
        y_label: "visibility error eps_v, %".to_owned(),
        across: Across::Numbers(Scale::Log),
        y_scale: Scale::Linear,
        series: lines,
    });
    Ok(table)
}

/// Table VI: rays a second of every method against the scene's triangles.
pub fn throughput(
    sources: &[SceneSource],
    methods: &dyn MethodSource,
    settings: &TableSettings,
    progress: &dyn Progress,
) -> Result<Table, BenchError> {
    let names = settings.chosen(methods)?;
    let title = format!("Table VI: rays a second against triangles, {} lights", settings.lights);
    let more = ["ns a ray", "ns a ray to the first scene's"];
    let mut table = Table::new("table-6-throughput", title, &columns(&["scene", "triangles"], &more));
    let mut all: Vec<(f64, Measured)> = Vec::new();
    progress.begin("throughput", (sources.len() * names.len()) as u64, "methods");
    for source in sources {
        let scene = BenchScene::load(source)?;
        let triangles = scene.scene.drawn_triangles();
        let subject = Subject::new(&scene, settings.levels, settings.size)?;
        let measurement = Measurement::new(&subject, settings.lights, settings)?;
        for name in &names {
            let measured = step(progress, || measurement.of(methods, name, default_rows()))?;
            let first =
                all.iter().find(|(_, first)| first.method == *name).map_or(&measured, |(_, first)| first);
            let ratio = first.rays_per_second() / measured.rays_per_second();
            let more = [Cell::Number(1e9 / measured.rays_per_second(), 1), Cell::Number(ratio, 2)];
            let head = [Cell::Text(scene.name.clone()), Cell::Count(triangles)];
            table.push([&head, measured.cells().as_slice(), &more].concat());
            all.push((triangles as f64, measured));
        }
    }
    table.plots.push(Plot {
        name: "table-6-throughput".to_owned(),
        title: "Rays a second against triangles".to_owned(),
        x_label: "triangles".to_owned(),
        y_label: "million rays a second".to_owned(),
        across: Across::Numbers(Scale::Log),
        y_scale: Scale::Log,
        series: series(&names, &all, |m| m.rays_per_second() * 1e-6),
    });
    Ok(table)
}

/// Does one method's measurement, unless the user has given up.
fn step<R>(progress: &dyn Progress, work: impl FnOnce() -> Result<R, BenchError>) -> Result<R, BenchError> {
    if progress.cancelled() {
        return Err(BenchError::Cancelled);
    }
    let result = work()?;
    progress.advance(1);
    Ok(result)
}

fn columns(before: &[&'static str], after: &[&'static str]) -> Vec<&'static str> {
    [before, &Measured::COLUMNS, after].concat()
}

fn series(names: &[String], all: &[(f64, Measured)], value: fn(&Measured) -> f64) -> Vec<Series> {
    let of = |name: &String| Series {
        name: name.clone(),
        points: all.iter().filter(|(_, m)| m.method == *name).map(|(x, m)| (*x, value(m))).collect(),
    };
    names.iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::tables::OurMethods;
    use manyview_pipeline::bake::Silent;

    fn settings() -> TableSettings {
        TableSettings { size: [24, 14], lights: 40, levels: 6, repeats: 1, ..TableSettings::default() }
    }

    fn number(cell: &Cell) -> f64 {
        match cell {
            Cell::Number(number, _) => *number,
            Cell::Count(count) => *count as f64,
            other => panic!("{other:?} is no number"),
        }
    }

    fn column(table: &Table, name: &str) -> usize {
        table.columns.iter().position(|column| *column == name).unwrap()
    }

    fn settings_of(methods: &[&str]) -> TableSettings {
        TableSettings { methods: methods.iter().map(|name| (*name).to_owned()).collect(), ..settings() }
    }

    #[test]
    fn rays_are_hardly_wrong_and_receivers_make_room_for_lights() {
        let source = "city:2000".parse().unwrap();
        let settings = TableSettings { most_pairs: 500, ..settings_of(&["bvh"]) };
        let table = lights(&source, &[10, 100], &OurMethods::default(), &settings, &Silent).unwrap();
        assert_eq!(table.rows.len(), 2);
        for (row, receivers) in table.rows.iter().zip([50.0, 5.0]) {
            // Rays in `f32` may pass an edge on its other side.
            assert!(number(&row[column(&table, "eps_v %")]) <= 0.4);
            assert!(number(&row[column(&table, "eps_s %")]) <= 0.4);
            assert_eq!(number(&row[column(&table, "receivers")]), receivers);
        }
        assert_eq!(table.plots.len(), 2);
    }

    #[test]
    fn finer_rows_are_less_wrong() {
        let source = "city:2000".parse().unwrap();
        let sources = std::slice::from_ref(&source);
        let steps =
            directions(sources, &[4, 24], &OurMethods::default(), &settings_of(&["rows"]), &Silent).unwrap();
        let errors: Vec<_> = steps.rows.iter().map(|row| number(&row[column(&steps, "eps_v %")])).collect();
        assert!(errors[0] > errors[1] + 1.0 && errors[1] > 0.0, "{errors:?}");
        assert_eq!(steps.plots[0].series[0].points.len(), 2);
    }

    #[test]
    fn all_methods_stand_side_by_side() {
        let sources = ["city:2000".parse().unwrap()];
        let small = TableSettings { most_pairs: 4000, ..settings_of(&["brickmap", "ism", "bvh"]) };
        let table = scenes(&sources, &OurMethods::default(), &small, &Silent).unwrap();
        let errors: Vec<_> = table.rows.iter().map(|row| number(&row[column(&table, "eps_v %")])).collect();
        assert!(errors[0] > errors[2] && errors[1] > errors[2] && errors[0] < 30.0, "{errors:?}");
        assert_eq!(table.rows[1][column(&table, "the paper's eps_v %")], Cell::Number(5.9, 1));
        assert_eq!((table.plots.len(), table.plots[0].series.len()), (2, 3));
    }

    #[test]
    fn unknown_methods_are_refused_before_any_work() {
        let sources = ["no such file.glb".parse().unwrap()];
        let error =
            scenes(&sources, &OurMethods::default(), &settings_of(&["bvh", "guess"]), &Silent).unwrap_err();
        assert!(error.to_string().contains("`guess`; choose of rows, "), "{error}");
    }
}
