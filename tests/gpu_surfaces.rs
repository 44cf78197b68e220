//! The surfaces of a picture's pixels on the GPU against rays on the CPU.
//!
//! Without an adapter every test is reported as ignored, or as failed if `MANYVIEW_REQUIRE_GPU` is 1.
//! `MANYVIEW_ADAPTER` chooses among adapters.

mod surfaces;

use libtest_mimic::{Arguments, Failed, Trial};
use manyview::gpu::{AdapterChoice, GpuContext, WgpuExecutor};
use manyview::render::gbuffer::GBuffer;
use manyview_pipeline::bake::Silent;
use manyview_shaders::executor::ExecutorLimits;
use std::sync::OnceLock;
use surfaces::{Case, cases, seen};

type Check = fn(&GpuContext) -> Result<(), Failed>;

fn main() {
    let arguments = Arguments::from_args();
    let required = std::env::var("MANYVIEW_REQUIRE_GPU").is_ok_and(|value| value == "1");
    let opened = GpuContext::open(&AdapterChoice::from_env());
    let reason = match &opened {
        Ok(context) => {
            eprintln!("adapter: {}", context.name());
            String::new()
        }
        Err(error) => {
            eprintln!("no adapter: {error}");
            error.to_string()
        }
    };
    static CONTEXT: OnceLock<Option<GpuContext>> = OnceLock::new();
    let found = CONTEXT.get_or_init(|| opened.ok()).is_some();
    let trial = |(name, check): (&str, Check)| {
        let reason = reason.clone();
        Trial::test(name, move || match CONTEXT.get().and_then(Option::as_ref) {
            Some(context) => check(context),
            None => Err(format!("MANYVIEW_REQUIRE_GPU is 1, but {reason}").into()),
        })
        .with_ignored_flag(!found && !required)
    };
    let checks: [(&str, Check); 3] = [
        ("gpu_and_rays_see_the_same_triangles", gpu_and_rays_see_the_same_triangles),
        ("small_buffers_change_nothing", small_buffers_change_nothing),
        ("two_runs_see_the_same", two_runs_see_the_same),
    ];
    libtest_mimic::run(&arguments, Vec::from(checks.map(trial))).exit();
}

fn triangles(gpu: &GpuContext, case: &Case, limits: ExecutorLimits) -> Vec<u32> {
    seen(&mut WgpuExecutor::new(gpu, limits), case)
}

fn gpu_and_rays_see_the_same_triangles(gpu: &GpuContext) -> Result<(), Failed> {
    for case in cases() {
        let found = triangles(gpu, &case, ExecutorLimits::DEFAULT);
        surfaces::expect_agreement(&case, &found)?;
        // Where both agree on the triangle, everything is the same.
        let (scene, reference) = (&case.scene, case.scene.reference());
        let resolved = GBuffer::resolve(scene, &reference, &case.camera, case.size, &found, &Silent)?;
        let cast = GBuffer::cast(scene, &reference, &case.camera, case.size, &Silent)?;
        let agreeing = resolved.pixels.iter().zip(&cast.pixels).filter(|(a, b)| a.triangle == b.triangle);
        if let Some((a, b)) = agreeing.clone().find(|(a, b)| a != b) {
            return Err(format!("{}: {a:?} is not {b:?}", case.name).into());
        }
    }
    Ok(())
}

fn small_buffers_change_nothing(gpu: &GpuContext) -> Result<(), Failed> {
    for case in cases() {
        let whole = triangles(gpu, &case, ExecutorLimits::DEFAULT);
        // Pieces of triangles, and a group for each few alpha planes.
        let limits = ExecutorLimits { binding_bytes: 90_000, ..ExecutorLimits::DEFAULT };
        if triangles(gpu, &case, limits) != whole {
            return Err(format!("{}: pieces give another picture", case.name).into());
        }
    }
    Ok(())
}

fn two_runs_see_the_same(gpu: &GpuContext) -> Result<(), Failed> {
    let case = cases().remove(0);
    let first = triangles(gpu, &case, ExecutorLimits::DEFAULT);
    match triangles(gpu, &case, ExecutorLimits::DEFAULT) == first {
        true => Ok(()),
        false => Err("they differ".into()),
    }
}
