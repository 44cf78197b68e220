// Turns values into the sums of all before them; `offsets` holds that of the first of every chunk. One invocation a chunk.

@group(0) @binding(0) var<uniform> scan: ScanParams;
@group(0) @binding(1) var<storage, read> offsets: array<u32>;
@group(0) @binding(2) var<storage, read_write> values: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let chunk = group.x * 64u + lane;
    let start = chunk * SCAN_CHUNK;
    if start >= scan.count {
        return;
    }
    let end = min(start + SCAN_CHUNK, scan.count);
    var sum = offsets[chunk];
    for (var i = start; i < end; i += 1u) {
        let value = values[i];
        values[i] = sum;
        sum += value;
    }
}
