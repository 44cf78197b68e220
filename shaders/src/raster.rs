//! Which voxels a triangle covers, decided in integers.
//!
//! # Theory
//! \[WMP\] Algorithm 1 and the scene octree of \[MV\] both voxelize by rendering the triangles orthographically along the
//! three grid axes and keeping every depth layer. A fragment exists where a pixel centre lies in the projected
//! triangle (top-left rule on shared edges); its voxel is the floor of the plane's depth there.
//!
//! # Differences from the papers
//! The papers leave coverage to the GPU's rasterizer and depth to floats, so that results differ between machines.
//! Here vertices are snapped to a lattice of [`LATTICE_BITS`] bits per axis, edge functions are integers that fit
//! 32 bits, and depth is an exact integer division. Depth peeling, one pass with atomic OR, compute shaders and this
//! code then give the same voxels bit for bit, on every machine.
//!
//! # Practice
//! [`Grid`] says how many voxels and sub-voxel steps there are, [`Raster::new`] sets one triangle up along one axis,
//! [`Raster::fragments`] visits its fragments within a clip box. [`fragments_basic`] is the slow, obvious version.
//!
//! `raster.wgsl` follows this file's arithmetic with 32-bit integers.

/// Lattice coordinates lie in `0 ..= LATTICE_MAX`, so that an edge function of two 15-bit differences fits an `i32`.
pub const LATTICE_BITS: u32 = 15;
/// Largest lattice coordinate.
pub const LATTICE_MAX: i32 = (1 << LATTICE_BITS) - 1;
/// One, in the fixed point of [`Fragment::barycentric`].
pub const BARYCENTRIC_ONE: u32 = 1 << 15;

/// A cubic grid of `2^bits` voxels a side, each divided into `2^sub_bits` lattice steps a side.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    /// log2 of voxels a side, 1 ..= 13.
    pub bits: u32,
    /// log2 of lattice steps per voxel, 1 ..= 8.
    pub sub_bits: u32,
}

impl Grid {
    /// The grid of `2^bits` voxels a side with the finest lattice (at most 256 steps per voxel) that 32-bit edge
    /// functions allow.
    ///
    /// # Panics
    /// If `bits` is not in 1 ..= 13 (below 4 lattice steps per voxel, snapping would show).
    pub fn new(bits: u32) -> Self {
        assert!((1..=13).contains(&bits), "a grid has 1 to 13 bits, not {bits}");
        Self { bits, sub_bits: (LATTICE_BITS - bits).min(8) }
    }

    /// Voxels a side.
    pub fn size(self) -> u32 {
        1 << self.bits
    }

    /// Lattice steps a side; every valid lattice coordinate is below it.
    pub fn lattice_size(self) -> i32 {
        1 << (self.bits + self.sub_bits)
    }

    /// The nearest lattice coordinate to `voxels` (a position in units of voxels), clamped to the grid.
    /// Ties go up; NaN goes to 0.
    pub fn snap(self, voxels: f64) -> i32 {
        let steps = (voxels * f64::from(1u32 << self.sub_bits) + 0.5).floor();
        // `as` saturates and turns NaN into 0.
        (steps as i32).clamp(0, self.lattice_size() - 1)
    }
}

/// A box of voxels: `min` inclusive, `max` exclusive, in voxels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VoxelBox {
    /// Smallest voxel.
    pub min: [i32; 3],
    /// One past the largest voxel.
    pub max: [i32; 3],
}

impl VoxelBox {
    /// The whole grid.
    pub fn whole(grid: Grid) -> Self {
        Self { min: [0; 3], max: [grid.size() as i32; 3] }
    }

    /// Whether `voxel` is inside.
    pub fn contains(&self, voxel: [i32; 3]) -> bool {
        (0..3).all(|i| self.min[i] <= voxel[i] && voxel[i] < self.max[i])
    }
}

/// One sample of a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Fragment {
    /// The voxel it falls in.
    pub voxel: [i32; 3],
    /// Weights of the triangle's second and third vertex, of [`BARYCENTRIC_ONE`]; rounded down, so that their sum
    /// never exceeds one.
    pub barycentric: [u32; 2],
}

/// One triangle set up for one projection axis.
///
/// With `x = (axis + 1) % 3`, `y = (axis + 2) % 3`, `z = axis`, a pixel is the column of voxels with equal x and y.
#[derive(Debug, Clone, Copy)]
pub struct Raster {
    axis: usize,
    sub_bits: u32,
    /// Edge i lies opposite vertex i: value at the pixel (0, 0)'s centre, and steps per pixel in x and y. Inside is
    /// where all are ≥ 0 after `bias` is added.
    edge: [i64; 3],
    edge_dx: [i64; 3],
    edge_dy: [i64; 3],
    bias: [i64; 3],
    /// Twice the projected area, > 0.
    area: i64,
    /// Depth numerator at pixel (0, 0)'s centre and its steps; the voxel is its floor over `area << sub_bits`.
    depth: i64,
    depth_dx: i64,
    depth_dy: i64,
    /// Pixels whose centres lie in the bounding rectangle, inclusive.
    pixel_min: [i32; 2],
    pixel_max: [i32; 2],
    /// Whether vertices 1 and 2 were exchanged to make the area positive.
    swapped: bool,
}

impl Raster {
    /// Sets up a triangle of lattice coordinates for projection along `axis` (0, 1, 2), or `None` if it has no
    /// projected area or no pixel centre in its bounds.
    #[inline]
    pub fn new(grid: Grid, triangle: &[[i32; 3]; 3], axis: usize) -> Option<Self> {
        let (x, y, z) = ((axis + 1) % 3, (axis + 2) % 3, axis);
        let s = grid.sub_bits;
        let half = 1i32 << (s - 1);
        let step = 1i32 << s;
        let [a, mut b, mut c] = [0, 1, 2].map(|i| [triangle[i][x], triangle[i][y], triangle[i][z]]);
        let mut pixel_min = [0; 2];
        let mut pixel_max = [0; 2];
        for i in 0..2 {
            let lo = a[i].min(b[i]).min(c[i]);
            let hi = a[i].max(b[i]).max(c[i]);
            pixel_min[i] = (lo - half + step - 1) >> s;
            pixel_max[i] = (hi - half) >> s;
            if pixel_min[i] > pixel_max[i] {
                return None;
            }
        }
        let cross = |p: [i32; 3], q: [i32; 3], r: [i32; 3]| {
            i64::from(q[0] - p[0]) * i64::from(r[1] - p[1]) - i64::from(q[1] - p[1]) * i64::from(r[0] - p[0])
        };
        let mut area = cross(a, b, c);
        if area == 0 {
            return None;
        }
        let swapped = area < 0;
        if swapped {
            std::mem::swap(&mut b, &mut c);
            area = -area;
        }
        let mut edge = [0; 3];
        let mut edge_dx = [0; 3];
        let mut edge_dy = [0; 3];
        let mut bias = [0; 3];
        for (i, (p, q)) in [(b, c), (c, a), (a, b)].into_iter().enumerate() {
            let (dx, dy) = (i64::from(q[0] - p[0]), i64::from(q[1] - p[1]));
            edge[i] = dx * i64::from(half - p[1]) - dy * i64::from(half - p[0]);
            edge_dx[i] = -(dy << s);
            edge_dy[i] = dx << s;
            // Top-left rule, rows downwards: a left edge or a top edge owns the centres on it.
            bias[i] = if dy < 0 || (dy == 0 && dx > 0) { 0 } else { -1 };
        }
        let d = |p: [i32; 3], q: [i32; 3], i: usize| i64::from(q[i] - p[i]);
        let plane_x = d(a, b, 2) * d(a, c, 1) - d(a, c, 2) * d(a, b, 1);
        let plane_y = d(a, b, 0) * d(a, c, 2) - d(a, c, 0) * d(a, b, 2);
        let depth =
            i64::from(a[2]) * area + plane_x * i64::from(half - a[0]) + plane_y * i64::from(half - a[1]);
        Some(Self {
            axis,
            sub_bits: s,
            edge,
            edge_dx,
            edge_dy,
            bias,
            area,
            depth,
            depth_dx: plane_x << s,
            depth_dy: plane_y << s,
            pixel_min,
            pixel_max,
            swapped,
        })
    }

    /// Smallest and largest pixel (inclusive; largest < smallest if there is none) that [`Self::fragments`] looks at.
    pub fn pixels(&self, clip: &VoxelBox) -> [[i32; 2]; 2] {
        let (x, y) = ((self.axis + 1) % 3, (self.axis + 2) % 3);
        [
            [self.pixel_min[0].max(clip.min[x]), self.pixel_min[1].max(clip.min[y])],
            [self.pixel_max[0].min(clip.max[x] - 1), self.pixel_max[1].min(clip.max[y] - 1)],
        ]
    }

    /// Visits every fragment inside `clip`, row by row.
    #[inline]
    pub fn fragments(&self, clip: &VoxelBox, mut visit: impl FnMut(Fragment)) {
        let shift = barycentric_shift(self.area);
        let scaled_area = (self.area >> shift) as u32;
        self.spans(clip, |voxel, edges| {
            let [mut e1, mut e2] = [edges[1], edges[2]];
            if self.swapped {
                std::mem::swap(&mut e1, &mut e2);
            }
            // e <= area < 2^31, so that the shifted quotient fits 32 bits: the same arithmetic runs in WGSL.
            let weight = |e: i64| (((e >> shift) as u32) << 15) / scaled_area;
            visit(Fragment { voxel, barycentric: [weight(e1), weight(e2)] });
        });
    }

    /// Visits every covered voxel inside `clip`, without barycentric weights.
    #[inline]
    pub fn voxels(&self, clip: &VoxelBox, mut visit: impl FnMut([i32; 3])) {
        self.spans(clip, |voxel, _| visit(voxel));
    }

    #[inline]
    fn spans(&self, clip: &VoxelBox, mut visit: impl FnMut([i32; 3], [i64; 3])) {
        let (x, y, z) = ((self.axis + 1) % 3, (self.axis + 2) % 3, self.axis);
        let x_min = self.pixel_min[0].max(clip.min[x]);
        let x_max = self.pixel_max[0].min(clip.max[x] - 1);
        let y_min = self.pixel_min[1].max(clip.min[y]);
        let y_max = self.pixel_max[1].min(clip.max[y] - 1);
        if x_min > x_max {
            return;
        }
        let (z_min, z_max) = (i64::from(clip.min[z]), i64::from(clip.max[z]));
        let denominator = self.area << self.sub_bits;
        // Depth advances along x by a whole number of voxels and a remainder: no division per pixel.
        let depth_step = self.depth_dx.div_euclid(denominator);
        let depth_step_rest = self.depth_dx.rem_euclid(denominator);
        for py in y_min..=y_max {
            let row = i64::from(py);
            let (mut first, mut last) = (i64::from(x_min), i64::from(x_max));
            let mut row_edge = [0i64; 3];
            for i in 0..3 {
                row_edge[i] = self.edge[i] + row * self.edge_dy[i];
                // edge + bias + px * dx >= 0
                let at_zero = row_edge[i] + self.bias[i];
                let dx = self.edge_dx[i];
                if dx > 0 {
                    first = first.max(div_ceil(-at_zero, dx));
                } else if dx < 0 {
                    last = last.min(at_zero.div_euclid(-dx));
                } else if at_zero < 0 {
                    last = i64::MIN;
                }
            }
            if first > last {
                continue;
            }
            let numerator = self.depth + row * self.depth_dy + first * self.depth_dx;
            let mut depth = numerator.div_euclid(denominator);
            let mut rest = numerator.rem_euclid(denominator);
            for px in first..=last {
                if z_min <= depth && depth < z_max {
                    let mut voxel = [0; 3];
                    voxel[x] = px as i32;
                    voxel[y] = py;
                    voxel[z] = depth as i32;
                    visit(voxel, [0, 1, 2].map(|i| row_edge[i] + px * self.edge_dx[i]));
                }
                depth += depth_step;
                rest += depth_step_rest;
                if rest >= denominator {
                    rest -= denominator;
                    depth += 1;
                }
            }
        }
    }
}

/// Right shift that brings an edge value of a triangle with twice the area `area` to 16 bits.
#[inline]
fn barycentric_shift(area: i64) -> u32 {
    (64 - area.leading_zeros()).saturating_sub(16)
}

#[inline]
fn div_ceil(numerator: i64, denominator: i64) -> i64 {
    -((-numerator).div_euclid(denominator))
}

/// The slow, obvious version of [`Raster::fragments`] over all three axes: every pixel of the clip box, every edge by
/// its definition, one division per depth. For tests.
pub fn fragments_basic(grid: Grid, triangle: &[[i32; 3]; 3], clip: &VoxelBox) -> Vec<Fragment> {
    let mut fragments = Vec::new();
    let (step, half) = (1i64 << grid.sub_bits, 1i64 << (grid.sub_bits - 1));
    for axis in 0..3 {
        let (x, y, z) = ((axis + 1) % 3, (axis + 2) % 3, axis);
        let v = triangle.map(|p| [i64::from(p[x]), i64::from(p[y]), i64::from(p[z])]);
        let cross = |p: [i64; 2], q: [i64; 2], r: [i64; 2]| {
            (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
        };
        let xy = |i: usize| [v[i][0], v[i][1]];
        let area = cross(xy(0), xy(1), xy(2));
        if area == 0 {
            continue;
        }
        for py in clip.min[y]..clip.max[y] {
            for px in clip.min[x]..clip.max[x] {
                let p = [i64::from(px) * step + half, i64::from(py) * step + half];
                let mut weights = [0; 3];
                let mut inside = true;
                for (i, weight) in weights.iter_mut().enumerate() {
                    let (from, to) = ((i + 1) % 3, (i + 2) % 3);
                    // Walk each edge so that the inside is on its positive side.
                    let (from, to) = if area > 0 { (from, to) } else { (to, from) };
                    *weight = cross(xy(from), xy(to), p);
                    let (dx, dy) = (v[to][0] - v[from][0], v[to][1] - v[from][1]);
                    let owns_border = dy < 0 || (dy == 0 && dx > 0);
                    inside &= *weight > 0 || (*weight == 0 && owns_border);
                }
                if !inside {
                    continue;
                }
                let depth_numerator: i64 = (0..3).map(|i| weights[i] * v[i][2]).sum();
                let depth = depth_numerator.div_euclid(area.abs() * step) as i32;
                let mut voxel = [0; 3];
                (voxel[x], voxel[y], voxel[z]) = (px, py, depth);
                if clip.contains(voxel) {
                    let shift = barycentric_shift(area.abs());
                    let weight = |w: i64| (((w >> shift) << 15) / (area.abs() >> shift)) as u32;
                    fragments.push(Fragment { voxel, barycentric: [weight(weights[1]), weight(weights[2])] });
                }
            }
        }
    }
    fragments
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn fragments(grid: Grid, triangle: &[[i32; 3]; 3], clip: &VoxelBox) -> Vec<Fragment> {
        let mut all = Vec::new();
        for axis in 0..3 {
            if let Some(raster) = Raster::new(grid, triangle, axis) {
                raster.fragments(clip, |f| all.push(f));
            }
        }
        all
    }

    #[test]
    fn an_axis_aligned_square_fills_exactly_its_pixels_once() {
        let grid = Grid::new(4);
        let s = 1 << grid.sub_bits;
        // Square [2, 6) x [3, 8) voxels at z = 5.5 voxels, as two triangles sharing a diagonal.
        let p = |x: i32, y: i32| [x * s, y * s, 5 * s + s / 2];
        let clip = VoxelBox::whole(grid);
        let mut all = fragments(grid, &[p(2, 3), p(6, 3), p(6, 8)], &clip);
        all.extend(fragments(grid, &[p(2, 3), p(6, 8), p(2, 8)], &clip));
        let mut voxels: Vec<_> = all.iter().map(|f| f.voxel).collect();
        voxels.sort_unstable();
        let mut expected: Vec<_> = (2..6).flat_map(|x| (3..8).map(move |y| [x, y, 5])).collect();
        expected.sort_unstable();
        assert_eq!(voxels, expected, "each pixel centre belongs to exactly one of the two triangles");
    }

    #[test]
    fn a_degenerate_triangle_has_no_fragments() {
        let grid = Grid::new(7);
        let clip = VoxelBox::whole(grid);
        assert!(fragments(grid, &[[5, 5, 5]; 3], &clip).is_empty());
        assert!(fragments(grid, &[[0, 0, 0], [1000, 2000, 3000], [2000, 4000, 6000]], &clip).is_empty());
    }

    #[test]
    fn snapping_clamps_and_survives_nan() {
        let grid = Grid::new(7);
        assert_eq!(grid.snap(f64::NAN), 0);
        assert_eq!(grid.snap(-3.0), 0);
        assert_eq!(grid.snap(1e300), LATTICE_MAX);
        assert_eq!(grid.snap(1.0), 256);
    }

    proptest! {
        #[test]
        fn fast_and_basic_agree(
            bits in 1u32..=5,
            raw in prop::array::uniform3(prop::array::uniform3(0i32..=LATTICE_MAX)),
            lo in prop::array::uniform3(0i32..16), size in prop::array::uniform3(1i32..32),
        ) {
            let grid = Grid::new(bits);
            let triangle = raw.map(|v| v.map(|c| c & (grid.lattice_size() - 1)));
            let n = grid.size() as i32;
            let clip = VoxelBox {
                min: lo.map(|c| c.min(n - 1)),
                max: [0, 1, 2].map(|i| (lo[i].min(n - 1) + size[i]).min(n)),
            };
            let mut fast = fragments(grid, &triangle, &clip);
            let mut basic = fragments_basic(grid, &triangle, &clip);
            fast.sort_unstable();
            basic.sort_unstable();
            prop_assert_eq!(&fast, &basic);
            for f in fast {
                prop_assert!(f.barycentric[0] + f.barycentric[1] <= BARYCENTRIC_ONE);
            }
        }

        #[test]
        fn large_grids_stay_in_range(raw in prop::array::uniform3(prop::array::uniform3(0i32..=LATTICE_MAX))) {
            let grid = Grid::new(11);
            let corner = raw[0].map(|c| c >> grid.sub_bits);
            let clip = VoxelBox { min: corner, max: corner.map(|c| c + 8) };
            let mut fast = fragments(grid, &raw, &clip);
            let mut basic = fragments_basic(grid, &raw, &clip);
            fast.sort_unstable();
            basic.sort_unstable();
            prop_assert_eq!(fast, basic);
        }
    }
}
