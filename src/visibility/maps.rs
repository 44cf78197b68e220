//! Shadows from the maps of views: any [`ViewRenderer`] as a method of testing lights.
//!
//! # Theory
//! L. Williams, *Casting Curved Shadows on Curved Surfaces*, SIGGRAPH 1978: a receiver that is farther from a light than
//! what the light's map holds in its direction is in shadow. A map has one distance for all that a texel shows: the
//! nearest. A receiver must not be hidden by the rest of its own surface, so that what counts is where the plane through
//! it comes nearest to the light within the texel; and nodes are drawn at their middles, up to half a texel and a voxel
//! off. What is left to choose is in [`Bias`].
//!
//! # Practice
//! Every light at a position is a view that sees all around. Maps that fit the budget are drawn once and kept until other
//! lights are asked about; others are drawn again, run by run, for every batch of receivers.

use crate::views::{View, ViewMaps, ViewRenderer, ViewSettings};
use crate::visibility::{LightPoint, Receiver, Segment, Visibility, VisibilityError, light_words, parallel};
use manyview_shaders::paraboloid;
use std::sync::{Arc, Mutex, PoisonError};

/// By how much a receiver must be farther than its map says to be in shadow.
///
/// The shares are those at which false shadows and false light of virtual lights add up to the least over generated towns
/// and real interiors at 16² and 64²; near them the sum is flat.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bias {
    /// Edge of the scene hierarchy's leaves, metres.
    pub voxel_metres: f32,
    /// How far around the texel's middle its surface is followed, in the texel's widths: half its diagonal.
    pub reach_texels: f32,
    /// For the middles of nodes, in the texel's widths at the receiver.
    pub texels: f32,
    /// For the middles of leaves, in leaves.
    pub voxels: f32,
    /// How far receivers are lifted off their surface, in leaves.
    pub lift_voxels: f32,
}

impl Bias {
    /// The bias for a scene hierarchy of leaves of this edge.
    pub fn new(voxel_metres: f32) -> Self {
        Self { voxel_metres, reach_texels: 0.7, texels: 0.5, voxels: 1.0, lift_voxels: 1.0 }
    }

    /// Off the surface along its normal.
    #[inline]
    pub fn lifted(&self, position: [f32; 3], normal: [f32; 3]) -> [f32; 3] {
        let lift = self.lift_voxels * self.voxel_metres;
        [0, 1, 2].map(|i| position[i] + normal[i] * lift)
    }
}

/// Whether a receiver at `position` ([`Bias::lifted`]) with this normal (zero for none) lies behind what a map holds.
#[inline]
pub fn is_hidden(maps: &ViewMaps, map: usize, position: [f32; 3], normal: [f32; 3], bias: &Bias) -> bool {
    LookUp::new(maps, map, position).is_hidden(maps, normal, bias)
}

/// Where a map shows a receiver: the part of the test before the map's memory is touched, which is far away for most.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LookUp {
    map: u32,
    texel: u32,
    offset: [f32; 3],
    distance: f32,
}

impl LookUp {
    /// Finds the texel, and asks for its depth.
    #[inline]
    pub(crate) fn new(maps: &ViewMaps, map: usize, position: [f32; 3]) -> Self {
        let center = maps.centers()[map];
        let offset = [0, 1, 2].map(|i| position[i] - center[i]);
        let distance = (offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]).sqrt();
        let texel = match distance > 0.0 {
            true => paraboloid::texel(offset, distance, maps.resolution()),
            false => 0,
        };
        maps.prefetch_depth(map, texel as usize);
        Self { map: map as u32, texel, offset, distance }
    }

    /// The answer.
    #[inline]
    pub(crate) fn is_hidden(&self, maps: &ViewMaps, normal: [f32; 3], bias: &Bias) -> bool {
        let Self { offset, distance, texel, .. } = *self;
        let depth = maps.depth(self.map as usize, texel as usize);
        if distance <= depth || distance == 0.0 {
            return false;
        }
        // Texels of a paraboloid map are the wider the farther from its axis; here as an angle, and metres there.
        let width = 2.0 * (1.0 + offset[0].abs() / distance) / maps.resolution() as f32;
        let bias_metres = bias.texels * width * distance + bias.voxels * bias.voxel_metres;
        let nearest = match normal == [0.0; 3] {
            true => distance,
            false => {
                nearest_of_plane(texel, maps.resolution(), offset, normal, bias.reach_texels).min(distance)
            }
        };
        nearest - bias_metres > depth
    }
}

/// How near the plane through `offset` with this normal comes to the middle of a map within `reach_texels` of a texel's
/// middle.
#[inline]
fn nearest_of_plane(
    texel: u32,
    resolution: u32,
    offset: [f32; 3],
    normal: [f32; 3],
    reach_texels: f32,
) -> f32 {
    let dot = |v: [f32; 3]| v[0] * normal[0] + v[1] * normal[1] + v[2] * normal[2];
    let direction = paraboloid::texel_direction(texel, resolution);
    let (plane_distance, toward) = (-dot(offset), -dot(direction));
    if plane_distance <= 0.0 {
        // The light lies in the plane, or sees its back: the limit of the planes before.
        return 0.0;
    }
    let reach = reach_texels * 2.0 * (1.0 + direction[0].abs()) / resolution as f32;
    // The steepest direction toward the plane within reach: the cosine's slope is the sine.
    let most = toward + reach * (1.0 - toward * toward).max(0.0).sqrt();
    if most > 0.0 { plane_distance / most } else { f32::INFINITY }
}

/// Lights as they were asked about, and their maps.
type Kept = (Vec<LightPoint>, Arc<ViewMaps>);

/// A renderer of views as a method of testing lights.
pub struct MapVisibility<R> {
    renderer: R,
    settings: ViewSettings,
    bias: Bias,
    kept: Mutex<Option<Kept>>,
}

impl<R: ViewRenderer> MapVisibility<R> {
    /// Takes a renderer of a scene hierarchy.
    pub fn new(renderer: R, settings: ViewSettings, bias: Bias) -> Self {
        Self { renderer, settings, bias, kept: Mutex::new(None) }
    }

    /// What draws the maps.
    pub fn renderer(&self) -> &R {
        &self.renderer
    }

    /// How the maps are drawn.
    pub fn settings(&self) -> &ViewSettings {
        &self.settings
    }

    /// The bias.
    pub fn bias(&self) -> &Bias {
        &self.bias
    }

    fn unsupported(&self, problem: &'static str) -> VisibilityError {
        VisibilityError::Unsupported { method: self.renderer.name(), problem }
    }

    /// Answers for the lights whose maps are given.
    fn answer(&self, receivers: &[Receiver], lights: &[LightPoint], maps: &ViewMaps, hidden: &mut [u32]) {
        let of = (maps.views().len(), |place: usize| maps.views()[place] as usize);
        parallel::hide_some(receivers, lights, of, hidden, |place, segment| {
            let map = maps.map_of()[place];
            let position = self.bias.lifted(segment.origin, segment.normal);
            map != ViewMaps::NO_MAP && is_hidden(maps, map as usize, position, segment.normal, &self.bias)
        });
    }
}

impl<R: ViewRenderer> Visibility for MapVisibility<R> {
    fn name(&self) -> &'static str {
        self.renderer.name()
    }

    fn occluded(&self, _: &[Segment], _: &mut [u8]) -> Result<(), VisibilityError> {
        Err(self.unsupported(SEGMENTS))
    }

    fn distances(&self, _: &[Segment], _: &mut [f32]) -> Result<(), VisibilityError> {
        Err(self.unsupported(SEGMENTS))
    }

    fn hidden_lights(
        &self,
        receivers: &[Receiver],
        lights: &[LightPoint],
        hidden: &mut [u32],
    ) -> Result<(), VisibilityError> {
        let words = light_words(lights.len());
        assert_eq!(hidden.len(), receivers.len() * words, "one bit for each receiver and light");
        check_positions(self.name(), lights)?;
        hidden.fill(0);
        if hidden.is_empty() {
            return Ok(());
        }
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, maps)) = kept.as_ref().filter(|(of, _)| of == lights) {
            let maps = maps.clone();
            drop(kept);
            self.answer(receivers, lights, &maps, hidden);
            return Ok(());
        }
        *kept = None;
        let views: Vec<View> = lights.iter().map(|light| View::around(light.offset)).collect();
        let mut all: Option<ViewMaps> = None;
        self.renderer.render_passes(&views, &self.settings, &mut |pass| {
            self.answer(receivers, lights, &pass, hidden);
            // Kept if there is but one pass: more do not fit.
            all = (pass.views().len() == views.len()).then_some(pass);
            Ok(())
        })?;
        if let Some(all) = all {
            *kept = Some((lights.to_vec(), Arc::new(all)));
        }
        Ok(())
    }
}

/// Why methods that have maps of lights refuse segments.
pub(crate) const SEGMENTS: &str =
    "has depth maps of lights and answers for receivers and lights only; use `rows` or `bvh` for segments";

/// Refuses lights without a position: a method that has maps of lights has none of them.
pub(crate) fn check_positions(method: &'static str, lights: &[LightPoint]) -> Result<(), VisibilityError> {
    let problem = "has maps of lights at positions only; use `rows` or `bvh` for directional lights";
    match lights.iter().all(|light| light.position_weight == 0.0) {
        true => Ok(()),
        false => Err(VisibilityError::Unsupported { method, problem }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::views::{Depths, PassSink, ViewError};
    use manyview_shaders::paraboloid::{texel_count, texel_direction};

    /// Sees a wall at x = `wall` wherever |y| and |z| are at most 1 there, in passes of `most` views.
    struct Wall {
        wall: f32,
        most: usize,
    }

    impl ViewRenderer for Wall {
        fn name(&self) -> &'static str {
            "wall"
        }

        fn render_passes(
            &self,
            views: &[View],
            settings: &ViewSettings,
            sink: &mut PassSink<'_>,
        ) -> Result<(), ViewError> {
            let order: Vec<u32> = (0..views.len() as u32).rev().collect();
            for run in order.chunks(self.most) {
                let mut depths = Vec::new();
                for &view in run {
                    let from = views[view as usize].position;
                    depths.extend((0..texel_count(settings.resolution) as u32).map(|texel| {
                        let d = texel_direction(texel, settings.resolution);
                        let t = (self.wall - from[0]) / d[0];
                        let on = |i: usize| (from[i] + d[i] * t).abs() <= 1.0;
                        if t > 0.0 && on(1) && on(2) { t } else { f32::INFINITY }
                    }));
                }
                let centers = run.iter().map(|&view| views[view as usize].position).collect();
                let maps = (0..run.len() as u32).collect();
                let depths = Depths::Full(depths);
                sink(ViewMaps::from_parts(settings.resolution, run.to_vec(), maps, centers, depths, vec![]))?;
            }
            Ok(())
        }
    }

    fn ask(most: usize, receivers: &[Receiver], lights: &[LightPoint]) -> Vec<u32> {
        let method = MapVisibility::new(Wall { wall: 2.0, most }, ViewSettings::new(32), Bias::new(0.01));
        let mut hidden = vec![7; receivers.len() * light_words(lights.len())];
        method.hidden_lights(receivers, lights, &mut hidden).unwrap();
        let mut again = hidden.clone();
        method.hidden_lights(receivers, lights, &mut again).unwrap();
        assert_eq!(hidden, again);
        hidden
    }

    #[test]
    fn what_is_behind_the_wall_is_hidden_and_what_is_on_it_is_not() {
        let at = |x: f32, y: f32, normal: [f32; 3]| Receiver { position: [x, y, 0.0], normal };
        let back = [-1.0, 0.0, 0.0];
        let receivers = [
            at(1.0, 0.0, back),
            at(2.0, 0.0, back),
            at(2.0, 0.9, back),
            at(3.0, 0.2, back),
            at(3.0, 0.2, [0.0; 3]),
            at(3.0, 4.0, back),
            at(1.0, 0.0, [1.0, 0.0, 0.0]),
        ];
        let lights: Vec<LightPoint> = [[0.0; 3], [0.5, 0.3, 0.0], [f32::NAN; 3]].map(LightPoint::at).to_vec();
        let expected = vec![0, 0, 0, 3, 3, 0, 3];
        for most in [1, 2, 9] {
            assert_eq!(ask(most, &receivers, &lights), expected, "in passes of {most}");
        }
        // More lights than a word has bits.
        let many: Vec<LightPoint> = (0..70).map(|i| LightPoint::at([0.01 * i as f32, 0.0, 0.0])).collect();
        assert_eq!(ask(70, &receivers[3..4], &many), [u32::MAX, u32::MAX, 63]);
        assert_eq!(ask(9, &receivers[3..4], &many), [u32::MAX, u32::MAX, 63]);
        assert!(ask(9, &receivers, &[]).is_empty() && ask(9, &[], &many).is_empty());
    }

    /// The map, seen from the origin, of the plane with this normal at this distance; every texel has the nearest of what
    /// it shows, as maps of points have.
    fn map_of_plane(resolution: u32, normal: [f32; 3], distance: f32) -> ViewMaps {
        let side = 9;
        let depths = (0..texel_count(resolution) as u32).map(|index| {
            let (row, column) = (index / resolution, index % resolution);
            let nearest = (0..side * side).map(|i| {
                let at = [column, row % resolution].map(|c| c as f32);
                let within = [i % side, i / side].map(|c| c as f32 / (side - 1) as f32);
                let at = [0, 1].map(|i| at[i] + within[i]);
                let d = paraboloid::direction(row / resolution, at, resolution);
                let toward = -(d[0] * normal[0] + d[1] * normal[1] + d[2] * normal[2]);
                if toward > 0.0 { distance / toward } else { f32::INFINITY }
            });
            nearest.fold(f32::INFINITY, f32::min)
        });
        let depths = Depths::Full(depths.collect());
        ViewMaps::from_parts(resolution, vec![0], vec![0], vec![[0.0; 3]], depths, vec![])
    }

    #[test]
    fn a_plane_does_not_hide_itself_and_hides_what_is_well_behind_it() {
        let mut random = manyview_shaders::cases::Random::new(5);
        let bias = Bias::new(1e-3);
        for resolution in [16, 64] {
            for _ in 0..40 {
                let normal = [0; 3].map(|_| random.range(-1000, 1000) as f32 / 1000.0);
                let length = normal.iter().map(|c| c * c).sum::<f32>().sqrt();
                let normal = normal.map(|c| c / length);
                let maps = map_of_plane(resolution, normal, 2.0);
                for _ in 0..200 {
                    let d = [0; 3].map(|_| random.range(-1000, 1000) as f32 / 1000.0);
                    let toward = -(0..3).map(|i| d[i] * normal[i]).sum::<f32>();
                    let long = d.iter().map(|c| c * c).sum::<f32>().sqrt();
                    if toward <= 0.0 {
                        continue;
                    }
                    let on_it = d.map(|c| c * 2.0 / toward);
                    assert!(!is_hidden(&maps, 0, on_it, normal, &bias), "{on_it:?} {normal:?} {resolution}");
                    // Twice as far, where texels are no larger than what they show is far.
                    if toward > 0.5 * long {
                        let behind = on_it.map(|c| c * 2.0);
                        assert!(is_hidden(&maps, 0, behind, normal, &bias), "{behind:?} {normal:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn segments_and_suns_are_refused() {
        let method = MapVisibility::new(Wall { wall: 1.0, most: 9 }, ViewSettings::new(8), Bias::new(0.01));
        let error = method.occluded(&[], &mut []).unwrap_err().to_string();
        assert!(error.contains("`wall`") && error.contains("use `rows`"), "{error}");
        let sun = [LightPoint::directional([0.0, -1.0, 0.0], 9.0)];
        assert!(method.hidden_lights(&[], &sun, &mut []).is_err());
    }
}
