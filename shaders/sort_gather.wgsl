// Keys and views in sorted order. One invocation a view.

@group(0) @binding(0) var<uniform> sort: SortParams;
@group(0) @binding(1) var<storage, read> order: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> views: array<ViewCone>;
@group(0) @binding(4) var<storage, read_write> sorted_keys: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read_write> sorted_views: array<ViewCone>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let place = flat_group(group) * 64u + lane;
    if place >= sort.count {
        return;
    }
    let view = order[place];
    sorted_keys[place] = keys[view];
    sorted_views[place] = views[view];
}
