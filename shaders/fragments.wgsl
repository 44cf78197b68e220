// Appends every fragment of small triangles to a list; queues large triangles. One invocation does one triangle.

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
    scan_triangle(id.x, id.y);
}
