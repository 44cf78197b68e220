//! How long a bake takes to load, beside reading a raw file of the same size.
//!
//! `cargo run --release --example load -- A.mvb [SCRATCH_FOLDER]`
//!
//! The raw file is written to the scratch folder, read from the page cache and removed. Best of three each.

use std::error::Error;
use std::io::Read;
use std::path::PathBuf;
use std::time::Instant;

use manyview::gpu::{AdapterChoice, GpuContext};
use manyview::{Archive, CpuScene, GpuScene, StreamOptions};

/// Runs `work` three times; the shortest time, seconds.
fn best(mut work: impl FnMut() -> Result<(), Box<dyn Error>>) -> Result<f64, Box<dyn Error>> {
    let mut best = f64::INFINITY;
    for _ in 0..3 {
        let start = Instant::now();
        work()?;
        best = best.min(start.elapsed().as_secs_f64());
    }
    Ok(best)
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("usage: load A.mvb [SCRATCH_FOLDER]")?;
    let folder = arguments.next().map_or_else(std::env::temp_dir, PathBuf::from);
    let archive = Archive::open(&path)?;
    let info = *archive.rows_info().ok_or("the bake has no rows")?;
    let bytes = info.directions as usize * info.direction_bytes();
    println!(
        "{path}: {} directions of {}³, {:.1} MiB of rows, {} threads",
        info.directions,
        1 << info.bits,
        bytes as f64 / f64::from(1 << 20),
        rayon::current_num_threads()
    );

    let raw_path = folder.join(format!("manyview-load-{}.raw", std::process::id()));
    let scene = CpuScene::load(&archive)?;
    fs_err::write(&raw_path, bytemuck::cast_slice::<u32, u8>(scene.words()))?;
    drop(scene);
    let raw = best(|| {
        let mut content = Vec::with_capacity(bytes);
        fs_err::File::open(&raw_path)?.read_to_end(&mut content)?;
        if content.len() == bytes { Ok(()) } else { Err("the raw file is short".into()) }
    });
    fs_err::remove_file(&raw_path)?;
    let raw = raw?;
    let report = |what: &str, seconds: f64| {
        println!(
            "{what:<44} {seconds:>8.3} s {:>7.2} GB/s {:>6.2} × raw",
            bytes as f64 / seconds / 1e9,
            seconds / raw
        );
    };
    report("raw file of the same size, one thread", raw);
    report("to the CPU", best(|| Ok(drop(CpuScene::load(&archive)?)))?);

    let gpu = match GpuContext::open(&AdapterChoice::from_env()) {
        Ok(gpu) => gpu,
        Err(error) => {
            println!("no GPU: {error}");
            return Ok(());
        }
    };
    println!("{}", gpu.name());
    let options = StreamOptions::new(8 << 30);
    let (mut usable, mut complete) = (f64::INFINITY, f64::INFINITY);
    let mut memory = 0;
    for _ in 0..3 {
        let start = Instant::now();
        let scene = GpuScene::stream(gpu.device(), gpu.queue(), &archive, options.with_octree_bytes(0))?;
        usable = usable.min(start.elapsed().as_secs_f64());
        scene.finish()?;
        complete = complete.min(start.elapsed().as_secs_f64());
        memory = scene.gpu_bytes();
    }
    report("to the GPU, usable", usable);
    report("to the GPU, complete", complete);
    println!(
        "usable after {:.1}% of the time; {:.1} MiB of GPU memory",
        100.0 * usable / complete,
        memory as f64 / f64::from(1 << 20)
    );
    let start = Instant::now();
    let scene = GpuScene::stream(gpu.device(), gpu.queue(), &archive, options)?;
    scene.finish()?;
    let progress = scene.progress();
    println!("with {} levels of the octree: {:.3} s", progress.octree_levels, start.elapsed().as_secs_f64());
    Ok(())
}
