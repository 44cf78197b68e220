// Counts the digits of every chunk of views. One invocation a chunk; `counts` holds all chunks' counts of digit 0, then of
// digit 1 and so on, and is zero before.

@group(0) @binding(0) var<uniform> sort: SortParams;
@group(0) @binding(1) var<storage, read> keys: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let chunk = group.x * 64u + lane;
    if chunk >= sort.chunks {
        return;
    }
    let end = min((chunk + 1u) * SORT_CHUNK, sort.count);
    for (var i = chunk * SORT_CHUNK; i < end; i += 1u) {
        counts[sort_digit(keys[order[i]], sort.digit) * sort.chunks + chunk] += 1u;
    }
}
