// Sets the bits of the large triangles that `voxelize` queued.

@group(0) @binding(0) var<uniform> params: RasterParams;
@group(0) @binding(1) var<storage, read> frames: array<DirectionFrame>;
@group(0) @binding(2) var<storage, read> triangles: array<PackedTriangle>;
@group(0) @binding(3) var<storage, read> masks: array<TriangleMask>;
@group(0) @binding(4) var<storage, read> planes: array<PackedPlane>;
@group(0) @binding(5) var<storage, read> alpha: array<u32>;
@group(0) @binding(6) var<storage, read> queue: LargeItems;
@group(0) @binding(7) var<storage, read_write> bits: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    scan_strip(group, lane);
}
