//! What differs between two sets of points, and rows made from older rows by it.

use crate::bake::BakeError;
use crate::points_step::{PointCell, PointCells};
use crate::rows::RowsPlan;
use manyview_cache::archive::{CompressedChunk, TILE_BYTES, TileEditor};
use manyview_shaders::directions::{DirectionFrame, ROW_RAW_BITS};
use std::ops::Range;

/// Where more than one in so many points differs, all rows are made anew.
const MOST_CHANGED: usize = 4;
/// Points of a cluster: neighbours, whose box tells whether any of them matters to some rows.
const CLUSTER: usize = 64;
/// Clusters of a group, whose box is asked first.
const GROUP: usize = 16;
/// log2 of squares a side of a direction's rows. What changes in each is taken together as a rectangle.
const SQUARE_BITS: u32 = 3;

/// What is different between an old set of points and a new one.
pub(crate) struct Change {
    /// Points that only one of them has.
    points: Vec<[i16; 3]>,
    clusters: Boxes,
    groups: Boxes,
}

/// Boxes, coordinate by coordinate.
#[derive(Default)]
struct Boxes {
    min: [Vec<i16>; 3],
    max: [Vec<i16>; 3],
}

impl Boxes {
    /// Around so many successive points each.
    fn around(points: &[[i16; 3]], size: usize) -> Self {
        let mut boxes = Self::default();
        for points in points.chunks(size) {
            for i in 0..3 {
                let coordinates = points.iter().map(|p| p[i]);
                boxes.min[i].push(coordinates.clone().min().unwrap_or(0));
                boxes.max[i].push(coordinates.max().unwrap_or(0));
            }
        }
        boxes
    }

    fn len(&self) -> usize {
        self.min[0].len()
    }

    /// Appends those of some boxes that reach into any of the given rectangles of rows.
    fn find(&self, frame: &RowFrame, rectangles: &[Rectangle], range: Range<usize>, found: &mut Vec<u32>) {
        for index in range {
            // The corners of the box that are least and most along an axis.
            let row = |axis: usize, is_max: bool| {
                let m = frame.matrix[axis];
                let corner = |i: usize| {
                    let corners = if (m[i] < 0) ^ is_max { &self.max[i] } else { &self.min[i] };
                    m[i] * i32::from(corners[index])
                };
                frame.row(frame.offset[axis] + corner(0) + corner(1) + corner(2))
            };
            let (u_min, u_max) = (row(0, false), row(0, true));
            if !rectangles.iter().any(|r| r.u[0] <= u_max && u_min <= r.u[1]) {
                continue;
            }
            let (v_min, v_max) = (row(1, false), row(1, true));
            let is_hit =
                |r: &Rectangle| r.u[0] <= u_max && u_min <= r.u[1] && r.v[0] <= v_max && v_min <= r.v[1];
            if rectangles.iter().any(is_hit) {
                found.push(index as u32);
            }
        }
    }
}

/// Rows within a square that change: their least and largest u and v.
#[derive(Clone, Copy)]
struct Rectangle {
    u: [u32; 2],
    v: [u32; 2],
}

/// A direction's frame, ready for many points. As [`DirectionFrame::voxel`].
struct RowFrame {
    matrix: [[i32; 3]; 3],
    offset: [i32; 3],
    shift: u32,
}

impl RowFrame {
    fn new(frame: &DirectionFrame, bits: u32) -> Self {
        Self { matrix: frame.row_from_lattice, offset: frame.offset, shift: ROW_RAW_BITS - bits }
    }

    /// The voxel of a raw coordinate.
    #[inline(always)]
    fn row(&self, raw: i32) -> u32 {
        raw.clamp(0, (1 << ROW_RAW_BITS) - 1) as u32 >> self.shift
    }

    /// The voxel of a point along an axis.
    #[inline(always)]
    fn along(&self, axis: usize, [x, y, z]: [i16; 3]) -> u32 {
        let m = &self.matrix[axis];
        let raw = m[0] * i32::from(x) + m[1] * i32::from(y) + m[2] * i32::from(z) + self.offset[axis];
        self.row(raw)
    }
}

impl Change {
    /// Compares two sets of points; `None` if they have little in common. Cells that were made from the same are not
    /// looked at.
    pub(crate) fn between(old: &PointCells, new: &PointCells) -> Option<Self> {
        let mut points = Vec::new();
        let (mut a, mut b) = (old.ranges().peekable(), new.ranges().peekable());
        loop {
            let code =
                |cell: Option<&(&PointCell, Range<usize>)>| cell.map_or(u32::MAX, |(cell, _)| cell.code);
            let first = code(a.peek()).min(code(b.peek()));
            if first == u32::MAX {
                break;
            }
            let of_old = a.next_if(|(cell, _)| cell.code == first);
            let of_new = b.next_if(|(cell, _)| cell.code == first);
            let is_same = |a: &PointCell, b: &PointCell| a.digest == b.digest;
            if of_old.as_ref().zip(of_new.as_ref()).is_some_and(|((a, _), (b, _))| is_same(a, b)) {
                continue;
            }
            let sorted = |cells: &PointCells, range: Option<Range<usize>>| {
                let mut points = range.map_or(Vec::new(), |range| cells.points[range].to_vec());
                points.sort_unstable();
                points
            };
            let of_old = sorted(old, of_old.map(|(_, range)| range));
            let of_new = sorted(new, of_new.map(|(_, range)| range));
            points.extend(only_in_one(&of_old, &of_new));
        }
        if points.len() * MOST_CHANGED > new.points.len() {
            return None;
        }
        let clusters = Boxes::around(&new.points, CLUSTER);
        let groups = Boxes::around(&new.points, CLUSTER * GROUP);
        Some(Self { points, clusters, groups })
    }

    /// The rows of the new points in `frames`, from the old points' rows in `old_frames`.
    pub(crate) fn patch(
        &self,
        plan: &RowsPlan<'_>,
        frames: &[DirectionFrame],
        old_frames: &[DirectionFrame],
        old: &CompressedChunk,
    ) -> Result<CompressedChunk, BakeError> {
        let anew = || plan.compress(&plan.block(frames));
        let words = plan.info().direction_bytes() / 4;
        if old.raw_bytes() as usize != words * 4 * frames.len() {
            return Ok(anew());
        }
        let Some(mut editor) = TileEditor::new(old)? else { return Ok(anew()) };
        let mut patch = Patch::new(self, plan);
        // Several directions in a tile, or several tiles in a direction.
        let together = (TILE_BYTES / (words * 4)).max(1);
        let tiles_of = |start: usize, count: usize| {
            start * words * 4 / TILE_BYTES..((start + count) * words * 4).div_ceil(TILE_BYTES)
        };
        for (number, (frames, old_frames)) in
            frames.chunks(together).zip(old_frames.chunks(together)).enumerate()
        {
            let tiles = tiles_of(number * together, frames.len());
            patch.directions(&mut editor, tiles, frames, old_frames)?;
        }
        Ok(editor.finish().unwrap_or_else(anew))
    }
}

/// What only one of two sorted lists has.
fn only_in_one(old: &[[i16; 3]], new: &[[i16; 3]]) -> Vec<[i16; 3]> {
    let mut only = Vec::new();
    let (mut a, mut b) = (old.iter().peekable(), new.iter().peekable());
    loop {
        match (a.peek(), b.peek()) {
            (Some(x), Some(y)) if x == y => {
                a.next();
                b.next();
            }
            (Some(x), Some(y)) => only.extend(if x < y { a.next() } else { b.next() }),
            (Some(_), None) => only.extend(a.next()),
            (None, Some(_)) => only.extend(b.next()),
            (None, None) => return only,
        }
    }
}

/// One thread's work on a block.
struct Patch<'a> {
    change: &'a Change,
    plan: &'a RowsPlan<'a>,
    bits: u32,
    /// Rows of some directions, of which the tiles that change are filled in.
    rows: Vec<u32>,
    /// A bit for each row of a direction.
    touched: Vec<u64>,
    /// Touched rows, in the order they were met.
    list: Vec<u32>,
    /// What touched rows span in each square that has some.
    rectangles: Vec<Rectangle>,
    groups: Vec<u32>,
    clusters: Vec<u32>,
}

impl<'a> Patch<'a> {
    fn new(change: &'a Change, plan: &'a RowsPlan<'a>) -> Self {
        let bits = plan.info().bits;
        let touched = vec![0; 1 << (2 * bits - 6)];
        let (rows, list, groups, clusters) = Default::default();
        Self { change, plan, bits, rows, touched, list, rectangles: Vec::new(), groups, clusters }
    }

    /// Changes the directions that share some tiles.
    fn directions(
        &mut self,
        editor: &mut TileEditor<'_>,
        tiles: Range<usize>,
        frames: &[DirectionFrame],
        old_frames: &[DirectionFrame],
    ) -> Result<(), BakeError> {
        let words = self.plan.info().direction_bytes() / 4;
        let tile_words = TILE_BYTES / 4;
        let row_words = 1usize << (self.bits - 5);
        let mut rows = std::mem::take(&mut self.rows);
        rows.resize(words * frames.len(), 0);
        let mut is_read = vec![false; tiles.len()];
        let mut read = |tile: usize, rows: &mut [u32]| {
            if std::mem::replace(&mut is_read[tile], true) {
                return Ok(());
            }
            let end = rows.len().min((tile + 1) * tile_words);
            // From the directions before.
            rows[tile * tile_words..end].fill(0);
            editor.read(tiles.start + tile, bytemuck::cast_slice_mut(&mut rows[tile * tile_words..end]))
        };
        for (number, (frame, old_frame)) in frames.iter().zip(old_frames).enumerate() {
            let start = number * words;
            if frame != old_frame {
                // All tiles are read first, since others may share them.
                for tile in start / tile_words..(start + words).div_ceil(tile_words) {
                    read(tile, &mut rows)?;
                }
                rows[start..start + words].copy_from_slice(&self.plan.block(std::slice::from_ref(frame)));
                continue;
            }
            let frame = RowFrame::new(frame, self.bits);
            self.touch(&frame);
            for &row in &self.list {
                let at = start + row as usize * row_words;
                read(at / tile_words, &mut rows)?;
                rows[at..at + row_words].fill(0);
            }
            self.fill(&frame, &mut rows[start..start + words]);
        }
        for (tile, _) in is_read.iter().enumerate().filter(|(_, is_read)| **is_read) {
            let end = rows.len().min((tile + 1) * tile_words);
            let content = bytemuck::cast_slice(&rows[tile * tile_words..end]);
            editor.replace(tiles.start + tile, content);
        }
        self.rows = rows;
        Ok(())
    }

    /// Notes the rows that a point has come to or gone from.
    fn touch(&mut self, frame: &RowFrame) {
        let shift = self.bits - SQUARE_BITS;
        self.touched.fill(0);
        self.list.clear();
        let mut squares: [Option<Rectangle>; 1 << (2 * SQUARE_BITS)] = [None; _];
        for &point in &self.change.points {
            let (u, v) = (frame.along(0, point), frame.along(1, point));
            let row = v << self.bits | u;
            let (word, bit) = ((row / 64) as usize, 1u64 << (row % 64));
            if self.touched[word] & bit == 0 {
                self.touched[word] |= bit;
                self.list.push(row);
                let square = &mut squares[((v >> shift) << SQUARE_BITS | (u >> shift)) as usize];
                let r = square.get_or_insert(Rectangle { u: [u; 2], v: [v; 2] });
                r.u = [r.u[0].min(u), r.u[1].max(u)];
                r.v = [r.v[0].min(v), r.v[1].max(v)];
            }
        }
        self.rectangles.clear();
        self.rectangles.extend(squares.into_iter().flatten());
    }

    /// Sets the bits of all points in touched rows.
    fn fill(&mut self, frame: &RowFrame, rows: &mut [u32]) {
        let change = self.change;
        let (groups, clusters) = (&mut self.groups, &mut self.clusters);
        groups.clear();
        change.groups.find(frame, &self.rectangles, 0..change.groups.len(), groups);
        clusters.clear();
        for &group in groups.iter() {
            let start = group as usize * GROUP;
            let end = change.clusters.len().min(start + GROUP);
            change.clusters.find(frame, &self.rectangles, start..end, clusters);
        }
        let row_words = 1usize << (self.bits - 5);
        let points = self.plan.points();
        for &cluster in clusters.iter() {
            let start = cluster as usize * CLUSTER;
            for &point in &points[start..points.len().min(start + CLUSTER)] {
                let row = (frame.along(1, point) << self.bits | frame.along(0, point)) as usize;
                if self.touched[row / 64] >> (row % 64) & 1 == 1 {
                    let w = frame.along(2, point);
                    rows[row * row_words + (w >> 5) as usize] |= 1 << (w & 31);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::coarse_boxes;
    use crate::rows::{RowsFrom, RowsOptions};
    use crate::rows_frames::fit_frames;
    use crate::triangles::{Cutouts, LatticeTriangles};
    use manyview_cache::digest::Digest;
    use manyview_shaders::directions::{DirectionSet, Fit, RowLattice};
    use proptest::prelude::*;

    /// Points in cells of their own, in the order of their codes.
    fn points(seed: u32, count: usize) -> Vec<[i16; 3]> {
        let mut state = seed;
        let mut coordinate = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((state >> 16) as i32 % 32_769 - 16_384) as i16
        };
        let mut points: Vec<_> = (0..count).map(|_| [coordinate(), coordinate(), coordinate()]).collect();
        points.sort_unstable_by_key(|p| crate::octree::morton(crate::points::cell_code(*p, 8)));
        points
    }

    /// The points by coarse cells; a cell's identity is that of its points.
    fn cells(points: &[[i16; 3]]) -> PointCells {
        let code = |p: &[i16; 3]| crate::octree::morton(crate::points::cell_code(*p, 4));
        let cell = |points: &[[i16; 3]]| PointCell {
            code: code(&points[0]),
            count: points.len() as u32,
            digest: Digest::of(bytemuck::cast_slice(points)),
        };
        let cells = points.chunk_by(|a, b| code(a) == code(b)).map(cell).collect();
        PointCells { cells, points: points.to_vec() }
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

        #[test]
        fn changed_rows_are_the_rows_of_the_new_points(
            bits in 5u32..8, seed: u32, gone in 0usize..60, moved in 0usize..40, by in -4000i16..4000,
        ) {
            let old = points(seed, 3000);
            let mut new = old.clone();
            new.drain(..gone);
            for point in new.iter_mut().rev().take(moved) {
                *point = point.map(|c| c.saturating_add(by).clamp(-16_384, 16_384));
            }
            new.sort_unstable_by_key(|p| crate::octree::morton(crate::points::cell_code(*p, 8)));
            let directions = DirectionSet::LatLong { thetas: 5, phis: 3 };
            let options = RowsOptions { bits, directions, fit: Fit::Extent, from: RowsFrom::Points };
            let lattice = RowLattice::new([-3.0, 0.0, -5.0], [3.0, 4.0, 5.0]);
            let (triangles, cutouts) = (LatticeTriangles::default(), Cutouts::default());
            let plan = |points: &[[i16; 3]]| {
                let frames = fit_frames(options, &lattice, &coarse_boxes(points));
                RowsPlan::with_frames(options, lattice, &triangles, &cutouts, points.to_vec().into(), frames)
            };
            let (old_plan, new_plan) = (plan(&old), plan(&new));
            let old_chunk = old_plan.compress(&old_plan.block(&old_plan.frames));
            let change = Change::between(&cells(&old), &cells(&new)).expect("most is the same");
            let patched = change.patch(&new_plan, &new_plan.frames, &old_plan.frames, &old_chunk).unwrap();
            prop_assert!(patched == new_plan.compress(&new_plan.block(&new_plan.frames)));
        }
    }

    #[test]
    fn sets_with_little_in_common_are_not_patched() {
        let [a, b] = [1, 2].map(|seed| cells(&points(seed, 1000)));
        assert!(Change::between(&a, &b).is_none());
        assert_eq!(Change::between(&a, &a).map(|c| c.points.len()), Some(0));
    }
}
