//! Shaders against their twins, and with known answers.

use crate::answers::*;
use crate::place::*;
use libtest_mimic::Failed;
use manyview::gpu::GpuContext;
use manyview::rivals::brickmap::{self};
use manyview::rivals::wide_bvh::WideBvh;
use manyview::visibility::{LightPoint, Receiver, Visibility, VisibilityError, light_words};
use manyview_pipeline::generate::{SceneKind, generate};

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
