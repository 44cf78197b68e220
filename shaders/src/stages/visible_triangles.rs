use crate::executor::{CpuBinding, DepthImage};
use crate::masks::{TriangleMask, UNMASKED};
use crate::raster::BARYCENTRIC_ONE;
use crate::types::{EyeTriangle, PackedPlane, ViewParams};

type Vector = [f32; 3];

fn dot(a: Vector, b: Vector) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn minus(a: Vector, b: Vector) -> Vector {
    [0, 1, 2].map(|i| a[i] - b[i])
}

/// Where a pixel's ray meets a triangle: distance in lengths of `direction`, weights of the second and third vertex.
fn intersect([a, b, c]: [Vector; 3], direction: Vector) -> Option<(f32, [f32; 2])> {
    let (ab, ac) = (minus(b, a), minus(c, a));
    let across = cross(direction, ac);
    let determinant = dot(ab, across);
    if determinant == 0.0 {
        return None;
    }
    let from_a = a.map(|c| -c);
    let turned = cross(from_a, ab);
    let (b1, b2) = (dot(from_a, across) / determinant, dot(direction, turned) / determinant);
    (b1 >= 0.0 && b2 >= 0.0 && b1 + b2 <= 1.0).then(|| (dot(ac, turned) / determinant, [b1, b2]))
}

/// Pixels that a triangle may cover: all of them where it reaches behind the eye.
fn pixels(view: &ViewParams, vertices: &[Vector; 3]) -> [[u32; 2]; 2] {
    let size = [view.width, view.height];
    let mut min = [f32::INFINITY; 2];
    let mut max = [f32::NEG_INFINITY; 2];
    for &vertex in vertices {
        let z = dot(vertex, view.forward);
        if z < view.near_metres {
            return [[0; 2], size];
        }
        let ndc = [dot(vertex, view.right_over_square) / z, -dot(vertex, view.up_over_square) / z];
        for i in 0..2 {
            let pixel = (ndc[i] + 1.0) * 0.5 * size[i] as f32;
            min[i] = min[i].min(pixel);
            max[i] = max[i].max(pixel);
        }
    }
    // `as` saturates.
    [[0, 1].map(|i| (min[i] - 1.0) as u32), [0, 1].map(|i| ((max[i] + 2.0) as u32).min(size[i]))]
}

pub(super) fn twin(counts: [u32; 2], bindings: &mut [CpuBinding], target: &mut DepthImage) {
    let [view, triangles, masks, planes, alpha, nearest, seen] = bindings else {
        unreachable!("checked against the table")
    };
    let view: ViewParams = view.first();
    let (masks, planes) = (masks.slice::<TriangleMask>(), planes.slice::<PackedPlane>());
    for triangle in &triangles.slice::<EyeTriangle>()[..counts[0] as usize / 3] {
        let vertices = triangle.vertices();
        let [min, max] = pixels(&view, &vertices);
        for y in min[1]..max[1] {
            for x in min[0]..max[0] {
                let at = [(x, view.width), (y, view.height)]
                    .map(|(pixel, size)| 2.0 * (pixel as f32 + 0.5) / size as f32 - 1.0);
                let direction = [0, 1, 2]
                    .map(|i| view.forward[i] + view.right[i] * at[0] - view.up[i] * at[1]);
                let Some((metres, weights)) = intersect(vertices, direction) else { continue };
                if metres < view.near_metres {
                    continue;
                }
                let weights = weights.map(|weight| (weight * BARYCENTRIC_ONE as f32) as u32);
                if triangle.mask != UNMASKED
                    && !masks[triangle.mask as usize].passes_packed(planes, alpha.words(), weights)
                {
                    continue;
                }
                let depth = (metres / view.far_metres).clamp(0.0, 1.0);
                if view.collect == 1 && depth == nearest.depth().at(x, y) {
                    let seen = &mut seen.words_mut()[(y * view.width + x) as usize];
                    *seen = (*seen).min(triangle.index);
                }
                target.keep_nearest(x, y, depth);
            }
        }
    }
}
