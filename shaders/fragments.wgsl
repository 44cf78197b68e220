// Appends every fragment of small triangles; queues large triangles. One invocation does one triangle along three
// axes.

struct LargeQueue {
    count: atomic<u32>,
    items: array<LargeItem>,
}

@group(0) @binding(0) var<uniform> params: RasterParams;
@group(0) @binding(1) var<storage, read> frames: array<DirectionFrame>;
@group(0) @binding(2) var<storage, read> triangles: array<PackedTriangle>;
@group(0) @binding(3) var<storage, read> masks: array<TriangleMask>;
@group(0) @binding(4) var<storage, read> planes: array<PackedPlane>;
@group(0) @binding(5) var<storage, read> alpha: array<u32>;
@group(0) @binding(6) var<storage, read_write> queue: LargeQueue;
@group(0) @binding(7) var<storage, read_write> fragments: FragmentList;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= params.triangles {
        return;
    }
    let vertices = triangle_vertices(id.x, id.y);
    for (var axis = 0u; axis < 3u; axis += 1u) {
        let p = project(vertices, axis, params.sub_bits, params.clip_min, params.clip_max);
        if p.area == 0 {
            continue;
        }
        if pixel_count(p) <= SMALL_PIXELS {
            scan_small(p, id.x, id.y, axis);
        } else {
            queue.items[atomicAdd(&queue.count, 1u)] = LargeItem(id.x, id.y, axis);
        }
    }
}
