//! How small child masks are coded, and how fast: of an archive, the masks of each brick.
//!
//! ```console
//! $ cargo run --release -p manyview-cache --example mask_code -- ARCHIVE.mvb …
//! ```

use std::error::Error;
use std::time::Instant;

use manyview_cache::archive::{Archive, CompressedChunk};

/// Levels in a brick of 256³ voxels.
const BRICK_LEVELS: usize = 8;

fn main() -> Result<(), Box<dyn Error>> {
    for path in std::env::args().skip(1) {
        let archive = Archive::open(&path)?;
        let section =
            |level| archive.section("svo.masks", level).map(|section| archive.read_section(section));
        let levels: Vec<Vec<u8>> = (0..).map_while(section).collect::<Result<_, _>>()?;
        let top = levels.len().saturating_sub(BRICK_LEVELS);
        let bits = |masks: &[u8]| masks.iter().map(|mask| mask.count_ones() as usize).sum::<usize>();
        let mut rest: Vec<&[u8]> = levels[top..].iter().map(Vec::as_slice).collect();
        let (mut raw_bytes, mut stored_bytes) = (0, 0);
        let [mut coding, mut decoding] = [0.0; 2];
        while !rest[0].is_empty() {
            let mut nodes = 1;
            let mut brick = Vec::new();
            for rest in &mut rest {
                let masks;
                (masks, *rest) = rest.split_at(nodes);
                nodes = bits(masks);
                brick.push(masks);
            }
            let clock = Instant::now();
            let chunks = CompressedChunk::compress_masks(&brick, brick.len().saturating_sub(2));
            coding += clock.elapsed().as_secs_f64();
            let clock = Instant::now();
            for chunk in &chunks {
                raw_bytes += chunk.content()?.len();
            }
            decoding += clock.elapsed().as_secs_f64();
            stored_bytes += chunks.last().map_or(0, |chunk| chunk.stored().len());
        }
        let leaves = levels.last().map_or(0, |masks| bits(masks));
        let megabytes = raw_bytes as f64 / 1e6;
        println!(
            "{path}: {leaves} leaves, the two deepest levels of masks in {:.3} bits a leaf; coded at {:.1} MB/s, decoded at {:.1} MB/s",
            stored_bytes as f64 * 8.0 / leaves as f64,
            megabytes / coding,
            megabytes / decoding,
        );
    }
    Ok(())
}
