//! How small and how fast the rows of some bakes are coded, beside zstd, on one thread. Best of three.
//!
//! `cargo run --release -p manyview-cache --example row_code -- ROW_BYTES ARCHIVE.mvb …` (16 bytes for rows of 128 voxels)

use std::error::Error;
use std::time::Instant;

use manyview_cache::archive::{Archive, CompressedChunk};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let row_bytes: usize = arguments.next().ok_or("usage: row_code ROW_BYTES ARCHIVE.mvb …")?.parse()?;
    println!("| bake | by | raw / stored | coding GB/s | decoding GB/s |\n|---|---|---:|---:|---:|");
    for path in arguments {
        let archive = Archive::open(&path)?;
        let rows = archive.sections().iter().filter(|section| section.id.name.as_str() == "rows.bits");
        // Every eighth block is like the others.
        let blocks =
            rows.step_by(8).map(|section| archive.read_section(section)).collect::<Result<Vec<_>, _>>()?;
        let name = std::path::Path::new(&path).file_stem().unwrap_or_default().display();
        for by in ["rows", "zstd 1", "zstd 3"] {
            let compress = |raw: &[u8]| match by {
                "rows" => CompressedChunk::compress_rows(raw, row_bytes),
                "zstd 1" => CompressedChunk::compress(raw, 1),
                _ => CompressedChunk::compress(raw, 3),
            };
            let (mut coding, mut decoding) = (f64::INFINITY, f64::INFINITY);
            let (mut raw_bytes, mut stored_bytes) = (0, 0);
            for _ in 0..3 {
                let start = Instant::now();
                let chunks: Vec<_> = blocks.iter().map(|raw| compress(raw)).collect();
                coding = coding.min(start.elapsed().as_secs_f64());
                (raw_bytes, stored_bytes) = (0, 0);
                let mut seconds = 0.0;
                let mut back = Vec::new();
                for (chunk, raw) in chunks.iter().zip(&blocks) {
                    back.clear();
                    back.resize(raw.len(), 0);
                    let start = Instant::now();
                    chunk.content_into_zeros(&mut back)?;
                    seconds += start.elapsed().as_secs_f64();
                    assert!(back == *raw, "another content came back");
                    (raw_bytes, stored_bytes) = (raw_bytes + raw.len(), stored_bytes + chunk.stored().len());
                }
                decoding = decoding.min(seconds);
            }
            let gigabytes = raw_bytes as f64 / 1e9;
            println!(
                "| {name} | {by} | {:.2} | {:.2} | {:.2} |",
                raw_bytes as f64 / stored_bytes as f64,
                gigabytes / coding,
                gigabytes / decoding
            );
        }
    }
    Ok(())
}
