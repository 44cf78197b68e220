//! How long a bake takes to load, beside reading a raw file of the same size.
//!
//! `cargo run --release --example load -- A.mvb [SCRATCH_FOLDER]`
//!
//! The raw file is written to the scratch folder, read from the page cache and removed. All are measured in turns, three
//! times; the best counts. Loaders must use no more than WebGPU's default limits: the device has no others.

use std::error::Error;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::Instant;

use manyview::gpu::{AdapterChoice, GpuContext};
use manyview::{Archive, CpuScene, GpuScene, StreamOptions};

const MIB: f64 = (1 << 20) as f64;
const ROUNDS: u32 = 3;

/// A file that is removed in the end.
struct Scratch(PathBuf);

impl Drop for Scratch {
    fn drop(&mut self) {
        // Nothing can be done about it but to leave it there.
        let _ = fs_err::remove_file(&self.0);
    }
}

/// The shortest time so far, seconds.
struct Best(f64);

impl Best {
    fn of<R>(&mut self, work: impl FnOnce() -> R) -> R {
        let start = Instant::now();
        let result = work();
        self.since(start);
        result
    }

    fn since(&mut self, start: Instant) {
        self.0 = self.0.min(start.elapsed().as_secs_f64());
    }
}

fn read_raw(path: &Path, bytes: usize) -> Result<(), Box<dyn Error>> {
    let mut content = Vec::with_capacity(bytes);
    fs_err::File::open(path)?.read_to_end(&mut content)?;
    if content.len() == bytes { Ok(()) } else { Err("the raw file is short".into()) }
}

/// The most memory that this process has had, MiB; `None` where the system does not tell.
fn peak_memory() -> Option<f64> {
    let status = fs_err::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.trim().strip_suffix(" kB")?.parse::<f64>().ok()? / 1024.0)
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
        bytes as f64 / MIB,
        rayon::current_num_threads()
    );
    let raw_path = Scratch(folder.join(format!("manyview-load-{}.raw", std::process::id())));
    let scene = CpuScene::load(&archive)?;
    if let Some(peak) = peak_memory() {
        println!(
            "peak memory of loading to the CPU: {:.1} MiB more than the rows",
            peak - bytes as f64 / MIB
        );
    }
    fs_err::write(&raw_path.0, bytemuck::cast_slice::<u32, u8>(scene.words()))?;
    drop(scene);
    let gpu = GpuContext::open(&AdapterChoice::from_env());
    match &gpu {
        Ok(gpu) => println!("{}", gpu.name()),
        Err(error) => println!("no GPU: {error}"),
    }

    let [mut raw, mut cpu, mut usable, mut complete] = [f64::INFINITY; 4].map(Best);
    let options = StreamOptions::new(u64::MAX).with_octree_bytes(0);
    let mut gpu_bytes = 0;
    for _ in 0..ROUNDS {
        raw.of(|| read_raw(&raw_path.0, bytes))?;
        cpu.of(|| CpuScene::load(&archive).map(drop))?;
        if let Ok(gpu) = &gpu {
            let start = Instant::now();
            let scene = GpuScene::stream(gpu.device(), gpu.queue(), &archive, options)?;
            // All that was submitted has arrived: a picture could be drawn now.
            scene.wait()?;
            usable.since(start);
            scene.finish()?;
            complete.since(start);
            gpu_bytes = scene.gpu_bytes();
        }
    }
    for (name, Best(seconds)) in [
        ("raw file of the same size, one thread", &raw),
        ("to the CPU", &cpu),
        ("to the GPU, usable", &usable),
        ("to the GPU, complete", &complete),
    ] {
        if seconds.is_finite() {
            let (rate, ratio) = (bytes as f64 / seconds / 1e9, seconds / raw.0);
            println!("{name:<40} {seconds:>8.3} s {rate:>7.2} GB/s {ratio:>6.2} × raw");
        }
    }
    if complete.0.is_finite() {
        println!("usable after {:.1}% of the time", 100.0 * usable.0 / complete.0);
        println!("GPU memory: {:.1} MiB", gpu_bytes as f64 / MIB);
    }
    if let Some(peak) = peak_memory() {
        // On a software adapter the GPU's memory is this process's.
        println!("peak memory of all: {peak:.1} MiB");
    }
    Ok(())
}
