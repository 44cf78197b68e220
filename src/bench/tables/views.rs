//! Tables of methods that draw many views: time and memory against the number of views, agreement with exact casts,
//! resolution, levels of the octree, culling.
//!
//! | table | question |
//! |---|---|
//! | [`view_growth`] | time and memory against views, 1 K to 1 M |
//! | [`view_agreement`] | how far maps agree with exact casts |
//! | [`view_resolutions`] | time and memory against texels |
//! | [`view_levels`] | the same views over a coarse and a fine octree |
//! | [`view_culling`] | what dropping what is outside the fields of view saves |
//!
//! # Practice
//! Methods are any [`ViewRenderer`]s with names. Maps are dropped pass by pass, as a renderer that uses them would. A
//! method that has become too slow is left out of the larger rest of a row: its cells are empty.

use super::view_measure::{Drawn, agreement_cells, drawn_cells, drawn_of};
use crate::archive::Archive;
use crate::bench::plot::{Across, Plot, Scale, Series};
use crate::bench::{BenchError, BenchScene, Cell, Table};
use crate::views::agreement::{Agreement, AgreementSettings};
use crate::views::sample;
use crate::views::{OctreeSurfaces, View, ViewError, ViewRenderer, ViewSettings};
use manyview_pipeline::bake::Progress;
use manyview_shaders::svo::Svo;

/// A method with its name in tables.
pub type NamedRenderer<'a> = (String, Box<dyn ViewRenderer + 'a>);

/// Methods with their names in tables.
pub type Renderers<'a> = [NamedRenderer<'a>];

/// An octree that views look at.
pub struct ViewSubject {
    /// The scene's name.
    pub name: String,
    /// The octree.
    pub svo: Svo,
    /// Corners of the scene's bounds, metres.
    pub bounds: [[f64; 3]; 2],
    /// What exact rays meet.
    pub surfaces: OctreeSurfaces,
}

impl ViewSubject {
    /// Bakes an octree of a scene.
    pub fn new(scene: &BenchScene, levels: u32) -> Result<Self, BenchError> {
        Self::of_archive(scene.name.clone(), &super::subject::bake_octree(scene, levels)?)
    }

    /// Takes an archive's octree.
    pub fn of_archive(name: String, archive: &Archive) -> Result<Self, BenchError> {
        let load = |error| BenchError::Load { scene: name.clone(), source: Box::new(error) };
        let svo = archive.svo().map_err(load)?;
        let info = archive.scene_info();
        let surfaces = OctreeSurfaces::new(&svo, false);
        Ok(Self { name, bounds: [info.bounds_min, info.bounds_max], surfaces, svo })
    }

    /// Views in front of surfaces, one hemisphere each.
    pub fn surface_views(&self, seed: u64) -> ViewKind<'_> {
        let make = move |count| sample::surface(&self.svo, count, seed);
        ViewKind { name: "surface".to_owned(), make: Box::new(make) }
    }

    /// Views anywhere, seeing all around.
    pub fn random_views(&self, seed: u64) -> ViewKind<'_> {
        let make = move |count| sample::random(self.bounds, count, seed);
        ViewKind { name: "random".to_owned(), make: Box::new(make) }
    }
}

/// Views of a kind, as many as are wanted.
pub struct ViewKind<'a> {
    /// Its name in tables.
    pub name: String,
    /// Makes so many.
    pub make: Box<dyn Fn(u32) -> Vec<View> + 'a>,
}

/// What views are measured with.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewTableSettings {
    /// How they are drawn, where that is not what is varied.
    pub drawing: ViewSettings,
    /// How often each method is timed; the shortest time counts.
    pub repeats: u32,
    /// A method is left out where it would presumably take longer than this, seconds.
    pub most_seconds: f64,
    /// Rays a side of a texel that agreement is measured with.
    pub agreement_rays: u32,
}

impl Default for ViewTableSettings {
    /// Maps of 16² texels, the best of three times, a minute at most, 8 × 8 rays a texel.
    fn default() -> Self {
        Self { drawing: ViewSettings::default(), repeats: 3, most_seconds: 60.0, agreement_rays: 8 }
    }
}

/// One method over growing work: whether it is still fast enough to go on.
struct Pace {
    most_seconds: f64,
    /// Work and seconds, at the last step and the one before.
    steps: Vec<(f64, f64)>,
}

impl Pace {
    fn new(most_seconds: f64) -> Self {
        Self { most_seconds, steps: Vec::new() }
    }

    /// Whether `work` will presumably take no longer than is allowed: growth as at the last step, at first in proportion.
    fn allows(&self, work: f64) -> bool {
        let (ratio, last) = match self.steps.as_slice() {
            [] => return true,
            [(before, last)] => (work / before, last),
            [.., (_, first), (_, last)] => (last / first.max(1e-9), last),
        };
        last * ratio <= self.most_seconds
    }

    fn done(&mut self, work: f64, seconds: f64) {
        self.steps.push((work, seconds));
    }
}

/// Figures of a plot: method, x, what was drawn.
type Points = Vec<(String, f64, Drawn)>;

fn plots(name: &str, title: &str, x_label: &str, points: &Points) -> Vec<Plot> {
    let mut names: Vec<&String> = Vec::new();
    for (name, ..) in points {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let plot = |what: &str, y_label: &str, value: fn(&Drawn) -> f64| Plot {
        name: format!("{name}-{what}"),
        title: format!("{title}: {what}"),
        x_label: x_label.to_owned(),
        y_label: y_label.to_owned(),
        across: Across::Numbers(Scale::Log),
        y_scale: Scale::Log,
        series: names
            .iter()
            .map(|&name| {
                let of_method = points.iter().filter(|(method, ..)| method == name);
                let points = of_method.map(|(_, x, drawn)| (*x, value(drawn))).collect();
                Series { name: name.clone(), points }
            })
            .collect(),
    };
    let mib = |drawn: &Drawn| {
        drawn.peak_bytes.unwrap_or(0).max(drawn.largest_pass_bytes) as f64 / f64::from(1 << 20)
    };
    vec![plot("time", "ms", |drawn| drawn.seconds * 1e3), plot("memory", "MiB", mib)]
}

/// Draws once, unless the user has given up.
fn step(
    progress: &dyn Progress,
    renderer: &NamedRenderer<'_>,
    views: &[View],
    drawing: &ViewSettings,
    repeats: u32,
) -> Result<Drawn, BenchError> {
    if progress.cancelled() {
        return Err(BenchError::Cancelled);
    }
    let (name, renderer) = renderer;
    let drawn = drawn_of(&**renderer, views, drawing, repeats, &|| progress.cancelled());
    progress.advance(1);
    drawn.map_err(|source| failed(name, source))
}

/// A row for each kind and number of views: its name, how many there are, then what `measure` says of them.
pub(super) fn rows_of_kinds(
    kinds: &[ViewKind<'_>],
    counts: &[u32],
    what: &'static str,
    progress: &dyn Progress,
    mut measure: impl FnMut(&[View]) -> Result<Vec<Cell>, BenchError>,
) -> Result<Vec<Vec<Cell>>, BenchError> {
    let mut rows = Vec::new();
    progress.begin(what, (kinds.len() * counts.len()) as u64, "measurements");
    for kind in kinds {
        for &count in counts {
            if progress.cancelled() {
                return Err(BenchError::Cancelled);
            }
            let views = (kind.make)(count);
            let head = [kind.name.as_str().into(), Cell::Count(views.len() as u64)];
            rows.push([&head[..], &measure(&views)?].concat());
            progress.advance(1);
        }
    }
    Ok(rows)
}

pub(super) fn failed(method: &str, source: ViewError) -> BenchError {
    match source {
        ViewError::Cancelled => BenchError::Cancelled,
        source => BenchError::Views { method: method.to_owned(), source },
    }
}

/// Time and memory of every method against the number of views.
pub fn view_growth(
    subject: &ViewSubject,
    kinds: &[ViewKind<'_>],
    counts: &[u32],
    renderers: &Renderers<'_>,
    settings: &ViewTableSettings,
    progress: &dyn Progress,
) -> Result<Table, BenchError> {
    let name = format!("views-growth-{}", subject.name);
    let title = format!("{}: time and memory against views", subject.name);
    let columns = [&["kind of views", "views", "method"][..], &Drawn::COLUMNS].concat();
    let mut table = Table::new(name.clone(), title, &columns);
    progress.begin("views", (kinds.len() * counts.len() * renderers.len()) as u64, "measurements");
    for kind in kinds {
        let mut points = Points::new();
        let mut paces: Vec<Pace> = renderers.iter().map(|_| Pace::new(settings.most_seconds)).collect();
        for &count in counts {
            let views = (kind.make)(count);
            for (renderer, pace) in renderers.iter().zip(&mut paces) {
                let mut drawn = None;
                if pace.allows(f64::from(count)) {
                    let found = step(progress, renderer, &views, &settings.drawing, settings.repeats)?;
                    pace.done(f64::from(count), found.seconds);
                    points.push((renderer.0.clone(), f64::from(count), found.clone()));
                    drawn = Some(found);
                } else {
                    progress.advance(1);
                    // One that was left out stays out.
                    pace.done(f64::from(count), f64::INFINITY);
                }
                let head =
                    [kind.name.as_str().into(), Cell::Count(views.len() as u64), renderer.0.as_str().into()];
                table.push([&head[..], &drawn_cells(drawn.as_ref(), views.len())].concat());
            }
        }
        let title = format!("{}, {} views", subject.name, kind.name);
        table.plots.extend(plots(&format!("{name}-{}", kind.name), &title, "views", &points));
    }
    Ok(table)
}

/// How far the maps of every method agree with exact casts.
pub fn view_agreement(
    subject: &ViewSubject,
    kinds: &[ViewKind<'_>],
    views: u32,
    resolutions: &[u32],
    renderers: &Renderers<'_>,
    settings: &ViewTableSettings,
    progress: &dyn Progress,
) -> Result<Table, BenchError> {
    let title = format!("{}: agreement of maps with exact casts", subject.name);
    let columns =
        [&["kind of views", "views", "texels a side", "method"][..], &agreement_cells::COLUMNS].concat();
    let mut table = Table::new(format!("views-agreement-{}", subject.name), title, &columns);
    let comparing = AgreementSettings {
        rays: settings.agreement_rays,
        ..AgreementSettings::of_voxel(subject.surfaces.voxel())
    };
    progress.begin("agreement", (kinds.len() * resolutions.len() * renderers.len()) as u64, "measurements");
    for kind in kinds {
        let views = (kind.make)(views);
        for &resolution in resolutions {
            let drawing = ViewSettings { resolution, ..settings.drawing };
            for (name, renderer) in renderers {
                if progress.cancelled() {
                    return Err(BenchError::Cancelled);
                }
                let found =
                    Agreement::of_renderer(&**renderer, &subject.surfaces, &views, &drawing, &comparing)
                        .map_err(|source| failed(name, source))?;
                let head = [
                    kind.name.as_str().into(),
                    Cell::Count(views.len() as u64),
                    Cell::Count(u64::from(resolution)),
                    name.as_str().into(),
                ];
                table.push([&head[..], &agreement_cells::of(&found)].concat());
                progress.advance(1);
            }
        }
    }
    Ok(table)
}

/// Time and memory of every method against texels a side.
pub fn view_resolutions(
    subject: &ViewSubject,
    kind: &ViewKind<'_>,
    views: u32,
    resolutions: &[u32],
    renderers: &Renderers<'_>,
    settings: &ViewTableSettings,
    progress: &dyn Progress,
) -> Result<Table, BenchError> {
    let name = format!("views-resolution-{}", subject.name);
    let views = (kind.make)(views);
    let title = format!("{}: {} {} views against texels", subject.name, views.len(), kind.name);
    let columns = [&["texels a side", "method"][..], &Drawn::COLUMNS].concat();
    let mut table = Table::new(name.clone(), title.clone(), &columns);
    let mut points = Points::new();
    progress.begin("resolutions", (resolutions.len() * renderers.len()) as u64, "measurements");
    let mut paces: Vec<Pace> = renderers.iter().map(|_| Pace::new(settings.most_seconds)).collect();
    for &resolution in resolutions {
        let drawing = ViewSettings { resolution, ..settings.drawing };
        let work = f64::from(resolution).powi(2);
        for (renderer, pace) in renderers.iter().zip(&mut paces) {
            let mut drawn = None;
            if pace.allows(work) {
                let found = step(progress, renderer, &views, &drawing, settings.repeats)?;
                pace.done(work, found.seconds);
                points.push((renderer.0.clone(), f64::from(resolution), found.clone()));
                drawn = Some(found);
            } else {
                progress.advance(1);
                pace.done(work, f64::INFINITY);
            }
            let head = [Cell::Count(u64::from(resolution)), renderer.0.as_str().into()];
            table.push([&head[..], &drawn_cells(drawn.as_ref(), views.len())].concat());
        }
    }
    table.plots = plots(&name, &title, "texels a side", &points);
    Ok(table)
}

/// The same views over octrees of different depth, each with methods made for it, and how far their maps agree with exact
/// casts at the deepest of them, which comes last.
pub fn view_levels(
    subjects: &[(&ViewSubject, &Renderers<'_>)],
    kind: &ViewKind<'_>,
    [views, compared_views]: [u32; 2],
    settings: &ViewTableSettings,
    progress: &dyn Progress,
) -> Result<Table, BenchError> {
    let (deepest, _) = subjects.last().expect("an octree at least");
    let views = (kind.make)(views);
    let title = format!("{}: {} {} views over levels of the octree", deepest.name, views.len(), kind.name);
    let columns =
        [&["levels", "leaves", "method"][..], &Drawn::COLUMNS, &["emptiness %", "depth %"]].concat();
    let mut table = Table::new(format!("views-levels-{}", deepest.name), title, &columns);
    let steps: usize = subjects.iter().map(|(_, renderers)| renderers.len()).sum();
    progress.begin("levels", steps as u64, "measurements");
    let comparing = AgreementSettings {
        rays: settings.agreement_rays,
        ..AgreementSettings::of_voxel(deepest.surfaces.voxel())
    };
    let compared = &views[..views.len().min(compared_views as usize)];
    for (subject, renderers) in subjects {
        let depth = subject.svo.depth();
        for renderer in *renderers {
            let drawn = step(progress, renderer, &views, &settings.drawing, settings.repeats)?;
            let found = Agreement::of_renderer(
                &*renderer.1,
                &deepest.surfaces,
                compared,
                &settings.drawing,
                &comparing,
            )
            .map_err(|source| failed(&renderer.0, source))?;
            let head = [
                Cell::Count(u64::from(depth)),
                Cell::Count(subject.svo.node_count(depth as usize) as u64),
                renderer.0.as_str().into(),
            ];
            let shares =
                [found.all.emptiness_share(), found.all.depth_share()].map(|s| Cell::Number(100.0 * s, 2));
            table.push([&head[..], &drawn_cells(Some(&drawn), views.len()), &shares].concat());
        }
    }
    Ok(table)
}

/// Every method with and without culling.
pub fn view_culling(
    subject: &ViewSubject,
    kinds: &[ViewKind<'_>],
    views: u32,
    renderers: &Renderers<'_>,
    settings: &ViewTableSettings,
    progress: &dyn Progress,
) -> Result<Table, BenchError> {
    let title = format!("{}: what culling saves, {views} views", subject.name);
    let columns = ["kind of views", "method", "ms with culling", "ms without", "saved %"];
    let mut table = Table::new(format!("views-culling-{}", subject.name), title, &columns);
    progress.begin("culling", (2 * kinds.len() * renderers.len()) as u64, "measurements");
    for kind in kinds {
        let views = (kind.make)(views);
        for renderer in renderers {
            let mut seconds = [0.0; 2];
            for (seconds, culling) in seconds.iter_mut().zip([true, false]) {
                let drawing = ViewSettings { culling, ..settings.drawing };
                *seconds = step(progress, renderer, &views, &drawing, settings.repeats)?.seconds;
            }
            let [with, without] = seconds;
            table.push(vec![
                kind.name.as_str().into(),
                renderer.0.as_str().into(),
                Cell::Number(with * 1e3, 1),
                Cell::Number(without * 1e3, 1),
                Cell::Number(100.0 * (1.0 - with / without.max(1e-9)), 1),
            ]);
        }
    }
    Ok(table)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::views::RayCast;
    use manyview_pipeline::bake::Silent;
    use manyview_pipeline::generate::{SceneKind, generate};

    fn renderers(subject: &ViewSubject) -> Vec<NamedRenderer<'_>> {
        let cast = || RayCast::new(subject.surfaces.clone());
        vec![("one".to_owned(), Box::new(cast())), ("many".to_owned(), Box::new(cast().with_rays(8)))]
    }

    #[test]
    fn every_table_has_a_row_for_each_method() {
        let scene = BenchScene::new("town".to_owned(), generate(SceneKind::Town, 2000, 1)).unwrap();
        let (coarse, fine) = (ViewSubject::new(&scene, 5).unwrap(), ViewSubject::new(&scene, 6).unwrap());
        let kinds = [fine.surface_views(1), fine.random_views(1)];
        let methods = renderers(&fine);
        let drawing = ViewSettings::new(8);
        let settings = ViewTableSettings { drawing, repeats: 1, ..ViewTableSettings::default() };
        let growth = view_growth(&fine, &kinds, &[3, 9], &methods, &settings, &Silent).unwrap();
        assert_eq!((growth.rows.len(), growth.plots.len()), (8, 4));
        let found = view_agreement(&fine, &kinds, 4, &[8, 16], &methods, &settings, &Silent).unwrap();
        assert_eq!(found.rows.len(), 8);
        let column = found.columns.iter().position(|c| *c == "emptiness %").unwrap();
        // Eight by eight rays a texel agree with eight by eight rays a texel.
        for row in found.rows.iter().filter(|row| row[3] == "many".into()) {
            assert_eq!(row[column], Cell::Number(100.0, 2));
        }
        let sides = view_resolutions(&fine, &kinds[0], 4, &[8, 16], &methods, &settings, &Silent).unwrap();
        assert_eq!((sides.rows.len(), sides.plots.len()), (4, 2));
        let coarse_methods = renderers(&coarse);
        let both: [(&ViewSubject, &Renderers<'_>); 2] = [(&coarse, &coarse_methods), (&fine, &methods)];
        assert_eq!(view_levels(&both, &kinds[0], [8, 4], &settings, &Silent).unwrap().rows.len(), 4);
        assert_eq!(view_culling(&fine, &kinds, 4, &methods, &settings, &Silent).unwrap().rows.len(), 4);
    }

    #[test]
    fn what_is_too_slow_is_left_out_of_the_rest() {
        let mut pace = Pace::new(10.0);
        assert!(pace.allows(1000.0));
        pace.done(1000.0, 2.0);
        assert!(pace.allows(4000.0) && !pace.allows(6000.0));
        pace.done(4000.0, 3.0);
        // Half as much again for four times the work.
        assert!(pace.allows(16000.0));
        pace.done(16000.0, f64::INFINITY);
        assert!(!pace.allows(64000.0));
    }
}
