//! Inner octree nodes from their children.
//!
//! An inner node's attributes are a function of its children's stored ones, so that anyone who has the leaves can
//! compute and check all levels above them.

use manyview_shaders::octahedral;
use manyview_shaders::rgb9e5;
use manyview_shaders::srgb::{LINEAR_FROM_SRGB, srgb_from_linear};
use manyview_shaders::svo::SvoLevel;

/// The level above `children`: node i has the children that `child_masks[i]` names, taken in order.
///
/// Colour and radiance are averaged in linear light with the children's coverage as weight; the cone is the smallest
/// one around the summed axis that contains the children's cones; coverage is the share of the cell that its children
/// cover when seen along x, y and z, averaged.
///
/// # Panics
/// If the masks name another number of children than there are.
pub fn reduce_level(child_masks: Vec<u8>, children: &SvoLevel) -> SvoLevel {
    let named: usize = child_masks.iter().map(|m| m.count_ones() as usize).sum();
    assert_eq!(named, children.colors.len(), "child masks must name every child");
    let nodes = child_masks.len();
    let emits = !children.emissive.is_empty();
    let mut level = SvoLevel {
        child_masks: Vec::new(),
        colors: Vec::with_capacity(nodes),
        normals: Vec::with_capacity(nodes),
        cones: Vec::with_capacity(nodes),
        coverages: Vec::with_capacity(nodes),
        emissive: Vec::with_capacity(if emits { nodes } else { 0 }),
    };
    let mut first = 0;
    for &mask in &child_masks {
        let family = first..first + mask.count_ones() as usize;
        first = family.end;
        let mut by_octant = [0u32; 8];
        let (mut weights, mut color, mut emissive, mut axis) = (0u64, [0u64; 3], [0.0; 3], [0.0; 3]);
        for (child, octant) in family.clone().zip((0..8).filter(|o| mask >> o & 1 == 1)) {
            let weight = children.coverages.get(child).map_or(255, |&c| u64::from(c));
            by_octant[octant] = weight as u32;
            weights += weight;
            let normal = octahedral::decode(children.normals[child]);
            let radiance = if emits { rgb9e5::decode(children.emissive[child]) } else { [0.0; 3] };
            for c in 0..3 {
                color[c] += u64::from(LINEAR_FROM_SRGB[usize::from(children.colors[child][c])]) * weight;
                emissive[c] += radiance[c] * weight as f64;
                axis[c] += normal[c] * weight as f64;
            }
        }
        level.colors.push(color.map(|c| srgb_from_linear(((c + weights / 2) / weights) as u16)));
        if emits {
            level.emissive.push(rgb9e5::encode(emissive.map(|e| e / weights as f64)));
        }
        let packed = octahedral::encode(axis);
        level.normals.push(packed);
        let axis = octahedral::decode(packed);
        let cos = family
            .map(|child| {
                let normal = octahedral::decode(children.normals[child]);
                let between =
                    (axis[0] * normal[0] + axis[1] * normal[1] + axis[2] * normal[2]).clamp(-1.0, 1.0);
                cos_of_sum(between, octahedral::decode_cone(children.cones[child]))
            })
            .fold(1.0, f64::min);
        level.cones.push(octahedral::encode_cone(cos));
        level.coverages.push(coverage(by_octant));
    }
    level.child_masks = child_masks;
    level
}

/// cos(a + b) from cos a and cos b with a, b in 0 ..= π; −1 where the sum exceeds π.
fn cos_of_sum(cos_a: f64, cos_b: f64) -> f64 {
    if cos_a + cos_b <= 0.0 {
        return -1.0;
    }
    let sines = ((1.0 - cos_a * cos_a) * (1.0 - cos_b * cos_b)).max(0.0).sqrt();
    cos_a * cos_b - sines
}

/// Mean over the axes of the covered share of a 2 × 2 × 2 cell; two cells behind each other cover as if placed at
/// random. Of 255, at least 1.
fn coverage(by_octant: [u32; 8]) -> u8 {
    let mut total = 0;
    for axis in 0..3 {
        for front in (0..8).filter(|o| o >> axis & 1 == 0) {
            let (a, b) = (by_octant[front], by_octant[front | 1 << axis]);
            total += 255 * (a + b) - a * b;
        }
    }
    let all = 12 * 255;
    ((total + all / 2) / all).clamp(1, 255) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn leaves(colors: &[[u8; 3]], normals: &[[f64; 3]]) -> SvoLevel {
        SvoLevel {
            colors: colors.to_vec(),
            normals: normals.iter().map(|&n| octahedral::encode(n)).collect(),
            cones: vec![0; colors.len()],
            ..SvoLevel::default()
        }
    }

    #[test]
    fn colours_average_in_linear_light() {
        let up = [0.0, 1.0, 0.0];
        let level = reduce_level(vec![0b11], &leaves(&[[0, 0, 0], [255, 255, 255]], &[up, up]));
        assert_eq!(level.colors, [[188, 188, 188]]);
        assert_eq!((level.normals[0], level.cones[0]), (octahedral::encode(up), 0));
    }

    #[test]
    fn a_plane_of_leaves_covers_one_axis_and_half_of_the_others() {
        let up = [0.0, 1.0, 0.0];
        // Octants with y = 0: 0, 1, 4, 5.
        let level = reduce_level(vec![0b0011_0011], &leaves(&[[9; 3]; 4], &[up; 4]));
        assert_eq!(level.coverages, [170], "(1 + 1/2 + 1/2) / 3 of 255");
        let level = reduce_level(vec![0xff], &leaves(&[[9; 3]; 8], &[up; 8]));
        assert_eq!(level.coverages, [255]);
    }

    #[test]
    fn cones_contain_their_children() {
        let (x, y) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        let level = reduce_level(vec![0b101], &leaves(&[[9; 3]; 2], &[x, y]));
        let cos = octahedral::decode_cone(level.cones[0]);
        assert!((0.69..=0.7072).contains(&cos), "{cos}");
        let level = reduce_level(vec![0b101], &leaves(&[[9; 3]; 2], &[x, [-1.0, 0.0, 0.0]]));
        let axis = octahedral::decode(level.normals[0]);
        assert!(
            octahedral::decode_cone(level.cones[0]) <= -axis[0].abs() + 1e-9,
            "opposite normals both lie inside"
        );
    }
}
