// Counts the children and the leaves of every chunk of nodes of the level that is next. One invocation a chunk.

@group(0) @binding(0) var<uniform> scene: SceneParams;
@group(0) @binding(1) var<uniform> pass_params: PassParams;
@group(0) @binding(2) var<storage, read> tree: array<u32>;
@group(0) @binding(3) var<storage, read> keys: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read_write> chunk_sums: array<vec2<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let chunk = group.x * 64u + lane;
    let level = tree[TREE_LEVEL];
    let end = tree[TREE_STARTS + level + 1u];
    let first = tree[TREE_STARTS + level] + chunk * TREE_CHUNK;
    if first >= end {
        return;
    }
    var sums = vec2<u32>(0u);
    for (var node = first; node < min(first + TREE_CHUNK, end); node += 1u) {
        let range = ranges[node];
        let digit = differing_digit(range.x, range.y - 1u);
        if is_shared(range, digit) {
            sums.y += 1u;
            continue;
        }
        for (var start = range.x; start < range.y; start = child_end(start, range, digit)) {
            sums.x += 1u;
        }
    }
    chunk_sums[chunk] = sums;
}
