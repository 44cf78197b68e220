//! Carries the baked courtyard inside the program and says what is in it.

use manyview_cache::archive::{Archive, ArchiveError};

static COURTYARD: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/courtyard.mvb"));

fn main() -> Result<(), ArchiveError> {
    let archive = Archive::from_bytes(COURTYARD.to_vec())?;
    println!("{} bytes, index {}", COURTYARD.len(), archive.header().index_digest);
    Ok(())
}
