// Puts the views of every chunk to their places by one digit, in order. One invocation a chunk; `counts` holds where the
// first view of each digit and chunk goes.

@group(0) @binding(0) var<uniform> sort: SortParams;
@group(0) @binding(1) var<storage, read> keys: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;
@group(0) @binding(4) var<storage, read_write> sorted: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let chunk = group.x * 64u + lane;
    if chunk >= sort.chunks {
        return;
    }
    let end = min((chunk + 1u) * SORT_CHUNK, sort.count);
    for (var i = chunk * SORT_CHUNK; i < end; i += 1u) {
        let view = order[i];
        let at = sort_digit(keys[view], sort.digit) * sort.chunks + chunk;
        let place = counts[at];
        counts[at] = place + 1u;
        sorted[place] = view;
    }
}
