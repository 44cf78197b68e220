// Sums up what the chunks of a level counted, and makes room for the next level. One invocation in all: a level has few
// chunks.

@group(0) @binding(0) var<uniform> pass_params: PassParams;
@group(0) @binding(1) var<storage, read_write> tree: array<u32>;
@group(0) @binding(2) var<storage, read_write> chunk_sums: array<vec2<u32>>;

fn put_arguments(at: u32, workgroups: vec3<u32>) {
    tree[at] = workgroups.x;
    tree[at + 1u] = workgroups.y;
    tree[at + 2u] = workgroups.z;
}

@compute @workgroup_size(1)
fn main() {
    let level = tree[TREE_LEVEL];
    let start = tree[TREE_STARTS + level];
    let end = tree[TREE_STARTS + level + 1u];
    let chunks = (end - start + TREE_CHUNK - 1u) / TREE_CHUNK;
    var sums = vec2<u32>(end, tree[TREE_LEAVES]);
    for (var chunk = 0u; chunk < chunks; chunk += 1u) {
        let counts = chunk_sums[chunk];
        chunk_sums[chunk] = sums;
        sums += counts;
    }
    if sums.x > pass_params.node_capacity {
        tree[TREE_FLAGS] = FLAG_NODES;
        tree[TREE_NEEDED] = sums.x;
        sums.x = end;
    }
    let nodes = sums.x - end;
    tree[TREE_LEVEL] = level + 1u;
    tree[TREE_NODES] = sums.x;
    tree[TREE_LEAVES] = sums.y;
    tree[TREE_STARTS + level + 2u] = sums.x;
    let next = TREE_ARGUMENTS + TREE_LEVEL_ARGUMENTS * (level + 1u);
    // An invocation for each chunk, one for each node, and workgroups for each node's map.
    put_arguments(next, vec3<u32>((nodes + 64u * TREE_CHUNK - 1u) / (64u * TREE_CHUNK), 1u, 1u));
    put_arguments(next + 3u, vec3<u32>((nodes + 63u) / 64u, 1u, 1u));
    put_arguments(next + 6u, vec3<u32>(grid_of(nodes), pass_params.slices));
    put_arguments(TREE_NODE_ARGUMENTS, vec3<u32>(grid_of(sums.x), pass_params.slices));
    put_arguments(TREE_LEAF_ARGUMENTS, vec3<u32>(grid_of(sums.y), pass_params.slices));
}
