//! What differs between two sets of points, and rows made from older rows by it.

use crate::bake::BakeError;
use crate::rows::RowsPlan;
use manyview_cache::archive::CompressedChunk;
use manyview_shaders::directions::{DirectionFrame, ROW_RAW_BITS};
use manyview_shaders::sections::RowsInfo;

/// Where more than one in so many points differs, all rows are made anew.
const MOST_CHANGED: usize = 4;
/// Points of a cluster: neighbours, whose box tells whether any of them matters to some rows.
const CLUSTER: usize = 64;
/// Tiles a side of a direction's rows: a bit for each in a `u64` tells which have rows that change.
const TILE_BITS: u32 = 3;

/// What is different between an old set of points and a new one.
pub(crate) struct Change {
    /// Points that only one of them has.
    points: Vec<[i16; 3]>,
    clusters: Clusters,
}

/// Boxes around runs of the new points, coordinate by coordinate.
#[derive(Default)]
struct Clusters {
    min: [Vec<i16>; 3],
    max: [Vec<i16>; 3],
}

impl Change {
    /// Compares two sets of points, both in Morton order of cells; `None` if they have little in common.
    pub(crate) fn between(old: &[[i16; 3]], new: &[[i16; 3]]) -> Option<Self> {
        let sorted = |points: &[[i16; 3]]| {
            let mut sorted = points.to_vec();
            sorted.sort_unstable();
            sorted
        };
        let (old, sorted_new) = (sorted(old), sorted(new));
        let mut points = Vec::new();
        let (mut a, mut b) = (old.iter().peekable(), sorted_new.iter().peekable());
        loop {
            match (a.peek(), b.peek()) {
                (Some(x), Some(y)) if x == y => {
                    a.next();
                    b.next();
                }
                (Some(x), Some(y)) => points.extend(if x < y { a.next() } else { b.next() }),
                (Some(_), None) => points.extend(a.next()),
                (None, Some(_)) => points.extend(b.next()),
                (None, None) => break,
            }
        }
        if points.len() * MOST_CHANGED > new.len() {
            return None;
        }
        let mut clusters = Clusters::default();
        for cluster in new.chunks(CLUSTER) {
            for i in 0..3 {
                let coordinates = cluster.iter().map(|p| p[i]);
                let bounds =
                    coordinates.fold((i16::MAX, i16::MIN), |(lo, hi), c| (lo.min(c), hi.max(c)));
                clusters.min[i].push(bounds.0);
                clusters.max[i].push(bounds.1);
            }
        }
        Some(Self { points, clusters })
    }

    /// The rows of the new points in `frames`, from the old points' rows in `old_frames`.
    pub(crate) fn patch(
        &self,
        plan: &RowsPlan<'_>,
        frames: &[DirectionFrame],
        old_frames: &[DirectionFrame],
        old: &CompressedChunk,
    ) -> Result<CompressedChunk, BakeError> {
        let info = plan.info();
        let words = info.direction_bytes() / 4;
        let mut rows = vec![0u32; words * frames.len()];
        old.content_into_zeros(bytemuck::cast_slice_mut(&mut rows))?;
        let mut scratch = Scratch::new(&info);
        for ((frame, old_frame), rows) in frames.iter().zip(old_frames).zip(rows.chunks_exact_mut(words)) {
            if frame == old_frame {
                self.patch_direction(plan, frame, &info, &mut scratch, rows);
            } else {
                rows.copy_from_slice(&plan.block(std::slice::from_ref(frame)));
            }
        }
        Ok(RowsPlan::compress(&rows))
    }

    fn patch_direction(
        &self,
        plan: &RowsPlan<'_>,
        frame: &DirectionFrame,
        info: &RowsInfo,
        scratch: &mut Scratch,
        rows: &mut [u32],
    ) {
        let bits = info.bits;
        let row_words = 1usize << (bits - 5);
        let tile_shift = bits - TILE_BITS;
        let row_of = |u: u32, v: u32| (v << bits | u) as usize;
        scratch.touched.fill(0);
        let mut tiles = 0u64;
        for &point in &self.points {
            let [u, v, _] = frame.voxel(point, bits);
            let row = row_of(u, v);
            let (word, bit) = (row / 64, 1u64 << (row % 64));
            if scratch.touched[word] & bit == 0 {
                scratch.touched[word] |= bit;
                tiles |= 1 << ((v >> tile_shift) << TILE_BITS | (u >> tile_shift));
                rows[row * row_words..(row + 1) * row_words].fill(0);
            }
        }
        self.clusters.find(frame, tiles, scratch);
        let points = plan.points();
        for &cluster in &scratch.found {
            let start = cluster as usize * CLUSTER;
            for &point in &points[start..points.len().min(start + CLUSTER)] {
                let [u, v, w] = frame.voxel(point, bits);
                let row = row_of(u, v);
                if scratch.touched[row / 64] >> (row % 64) & 1 == 1 {
                    rows[row * row_words + (w >> 5) as usize] |= 1 << (w & 31);
                }
            }
        }
    }
}

/// Memory of one thread's work.
struct Scratch {
    /// A bit for each row.
    touched: Vec<u64>,
    /// Tile bounds of the clusters: smallest u, largest u, smallest v, largest v.
    bounds: [Vec<u8>; 4],
    /// Clusters that may have points in touched rows.
    found: Vec<u32>,
}

impl Scratch {
    fn new(info: &RowsInfo) -> Self {
        Self { touched: vec![0; 1 << (2 * info.bits - 6)], bounds: Default::default(), found: Vec::new() }
    }
}

impl Clusters {
    /// Finds the clusters whose boxes reach into the given tiles of a direction.
    fn find(&self, frame: &DirectionFrame, tiles: u64, scratch: &mut Scratch) {
        let shift = ROW_RAW_BITS - TILE_BITS;
        for axis in 0..2 {
            let m = frame.row_from_lattice[axis];
            for is_max in [false, true] {
                // The corner of the box that is least (most) along the axis.
                let corner = [0, 1, 2].map(|i| if (m[i] < 0) ^ is_max { &self.max[i] } else { &self.min[i] });
                let out = &mut scratch.bounds[axis * 2 + usize::from(is_max)];
                out.clear();
                out.extend(corner[0].iter().zip(corner[1]).zip(corner[2]).map(|((&x, &y), &z)| {
                    let raw = m[0] * i32::from(x) + m[1] * i32::from(y) + m[2] * i32::from(z)
                        + frame.offset[axis];
                    (raw.clamp(0, (1 << ROW_RAW_BITS) - 1) >> shift) as u8
                }));
            }
        }
        let [u_min, u_max, v_min, v_max] = &scratch.bounds;
        scratch.found.clear();
        for cluster in 0..u_min.len() {
            let columns = (2u64 << u_max[cluster]) - (1 << u_min[cluster]);
            let is_hit =
                (v_min[cluster]..=v_max[cluster]).any(|v| tiles >> (u32::from(v) << TILE_BITS) & columns != 0);
            if is_hit {
                scratch.found.push(cluster as u32);
            }
        }
    }
}
