//! Points into the rows of a direction, fast, on one thread: what `rotate_points` does on a GPU.
//!
//! # Practice
//! The arithmetic of a batch of points is one loop, which the compiler vectorizes; setting their bits is another. The
//! points of a batch are far apart ([`SpreadPoints`]): setting bits of one word again and again would wait for the
//! store before each time.

use crate::directions::{DirectionFrame, ROW_RAW_BITS};

/// Points whose bits are found together before they are set.
const BATCH: usize = 512;
/// Points next to each other in time are as far apart in the order they came in.
const STRIDE: usize = 64;

/// Points of the row lattice, coordinate by coordinate and spread, as the kernel reads them.
#[derive(Debug, Clone, Default)]
pub struct SpreadPoints {
    x: Vec<i16>,
    y: Vec<i16>,
    z: Vec<i16>,
}

impl SpreadPoints {
    /// Takes points in any order; neighbours in space next to each other are best.
    pub fn new(points: &[[i16; 3]]) -> Self {
        let mut spread = Self::default();
        spread.assign(points.len(), |index| points[index]);
        spread
    }

    /// Takes `count` other points, in the same memory.
    ///
    /// Blocks of 4,096 points are transposed: what is next to each other in time is 64 apart, still close in memory.
    pub fn assign(&mut self, count: usize, point: impl Fn(usize) -> [i16; 3]) {
        for coordinates in [&mut self.x, &mut self.y, &mut self.z] {
            coordinates.clear();
            coordinates.reserve(count);
        }
        for block in (0..count).step_by(STRIDE * STRIDE) {
            let end = count.min(block + STRIDE * STRIDE);
            for start in block..end.min(block + STRIDE) {
                for index in (start..end).step_by(STRIDE) {
                    let [x, y, z] = point(index);
                    self.x.push(x);
                    self.y.push(y);
                    self.z.push(z);
                }
            }
        }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }
}

/// Sets the bit of every point in a direction's rows ([`DirectionFrame::voxel`]; layout of `rows.bits`,
/// [`crate::sections`]). Other bits are left.
///
/// # Panics
/// If `rows` is shorter than a direction's rows of `2^bits` voxels a side.
pub fn rotate_points(frame: &DirectionFrame, bits: u32, points: &SpreadPoints, rows: &mut [u32]) {
    assert!(rows.len() >= 1 << (3 * bits - 5), "a direction of {bits} bits has more rows");
    #[cfg(target_arch = "x86_64")]
    {
        if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("bmi2") {
            #[target_feature(enable = "avx2,bmi2")]
            fn with_avx2(frame: &DirectionFrame, bits: u32, points: &SpreadPoints, rows: &mut [u32]) {
                rotate_points_portable(frame, bits, points, rows);
            }
            #[allow(unsafe_code, reason = "calling a function compiled for AVX2 and BMI2")]
            // SAFETY: both were detected just above. Tested: `every_kernel_sets_the_same_bits`.
            unsafe {
                with_avx2(frame, bits, points, rows);
            }
            return;
        }
    }
    rotate_points_portable(frame, bits, points, rows);
}

#[inline(always)]
fn rotate_points_portable(frame: &DirectionFrame, bits: u32, points: &SpreadPoints, rows: &mut [u32]) {
    let shift = ROW_RAW_BITS - bits;
    let m = frame.row_from_lattice;
    let mut found = [0u32; BATCH];
    for ((x, y), z) in points.x.chunks(BATCH).zip(points.y.chunks(BATCH)).zip(points.z.chunks(BATCH)) {
        let n = x.len().min(BATCH);
        let (x, y, z) = (&x[..n], &y[..n], &z[..n]);
        // Arithmetic and memory apart: the first loop is vectorized, eight points at a time.
        for i in 0..n {
            let p = [i32::from(x[i]), i32::from(y[i]), i32::from(z[i])];
            let voxel = |a: usize| {
                let raw = m[a][0] * p[0] + m[a][1] * p[1] + m[a][2] * p[2] + frame.offset[a];
                raw.clamp(0, (1 << ROW_RAW_BITS) - 1) as u32 >> shift
            };
            found[i] = (voxel(1) << bits | voxel(0)) << bits | voxel(2);
        }
        for &bit in &found[..n] {
            rows[(bit >> 5) as usize] |= 1 << (bit & 31);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::directions::{DirectionSet, Fit, RowLattice};

    fn points(count: usize) -> Vec<[i16; 3]> {
        let mut state = 99u32;
        let mut coordinate = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((state >> 16) as i32 % 32_769 - 16_384) as i16
        };
        (0..count).map(|_| [coordinate(), coordinate(), coordinate()]).collect()
    }

    #[test]
    fn every_kernel_sets_the_same_bits() {
        let lattice = RowLattice::new([-3.0, 0.0, -5.0], [3.0, 4.0, 5.0]);
        let set = DirectionSet::LatLong { thetas: 4, phis: 5 };
        // Miri takes milliseconds a point.
        let counts: &[usize] = if cfg!(miri) { &[0, 1, 65] } else { &[0, 1, 63, 64, 65, 4096, 4097, 9000] };
        for &count in counts {
            let points = points(count);
            let spread = SpreadPoints::new(&points);
            assert_eq!((spread.len(), spread.is_empty()), (count, count == 0));
            for direction in [0, 3, 11, 19] {
                let frame = DirectionFrame::new(set.frame(direction), &lattice, Fit::Cube, [[0.0; 2]; 3]);
                let (mut fast, mut portable, mut plain) = ([0; 1024], [0; 1024], [0u32; 1024]);
                rotate_points(&frame, 5, &spread, &mut fast);
                rotate_points_portable(&frame, 5, &spread, &mut portable);
                for &p in &points {
                    let [u, v, w] = frame.voxel(p, 5);
                    plain[(v * 32 + u) as usize] |= 1 << w;
                }
                assert!(fast == plain && portable == plain, "{count} points, direction {direction}");
            }
        }
    }
}
