// Appends the fragments of the large triangles that `fragments` queued: one workgroup per item (x, y) and strip
// of rows (z).

struct LargeItems {
    count: u32,
    items: array<LargeItem>,
}

@group(0) @binding(0) var<uniform> params: RasterParams;
@group(0) @binding(1) var<storage, read> frames: array<DirectionFrame>;
@group(0) @binding(2) var<storage, read> triangles: array<PackedTriangle>;
@group(0) @binding(3) var<storage, read> masks: array<TriangleMask>;
@group(0) @binding(4) var<storage, read> planes: array<PackedPlane>;
@group(0) @binding(5) var<storage, read> alpha: array<u32>;
@group(0) @binding(6) var<storage, read> queue: LargeItems;
@group(0) @binding(7) var<storage, read_write> fragments: FragmentList;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let item = group.y * MAX_WORKGROUPS + group.x;
    if item < queue.count {
        scan_strip(queue.items[item], group.z, lane);
    }
}
