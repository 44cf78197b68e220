// Empties the maps of all nodes. A workgroup does a slice of a node's.

@group(0) @binding(0) var<uniform> pass_params: PassParams;
@group(0) @binding(1) var<storage, read> tree: array<u32>;
@group(0) @binding(2) var<storage, read_write> maps: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = flat_group(group);
    if node >= tree[TREE_NODES] {
        return;
    }
    let end = min((group.z + 1u) * MAP_SLICE, pass_params.texels);
    for (var texel = group.z * MAP_SLICE + lane; texel < end; texel += 64u) {
        let at = node * pass_params.texels + texel;
        maps[at] = INFINITY_BITS;
        if pass_params.with_numbers == 1u {
            maps[number_at(at)] = NO_NUMBER;
        }
    }
}
