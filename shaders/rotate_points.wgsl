// Sets the voxel of every point in every direction's grid. One invocation does some pairs of
// points in one direction.

struct PointParams {
    // Pairs of points.
    pairs: u32,
    grid_bits: u32,
    // From one row to the next, log2 of bits.
    row_bits: u32,
    reserved: u32,
}

@group(0) @binding(0) var<uniform> params: PointParams;
@group(0) @binding(1) var<storage, read> frames: array<DirectionFrame>;
// Three signed 16-bit coordinates each: three words for two points.
@group(0) @binding(2) var<storage, read> points: array<u32>;
@group(0) @binding(3) var<storage, read_write> bits: array<atomic<u32>>;

fn set_voxel(direction: u32, axes: Axes, p: vec3<i32>) {
    let voxel = vec3<u32>(raw_point(axes, p)) >> vec3<u32>(ROW_RAW_BITS - params.grid_bits);
    let row = (((direction << params.grid_bits) | voxel.y) << params.grid_bits) | voxel.x;
    let bit = (row << params.row_bits) | voxel.z;
    atomicOr(&bits[bit >> 5u], 1u << (bit & 31u));
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let direction = group.y;
    let axes = axes_of(direction);
    for (var i = 0u; i < PAIRS_PER_INVOCATION; i += 1u) {
        let pair = (group.x * PAIRS_PER_INVOCATION + i) * 64u + lane;
        if pair >= params.pairs {
            return;
        }
        let a = points[3u * pair];
        let b = points[3u * pair + 1u];
        let c = points[3u * pair + 2u];
        let low = vec3<i32>(vec3<u32>(a, b, c) << vec3<u32>(16u)) >> vec3<u32>(16u);
        let high = vec3<i32>(vec3<u32>(a, b, c)) >> vec3<u32>(16u);
        set_voxel(direction, axes, vec3<i32>(low.x, high.x, low.y));
        set_voxel(direction, axes, vec3<i32>(high.y, low.z, high.z));
    }
}
