// The Morton key of every view's position in the scene cube, and the order before sorting. One invocation a view.

@group(0) @binding(0) var<uniform> scene: SceneParams;
@group(0) @binding(1) var<uniform> sort: SortParams;
@group(0) @binding(2) var<storage, read> views: array<ViewCone>;
@group(0) @binding(3) var<storage, read_write> keys: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read_write> order: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = flat_group(group) * 64u + lane;
    if index >= sort.count {
        return;
    }
    let at = (views[index].position - scene.origin) * scene.key_cells_per_metre;
    let cell = vec3<u32>(clamp(at, vec3<f32>(0.0), vec3<f32>(8191.0)));
    var key = vec2<u32>(0u);
    for (var l = 0u; l < 10u; l += 1u) {
        let bit = (cell >> vec3<u32>(l)) & vec3<u32>(1u);
        key.x |= (bit.x | (bit.y << 1u) | (bit.z << 2u)) << (3u * l);
    }
    for (var l = 0u; l < 3u; l += 1u) {
        let bit = (cell >> vec3<u32>(l + 10u)) & vec3<u32>(1u);
        key.y |= (bit.x | (bit.y << 1u) | (bit.z << 2u)) << (3u * l);
    }
    keys[index] = key;
    order[index] = index;
}
