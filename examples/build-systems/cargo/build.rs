//! Bakes the courtyard into the build folder. Cargo runs this again when a file that the bake has read changes.

use manyview_cache::store::Store;
use manyview_pipeline::run::Bake;
use std::error::Error;
use std::path::PathBuf;
use std::sync::Arc;

fn main() -> Result<(), Box<dyn Error>> {
    let out = PathBuf::from(std::env::var_os("OUT_DIR").ok_or("cargo sets OUT_DIR")?);
    // Beside the archive, so that `cargo clean` removes it; a folder of the user's would last longer.
    let store = Store::open(out.join("bake-cache"))?;
    let mut bake = Bake::new("../courtyard.gltf").output(out.join("courtyard.mvb")).store(Arc::new(store));
    bake.options.levels = 8;
    bake.options.rows = None;
    bake.run_in_build_script()?;
    Ok(())
}
