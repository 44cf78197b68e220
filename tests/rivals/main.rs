//! The rivals of the row method: known answers, brute force, and shaders against their twins.
//!
//! Without an adapter the tests of shaders are reported as ignored, or as failed if `MANYVIEW_REQUIRE_GPU` is 1.
//! `MANYVIEW_ADAPTER` chooses among adapters.

macro_rules! ensure {
    ($condition:expr, $($text:tt)+) => {{
        let holds = $condition;
        if !holds {
            return Err(format!($($text)+).into());
        }
    }};
}

mod answers;
mod brute_force;
mod place;
mod questions;
mod shaders;

use answers::*;
use brute_force::*;
use libtest_mimic::{Arguments, Failed, Trial};
use manyview::gpu::{AdapterChoice, GpuContext};
use questions::*;
use shaders::*;
use std::sync::OnceLock;

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
    type Check = fn() -> Result<(), Failed>;
    let checks: [(&str, Check); 9] = [
        ("a_plane_hides_what_is_behind_it", a_plane_hides_what_is_behind_it),
        ("a_closed_room_leaks_nothing", a_closed_room_leaks_nothing),
        ("a_sphere_is_hit_between_its_radii", a_sphere_is_hit_between_its_radii),
        ("rooms_see_each_other_through_the_door", rooms_see_each_other_through_the_door),
        ("trees_find_what_testing_every_triangle_finds", trees_find_what_testing_every_triangle_finds),
        ("a_brickmap_finds_the_octrees_cells", a_brickmap_finds_the_octrees_cells),
        ("what_is_no_segment_is_not_occluded", what_is_no_segment_is_not_occluded),
        ("imperfect_shadow_maps_are_not_far_off", imperfect_shadow_maps_are_not_far_off),
        ("what_does_not_fit_is_an_error", what_does_not_fit_is_an_error),
    ];
    let mut trials: Vec<Trial> = checks.into_iter().map(|(name, check)| Trial::test(name, check)).collect();
    type GpuCheck = fn(&'static GpuContext) -> Result<(), Failed>;
    let gpu_checks: [(&str, GpuCheck); 3] = [
        ("shaders_equal_their_twins", shaders_equal_their_twins),
        ("shaders_have_known_answers_too", shaders_have_known_answers_too),
        ("long_rays_are_tested_again", long_rays_are_tested_again),
    ];
    trials.extend(gpu_checks.map(|(name, check)| {
        let reason = reason.clone();
        Trial::test(name, move || match CONTEXT.get().and_then(Option::as_ref) {
            Some(context) => check(context),
            None => Err(format!("MANYVIEW_REQUIRE_GPU is 1, but {reason}").into()),
        })
        .with_ignored_flag(!found && !required)
    }));
    libtest_mimic::run(&arguments, trials).exit();
}
