//! See the check.
#![no_main]

#[path = "../checks/recipe.rs"]
mod recipe;

libfuzzer_sys::fuzz_target!(|data: &[u8]| recipe::check(data));
