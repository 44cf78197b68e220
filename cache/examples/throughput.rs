//! How fast archives are written and read: sparse random bits, on one thread and on all. Best of three.
//!
//! `cargo run --release -p manyview-cache --example throughput [MIB] [FOLDER]`

use std::error::Error;
use std::path::PathBuf;
use std::time::Instant;

use manyview_cache::archive::{Archive, ArchiveWriter};

/// One bit in about `2^rarity` is set.
fn sparse_bits(bytes: usize, rarity: u32) -> Vec<u8> {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    let mut content = Vec::with_capacity(bytes);
    while content.len() < bytes {
        let word = (0..rarity).fold(u64::MAX, |word, _| word & next());
        content.extend(word.to_le_bytes());
    }
    content
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let mib: usize = arguments.next().map_or(Ok(512), |text| text.parse())?;
    let folder = arguments.next().map_or_else(std::env::temp_dir, PathBuf::from);
    let path = folder.join(format!("throughput-{}.mvb", std::process::id()));
    println!("{mib} MiB; GB of content a second");
    println!(
        "{:>8} {:>6} {:>8} {:>7} {:>7} {:>7} {:>7}",
        "set bits", "level", "threads", "ratio", "write", "read", "verify"
    );
    for rarity in [4, 6, 8] {
        let content = sparse_bits(mib << 20, rarity);
        for level in [1, 3] {
            for threads in [1, std::thread::available_parallelism()?.get()] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
                let rate = |start: Instant| content.len() as f64 / start.elapsed().as_secs_f64() / 1e9;
                let (stats, write) = pool
                    .install(|| -> Result<_, Box<dyn Error + Send + Sync>> {
                        let start = Instant::now();
                        let mut writer = ArchiveWriter::create(&path)?.with_level(level);
                        writer.begin_section("bits", 0)?;
                        writer.append_raw(&content)?;
                        Ok((writer.finish()?, rate(start)))
                    })
                    .map_err(|error| error.to_string())?;
                let archive = Archive::open(&path)?;
                let (mut read, mut verify) = (0_f64, 0_f64);
                for _ in 0..3 {
                    let start = Instant::now();
                    let back = pool.install(|| archive.read_section(&archive.sections()[0]))?;
                    read = read.max(rate(start));
                    assert!(back == content, "another content came back");
                    let start = Instant::now();
                    assert!(pool.install(|| archive.verify()).is_sound());
                    verify = verify.max(rate(start));
                }
                let ratio = stats.raw_bytes as f64 / stats.file_bytes as f64;
                println!(
                    "   1/2^{rarity} {level:>6} {threads:>8} {ratio:>7.2} {write:>7.2} {read:>7.2} {verify:>7.2}"
                );
            }
        }
    }
    fs_err::remove_file(&path)?;
    Ok(())
}
