//! See the check.
#![no_main]

#[path = "../checks/archive_index.rs"]
mod archive_index;

libfuzzer_sys::fuzz_target!(|data: &[u8]| archive_index::check(data));
