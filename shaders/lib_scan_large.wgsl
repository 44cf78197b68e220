// Large triangles from the global `queue`: one workgroup per item (x, y) and strip of LARGE_ROWS rows (z).

struct LargeItems {
    count: u32,
    items: array<LargeItem>,
}

fn scan_strip(group: vec3<u32>, lane: u32) {
    let index = group.y * MAX_WORKGROUPS + group.x;
    if index >= queue.count {
        return;
    }
    let item = queue.items[index];
    let vertices = triangle_vertices(item.triangle, item.direction);
    let p = project(vertices, item.axis, params.sub_bits, params.clip_min, params.clip_max);
    let first_row = p.pixel_min.y + i32(group.z * LARGE_ROWS);
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
