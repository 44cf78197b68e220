// Makes the nodes of the level that was counted and the ranges of their children. One invocation a chunk.

@group(0) @binding(0) var<uniform> scene: SceneParams;
@group(0) @binding(1) var<uniform> pass_params: PassParams;
@group(0) @binding(2) var<storage, read> tree: array<u32>;
@group(0) @binding(3) var<storage, read> keys: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> chunk_sums: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read_write> ranges: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read_write> view_nodes: array<ViewNode>;
// The parent of every node, and the node of every leaf.
@group(0) @binding(7) var<storage, read_write> links: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let chunk = group.x * 64u + lane;
    // The level after it is next by now.
    let level = tree[TREE_LEVEL] - 1u;
    let end = tree[TREE_STARTS + level + 1u];
    let first = tree[TREE_STARTS + level] + chunk * TREE_CHUNK;
    if first >= end {
        return;
    }
    let has_room = tree[TREE_FLAGS] == 0u;
    var sums = chunk_sums[chunk];
    for (var node = first; node < min(first + TREE_CHUNK, end); node += 1u) {
        let range = ranges[node];
        let digit = differing_digit(range.x, range.y - 1u);
        if is_shared(range, digit) {
            view_nodes[node].first = range.x;
            view_nodes[node].count = VIEW_LEAF | (range.y - range.x);
            links[pass_params.node_capacity + sums.y] = node;
            sums.y += 1u;
            continue;
        }
        if !has_room {
            // The pass will be done again.
            view_nodes[node].first = 0u;
            view_nodes[node].count = VIEW_LEAF;
            continue;
        }
        let first_child = sums.x;
        var start = range.x;
        while start < range.y {
            let next = child_end(start, range, digit);
            ranges[sums.x] = vec2<u32>(start, next);
            links[sums.x] = node;
            sums.x += 1u;
            start = next;
        }
        view_nodes[node].first = first_child;
        view_nodes[node].count = sums.x - first_child;
    }
}
