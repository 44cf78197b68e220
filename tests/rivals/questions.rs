//! Segments that are none, what a method does not answer, and what does not fit.

use crate::answers::{box_quads, plane};
use crate::place::*;
use glam::DVec3;
use libtest_mimic::Failed;
use manyview::exact::ExactRays;
use manyview::rivals::brickmap::{self, BrickmapBias};
use manyview::rivals::ism::{IsmOptions, IsmVisibility};
use manyview::rivals::wide_bvh::WideBvh;
use manyview::visibility::{LightPoint, Receiver, Segment, Visibility, VisibilityError, light_words};
use manyview_shaders::cases::Random;
use manyview_shaders::device::DeviceError;
use manyview_shaders::executor::{CpuExecutor, Executor, ExecutorLimits};

pub(crate) fn what_is_no_segment_is_not_occluded() -> Result<(), Failed> {
    let place = plane()?;
    let reference = place.reference();
    let up =
        |from: f32, to: f32| Segment { origin: [0.1, from, 0.2], target: [0.1, to, 0.2], normal: [0.0; 3] };
    let segments = [
        up(f32::NAN, 1.0),
        up(-1.0, f32::NAN),
        up(-1.0, f32::INFINITY),
        up(f32::NEG_INFINITY, 1.0),
        up(0.013, 0.013),
        up(-3e38, 3e38),
        up(5.0, 6.0),
        // The last two are segments, the second from far outside.
        up(-1.0, 1.0),
        up(-1000.0, 1.0),
    ];
    let expected = [0, 0, 0, 0, 0, 0, 0, 1, 1];
    let receivers = segments.map(|s| Receiver { position: s.origin, normal: [0.0, -1.0, 0.0] });
    let mut lights: Vec<LightPoint> = segments.iter().map(|s| LightPoint::at(s.target)).collect();
    lights.push(LightPoint::directional([0.0, -1.0, 0.0], 30.0));
    lights.extend((0..40).map(|i| LightPoint::at([0.3, i as f32 * 0.1 - 2.04, 0.1])));
    for method in methods(&place, &reference)?.iter().flatten() {
        let mut occluded = [9; 9];
        method.occluded(&segments, &mut occluded)?;
        ensure!(occluded == expected, "{}: {occluded:?}", method.name());
        let mut distances = [0.0; 9];
        method.distances(&segments, &mut distances)?;
        for (distance, expected) in distances.iter().zip(expected) {
            ensure!(distance.is_finite() == (expected == 1), "{}: {distances:?}", method.name());
        }
        // Every pair of a receiver and a light is a segment.
        let words = light_words(lights.len());
        let mut hidden = vec![u32::MAX; receivers.len() * words];
        method.hidden_lights(&receivers, &lights, &mut hidden)?;
        for (receiver, hidden) in receivers.iter().zip(hidden.chunks(words)) {
            let segments: Vec<Segment> = lights.iter().map(|light| light.segment_from(receiver)).collect();
            let mut occluded = vec![9; segments.len()];
            method.occluded(&segments, &mut occluded)?;
            for (i, &occluded) in occluded.iter().enumerate() {
                let bit = hidden[i / 32] >> (i % 32) & 1 == 1;
                let expected = occluded == 1 || lights[i].is_behind(receiver);
                ensure!(bit == expected, "{}: light {i} from {receiver:?}", method.name());
            }
            ensure!(hidden[1] >> (lights.len() - 32) == 0, "bits beyond the last light are 0");
        }
        method.hidden_lights(&receivers, &[], &mut [])?;
        method.hidden_lights(&[], &lights, &mut [])?;
        method.occluded(&[], &mut [])?;
    }
    Ok(())
}

pub(crate) fn imperfect_shadow_maps_are_not_far_off() -> Result<(), Failed> {
    // A box on a floor; lights all around above, receivers on the floor.
    let mut quads = box_quads([-1.0, 0.0, -1.0], [1.0, 2.0, 1.0]);
    quads.push([[-6.0, 0.0, -6.0], [6.0, 0.0, -6.0], [6.0, 0.0, 6.0], [-6.0, 0.0, 6.0]]);
    let place = Place::of_quads(&quads, 7)?;
    let reference = place.reference();
    let mut random = Random::new(11);
    let receivers: Vec<Receiver> = (0..500)
        .map(|_| point_in(&mut random, DVec3::new(-5.0, 0.0, -5.0), DVec3::new(5.0, 0.0, 5.0)))
        .filter(|p| p.x.abs().max(p.z.abs()) > 1.2)
        .map(|p| Receiver { position: p.as_vec3().to_array(), normal: [0.0, 1.0, 0.0] })
        .collect();
    let lights: Vec<LightPoint> = (0..70)
        .map(|_| point_in(&mut random, DVec3::new(-6.0, 2.5, -6.0), DVec3::new(6.0, 4.0, 6.0)))
        .map(|p| LightPoint::at(p.as_vec3().to_array()))
        .collect();
    let words = light_words(lights.len());
    let mut exact = vec![0; receivers.len() * words];
    ExactRays::new(&reference).hidden_lights(&receivers, &lights, &mut exact)?;
    let share = |bits: &[u32]| {
        f64::from(bits.iter().map(|w| w.count_ones()).sum::<u32>()) / (receivers.len() * lights.len()) as f64
    };
    ensure!((0.04..0.5).contains(&share(&exact)), "{} hidden", share(&exact));
    let error = |options: IsmOptions| -> Result<f64, Failed> {
        let mut hidden = vec![u32::MAX; exact.len()];
        IsmVisibility::new(&reference, options).hidden_lights(&receivers, &lights, &mut hidden)?;
        Ok(share(&hidden.iter().zip(&exact).map(|(a, b)| a ^ b).collect::<Vec<_>>()))
    };
    let default = error(IsmOptions::default())?;
    ensure!(default < 0.15, "eps_v is {default}");
    let coarse = error(IsmOptions { points_per_light: 200, resolution: 8, ..IsmOptions::default() })?;
    ensure!(coarse > default, "few points and texels err more: {coarse} and {default}");

    let ism = IsmVisibility::new(&reference, IsmOptions::default());
    let refused = ism.occluded(&[Segment::default()], &mut [0]);
    ensure!(matches!(refused, Err(VisibilityError::Unsupported { .. })), "{refused:?}");
    let sun = [LightPoint::directional([0.0, -1.0, 0.0], 30.0)];
    let refused = ism.hidden_lights(&receivers[..1], &sun, &mut [0]);
    ensure!(matches!(refused, Err(VisibilityError::Unsupported { .. })), "{refused:?}");
    Ok(())
}

pub(crate) fn what_does_not_fit_is_an_error() -> Result<(), Failed> {
    let place = forest()?;
    let reference = place.reference();
    let small = |binding_bytes| -> Box<dyn Executor + Send> {
        Box::new(CpuExecutor::new(ExecutorLimits { binding_bytes, depth_side: 8 }))
    };
    let refused = WideBvh::new(&reference).on_executor(small(100_000)).err();
    let names_it = |error: &DeviceError| error.to_string().contains("BVH");
    ensure!(refused.as_ref().is_some_and(names_it), "{refused:?}");
    let map = brickmap::from_svo(&place.svo, 8, BrickmapBias::NONE);
    let refused = brickmap::on_executor(&map, small(1000)).err();
    ensure!(matches!(refused, Some(DeviceError::TooLarge { .. })), "{refused:?}");
    Ok(())
}
