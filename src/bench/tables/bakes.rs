//! Tables of whole bakes: what was estimated beside what happened, and how costs grow.
//!
//! | table | question |
//! |---|---|
//! | [`bake_estimates`] | is what a bake says before it starts within a factor of what happens? |
//! | [`bake_growth`] | how do time and memory grow with triangles, levels, directions, voxels a side and threads? |
//!
//! # Practice
//! Peak memory is that of a whole process, so that every bake needs a process of its own: whoever calls gives a function
//! that starts one.

use crate::bench::plot::{Across, Plot, Scale, Series};
use crate::bench::{BenchError, Cell, SceneSource, Table};

/// A bake to measure.
#[derive(Debug, Clone, PartialEq)]
pub struct BakeCase {
    /// Its scene.
    pub scene: SceneSource,
    /// Octree depth.
    pub levels: u32,
    /// Steps of both angles of the directions.
    pub directions: u32,
    /// Voxels a side of the rows.
    pub rows: u32,
    /// Threads, or `None` for one per processor.
    pub threads: Option<u32>,
}

/// What a bake took, or was thought to take.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct BakeCost {
    /// Triangles drawn.
    pub triangles: u64,
    /// Leaves of the octree.
    pub leaves: u64,
    /// Points that rows are made from.
    pub points: u64,
    /// Peak memory of its process.
    pub peak_bytes: u64,
    /// Size of the archive.
    pub archive_bytes: u64,
    /// Time without the import.
    pub seconds: f64,
}

/// What a bake told before and after.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredBake {
    /// Before it started.
    pub estimated: BakeCost,
    /// When it was done.
    pub measured: BakeCost,
    /// The limit of its memory.
    pub limit_bytes: u64,
}

/// Starts a bake and waits for it; `None` where it was refused for want of memory.
pub type MeasureBake<'a> = dyn FnMut(&BakeCase) -> Result<Option<MeasuredBake>, BenchError> + 'a;

fn name_of(scene: &SceneSource) -> String {
    match scene {
        SceneSource::File(path) => {
            path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
        }
        SceneSource::Generated { kind, triangles } => format!("{kind}:{triangles}"),
    }
}

fn mebibytes(bytes: u64) -> Cell {
    Cell::Number(bytes as f64 / f64::from(1 << 20), 1)
}

fn ratio(estimated: f64, measured: f64) -> Cell {
    if measured > 0.0 { Cell::Number(estimated / measured, 2) } else { Cell::None }
}

/// What is estimated over what is measured, scene by scene, for each number of levels.
pub fn bake_estimates(
    scenes: &[SceneSource],
    levels: &[u32],
    directions: u32,
    measure: &mut MeasureBake<'_>,
) -> Result<Table, BenchError> {
    let columns = [
        "scene",
        "levels",
        "triangles",
        "leaves",
        "limit MiB",
        "peak MiB",
        "archive MiB",
        "seconds",
        "leaves est/was",
        "points est/was",
        "peak est/was",
        "archive est/was",
        "seconds est/was",
    ];
    let title = "Bakes: estimates before the work over what was measured (whole processes)";
    let mut table = Table::new("bake-estimates", title, &columns);
    for scene in scenes {
        for &levels in levels {
            let case = BakeCase { scene: scene.clone(), levels, directions, rows: 128, threads: None };
            let mut row = vec![Cell::Text(name_of(scene)), Cell::Count(levels.into())];
            match measure(&case)? {
                None => row.resize(columns.len(), Cell::None),
                Some(MeasuredBake { estimated, measured, limit_bytes }) => row.extend([
                    Cell::Count(measured.triangles),
                    Cell::Count(measured.leaves),
                    mebibytes(limit_bytes),
                    mebibytes(measured.peak_bytes),
                    mebibytes(measured.archive_bytes),
                    Cell::Number(measured.seconds, 2),
                    ratio(estimated.leaves as f64, measured.leaves as f64),
                    ratio(estimated.points as f64, measured.points as f64),
                    ratio(estimated.peak_bytes as f64, measured.peak_bytes as f64),
                    ratio(estimated.archive_bytes as f64, measured.archive_bytes as f64),
                    ratio(estimated.seconds, measured.seconds),
                ]),
            }
            table.push(row);
        }
    }
    Ok(table)
}

/// Something that bakes grow with.
#[derive(Debug, Clone)]
pub struct Growth {
    /// Its name, for files and columns.
    pub name: &'static str,
    /// Its values, each with the bake that has it.
    pub cases: Vec<(f64, BakeCase)>,
}

/// Time, memory and size against one setting, with a plot of time and one of memory. `power` is the exponent of growth
/// of the time since the row above: 1 where it grows as the setting does.
pub fn bake_growth(growth: &Growth, measure: &mut MeasureBake<'_>) -> Result<Table, BenchError> {
    let columns = [
        growth.name,
        "drawn triangles",
        "leaves",
        "seconds",
        "power",
        "peak MiB",
        "archive MiB",
        "peak est/was",
        "archive est/was",
        "seconds est/was",
    ];
    let title = format!("Bakes: time and memory against {}", growth.name);
    let mut table = Table::new(format!("bake-growth-{}", growth.name), title, &columns);
    let mut seconds: Vec<(f64, f64)> = Vec::new();
    let mut peaks: Vec<(f64, f64)> = Vec::new();
    for (value, case) in &growth.cases {
        let Some(MeasuredBake { estimated, measured, .. }) = measure(case)? else { continue };
        let power = seconds.last().map_or(Cell::None, |(before, took)| {
            Cell::Number((measured.seconds / took).ln() / (value / before).ln(), 2)
        });
        seconds.push((*value, measured.seconds));
        peaks.push((*value, measured.peak_bytes as f64 / f64::from(1 << 20)));
        table.push(vec![
            Cell::Count(*value as u64),
            Cell::Count(measured.triangles),
            Cell::Count(measured.leaves),
            Cell::Number(measured.seconds, 2),
            power,
            mebibytes(measured.peak_bytes),
            mebibytes(measured.archive_bytes),
            ratio(estimated.peak_bytes as f64, measured.peak_bytes as f64),
            ratio(estimated.archive_bytes as f64, measured.archive_bytes as f64),
            ratio(estimated.seconds, measured.seconds),
        ]);
    }
    for (what, label, points) in [("time", "seconds", seconds), ("memory", "peak memory, MiB", peaks)] {
        table.plots.push(Plot {
            name: format!("{}-{what}", table.name),
            title: format!("Bakes: {what} against {}", growth.name),
            x_label: growth.name.to_owned(),
            y_label: label.to_owned(),
            across: Across::Numbers(Scale::Log),
            y_scale: Scale::Log,
            series: vec![Series { name: what.to_owned(), points }],
        });
    }
    Ok(table)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn town(triangles: u64) -> SceneSource {
        format!("town:{triangles}").parse().unwrap()
    }

    fn measured(seconds: f64) -> MeasuredBake {
        let measured = BakeCost {
            triangles: 9,
            leaves: 100,
            points: 10,
            peak_bytes: 2 << 20,
            archive_bytes: 1 << 20,
            seconds,
        };
        let estimated = BakeCost { leaves: 150, peak_bytes: 3 << 20, ..measured };
        MeasuredBake { estimated, measured, limit_bytes: 8 << 20 }
    }

    #[test]
    fn estimates_stand_beside_what_happened() {
        let mut seen = Vec::new();
        let mut measure = |case: &BakeCase| {
            seen.push(case.levels);
            Ok((case.levels < 9).then(|| measured(2.0)))
        };
        let table = bake_estimates(&[town(2000)], &[8, 9], 90, &mut measure).unwrap();
        assert_eq!(seen, [8, 9]);
        assert!(
            table
                .markdown()
                .contains("| town:2000 | 8 | 9 | 100 | 8.0 | 2.0 | 1.0 | 2.00 | 1.50 | 1.00 | 1.50 |")
        );
        assert_eq!(table.rows[1][2..], vec![Cell::None; 11], "refused");
    }

    #[test]
    fn growth_has_the_power_of_its_time() {
        let case =
            |directions| BakeCase { scene: town(2000), levels: 8, directions, rows: 128, threads: None };
        let growth = Growth { name: "directions", cases: vec![(10.0, case(10)), (20.0, case(20))] };
        let mut measure = |case: &BakeCase| Ok(Some(measured(f64::from(case.directions).powi(2))));
        let table = bake_growth(&growth, &mut measure).unwrap();
        assert_eq!(table.rows[0][4], Cell::None);
        assert_eq!(table.rows[1][4], Cell::Number(2.0, 2));
        assert_eq!(table.plots.len(), 2);
    }
}
