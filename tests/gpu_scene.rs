//! Scenes streamed to the GPU: what arrives, in which order, within which budget, and what happens where it cannot.
//!
//! Without an adapter every test is reported as ignored, or as failed if `MANYVIEW_REQUIRE_GPU` is 1.
//! `MANYVIEW_ADAPTER` chooses among adapters.

mod support;

use std::sync::Arc;
use std::time::{Duration, Instant};

use libtest_mimic::Failed;
use manyview::gpu::{
    AdapterChoice, GpuContext, GpuScene, Progress, StreamError, StreamOptions, WgpuExecutor,
};
use manyview::{Archive, CpuScene, LoadError};
use manyview_shaders::executor::{CpuBinding, CpuExecutor, Executor, ExecutorLimits, Recording, RowsId};
use manyview_shaders::rows_texture::RowsTexture;
use manyview_shaders::sections::name;
use manyview_shaders::stages::{BindingKind, Kind, Stage};
use manyview_shaders::svo_nodes::SvoNode;
use support::gpu::Check;
use support::{bake_rows, bake_town, corrupt_section};

fn main() {
    let checks: [(&str, Check); 13] = [
        ("the_device_has_webgpus_default_limits", the_device_has_webgpus_default_limits),
        ("the_texture_holds_the_archives_rows", the_texture_holds_the_archives_rows),
        ("progress_only_grows", progress_only_grows),
        ("every_direction_is_answered_at_any_time", every_direction_is_answered_at_any_time),
        ("a_small_budget_keeps_fewer_directions", a_small_budget_keeps_fewer_directions),
        ("the_octree_arrives_level_by_level", the_octree_arrives_level_by_level),
        ("cancelling_stops", cancelling_stops),
        ("a_thread_refines", a_thread_refines),
        ("corrupt_chunks_are_errors", corrupt_chunks_are_errors),
        ("archives_without_rows_are_errors", archives_without_rows_are_errors),
        ("memory_that_is_not_there_is_an_error", memory_that_is_not_there_is_an_error),
        ("a_device_destroyed_midway_is_an_error", |_| a_device_destroyed_midway_is_an_error()),
        ("stages_see_the_same_rows_on_both_executors", stages_see_the_same_rows_on_both_executors),
    ];
    support::gpu::run(checks)
}

fn ensure(holds: bool, what: impl FnOnce() -> String) -> Result<(), Failed> {
    if holds { Ok(()) } else { Err(what().into()) }
}

fn archive(bits: u32, block_directions: u32) -> Result<Archive, LoadError> {
    Archive::from_bytes(bake_rows(bits, block_directions, 1 << 22))
}

fn stream(context: &GpuContext, archive: &Archive, options: StreamOptions) -> Result<GpuScene, StreamError> {
    GpuScene::stream(context.device(), context.queue(), archive, options)
}

fn begin(context: &GpuContext, archive: &Archive, options: StreamOptions) -> Result<GpuScene, StreamError> {
    GpuScene::begin(context.device(), context.queue(), archive, options)
}

/// Polls until something has arrived.
fn poll_until(scene: &GpuScene, reached: impl Fn(&Progress) -> bool) -> Result<Progress, Failed> {
    let start = Instant::now();
    loop {
        let progress = scene.poll(1)?;
        if reached(&progress) {
            return Ok(progress);
        }
        ensure(start.elapsed() < Duration::from_secs(60), || format!("it does not go on: {progress:?}"))?;
    }
}

const COPY_TILE: &str = "
@group(0) @binding(0) var<uniform> tile: vec4<u32>; // corner x, y, layer; width
@group(0) @binding(1) var rows: texture_2d_array<u32>;
@group(0) @binding(2) var<storage, read_write> texels: array<vec4<u32>>;
@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    texels[id.y * tile.w + id.x] = textureLoad(rows, tile.xy + id.xy, tile.z, 0);
}
";

fn copy_tile_twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let [tile, rows, texels] = bindings else { unreachable!("checked against the table") };
    let [x, y, layer, width] = tile.first::<[u32; 4]>();
    for j in 0..workgroups[1] * 8 {
        for i in 0..workgroups[0] * 8 {
            let texel = rows.rows().texel([x + i, y + j, layer]);
            texels.words_mut()[(j * width + i) as usize * 4..][..4].copy_from_slice(&texel);
        }
    }
}

/// Copies a tile of a rows texture to a buffer.
static COPY_TILE_STAGE: Stage = Stage {
    name: "copy_tile",
    bindings: &[BindingKind::Uniform, BindingKind::Rows, BindingKind::ReadWrite],
    kind: Kind::Compute { workgroup_size: [8, 8, 1], twin: copy_tile_twin },
    files: &[("copy_tile", COPY_TILE)],
};

/// The texels of a tile, word by word.
fn tile(
    executor: &mut dyn Executor,
    rows: RowsId,
    layout: &RowsTexture,
    tile: u32,
) -> Result<Vec<u32>, Failed> {
    let ([x, y, layer], [width, height]) = (layout.tile_origin(tile), layout.tile_size());
    let words = (width * height * 4) as usize;
    let uniform = executor.buffer("tile", 16)?;
    let texels = executor.buffer("texels", words as u64 * 4)?;
    let corner = [x, y, layer, width];
    let mut recording = Recording::new();
    recording.upload(uniform, &corner);
    let bindings = [uniform.into(), rows.into(), texels.into()];
    recording.dispatch(&COPY_TILE_STAGE, [width / 8, height / 8, 1], &bindings);
    recording.download(texels, words);
    let mut downloads = executor.run(&recording)?;
    executor.release(uniform);
    executor.release(texels);
    Ok(downloads.remove(0))
}

fn download(context: &GpuContext, buffer: &wgpu::Buffer, words: usize) -> Result<Vec<u32>, Failed> {
    let mut executor = WgpuExecutor::new(context, ExecutorLimits::DEFAULT);
    let id = executor.share_buffer(buffer);
    let mut recording = Recording::new();
    recording.download(id, words);
    Ok(executor.run(&recording)?.remove(0))
}

/// Every tile that is resident holds its direction's rows, every other one zeros.
fn check_tiles(scene: &GpuScene, archive: &Archive) -> Result<(), Failed> {
    let mut executor = WgpuExecutor::new(scene.context(), ExecutorLimits::DEFAULT);
    let rows = executor.share_rows(scene.rows_view());
    let layout = scene.layout();
    for (index, &direction) in (0..).zip(scene.directions_kept()) {
        let found = tile(&mut executor, rows, layout, index)?;
        let mut expected = Vec::new();
        layout.write_tile(&archive.direction_rows(direction)?, &mut expected);
        if !scene.is_resident(direction) {
            expected.fill([0; 4]);
        }
        ensure(found == *expected.as_flattened(), || {
            format!("direction {direction} in tile {index} differs")
        })?;
    }
    Ok(())
}

/// The tile table names the tile of the direction that answers, and the frames are the tiles'.
fn check_tables(scene: &GpuScene, archive: &Archive) -> Result<(), Failed> {
    let count = scene.direction_set().count();
    let table = download(scene.context(), scene.tile_table(), count as usize)?;
    let all_frames = archive.frames()?;
    for direction in 0..count {
        let resident = scene.resident_direction(direction);
        let found = table[direction as usize];
        ensure(Some(found) == scene.tile_of(resident), || {
            format!("direction {direction} is answered by {resident}, but tile {found}")
        })?;
        ensure(scene.frames()[found as usize] == all_frames[resident as usize], || "frames".to_owned())?;
    }
    let frames: &[u32] = bytemuck::cast_slice(scene.frames());
    ensure(download(scene.context(), scene.frames_buffer(), frames.len())? == frames, || {
        "the frames buffer differs".to_owned()
    })
}

/// The least angle between lines, by comparing all.
fn check_nearest(scene: &GpuScene) -> Result<(), Failed> {
    let set = scene.direction_set();
    let axis = |d: u32| set.frame(d)[2];
    let cosine = |a: u32, b: u32| (0..3).map(|i| axis(a)[i] * axis(b)[i]).sum::<f64>().abs();
    let resident: Vec<u32> = (0..set.count()).filter(|&d| scene.is_resident(d)).collect();
    for direction in 0..set.count() {
        let best = resident.iter().map(|&r| cosine(direction, r)).fold(0.0, f64::max);
        let found = cosine(direction, scene.resident_direction(direction));
        ensure(found >= best - 1e-6, || {
            format!("direction {direction}: cosine {found}, but there is one of {best}")
        })?;
    }
    Ok(())
}

fn the_device_has_webgpus_default_limits(context: &GpuContext) -> Result<(), Failed> {
    let (limits, default) = (context.device().limits(), wgpu::Limits::default());
    ensure(limits == default, || format!("{limits:?}"))?;
    ensure(context.device().features() == wgpu::Features::empty(), || "features".to_owned())?;
    ensure(default.max_texture_dimension_2d == manyview_shaders::rows_texture::MAX_TEXTURE_SIDE, || {
        "the texture's limits are not WebGPU's".to_owned()
    })?;
    ensure(default.max_texture_array_layers == manyview_shaders::rows_texture::MAX_TEXTURE_LAYERS, || {
        "the texture's limits are not WebGPU's".to_owned()
    })?;
    ensure(default.max_storage_buffer_binding_size == ExecutorLimits::DEFAULT.binding_bytes, || {
        "the buffers' limits are not WebGPU's".to_owned()
    })
}

fn the_texture_holds_the_archives_rows(context: &GpuContext) -> Result<(), Failed> {
    for (bits, block_directions) in [(5, 36), (6, 5), (7, 16), (8, 2)] {
        let archive = archive(bits, block_directions)?;
        let scene = stream(context, &archive, StreamOptions::new(1 << 30))?;
        let progress = scene.finish()?;
        ensure(progress.is_complete && progress.bytes_done == progress.bytes_total, || {
            format!("{progress:?}")
        })?;
        ensure((progress.directions_resident, progress.directions_kept) == (36, 36), || {
            format!("{progress:?}")
        })?;
        check_tiles(&scene, &archive)?;
        check_tables(&scene, &archive)?;
    }
    // Chunks that are cut elsewhere than directions.
    let archive = Archive::from_bytes(bake_rows(5, 7, 5 * 1024))?;
    let scene = stream(context, &archive, StreamOptions::new(1 << 30))?;
    scene.finish()?;
    check_tiles(&scene, &archive)
}

fn progress_only_grows(context: &GpuContext) -> Result<(), Failed> {
    let archive = archive(7, 2)?;
    let scene = begin(context, &archive, StreamOptions::new(1 << 30))?;
    let mut before = scene.progress();
    ensure(before.bytes_done == 0 && !before.is_usable && !before.is_complete, || format!("{before:?}"))?;
    let (mut steps, start) = (0, Instant::now());
    while !before.is_complete {
        let now = scene.poll(1)?;
        let grows = now.bytes_done >= before.bytes_done
            && now.directions_resident >= before.directions_resident
            && now.octree_levels >= before.octree_levels
            && now.is_usable >= before.is_usable
            && now.bytes_total == before.bytes_total;
        ensure(grows && now.bytes_done <= now.bytes_total, || format!("{before:?}, then {now:?}"))?;
        steps += usize::from(now.bytes_done > before.bytes_done);
        before = now;
        ensure(start.elapsed() < Duration::from_secs(60), || format!("it does not go on: {now:?}"))?;
    }
    ensure(before.is_usable && before.bytes_done == before.bytes_total, || format!("{before:?}"))?;
    // Five levels of the octree and 18 pieces of rows, each on its own.
    ensure(steps == 5 + 18, || format!("{steps} steps"))
}

fn every_direction_is_answered_at_any_time(context: &GpuContext) -> Result<(), Failed> {
    let archive = archive(6, 1)?;
    let scene = begin(context, &archive, StreamOptions::new(1 << 30))?;
    check_tables(&scene, &archive)?;
    let mut resident = 0;
    // The coarse part is three of 36; the nearest directions are found again when there are 3, 6, 12 and 24.
    for until in [3, 6, 12, 24, 36] {
        let progress = poll_until(&scene, |progress| progress.directions_resident >= until)?;
        ensure(progress.is_usable && progress.directions_resident > resident, || format!("{progress:?}"))?;
        resident = progress.directions_resident;
        check_tables(&scene, &archive)?;
        if progress.directions_resident == until {
            check_nearest(&scene)?;
        }
    }
    for direction in 0..36 {
        ensure(scene.resident_direction(direction) == direction, || format!("direction {direction}"))?;
    }
    // Midway some tiles are there and the others empty.
    let scene = begin(context, &archive, StreamOptions::new(1 << 30))?;
    poll_until(&scene, |progress| progress.directions_resident >= 5)?;
    check_tiles(&scene, &archive)
}

fn a_small_budget_keeps_fewer_directions(context: &GpuContext) -> Result<(), Failed> {
    let archive = Archive::from_bytes(support::bake_directions(5, 12, 12))?;
    let all = begin(context, &archive, StreamOptions::new(u64::MAX).with_octree_bytes(0))?.gpu_bytes();
    ensure(all == 144 * (32 * 32 * 16 + 48 + 4), || format!("{all} bytes"))?;
    for (budget, kept) in [(all, 144), (all - 1, 72), (all / 2 + 1000, 72), (all / 3, 36)] {
        let scene = stream(context, &archive, StreamOptions::new(budget))?;
        let progress = scene.finish()?;
        ensure(scene.directions_kept().len() == kept, || format!("{budget} bytes: {progress:?}"))?;
        ensure(scene.gpu_bytes() <= budget, || format!("{} of {budget} bytes", scene.gpu_bytes()))?;
        ensure(progress.is_complete && progress.directions_resident as usize == kept, || {
            format!("{progress:?}")
        })?;
        let lattice = scene.directions_kept().iter().all(|d| d / 12 % 2 == 0 || kept == 144);
        ensure(lattice, || "every second direction along the first axis".to_owned())?;
        check_tiles(&scene, &archive)?;
        check_tables(&scene, &archive)?;
        check_nearest(&scene)?;
    }
    // The same where levels of the octree come after the rows: those that are not kept are answered by the nearest as
    // soon as the last rows are there.
    let deep = Archive::from_bytes(support::bake_levels_and_directions(9, 7, 14, 14))?;
    let options = StreamOptions::new(40 << 20).with_octree_bytes(u64::MAX);
    let scene = begin(context, &deep, options)?;
    let progress = poll_until(&scene, |progress| progress.directions_resident == progress.directions_kept)?;
    ensure(progress.directions_kept == 98 && !progress.is_complete, || format!("{progress:?}"))?;
    check_tables(&scene, &deep)?;
    check_nearest(&scene)?;
    for budget in [0, 1, all / 5] {
        match stream(context, &archive, StreamOptions::new(budget)) {
            Err(StreamError::OverBudget { needed_bytes, budget_bytes, .. }) => {
                ensure(budget_bytes == budget && needed_bytes > budget && needed_bytes < all / 3, || {
                    format!("{needed_bytes} bytes")
                })?;
                stream(context, &archive, StreamOptions::new(needed_bytes))?;
            }
            other => return Err(format!("{budget} bytes: {other:?}").into()),
        }
    }
    Ok(())
}

fn the_octree_arrives_level_by_level(context: &GpuContext) -> Result<(), Failed> {
    let archive = archive(5, 36)?;
    let nodes = |level: u32| archive.svo_node_count(level).unwrap_or(0);
    let options = StreamOptions::new(1 << 30);
    for (bytes, levels) in [(u64::MAX, 5), (0, 0), (15, 0), (16, 1), (16 * (1 + nodes(1) + nodes(2)), 3)] {
        let scene = stream(context, &archive, options.with_octree_bytes(bytes))?;
        let progress = scene.finish()?;
        let buffers = scene.octree_levels();
        let found = [progress.octree_levels, progress.octree_levels_kept, buffers.len() as u32];
        ensure(found == [levels; 3], || format!("{bytes} bytes: {found:?}"))?;
        for (level, buffer) in (0..).zip(&buffers) {
            let expected = SvoNode::of_level(&archive.svo_level_alone(level)?);
            let found = download(context, buffer, expected.len() * 4)?;
            ensure(found == bytemuck::cast_slice::<SvoNode, u32>(&expected), || format!("level {level}"))?;
        }
    }
    Ok(())
}

fn cancelling_stops(context: &GpuContext) -> Result<(), Failed> {
    let archive = archive(6, 1)?;
    let scene = stream(context, &archive, StreamOptions::new(1 << 30))?;
    let before = scene.progress();
    scene.cancel();
    for result in [scene.poll(u64::MAX), scene.finish()] {
        ensure(matches!(result, Err(StreamError::Cancelled)), || format!("{result:?}"))?;
    }
    ensure(scene.progress() == before && before.is_usable && !before.is_complete, || format!("{before:?}"))?;
    // What is there stays.
    check_tables(&scene, &archive)
}

fn a_thread_refines(context: &GpuContext) -> Result<(), Failed> {
    let archive = archive(7, 1)?;
    let scene = Arc::new(stream(context, &archive, StreamOptions::new(1 << 30))?);
    let progress = scene.refine_in_background()?.join()?;
    ensure(progress.is_complete, || format!("{progress:?}"))?;
    check_tiles(&scene, &archive)?;
    // Whoever drops it cancels it.
    let scene = Arc::new(begin(context, &archive, StreamOptions::new(1 << 30))?);
    drop(scene.refine_in_background()?);
    let result = scene.poll(1);
    ensure(matches!(result, Err(StreamError::Cancelled)), || format!("{result:?}"))?;
    ensure(Arc::strong_count(&scene) == 1, || "the thread is still there".to_owned())
}

fn corrupt_chunks_are_errors(context: &GpuContext) -> Result<(), Failed> {
    let sound = bake_rows(6, 4, 1 << 22);
    for item in 0..9 {
        let archive = Archive::from_bytes(corrupt_section(&sound, name::ROWS_BITS, item))?;
        let scene = begin(context, &archive, StreamOptions::new(1 << 30))?;
        for attempt in 0..2 {
            match scene.finish() {
                Err(StreamError::Load(error)) if error.is_corruption() => {
                    let section = error.section();
                    ensure(section == Some(format!("rows.bits[{item}]")), || format!("{section:?}"))?;
                }
                other => return Err(format!("{item}, {attempt}: {other:?}").into()),
            }
        }
        let progress = scene.progress();
        ensure(!progress.is_complete && progress.directions_resident <= 32, || format!("{progress:?}"))?;
        check_tables(&scene, &Archive::from_bytes(sound.clone())?)?;
        check_tiles(&scene, &Archive::from_bytes(sound.clone())?)?;
    }
    let archive = Archive::from_bytes(corrupt_section(&sound, name::SVO_COLORS, 1))?;
    let result = stream(context, &archive, StreamOptions::new(1 << 30));
    ensure(matches!(&result, Err(StreamError::Load(error)) if error.is_corruption()), || {
        format!("{result:?}")
    })?;
    let archive = Archive::from_bytes(corrupt_section(&sound, name::ROWS_FRAMES, 0))?;
    let result = begin(context, &archive, StreamOptions::new(1 << 30));
    ensure(matches!(&result, Err(StreamError::Load(error)) if error.is_corruption()), || {
        format!("{result:?}")
    })
}

fn archives_without_rows_are_errors(context: &GpuContext) -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("town.mvb");
    bake_town(&path, 3, 1, false);
    let result = stream(context, &Archive::open(&path)?, StreamOptions::new(1 << 30));
    ensure(matches!(result, Err(StreamError::Load(LoadError::NoRows { .. }))), || format!("{result:?}"))
}

fn memory_that_is_not_there_is_an_error(context: &GpuContext) -> Result<(), Failed> {
    // A small file with 256 GiB of rows.
    let archive = Archive::from_bytes(support::empty_rows(8, 512, 256))?;
    let start = Instant::now();
    let result = begin(context, &archive, StreamOptions::new(u64::MAX));
    ensure(matches!(result, Err(StreamError::Device(_))), || format!("{result:?}"))?;
    // The budget is what keeps it to what is there, and the device goes on working.
    let scene = begin(context, &archive, StreamOptions::new(200 << 20))?;
    let progress = scene.poll(1)?;
    ensure(progress.directions_kept == 64 && scene.gpu_bytes() <= 200 << 20, || format!("{progress:?}"))?;
    ensure(start.elapsed() < Duration::from_secs(60), || format!("{:?}", start.elapsed()))
}

fn a_device_destroyed_midway_is_an_error() -> Result<(), Failed> {
    let archive = archive(7, 1)?;
    // Whoever owns the device owns its handlers: here the caller has none that would notice.
    let context = GpuContext::open(&AdapterChoice::from_env())?;
    let scene = stream(&context, &archive, StreamOptions::new(1 << 30))?;
    context.device().destroy();
    let result = scene.finish();
    ensure(matches!(result, Err(StreamError::Device(_))), || format!("{result:?}"))?;
    let result = scene.poll(1);
    ensure(matches!(result, Err(StreamError::Device(_))), || format!("{result:?}"))?;
    ensure(!scene.progress().is_complete, || "complete on a destroyed device".to_owned())?;
    let result = stream(&context, &archive, StreamOptions::new(1 << 30));
    ensure(matches!(result, Err(StreamError::Device(_))), || format!("{result:?}"))
}

fn stages_see_the_same_rows_on_both_executors(context: &GpuContext) -> Result<(), Failed> {
    for bits in [5, 8] {
        let archive = archive(bits, 36)?;
        let on_gpu = stream(context, &archive, StreamOptions::new(1 << 30))?;
        on_gpu.finish()?;
        let on_cpu = CpuScene::load(&archive)?;
        let mut gpu = WgpuExecutor::new(on_gpu.context(), ExecutorLimits::DEFAULT);
        let mut cpu = CpuExecutor::default();
        let gpu_rows = gpu.share_rows(on_gpu.rows_view());
        let image = on_cpu.rows_image()?;
        let cpu_rows = cpu.share_rows(image.clone());
        for direction in [0, 7, 35] {
            let Some(gpu_tile) = on_gpu.tile_of(direction) else { return Err("all are kept".into()) };
            let found = tile(&mut gpu, gpu_rows, on_gpu.layout(), gpu_tile)?;
            let expected = tile(&mut cpu, cpu_rows, image.layout(), direction)?;
            ensure(found == expected, || format!("direction {direction} of {bits} bits differs"))?;
        }
    }
    Ok(())
}
