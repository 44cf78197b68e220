// Begins the traversal anew with the pair of both roots. What a pass had no room for stays known: then nothing more is done.
// One invocation in all.

@group(0) @binding(0) var<storage, read_write> counters: array<u32>;
@group(0) @binding(1) var<storage, read_write> pairs: array<vec2<u32>>;

@compute @workgroup_size(1)
fn main() {
    pairs[0] = vec2<u32>(0u, PAIR_WHOLE);
    counters[COUNTER_QUEUED] = 1u;
    counters[COUNTER_NEAR] = 0u;
}
