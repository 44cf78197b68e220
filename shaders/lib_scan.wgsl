// Visits the fragments of triangles. The stage defines `emit(triangle, direction, voxel, weights)`; small triangles
// are done by one invocation, large ones by workgroups, so that no invocation loops long.

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

fn pixel_count(p: Projected) -> u32 {
    let size = vec2<u32>(p.pixel_max - p.pixel_min + 1i);
    return size.x * size.y;
}

fn scan_small(p: Projected, triangle: u32, direction: u32, axis: u32) {
    var pixel = p.pixel_min;
    while pixel.y <= p.pixel_max.y {
        visit_pixel(p, triangle, direction, axis, pixel);
        pixel.x += 1i;
        if pixel.x > p.pixel_max.x {
            pixel.x = p.pixel_min.x;
            pixel.y += 1i;
        }
    }
}

// Lane `lane` of LARGE_LANES does its share of the strip of LARGE_ROWS rows with number `strip`.
fn scan_strip(item: LargeItem, strip: u32, lane: u32) {
    let vertices = triangle_vertices(item.triangle, item.direction);
    let p = project(vertices, item.axis, params.sub_bits, params.clip_min, params.clip_max);
    let first_row = p.pixel_min.y + i32(strip * LARGE_ROWS);
    let rows = min(i32(LARGE_ROWS), p.pixel_max.y - first_row + 1i);
    if rows <= 0 {
        return;
    }
    let width = u32(p.pixel_max.x - p.pixel_min.x + 1i);
    for (var i = lane; i < width * u32(rows); i += LARGE_LANES) {
        let pixel = vec2<i32>(p.pixel_min.x + i32(i % width), first_row + i32(i / width));
        visit_pixel(p, item.triangle, item.direction, item.axis, pixel);
    }
}
