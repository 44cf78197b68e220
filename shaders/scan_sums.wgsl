// Sums of every SCAN_CHUNK values, the first half of a prefix sum. One invocation a chunk: barriers between invocations cost
// more than they save where the device is a processor.

@group(0) @binding(0) var<uniform> scan: ScanParams;
@group(0) @binding(1) var<storage, read> values: array<u32>;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let chunk = group.x * 64u + lane;
    let start = chunk * SCAN_CHUNK;
    if start >= scan.count {
        return;
    }
    let end = min(start + SCAN_CHUNK, scan.count);
    var sum = 0u;
    for (var i = start; i < end; i += 1u) {
        sum += values[i];
    }
    sums[chunk] = sum;
}
