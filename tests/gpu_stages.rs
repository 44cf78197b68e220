//! The voxel jobs on the GPU against plain loops on the CPU, bit for bit.
//!
//! Without an adapter every test is reported as ignored, or as failed if `MANYVIEW_REQUIRE_GPU` is 1.
//! `MANYVIEW_ADAPTER` chooses among adapters.

use libtest_mimic::{Arguments, Failed, Measurement, Trial};
use manyview::gpu::{AdapterChoice, GpuContext, GpuDevice, WgpuExecutor};
use manyview_shaders::cases::{Case, Geometry, Job, Random, cases, frames, long_loops, random_triangles};
use manyview_shaders::cpu_device::CpuDevice;
use manyview_shaders::device::{DeviceError, VoxelDevice};
use manyview_shaders::executor::{CpuExecutor, Executor, ExecutorLimits, Recording};
use manyview_shaders::raster::{Grid, VoxelBox};
use manyview_shaders::stages;
use manyview_shaders::types::PointParams;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

type Check = fn(&GpuDevice) -> Result<(), Failed>;

fn main() {
    let mut arguments = Arguments::from_args();
    let required = std::env::var("MANYVIEW_REQUIRE_GPU").is_ok_and(|value| value == "1");
    let opened = GpuDevice::open(&AdapterChoice::from_env());
    let reason = match &opened {
        Ok(device) => {
            eprintln!("adapter: {}", device.name());
            String::new()
        }
        Err(error) => {
            eprintln!("no adapter: {error}");
            error.to_string()
        }
    };
    static DEVICE: OnceLock<Option<GpuDevice>> = OnceLock::new();
    let found = DEVICE.get_or_init(|| opened.ok()).is_some();
    let trial = |(name, check): (&str, Check)| {
        let reason = reason.clone();
        Trial::test(name, move || match DEVICE.get().and_then(Option::as_ref) {
            Some(device) => check(device),
            None => Err(format!("MANYVIEW_REQUIRE_GPU is 1, but {reason}").into()),
        })
        .with_ignored_flag(!found && !required)
    };
    let checks: [(&str, Check); 11] = [
        ("fragments_equal_the_cpus", |gpu| compare(gpu, &cases(), "fragments")),
        ("peeled_boxes_equal_the_cpus", |gpu| compare(gpu, &cases(), "peel")),
        ("rotated_points_equal_the_cpus", |gpu| compare(gpu, &cases(), "rotate_points")),
        ("rows_in_one_pass_equal_the_cpus", |gpu| compare(gpu, &cases(), "raster_rows in one pass")),
        ("peeled_rows_equal_the_cpus", |gpu| compare(gpu, &cases(), "raster_rows by peeling")),
        ("long_loops_are_cut_into_pieces", |gpu| compare(gpu, &long_loops(), "")),
        ("small_buffers_change_nothing", small_buffers_change_nothing),
        ("peeling_gives_the_voxels_of_one_pass", peeling_gives_the_voxels_of_one_pass),
        ("buffers_beyond_the_limit_are_errors", buffers_beyond_the_limit_are_errors),
        ("a_buffer_says_how_many_workgroups_run", a_buffer_says_how_many_workgroups_run),
        ("a_destroyed_device_is_an_error", |_| a_destroyed_device_is_an_error()),
    ];
    let mut trials = Vec::from(checks.map(trial));
    // Ratios of times: `cargo test --test gpu_stages -- --bench`.
    if arguments.bench {
        arguments.test_threads = Some(1);
        trials = measured().into_iter().map(|case| measure(case, &DEVICE)).collect();
    }
    libtest_mimic::run(&arguments, trials).exit();
}

/// The cases whose times are compared.
fn measured() -> Vec<Case> {
    let mut random = Random::new(1);
    let triangles = |random: &mut Random, min, max, spread| Geometry {
        triangles: random_triangles(random, 100_000, min, max, spread),
        ..Geometry::default()
    };
    let clip = VoxelBox { min: [512; 3], max: [640; 3] };
    let small = triangles(&mut random, 512 * 16, 640 * 16, 40);
    let scene = triangles(&mut random, -16384, 16384, 200);
    let points = (0..200_000).map(|_| [0; 3].map(|_| random.range(-16384, 16384) as i16)).collect();
    let case = |name: &str, job, geometry: &Geometry| Case {
        name: name.to_owned(),
        job,
        geometry: geometry.clone(),
    };
    vec![
        case("fragments_100k_triangles_128_box", Job::Fragments(Grid::new(11), clip), &small),
        case(
            "rotate_points_200k_64_directions",
            Job::RotatePoints(7, frames(64)),
            &Geometry { points, ..Geometry::default() },
        ),
        case("raster_rows_100k_16_directions", Job::RasterRows(7, frames(16), false), &scene),
        case("peel_rows_100k_16_directions", Job::RasterRows(7, frames(16), true), &scene),
    ]
}

/// Times a case on both devices and prints the ratio; the printed measurement is the GPU's.
fn measure(case: Case, device: &'static OnceLock<Option<GpuDevice>>) -> Trial {
    let timed = move |case: &Case, device: &dyn VoxelDevice| -> Result<(Vec<u32>, Duration), Failed> {
        let start = Instant::now();
        Ok((case.run(device)?, start.elapsed()))
    };
    Trial::bench(case.name.clone(), move |test_mode| {
        let Some(gpu) = device.get().and_then(Option::as_ref) else { return Err("no adapter".into()) };
        if test_mode {
            return Ok(None);
        }
        // The first run makes pipelines.
        case.run(gpu)?;
        let (expected, cpu_time) = timed(&case, &CpuDevice)?;
        let (found, gpu_time) = timed(&case, gpu)?;
        if found != expected {
            return Err("results differ".into());
        }
        let ratio = gpu_time.as_secs_f64() / cpu_time.as_secs_f64();
        eprintln!("{}: GPU {gpu_time:.1?}, one CPU thread {cpu_time:.1?}: {ratio:.2} times", case.name);
        Ok(Some(Measurement { avg: gpu_time.as_nanos() as u64, variance: 0 }))
    })
}

/// Runs the cases whose name starts with `kind` on both devices.
fn compare(gpu: &GpuDevice, cases: &[Case], kind: &str) -> Result<(), Failed> {
    let mut count = 0;
    let mut wrong = Vec::new();
    for case in cases.iter().filter(|case| case.name.starts_with(kind)) {
        let expected = case.run(&CpuDevice)?;
        match case.run(gpu) {
            Ok(found) if found == expected => {}
            Ok(found) => {
                let differing = found.iter().zip(&expected).filter(|(a, b)| a != b).count();
                wrong.push(format!(
                    "{}: {differing} words differ, {} words instead of {}",
                    case.name,
                    found.len(),
                    expected.len()
                ));
            }
            Err(error) => wrong.push(format!("{}: {error}", case.name)),
        }
        count += 1;
    }
    if count == 0 {
        return Err(format!("no case starts with `{kind}`").into());
    }
    if wrong.is_empty() { Ok(()) } else { Err(wrong.join("\n").into()) }
}

fn small_buffers_change_nothing(gpu: &GpuDevice) -> Result<(), Failed> {
    // Lists overflow, planes need groups, views need several images and windows.
    let context = GpuContext::from_device(gpu.context().device().clone(), gpu.context().queue().clone());
    let small = GpuDevice::new(context).with_limits(ExecutorLimits { binding_bytes: 40_000, depth_side: 24 });
    let mut cases = cases();
    cases.retain(|case| match case.job {
        Job::Fragments(grid, _) | Job::Peel(grid, _) => grid.bits == 5,
        Job::RotatePoints(bits, _) | Job::RasterRows(bits, ..) => bits == 5,
    });
    compare(&small, &cases, "")
}

fn peeling_gives_the_voxels_of_one_pass(gpu: &GpuDevice) -> Result<(), Failed> {
    let triangles = random_triangles(&mut Random::new(7), 3000, -16384, 16384, 2000);
    let mut case = Case {
        name: "peeling".to_owned(),
        job: Job::RasterRows(6, frames(5), true),
        geometry: Geometry { triangles, ..Geometry::default() },
    };
    let peeled = case.run(gpu)?;
    case.job = Job::RasterRows(6, frames(5), false);
    let once = case.run(gpu)?;
    if peeled != once || once.iter().all(|&word| word == 0) {
        return Err("rows differ".into());
    }

    let grid = Grid::new(11);
    let clip = VoxelBox { min: [700, 800, 900], max: [796, 860, 1000] };
    case.geometry.triangles = random_triangles(&mut Random::new(8), 3000, 10_000, 17_000, 900);
    case.job = Job::Peel(grid, clip);
    let peeled = case.run(gpu)?;
    let mut bits = vec![0u32; peeled.len()];
    for fragment in gpu.fragments(grid, &clip, &case.geometry.batch())? {
        let [x, y, z] = [0, 10, 20].map(|shift| fragment.voxel >> shift & 1023);
        let bit = (z * 60 + y) * 96 + x;
        bits[bit as usize / 32] |= 1 << (bit % 32);
    }
    if peeled != bits || bits.iter().all(|&word| word == 0) {
        return Err("voxels of the box differ".into());
    }
    Ok(())
}

fn buffers_beyond_the_limit_are_errors(gpu: &GpuDevice) -> Result<(), Failed> {
    let case = Case {
        name: "1024 voxels a side and a bit".to_owned(),
        job: Job::Peel(Grid::new(11), VoxelBox { min: [0; 3], max: [1024, 1024, 1025] }),
        geometry: Geometry::default(),
    };
    if case.run(gpu).is_ok() {
        return Err("a clip box beyond the limit was accepted".into());
    }
    let case = Case { job: Job::RotatePoints(11, frames(1)), ..case };
    if case.run(gpu).is_ok() {
        return Err("rows beyond the limit were accepted".into());
    }
    // The driver's own limit, past our checks.
    let limits = ExecutorLimits { binding_bytes: 1 << 40, depth_side: 1 << 20 };
    let mut executor = WgpuExecutor::new(gpu.context(), limits);
    if executor.buffer("too much", 1 << 39).is_ok() || executor.depth_image([1 << 19, 4]).is_ok() {
        return Err("half a terabyte was allocated".into());
    }
    // The device goes on working.
    let buffer = executor.buffer("a few words", 16)?;
    let mut recording = Recording::new();
    recording.upload(buffer, &[1u32, 2, 3, 4]);
    recording.download(buffer, 4);
    if executor.run(&recording)? != [[1, 2, 3, 4]] {
        return Err("words did not come back".into());
    }
    Ok(())
}

/// A stage dispatched over workgroups that stand in a buffer does what it does over the same number given directly.
fn a_buffer_says_how_many_workgroups_run(gpu: &GpuDevice) -> Result<(), Failed> {
    let params = [PointParams { pairs: 40, grid_bits: 5, row_bits: 5, reserved: 0 }];
    let frames = frames(3);
    let mut random = Random::new(9);
    let points: Vec<[i16; 3]> = (0..80).map(|_| [0; 3].map(|_| random.range(-16384, 16384) as i16)).collect();
    // None, two directions, none again; then all three.
    let workgroups = [7u32, 0, 1, 2, 1, 0, 1, 3, 1];
    let run = |executor: &mut dyn Executor, indirect: bool| -> Result<Vec<Vec<u32>>, Failed> {
        let stage = &stages::rotate_points;
        let arguments = executor.buffer("workgroups", 36)?;
        let head = executor.buffer("parameters", 16)?;
        let frames_buffer = executor.buffer("frames", size_of_val(&*frames) as u64)?;
        let points_buffer = executor.buffer("points", size_of_val(&*points) as u64)?;
        let bits = executor.buffer("rows", 3 << 12)?;
        let bindings = [head, frames_buffer, points_buffer, bits].map(Into::into);
        let mut recording = Recording::new();
        recording.upload(arguments, &workgroups);
        recording.upload(head, &params);
        recording.upload(frames_buffer, &frames);
        recording.upload(points_buffer, &points);
        recording.clear(bits);
        for offset in [0, 2, 3, 6] {
            match indirect {
                true => recording.dispatch_indirect(stage, arguments, offset, &bindings),
                false => {
                    let counts = [0, 1, 2].map(|axis| workgroups[offset as usize + axis]);
                    recording.dispatch(stage, counts, &bindings);
                }
            }
            recording.download(bits, 3 << 10);
        }
        Ok(executor.run(&recording)?)
    };
    let expected = run(&mut CpuExecutor::default(), false)?;
    let set = |bits: &[u32]| bits.iter().map(|word| word.count_ones()).sum::<u32>();
    if expected.iter().map(|bits| set(bits)).is_sorted_by(|a, b| a < b) || set(&expected[3]) < 100 {
        return Err("the case is too simple".into());
    }
    let mut executor = WgpuExecutor::new(gpu.context(), ExecutorLimits::DEFAULT);
    if run(&mut CpuExecutor::default(), true)? != expected {
        return Err("the twin differs".into());
    }
    if run(&mut executor, true)? != expected || run(&mut executor, false)? != expected {
        return Err("the GPU differs".into());
    }
    Ok(())
}

fn a_destroyed_device_is_an_error() -> Result<(), Failed> {
    let device = GpuDevice::open(&AdapterChoice::from_env())?;
    let case = long_loops().remove(1);
    case.run(&device)?;
    device.context().device().destroy();
    match case.run(&device) {
        Err(DeviceError::Failed(_)) => Ok(()),
        other => Err(format!("{other:?}").into()),
    }
}
