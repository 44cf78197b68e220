//! `manyview render`, the part about more lights than every pixel can ask for: virtual ones, and very many.

use std::str::FromStr;
use std::time::Instant;

use glam::{DVec3, Vec3};
use manyview::exact::ExactRays;
use manyview::preview::Camera;
use manyview::radiosity::{
    FilterOptions, Gather, GatherOptions, Gathered, LightTree, Primaries, Samples, VIEW_LIFT_VOXELS,
    VirtualLight, VplOptions, filter, trace,
};
use manyview::render::gbuffer::GBuffer;
use manyview::render::lights::{LightSource, intensity, point_light};
use manyview::render::methods::{Ingredients, Method, map_renderer, visibility};
use manyview::render::scene::RenderScene;
use manyview::views::{ViewError, ViewSettings};
use manyview::visibility::VisibilityError;
use manyview_pipeline::scene::PunctualLight;
use serde_json::{Value, json};

use super::bake::memory_size;
use super::error::{CliError, Exit};
use super::progress::Progress;

/// Depths are kept in half the memory where all maps take more than this share of the budget.
const HALF_DEPTHS_SHARE: u64 = 4;

/// Options of `render` about maps and about lights that are gathered.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Texels a side of each half of a light's map, for methods that draw maps, and of --gi's views
    #[arg(long, value_name = "R", default_value_t = 16)]
    resolution: u32,
    /// Memory for maps, such as 4GiB; what does not fit is drawn in passes
    #[arg(long, value_name = "SIZE", default_value = "4GiB", value_parser = memory_size)]
    max_memory: u64,
    /// Of virtual lights, or of more than 10,000 points: how many each pixel is lit by, chosen at random by how much they
    /// may give, or `all`
    #[arg(long, value_name = "N|all", default_value = "64", value_parser = samples)]
    vpl_samples: Samples,
    /// Lights nearer than this many metres count as that far away, so that they make no spots; `auto` goes by the scene and the
    /// number of lights, `off` leaves the spots
    #[arg(long, value_name = "auto|off|METRES", default_value = "auto")]
    vpl_clamp: Clamp,
    /// Lights farther than this many metres do not count
    #[arg(long, value_name = "METRES", default_value_t = f32::INFINITY, hide_default_value = true, value_parser = metres)]
    vpl_cutoff: f32,
    /// Choose lights evenly, not by how much they may give
    #[arg(long)]
    vpl_even: bool,
    /// Leave the noise in
    #[arg(long)]
    no_filter: bool,
    /// With vpl:N or --gi: only the light that comes over surfaces
    #[arg(long)]
    pub(super) indirect_only: bool,
    /// With vpl:N: the lights that virtual ones come from, as --lights takes them
    /// [default: the scene's own; else what glows in it; else one light in view]
    #[arg(long, value_name = "LIGHTS", value_parser = LightSource::from_str)]
    pub(super) primary: Option<LightSource>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Clamp {
    Auto,
    Metres(f32),
}

impl FromStr for Clamp {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => Ok(Self::Auto),
            "off" => Ok(Self::Metres(0.0)),
            text => metres(text).map(Self::Metres).map_err(|error| format!("{error}, `auto` or `off`")),
        }
    }
}

fn metres(text: &str) -> Result<f32, String> {
    let metres = text.parse().ok().filter(|metres: &f32| *metres >= 0.0);
    metres.ok_or_else(|| "write metres, 0 or more".to_owned())
}

fn samples(text: &str) -> Result<Samples, String> {
    match text {
        "all" => Ok(Samples::All),
        text => text
            .parse()
            .ok()
            .filter(|count| (1..=65_536).contains(count))
            .map(Samples::Count)
            .ok_or_else(|| "write a number of lights from 1 to 65536, or `all`".to_owned()),
    }
}

impl Arguments {
    /// How maps are drawn.
    pub(super) fn maps(&self) -> Result<ViewSettings, CliError> {
        let settings = ViewSettings { budget_bytes: self.max_memory, ..ViewSettings::new(self.resolution) };
        settings.check().map_err(|error| CliError::new(Exit::Usage, error))?;
        Ok(settings)
    }

    /// How many of the lights a pixel asks for at most.
    pub(super) fn most_samples(&self, lights: usize, is_gathered: bool) -> usize {
        match self.vpl_samples {
            Samples::Count(count) if is_gathered => lights.min(count as usize),
            _ => lights,
        }
    }

    fn options(&self, scene: &RenderScene, lights: usize) -> GatherOptions {
        GatherOptions {
            samples: self.vpl_samples,
            clamp_metres: match self.vpl_clamp {
                Clamp::Auto => GatherOptions::suitable_clamp(scene.radius(), lights),
                Clamp::Metres(metres) => metres,
            },
            cutoff_metres: self.vpl_cutoff,
            by_importance: !self.vpl_even,
            seed: 1,
        }
    }
}

/// A light in view, for scenes without any: on the way to what the middle of the picture shows, up towards the ceiling if
/// there is one.
pub(super) fn default_light(scene: &RenderScene, exact: &ExactRays<'_>, camera: &Camera) -> PunctualLight {
    let free = |from: DVec3, direction: DVec3, most: f64| {
        exact.reference().intersect(from, direction, most).map_or(most, |hit| hit.t)
    };
    let most = scene.extent();
    let forward = (camera.target - camera.eye).normalize_or(DVec3::NEG_Z);
    let ahead = camera.eye + forward * (0.45 * free(camera.eye, forward, most));
    let above = ahead + DVec3::Y * (0.6 * free(ahead, DVec3::Y, 0.5 * most));
    point_light(above.as_vec3(), Vec3::splat(intensity(scene, 1)))
}

/// Virtual lights of some primary ones, and seconds that they took.
pub(super) fn virtual_lights(
    scene: &RenderScene,
    exact: &ExactRays<'_>,
    primary: &[PunctualLight],
    options: &VplOptions,
) -> (Vec<VirtualLight>, f64) {
    let clock = Instant::now();
    let primaries = Primaries::new(scene, exact.reference(), primary);
    let found = trace(scene, exact, &primaries, options);
    (found.lights, clock.elapsed().as_secs_f64())
}

/// Lights that are taken as points without end.
pub(super) fn as_points(lights: &[PunctualLight]) -> Result<Vec<VirtualLight>, CliError> {
    let points: Option<Vec<VirtualLight>> = lights.iter().map(VirtualLight::from_point).collect();
    points.ok_or_else(|| {
        CliError::bad_input(format!(
            "{} lights are too many to light every pixel by each, and only points without a range can be chosen among: leave \
             out other lights, or name fewer than 100,000",
            lights.len()
        ))
    })
}

/// Gathered light of all pixels, filtered, and what to say about it.
pub(super) struct Light {
    pub(super) irradiance: Vec<[f32; 3]>,
    pub(super) shadow: Vec<f32>,
    pub(super) tests: u64,
    pub(super) report: Value,
}

/// Lights the pixels by a method.
pub(super) fn gather(
    arguments: &Arguments,
    method: Method,
    ingredients: &Ingredients<'_>,
    gbuffer: &GBuffer,
    spread: f64,
    lights: &[VirtualLight],
    progress: &Progress,
) -> Result<Light, CliError> {
    let clock = Instant::now();
    let options = arguments.options(ingredients.scene, lights.len());
    let tree = LightTree::new(lights);
    let tree_seconds = clock.elapsed().as_secs_f64();
    let gather = Gather::new(gbuffer, &tree, spread, options);
    let found = match method {
        Method::None => gather.unshadowed(),
        method if method.draws_maps() => {
            let (renderer, bias) = map_renderer(method, ingredients).map_err(super::render::method_error)?;
            let mut settings = ingredients.maps;
            let all_maps = settings.map_bytes() * lights.len() as u64;
            settings.half_depths = all_maps > settings.budget_bytes / HALF_DEPTHS_SHARE;
            gather.by_maps(&*renderer, &settings, &bias, progress).map_err(view_error)?
        }
        method => {
            let lift = target_lift(method, ingredients)?;
            let method = visibility(method, ingredients).map_err(super::render::method_error)?;
            gather.by_segments(&*method, lift, progress).map_err(|error| match error {
                VisibilityError::Views(error) => view_error(error),
                error => CliError::new(Exit::Internal, error),
            })?
        }
    };
    let clock = Instant::now();
    let irradiance = match arguments.no_filter || options.samples == Samples::All {
        true => found.irradiance.clone(),
        false => filter(gbuffer, &found.irradiance, &FilterOptions { radius: FILTER_RADIUS, spread }),
    };
    let tests = found.tests.iter().map(|tests| u64::from(tests[0])).sum();
    let report = report(&found, &options, tree_seconds, clock.elapsed().as_secs_f64());
    Ok(Light { irradiance, shadow: found.shadow(), tests, report })
}

/// Pixels to each side.
const FILTER_RADIUS: u32 = 6;

fn report(found: &Gathered, options: &GatherOptions, tree_seconds: f64, filter_seconds: f64) -> Value {
    json!({
        "samples": match options.samples { Samples::All => json!("all"), Samples::Count(count) => json!(count) },
        "clamp_metres": options.clamp_metres,
        "passes": found.passes,
        "seconds": {
            "light_tree": tree_seconds,
            "maps": found.map_time.as_secs_f64(),
            "gather": found.gather_time.as_secs_f64(),
            "filter": filter_seconds,
        },
    })
}

/// Where segments to lights on surfaces end: methods that know surfaces as voxels would find those of the light.
fn target_lift(method: Method, ingredients: &Ingredients<'_>) -> Result<f32, CliError> {
    let extent = ingredients.scene.extent();
    Ok(match (method, ingredients.archive) {
        (Method::Rows | Method::RowsFast | Method::WgslRows, Some(archive)) => {
            let side = archive.rows_info().map_or(128, |rows| 1u32 << rows.bits);
            VIEW_LIFT_VOXELS * extent as f32 / side as f32
        }
        (Method::Brickmap, Some(archive)) => {
            let svo = archive.svo_info();
            VIEW_LIFT_VOXELS * svo.size as f32 / (1u64 << svo.levels) as f32
        }
        // Rays in 32-bit floats.
        (Method::Bvh | Method::WgslBvh, _) => extent as f32 * 1e-5,
        _ => 0.0,
    })
}

pub(super) fn view_error(error: ViewError) -> CliError {
    let exit = match error {
        ViewError::Cancelled => Exit::Cancelled,
        ViewError::Budget { .. } => Exit::OverBudget,
        ViewError::Device(_) => Exit::Internal,
        _ => Exit::Usage,
    };
    CliError::new(exit, error)
}
