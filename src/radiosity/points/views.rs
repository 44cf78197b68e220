//! Which surface points of a picture get a view, and how all other pixels take part.
//!
//! # Theory
//! Irradiance varies slowly over a surface, so that a few points of it tell that of all others (G. Ward et al., *A Ray Tracing
//! Solution for Diffuse Interreflection*, SIGGRAPH 1988). Here points are no closer to each other than a distance that
//! counts pixels, turns of the normal, and steps off the surface; the distance is lowered until there are as many as
//! wanted. Pixels then take the mean of those around them by the same distance (a cross-bilateral interpolation).

use crate::render::gbuffer::{GBuffer, Pixel};
use glam::Vec3;
use rayon::prelude::*;

/// By how much the distance is lowered at a time.
const LOWER: f32 = 0.75;
/// A difference of unit normals of this length is as far as the distance.
const TURN: f32 = 0.5;
/// A step off the surface by as many pixels' widths is as far as a pixel on it.
const STEP: f32 = 2.0;
/// Views count up to so many distances away. Every pixel has one within 1, if there are not too few for that; else it takes
/// the nearest.
const REACH: f32 = 2.0;

/// Points of a picture that have views.
#[derive(Debug, Clone, PartialEq)]
pub struct Places {
    /// Indices of pixels; no two are the same.
    pub pixels: Vec<u32>,
    /// Within how many pixels of one of them every pixel is, or what counts as that.
    distance: f32,
    /// Width of a pixel, metres per metre of distance.
    spread: f32,
}

impl Places {
    /// At most `count` well-spread pixels with surfaces, all of them if they are no more. Pixels are `spread` metres wide per
    /// metre of distance.
    pub fn choose(gbuffer: &GBuffer, count: usize, spread: f64) -> Self {
        let mut places = Self { pixels: Vec::new(), distance: 0.0, spread: spread as f32 };
        let order = shuffled(gbuffer);
        if order.len() <= count {
            places.pixels = order;
            places.pixels.sort_unstable();
            return places;
        }
        // What would do for a flat picture, and then some.
        let mut distance = 2.0 * (order.len() as f32 / count.max(1) as f32).sqrt().max(1.0);
        let mut is_chosen = vec![false; gbuffer.pixels.len()];
        loop {
            let mut buckets = Buckets::new(gbuffer, distance);
            places.pixels.iter().for_each(|&pixel| buckets.add(pixel));
            let mut complete = true;
            for &pixel in &order {
                let at = &gbuffer.pixels[pixel as usize];
                let is_near = |&other: &u32| places.far(gbuffer, pixel, other, at, distance) < 1.0;
                if is_chosen[pixel as usize] || buckets.around(pixel, 1).any(is_near) {
                    continue;
                }
                if places.pixels.len() == count {
                    complete = false;
                    break;
                }
                is_chosen[pixel as usize] = true;
                places.pixels.push(pixel);
                buckets.add(pixel);
            }
            // Of the first distance there may be too many already: then it was too small.
            if complete {
                places.distance = distance;
                if places.pixels.len() == count {
                    break;
                }
                distance *= LOWER;
            } else if places.distance > 0.0 {
                break;
            } else if distance > (gbuffer.width + gbuffer.height) as f32 {
                // Fewer than there are ways that surfaces face.
                places.distance = distance;
                break;
            } else {
                places.pixels.drain(..).for_each(|pixel| is_chosen[pixel as usize] = false);
                distance /= LOWER * LOWER;
            }
        }
        places.pixels.sort_unstable();
        places
    }

    /// How far pixel `b` is from pixel `a`, whose surface is `at`, in multiples of `distance`: the square of it.
    #[inline]
    fn far(&self, gbuffer: &GBuffer, a: u32, b: u32, at: &Pixel, distance: f32) -> f32 {
        let other = &gbuffer.pixels[b as usize];
        let width = gbuffer.width;
        let across = [(a % width) as f32 - (b % width) as f32, (a / width) as f32 - (b / width) as f32];
        let turn = (Vec3::from(at.normal) - Vec3::from(other.normal)).length_squared();
        let offset = Vec3::from(other.position) - Vec3::from(at.position);
        let off = Vec3::from(at.normal).dot(offset).abs().max(Vec3::from(other.normal).dot(offset).abs());
        let pixel_metres = (at.depth.max(other.depth) * self.spread).max(f32::MIN_POSITIVE);
        let off = off / (pixel_metres * STEP);
        (across[0] * across[0] + across[1] * across[1] + off * off) / (distance * distance)
            + turn / (TURN * TURN)
    }

    /// Irradiances of all pixels from those of the places, in the order of [`Places::pixels`]; 0 where there is no surface.
    ///
    /// # Panics
    /// If there is not one for each place.
    pub fn interpolate(&self, gbuffer: &GBuffer, irradiance: &[Vec3]) -> Vec<[f32; 3]> {
        assert_eq!(self.pixels.len(), irradiance.len(), "an irradiance for each place");
        let mut all = vec![[0.0; 3]; gbuffer.pixels.len()];
        // Every pixel has its own.
        if self.distance == 0.0 {
            self.pixels
                .iter()
                .zip(irradiance)
                .for_each(|(&pixel, light)| all[pixel as usize] = light.to_array());
            return all;
        }
        let mut buckets = Buckets::new(gbuffer, self.distance * REACH);
        let places: Vec<u32> = (0..self.pixels.len() as u32).collect();
        places.iter().for_each(|&place| buckets.add_at(self.pixels[place as usize], place));
        all.par_iter_mut().enumerate().for_each(|(index, light)| {
            let at = &gbuffer.pixels[index];
            if !at.is_surface() {
                return;
            }
            let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
            for &place in buckets.around(index as u32, 1) {
                let pixel = self.pixels[place as usize];
                let far = self.far(gbuffer, index as u32, pixel, at, self.distance).sqrt() / REACH;
                if far < 1.0 {
                    let weight = (1.0 - far) * (1.0 - far);
                    sum += irradiance[place as usize] * weight;
                    weights += weight;
                }
            }
            if weights > 0.0 {
                *light = (sum / weights).to_array();
                return;
            }
            let far = |place: usize| self.far(gbuffer, index as u32, self.pixels[place], at, self.distance);
            let nearest = (0..self.pixels.len()).min_by(|&a, &b| far(a).total_cmp(&far(b)));
            *light = nearest.map_or([0.0; 3], |place| irradiance[place].to_array());
        });
        all
    }
}

/// Pixels by squares of the picture.
struct Buckets {
    side: u32,
    columns: u32,
    width: u32,
    lists: Vec<Vec<u32>>,
}

impl Buckets {
    /// Squares of at least `side` pixels a side.
    fn new(gbuffer: &GBuffer, side: f32) -> Self {
        let side = (side.ceil() as u32).clamp(1, gbuffer.width.max(gbuffer.height).max(1));
        let [columns, rows] = [gbuffer.width, gbuffer.height].map(|pixels| pixels.div_ceil(side));
        Self {
            side,
            columns,
            width: gbuffer.width,
            lists: vec![Vec::new(); columns as usize * rows as usize],
        }
    }

    fn add(&mut self, pixel: u32) {
        self.add_at(pixel, pixel);
    }

    fn add_at(&mut self, pixel: u32, what: u32) {
        let [column, row] = self.square(pixel);
        self.lists[(row * self.columns + column) as usize].push(what);
    }

    fn square(&self, pixel: u32) -> [u32; 2] {
        [pixel % self.width / self.side, pixel / self.width / self.side]
    }

    /// What is in a pixel's square and those up to `reach` squares away.
    fn around(&self, pixel: u32, reach: u32) -> impl Iterator<Item = &u32> {
        let [column, row] = self.square(pixel);
        let rows = self.lists.len() as u32 / self.columns;
        let columns = column.saturating_sub(reach)..(column + reach + 1).min(self.columns);
        let rows = row.saturating_sub(reach)..(row + reach + 1).min(rows);
        rows.flat_map(move |row| columns.clone().map(move |column| row * self.columns + column))
            .flat_map(|square| &self.lists[square as usize])
    }
}

/// Pixels with surfaces in an order in which any run is spread over the picture.
fn shuffled(gbuffer: &GBuffer) -> Vec<u32> {
    let surfaces = (0u32..).zip(&gbuffer.pixels).filter(|(_, pixel)| pixel.is_surface());
    let mut keyed: Vec<(u64, u32)> =
        surfaces.map(|(index, _)| (crate::bench::Random::new(u64::from(index)).bits(), index)).collect();
    keyed.par_sort_unstable();
    keyed.into_iter().map(|(_, index)| index).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A floor on the left, a far wall in the middle, a near one on the right, and a column of nothing.
    fn gbuffer() -> GBuffer {
        let (width, height) = (96, 64);
        let pixels = (0..width * height).map(|i| {
            let (x, y) = ((i % width) as f32, (i / width) as f32);
            let (position, normal, depth) = match i % width {
                0..30 => ([x * 0.01, 0.0, y * 0.01], [0.0, 1.0, 0.0], 1.0),
                30..60 => ([x * 0.02, y * 0.02, -2.0], [0.0, 0.0, 1.0], 2.0),
                60..62 => return Pixel::EMPTY,
                _ => ([x * 0.01, y * 0.01, -1.0], [0.0, 0.0, 1.0], 1.0),
            };
            Pixel { position, geometric_normal: normal, normal, depth, triangle: 0, ..Pixel::EMPTY }
        });
        GBuffer { width, height, pixels: pixels.collect() }
    }

    #[test]
    fn places_are_as_many_as_wanted_and_reach_every_surface() {
        let gbuffer = gbuffer();
        for count in [1, 2, 50, 600, 5000] {
            let places = Places::choose(&gbuffer, count, 0.01);
            // The last distance may leave no more places than there are.
            assert!(places.pixels.len() <= count && places.pixels.len() * 10 >= count * 9, "{count}");
            assert!(places.pixels.windows(2).all(|pair| pair[0] < pair[1]));
            let light = places.interpolate(&gbuffer, &vec![Vec3::new(1.0, 2.0, 3.0); places.pixels.len()]);
            let (mut reached, mut surfaces) = (0, 0);
            for (pixel, light) in gbuffer.pixels.iter().zip(&light) {
                let expected = if pixel.is_surface() { [1.0, 2.0, 3.0] } else { [0.0; 3] };
                surfaces += 1;
                reached += u32::from((Vec3::from(*light) - Vec3::from(expected)).length() < 1e-5);
            }
            assert_eq!(reached, surfaces, "{count}");
        }
        let all = Places::choose(&gbuffer, 1_000_000, 0.01);
        assert_eq!(all.pixels.len(), gbuffer.surface_count());
        assert_eq!(
            Places::choose(&GBuffer { pixels: Vec::new(), width: 0, height: 0 }, 5, 0.01).pixels.len(),
            0
        );
    }

    #[test]
    fn light_does_not_cross_from_surface_to_surface() {
        let gbuffer = gbuffer();
        let places = Places::choose(&gbuffer, 300, 0.01);
        let surface = |pixel: u32| match pixel % gbuffer.width {
            0..30 => 1.0,
            30..60 => 2.0,
            _ => 3.0,
        };
        let light: Vec<Vec3> = places.pixels.iter().map(|&pixel| Vec3::splat(surface(pixel))).collect();
        for (pixel, light) in (0u32..).zip(places.interpolate(&gbuffer, &light)) {
            if gbuffer.pixels[pixel as usize].is_surface() {
                assert!((light[0] - surface(pixel)).abs() < 1e-5, "{pixel}: {light:?}");
            }
        }
    }

    #[test]
    fn light_is_smooth_along_a_surface() {
        let gbuffer = gbuffer();
        let places = Places::choose(&gbuffer, 600, 0.01);
        let of = |pixel: u32| Vec3::splat((pixel / gbuffer.width) as f32);
        let light: Vec<Vec3> = places.pixels.iter().map(|&pixel| of(pixel)).collect();
        let all = places.interpolate(&gbuffer, &light);
        for (pixel, light) in
            (0u32..).zip(all).filter(|(pixel, _)| gbuffer.pixels[*pixel as usize].is_surface())
        {
            assert!((light[0] - of(pixel).x).abs() < 3.0, "{pixel}: {light:?}");
        }
    }
}
