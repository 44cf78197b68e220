// Sets the bits of the voxels in one layer of depth peeling and counts them. One invocation does one pixel.

struct Count {
    voxels: atomic<u32>,
}

@group(0) @binding(0) var<uniform> params: RasterParams;
@group(0) @binding(1) var<uniform> peel: PeelParams;
@group(0) @binding(2) var<storage, read> views: array<PeelView>;
@group(0) @binding(3) var layer: texture_depth_2d;
@group(0) @binding(4) var<storage, read_write> count: Count;
@group(0) @binding(5) var<storage, read_write> bits: array<atomic<u32>>;

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let cell = id.xy / peel.cell;
    let index = cell.y * peel.columns + cell.x;
    if cell.x >= peel.columns || index >= peel.views {
        return;
    }
    let depth = textureLoad(layer, vec2<i32>(id.xy), 0i);
    if depth >= 1.0 {
        return;
    }
    let view = views[index];
    let pixel = vec2<i32>(id.xy) - cell_corner(index, peel) + vec2<i32>(view.window_x, view.window_y);
    let z = i32(depth * PEEL_DEPTHS) - 1i + to_projection(params.clip_min, view.axis).z;
    let at = vec3<u32>(from_projection(vec3<i32>(pixel, z), view.axis) - params.clip_min) * params.bit_stride;
    let bit = view.direction * params.direction_stride + at.x + at.y + at.z;
    atomicOr(&bits[bit >> 5u], 1u << (bit & 31u));
    atomicAdd(&count.voxels, 1u);
}
