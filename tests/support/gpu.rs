//! Runs checks on a GPU: without an adapter they are reported as ignored, or as failed if `MANYVIEW_REQUIRE_GPU` is 1.

use std::sync::Arc;

use libtest_mimic::{Arguments, Failed, Trial};
use manyview::gpu::{AdapterChoice, GpuContext};

/// A check on an open device.
pub(crate) type Check = fn(&GpuContext) -> Result<(), Failed>;

/// Opens an adapter, runs the checks and exits.
pub(crate) fn run<const N: usize>(checks: [(&str, Check); N]) -> ! {
    let arguments = Arguments::from_args();
    let required = std::env::var("MANYVIEW_REQUIRE_GPU").is_ok_and(|value| value == "1");
    let opened =
        GpuContext::open(&AdapterChoice::from_env()).map(Arc::new).map_err(|error| error.to_string());
    match &opened {
        Ok(context) => eprintln!("adapter: {}", context.name()),
        Err(error) => eprintln!("no adapter: {error}"),
    }
    let trials = checks.map(|(name, check)| {
        let ignored = opened.is_err() && !required;
        let opened = opened.clone();
        Trial::test(name, move || match opened {
            Ok(context) => check(&context),
            Err(reason) => Err(format!("MANYVIEW_REQUIRE_GPU is 1, but {reason}").into()),
        })
        .with_ignored_flag(ignored)
    });
    libtest_mimic::run(&arguments, Vec::from(trials)).exit()
}
