//! Shaders against their twins, and with known answers.

use crate::answers::*;
use crate::place::*;
use libtest_mimic::Failed;
use manyview::gpu::{GpuContext, WgpuExecutor};
use manyview::rivals::brickmap::{self, Brickmap, BrickmapBias};
use manyview::rivals::wide_bvh::WideBvh;
use manyview::visibility::{LightPoint, Receiver, Visibility, VisibilityError, light_words};
use manyview_pipeline::generate::{SceneKind, generate};
use manyview_shaders::executor::ExecutorLimits;

pub(crate) fn shaders_have_known_answers_too(context: &'static GpuContext) -> Result<(), Failed> {
    let place = plane()?;
    plane_answers(&place, &gpu_methods(&place, &place.reference(), context)?)?;
    let place = room()?;
    room_answers(&gpu_methods(&place, &place.reference(), context)?)?;
    let place = two_rooms()?;
    rooms_answers(&place, &gpu_methods(&place, &place.reference(), context)?)
}

/// What is asked of a method, as words.
pub(crate) type Ask<'a> = dyn Fn(&dyn Visibility) -> Result<Vec<u32>, VisibilityError> + 'a;

pub(crate) fn shaders_equal_their_twins(context: &'static GpuContext) -> Result<(), Failed> {
    // Software adapters neither fuse nor approximate. Others may: then a ray that passes a border within rounding
    // differs.
    let most = if context.is_software() { 0 } else { 20 };
    for place in [forest()?, Place::new(generate(SceneKind::Town, 5000, 3), 8)?] {
        let reference = place.reference();
        let map = brickmap::from_svo(&place.svo, 8, brickmap::DEFAULT_BIAS);
        let twins: Methods = [
            vec![Box::new(WideBvh::new(&reference).on_executor(twins()?)?)],
            vec![Box::new(brickmap::on_executor(&map, twins()?)?)],
        ];
        let segments = random_segments(&place, 21, 20_000);
        let receivers: Vec<Receiver> = segments[..300]
            .iter()
            .map(|s| Receiver { position: s.origin, normal: [0.6, 0.8, 0.0] })
            .collect();
        let lights: Vec<LightPoint> = segments[..70].iter().map(|s| LightPoint::at(s.target)).collect();
        for (gpu, twin) in
            gpu_methods(&place, &reference, context)?.iter().flatten().zip(twins.iter().flatten())
        {
            let both = |ask: &Ask| {
                let (found, expected) = (ask(&**gpu)?, ask(&**twin)?);
                let differing = found.iter().zip(&expected).filter(|(a, b)| a != b).count();
                let any = expected.iter().any(|&word| word != expected[0]);
                Ok::<_, Failed>((differing, any))
            };
            let occluded = both(&|method| {
                let mut occluded = vec![9; segments.len()];
                method.occluded(&segments, &mut occluded)?;
                Ok(occluded.into_iter().map(u32::from).collect())
            })?;
            let distances = both(&|method| {
                let mut distances = vec![0.0f32; segments.len()];
                method.distances(&segments, &mut distances)?;
                // To a part in 2^16, but on a software adapter to the bit.
                let bits = if most == 0 { 0 } else { 7 };
                Ok(distances.into_iter().map(|d| d.to_bits() >> bits).collect())
            })?;
            let hidden = both(&|method| {
                let mut hidden = vec![9; receivers.len() * light_words(lights.len())];
                method.hidden_lights(&receivers, &lights, &mut hidden)?;
                Ok(hidden)
            })?;
            for (what, (differing, any)) in
                [("occluded", occluded), ("distances", distances), ("hidden lights", hidden)]
            {
                let name = gpu.name();
                ensure!(differing <= most && any, "{name}: {differing} {what} differ from the twin's");
            }
        }
    }
    Ok(())
}

pub(crate) fn long_rays_are_tested_again(context: &'static GpuContext) -> Result<(), Failed> {
    // A diagonal of cells, a ray beside it that takes thousands of steps, and a cell at its end: 32 such rays are more
    // than some drivers let an invocation do.
    let mut cells: Vec<[u16; 3]> = (0..2047).flat_map(|x| [[x, x, 8], [x + 1, x, 8]]).collect();
    cells.push([2040, 2040, 9]);
    let code = |cell: &[u16; 3]| {
        (0..12).fold(0u64, |code, bit| {
            code | (0..3).map(|i| u64::from(cell[i] >> bit & 1) << (3 * bit + i)).sum::<u64>()
        })
    };
    cells.sort_by_key(code);
    let map = Brickmap::new([0.0; 3], 2048.0, 11, &cells, BrickmapBias::NONE);
    let gpu = brickmap::on_executor(&map, Box::new(WgpuExecutor::new(context, ExecutorLimits::DEFAULT)))?;
    let receivers: Vec<Receiver> = (0..64)
        .map(|i| Receiver { position: [0.5, 0.25 + i as f32 / 256.0, 9.5], normal: [0.0; 3] })
        .collect();
    let lights = [LightPoint::at([2046.5, 2046.5, 9.5]); 40];
    let steps = {
        let mut steps = u32::MAX;
        let hit = map.view().march(&lights[0].segment_from(&receivers[0]), &mut steps);
        ensure!(hit.is_some(), "the cell at the end is found");
        u32::MAX - steps
    };
    ensure!(32 * steps > 65_535, "{steps} steps are not many");
    let mut hidden = vec![0; 128];
    gpu.hidden_lights(&receivers, &lights, &mut hidden)?;
    let all = hidden.chunks(2).all(|words| words == [u32::MAX, 255]);
    ensure!(all, "some of {steps} steps were left out: {hidden:x?}");
    Ok(())
}
