//! `ism`: imperfect shadow maps.
//!
//! # Theory
//! T. Ritschel, T. Grosch, M. H. Kim, H.-P. Seidel, C. Dachsbacher, J. Kautz, *Imperfect Shadow Maps for Efficient
//! Computation of Indirect Illumination*, ACM TOG 27(5), 2008, doi 10.1145/1409060.1409082: every light has a small
//! depth map, drawn from a few thousand points of the scene's surface instead of its triangles. Points leave holes,
//! which a pull-push pyramid fills: the pull averages texels that are about as near as the nearest of four, the push
//! writes them into holes and over texels that lie far behind.
//!
//! # Differences from the paper
//! Maps see all around (a dual paraboloid), since lights here have no side. Points are drawn once, by area, and each
//! light takes a run of them that begins elsewhere, where the paper draws anew for every light. The pyramid stops after
//! some levels, so that open sky stays open.
//!
//! # Practice
//! Maps belong to lights: [`Visibility::hidden_lights`] is the one question they answer. Errors depend on the number
//! of points and texels alone, so that their time is theirs to choose: [`IsmOptions`].

use crate::reference::{Reference, area_normal};
use crate::views::{Depths, PassSink, View, ViewError, ViewMaps, ViewRenderer, ViewSettings};
use crate::visibility::maps::{SEGMENTS, check_positions};
use crate::visibility::{Visibility, VisibilityError, light_words, parallel};
use glam::Vec3;
use manyview_shaders::cases::Random;
use manyview_shaders::types::{LightPoint, Receiver, Segment};
use rayon::prelude::*;

/// Runs of points that do not overlap.
const RUNS: usize = 64;
/// Lights whose maps exist at a time.
const LIGHTS_AT_ONCE: usize = 256;
/// Largest half side of a splat, texels: nearer points leave holes to the pyramid.
const MAX_SPLAT_TEXELS: f32 = 3.0;

/// How good and how slow the maps are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IsmOptions {
    /// Points that are drawn into each light's map.
    pub points_per_light: usize,
    /// Texels a side of each of a map's two halves, a power of two.
    pub resolution: u32,
    /// Levels of the pyramid above the map.
    pub pull_levels: u32,
    /// Depths of neighbouring texels belong to one surface if it need not be steeper than this: the tangent of the
    /// angle between its normal and the way to the light.
    pub steepest: f32,
    /// Radius of splats in radii of discs that would together be as large as the surface.
    pub splat_scale: f32,
    /// Behind how much of a texel's width at its distance a receiver is in shadow.
    pub bias_texels: f32,
    /// Seed of the points.
    pub seed: u64,
}

impl Default for IsmOptions {
    /// As many points as the paper takes, and texels about as many. The rest errs least over a town, a city and the Sponza:
    /// `examples/rivals.rs --ism` measures it.
    fn default() -> Self {
        Self {
            points_per_light: 8192,
            resolution: 64,
            pull_levels: 2,
            steepest: 6.0,
            splat_scale: 0.8,
            bias_texels: 0.75,
            seed: 1,
        }
    }
}

/// Points of a scene's surface, from which the maps of any lights are drawn.
#[derive(Debug)]
pub struct IsmVisibility {
    options: IsmOptions,
    /// In random order.
    points: Vec<Vec3>,
    /// Radius of the disc that a point stands for when `points_per_light` share the surface, metres.
    point_radius: f32,
}

impl IsmVisibility {
    /// Draws points on the reference's triangles, where alpha leaves them, each spot as likely.
    pub fn new(reference: &Reference, options: IsmOptions) -> Self {
        let mut area = 0.0;
        let areas: Vec<f64> = reference
            .triangles()
            .iter()
            .map(|t| {
                area += area_normal(t).length() * 0.5;
                area
            })
            .collect();
        let mut random = Random::new(options.seed);
        let mut unit = || f64::from(random.below(1 << 24)) / f64::from(1 << 24);
        let wanted = options.points_per_light * RUNS;
        let (mut points, mut tries) = (Vec::new(), 0usize);
        // A scene that alpha cuts away almost wholly gets fewer points.
        while area > 0.0 && points.len() < wanted && tries < 16 * wanted {
            tries += 1;
            // 24 bits alone would never reach small triangles of large scenes.
            let at = (unit() + unit() / f64::from(1 << 24)) * area;
            let index = areas.partition_point(|&a| a <= at).min(areas.len() - 1);
            let (mut b1, mut b2) = (unit(), unit());
            if b1 + b2 > 1.0 {
                (b1, b2) = (1.0 - b1, 1.0 - b2);
            }
            if reference.exists(index as u32, [b1, b2]) {
                let [a, b, c] = reference.triangles()[index];
                points.push((a + (b - a) * b1 + (c - a) * b2).as_vec3());
            }
        }
        let kept = points.len() as f64 / tries.max(1) as f64;
        let disc = area * kept / options.points_per_light.max(1) as f64;
        Self { options, points, point_radius: (disc / std::f64::consts::PI).sqrt() as f32 }
    }

    /// The map of light number `index` at `position`.
    fn map(&self, index: usize, position: Vec3, resolution: u32) -> Map {
        let mut map = Map::empty(resolution);
        let radius = self.point_radius * self.options.splat_scale;
        let count = self.options.points_per_light.min(self.points.len());
        // Runs of successive lights have little in common.
        let first = index.wrapping_mul(0x9e37_79b1) % self.points.len().max(1);
        for i in 0..count {
            map.splat(self.points[(first + i) % self.points.len()] - position, radius);
        }
        let similar = self.options.steepest * std::f32::consts::PI / resolution as f32;
        map.fill_holes(self.options.pull_levels, similar);
        map
    }

    fn is_hidden(&self, map: &Map, segment: &Segment) -> bool {
        let from_light = Vec3::from_array(segment.origin) - Vec3::from_array(segment.target);
        let distance = from_light.length();
        let direction = from_light / distance;
        // A texel's angle is 4 / resolution in the middle of a half and 2 / resolution at its rim. A receiver that is
        // seen at a flat angle spans more depth in one.
        let cosine = direction.dot(Vec3::from_array(segment.normal)).abs();
        let slope = if cosine > 0.0 { (1.0 / cosine).min(8.0) } else { 1.0 };
        let texel = distance * 2.0 * (1.0 + direction.x.abs()) / self.options.resolution as f32;
        distance - self.options.bias_texels * texel * slope > map.at(direction)
    }
}

impl Visibility for IsmVisibility {
    fn name(&self) -> &'static str {
        "ism"
    }

    fn occluded(&self, _: &[Segment], _: &mut [u8]) -> Result<(), VisibilityError> {
        Err(NO_SEGMENTS)
    }

    fn distances(&self, _: &[Segment], _: &mut [f32]) -> Result<(), VisibilityError> {
        Err(NO_SEGMENTS)
    }

    fn hidden_lights(
        &self,
        receivers: &[Receiver],
        lights: &[LightPoint],
        hidden: &mut [u32],
    ) -> Result<(), VisibilityError> {
        let words = light_words(lights.len());
        assert_eq!(hidden.len(), receivers.len() * words, "one bit for each receiver and light");
        check_positions("ism", lights)?;
        hidden.fill(0);
        if hidden.is_empty() || self.points.is_empty() {
            return Ok(());
        }
        for (number, run) in lights.chunks(LIGHTS_AT_ONCE).enumerate() {
            let first = number * LIGHTS_AT_ONCE;
            let map = |(i, light): (usize, &LightPoint)| {
                self.map(first + i, Vec3::from_array(light.offset), self.options.resolution)
            };
            let maps: Vec<Map> = run.par_iter().enumerate().map(map).collect();
            let of = (run.len(), |place: usize| first + place);
            parallel::hide_some(receivers, lights, of, hidden, |place, segment| {
                self.is_hidden(&maps[place], segment)
            });
        }
        Ok(())
    }
}

/// The maps, for those who gather light by them. Fields of view are not looked at: every map sees all around.
impl ViewRenderer for IsmVisibility {
    fn name(&self) -> &'static str {
        "ism"
    }

    fn render_passes(
        &self,
        views: &[View],
        settings: &ViewSettings,
        sink: &mut PassSink<'_>,
    ) -> Result<(), ViewError> {
        settings.check()?;
        if settings.with_colors {
            return Err(ViewError::Unsupported { method: "ism", problem: "has no colours; use `manylods`" });
        }
        let (map_bytes, budget_bytes) = (settings.map_bytes(), settings.budget_bytes);
        if map_bytes > budget_bytes {
            return Err(settings.over_budget("one map", map_bytes));
        }
        // While a run is drawn, its depths are there twice.
        let at_once = (budget_bytes / (map_bytes * 3)).clamp(1, 1 << 16) as usize;
        for (number, run) in views.chunks(at_once).enumerate() {
            let first = number * at_once;
            let map = |(i, view): (usize, &View)| match view.is_drawable() {
                true => self.map(first + i, Vec3::from_array(view.position), settings.resolution).depths,
                false => Map::empty(settings.resolution).depths,
            };
            let maps: Vec<Vec<f32>> = run.par_iter().enumerate().map(map).collect();
            let depths = match settings.half_depths {
                true => {
                    Depths::Half(maps.iter().flatten().map(|&depth| half::f16::from_f32(depth)).collect())
                }
                false => Depths::Full(maps.concat()),
            };
            let indices = (first as u32..(first + run.len()) as u32).collect();
            let centers = run.iter().map(|view| view.position).collect();
            let map_of = (0..run.len() as u32).collect();
            sink(ViewMaps::from_parts(settings.resolution, indices, map_of, centers, depths, Vec::new()))?;
        }
        Ok(())
    }
}

const NO_SEGMENTS: VisibilityError = VisibilityError::Unsupported { method: "ism", problem: SEGMENTS };

/// A dual paraboloid of distances from its middle, metres; +infinity where nothing is. The front half (x ≥ 0), then the
/// back half, row by row.
#[derive(Debug, Clone, PartialEq)]
struct Map {
    resolution: u32,
    depths: Vec<f32>,
}

/// Half (0: x ≥ 0), column and row of a unit direction, in −1 ..= 1.
fn paraboloid(direction: Vec3) -> (usize, f32, f32) {
    let half = usize::from(direction.x < 0.0);
    let scale = 1.0 / (1.0 + direction.x.abs());
    (half, direction.y * scale, direction.z * scale)
}

impl Map {
    fn empty(resolution: u32) -> Self {
        Self { resolution, depths: vec![f32::INFINITY; 2 * (resolution * resolution) as usize] }
    }

    /// The distance in a direction.
    fn at(&self, direction: Vec3) -> f32 {
        let (half, a, b) = paraboloid(direction);
        let n = self.resolution as f32;
        let texel = |c: f32| (((c + 1.0) * 0.5 * n) as usize).min(self.resolution as usize - 1);
        let n = self.resolution as usize;
        self.depths[(half * n + texel(b)) * n + texel(a)]
    }

    /// Draws a square that covers a disc of `radius` metres at `offset` from the middle.
    fn splat(&mut self, offset: Vec3, radius: f32) {
        let distance = offset.length();
        if distance == 0.0 || !distance.is_finite() {
            return;
        }
        let (half, a, b) = paraboloid(offset / distance);
        let n = self.resolution as f32;
        let (x, y) = ((a + 1.0) * 0.5 * n, (b + 1.0) * 0.5 * n);
        // Texels per radian: a quarter of the side in the middle, half of it at the rim.
        let texels_per_radian = n * 0.25 * (1.0 + a * a + b * b);
        let side = (radius / distance * texels_per_radian).min(MAX_SPLAT_TEXELS);
        let last = self.resolution as usize - 1;
        // Casts cut off at 0.
        let span = |c: f32| ((c - side + 0.5) as usize)..=((c + side - 0.5) as usize).min(last);
        let (columns, rows) = (span(x), span(y));
        // A splat smaller than a texel is in one.
        let middle = |c: f32| (c as usize).min(last);
        let n = self.resolution as usize;
        let mut keep = |column: usize, row: usize| {
            let depth = &mut self.depths[(half * n + row) * n + column];
            *depth = depth.min(distance);
        };
        keep(middle(x), middle(y));
        for row in rows {
            columns.clone().for_each(|column| keep(column, row));
        }
    }

    /// Pull-push: see the module. Depths that differ by at most a share of `similar` belong together, on the next level
    /// of twice that.
    fn fill_holes(&mut self, levels: u32, similar: f32) {
        let size = (self.resolution * self.resolution) as usize;
        for half in self.depths.chunks_mut(size) {
            let mut pyramid = vec![half.to_vec()];
            let mut side = self.resolution as usize;
            let mut reach = 1.0 + similar;
            while pyramid.len() <= levels as usize && side > 1 {
                let finer = &pyramid[pyramid.len() - 1];
                let coarse = (0..side * side / 4).map(|i| {
                    let (x, y) = (i % (side / 2) * 2, i / (side / 2) * 2);
                    let at = y * side + x;
                    let four = [finer[at], finer[at + 1], finer[at + side], finer[at + side + 1]];
                    let nearest = four.iter().copied().fold(f32::INFINITY, f32::min);
                    let (mut sum, mut count) = (0.0, 0.0);
                    for depth in four.into_iter().filter(|&d| d <= nearest * reach && d < f32::INFINITY) {
                        sum += depth;
                        count += 1.0;
                    }
                    if count > 0.0 { sum / count } else { f32::INFINITY }
                });
                let coarse = coarse.collect();
                pyramid.push(coarse);
                side /= 2;
                reach = 1.0 + (reach - 1.0) * 2.0;
            }
            while let Some(coarse) = pyramid.pop() {
                let Some(finer) = pyramid.last_mut() else {
                    half.copy_from_slice(&coarse);
                    break;
                };
                for (i, depth) in finer.iter_mut().enumerate() {
                    let (x, y) = (i % (2 * side), i / (2 * side));
                    let above = coarse[y / 2 * side + x / 2];
                    if *depth > above * reach {
                        *depth = above;
                    }
                }
                side *= 2;
                reach = 1.0 + (reach - 1.0) * 0.5;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texels_are_where_the_contract_says() {
        for (direction, half, column, row) in [
            (Vec3::X, 0, 8, 8),
            (Vec3::NEG_X, 1, 8, 8),
            (Vec3::new(0.0, 0.999, 0.0447), 0, 15, 8),
            (Vec3::new(-0.6, 0.0, -0.8), 1, 8, 4),
        ] {
            let mut map = Map::empty(16);
            map.splat(direction * 3.0, 0.0);
            let set: Vec<usize> = (0..512).filter(|&i| map.depths[i] < f32::INFINITY).collect();
            assert_eq!(set, [(half * 16 + row) * 16 + column], "{direction}");
            assert!((map.at(direction.normalize_or_zero()) - 3.0).abs() < 2e-3);
        }
    }

    #[test]
    fn the_nearest_point_counts_and_large_splats_cover_squares() {
        let mut map = Map::empty(64);
        map.splat(Vec3::X * 5.0, 0.1);
        map.splat(Vec3::X * 2.0, 0.1);
        map.splat(Vec3::X * 4.0, 0.1);
        assert_eq!(map.at(Vec3::X), 2.0);
        let mut map = Map::empty(64);
        map.splat(Vec3::X, 0.13);
        let set = map.depths.iter().filter(|d| d.is_finite()).count();
        assert!((9..=25).contains(&set), "0.13 rad are two texels to each side: {set}");
        map.splat(Vec3::ZERO, 1.0);
        map.splat(Vec3::NAN, 1.0);
    }

    #[test]
    fn holes_are_filled_and_far_surfaces_kept_apart() {
        // A wall at 2 m with holes, some of which show another at 9 m; nothing on the right.
        let mut map = Map::empty(8);
        for (i, depth) in map.depths.iter_mut().take(64).enumerate().filter(|(i, _)| i % 8 < 4) {
            *depth = [2.0, f32::INFINITY, 2.1, 9.0][(i * 7 + i / 8 * 3) % 4];
        }
        map.fill_holes(2, 0.1);
        for y in 0..8 {
            for x in 0..8 {
                let depth = map.depths[y * 8 + x];
                assert_eq!(depth < 2.2, x < 4, "{x} {y}: {depth}");
            }
        }
        assert!(map.depths[64..].iter().all(|d| *d == f32::INFINITY));
    }
}
