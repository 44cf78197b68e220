// One triangle in one direction along three axes: visits its pixels if they are few, else leaves it to the global
// `queue`, which has room for all.

struct LargeQueue {
    count: atomic<u32>,
    items: array<LargeItem>,
}

fn scan_pixels(p: Projected, triangle: u32, direction: u32, axis: u32) {
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

fn scan_triangle(triangle: u32, direction: u32) {
    if triangle >= params.triangles {
        return;
    }
    let vertices = triangle_vertices(triangle, direction);
    for (var axis = 0u; axis < 3u; axis += 1u) {
        let p = project(vertices, axis, params.sub_bits, params.clip_min, params.clip_max);
        if p.area == 0 {
            continue;
        }
        let size = vec2<u32>(p.pixel_max - p.pixel_min + 1i);
        if size.x * size.y <= SMALL_PIXELS {
            scan_pixels(p, triangle, direction, axis);
        } else {
            queue.items[atomicAdd(&queue.count, 1u)] = LargeItem(triangle, direction, axis);
        }
    }
}
