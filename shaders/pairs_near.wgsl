// Draws pairs of two leaves. `near_lanes` invocations a pair.

@group(0) @binding(0) var<uniform> scene: SceneParams;
@group(0) @binding(1) var<uniform> pass_params: PassParams;
@group(0) @binding(2) var<storage, read> scene_places: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> view_nodes: array<ViewNode>;
@group(0) @binding(4) var<storage, read> counters: array<u32>;
@group(0) @binding(5) var<storage, read> near_pairs: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read_write> maps: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let lanes = pass_params.near_lanes;
    let index = flat_group(group) * (64u / lanes) + lane / lanes;
    if index >= counters[COUNTER_NEAR] {
        return;
    }
    let pair = near_pairs[index];
    let cell = octant_cell(place_cell(scene_places[leaf_parent(pair.x)]), pair.x & 7u);
    let edge = cell_size(scene.depth);
    let offset = cell_center(cell, edge) - view_nodes[pair.y].center;
    draw_near_leaf(pair.y, pair.x, offset, edge, pass_params.resolution, lane & (lanes - 1u), lanes);
}
