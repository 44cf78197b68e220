//! `manyview render`.

mod inputs;

use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Instant;

use clap::ValueEnum;
use manyview::LoadError;
use manyview::bench::SceneSource;
use manyview::exact::ExactRays;
use manyview::gpu::{GpuContext, StreamError};
use manyview::npy;
use manyview::preview::{Camera, PictureFormat, write_picture};
use manyview::radiosity::{Primaries, VplOptions};
use manyview::render::gbuffer::{GBuffer, MAX_PIXELS, MAX_SIDE};
use manyview::render::glow::glow;
use manyview::render::image::{Exposure, LitImage, Provenance, RenderError, picture, render_with};
use manyview::render::lights::{CHOICE_LIGHTS, LightSource, MAX_LIGHTS};
use manyview::render::methods::{Ingredients, Method, MethodError, visibility};
use manyview::render::raster;
use manyview::render::scene::RenderScene;
use manyview::render::shade::Lighting;
use manyview::visibility::{Visibility, light_words};
use manyview_cache::atomic::AtomicFile;
use manyview_pipeline::bake::Progress as _;
use manyview_pipeline::scene::PunctualLight;
use serde_json::{Value, json};

use super::Format;
use super::cancel;
use super::error::{CliError, CliResult, Exit};
use super::gather;
use super::gi;
use super::output::{bytes, count, counted, print, print_json};
use super::overwrite::check_outputs;
use super::progress::Progress;
use inputs::{archive_of, camera_of, lights_of, load, open_gpu, tell};

/// Options of `render`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Options {
    /// A .glb or .gltf file, or KIND:TRIANGLES for a generated scene, such as town:100000
    #[arg(value_name = "SCENE")]
    scene: SceneSource,
    /// The scene's archive, for methods that read one; without it the scene is baked in memory
    #[arg(long, value_name = "A.mvb")]
    bake: Option<PathBuf>,
    /// `scene` (the glTF's lights), a file, `random:N[:SEED]`, `particles:N[:SEED]`, or `vpl:N[:BOUNCES[:SEED]]`: the scene's
    /// lights and what surfaces send on of their light, by N virtual lights
    /// [default: the glTF's lights, or random:256 where it has none]
    #[arg(long, value_name = "LIGHTS", value_parser = LightSource::from_str)]
    lights: Option<LightSource>,
    /// Add the light that comes over one surface: `points:VIEWS` lights the bake's octree and draws what VIEWS well-spread pixels
    /// see of it (`points`: 4096), the others take the mean of those near; `raycast:VIEWS` is the same by exact casts
    #[arg(long, value_name = "points[:VIEWS]", value_parser = gi::Points::from_str)]
    gi: Option<gi::Points>,
    /// How it is found which lights a surface sees
    #[arg(long, value_name = "METHOD", default_value = "raytrace", value_parser = Method::from_str)]
    visibility: Method,
    /// `auto` (from inside where the scene is mostly rooms), `inside`, or a file
    #[arg(long, value_name = "auto|inside|FILE", default_value = "auto")]
    camera: String,
    /// Pixels
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1024x1024")]
    size: Size,
    /// The picture: .png for a screen, .exr for 32-bit floats; may be repeated
    #[arg(short, long, value_name = "P.png|P.exr", required = true)]
    output: Vec<PathBuf>,
    /// Stops between radiance and the tone-mapped picture, or `auto`
    #[arg(long, value_name = "EV|auto", default_value = "auto", value_parser = exposure, allow_hyphen_values = true)]
    exposure: Exposure,
    /// Draw the lights themselves, in .png only: small discs
    #[arg(long)]
    show_lights: bool,
    /// Also write which lights each pixel does not see: uint32 (height, width, words), bit l % 32 of word l / 32 for
    /// light l, 0 where there is no surface; for `compare --light-bits`
    #[arg(long, value_name = "B.npy")]
    light_bits: Option<PathBuf>,
    /// What finds the surfaces of the pixels and runs the method, if it can run there; `auto` takes a GPU if it is not a software one
    #[arg(long, value_enum, default_value_t = Backend::Auto)]
    backend: Backend,
    #[command(flatten)]
    gather: gather::Arguments,
    /// Seconds into the first animation; without it the rest pose is drawn
    #[arg(long, value_name = "SECONDS")]
    time: Option<f64>,
    /// Let the scene's URIs leave its folder
    #[arg(long)]
    allow_outside: bool,
    /// Of the summary on stdout; with `json`, progress on stderr comes as JSON events too
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

const AFTER_HELP: &str = "\
An EXR has linear radiance in R, G, B (not multiplied by the exposure) and the layers albedo, depth, normal, position \
(metres, +infinity where there is nothing), shadow (hidden lights / all lights) and, if anything glows, emissive; its \
attribute `manyview` says how it was made.\n\
\n\
A file of lights is JSON (a list, or an object with the list as `lights`), TOML ([[lights]]), CSV (x,y,z or \
x,y,z,r,g,b) or NumPy (float32 (n, 3) or (n, 6), likewise). A light has position ([x, y, z], metres), and if need be color ([r, g, b], linear), intensity (candela), \
range (metres), and for a spot direction, inner_angle and outer_angle (degrees).\n\
\n\
A camera file is JSON or TOML with eye and target ([x, y, z], metres), and if need be up ([x, y, z], +Y unless given) and \
fov (vertical, degrees, 40 unless given).";

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Backend {
    Auto,
    Cpu,
    Gpu,
}

/// A picture size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Size([u32; 2]);

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side = |text: &str| text.parse::<u32>().ok().filter(|side| (1..=MAX_SIDE).contains(side));
        text.split_once('x')
            .and_then(|(width, height)| Some(Self([side(width)?, side(height)?])))
            .filter(|Self([width, height])| u64::from(*width) * u64::from(*height) <= MAX_PIXELS)
            .ok_or_else(|| {
                format!(
                    "write WIDTHxHEIGHT, such as 1280x720, of 1 to {MAX_SIDE} pixels a side and at most {MAX_PIXELS} in all"
                )
            })
    }
}

pub(super) fn exposure(text: &str) -> Result<Exposure, String> {
    match text {
        "auto" => Ok(Exposure::Auto),
        text => text.parse().ok().filter(|stops: &f32| stops.abs() <= 60.0).map(Exposure::Stops).ok_or_else(
            || "write `auto`, or stops from -60 to 60: radiance is multiplied by 2 to this power".to_owned(),
        ),
    }
}

/// Runs `render`.
pub(crate) fn run(options: &Options) -> CliResult {
    let formats = output_formats(options)?;
    spare_inputs(options)?;
    if options.format == Format::Json {
        cancel::tell_events();
    }
    let progress = Progress::new(options.format, cancel::watch());
    let result = draw(options, &formats, &progress);
    progress.finish();
    result
}

fn draw(options: &Options, formats: &[PictureFormat], progress: &Progress) -> CliResult {
    let clock = Instant::now();
    let vpls = vpl_options(options);
    check_gi(options, vpls.is_some())?;
    let maps = options.gather.maps()?;
    let scene = load(options)?;
    let archive = archive_of(options, &scene)?;
    cancel::check()?;
    let exact = ExactRays::new(scene.reference());
    cancel::check()?;
    let camera = camera_of(options, &scene)?;
    cancel::check()?;
    let mut lights = lights_of(options, &scene, &exact)?;
    if vpls.is_some() && Primaries::new(&scene, exact.reference(), &lights).are_dark() {
        tell(
            options.format,
            "note",
            "the scene has no lights of its own, and nothing glows: one light in view is taken",
        );
        lights = vec![gather::default_light(&scene, &exact, &camera)];
    }
    let gpu = open_gpu(options.backend, options.visibility)?;
    let ingredients =
        Ingredients { scene: &scene, exact: &exact, archive: archive.as_ref(), gpu: gpu.as_ref(), maps };
    let [width, height] = options.size.0;
    let (small_lights, path_seconds) = match &vpls {
        Some(vpls) => {
            let (found, seconds) = gather::virtual_lights(&scene, &exact, &lights, vpls);
            if found.is_empty() {
                tell(
                    options.format,
                    "warning",
                    "no light reaches any surface that sends some on: there are no virtual lights",
                );
            }
            (Some(found), seconds)
        }
        None if lights.len() > MAX_LIGHTS => (Some(gather::as_points(&lights)?), 0.0),
        // Which lights a pixel sees can only be told if it asks for all.
        None if lights.len() > CHOICE_LIGHTS && options.light_bits.is_none() => {
            (gather::as_points(&lights).ok(), 0.0)
        }
        None => (None, 0.0),
    };
    check_gi(options, small_lights.is_some())?;
    let only_indirect = options.gi.is_some() && options.gather.indirect_only;
    if small_lights.is_some() && options.light_bits.is_some() {
        let message =
            "--light-bits says which of all lights a pixel sees; here each is lit by a choice of lights";
        return Err(CliError::usage(message));
    }
    // The few that virtual lights come from are tested exactly.
    let few = if options.visibility == Method::None { Method::None } else { Method::RayTrace };
    let light_method = if small_lights.is_some() { few } else { options.visibility };
    let method = visibility(light_method, &ingredients).map_err(method_error)?;
    let light_count = small_lights.as_ref().map_or(lights.len(), Vec::len);
    announce(options, light_count, small_lights.is_some());

    // What cannot be written is not worth the work.
    for output in options.output.iter() {
        drop(AtomicFile::create(output)?);
    }
    let mut bits = match &options.light_bits {
        Some(path) => Some(BitsFile::create(path, [width, height], lights.len())?),
        None => None,
    };
    let prepared = clock.elapsed().as_secs_f64() - path_seconds;
    let gbuffer = gbuffer(&scene, &exact, &camera, [width, height], gpu.as_ref(), progress)?;
    cancel::check()?;
    let surfaces = clock.elapsed().as_secs_f64() - path_seconds;
    let surface_count = gbuffer.surface_count();
    let mut lighting = Lighting::new(&lights, &scene);
    let direct_lights: &[PunctualLight] = match (&small_lights, &vpls) {
        (None, _) if only_indirect => &[],
        (None, _) => &lights,
        (Some(_), Some(_)) if !options.gather.indirect_only => &lights,
        (Some(_), _) => &[],
    };
    let is_gathered = small_lights.is_some() || options.gi.is_some();
    let mut image = match direct_lights.is_empty() {
        true if is_gathered => LitImage::dark(&gbuffer, !options.gather.indirect_only),
        _ => {
            if is_gathered {
                lighting = lighting.without_ambient();
            }
            light(&lighting, &scene, &gbuffer, direct_lights, &*method, bits.as_mut(), progress)?
        }
    };
    let mut pairs = surface_count as u64 * direct_lights.len() as u64;
    let lit = clock.elapsed().as_secs_f64() - path_seconds;
    let mut gathered = Value::Null;
    if let Some(small_lights) = &small_lights {
        let spread = camera.ray_maker(width, height)?.pixel_spread();
        let light = gather::gather(
            &options.gather,
            options.visibility,
            &ingredients,
            &gbuffer,
            spread,
            small_lights,
            progress,
        )?;
        image.add(&gbuffer, &light.irradiance);
        if direct_lights.is_empty() {
            image.shadow = light.shadow;
        }
        pairs += light.tests;
        gathered = light.report;
    }
    let mut over_points = Value::Null;
    if let Some(points) = options.gi {
        let spread = camera.ray_maker(width, height)?.pixel_spread();
        let (light, report) =
            gi::light_over_points(points, &ingredients, &gbuffer, spread, &lights, &*method, progress)?;
        image.add(&gbuffer, &light);
        over_points = report;
    }
    let done = clock.elapsed().as_secs_f64() - path_seconds;
    let exposure_stops = image.stops(options.exposure);
    let mean_shadow = image.shadow.iter().map(|&s| f64::from(s)).sum::<f64>() / surface_count.max(1) as f64;
    let provenance =
        Provenance { visibility: options.visibility.name(), lights: light_count, exposure_stops };
    let glow = match options.show_lights {
        true => glow(&gbuffer, &camera, &lights, scene.radius())?,
        false => Vec::new(),
    };
    let picture = picture(&gbuffer, image, &glow, &provenance);
    for (path, format) in options.output.iter().zip(formats) {
        cancel::check()?;
        write_picture(path, *format, &picture)?;
    }
    if let Some(bits) = bits {
        bits.finish()?;
    }
    progress.finish();
    let seconds = done - surfaces;
    let paths: Vec<String> = options.output.iter().map(|path| path.display().to_string()).collect();
    match options.format {
        Format::Json => print_json(&json!({
            "outputs": paths,
            "visibility": options.visibility.name(),
            "width": width,
            "height": height,
            "surface_pixels": surface_count,
            "lights": light_count,
            "primary_lights": vpls.is_some().then_some(lights.len()),
            "segments": pairs,
            "gathered": gathered,
            "gi": over_points,
            "mean_shadow": mean_shadow,
            "exposure_stops": exposure_stops,
            "surfaces_on": gpu.as_ref().map_or("cpu", |gpu| gpu.name()),
            "seconds": {
                "prepare": prepared,
                "surfaces": surfaces - prepared,
                "paths": path_seconds,
                "lights": lit - surfaces,
                "gather": done - lit,
            },
        }))?,
        Format::Text => print(&format!(
            "{}: {width} × {height} pixels, {}, {:.1}% of segments hidden, exposure {exposure_stops:+.2} stops; {} \
             segments in {seconds:.1} s\n",
            paths.join(", "),
            counted(light_count as u64, "light"),
            mean_shadow * 100.0,
            count(pairs),
        ))?,
    }
    Ok(Exit::Done)
}

fn output_formats(options: &Options) -> Result<Vec<PictureFormat>, CliError> {
    let named = options.output.iter().map(|path| {
        PictureFormat::of_path(path).ok_or_else(|| {
            CliError::usage(format!("{}: name the picture with the ending .png or .exr", path.display()))
        })
    });
    named.collect()
}

/// No output may be an input or another output.
fn spare_inputs(options: &Options) -> Result<(), CliError> {
    let scene = match &options.scene {
        SceneSource::File(path) => Some(("SCENE", &**path)),
        SceneSource::Generated { .. } => None,
    };
    let lights = match &options.lights {
        Some(LightSource::File(path)) => Some(("--lights", &**path)),
        _ => None,
    };
    let camera = match options.camera.as_str() {
        "auto" | "inside" => None,
        file => Some(("--camera", Path::new(file))),
    };
    let archive = options.bake.as_deref().map(|path| ("--bake", path));
    let inputs: Vec<_> = [scene, archive, lights, camera].into_iter().flatten().collect();
    let pictures = options.output.iter().map(|path| ("--output", &**path));
    let outputs: Vec<_> =
        pictures.chain(options.light_bits.as_deref().map(|path| ("--light-bits", path))).collect();
    check_outputs(&inputs, &outputs)
}

/// The virtual lights that are asked for.
fn vpl_options(options: &Options) -> Option<VplOptions> {
    let Some(LightSource::Virtual { count, bounces, seed }) = options.lights else { return None };
    Some(VplOptions { count, bounces, seed, indirect_only: options.gather.indirect_only })
}

/// What `--gi` does not go with: lights that each pixel takes a choice of, and bits that nobody asks for.
fn check_gi(options: &Options, is_gathered: bool) -> Result<(), CliError> {
    if options.gi.is_none() {
        return Ok(());
    }
    if is_gathered {
        return Err(CliError::usage(format!(
            "--gi lights surfaces by every light: name at most {MAX_LIGHTS} with --lights, and not vpl:N, which is another way \
             to the same light"
        )));
    }
    if options.gather.indirect_only && options.light_bits.is_some() {
        let message =
            "--light-bits says which lights a pixel sees; with --indirect-only no pixel asks: leave one out";
        return Err(CliError::usage(message));
    }
    Ok(())
}

fn announce(options: &Options, lights: usize, is_gathered: bool) {
    let [width, height] = options.size.0;
    let pixels = u64::from(width) * u64::from(height);
    let segments = pixels * options.gather.most_samples(lights, is_gathered) as u64;
    let bits = pixels * 4 * light_words(lights) as u64;
    if options.format == Format::Json {
        let event = json!({
            "event": "estimate",
            "pixels": pixels,
            "lights": lights,
            "segments": segments,
            "light_bits_bytes": options.light_bits.as_ref().map(|_| bits),
        });
        eprintln!("{event}");
        return;
    }
    let file = match options.light_bits {
        Some(_) => format!(", {} of light bits", bytes(bits)),
        None => String::new(),
    };
    eprintln!(
        "{:>12}  {} pixels × {} = at most {} segments by {}{file}; memory about {} besides the scene",
        "about to draw",
        count(pixels),
        counted(lights as u64, "light"),
        count(segments),
        options.visibility,
        bytes(pixels * 100 + (80 << 20)),
    );
}

fn gbuffer(
    scene: &RenderScene,
    exact: &ExactRays<'_>,
    camera: &Camera,
    size: [u32; 2],
    gpu: Option<&GpuContext>,
    progress: &Progress,
) -> Result<GBuffer, CliError> {
    let reference = exact.reference();
    let Some(gpu) = gpu else { return Ok(GBuffer::cast(scene, reference, camera, size, progress)?) };
    let count = reference.triangles().len() as u64;
    progress.begin("raster", count, "triangles");
    let triangles = raster::triangles(gpu, scene, reference, camera, size)
        .map_err(|error| CliError::new(Exit::Internal, error))?;
    progress.advance(count);
    Ok(GBuffer::resolve(scene, reference, camera, size, &triangles, progress)?)
}

fn light(
    lighting: &Lighting,
    scene: &RenderScene,
    gbuffer: &GBuffer,
    lights: &[PunctualLight],
    method: &dyn Visibility,
    bits: Option<&mut BitsFile>,
    progress: &Progress,
) -> Result<LitImage, CliError> {
    let result = match bits {
        Some(bits) => {
            let mut sink = |words: &[u32]| npy::write_elements(&mut bits.file, words);
            render_with(lighting, scene, gbuffer, lights, method, Some(&mut sink), progress)
        }
        None => render_with(lighting, scene, gbuffer, lights, method, None, progress),
    };
    result.map_err(render_error)
}

pub(super) fn render_error(error: RenderError) -> CliError {
    let exit = match &error {
        RenderError::Visibility(_) => Exit::Internal,
        RenderError::Bits(_) => Exit::BadInput,
        RenderError::Cancelled => Exit::Cancelled,
    };
    CliError::new(exit, error)
}

/// The file of light bits while it is written.
struct BitsFile {
    file: BufWriter<AtomicFile>,
    path: PathBuf,
}

impl BitsFile {
    fn create(path: &Path, [width, height]: [u32; 2], lights: usize) -> Result<Self, CliError> {
        let mut file = BufWriter::with_capacity(1 << 20, AtomicFile::create(path)?);
        let shape = [height as usize, width as usize, light_words(lights)];
        let begun = npy::write_header::<u32>(&mut file, &shape);
        let bits = Self { file, path: path.to_owned() };
        begun.map_err(|error| bits.failed(&error))?;
        Ok(bits)
    }

    fn finish(mut self) -> Result<(), CliError> {
        self.file.flush().map_err(|error| self.failed(&error))?;
        let path = self.path;
        let file = self.file.into_inner();
        file.map_err(|error| CliError::bad_input(format!("{}: {error}", path.display())))?.commit()?;
        Ok(())
    }

    fn failed(&self, error: &std::io::Error) -> CliError {
        CliError::bad_input(format!("{}: cannot write the light bits: {error}", self.path.display()))
    }
}
/// What is wrong with an archive keeps its own exit code.
pub(super) fn method_error(error: MethodError) -> CliError {
    let load = error.source.downcast_ref::<LoadError>().or_else(|| {
        match error.source.downcast_ref::<StreamError>() {
            Some(StreamError::Load(load)) => Some(load),
            _ => None,
        }
    });
    let exit = match load {
        Some(load) if load.is_corruption() => Exit::Corrupt,
        Some(load) if load.is_over_budget() => Exit::OverBudget,
        _ => Exit::BadInput,
    };
    CliError::new(exit, error)
}
