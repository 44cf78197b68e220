//! What a picture is made of: scene, archive, lights, camera and GPU, as the options name them.

use std::path::Path;

use manyview::Archive;
use manyview::bench::SceneSource;
use manyview::exact::ExactRays;
use manyview::gpu::{AdapterChoice, GpuContext};
use manyview::preview::{Camera, CameraChoice};
use manyview::render::lights::{DEFAULT_LIGHTS, LightSource, MAX_GATHERED_LIGHTS, MAX_LIGHTS};
use manyview::render::methods::Method;
use manyview::render::scene::{RenderScene, SceneError};
use manyview_pipeline::bake::{BakeOptions, bake_in_memory};
use manyview_pipeline::generate::generate;
use manyview_pipeline::import::{ImportOptions, import};
use manyview_pipeline::run::RunError;
use manyview_pipeline::scene::PunctualLight;
use serde_json::json;

use super::super::Format;
use super::super::camera_file::{describe, read_camera};
use super::super::error::{CliError, Exit};
use super::{Backend, Options};

pub(super) fn load(options: &Options) -> Result<RenderScene, CliError> {
    if options.time.is_some_and(|time| !time.is_finite()) {
        return Err(CliError::usage("--time must be a finite number of seconds"));
    }
    let scene = match &options.scene {
        SceneSource::File(path) => {
            if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mvb")) {
                let path = path.display();
                let message = format!(
                    "{path}: an archive has no triangles to draw; name the scene, and the archive with --bake"
                );
                return Err(CliError::usage(message));
            }
            let import_options = ImportOptions {
                allow_outside: options.allow_outside,
                time_seconds: options.time,
                ..ImportOptions::default()
            };
            import(path, &import_options).map_err(RunError::from)?.scene
        }
        SceneSource::Generated { kind, triangles } => generate(*kind, *triangles, 1),
    };
    for warning in &scene.warnings {
        tell(options.format, "warning", warning);
    }
    RenderScene::new(scene).map_err(|error| scene_error(options, error))
}

fn scene_error(options: &Options, error: SceneError) -> CliError {
    match error {
        SceneError::Unusable(source) => {
            RunError::Bake { scene: scene_name(&options.scene).into(), source }.into()
        }
        SceneError::Load(error) => error.into(),
    }
}

fn scene_name(source: &SceneSource) -> String {
    match source {
        SceneSource::File(path) => path.display().to_string(),
        SceneSource::Generated { kind, triangles } => format!("{kind}:{triangles}"),
    }
}

/// One line on stderr.
pub(super) fn tell(format: Format, kind: &str, message: &str) {
    match format {
        Format::Text => eprintln!("{kind}: {message}"),
        Format::Json => eprintln!("{}", json!({"event": kind, "message": message})),
    }
}

/// The archive that the method or `--gi` reads, if they read any.
pub(super) fn archive_of(options: &Options, scene: &RenderScene) -> Result<Option<Archive>, CliError> {
    let wanted = options.visibility.needs_archive() || options.gi.is_some();
    if let Some(path) = &options.bake {
        let archive = Archive::open(path)?;
        check_belongs(&archive, scene, &options.scene)?;
        if !wanted {
            let message = format!("--visibility {} does not read {}", options.visibility, path.display());
            tell(options.format, "note", &message);
        }
        return Ok(wanted.then_some(archive));
    }
    if !wanted {
        return Ok(None);
    }
    tell(
        options.format,
        "note",
        "no --bake was given: the scene is baked in memory with the default settings",
    );
    let mut bake_options = BakeOptions::default();
    if !options.visibility.needs_rows() {
        bake_options.rows = None;
    }
    let bytes =
        bake_in_memory(&scene.scene, &bake_options).map_err(|source| scene_error(options, source.into()))?;
    Ok(Some(Archive::from_bytes(bytes)?))
}

/// An archive of another scene gives nonsense without any error.
fn check_belongs(archive: &Archive, scene: &RenderScene, source: &SceneSource) -> Result<(), CliError> {
    let info = archive.scene_info();
    let triangles = scene.scene.drawn_triangles();
    let same_bounds =
        info.bounds_min == scene.bounds[0].to_array() && info.bounds_max == scene.bounds[1].to_array();
    if info.triangles == triangles && same_bounds {
        return Ok(());
    }
    Err(CliError::bad_input(format!(
        "{}: this is no bake of {}: it has {} triangles within {:?} … {:?}, the scene {triangles} within {:?} … {:?}; bake \
         the scene again",
        archive.name(),
        scene_name(source),
        info.triangles,
        info.bounds_min,
        info.bounds_max,
        scene.bounds[0].to_array(),
        scene.bounds[1].to_array(),
    )))
}

pub(super) fn lights_of(
    options: &Options,
    scene: &RenderScene,
    exact: &ExactRays<'_>,
) -> Result<Vec<PunctualLight>, CliError> {
    let source = match &options.lights {
        Some(LightSource::Virtual { .. }) if options.gather.primary.is_some() => {
            options.gather.primary.clone().unwrap_or(LightSource::Scene)
        }
        None if scene.scene.lights.is_empty() => {
            let message = "the scene has no lights of its own: --lights random:256 is taken";
            tell(options.format, "note", message);
            DEFAULT_LIGHTS
        }
        Some(source) => source.clone(),
        None => LightSource::Scene,
    };
    let is_virtual = matches!(options.lights, Some(LightSource::Virtual { .. }));
    let lights =
        source.lights(scene, exact.reference()).map_err(|error| CliError::new(Exit::BadInput, error))?;
    if lights.is_empty() && !is_virtual {
        tell(options.format, "warning", "there are no lights: the picture shows ambient light only");
    }
    if lights.len() > if is_virtual { MAX_LIGHTS } else { MAX_GATHERED_LIGHTS } {
        let message = format!(
            "{}: {} lights are too many; name some with --lights, or with --primary",
            scene_name(&options.scene),
            lights.len()
        );
        return Err(CliError::bad_input(message));
    }
    Ok(lights)
}

pub(super) fn camera_of(options: &Options, scene: &RenderScene) -> Result<Camera, CliError> {
    let choice = match options.camera.as_str() {
        "auto" => CameraChoice::Auto,
        "inside" => CameraChoice::Inside,
        file => return read_camera(Path::new(file)),
    };
    let [width, height] = options.size.0;
    let aspect = f64::from(width) / f64::from(height);
    let camera = scene.choose_camera(aspect, choice).map_err(|error| scene_error(options, error))?;
    if options.format == Format::Text {
        eprintln!("{}", describe(&camera));
    }
    Ok(camera)
}

pub(super) fn open_gpu(backend: Backend, method: Method) -> Result<Option<GpuContext>, CliError> {
    let gpu = || GpuContext::open(&AdapterChoice::from_env());
    match backend {
        Backend::Cpu => Ok(None),
        _ if method.needs_gpu() => gpu().map(Some).map_err(|error| CliError::new(Exit::BadInput, error)),
        Backend::Gpu => gpu().map(Some).map_err(|error| CliError::new(Exit::BadInput, error)),
        Backend::Auto => Ok(gpu().ok().filter(|gpu| !gpu.is_software())),
    }
}
