//! The segment test over what shaders are given: a table, tiles, frames and the rows texture.

use crate::direction_table::table_cell;
use crate::executor::CpuBinding;
use crate::row_bits::DirectionBits;
use crate::row_test::{
    LatticeSegment, NEAR_STEPS, PackedFrame, RowPlan, RowTestParams, TEST_RAW_BITS, all_within,
    cut_far_segment, cut_segment, plan_any,
};
use crate::rows_texture::RowsImage;
use crate::types::Segment;

/// The bindings of `lib_rows.wgsl`.
#[derive(Debug, Clone, Copy)]
pub struct RowView<'a> {
    params: RowTestParams,
    cells: &'a [u32],
    tiles: &'a [u32],
    frames: &'a [PackedFrame],
    image: &'a RowsImage,
}

impl<'a> RowView<'a> {
    /// From what a stage is given.
    pub fn bound(bindings: &'a [CpuBinding]) -> Self {
        let [params, cells, tiles, frames, image] = bindings else {
            unreachable!("checked against the table")
        };
        Self {
            params: params.first(),
            cells: cells.slice(),
            tiles: tiles.slice(),
            frames: frames.slice(),
            image: image.rows(),
        }
    }

    /// Whether a bit is set in what the segment looks at.
    pub fn is_occluded(&self, segment: &Segment) -> bool {
        self.plan(segment).is_some_and(|(_, plan, bits)| bits.any(&plan.near) || bits.any(&plan.far))
    }

    /// Metres from the origin to the near face of the first voxel.
    pub fn distance(&self, segment: &Segment) -> Option<f32> {
        let (cut, plan, bits) = self.plan(segment)?;
        let share = first_share(&bits, &plan)?;
        let way = [0, 1, 2].map(|i| segment.target[i] - segment.origin[i]);
        let length = (way[0] * way[0] + way[1] * way[1] + way[2] * way[2]).sqrt();
        Some((cut.cut + cut.share * share) * length)
    }

    fn plan(&self, segment: &Segment) -> Option<(LatticeSegment, RowPlan, DirectionBits<'a>)> {
        let Segment { origin, target, normal } = *segment;
        let way = [0, 1, 2].map(|i| target[i] - origin[i]);
        let from_center = self.params.lattice_from_world(origin);
        let (cut, normal) = if all_within(from_center, NEAR_STEPS) {
            let steps = self.params.steps_per_metre;
            (
                cut_segment(from_center, [0, 1, 2].map(|i| way[i] * steps[i])),
                self.params.normal_in_steps(normal),
            )
        } else {
            // So far away no surface is the origin's.
            (cut_far_segment(from_center, self.params.lattice_from_world(target)), [0; 3])
        };
        if !cut.is_valid {
            return None;
        }
        let cell = table_cell(way);
        let direction = self.cells[(cell >> 1) as usize] >> (16 * (cell & 1)) & 0xffff;
        let tile = self.tiles[direction as usize];
        let words = self.image.layout().words_a_direction();
        let bits = DirectionBits {
            words: &self.image.rows()[tile as usize * words..][..words],
            bits: self.params.bits,
            consensus: self.params.consensus == 1,
        };
        Some((cut, plan_any(&self.params, &self.frames[tile as usize].unpacked(), &cut, normal), bits))
    }
}

/// Where along the way that was planned (0 to 1) its first voxel begins.
#[inline]
pub fn first_share(bits: &DirectionBits, plan: &RowPlan) -> Option<f32> {
    let upwards = plan.way_w >= 0;
    let bit = bits.first(&plan.near, upwards).or_else(|| bits.first(&plan.far, upwards))?;
    if plan.way_w == 0 {
        return Some(0.0);
    }
    // The voxel's face on the origin's side.
    let face = (bit + i32::from(!upwards)) << (TEST_RAW_BITS - bits.bits);
    Some((face.wrapping_sub(plan.origin_w) as f32 / plan.way_w as f32).clamp(0.0, 1.0))
}
