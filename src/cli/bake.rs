//! `manyview bake`.

mod explain;
mod watch;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::ValueEnum;
use manyview::gpu::{AdapterChoice, GpuDevice};
use manyview_cache::archive::{ArchiveError, ArchiveErrorKind};
use manyview_pipeline::bake::{BakeError, RowsFrom, VoxelsFrom};
use manyview_pipeline::import::ImportError;
use manyview_pipeline::recipe::{Recipe, SceneSource, parse_fit, parse_rows_from, parse_rows_size};
use manyview_pipeline::rows::RowsOptions;
use manyview_pipeline::run::{Bake, RunError, Summary};
use manyview_pipeline::steps::{StepCount, StepCounts, StepKind};
use manyview_shaders::cpu_device::CpuDevice;
use manyview_shaders::device::VoxelDevice;
use manyview_shaders::directions::{DirectionSet, Fit};
use serde_json::json;

use super::Format;
use super::cache::CacheOptions;
use super::cancel;
use super::error::{CliError, CliResult, Exit};
use super::output::{bytes, count, print, print_json};
use super::overwrite::check_outputs;
use super::progress::{Progress, estimate_event, estimate_line};

/// Options of `bake`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Options {
    /// The scene: a .glb or .gltf file [default: the recipe's]
    #[arg(value_name = "SCENE", required_unless_present = "recipe")]
    scene: Option<PathBuf>,
    /// The archive [default: the recipe's, or the scene's name with .mvb]
    #[arg(short, long, value_name = "OUT.mvb")]
    output: Option<PathBuf>,
    /// Settings in a TOML file; options given here win over it
    #[arg(long, value_name = "FILE")]
    recipe: Option<PathBuf>,
    /// Depth of the octree, 1 to 13: 11 gives 2048³ voxels [default: 11]
    #[arg(long, value_name = "N")]
    levels: Option<u32>,
    /// Voxels a side of each direction's rows: 32, 64, 128, 256; 0 for none [default: 128]
    #[arg(long, value_name = "N", value_parser = rows_size)]
    rows: Option<RowsSize>,
    /// Sampled directions: latlong:THETASxPHIS or octahedral:N [default: latlong:90x90]
    #[arg(long, value_name = "SET", value_parser = DirectionSet::from_str)]
    directions: Option<DirectionSet>,
    /// Grid of each direction: `extent` fits the scene, `cube` is the paper's [default: extent]
    #[arg(long, value_name = "extent|cube", value_parser = parse_fit)]
    grid: Option<Fit>,
    /// How rows are made: `points` rotates dense surface points, `peel` voxelizes every direction (the paper's
    /// Algorithm 1), `rotate` rotates one voxelization (its Algorithm 5) [default: points]
    #[arg(long, value_name = "points|peel|rotate", value_parser = parse_rows_from)]
    rows_from: Option<RowsFrom>,
    /// How octree voxels are found; `peel` (depth peeling; on the CPU slow, by one thread) gives the same voxels
    #[arg(long, value_enum, default_value_t = VoxelsFromName::Raster)]
    voxels_from: VoxelsFromName,
    /// Where the voxels are made; every backend gives the same bytes. `auto` takes a GPU if it is not a software one
    #[arg(long, value_enum, default_value_t = Backend::Auto)]
    backend: Backend,
    /// Threads [default: one per processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    jobs: Option<u32>,
    /// Most memory to plan for, such as 8GiB or 500MiB
    #[arg(long, value_name = "SIZE", default_value = "8GiB", value_parser = memory_size)]
    max_memory: u64,
    /// Seconds into the first animation; without it the rest pose is baked
    #[arg(long, value_name = "SECONDS")]
    time: Option<f64>,
    /// Let the scene's URIs leave its folder
    #[arg(long)]
    allow_outside: bool,
    #[command(flatten)]
    cache: CacheOptions,
    /// Only say what the bake would cost
    #[arg(long)]
    dry_run: bool,
    /// Say of every step whether the cache has it, and why not
    #[arg(long)]
    explain: bool,
    /// Bake again whenever the scene, or a file that it refers to, changes; until interrupted
    #[arg(long, conflicts_with = "dry_run")]
    watch: bool,
    /// Write the files that the archive depends on as a rule for make and ninja
    #[arg(long, value_name = "FILE")]
    depfile: Option<PathBuf>,
    /// Also draw a picture of the result (PNG or EXR) [default: the recipe's]
    #[arg(long, value_name = "P.png|P.exr")]
    preview: Option<PathBuf>,
    /// Of the summary on stdout; with `json`, progress on stderr comes as JSON events too
    /// (between them, graphics drivers may write lines of their own)
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

const AFTER_HELP: &str = "The archive's bytes depend on the scene and on levels, rows, directions, grid, rows-from and \
the cube alone: not on backend, jobs, folder or time.";

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Backend {
    Auto,
    Cpu,
    Gpu,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum VoxelsFromName {
    Raster,
    Peel,
}

/// log2 of voxels a side; `None` for no rows.
#[derive(Debug, Clone, Copy)]
struct RowsSize(Option<u32>);

fn rows_size(text: &str) -> Result<RowsSize, String> {
    let size = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    parse_rows_size(size).map(RowsSize)
}

/// Bytes, from a number with an optional unit (B, KiB, MiB, GiB, TiB; KB, MB, GB, TB).
pub(crate) fn memory_size(text: &str) -> Result<u64, String> {
    let digits = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let unit_bytes: u64 = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1,
        "k" | "kib" => 1 << 10,
        "m" | "mib" => 1 << 20,
        "g" | "gib" => 1 << 30,
        "t" | "tib" => 1 << 40,
        "kb" => 1_000,
        "mb" => 1_000_000,
        "gb" => 1_000_000_000,
        "tb" => 1_000_000_000_000,
        _ => return Err(format!("`{unit}` is no unit: use B, KiB, MiB, GiB or TiB")),
    };
    match number.parse::<f64>() {
        Ok(number) if number.is_finite() => Ok((number * unit_bytes as f64) as u64),
        _ => Err(format!("`{text}` is no size: write for example 8GiB")),
    }
}

impl Options {
    /// With `json`, everything on stderr has to be an event.
    pub(crate) fn format(&self) -> Format {
        self.format
    }
}

fn warn(format: Format, warnings: &[String]) {
    for warning in warnings {
        match format {
            Format::Text => eprintln!("warning: {warning}"),
            Format::Json => eprintln!("{}", json!({"event": "warning", "message": warning})),
        }
    }
}

/// Runs the command.
pub(crate) fn run(options: &Options) -> CliResult {
    if options.format == Format::Json {
        cancel::tell_events();
    }
    if options.watch {
        return watch::run(options);
    }
    run_once(options).result.map(|()| Exit::Done)
}

/// How one bake ended, and what it has looked at.
pub(super) struct Outcome {
    pub(super) result: Result<(), CliError>,
    /// Files that were read or looked for, as far as it got.
    pub(super) inputs: Vec<PathBuf>,
}

pub(super) fn run_once(options: &Options) -> Outcome {
    let mut inputs: Vec<PathBuf> = options.recipe.iter().chain(&options.scene).cloned().collect();
    let result = bake_once(options, &mut inputs);
    Outcome { result, inputs }
}

fn bake_once(options: &Options, inputs: &mut Vec<PathBuf>) -> Result<(), CliError> {
    let recipe = match &options.recipe {
        Some(path) => Recipe::read(path).map_err(CliError::bad_input)?,
        None => Recipe::default(),
    };
    let mut bake = plan(options, &recipe)?;
    if let SceneSource::File(scene) = &bake.source {
        inputs.push(scene.clone());
    }
    inputs.extend(recipe.camera.clone());
    if options.dry_run {
        return dry_run(options, &mut bake);
    }
    spare_inputs(options, &recipe, &bake)?;
    let picture = options.preview.as_ref().or(recipe.preview.as_ref());
    for output in [Some(&bake.output), picture].into_iter().flatten() {
        make_recipe_folder(&recipe, output)?;
    }
    let clock = std::time::Instant::now();
    let store = options.cache.open(|warning| warn(options.format, &[warning]))?;
    bake.store.clone_from(&store);
    let progress = Progress::new(options.format, cancel::watch());
    let result = bake_or_reuse(options, &mut bake, &progress);
    progress.finish();
    if let Some(store) = &store {
        warn(options.format, &store.take_warnings());
    }
    let (summary, backend) = result.inspect_err(|error| inputs.extend(error.missing_file()))?;
    inputs.extend(summary.files.iter().cloned());
    warn(options.format, &summary.warnings);
    if let Some(path) = &options.depfile {
        write_depfile(path, &bake.output, &summary, options.recipe.as_deref())?;
    }
    if let Some(picture) = picture {
        super::preview::draw_default(&bake.output, picture, recipe.camera.as_deref())?;
    }
    report(options.format, &bake, &summary, &backend, clock.elapsed().as_secs_f64())
}

/// The summary, and the name of what baked.
fn bake_or_reuse(
    options: &Options,
    bake: &mut Bake,
    progress: &Progress,
) -> Result<(Summary, String), CliError> {
    // Opening a GPU takes longer than to see that there is nothing to do.
    if let Some(summary) = bake.up_to_date()? {
        bake.touch_output();
        if options.explain {
            explain::tell(options.format, &[]);
        }
        return Ok((summary, "nothing".to_owned()));
    }
    if options.explain {
        explain::tell(options.format, &bake.explain()?);
    }
    let device = open_device(options.backend, options.voxels_from, options.max_memory)?;
    bake.options.held_bytes = status_bytes("VmRSS:").unwrap_or(0);
    let device = device.as_deref();
    let backend = device.map_or_else(|| "cpu".to_owned(), VoxelDevice::name);
    Ok((bake.run_on(device, progress)?, backend))
}

/// Says what a bake would cost, and with `--explain` what would become of every step.
fn dry_run(options: &Options, bake: &mut Bake) -> Result<(), CliError> {
    let (estimate, warnings) = bake.estimate()?;
    warn(options.format, &warnings);
    let mut event = estimate_event(&estimate);
    if options.format == Format::Text {
        print(&format!("{}\n", estimate_line(&estimate)))?;
    }
    if options.explain {
        bake.store = options.cache.open_if_there()?;
        let steps = match bake.up_to_date()? {
            Some(_) => Vec::new(),
            None => bake.explain()?,
        };
        match options.format {
            Format::Text => print(&explain::text(&steps))?,
            Format::Json => event["steps"] = explain::json(&steps),
        }
    }
    match options.format {
        Format::Text => Ok(()),
        Format::Json => print_json(&event),
    }
}

/// The bake that options and recipe ask for.
fn plan(options: &Options, recipe: &Recipe) -> Result<Bake, CliError> {
    let source = match (&options.scene, &recipe.scene) {
        (Some(path), _) => SceneSource::File(path.clone()),
        (None, Some(source)) => source.clone(),
        (None, None) => {
            return Err(CliError::usage("the recipe names no scene: give one, or add `scene` to it"));
        }
    };
    let output = match (&options.output, &recipe.output, &source) {
        (Some(output), ..) => output.clone(),
        // The recipe's output belongs to the recipe's scene.
        (None, Some(output), _) if options.scene.is_none() => output.clone(),
        (None, _, SceneSource::File(scene)) => scene.with_extension("mvb"),
        (None, _, SceneSource::Generated { kind, .. }) => PathBuf::from(format!("{kind}.mvb")),
    };
    let mut bake = Bake::from_source(source, output);
    bake.options = recipe.options.clone();
    bake.options.max_memory_bytes = options.max_memory;
    if let Some(levels) = options.levels {
        bake.options.levels = levels;
    }
    let defaults = manyview_pipeline::bake::BakeOptions::default().rows.expect("rows are baked by default");
    let base = bake.options.rows.unwrap_or(defaults);
    let bits = match options.rows {
        Some(RowsSize(bits)) => bits,
        None => bake.options.rows.map(|rows| rows.bits),
    };
    bake.options.rows = bits.map(|bits| RowsOptions {
        bits,
        directions: options.directions.unwrap_or(base.directions),
        fit: options.grid.unwrap_or(base.fit),
        from: options.rows_from.unwrap_or(base.from),
    });
    bake.options.voxels_from = match options.voxels_from {
        VoxelsFromName::Raster => VoxelsFrom::Raster,
        VoxelsFromName::Peel => VoxelsFrom::Peel,
    };
    bake.import.allow_outside = options.allow_outside;
    bake.import.time_seconds = options.time.or(recipe.time_seconds);
    if bake.import.time_seconds.is_some_and(|t| !t.is_finite()) {
        return Err(CliError::usage("--time must be a finite number of seconds"));
    }
    bake.import.max_memory_bytes = options.max_memory;
    bake.jobs = options.jobs.map(|jobs| jobs as usize);
    Ok(bake)
}

/// No output may be an input or another output.
fn spare_inputs(options: &Options, recipe: &Recipe, bake: &Bake) -> Result<(), CliError> {
    // A scene that the archive would overwrite is the bake's own error.
    let scene = match &bake.source {
        SceneSource::File(scene) => Some(("SCENE", &**scene)),
        SceneSource::Generated { .. } => None,
    };
    let recipe_file = options.recipe.as_deref().map(|path| ("--recipe", path));
    let camera = recipe.camera.as_deref().map(|path| ("the recipe's camera", path));
    let archive = ("--output", &*bake.output);
    let picture = options.preview.as_deref().or(recipe.preview.as_deref()).map(|path| ("--preview", path));
    let depfile = options.depfile.as_deref().map(|path| ("--depfile", path));
    let settings: Vec<_> = [recipe_file, camera].into_iter().flatten().collect();
    check_outputs(&settings, &[archive])?;
    let inputs: Vec<_> = settings.into_iter().chain(scene).chain([archive]).collect();
    let outputs: Vec<_> = [picture, depfile].into_iter().flatten().collect();
    check_outputs(&inputs, &outputs)
}

/// Makes the folder of an output that the recipe names, so that a fresh clone can run it.
fn make_recipe_folder(recipe: &Recipe, output: &Path) -> Result<(), CliError> {
    let named = [&recipe.output, &recipe.preview].into_iter().flatten().any(|path| path == output);
    match output.parent().filter(|folder| named && !folder.as_os_str().is_empty()) {
        Some(folder) => fs_err::create_dir_all(folder).map_err(CliError::bad_input),
        None => Ok(()),
    }
}

/// Drivers take up to about this when they are asked for their GPUs, also those that turn out to have none: with a smaller
/// limit nobody asks.
const DRIVERS_BYTES: u64 = 256 << 20;

/// What to bake on, unless it is the bake's own code for the CPU.
fn open_device(
    backend: Backend,
    voxels_from: VoxelsFromName,
    max_memory_bytes: u64,
) -> Result<Option<Box<dyn VoxelDevice>>, CliError> {
    let gpu = || GpuDevice::open(&AdapterChoice::from_env());
    match backend {
        Backend::Gpu => match gpu() {
            Ok(gpu) => Ok(Some(Box::new(gpu))),
            Err(error) => Err(CliError::bad_input(format!(
                "{error}; --backend cpu gives the same archive without a GPU"
            ))),
        },
        Backend::Auto
            if max_memory_bytes >= DRIVERS_BYTES
                && let Some(gpu) = gpu().ok().filter(|gpu| !gpu.context().is_software()) =>
        {
            Ok(Some(Box::new(gpu)))
        }
        // Peeling has no fast form on the CPU: it is there to be compared with.
        _ if voxels_from == VoxelsFromName::Peel => Ok(Some(Box::new(CpuDevice))),
        _ => Ok(None),
    }
}

fn write_depfile(
    path: &Path,
    output: &Path,
    summary: &Summary,
    recipe: Option<&Path>,
) -> Result<(), CliError> {
    // make's escapes, which ninja reads too.
    let escaped = |path: &Path| {
        let path = path.display().to_string();
        let path = if cfg!(windows) { path.replace('\\', "/") } else { path };
        path.replace('$', "$$").replace('#', "\\#").replace(' ', "\\ ")
    };
    let mut rule = format!("{}:", escaped(output));
    for file in summary.files.iter().map(PathBuf::as_path).chain(recipe) {
        _ = write!(rule, " \\\n  {}", escaped(file));
    }
    rule.push('\n');
    let mut file = manyview_cache::atomic::AtomicFile::create(path)?;
    std::io::Write::write_all(&mut file, rule.as_bytes())
        .map_err(|error| CliError::bad_input(format!("{}: {error}", path.display())))?;
    file.commit()?;
    Ok(())
}

fn report(
    format: Format,
    bake: &Bake,
    summary: &Summary,
    backend: &str,
    seconds: f64,
) -> Result<(), CliError> {
    let Summary { report, archive, steps, .. } = summary;
    match format {
        Format::Json => print_json(&json!({
            "up_to_date": summary.is_up_to_date,
            "steps": steps_json(steps),
            "output": bake.output.display().to_string(),
            "backend": backend,
            "triangles": report.triangles,
            "leaves": report.leaves,
            "nodes": report.nodes,
            "points": report.points,
            "raw_bytes": archive.raw_bytes,
            "file_bytes": archive.file_bytes,
            "seconds": {
                "import": summary.import_seconds,
                "triangles": report.seconds[0],
                "octree": report.seconds[1],
                "rows": report.seconds[2],
                "all": seconds,
            },
            "peak_memory_bytes": peak_memory_bytes(),
        })),
        Format::Text if summary.is_up_to_date => print(&format!(
            "{}: up to date, {} leaves, {}, seen in {seconds:.3} s\nsteps: {steps}\n",
            bake.output.display(),
            count(report.leaves),
            bytes(archive.file_bytes),
        )),
        Format::Text => {
            let peak =
                peak_memory_bytes().map_or(String::new(), |peak| format!(", peak memory {}", bytes(peak)));
            print(&format!(
                "{}: {} triangles, {} leaves, {} in {seconds:.1} s on {backend}{peak}\nsteps: {steps}\n",
                bake.output.display(),
                count(report.triangles),
                count(report.leaves),
                bytes(archive.file_bytes),
            ))
        }
    }
}

/// Counts of steps as JSON.
pub(crate) fn steps_json(steps: &StepCounts) -> serde_json::Value {
    let total = steps.total();
    let kinds: serde_json::Map<String, serde_json::Value> = StepKind::ALL
        .iter()
        .map(|kind| (kind.name().to_owned(), steps.of(*kind)))
        .filter(|(_, count)| *count != StepCount::default())
        .map(|(name, count)| {
            let StepCount { reused, rebuilt, patched } = count;
            (name, json!({ "reused": reused, "rebuilt": rebuilt, "patched": patched }))
        })
        .collect();
    json!({ "reused": total.reused, "rebuilt": total.rebuilt, "failed": 0, "kinds": kinds })
}

/// The most memory this process has had, where the system tells.
fn peak_memory_bytes() -> Option<u64> {
    status_bytes("VmHWM:")
}

fn status_bytes(key: &str) -> Option<u64> {
    let status = fs_err::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with(key))?;
    let kib: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib << 10)
}

impl From<RunError> for CliError {
    fn from(error: RunError) -> Self {
        let exit = match &error {
            RunError::Import(ImportError::OverLimit { .. }) => Exit::OverBudget,
            RunError::Import(_) => Exit::BadInput,
            RunError::Bake { source, .. } => match source {
                BakeError::Empty { .. } | BakeError::AllTransparent | BakeError::NoVoxels { .. } => {
                    Exit::BadInput
                }
                BakeError::Bounds { .. } | BakeError::CubeTooSmall { .. } => Exit::BadInput,
                BakeError::Parameter { .. } | BakeError::PeelNeedsDevice => Exit::Usage,
                BakeError::OverBudget { .. } => Exit::OverBudget,
                BakeError::Disagreement(_) | BakeError::Device(_) => Exit::Internal,
                BakeError::Archive(error) => archive_exit(error),
                BakeError::Cancelled => Exit::Cancelled,
            },
            RunError::Output(error) => archive_exit(error),
            RunError::OverwritesScene { .. } | RunError::Threads { .. } => Exit::Usage,
        };
        Self::new(exit, error)
    }
}

/// An archive that cannot be written is a bad output.
fn archive_exit(error: &ArchiveError) -> Exit {
    match error.kind() {
        ArchiveErrorKind::Corrupt { .. } => Exit::Corrupt,
        _ => Exit::BadInput,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_sizes_have_units() {
        assert_eq!(memory_size("8GiB"), Ok(8 << 30));
        assert_eq!(memory_size("1.5 MiB"), Ok(3 << 19));
        assert_eq!(memory_size("2GB"), Ok(2_000_000_000));
        assert_eq!(memory_size("77"), Ok(77));
        assert!(memory_size("8 furlongs").is_err());
        assert!(memory_size("GiB").is_err());
    }
}
