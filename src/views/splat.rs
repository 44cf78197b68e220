//! Drawing scene nodes into a map: points, and leaves that fill more than a texel.
//!
//! # Theory
//! \[MV\] §3.3 draws a node that fills less than a texel as one point. A leaf near a view fills many texels; the paper
//! splats it into the level of a mip pyramid whose texels are as large, and pushes that level down afterwards.
//!
//! # Differences from the paper
//! Near leaves are drawn as what they are ([`Canvas::leaf`]): every texel whose middle ray meets the leaf's cube gets
//! the distance at which it enters. The circles of latitude and longitude of a stereographic map are circles again, so that the
//! texels to try follow from the leaf's sphere in closed form. Leaves share the map's area between them, so that their texels
//! together are a few times the map's, however near the view is to a surface.

use manyview_shaders::paraboloid::{is_inside, texel, texel_count, texel_direction};
use manyview_shaders::scene_tree::SPHERE_OF_CUBE;
use std::ops::Range;

/// Below this sum of cosines a leaf's sphere reaches so far around a half's pole that the whole half is tried.
const WHOLE_HALF: f32 = 1e-3;

/// Directions of the middles of all texels of a map, and their reciprocals.
#[derive(Debug, Clone, PartialEq)]
pub struct TexelDirections {
    resolution: u32,
    /// x, y, z of all texels.
    directions: [Vec<f32>; 3],
    inverses: [Vec<f32>; 3],
    /// For each row of a half the first column whose middle lies in the disc, and the one behind the last.
    spans: Vec<[u32; 2]>,
}

impl TexelDirections {
    /// Those of maps of this resolution.
    pub fn new(resolution: u32) -> Self {
        let count = texel_count(resolution) as u32;
        let axis = |i: usize| (0..count).map(|t| texel_direction(t, resolution)[i]).collect::<Vec<f32>>();
        let directions = [axis(0), axis(1), axis(2)];
        // No middle lies on an axis' plane: they are odd multiples of half a texel from the middle, and no such two squares
        // add up to that of the radius.
        let inverses = [0, 1, 2].map(|i: usize| directions[i].iter().map(|d| 1.0 / d).collect());
        let spans = (0..resolution)
            .map(|row| {
                let inside = |column: &u32| is_inside(row * resolution + column, resolution);
                let first = (0..resolution).find(inside).unwrap_or(0);
                [first, resolution - first]
            })
            .collect();
        Self { resolution, directions, inverses, spans }
    }

    /// Texels a side of each half.
    pub fn resolution(&self) -> u32 {
        self.resolution
    }

    /// Direction of a texel's middle.
    pub fn direction(&self, texel: usize) -> [f32; 3] {
        [0, 1, 2].map(|i| self.directions[i][texel])
    }

    /// Takes what a parent's map shows into a child's: a texel keeps the smaller of its own distance and the parent's
    /// corrected for the way from the parent's middle to the child's, which is `offset` (child − parent). \[MV\] §3.4,
    /// "Fusion"; where both have a distance, the paper takes the child's.
    #[inline(always)]
    pub fn fuse(&self, child: &mut [f32], parent: &[f32], offset: [f32; 3]) {
        let count = child.len();
        let [x, y, z] = [0, 1, 2].map(|i| &self.directions[i][..count]);
        let parent = &parent[..count];
        for t in 0..count {
            let moved = moved_depth([x[t], y[t], z[t]], parent[t], offset);
            child[t] = if moved < child[t] { moved } else { child[t] };
        }
    }
}

/// The distance from a child's middle of what its parent's map shows at `depth` in this direction; `offset` leads from the
/// parent's middle to the child's. +infinity, or no number, where the parent shows nothing.
#[inline(always)]
pub(crate) fn moved_depth(direction: [f32; 3], depth: f32, offset: [f32; 3]) -> f32 {
    let [x, y, z] = [0, 1, 2].map(|i| direction[i] * depth - offset[i]);
    (x * x + y * y + z * z).sqrt()
}

/// A map that is drawn into: distances, and unless empty the number of the node that each is of.
#[derive(Debug)]
pub struct Canvas<'a> {
    /// Directions of its texels.
    pub texels: &'a TexelDirections,
    /// Distances, +infinity where nothing is.
    pub depths: &'a mut [f32],
    /// For each texel the number of what is nearest there; of equally near ones the smallest.
    pub nodes: &'a mut [u32],
}

impl Canvas<'_> {
    #[inline(always)]
    fn keep(&mut self, texel: usize, depth: f32, node: u32) {
        let kept = &mut self.depths[texel];
        if self.nodes.is_empty() {
            *kept = if depth < *kept { depth } else { *kept };
        } else if depth < *kept || depth == *kept && node < self.nodes[texel] {
            *kept = depth;
            self.nodes[texel] = node;
        }
    }

    /// Draws a point at `offset` from the middle; nothing if it is the middle.
    #[inline(always)]
    pub fn point(&mut self, offset: [f32; 3], node: u32) {
        let length = (offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]).sqrt();
        if length > 0.0 {
            self.keep(texel(offset, length, self.texels.resolution) as usize, length, node);
        }
    }

    /// [`Canvas::point`] for the first `count` of many: `offsets` by axis.
    #[inline(always)]
    pub fn points<const N: usize>(&mut self, offsets: &[[f32; N]; 3], nodes: &[u32; N], count: usize) {
        let resolution = self.texels.resolution;
        let half_side = resolution as f32 * 0.5;
        let [x, y, z] = offsets;
        let (mut lengths, mut texels) = ([0.0; N], [0u32; N]);
        for i in 0..N {
            // As in paraboloid::project and texel; of what is nothing the texel is the last one.
            let length = (x[i] * x[i] + y[i] * y[i] + z[i] * z[i]).sqrt();
            let scale = 1.0 / (length + x[i].abs());
            let column = (((y[i] * scale + 1.0) * half_side) as i32).min(resolution as i32 - 1);
            let row = (((z[i] * scale + 1.0) * half_side) as i32).min(resolution as i32 - 1);
            let half = if x[i] < 0.0 { resolution } else { 0 };
            texels[i] = (half + row as u32) * resolution + column as u32;
            lengths[i] = if length > 0.0 { length } else { f32::INFINITY };
        }
        for i in 0..count.min(N) {
            self.keep(texels[i] as usize, lengths[i], nodes[i]);
        }
    }

    /// Draws a cube of an edge, metres, whose middle is at `offset` and which does not hold the middle of the map: the
    /// texel of its middle gets the middle's distance, every texel whose middle ray meets it the distance where it enters.
    #[inline(always)]
    pub fn leaf(&mut self, offset: [f32; 3], edge: f32, node: u32) {
        let half_edge = edge * 0.5;
        let length = (offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]).sqrt();
        if length.is_nan() || length <= 0.0 {
            return;
        }
        self.point(offset, node);
        let low = offset.map(|c| c - half_edge);
        let high = offset.map(|c| c + half_edge);
        let resolution = self.texels.resolution;
        for half in 0..2 {
            let Some([columns, rows]) = candidates(half, offset, length, edge, resolution) else { continue };
            for row in rows[0]..rows[1] {
                let [first, end] = self.texels.spans[row as usize];
                let start = ((half * resolution + row) * resolution) as usize;
                let (first, end) = (columns[0].max(first) as usize, columns[1].min(end) as usize);
                if first < end {
                    self.leaf_row(start + first..start + end, low, high, node);
                }
            }
        }
    }

    /// Texels of a row whose middle rays meet a box.
    #[inline(always)]
    fn leaf_row(&mut self, row: Range<usize>, low: [f32; 3], high: [f32; 3], node: u32) {
        let inverses = [0, 1, 2].map(|i: usize| &self.texels.inverses[i][row.clone()]);
        let enter = |t: usize| {
            let (mut enter, mut exit) = (f32::NEG_INFINITY, f32::INFINITY);
            for i in 0..3 {
                let (a, b) = (low[i] * inverses[i][t], high[i] * inverses[i][t]);
                enter = larger(enter, smaller(a, b));
                exit = smaller(exit, larger(a, b));
            }
            if enter <= exit && enter > 0.0 { enter } else { f32::INFINITY }
        };
        if self.nodes.is_empty() {
            let depths = &mut self.depths[row];
            for t in 0..depths.len() {
                depths[t] = smaller(enter(t), depths[t]);
            }
        } else {
            for t in 0..row.len() {
                let depth = enter(t);
                if depth < f32::INFINITY {
                    self.keep(row.start + t, depth, node);
                }
            }
        }
    }
}

/// One instruction where `f32::min`, which heeds NaNs, is several.
#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// See [`smaller`].
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Columns and rows (first, and one behind the last) of a half whose texels' middles the sphere around a cube may cover.
#[inline]
pub(crate) fn candidates(
    half: u32,
    offset: [f32; 3],
    length: f32,
    edge: f32,
    resolution: u32,
) -> Option<[[u32; 2]; 2]> {
    let radius = edge * SPHERE_OF_CUBE;
    let whole = Some([[0, resolution]; 2]);
    if length <= radius {
        return whole;
    }
    let cos_middle = if half == 0 { offset[0] } else { -offset[0] } / length;
    let sin_beta = radius / length;
    let sum = cos_middle + (1.0 - sin_beta * sin_beta).sqrt();
    if sum <= WHOLE_HALF {
        // Its nearest edge may still be behind the rim.
        return (cos_middle + sin_beta >= 0.0).then_some([[0, resolution]; 2]);
    }
    let scale = 1.0 / sum;
    let (reach, half_side) = (sin_beta * scale, resolution as f32 * 0.5);
    let range = |c: f32| {
        let middle = c / length * scale + 1.0;
        let first = ((middle - reach) * half_side - 0.5).ceil().max(0.0);
        let last = ((middle + reach) * half_side - 0.5).floor().min(resolution as f32 - 1.0);
        (first <= last).then(|| [first as u32, last as u32 + 1])
    };
    Some([range(offset[1])?, range(offset[2])?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use manyview_shaders::cases::Random;

    fn meets(direction: [f32; 3], offset: [f32; 3], edge: f32) -> Option<f64> {
        let (mut enter, mut exit) = (0.0f64, f64::INFINITY);
        for i in 0..3 {
            let [a, b] = [-0.5, 0.5].map(|s| f64::from(offset[i] + s * edge) / f64::from(direction[i]));
            enter = enter.max(a.min(b));
            exit = exit.min(a.max(b));
        }
        (enter <= exit).then_some(enter)
    }

    #[test]
    fn a_leaf_fills_what_rays_meet() {
        let mut random = Random::new(3);
        for resolution in [8, 16, 64] {
            let texels = TexelDirections::new(resolution);
            let count = texel_count(resolution);
            let mut drawn = 0;
            for _ in 0..500 {
                let offset = [0; 3].map(|_| random.range(-4000, 4000) as f32 / 1000.0);
                if offset.iter().all(|c| c.abs() < 0.51) {
                    continue;
                }
                let mut depths = vec![f32::INFINITY; count];
                let mut nodes = vec![u32::MAX; count];
                Canvas { texels: &texels, depths: &mut depths, nodes: &mut nodes }.leaf(offset, 1.0, 7);
                let length = (offset.iter().map(|c| c * c).sum::<f32>()).sqrt();
                let middle = texel(offset, length, resolution) as usize;
                for t in 0..count {
                    let hit =
                        meets(texels.direction(t), offset, 1.0).filter(|_| is_inside(t as u32, resolution));
                    drawn += usize::from(hit.is_some());
                    assert_eq!(nodes[t] == 7, depths[t] < f32::INFINITY);
                    match hit {
                        _ if t == middle => assert!(depths[t] <= length),
                        Some(distance) => {
                            let edge = (f64::from(depths[t]) - distance).abs();
                            assert!(edge < 1e-4, "{offset:?} {t} {distance} {}", depths[t]);
                        }
                        None => assert_eq!(depths[t], f32::INFINITY, "{offset:?} {t}"),
                    }
                }
            }
            assert!(drawn > 500, "{drawn}");
        }
    }

    #[test]
    fn points_keep_the_nearest_and_of_equals_the_smallest() {
        let texels = TexelDirections::new(8);
        let (mut depths, mut nodes) = (vec![f32::INFINITY; 128], vec![u32::MAX; 128]);
        let mut canvas = Canvas { texels: &texels, depths: &mut depths, nodes: &mut nodes };
        canvas.point([5.0, 0.0, 0.0], 1);
        canvas.point([2.0, 0.0, 0.0], 9);
        canvas.point([2.0, 0.0, 0.0], 4);
        canvas.point([3.0, 0.0, 0.0], 0);
        canvas.point([0.0; 3], 0);
        let at = 4 * 8 + 4;
        assert_eq!((depths[at], nodes[at]), (2.0, 4));
        assert_eq!(depths.iter().filter(|d| d.is_finite()).count(), 1);
    }

    #[test]
    fn fusion_moves_points_and_keeps_the_nearer() {
        let texels = TexelDirections::new(16);
        let parent: Vec<f32> = (0..512).map(|t| if t < 300 { 10.0 } else { f32::INFINITY }).collect();
        let mut child = vec![f32::INFINITY; 512];
        child[0] = 1.0;
        let offset = [0.5, -0.25, 1.0];
        texels.fuse(&mut child, &parent, offset);
        assert_eq!(child[0], 1.0);
        for (t, &depth) in child.iter().enumerate().skip(1) {
            let d = texels.direction(t);
            let exact = [0, 1, 2].map(|i| d[i] * 10.0 - offset[i]).iter().map(|c| c * c).sum::<f32>().sqrt();
            assert_eq!(depth, if t < 300 { exact } else { f32::INFINITY });
        }
    }

    #[test]
    fn no_middle_of_a_texel_has_a_zero_coordinate() {
        for resolution in [8, 16, 32, 64, 128, 256, 512, 1024] {
            let texels = TexelDirections::new(resolution);
            assert!(texels.inverses.iter().flatten().all(|c| c.is_finite()), "{resolution}");
        }
    }
}
