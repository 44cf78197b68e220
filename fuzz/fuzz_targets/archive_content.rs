//! See the check. The bake that is edited is a file among the seeds; `Cargo.toml` says how they are written.
#![no_main]

#[path = "../checks/archive_content.rs"]
mod archive_content;

use std::sync::LazyLock;

static SOUND: LazyLock<archive_content::Sections> = LazyLock::new(|| {
    let bytes =
        std::fs::read("corpus/town.mvb").expect("run in the folder fuzz/, once the seeds are written");
    archive_content::sections(&bytes)
});

libfuzzer_sys::fuzz_target!(|data: &[u8]| archive_content::check(&SOUND, data));
