//! See the check.
#![no_main]

#[path = "../checks/archive_chunk.rs"]
mod archive_chunk;

libfuzzer_sys::fuzz_target!(|data: &[u8]| archive_chunk::check(data));
