//! The light that many small lights give every pixel.
//!
//! # Theory
//! \[MV\] (Applications): subtrees of lights that cannot shine on a pixel are culled, of the rest every pixel takes a random
//! subset, asks their maps which of them it sees, and a filter guided by the G-buffer evens out the noise.
//!
//! # Differences from the paper
//! Choices are made for groups of a few pixels that face one way, not for each; runs of lights that may give more are
//! chosen more often and count less in return, so that the mean is the same. The pixels of a tile take different parts of the
//! choices ([`Gather::sample`]), so that the filter's window sees thousands of lights, not the same few.
//!
//! # Practice
//! A light seen from very near lights a spot, which is what remains of a surface cut into points: within
//! [`GatherOptions::clamp_metres`] a light counts as that far away.
//!
//! Maps may come in passes: each adds what its lights give. Which lights a pixel takes depends on pixel and seed alone.

use super::light_tree::{Choice, ChoiceRule, LightTree};
use super::receivers::{Receivers, TILE, groups, tile_count};
use super::{MAX_VIRTUAL_LIGHTS, VirtualLight};
use crate::render::gbuffer::{GBuffer, Pixel};
use crate::simd::prefetch;
use crate::views::{View, ViewError, ViewMaps, ViewRenderer, ViewSettings};
use crate::visibility::{Bias, LookUp, Segment, Visibility, VisibilityError};
use glam::Vec3;
use manyview_pipeline::bake::Progress;
use rayon::prelude::*;
use std::time::{Duration, Instant};

/// About how many runs of lights a group of pixels chooses among.
const MOST_NODES: usize = 512;
/// Segments that are tested at a time.
const SEGMENTS: usize = 1 << 20;
/// Views of lights on surfaces are so many leaves off them.
pub const VIEW_LIFT_VOXELS: f32 = 1.5;

/// How many lights every pixel is lit by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Samples {
    /// All that shine on it.
    All,
    /// So many.
    Count(u32),
}

/// A receiver's number and what a segment's light would give it.
type Tested = (u32, Vec3);

/// How light is gathered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GatherOptions {
    /// How many lights every pixel is lit by.
    pub samples: Samples,
    /// Nearer lights count as this far away, metres; 0 for none.
    pub clamp_metres: f32,
    /// Farther lights do not count, metres.
    pub cutoff_metres: f32,
    /// Choose by about how much light each may give, not evenly.
    pub by_importance: bool,
    /// Another seed takes other lights.
    pub seed: u64,
}

impl Default for GatherOptions {
    fn default() -> Self {
        Self {
            samples: Samples::Count(64),
            clamp_metres: 0.0,
            cutoff_metres: f32::INFINITY,
            by_importance: true,
            seed: 1,
        }
    }
}

impl GatherOptions {
    /// A distance to clamp at that hides the spots of `count` lights on the surfaces of a scene of this radius.
    pub fn suitable_clamp(scene_radius: f64, count: usize) -> f32 {
        (scene_radius * (1.5 / (count.max(1) as f64).sqrt()).clamp(0.002, 0.05)) as f32
    }
}

/// What was gathered.
#[derive(Debug, Clone, PartialEq)]
pub struct Gathered {
    /// Of every pixel, lux; 0 where there is no surface.
    pub irradiance: Vec<[f32; 3]>,
    /// Lights that were tested, and how many of them are hidden, for every pixel.
    pub tests: Vec<[u32; 2]>,
    /// In how many passes the maps came; 0 without maps.
    pub passes: u32,
    /// Time for maps.
    pub map_time: Duration,
    /// Time for all else.
    pub gather_time: Duration,
}

/// Lights and the pixels that they light.
pub struct Gather<'a> {
    gbuffer: &'a GBuffer,
    tree: &'a LightTree,
    options: GatherOptions,
    rule: ChoiceRule,
    /// Width of a pixel, metres per metre of distance.
    spread: f32,
}

/// Maps of some of the lights.
struct Shadows<'a> {
    maps: &'a ViewMaps,
    /// For every light the place of its map, [`ELSEWHERE`] or [`UNSHADOWED`].
    places: &'a [u32],
    bias: &'a Bias,
}

/// A light that a pixel takes.
struct Pick {
    /// Its number, then the place of its map.
    light: u32,
    weight: f32,
    /// What it gives where it is seen.
    given: Vec3,
    look_up: Option<LookUp>,
}

/// Lights that a pixel takes at a time.
const BATCH: usize = 64;

/// A pixel's sum in one pass.
type Part = (u32, Vec3, [u32; 2]);

impl<'a> Gather<'a> {
    /// Takes a picture whose pixels are `spread` metres wide per metre of distance.
    ///
    /// # Panics
    /// If there are more than [`MAX_VIRTUAL_LIGHTS`] lights.
    pub fn new(gbuffer: &'a GBuffer, tree: &'a LightTree, spread: f64, options: GatherOptions) -> Self {
        assert!(tree.lights().len() <= MAX_VIRTUAL_LIGHTS, "as many lights as are allowed");
        let near2 = options.clamp_metres * options.clamp_metres;
        let rule = ChoiceRule {
            cutoff: options.cutoff_metres,
            near2: near2.max(f32::MIN_POSITIVE),
            by_importance: options.by_importance,
            most_nodes: MOST_NODES,
        };
        Self { gbuffer, tree, options, rule, spread: spread as f32 }
    }

    fn empty(&self) -> Gathered {
        let count = self.gbuffer.pixels.len();
        Gathered {
            irradiance: vec![[0.0; 3]; count],
            tests: vec![[0; 2]; count],
            passes: 0,
            map_time: Duration::ZERO,
            gather_time: Duration::ZERO,
        }
    }

    /// Irradiance of a pixel's surface by a light that it sees, if the two face each other.
    #[inline]
    fn irradiance(&self, pixel: &Pixel, light: &VirtualLight) -> Option<Vec3> {
        let to_light = Vec3::from(light.position) - Vec3::from(pixel.position);
        let along = to_light.dot(pixel.normal.into());
        // Both, or light would shine through surfaces whose shading normal leans.
        if !(along > 0.0 && to_light.dot(pixel.geometric_normal.into()) > 0.0) {
            return None;
        }
        let distance2 = to_light.length_squared();
        if distance2 > self.options.cutoff_metres * self.options.cutoff_metres {
            return None;
        }
        let mut factor = along / (distance2.sqrt() * distance2.max(self.rule.near2));
        if light.normal != [0.0; 3] {
            let at_light = -to_light.dot(light.normal.into()) / distance2.sqrt();
            if at_light.is_nan() || at_light <= 0.0 {
                return None;
            }
            factor *= at_light;
        }
        Some(Vec3::from(light.intensity) * factor)
    }

    /// Calls `visit` with the lights that a pixel takes and what each counts: the lights of `choices`, `total` in all.
    ///
    /// Of k lights the j-th is the one at share (j + o) / k of the choices' sum of probabilities. The offset o is one of 64
    /// parts of 1, in dispersed order over the tile's pixels, and random within its part.
    #[inline]
    fn sample(&self, index: u32, choices: &[Choice], total: usize, mut visit: impl FnMut(u32, f32)) {
        let wanted = match self.options.samples {
            Samples::Count(count) if (count as usize) < total => count,
            _ => {
                for choice in choices {
                    (choice.first..choice.first + choice.count).for_each(|light| visit(light, 1.0));
                }
                return;
            }
        };
        let (x, y) = (index % self.gbuffer.width, index / self.gbuffer.width);
        let part = dispersed(x % TILE, y % TILE);
        let mut state = hash(u64::from(index) ^ self.options.seed.rotate_left(32));
        let parts = f64::from(TILE * TILE);
        let scale = choices.last().map_or(1.0, |choice| choice.until) / f64::from(wanted);
        let mut at = 0;
        for number in 0..wanted {
            state = hash(state);
            let random = (state >> 11) as f64 / (1u64 << 53) as f64;
            let share = (f64::from(number) + (f64::from(part) + random) / parts) * scale;
            while at + 1 < choices.len() && choices[at].until <= share {
                at += 1;
            }
            let choice = &choices[at];
            let probability = f64::from(choice.probability);
            let within = (share - (choice.until - probability)) / probability;
            // Casts cut off at 0.
            let place = ((within * f64::from(choice.count)) as u32).min(choice.count - 1);
            visit(choice.first + place, choice.count as f32 / (wanted as f32 * choice.probability));
        }
    }

    /// Lights the pixels by lights whose maps `renderer` draws, in passes that keep to the budget.
    pub fn by_maps(
        &self,
        renderer: &dyn ViewRenderer,
        settings: &ViewSettings,
        bias: &Bias,
        progress: &dyn Progress,
    ) -> Result<Gathered, ViewError> {
        let mut found = self.empty();
        let clock = Instant::now();
        let lift = VIEW_LIFT_VOXELS * bias.voxel_metres;
        let views: Vec<View> = self.tree.lights().par_iter().map(|light| light.view(lift)).collect();
        let mut places = Vec::new();
        let mut gather_time = Duration::ZERO;
        progress.begin("maps and light", views.len() as u64, "views");
        renderer.render_passes(&views, settings, &mut |maps| {
            if progress.cancelled() {
                return Err(ViewError::Cancelled);
            }
            let clock = Instant::now();
            places.clear();
            places.resize(views.len(), ELSEWHERE);
            for (&view, &map) in maps.views().iter().zip(maps.map_of()) {
                places[view as usize] = if map == ViewMaps::NO_MAP { UNSHADOWED } else { map };
            }
            self.add(&mut found, Some(&Shadows { maps: &maps, places: &places, bias }));
            found.passes += 1;
            progress.advance(maps.views().len() as u64);
            gather_time += clock.elapsed();
            Ok(())
        })?;
        if progress.cancelled() {
            return Err(ViewError::Cancelled);
        }
        found.gather_time = gather_time;
        found.map_time = clock.elapsed().saturating_sub(gather_time);
        Ok(found)
    }

    /// Lights the pixels as if nothing hid any light.
    pub fn unshadowed(&self) -> Gathered {
        let mut found = self.empty();
        let clock = Instant::now();
        self.add(&mut found, None);
        found.gather_time = clock.elapsed();
        found
    }

    /// Adds what lights give whose maps are there; without maps what all give.
    fn add(&self, found: &mut Gathered, shadows: Option<&Shadows<'_>>) {
        let tile = |tile: u32| {
            let mut parts: Vec<Part> = Vec::new();
            let (mut choices, mut batch) = (Vec::new(), Vec::with_capacity(BATCH));
            for Receivers { pixels, group } in groups(self.gbuffer, tile, self.spread) {
                let total = self.tree.choose(&group, &self.rule, &mut choices);
                for &index in &pixels {
                    let mut part = (index, Vec3::ZERO, [0; 2]);
                    self.sample(index, &choices, total, |light, weight| {
                        let of = &self.tree.lights()[light as usize];
                        prefetch(&of.position, 0);
                        prefetch(&of.intensity, 2);
                        if let Some(shadows) = shadows {
                            prefetch(shadows.places, light as usize);
                        }
                        batch.push(Pick { light, weight, given: Vec3::ZERO, look_up: None });
                        if batch.len() == BATCH {
                            self.add_batch(&mut part, &mut batch, shadows);
                        }
                    });
                    self.add_batch(&mut part, &mut batch, shadows);
                    parts.push(part);
                }
            }
            parts
        };
        let parts: Vec<Vec<Part>> = (0..tile_count(self.gbuffer)).into_par_iter().map(tile).collect();
        parts.into_iter().flatten().for_each(|part| found.take(part));
    }

    /// Adds what some lights give a pixel. Lights, middles of maps and maps are each somewhere in memory: every step asks
    /// for what the next one reads, so that the waits of a batch overlap.
    #[inline]
    fn add_batch(&self, part: &mut Part, batch: &mut Vec<Pick>, shadows: Option<&Shadows<'_>>) {
        let (index, sum, tests) = part;
        let pixel = &self.gbuffer.pixels[*index as usize];
        batch.retain_mut(|pick| {
            let of = &self.tree.lights()[pick.light as usize];
            let Some(irradiance) = self.irradiance(pixel, of) else { return false };
            pick.given = irradiance * pick.weight;
            if let Some(shadows) = shadows {
                let map = shadows.places[pick.light as usize];
                pick.light = map;
                prefetch(shadows.maps.centers(), map as usize);
                return map != ELSEWHERE;
            }
            true
        });
        if let Some(Shadows { maps, bias, .. }) = shadows {
            let position = bias.lifted(pixel.position, pixel.geometric_normal);
            for pick in batch.iter_mut().filter(|pick| pick.light != UNSHADOWED) {
                pick.look_up = Some(LookUp::new(maps, pick.light as usize, position));
            }
        }
        for pick in batch.drain(..) {
            let is_hidden = match (pick.look_up, shadows) {
                (Some(look_up), Some(Shadows { maps, bias, .. })) => {
                    look_up.is_hidden(maps, pixel.geometric_normal, bias)
                }
                _ => false,
            };
            *tests = [tests[0] + 1, tests[1] + u32::from(is_hidden)];
            if !is_hidden {
                *sum += pick.given;
            }
        }
    }

    /// Lights the pixels by lights that `method` tests segment by segment; they end `lift_metres` off the lights' surfaces.
    pub fn by_segments(
        &self,
        method: &dyn Visibility,
        lift_metres: f32,
        progress: &dyn Progress,
    ) -> Result<Gathered, VisibilityError> {
        let mut found = self.empty();
        let clock = Instant::now();
        let samples = match self.options.samples {
            Samples::Count(count) => (count as usize).min(self.tree.lights().len()),
            Samples::All => self.tree.lights().len(),
        };
        let at_once = (SEGMENTS / samples.max(1)).max(1);
        let tiles_at_once = (at_once / (TILE * TILE) as usize).max(1) as u32;
        let tiles = tile_count(self.gbuffer);
        progress.begin("light", u64::from(tiles), "tiles");
        let mut occluded = Vec::new();
        for first in (0..tiles).step_by(tiles_at_once as usize) {
            let last = (first + tiles_at_once).min(tiles);
            let of = |tile| groups(self.gbuffer, tile, self.spread);
            let groups: Vec<Receivers> = (first..last).into_par_iter().flat_map_iter(of).collect();
            let pixels: Vec<(u32, u32)> = (0..)
                .zip(&groups)
                .flat_map(|(number, group)| group.pixels.iter().map(move |&pixel| (number, pixel)))
                .collect();
            for pixels in pixels.chunks(at_once) {
                if progress.cancelled() {
                    return Err(VisibilityError::Views(ViewError::Cancelled));
                }
                let (segments, light) = self.segments(&groups, pixels, lift_metres);
                occluded.clear();
                occluded.resize(segments.len(), 0);
                method.occluded(&segments, &mut occluded)?;
                for (&(pixel, light), &hidden) in light.iter().zip(&occluded) {
                    let light = if hidden == 0 { light } else { Vec3::ZERO };
                    found.take((pixel, light, [1, u32::from(hidden)]));
                }
            }
            progress.advance(u64::from(last - first));
        }
        found.gather_time = clock.elapsed();
        Ok(found)
    }

    /// The segments of pixels to their lights, and what each light gives if nothing is in between.
    fn segments(
        &self,
        groups: &[Receivers],
        pixels: &[(u32, u32)],
        lift_metres: f32,
    ) -> (Vec<Segment>, Vec<Tested>) {
        let runs: Vec<&[(u32, u32)]> = pixels.chunk_by(|a, b| a.0 == b.0).collect();
        let of = |run: &&[(u32, u32)]| {
            let mut choices = Vec::new();
            let total = self.tree.choose(&groups[run[0].0 as usize].group, &self.rule, &mut choices);
            let (mut segments, mut light) = (Vec::new(), Vec::new());
            for &(_, index) in *run {
                let pixel = &self.gbuffer.pixels[index as usize];
                self.sample(index, &choices, total, |place, weight| {
                    let of = &self.tree.lights()[place as usize];
                    if let Some(irradiance) = self.irradiance(pixel, of) {
                        let target = of.view(lift_metres).position;
                        let normal = pixel.geometric_normal;
                        segments.push(Segment { origin: pixel.position, target, normal });
                        light.push((index, irradiance * weight));
                    }
                });
            }
            (segments, light)
        };
        let parts: Vec<(Vec<Segment>, Vec<Tested>)> = runs.par_iter().map(of).collect();
        let (mut segments, mut light) = (Vec::new(), Vec::new());
        for (more_segments, more_light) in parts {
            segments.extend(more_segments);
            light.extend(more_light);
        }
        (segments, light)
    }
}

impl Gathered {
    fn take(&mut self, (pixel, light, tests): Part) {
        let pixel = pixel as usize;
        self.irradiance[pixel] = (Vec3::from(self.irradiance[pixel]) + light).to_array();
        self.tests[pixel] = [0, 1].map(|i| self.tests[pixel][i] + tests[i]);
    }

    /// Hidden lights / all lights that were tested, for every pixel; 0 where none was.
    pub fn shadow(&self) -> Vec<f32> {
        self.tests.iter().map(|&[all, hidden]| hidden as f32 / all.max(1) as f32).collect()
    }
}

/// Places of lights whose maps come in other passes.
const ELSEWHERE: u32 = u32::MAX;
/// Places of lights that have no map.
const UNSHADOWED: u32 = u32::MAX - 1;

/// A number below 64 for each pixel of a tile, so that those close to each other differ much (B. Bayer, 1973).
fn dispersed(x: u32, y: u32) -> u32 {
    (0..3).fold(0, |sum, bit| {
        let (x, y) = (x >> bit & 1, y >> bit & 1);
        sum | ((x ^ y) << 1 | y) << (4 - 2 * bit)
    })
}

/// The finalizer of SplitMix64 after a step.
fn hash(state: u64) -> u64 {
    let z = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
