//! Throughput and error of the rivals on a scene: receivers from a camera's primary rays, random lights in the bounds.
//!
//! `cargo run --release --example rivals -- SCENE ARCHIVE [--size 256x144] [--lights 1024] [--level L]… [--gpu-share N]
//! [--builds] [--bias] [--ism]`
//!
//! SCENE is a glTF file or KIND:TRIANGLES, ARCHIVE its bake. Errors are against exact rays.

use anyhow::{Context, Result, bail};
use glam::DVec3;
use manyview::bench::{BenchScene, Random};
use manyview::exact::ExactRays;
use manyview::gpu::{AdapterChoice, GpuContext, GpuScene, StreamOptions, WgpuExecutor};
use manyview::preview::{CameraChoice, Scene, choose_camera};
use manyview::rays::{RowTester, TestSettings};
use manyview::reference::{Reference, area_normal};
use manyview::rivals::brickmap::{self, BrickmapBias, BrickmapVisibility};
use manyview::rivals::bvh::BvhVisibility;
use manyview::rivals::ism::{IsmOptions, IsmVisibility};
use manyview::rivals::wide_bvh::WideBvh;
use manyview::visibility::{LightPoint, Receiver, Visibility, light_words};
use manyview::{Archive, CpuScene};
use manyview_shaders::executor::ExecutorLimits;
use obvhs::BvhBuildParams;
use std::time::Instant;

struct Options {
    scene: String,
    archive: String,
    size: [u32; 2],
    lights: usize,
    levels: Vec<u32>,
    /// Methods on a software GPU do one of so many receivers.
    gpu_share: usize,
    builds: bool,
    bias: bool,
    ism: bool,
}

fn options() -> Result<Options> {
    let mut names = Vec::new();
    let mut options = Options {
        scene: String::new(),
        archive: String::new(),
        size: [256, 144],
        lights: 1024,
        levels: Vec::new(),
        gpu_share: 8,
        builds: false,
        bias: false,
        ism: false,
    };
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().with_context(|| format!("{argument} needs a value"));
        match argument.as_str() {
            "--size" => {
                let value = value()?;
                let (width, height) = value.split_once('x').context("--size is WIDTHxHEIGHT")?;
                options.size = [width.parse()?, height.parse()?];
            }
            "--lights" => options.lights = value()?.parse()?,
            "--level" => options.levels.push(value()?.parse()?),
            "--gpu-share" => options.gpu_share = value()?.parse()?,
            "--builds" => options.builds = true,
            "--bias" => options.bias = true,
            "--ism" => options.ism = true,
            _ => names.push(argument),
        }
    }
    if options.levels.is_empty() {
        options.levels = vec![9, 11];
    }
    let [scene, archive] = <[String; 2]>::try_from(names).ok().context("give a SCENE and its ARCHIVE")?;
    Ok(Options { scene, archive, ..options })
}

/// What the camera sees: points on the triangles, on the side that is seen.
fn receivers(
    reference: &Reference,
    camera: &manyview::preview::Camera,
    size: [u32; 2],
) -> Result<Vec<Receiver>> {
    let rays = camera.ray_maker(size[0], size[1])?;
    let mut receivers = Vec::new();
    for y in 0..size[1] {
        for x in 0..size[0] {
            let ray = rays.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let (origin, direction) = (DVec3::from(ray.origin), DVec3::from(ray.direction));
            let Some(hit) = reference.intersect(origin, direction, 1e30) else { continue };
            let normal = area_normal(&reference.triangles()[hit.triangle as usize]).normalize_or_zero();
            let normal = if normal.dot(direction) > 0.0 { -normal } else { normal };
            receivers.push(Receiver {
                position: (origin + direction * hit.t).as_vec3().to_array(),
                normal: normal.as_vec3().to_array(),
            });
        }
    }
    Ok(receivers)
}

/// Time that all threads of this process have run, seconds; on a machine with other work it says more than a clock. 0
/// where the system does not tell.
fn processor_seconds() -> f64 {
    let stat = fs_err::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let ticks: f64 =
        after_name.split_whitespace().skip(11).take(2).filter_map(|field| field.parse::<f64>().ok()).sum();
    ticks / 100.0
}

struct Bench<'a> {
    receivers: &'a [Receiver],
    lights: &'a [LightPoint],
    exact: Vec<u32>,
}

impl Bench<'_> {
    /// Runs a method on every `share`-th receiver and prints its rate and its error: the share of lights whose
    /// visibility is wrong.
    fn run(&self, label: &str, method: &dyn Visibility, share: usize) -> Result<()> {
        let words = light_words(self.lights.len());
        // Bands of neighbours, not single receivers: neighbours are what methods are fast on.
        let band = 256;
        let chosen: Vec<usize> = (0..self.receivers.len()).filter(|i| i / band % share == 0).collect();
        let receivers: Vec<Receiver> = chosen.iter().map(|&i| self.receivers[i]).collect();
        let mut hidden = vec![0; receivers.len() * words];
        // Once for pipelines and caches.
        let few = receivers.len().min(64);
        method.hidden_lights(&receivers[..few], self.lights, &mut hidden[..few * words])?;
        let (start, busy) = (Instant::now(), processor_seconds());
        method.hidden_lights(&receivers, self.lights, &mut hidden)?;
        let (seconds, busy) = (start.elapsed().as_secs_f64(), processor_seconds() - busy);
        let rays = receivers.len() * self.lights.len();
        let rate = rays as f64 / seconds / 1e6;
        let (mut wrong, mut too_many, mut set, mut net) = (0u64, 0u64, 0u64, 0u64);
        for (&i, found) in chosen.iter().zip(hidden.chunks(words)) {
            let exact = &self.exact[i * words..(i + 1) * words];
            let (mut more, mut less) = (0u32, 0u32);
            for (&a, &b) in exact.iter().zip(found) {
                more += (b & !a).count_ones();
                less += (a & !b).count_ones();
                set += u64::from(a.count_ones());
            }
            wrong += u64::from(more + less);
            too_many += u64::from(more);
            net += u64::from(more.abs_diff(less));
        }
        println!(
            "{label:<36} {rate:>9.3} Mray/s {:>9.3} Mray per processor second  eps_v {:>6.3} % (hides {:.3} % too many)  eps_s {:>6.3} %  ({:.1} % hidden, {:.1} s)",
            rays as f64 / busy / 1e6,
            100.0 * wrong as f64 / rays as f64,
            100.0 * too_many as f64 / rays as f64,
            100.0 * net as f64 / rays as f64,
            100.0 * set as f64 / rays as f64,
            seconds
        );
        Ok(())
    }
}

fn main() -> Result<()> {
    let options = options()?;
    let scene = BenchScene::load(&options.scene.parse()?)?;
    let reference = Reference::new(&scene.scene, &scene.row_triangles, &scene.cutouts);
    let archive = Archive::open(&options.archive)?;
    let svo = archive.svo_levels(..)?;
    let Some((min, max)) = scene.scene.bounds() else { bail!("the scene is empty") };
    let aspect = f64::from(options.size[0]) / f64::from(options.size[1]);
    let camera = choose_camera(&Scene::new(svo.clone()), [min, max], aspect, CameraChoice::Auto);
    let receivers = receivers(&reference, &camera, options.size)?;
    let mut random = Random::new(7);
    let lights: Vec<LightPoint> = (0..options.lights)
        .map(|_| {
            let share = DVec3::new(random.unit(), random.unit(), random.unit());
            LightPoint::at((min + (max - min) * share).as_vec3().to_array())
        })
        .collect();
    let exact_method = ExactRays::new(&reference);
    let mut exact = vec![0; receivers.len() * light_words(lights.len())];
    let start = Instant::now();
    exact_method.hidden_lights(&receivers, &lights, &mut exact)?;
    let rays = receivers.len() * lights.len();
    println!(
        "{}: {} triangles, {} receivers x {} lights, {} threads; exact: {:.3} Mray/s",
        scene.name,
        reference.triangles().len(),
        receivers.len(),
        lights.len(),
        rayon::current_num_threads(),
        rays as f64 / start.elapsed().as_secs_f64() / 1e6,
    );
    let bench = Bench { receivers: &receivers, lights: &lights, exact };
    if options.builds {
        for (name, build) in [
            ("fast", BvhBuildParams::fast_build()),
            ("medium", BvhBuildParams::medium_build()),
            ("slow", BvhBuildParams::slow_build()),
            ("very slow", BvhBuildParams::very_slow_build()),
            ("very slow, whole", BvhBuildParams { pre_split: false, ..BvhBuildParams::very_slow_build() }),
        ] {
            let start = Instant::now();
            let method = BvhVisibility::with_build(&reference, build);
            let seconds = start.elapsed().as_secs_f64();
            bench.run(&format!("bvh, {name} build ({seconds:.1} s)"), &method, 1)?;
        }
        return Ok(());
    }
    if options.ism {
        for resolution in [64, 128] {
            for pull_levels in [0, 2] {
                for steepest in [3.0, 6.0] {
                    for splat_scale in [0.8, 1.2] {
                        for bias_texels in [0.5, 0.75, 1.5] {
                            let default = IsmOptions::default();
                            let ism = IsmOptions {
                                resolution,
                                pull_levels,
                                steepest,
                                splat_scale,
                                bias_texels,
                                ..default
                            };
                            let label = format!(
                                "{resolution} texels, {pull_levels} levels {steepest}, splat {splat_scale}, bias {bias_texels}"
                            );
                            bench.run(&label, &IsmVisibility::new(&reference, ism), 4)?;
                        }
                    }
                }
            }
        }
        return Ok(());
    }
    if options.bias {
        for &level in &options.levels {
            for normal_cells in [0.0, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0] {
                for skip_cells in [0.0, 0.25, 0.5, 1.0, 1.5] {
                    let bias = BrickmapBias { normal_cells, skip_cells };
                    let method = BrickmapVisibility::new(brickmap::from_svo(&svo, level, bias));
                    bench.run(&format!("level {level} lift {normal_cells} skip {skip_cells}"), &method, 4)?;
                }
            }
        }
        return Ok(());
    }
    let cpu_scene = CpuScene::load(&archive)?;
    for (label, settings) in [("rows (CPU)", TestSettings::EXACT), ("rows-fast (CPU)", TestSettings::FAST)] {
        bench.run(label, &RowTester::of(&cpu_scene).with_settings(settings), 1)?;
    }
    bench.run("the paper's rows (CPU, f64)", &cpu_scene.paper_rows(), 8)?;
    let ism = IsmVisibility::new(&reference, IsmOptions::default());
    bench.run("ism (CPU)", &ism, 1)?;
    bench.run("bvh (CPU)", &BvhVisibility::new(&reference), 1)?;
    let context = GpuContext::open(&AdapterChoice::from_env());
    if let Ok(context) = &context {
        println!("{}", context.name());
        let options = StreamOptions::new(3 << 30).with_octree_bytes(0);
        let scene = GpuScene::stream(context.device(), context.queue(), &archive, options)?;
        scene.finish()?;
        for (label, settings) in
            [("wgsl-rows (GPU)", TestSettings::EXACT), ("wgsl-rows, fast (GPU)", TestSettings::FAST)]
        {
            bench.run(label, &manyview::rays::on_gpu(context, &scene, &settings)?, 1)?;
        }
    }
    let gpu = || {
        Ok::<_, anyhow::Error>(
            context.as_ref().ok().map(|c| Box::new(WgpuExecutor::new(c, ExecutorLimits::DEFAULT))),
        )
    };
    for &level in &options.levels {
        let map = brickmap::from_svo(&svo, level, brickmap::DEFAULT_BIAS);
        let mebibytes = map.bytes() >> 20;
        if let Some(executor) = gpu()? {
            let method = brickmap::on_executor(&map, executor)?;
            bench.run(&format!("brickmap, level {level} (GPU)"), &method, options.gpu_share)?;
        }
        let method = BrickmapVisibility::new(map);
        bench.run(&format!("brickmap, level {level} (CPU, {mebibytes} MiB)"), &method, 1)?;
    }
    if let Some(executor) = gpu()? {
        let tree = WideBvh::new(&reference);
        let label = format!("wgsl-bvh ({} MiB)", tree.bytes() >> 20);
        bench.run(&label, &tree.on_executor(executor)?, options.gpu_share)?;
    }
    Ok(())
}
