// Takes what the maps of the level above show into the maps of a level's nodes: a texel keeps the smaller of its own distance
// and the parent's, corrected for the way between their middles, and with the parent's the number of the node that the parent
// shows. A workgroup does a slice of a node's map.

@group(0) @binding(0) var<uniform> pass_params: PassParams;
@group(0) @binding(1) var<uniform> level_params: LevelParams;
@group(0) @binding(2) var<storage, read> tree: array<u32>;
@group(0) @binding(3) var<storage, read> view_nodes: array<ViewNode>;
@group(0) @binding(4) var<storage, read> links: array<u32>;
@group(0) @binding(5) var<storage, read_write> maps: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = tree[TREE_STARTS + level_params.level] + flat_group(group);
    if node >= tree[TREE_STARTS + level_params.level + 1u] {
        return;
    }
    let parent = links[node];
    let offset = view_nodes[node].center - view_nodes[parent].center;
    let end = min((group.z + 1u) * MAP_SLICE, pass_params.texels);
    for (var texel = group.z * MAP_SLICE + lane; texel < end; texel += 64u) {
        let parent_at = parent * pass_params.texels + texel;
        let depth = maps[parent_at];
        if depth == INFINITY_BITS {
            continue;
        }
        let moved = texel_direction(texel, pass_params.resolution) * bitcast<f32>(depth) - offset;
        let at = node * pass_params.texels + texel;
        // Floats that are not negative are in the order of their bits.
        let bits = bitcast<u32>(sqrt(dot(moved, moved)));
        if bits < maps[at] {
            maps[at] = bits;
            if pass_params.with_numbers == 1u {
                maps[number_at(at)] = maps[number_at(parent_at)];
            }
        }
    }
}
