// Sets the voxel of every point in every direction's grid. One invocation does two points in one direction.

struct PointParams {
    // Pairs of points.
    pairs: u32,
    grid_bits: u32,
    reserved: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: PointParams;
@group(0) @binding(1) var<storage, read> frames: array<DirectionFrame>;
// Three signed 16-bit coordinates each: three words for two points.
@group(0) @binding(2) var<storage, read> points: array<u32>;
@group(0) @binding(3) var<storage, read_write> bits: array<atomic<u32>>;

fn voxel_along(direction: u32, axis: u32, p: vec3<i32>) -> u32 {
    return u32(raw_along(direction, axis, p)) >> (ROW_RAW_BITS - params.grid_bits);
}

fn set_voxel(direction: u32, p: vec3<i32>) {
    let u = voxel_along(direction, 0u, p);
    let v = voxel_along(direction, 1u, p);
    let w = voxel_along(direction, 2u, p);
    let bit = (((((direction << params.grid_bits) | v) << params.grid_bits) | u) << params.grid_bits) | w;
    let mask = 1u << (bit & 31u);
    // Most voxels are hit by many points: a load costs less than an atomic that changes nothing.
    if (atomicLoad(&bits[bit >> 5u]) & mask) == 0u {
        atomicOr(&bits[bit >> 5u], mask);
    }
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= params.pairs {
        return;
    }
    let a = points[3u * id.x];
    let b = points[3u * id.x + 1u];
    let c = points[3u * id.x + 2u];
    let low = vec3<i32>(vec3<u32>(a, b, c) << vec3<u32>(16u)) >> vec3<u32>(16u);
    let high = vec3<i32>(vec3<u32>(a, b, c)) >> vec3<u32>(16u);
    set_voxel(id.y, vec3<i32>(low.x, high.x, low.y));
    set_voxel(id.y, vec3<i32>(high.y, low.z, high.z));
}
