//! Traversing a compressed wide BVH, as a shader does.
//!
//! # Theory
//! H. Ylitie, T. Karras, S. Laine, *Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs*, HPG 2017,
//! doi 10.1145/3105762.3105773: nodes of eight children whose boxes are eight bits a plane, children in slots so that
//! the bits of a ray's octant give their order, one stack entry for all of a node's children that wait. Triangles: T.
//! Möller, B. Trumbore, *Fast, Minimum Storage Ray/Triangle Intersection*, 1997.
//!
//! # Differences from the paper
//! No postponing of triangles and no refilling of idle lanes: shaders here have no subgroup operations.
//!
//! # Practice
//! A node is 80 bytes, as the `obvhs` crate lays them out: origin (3 × f32), three exponents and the mask of inner
//! children (bytes); index of the first inner child, of the first primitive, eight bytes of meta data; then per axis
//! eight smallest and eight largest planes. `lib_wide_bvh.wgsl` does the same operations in the same order. Where a GPU
//! fuses multiplications and additions or divides less exactly, a ray that meets a triangle's border within rounding may
//! answer otherwise.

use crate::brickmap::MIN_DIRECTION;
use crate::executor::CpuBinding;
use crate::masks::{TriangleMask, UNMASKED};
use crate::raster::BARYCENTRIC_ONE;
use crate::types::{PackedPlane, Segment, WideBvhParams};

/// Groups of children that wait: one a level at most, so that this is the depth a tree may have.
pub const BVH_STACK: u32 = 24;

/// A triangle, 48 bytes.
pub type BvhTriangle = [u32; 12];

/// Packs a triangle: bits of vertex 0 relative to the tree's centre and its mask (or [`UNMASKED`]), then of the edges to
/// vertices 1 and 2, each followed by 0.
pub fn bvh_triangle([a, b, c]: [[f32; 3]; 3], mask: u32) -> BvhTriangle {
    let edge = |p: [f32; 3]| [0, 1, 2].map(|i| (p[i] - a[i]).to_bits());
    let ([ax, ay, az], [bx, by, bz], [cx, cy, cz]) = (a.map(f32::to_bits), edge(b), edge(c));
    [ax, ay, az, mask, bx, by, bz, 0, cx, cy, cz, 0]
}

/// Depth of a tree: nodes on its longest path. [`BVH_STACK`] is the most that is traversed.
pub fn depth(nodes: &[[u32; 20]]) -> u32 {
    // Children come after their parents.
    let mut depths = vec![0u32; nodes.len()];
    let mut deepest = 0;
    for (index, node) in nodes.iter().enumerate() {
        let at = depths[index].max(1);
        deepest = deepest.max(at);
        let inner = (node[3] >> 24).count_ones() as usize;
        for child in depths.iter_mut().skip(node[4] as usize).take(inner) {
            *child = at + 1;
        }
    }
    deepest
}

/// The arrays of a tree.
#[derive(Debug, Clone, Copy)]
pub struct WideBvhView<'a> {
    params: WideBvhParams,
    nodes: &'a [[u32; 20]],
    triangles: &'a [BvhTriangle],
    masks: &'a [TriangleMask],
    planes: &'a [PackedPlane],
    alpha: &'a [u32],
}

impl<'a> WideBvhView<'a> {
    /// From what the stages bind.
    pub(crate) fn bound(bindings: &'a [CpuBinding]) -> Self {
        Self {
            params: bindings[0].first(),
            nodes: bindings[1].slice(),
            triangles: bindings[2].slice(),
            masks: bindings[3].slice(),
            planes: bindings[4].slice(),
            alpha: bindings[5].words(),
        }
    }

    /// Distance in metres to the first triangle along a testable segment ([`crate::testable`]), or to any if
    /// `any_hit`. Takes one of `steps_left` for each node and triangle; where none is left, what was found so far.
    #[inline]
    pub fn traverse(&self, segment: &Segment, any_hit: bool, steps_left: &mut u32) -> Option<f32> {
        let params = &self.params;
        let start =
            [0, 1, 2].map(|i| (segment.origin[i] - params.center[i]) + segment.normal[i] * params.lift);
        let along = [0, 1, 2].map(|i| (segment.target[i] - params.center[i]) - start[i]);
        let positive = along.map(|c| c >= 0.0);
        let inverse = [0, 1, 2].map(|i| {
            let magnitude = along[i].abs().max(MIN_DIRECTION);
            1.0 / if positive[i] { magnitude } else { -magnitude }
        });
        let octant = u32::from(positive[0]) << 2 | u32::from(positive[1]) << 1 | u32::from(positive[2]);
        let (mut t_max, mut found) = (1.0f32, None);
        let mut stack = [[0u32; 2]; BVH_STACK as usize];
        let mut depth = 0;
        let mut group = [0, if params.nodes > 0 { 1u32 << 31 } else { 0 }];
        while *steps_left > 0 {
            let mut primitives = [0; 2];
            if group[1] > 0x00ff_ffff {
                *steps_left -= 1;
                let bit = 31 - group[1].leading_zeros();
                let inner = group[1];
                group[1] &= !(1 << bit);
                if group[1] > 0x00ff_ffff && depth < stack.len() {
                    stack[depth] = group;
                    depth += 1;
                }
                let slot = (bit - 24) ^ octant;
                let node = &self.nodes[(group[0] + (inner & ((1 << slot) - 1)).count_ones()) as usize];
                let met = children_met(node, start, inverse, positive, octant, t_max);
                group = [node[4], (met & 0xff00_0000) | node[3] >> 24];
                primitives = [node[5], met & 0x00ff_ffff];
            }
            while primitives[1] != 0 && *steps_left > 0 {
                *steps_left -= 1;
                let bit = primitives[1].trailing_zeros();
                primitives[1] &= primitives[1] - 1;
                if let Some(t) = self.meet(primitives[0] + bit, start, along, t_max) {
                    (t_max, found) = (t, Some(t));
                    if any_hit {
                        primitives[1] = 0;
                    }
                }
            }
            if any_hit && found.is_some() {
                break;
            }
            if group[1] <= 0x00ff_ffff {
                if depth == 0 {
                    break;
                }
                depth -= 1;
                group = stack[depth];
            }
        }
        let length = (along[0] * along[0] + along[1] * along[1] + along[2] * along[2]).sqrt();
        found.map(|t| t * length)
    }

    #[inline]
    fn meet(&self, index: u32, start: [f32; 3], along: [f32; 3], t_max: f32) -> Option<f32> {
        let triangle = &self.triangles[index as usize];
        let float = |i: usize| f32::from_bits(triangle[i]);
        let (e1, e2) = ([float(4), float(5), float(6)], [float(8), float(9), float(10)]);
        let cross = |a: [f32; 3], b: [f32; 3]| {
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        };
        let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let p = cross(along, e2);
        let determinant = dot(e1, p);
        let s = [0, 1, 2].map(|i| start[i] - float(i));
        let q = cross(s, e1);
        let inverse = 1.0 / determinant;
        let (u, v, t) = (dot(s, p) * inverse, dot(along, q) * inverse, dot(e2, q) * inverse);
        if !(determinant != 0.0 && u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 && t < t_max) {
            return None;
        }
        let mask = triangle[3];
        if mask != UNMASKED {
            let one = BARYCENTRIC_ONE as f32;
            let w1 = ((u * one) as u32).min(BARYCENTRIC_ONE);
            let w2 = ((v * one) as u32).min(BARYCENTRIC_ONE - w1);
            let mask = &self.masks[mask as usize];
            if !mask.passes_packed(self.planes, self.alpha, [w1, w2]) {
                return None;
            }
        }
        Some(t)
    }
}

/// Bits of the children whose boxes the ray meets: inner ones from bit 24 on, primitives below.
#[inline]
fn children_met(
    node: &[u32; 20],
    start: [f32; 3],
    inverse: [f32; 3],
    positive: [bool; 3],
    octant: u32,
    t_max: f32,
) -> u32 {
    let scale = [0, 8, 16].map(|shift| f32::from_bits((node[3] >> shift & 255) << 23));
    let scale = [0, 1, 2].map(|i| scale[i] * inverse[i]);
    let shift = [0, 1, 2].map(|i| (f32::from_bits(node[i]) - start[i]) * inverse[i]);
    let octant4 = octant * 0x0101_0101;
    let mut met = 0;
    for half in 0..2 {
        let meta4 = node[6 + half];
        let inner4 = (((meta4 & (meta4 << 1)) & 0x1010_1010) >> 4) * 0xff;
        let index4 = (meta4 ^ (octant4 & inner4)) & 0x1f1f_1f1f;
        let child4 = meta4 >> 5 & 0x0707_0707;
        for byte in [0, 8, 16, 24] {
            let plane = |i: usize, is_far: bool| {
                let largest = is_far == positive[i];
                let word = node[8 + 4 * i + half + if largest { 2 } else { 0 }];
                (word >> byte & 255) as f32 * scale[i] + shift[i]
            };
            let near = plane(0, false).max(plane(1, false)).max(plane(2, false).max(0.0));
            let far = plane(0, true).min(plane(1, true)).min(plane(2, true).min(t_max));
            if near <= far {
                met |= (child4 >> byte & 255) << (index4 >> byte & 31);
            }
        }
    }
    met
}
