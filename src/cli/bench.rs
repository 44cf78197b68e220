//! `manyview bench`.

mod bakes;

use glam::Vec3;
use manyview::bench::tables::{
    self, DynamicSettings, NamedRenderer, OurMethods, Renderers, TableSettings, ViewKind, ViewSubject,
    ViewTableSettings,
};
use manyview::bench::variants::{Detail, variants};
use manyview::bench::{BenchError, BenchScene, RunInfo, SceneSource, Table, rows, voxels};
use manyview::exact::ExactRays;
use manyview::gpu::{AdapterChoice, GpuContext};
use manyview::megaviews::{MegaViews, Sharing};
use manyview::preview::CameraChoice;
use manyview::radiosity::{self, Primaries, VplOptions};
use manyview::rays::paper::OriginBias;
use manyview::reference::Reference;
use manyview::render::lights::point_light;
use manyview::render::scene::{RenderScene, SceneError};
use manyview::views::ViewError;
use manyview::views::methods::{Ingredients, ViewMethod, renderer};
use manyview_pipeline::bake;
use manyview_pipeline::scene::PunctualLight;
use manyview_shaders::scene_tree::SceneTree;
use std::path::PathBuf;
use std::sync::Arc;

use super::Format;
use super::cancel;
use super::error::{CliError, CliResult, Exit};
use super::output::print;
use super::progress::Progress;

/// Options of `bench`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// What to measure; all tables if none is named
    #[arg(value_name = "TABLE", value_enum)]
    tables: Vec<TableName>,
    /// A .glb or .gltf file, or KIND:TRIANGLES for a generated scene; may be repeated [default: town:100000 for
    /// `voxels` and `rows`, stand-ins of the paper's triangle counts for its tables]
    #[arg(long = "scene", value_name = "SCENE")]
    scenes: Vec<SceneSource>,
    /// Folder for the tables as Markdown, CSV and JSON, and for plots as SVG; without it tables are printed
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Directions that are sampled for the rows
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=8100))]
    directions: u32,
    /// Rays per direction
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    rays: u32,
    /// Measure every combination of source, grid and direction set, not only those around the default
    #[arg(long)]
    full: bool,
    /// Seed of directions, rays and lights
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// The paper's tables: lights, where they are not what is varied
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    lights: u32,
    /// The paper's tables: pixels of the picture whose surface points are lit
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1920x1080", value_parser = parse_size)]
    size: [u32; 2],
    /// The paper's tables: pieces of the picture are left out until there are no more pairs of receivers and lights than
    /// this, in millions
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=1 << 20))]
    million_pairs: u64,
    /// The paper's tables: how often each method is timed; the shortest time counts
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    repeats: u32,
    /// The table of views: how many there are at most
    #[arg(long, value_name = "N", default_value_t = 1_000_000, value_parser = clap::value_parser!(u32).range(1..=100_000_000))]
    views: u32,
    /// The table of views: a method is left out where it would presumably take longer than this
    #[arg(long, value_name = "SECONDS", default_value_t = 60.0)]
    most_seconds: f64,
    /// Estimates: levels of the octrees
    #[arg(long, value_name = "L,…", value_delimiter = ',', default_value = "8,9,11,13", value_parser = clap::value_parser!(u32).range(1..=13))]
    bake_levels: Vec<u32>,
    /// Estimates: steps of both angles of the directions
    #[arg(long, value_name = "N", default_value_t = 90, value_parser = clap::value_parser!(u32).range(2..=90))]
    bake_directions: u32,
    /// Estimates and growth: most memory of each bake
    #[arg(long, value_name = "SIZE", default_value = "4GiB", value_parser = super::bake::memory_size)]
    max_memory: u64,
    /// Growth: most triangles, up to 50 million
    #[arg(long, value_name = "N", default_value_t = 1_000_000)]
    most_triangles: u64,
    /// The table of views: levels of the octree, compared with 8
    #[arg(long, value_name = "L", default_value_t = 11, value_parser = clap::value_parser!(u32).range(9..=12))]
    levels: u32,
    /// The paper's tables and that of views: a method to compare; may be repeated [default: all]
    #[arg(long = "method", value_name = "NAME")]
    methods: Vec<String>,
}

fn parse_size(text: &str) -> Result<[u32; 2], String> {
    let side = |text: &str| text.parse::<u32>().ok().filter(|side| (1..=4096).contains(side));
    let sides = text.split_once('x').and_then(|(width, height)| Some([side(width)?, side(height)?]));
    sides.ok_or_else(|| "write WIDTHxHEIGHT, each 1 to 4096, such as 320x180".to_owned())
}

/// The tables there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum TableName {
    /// Octree occupancy against exact triangle-box overlap
    Voxels,
    /// Rows of every source, grid and direction set against exact rays
    Rows,
    /// Table I: error and time of each method, scene by scene
    #[value(alias = "I")]
    Scenes,
    /// Table II: error and time against lights, 512 to 10,000
    #[value(alias = "II")]
    Lights,
    /// Table III: error of rows against voxels a side
    #[value(alias = "III")]
    Resolution,
    /// Table IV: error of rows against sampled directions
    #[value(alias = "IV")]
    Directions,
    /// Table V: moving and deforming objects
    #[value(alias = "V")]
    Dynamic,
    /// Table VI: rays a second against triangles, 100 thousand to 10 million
    #[value(alias = "VI")]
    Throughput,
    /// Methods that draw many views: time and memory against views and texels, queries without fusion, agreement with
    /// exact casts, levels of the octree, culling
    Views,
    /// Bakes: estimates of time, memory and size beside what is measured
    Estimates,
    /// Bakes: time and memory against triangles, levels, directions, rows and threads
    Growth,
    /// ManyLoDs: maps of many lights, from the root and from the last frame's cuts
    Manylods,
}

/// The tables that are measured with all methods.
const PAPER_TABLES: [TableName; 7] = [
    TableName::Scenes,
    TableName::Lights,
    TableName::Resolution,
    TableName::Directions,
    TableName::Dynamic,
    TableName::Throughput,
    TableName::Manylods,
];
/// Lights of Table II.
const LIGHTS: [u32; 5] = [512, 1024, 2048, 4096, 10_000];
/// log2 of voxels a side in Table III.
const ROW_BITS: [u32; 3] = [5, 6, 7];
/// Steps of both angles in Table IV.
const DIRECTION_STEPS: [u32; 3] = [30, 60, 90];
/// Stand-ins for the paper's City, Trees and Garden, with their triangle counts.
const PAPER_SCENES: [&str; 3] = ["city:871000", "forest:626000", "park:416000"];
/// Triangles of the deforming object of Table V.
const BEAR_TRIANGLES: u32 = 200_000;
/// Stand-in for the paper's Grog, with its triangle count.
const MANYLODS_SCENES: [&str; 1] = ["hairball:1300000"];
/// Levels of the octrees that views are drawn from.
const MANYLODS_LEVELS: u32 = 11;
/// Scenes of Table VI.
const GROWING_SCENES: [&str; 3] = ["city:100000", "city:1000000", "city:10000000"];

/// Runs the command.
pub(crate) fn run_command(args: &Args) -> CliResult {
    let progress = Progress::new(Format::Text, cancel::watch());
    let result = run(args, &progress, |text| _ = print(text));
    progress.finish();
    result?;
    Ok(Exit::Done)
}

/// Measures, hands every table to `print` as Markdown or writes it to the folder as soon as it is done.
pub(crate) fn run(
    args: &Args,
    progress: &dyn bake::Progress,
    mut print: impl FnMut(&str),
) -> Result<(), BenchError> {
    let wanted = |table| args.tables.is_empty() || args.tables.contains(&table);
    let mut done = |table: &Table| match &args.output {
        Some(folder) => table.write(folder),
        None => {
            print(&table.markdown());
            print("\n");
            Ok(())
        }
    };
    let scenes_or = |names: &[&str]| match args.scenes.as_slice() {
        [] => names.iter().map(|name| name.parse().expect("a generated scene's name")).collect(),
        scenes => scenes.to_vec(),
    };
    if wanted(TableName::Voxels) {
        done(&voxels::run(scenes_or(&["town:100000"]).iter().map(BenchScene::load), progress)?)?;
    }
    if wanted(TableName::Rows) {
        let Args { directions, rays, seed, .. } = *args;
        let settings = rows::RowsSettings { directions, rays, seed, bias: OriginBias::default() };
        let detail = if args.full { Detail::Full } else { Detail::Brief };
        let variants = variants(detail);
        for source in &scenes_or(&["town:100000"]) {
            let scene = BenchScene::load(source)?;
            for table in rows::run(&scene, &variants, &settings, progress)? {
                done(&table)?;
            }
        }
    }
    if wanted(TableName::Estimates) || wanted(TableName::Growth) {
        let mut done = |mut table: Table| {
            table.run = Some(RunInfo::gather(command_line(), None));
            done(&table)
        };
        let bakes = bakes::Bakes::new(args.max_memory)?;
        let mut measure = |case: &tables::BakeCase| {
            if progress.cancelled() { Err(BenchError::Cancelled) } else { bakes.measure(case) }
        };
        if wanted(TableName::Estimates) {
            let scenes = scenes_or(&bakes::SCENES);
            done(tables::bake_estimates(&scenes, &args.bake_levels, args.bake_directions, &mut measure)?)?;
        }
        if wanted(TableName::Growth) {
            for growth in bakes::growths(args.most_triangles) {
                done(tables::bake_growth(&growth, &mut measure)?)?;
            }
        }
    }
    let needs_gpu = wanted(TableName::Views) || PAPER_TABLES.iter().any(|&table| wanted(table));
    let gpu = match needs_gpu {
        true => GpuContext::open(&AdapterChoice::from_env()).ok(),
        false => return Ok(()),
    };
    let adapter = gpu.as_ref().map(|context| context.name().to_owned());
    let methods = &OurMethods { gpu };
    let settings = TableSettings {
        size: args.size,
        lights: args.lights,
        seed: args.seed,
        most_pairs: args.million_pairs * 1_000_000,
        repeats: args.repeats,
        methods: args.methods.clone(),
        ..TableSettings::default()
    };
    let mut done = |mut table: Table| {
        table.run = Some(RunInfo::gather(command_line(), adapter.clone()));
        done(&table)
    };
    if wanted(TableName::Views) {
        for source in &scenes_or(&["town:100000"]) {
            views(args, &BenchScene::load(source)?, methods.gpu.as_ref(), &mut done, progress)?;
        }
    }
    let paper = scenes_or(&PAPER_SCENES);
    if wanted(TableName::Scenes) {
        done(tables::scenes(&paper, methods, &settings, progress)?)?;
    }
    if wanted(TableName::Lights) {
        for source in &paper {
            done(tables::lights(source, &LIGHTS, methods, &settings, progress)?)?;
        }
    }
    if wanted(TableName::Resolution) {
        done(tables::resolution(&paper, &ROW_BITS, methods, &settings, progress)?)?;
    }
    if wanted(TableName::Directions) {
        done(tables::directions(&paper, &DIRECTION_STEPS, methods, &settings, progress)?)?;
    }
    if wanted(TableName::Dynamic) {
        done(tables::dynamic(&DynamicSettings::default(), &settings, progress)?)?;
        let gpu = methods.gpu.as_ref();
        done(tables::deforming_rows(BEAR_TRIANGLES, &DIRECTION_STEPS, &ROW_BITS[1..], gpu, progress)?)?;
    }
    if wanted(TableName::Manylods) {
        let settings = TableSettings { levels: MANYLODS_LEVELS, ..settings.clone() };
        let scenes = scenes_or(&MANYLODS_SCENES);
        done(tables::manylods(&scenes, &settings, progress)?)?;
        done(tables::manylods_single(&scenes, &settings, progress)?)?;
    }
    if wanted(TableName::Throughput) {
        done(tables::throughput(&scenes_or(&GROWING_SCENES), methods, &settings, progress)?)?;
    }
    Ok(())
}

/// Octree levels that the table of views compares with.
const COARSE_LEVELS: u32 = 8;
/// Cuts as of ManyLoDs, without lists, by the vector code of MegaViews: what sharing alone gains is seen beside it.
const ALONE: &str = "manylods-alone";
/// Views whose maps are compared with exact casts, each in 2 · 64 · R² rays.
const COMPARED_VIEWS: u32 = 64;
/// Numbers of views.
const VIEW_COUNTS: [u32; 6] = [1_000, 4_000, 16_000, 64_000, 256_000, 1_000_000];
/// Texels a side.
const VIEW_RESOLUTIONS: [u32; 5] = [16, 32, 64, 128, 256];

/// The tables of views over one scene.
fn views(
    args: &Args,
    scene: &BenchScene,
    gpu: Option<&GpuContext>,
    done: &mut dyn FnMut(Table) -> Result<(), BenchError>,
    progress: &dyn bake::Progress,
) -> Result<(), BenchError> {
    let settings = ViewTableSettings {
        repeats: args.repeats,
        most_seconds: args.most_seconds,
        ..ViewTableSettings::default()
    };
    let reference = Reference::new(&scene.scene, &scene.row_triangles, &scene.cutouts);
    let coarse = ViewSubject::new(scene, COARSE_LEVELS)?;
    let fine = ViewSubject::new(scene, args.levels)?;
    let made = view_renderers(&fine, &reference, gpu, &args.methods)?;
    let lamp = Lamp::new(scene)?;
    let exact = ExactRays::new(lamp.scene.reference());
    let primaries = Primaries::new(&lamp.scene, exact.reference(), &lamp.lights);
    let bounced = |bounces: u32| {
        let (lamp, exact, primaries) = (&lamp, &exact, &primaries);
        // Off the surface's own voxel.
        let lift_metres = 1.5 * fine.svo.voxel_size() as f32;
        let make = move |count: u32| {
            let options = VplOptions { count: count as usize, bounces, seed: args.seed, indirect_only: true };
            let found = radiosity::trace(&lamp.scene, exact, primaries, &options);
            found.lights.iter().map(|light| light.view(lift_metres)).collect()
        };
        ViewKind { name: format!("{bounces}-bounce"), make: Box::new(make) }
    };
    let kinds = [bounced(1), bounced(4), fine.random_views(args.seed)];
    let counts: Vec<u32> = VIEW_COUNTS.into_iter().filter(|&count| count <= args.views).collect();
    let counts = if counts.is_empty() { vec![args.views] } else { counts };
    done(tables::view_growth(&fine, &kinds, &counts, &made, &settings, progress)?)?;
    done(tables::view_work(&fine, &kinds, &counts, &settings, progress)?)?;
    done(tables::view_queries(&fine, &kinds, &counts, &settings, progress)?)?;
    let compared = COMPARED_VIEWS.min(args.views);
    done(tables::view_agreement(&fine, &kinds, compared, &[16, 64], &made, &settings, progress)?)?;
    let [bounced, ..] = &kinds;
    let some = args.views.min(VIEW_COUNTS[0]);
    done(tables::view_resolutions(&fine, bounced, some, &VIEW_RESOLUTIONS, &made, &settings, progress)?)?;
    done(tables::view_culling(&fine, &kinds, some, &made, &settings, progress)?)?;
    let over_coarse = view_renderers(&coarse, &reference, gpu, &args.methods)?;
    let both: [(&ViewSubject, &Renderers<'_>); 2] = [(&coarse, &over_coarse), (&fine, &made)];
    done(tables::view_levels(&both, bounced, [some, compared], &settings, progress)?)
}

/// One light in a scene, where a camera would stand: virtual lights come from it.
struct Lamp {
    scene: RenderScene,
    lights: Vec<PunctualLight>,
}

impl Lamp {
    fn new(scene: &BenchScene) -> Result<Self, BenchError> {
        let unusable = |error: SceneError| match error {
            SceneError::Unusable(source) => BenchError::Scene { scene: scene.name.clone(), source },
            SceneError::Load(source) => {
                BenchError::Load { scene: scene.name.clone(), source: Box::new(source) }
            }
        };
        let lit = RenderScene::new(scene.scene.clone()).map_err(unusable)?;
        let camera = lit.choose_camera(1.0, CameraChoice::Inside).map_err(unusable)?;
        let lights = vec![point_light(camera.eye.as_vec3(), Vec3::ONE)];
        Ok(Self { scene: lit, lights })
    }
}

/// All methods, or those that are named; on a GPU too, if there is one, with `-gpu` behind their names.
fn view_renderers<'a>(
    subject: &'a ViewSubject,
    reference: &'a Reference<'a>,
    gpu: Option<&'a GpuContext>,
    names: &[String],
) -> Result<Vec<NamedRenderer<'a>>, BenchError> {
    let mut known = Vec::new();
    let mut made = Vec::new();
    for (method, name) in ViewMethod::NAMES {
        let on_gpu = gpu.filter(|_| method.runs_on_gpu()).map(Some);
        for gpu in [None].into_iter().chain(on_gpu) {
            let name = if gpu.is_some() { format!("{name}-gpu") } else { name.to_owned() };
            known.push(name.clone());
            if !names.is_empty() && !names.contains(&name) {
                continue;
            }
            let ingredients = Ingredients {
                svo: Some(&subject.svo),
                reference: Some(reference),
                gpu,
                ..Ingredients::default()
            };
            match renderer(method, &ingredients) {
                Ok(renderer) => made.push((name, renderer)),
                // Unless it was asked for, a method that is not there is no reason to measure none.
                Err(ViewError::Unsupported { .. }) if names.is_empty() => {}
                Err(source) => return Err(BenchError::Views { method: name, source }),
            }
        }
    }
    known.push(ALONE.to_owned());
    if names.is_empty() || names.iter().any(|name| name == ALONE) {
        let scene = Arc::new(SceneTree::new(&subject.svo, false));
        made.push((ALONE.to_owned(), Box::new(MegaViews::new(scene).with_sharing(Sharing::Alone))));
    }
    match names.iter().find(|name| !known.contains(name)) {
        Some(name) => Err(BenchError::NoSuchMethod { name: name.clone(), known: known.join(", ") }),
        None => Ok(made),
    }
}

/// The command as a shell would take it, without the program's folder.
fn command_line() -> String {
    let arguments = std::env::args().skip(1).map(|argument| match argument.contains([' ', '"', '\'']) {
        true => format!("{argument:?}"),
        false => argument,
    });
    std::iter::once("manyview".to_owned()).chain(arguments).collect::<Vec<_>>().join(" ")
}

impl From<BenchError> for CliError {
    fn from(error: BenchError) -> Self {
        let exit = match error {
            BenchError::Cancelled => Exit::Cancelled,
            BenchError::NoSuchMethod { .. }
            | BenchError::Views { source: ViewError::Unsupported { .. }, .. } => Exit::Usage,
            BenchError::Views { source: ViewError::Budget { .. }, .. } => Exit::OverBudget,
            _ => Exit::BadInput,
        };
        Self::new(exit, error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use manyview_pipeline::bake::Silent;

    #[derive(clap::Parser)]
    struct Command {
        #[command(flatten)]
        args: Args,
    }

    fn parse(arguments: &[&str]) -> Result<Args, clap::Error> {
        Command::try_parse_from(["bench"].iter().chain(arguments)).map(|command| command.args)
    }

    #[test]
    fn tables_and_scenes_are_named() {
        let args = parse(&["rows", "--scene", "a.glb", "--scene", "city:2000", "--rays", "9"]).unwrap();
        assert_eq!((args.tables, args.scenes.len(), args.rays), (vec![TableName::Rows], 2, 9));
        assert!(parse(&["columns"]).is_err() && parse(&["--scene", "city:x"]).is_err());
        assert!(parse(&["--directions", "0"]).is_err());
        let args = parse(&["I", "VI", "throughput", "--size", "320x180"]).unwrap();
        assert_eq!(args.tables, [TableName::Scenes, TableName::Throughput, TableName::Throughput]);
        assert!(args.size == [320, 180] && parse(&["--size", "0x9"]).is_err());
    }

    #[test]
    fn a_table_is_printed_or_written() {
        let mut printed = String::new();
        run(&parse(&["voxels", "--scene", "town:1000"]).unwrap(), &Silent, |text| printed += text).unwrap();
        assert!(printed.contains("| town:1000 | 7 |"), "{printed}");
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().to_str().unwrap();
        run(&parse(&["voxels", "--scene", "town:1000", "-o", out]).unwrap(), &Silent, |_| panic!()).unwrap();
        assert!(folder.path().join("voxels.csv").exists());
        let missing = run(&parse(&["voxels", "--scene", "no.glb"]).unwrap(), &Silent, |_| ());
        assert!(missing.unwrap_err().to_string().contains("no.glb"));
    }
}
