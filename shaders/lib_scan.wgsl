// Visits the fragments of triangles, for `emit` of `lib_emit_*.wgsl`. Small triangles are done by one invocation, large
// ones by workgroups, so that no invocation loops long.

struct LargeItem {
    triangle: u32,
    direction: u32,
    axis: u32,
}

fn visit_pixel(p: Projected, triangle: u32, direction: u32, axis: u32, pixel: vec2<i32>) {
    let s = sample_pixel(p, pixel, params.sub_bits);
    if !s.inside {
        return;
    }
    let voxel = from_projection(vec3<i32>(pixel, s.depth), axis);
    if any(voxel < params.clip_min) || any(voxel >= params.clip_max) {
        return;
    }
    let mask = triangles[triangle].mask;
    if mask != UNMASKED && !mask_passes(mask, barycentric(p, s)) {
        return;
    }
    emit(p, s, triangle, direction, voxel);
}
