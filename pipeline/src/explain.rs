//! Why a bake would do what it would do: every step, hit or miss, with the reason and both values.
//!
//! Keys decide what is reused; the [`Journal`] of the last bake of the same output says what is behind a key that has
//! changed.

use crate::bake::{BakeError, BakeOptions};
use crate::cube::SceneCube;
use crate::import::SourceFile;
use crate::journal::{Journal, Object};
use crate::octree::cell_of_morton;
use crate::regions::RegionGrid;
use crate::rows_step::RowsJob;
use crate::runs::Runs;
use crate::scene::Scene;
use crate::steps::{LOOKS, SHAPES, StepKind, Steps};
use manyview_shaders::directions::RowLattice;
use manyview_shaders::raster::Grid;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;

/// Why a step has to be made.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "reason", rename_all = "snake_case")]
pub enum Reason {
    /// The cache remembers no bake of this output.
    FirstBake,
    /// A file of the scene has another content, has come or is gone (`None`).
    File {
        /// From the scene's folder.
        path: String,
        /// Digest of the content.
        old: Option<String>,
        /// Digest of the content.
        new: Option<String>,
    },
    /// A parameter has another value.
    Parameter {
        /// The option.
        name: String,
        /// Its value in the last bake.
        old: String,
        /// Its value now.
        new: String,
    },
    /// The scene has outgrown its cube, or left much of it: every voxel has another place.
    Cube {
        /// Origin and edge, metres.
        old: ([f64; 3], f64),
        /// Origin and edge, metres.
        new: ([f64; 3], f64),
    },
    /// The scene's bounds have changed, and with them the lattice of all rows.
    Bounds {
        /// Smallest and largest corner, metres.
        old: [[f64; 3]; 2],
        /// Smallest and largest corner, metres.
        new: [[f64; 3]; 2],
    },
    /// An object stands elsewhere.
    Moved {
        /// The mesh.
        object: String,
        /// Its origin, metres.
        old: [f64; 3],
        /// Its origin, metres.
        new: [f64; 3],
    },
    /// An object is new.
    Added {
        /// The mesh.
        object: String,
        /// Its origin, metres.
        new: [f64; 3],
    },
    /// An object is gone.
    Removed {
        /// The mesh.
        object: String,
        /// Its origin, metres.
        old: [f64; 3],
    },
    /// An object has another shape, turn or size.
    Reshaped {
        /// The mesh.
        object: String,
        /// Digest of the shape.
        old: String,
        /// Digest of the shape.
        new: String,
    },
    /// An object has another look: material, texture, normals.
    Repainted {
        /// The mesh.
        object: String,
        /// Digest of the look.
        old: String,
        /// Digest of the look.
        new: String,
    },
    /// The lights have changed.
    Lights {
        /// Their digest.
        old: String,
        /// Their digest.
        new: String,
    },
    /// Nothing has changed, but the cache does not have the result: it was never made, removed by `gc`, or broken.
    NotInCache,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let place = |[x, y, z]: &[f64; 3]| format!("({x:.3}, {y:.3}, {z:.3})");
        let content = |digest: &Option<String>| digest.clone().unwrap_or("missing".to_owned());
        match self {
            Self::FirstBake => f.write_str("the cache remembers no bake of this output"),
            Self::File { path, old, new } => {
                write!(f, "the file `{path}` has changed ({} → {})", content(old), content(new))
            }
            Self::Parameter { name, old, new } => write!(f, "{name} has changed ({old} → {new})"),
            Self::Cube { old, new } => write!(
                f,
                "the scene cube has changed ({} m from {} → {} m from {})",
                old.1,
                place(&old.0),
                new.1,
                place(&new.0)
            ),
            Self::Bounds { old, new } => write!(
                f,
                "the scene's bounds have changed ({} to {} → {} to {})",
                place(&old[0]),
                place(&old[1]),
                place(&new[0]),
                place(&new[1])
            ),
            Self::Moved { object, old, new } => {
                write!(f, "`{object}` has moved ({} → {})", place(old), place(new))
            }
            Self::Added { object, new } => write!(f, "`{object}` is new, at {}", place(new)),
            Self::Removed { object, old } => write!(f, "`{object}` is gone from {}", place(old)),
            Self::Reshaped { object, old, new } => {
                write!(f, "`{object}` has another shape ({old} → {new})")
            }
            Self::Repainted { object, old, new } => {
                write!(f, "`{object}` has another look ({old} → {new})")
            }
            Self::Lights { old, new } => write!(f, "the lights have changed ({old} → {new})"),
            Self::NotInCache => f.write_str("nothing has changed, but the cache does not have it"),
        }
    }
}

/// What would become of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// The cache has the result.
    Hit,
    /// It is made anew.
    Miss,
    /// It is made from the last bake's, by what differs.
    Patch,
}

/// One step, or several of a kind with the same fate.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Step {
    /// What kind.
    pub kind: StepKind,
    /// Which one: a brick's place in the grid of bricks, or how many there are.
    pub item: String,
    /// Steps that this line stands for.
    pub count: u64,
    /// What would become of it.
    pub state: State,
    /// Why, unless it is a hit; the first few causes.
    pub reasons: Vec<Reason>,
    /// How much work: triangles of bricks and points, directions of rows.
    pub cost: u64,
    /// Of what the work is counted.
    pub unit: &'static str,
}

/// Causes that are named for one step.
const NAMED_REASONS: usize = 3;

/// All steps of a bake.
pub(crate) fn explain(
    scene: &Scene,
    files: &[SourceFile],
    options: &BakeOptions,
    runs: &Runs,
    cube: SceneCube,
    steps: &Steps,
    last: Option<&Journal>,
) -> Result<Vec<Step>, BakeError> {
    let now = Journal::new(scene, runs, files, options, cube);
    let changes = Changes::between(last, &now);
    let mut lines = vec![Step {
        kind: StepKind::Import,
        item: format!("{} files", files.len()),
        count: 1,
        state: State::Miss,
        reasons: changes.or_not_in_cache(changes.files.clone()),
        cost: scene.drawn_triangles(),
        unit: "triangles",
    }];
    let grid = RegionGrid { cube, grid: Grid::new(options.levels) };
    bricks(grid, scene, runs, steps, &changes, &mut lines);
    if let Some(rows) = options.rows {
        let lattice = RowLattice::new(now.bounds[0], now.bounds[1]);
        let progress = &crate::bake::Silent;
        let job = RowsJob { scene, runs, options: rows, lattice, device: None, steps, progress };
        let forecast = job.forecast();
        let reasons = if changes.bounds.is_empty() {
            changes.of_kind(&changes.rows_parameters, changes.objects.iter().filter(|o| o.is_shape))
        } else {
            changes.bounds.clone()
        };
        let reasons = changes.or_not_in_cache(reasons);
        let [made, patched] = [forecast.made_directions, forecast.patched_directions];
        for (state, count, cost) in
            [(State::Hit, forecast.points.0, 0), (State::Miss, forecast.points.1, forecast.points_triangles)]
        {
            let reasons = if state == State::Hit { Vec::new() } else { reasons.clone() };
            push(&mut lines, StepKind::Points, count, state, reasons, cost, "triangles");
        }
        for (state, count, cost) in [
            (State::Hit, forecast.rows[0], 0),
            (State::Patch, forecast.rows[1], patched),
            (State::Miss, forecast.rows[2], made),
        ] {
            let reasons = if state == State::Hit { Vec::new() } else { reasons.clone() };
            push(&mut lines, StepKind::Rows, count, state, reasons, cost, "directions");
        }
    }
    Ok(lines)
}

fn push(
    lines: &mut Vec<Step>,
    kind: StepKind,
    count: u64,
    state: State,
    reasons: Vec<Reason>,
    cost: u64,
    unit: &'static str,
) {
    if count > 0 {
        lines.push(Step { kind, item: format!("{count} of them"), count, state, reasons, cost, unit });
    }
}

fn bricks(
    grid: RegionGrid,
    scene: &Scene,
    runs: &Runs,
    steps: &Steps,
    changes: &Changes,
    lines: &mut Vec<Step>,
) {
    let mut hits = [0, 0];
    for cell in grid.cells(scene, runs).cells {
        let keys = grid.keys(runs, &cell);
        let [x, y, z] = cell_of_morton(cell.code);
        let edge = grid.cube.size / f64::from(grid.grid.size() >> grid.bits());
        let min = [0, 1, 2].map(|i| grid.cube.origin[i] + f64::from([x, y, z][i]) * edge);
        let cost = cell.runs.iter().map(|run| runs.runs[*run as usize].triangles.len() as u64).sum();
        let has_shape = steps.contains(SHAPES, &keys.shape);
        let is_empty = has_shape && grid.is_empty(steps, &keys);
        let parts = [
            (StepKind::Bricks, has_shape),
            (StepKind::Attributes, is_empty || steps.contains(LOOKS, &keys.look)),
        ];
        for ((kind, is_hit), hits) in parts.into_iter().zip(&mut hits) {
            if is_hit {
                *hits += 1;
                continue;
            }
            let here = changes.objects.iter().filter(|object| {
                (object.is_shape || kind == StepKind::Attributes) && object.reaches(min, edge)
            });
            let reasons = if changes.cube.is_empty() {
                changes.of_kind(&changes.octree_parameters, here)
            } else {
                changes.cube.clone()
            };
            let reasons = changes.or_not_in_cache(reasons);
            let item = format!("{x} {y} {z}");
            lines.push(Step { kind, item, count: 1, state: State::Miss, reasons, cost, unit: "triangles" });
        }
    }
    for (kind, hits) in [StepKind::Bricks, StepKind::Attributes].into_iter().zip(hits) {
        push(lines, kind, hits, State::Hit, Vec::new(), 0, "triangles");
    }
}

/// A change of an object, and where it shows.
struct ObjectChange {
    reason: Reason,
    /// Whether shapes differ, not looks alone.
    is_shape: bool,
    /// World bounds of what was and of what is.
    bounds: Vec<[[f64; 3]; 2]>,
}

impl ObjectChange {
    /// Whether it shows in a cell with this smallest corner and edge.
    fn reaches(&self, min: [f64; 3], edge: f64) -> bool {
        // Voxels are snapped: a hair's breadth outside may still count.
        let slack = edge / 256.0;
        let overlaps =
            |b: &[[f64; 3]; 2]| (0..3).all(|i| b[0][i] <= min[i] + edge + slack && b[1][i] >= min[i] - slack);
        self.bounds.iter().any(overlaps)
    }
}

/// All differences between two bakes.
#[derive(Default)]
struct Changes {
    is_first: bool,
    files: Vec<Reason>,
    octree_parameters: Vec<Reason>,
    rows_parameters: Vec<Reason>,
    cube: Vec<Reason>,
    bounds: Vec<Reason>,
    objects: Vec<ObjectChange>,
}

impl Changes {
    fn between(last: Option<&Journal>, now: &Journal) -> Self {
        let Some(last) = last else { return Self { is_first: true, ..Self::default() } };
        let mut changes = Self { objects: object_changes(&last.objects, &now.objects), ..Self::default() };
        let paths = last.files.keys().chain(now.files.keys()).collect::<std::collections::BTreeSet<_>>();
        for path in paths {
            let [old, new] = [last, now].map(|journal| journal.files.get(path).cloned().flatten());
            if old != new {
                changes.files.push(Reason::File { path: path.clone(), old, new });
            }
        }
        let names = last.parameters.keys().chain(now.parameters.keys());
        for name in names.collect::<std::collections::BTreeSet<_>>() {
            let value =
                |journal: &Journal| journal.parameters.get(name).cloned().unwrap_or("none".to_owned());
            let (old, new) = (value(last), value(now));
            if old != new {
                let is_octrees = name == "--levels" || name == "cube";
                let list =
                    if is_octrees { &mut changes.octree_parameters } else { &mut changes.rows_parameters };
                list.push(Reason::Parameter { name: name.clone(), old, new });
            }
        }
        if last.cube != now.cube {
            changes.cube.push(Reason::Cube { old: last.cube, new: now.cube });
        }
        if last.bounds != now.bounds {
            changes.bounds.push(Reason::Bounds { old: last.bounds, new: now.bounds });
        }
        changes
    }

    /// Parameters, then objects, as many as are named.
    fn of_kind<'o>(
        &self,
        parameters: &[Reason],
        objects: impl Iterator<Item = &'o ObjectChange>,
    ) -> Vec<Reason> {
        let objects = objects.map(|object| object.reason.clone());
        parameters.iter().cloned().chain(objects).take(NAMED_REASONS).collect()
    }

    fn or_not_in_cache(&self, reasons: Vec<Reason>) -> Vec<Reason> {
        match (self.is_first, reasons.is_empty()) {
            (true, _) => vec![Reason::FirstBake],
            (false, true) => vec![Reason::NotInCache],
            (false, false) => reasons,
        }
    }
}

/// Pairs what differs: first objects of one mesh, then of one place, then of one name.
fn object_changes(old: &[Object], new: &[Object]) -> Vec<ObjectChange> {
    let mut counts: BTreeMap<(&str, &str), i64> = BTreeMap::new();
    old.iter().for_each(|object| *counts.entry((&object.shape, &object.look)).or_default() += 1);
    let mut added: Vec<&Object> = Vec::new();
    for object in new {
        let count = counts.entry((&object.shape, &object.look)).or_default();
        *count -= 1;
        if *count < 0 {
            added.push(object);
        }
    }
    let mut removed: Vec<&Object> = Vec::new();
    for object in old {
        let count = counts.entry((&object.shape, &object.look)).or_default();
        if *count > 0 {
            *count -= 1;
            removed.push(object);
        }
    }
    let mut changes = Vec::new();
    type Same = fn(&Object, &Object) -> bool;
    let same: [Same; 4] = [
        |a, b| a.shape == b.shape,
        |a, b| a.mesh == b.mesh && a.place != b.place,
        |a, b| a.place == b.place && a.name == b.name,
        |a, b| a.place == b.place,
    ];
    for same in same {
        removed.retain(|old| {
            let Some(at) = added.iter().position(|new| same(old, new)) else { return true };
            let new = added.remove(at);
            let object = new.name.clone();
            let is_shape = old.shape != new.shape;
            let reason = if !is_shape {
                Reason::Repainted { object, old: old.look.clone(), new: new.look.clone() }
            } else if old.place != new.place {
                Reason::Moved { object, old: old.place, new: new.place }
            } else {
                Reason::Reshaped { object, old: old.shape.clone(), new: new.shape.clone() }
            };
            changes.push(ObjectChange { reason, is_shape, bounds: vec![old.bounds, new.bounds] });
            false
        });
    }
    changes.extend(removed.iter().map(|old| ObjectChange {
        reason: Reason::Removed { object: old.name.clone(), old: old.place },
        is_shape: true,
        bounds: vec![old.bounds],
    }));
    changes.extend(added.iter().map(|new| ObjectChange {
        reason: Reason::Added { object: new.name.clone(), new: new.place },
        is_shape: true,
        bounds: vec![new.bounds],
    }));
    changes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn object(name: &str, mesh: &str, place: f64, look: &str) -> Object {
        Object {
            name: name.to_owned(),
            mesh: mesh.to_owned(),
            shape: format!("{mesh}@{place}"),
            look: format!("{mesh}@{place} {look}"),
            place: [place, 0.0, 0.0],
            bounds: [[place, 0.0, 0.0], [place + 1.0, 1.0, 1.0]],
        }
    }

    #[test]
    fn every_change_of_objects_has_its_name() {
        let old = [
            object("stays", "a", 0.0, "red"),
            object("moves", "b", 1.0, "red"),
            object("changes", "c", 2.0, "red"),
            object("paint", "d", 3.0, "red"),
            object("goes", "e", 4.0, "red"),
        ];
        let new = [
            object("paint", "d", 3.0, "blue"),
            object("comes", "f", 9.0, "red"),
            object("moves", "b", 5.0, "red"),
            object("stays", "a", 0.0, "red"),
            object("changes", "g", 2.0, "red"),
        ];
        let changes = object_changes(&old, &new);
        let texts: Vec<String> = changes.iter().map(|change| change.reason.to_string()).collect();
        assert_eq!(
            texts,
            [
                "`paint` has another look (d@3 red → d@3 blue)",
                "`moves` has moved ((1.000, 0.000, 0.000) → (5.000, 0.000, 0.000))",
                "`changes` has another shape (c@2 → g@2)",
                "`goes` is gone from (4.000, 0.000, 0.000)",
                "`comes` is new, at (9.000, 0.000, 0.000)",
            ]
        );
        assert!(!changes[0].is_shape && changes[1..].iter().all(|change| change.is_shape));
        assert!(changes[1].reaches([0.5, 0.0, 0.0], 1.0), "where it was");
        assert!(changes[1].reaches([5.5, 0.0, 0.0], 1.0), "where it is");
        assert!(!changes[1].reaches([3.0, 0.0, 0.0], 1.0));
        assert!(object_changes(&old, &old).is_empty());
    }
}
