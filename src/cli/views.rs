//! `manyview views`.

use std::io;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Instant;

use clap::ValueEnum;
use manyview::gpu::{AdapterChoice, GpuContext};
use manyview::npy::ArrayReader;
use manyview::reference::Reference;
use manyview::views::files::{MapsArray, MapsPicture};
use manyview::views::methods::{Ingredients, ViewMethod, renderer};
use manyview::views::sample::Sample;
use manyview::views::{View, ViewError, ViewMaps, ViewRenderer, ViewSettings};
use manyview_cache::atomic::{AtomicFile, AtomicFileError};
use manyview_pipeline::bake::Progress as _;
use manyview_shaders::paraboloid::texel_count;
use manyview_shaders::svo::Svo;
use serde_json::json;

use super::Format;
use super::bake::memory_size;
use super::cancel;
use super::error::{CliError, CliResult, Exit};
use super::output::{bytes, counted, print_json};
use super::progress::Progress;
use super::rays::{Input, archive_of};

/// Options of `views`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Options {
    /// An archive, or a scene: a .glb or .gltf file, or KIND:TRIANGLES for a generated one
    #[arg(value_name = "A.mvb|SCENE")]
    input: PathBuf,
    /// The views: a NumPy file of float32 (n, 7), position, axis and half field of view in radians (3.15 sees all
    /// around), or `random:N[:SEED]` (anywhere in the scene's bounds, all around) or `surface:N[:SEED]` (hemispheres in
    /// front of surfaces)
    #[arg(long, value_name = "V.npy|random:N|surface:N")]
    views: ViewSource,
    /// The maps: a NumPy file of float32 (n, 2, R, R), distances in metres, +infinity where nothing is; or an EXR with
    /// all maps in one picture, distances in channel Y
    #[arg(short, long, value_name = "D.npy|D.exr")]
    output: PathBuf,
    /// Texels a side of each half of a map: a power of two, 8 to 1024
    #[arg(long, value_name = "R", default_value_t = 16, value_parser = resolution)]
    resolution: u32,
    /// How views are drawn: megaviews, manylods, raycast (exact rays through the octree), raycast-triangles (through the
    /// scene's triangles) or polygons (every triangle into every view)
    #[arg(long, value_name = "METHOD", default_value = "megaviews", value_parser = ViewMethod::from_str)]
    method: ViewMethod,
    /// Where the method runs, if it can run there; `auto` takes a GPU if it is not a software one
    #[arg(long, value_enum, default_value_t = Backend::Auto)]
    backend: Backend,
    /// Also draw the colours of what is seen, into an EXR's channels R, G, B: megaviews on the CPU or a GPU, manylods and
    /// raycast on the CPU
    #[arg(long)]
    colors: bool,
    /// Draw also what is outside the fields of view
    #[arg(long)]
    no_culling: bool,
    /// Most memory for maps, queues and hierarchies of views, such as 8GiB or 500MiB; views that do not fit at once are
    /// drawn in passes
    #[arg(long, value_name = "SIZE", default_value = "4GiB", value_parser = memory_size)]
    max_memory: u64,
    /// Text on stderr, or JSON on stdout and events on stderr
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

const AFTER_HELP: &str = "\
A map is a dual paraboloid in world axes: half 0 holds the unit directions d with d.x >= 0, half 1 the others; with \
(a, b) = (d.y, d.z) / (1 + |d.x|) the column is floor((a + 1) / 2 R), the row floor((b + 1) / 2 R). Texels outside the unit \
disc are empty. What is outside a view's field may be drawn or not.\n\
\n\
A view whose position is not finite has an empty map; one whose axis or field is no number sees all around.\n\
\n\
An EXR has the maps in rows from the upper left, each the front half beside the back half; its attribute `manyview` says \
how many there are in a row.";

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Backend {
    Auto,
    Cpu,
    Gpu,
}

/// Where views come from.
#[derive(Debug, Clone, PartialEq, Eq)]
enum ViewSource {
    File(PathBuf),
    Sample(Sample),
}

impl FromStr for ViewSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match Sample::is_meant(text) {
            true => text.parse().map(Self::Sample),
            false => Ok(Self::File(text.into())),
        }
    }
}

fn resolution(text: &str) -> Result<u32, String> {
    let resolution = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    ViewSettings::new(resolution).check().map_err(|error| error.to_string())?;
    Ok(resolution)
}

/// A kind of output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum OutputKind {
    Array,
    Picture,
}

/// Floats that are read at a time.
const BATCH: usize = 7 << 12;

/// Runs `views`.
pub(crate) fn run(options: &Options) -> CliResult {
    if options.format == Format::Json {
        cancel::tell_events();
    }
    let progress = Progress::new(options.format, cancel::watch());
    let result = draw(options, &progress);
    progress.finish();
    result
}

fn draw(options: &Options, progress: &Progress) -> CliResult {
    let kind = output_kind(options)?;
    if options.backend == Backend::Gpu && !options.method.runs_on_gpu() {
        let method = options.method;
        return Err(CliError::usage(format!(
            "--method {method} runs on the CPU alone: leave out --backend gpu"
        )));
    }
    let views = match &options.views {
        ViewSource::File(path) => Some(read_views(path, options.max_memory)?),
        ViewSource::Sample(_) => None,
    };
    // What cannot be written is not worth the work.
    let file = AtomicFile::create(&options.output)?;
    let input = Input::open(&options.input)?;
    cancel::check()?;
    let prepared = Instant::now();
    match input {
        Input::Scene { scene, name } if options.method.needs_triangles() => {
            let views = match (views, &options.views) {
                (Some(views), _) => views,
                (None, source) => {
                    let svo = archive_of(&scene, &name, false)?.svo()?;
                    let (min, max) = scene.scene.bounds().unwrap_or_default();
                    sampled(source, &svo, [min.to_array(), max.to_array()])
                }
            };
            let reference = Reference::new(&scene.scene, &scene.row_triangles, &scene.cutouts);
            let ingredients = Ingredients { reference: Some(&reference), ..Ingredients::default() };
            let method = renderer(options.method, &ingredients)?;
            write(options, kind, file, &views, &*method, prepared, progress)
        }
        Input::Archive(archive) if options.method.needs_triangles() => Err(CliError::usage(format!(
            "{}: an archive has no triangles, which --method {} needs: name the scene that it was baked from (.glb or \
             .gltf)",
            archive.name(),
            options.method,
        ))),
        input => {
            let archive = input.into_archive(false)?;
            let svo = archive.svo()?;
            cancel::check()?;
            let views = views.unwrap_or_else(|| {
                let info = archive.scene_info();
                sampled(&options.views, &svo, [info.bounds_min, info.bounds_max])
            });
            let gpu = open_gpu(options)?;
            let ingredients = Ingredients {
                svo: Some(&svo),
                with_colors: options.colors,
                gpu: gpu.as_ref(),
                ..Ingredients::default()
            };
            let method = renderer(options.method, &ingredients)?;
            write(options, kind, file, &views, &*method, prepared, progress)
        }
    }
}

fn output_kind(options: &Options) -> Result<OutputKind, CliError> {
    let path = &options.output;
    let ending = path.extension().map(|extension| extension.to_ascii_lowercase());
    let kind = match ending.as_deref().and_then(|ending| ending.to_str()) {
        Some("npy") => OutputKind::Array,
        Some("exr") => OutputKind::Picture,
        _ => {
            let message = format!("{}: name the maps with the ending .npy or .exr", path.display());
            return Err(CliError::usage(message));
        }
    };
    if options.colors && kind == OutputKind::Array {
        return Err(CliError::usage("--colors needs an EXR, which has a place for them: -o D.exr"));
    }
    let inputs = [
        Some(&options.input),
        match &options.views {
            ViewSource::File(path) => Some(path),
            ViewSource::Sample(_) => None,
        },
    ];
    if inputs.into_iter().flatten().any(|input| is_same_file(input, path)) {
        let message = format!("{}: the output would replace an input: name another", path.display());
        return Err(CliError::usage(message));
    }
    Ok(kind)
}

fn is_same_file(a: &Path, b: &Path) -> bool {
    match (fs_err::canonicalize(a), fs_err::canonicalize(b)) {
        (Ok(a), Ok(b)) => a == b,
        _ => false,
    }
}

fn read_views(path: &Path, max_memory: u64) -> Result<Vec<View>, CliError> {
    let file = fs_err::File::open(path).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => CliError::bad_input(format_args!(
            "{}: there is no such file; write one with `numpy.save`, float32 (n, 7): position, axis, half field of view \
             in radians; or take --views random:1000",
            path.display()
        )),
        _ => CliError::bad_input(format_args!("{error}")),
    })?;
    let name = path.display().to_string();
    let source = io::BufReader::new(file.into_parts().0);
    let mut reader = ArrayReader::<f32, _>::new(name.clone(), source, &[&[None, Some(7)]])?;
    let count = reader.shape()[0];
    if count >= u64::from(u32::MAX) {
        return Err(CliError::bad_input(format!("{name}: {count} views are more than can be numbered")));
    }
    let needed_bytes = count * size_of::<View>() as u64;
    if needed_bytes > max_memory {
        return Err(ViewError::Budget { budget_bytes: max_memory, what: "the views", needed_bytes }.into());
    }
    let mut numbers = vec![0.0f32; BATCH];
    // Grows with what is there, not with what the header claims.
    let mut views = Vec::new();
    loop {
        cancel::check()?;
        let found = reader.read(&mut numbers)?;
        if found == 0 {
            return Ok(views);
        }
        views.extend(
            numbers[..found].chunks_exact(7).map(|v| View::new([v[0], v[1], v[2]], [v[3], v[4], v[5]], v[6])),
        );
    }
}

fn sampled(source: &ViewSource, svo: &Svo, bounds: [[f64; 3]; 2]) -> Vec<View> {
    match source {
        ViewSource::Sample(sample) => sample.views(svo, bounds),
        ViewSource::File(_) => Vec::new(),
    }
}

fn open_gpu(options: &Options) -> Result<Option<GpuContext>, CliError> {
    let gpu = || GpuContext::open(&AdapterChoice::from_env());
    match options.backend {
        Backend::Cpu => Ok(None),
        _ if !options.method.runs_on_gpu() => Ok(None),
        Backend::Gpu => gpu().map(Some).map_err(|error| CliError::new(Exit::BadInput, error)),
        Backend::Auto => Ok(gpu().ok().filter(|gpu| !gpu.is_software())),
    }
}

/// Draws the views, writes them pass by pass, and tells what was done.
fn write(
    options: &Options,
    kind: OutputKind,
    mut file: AtomicFile,
    views: &[View],
    method: &dyn ViewRenderer,
    begun: Instant,
    progress: &Progress,
) -> CliResult {
    let mut settings = ViewSettings {
        with_colors: options.colors,
        budget_bytes: options.max_memory,
        culling: !options.no_culling,
        ..ViewSettings::new(options.resolution)
    };
    if kind == OutputKind::Picture {
        if views.is_empty() {
            return Err(CliError::usage(
                "there are no views to make a picture of: name an output that ends in .npy",
            ));
        }
        let needed_bytes = MapsPicture::bytes(views.len(), &settings);
        let what = "the picture of all maps (an output that ends in .npy needs no memory)";
        let budget_bytes = settings.budget_bytes;
        settings.budget_bytes = budget_bytes.checked_sub(needed_bytes).ok_or(ViewError::Budget {
            budget_bytes,
            what,
            needed_bytes,
        })?;
    }
    announce(options, views.len(), kind, &settings);
    let unwritten = |source| AtomicFileError { path: options.output.clone(), action: "write it", source };
    let prepare_seconds = begun.elapsed().as_secs_f64();
    let clock = Instant::now();
    let mut tally = Tally::default();
    let mut failure = None;
    progress.begin("views", views.len() as u64, "views");
    if kind == OutputKind::Array {
        let mut array = MapsArray::new(file, views.len(), options.resolution).map_err(unwritten)?;
        let result = method.render_passes(views, &settings, &mut |pass| {
            tally.add(&pass, progress)?;
            array.write(pass).map_err(|error| {
                failure = Some(error);
                ViewError::Cancelled
            })
        });
        ended(result, failure.map(unwritten))?;
        file = array.finish();
    } else {
        let mut picture = MapsPicture::new(views.len(), &settings);
        let result = method.render_passes(views, &settings, &mut |pass| {
            tally.add(&pass, progress)?;
            picture.draw(&pass);
            Ok(())
        });
        ended(result, None)?;
        picture.write_exr(&mut file).map_err(unwritten)?;
    }
    cancel::check()?;
    let seconds = clock.elapsed().as_secs_f64();
    file.commit()?;
    progress.finish();
    let without_map = views.iter().filter(|view| !view.is_drawable()).count() as u64;
    tell(options, views.len() as u64, &tally, without_map, [prepare_seconds, seconds])
}

/// What passes had in them.
#[derive(Debug, Default)]
struct Tally {
    passes: u64,
    maps: u64,
    largest_pass_bytes: u64,
}

impl Tally {
    fn add(&mut self, pass: &ViewMaps, progress: &Progress) -> Result<(), ViewError> {
        self.passes += 1;
        self.maps += pass.centers().len() as u64;
        self.largest_pass_bytes = self.largest_pass_bytes.max(pass.bytes());
        progress.advance(pass.views().len() as u64);
        if progress.cancelled() { Err(ViewError::Cancelled) } else { Ok(()) }
    }
}

/// The end of drawing: a file that could not be written goes before what the method made of it.
fn ended(result: Result<(), ViewError>, failure: Option<AtomicFileError>) -> Result<(), CliError> {
    match failure {
        Some(error) => Err(error.into()),
        None => Ok(result?),
    }
}

fn announce(options: &Options, views: usize, kind: OutputKind, settings: &ViewSettings) {
    let texels = views as u64 * texel_count(options.resolution) as u64;
    let output_bytes = match kind {
        OutputKind::Array => 4 * texels,
        OutputKind::Picture => MapsPicture::bytes(views, settings),
    };
    match options.format {
        Format::Json => eprintln!(
            "{}",
            json!({
                "event": "estimate",
                "views": views,
                "texels": texels,
                "output_bytes": output_bytes,
                "budget_bytes": settings.budget_bytes,
            })
        ),
        Format::Text => eprintln!(
            "{:>12}  {} by {}, {} of maps, memory at most {}",
            "about to draw",
            counted(views as u64, "view"),
            options.method,
            bytes(output_bytes),
            bytes(options.max_memory),
        ),
    }
}

fn tell(
    options: &Options,
    views: u64,
    tally: &Tally,
    without_map: u64,
    [prepare, draw]: [f64; 2],
) -> CliResult {
    match options.format {
        Format::Json => print_json(&json!({
            "output": options.output.display().to_string(),
            "method": options.method.name(),
            "resolution": options.resolution,
            "views": views,
            "without_map": without_map,
            "maps": tally.maps,
            "passes": tally.passes,
            "largest_pass_bytes": tally.largest_pass_bytes,
            "seconds": { "prepare": prepare, "draw": draw },
        }))?,
        Format::Text => {
            eprintln!(
                "{}: {} by {}, {} in {}, {draw:.2} s",
                options.output.display(),
                counted(views, "view"),
                options.method,
                counted(tally.maps, "map"),
                if tally.passes == 1 { "1 pass".to_owned() } else { format!("{} passes", tally.passes) },
            );
            if without_map > 0 {
                let views = counted(without_map, "view");
                eprintln!("{views} at positions that are not finite: their maps are empty");
            }
        }
    }
    Ok(Exit::Done)
}

impl From<ViewError> for CliError {
    fn from(error: ViewError) -> Self {
        let exit = match error {
            ViewError::Resolution { .. } | ViewError::Texels { .. } | ViewError::Unsupported { .. } => {
                Exit::Usage
            }
            ViewError::Budget { .. } => Exit::OverBudget,
            ViewError::Device(_) => Exit::Internal,
            ViewError::Cancelled => Exit::Cancelled,
        };
        Self::new(exit, error)
    }
}
