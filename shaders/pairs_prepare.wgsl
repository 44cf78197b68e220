// Makes what the last step queued the next step's pairs. One invocation in all.

@group(0) @binding(0) var<uniform> pass_params: PassParams;
@group(0) @binding(1) var<storage, read> tree: array<u32>;
@group(0) @binding(2) var<storage, read_write> counters: array<u32>;
// Workgroups of the next step, and of the near pairs so far.
@group(0) @binding(3) var<storage, read_write> arguments: array<u32>;

@compute @workgroup_size(1)
fn main() {
    counters[COUNTER_FLAGS] |= tree[TREE_FLAGS];
    let queued = counters[COUNTER_QUEUED];
    let near = counters[COUNTER_NEAR];
    counters[COUNTER_MOST] = max(counters[COUNTER_MOST], queued);
    if queued > pass_params.pair_capacity {
        counters[COUNTER_FLAGS] |= FLAG_PAIRS;
    }
    if near > pass_params.near_capacity {
        counters[COUNTER_FLAGS] |= FLAG_NEAR;
    }
    // A pass without room is done again: nothing more of it.
    let has_room = counters[COUNTER_FLAGS] == 0u;
    let pairs = select(0u, queued, has_room);
    counters[COUNTER_PAIRS] = pairs;
    counters[COUNTER_QUEUED] = 0u;
    let of_pairs = grid_of((pairs + 63u) / 64u);
    arguments[0] = of_pairs.x;
    arguments[1] = of_pairs.y;
    arguments[2] = 1u;
    let per_group = 64u / pass_params.near_lanes;
    let of_near = grid_of((select(0u, near, has_room) + per_group - 1u) / per_group);
    arguments[3] = of_near.x;
    arguments[4] = of_near.y;
    arguments[5] = 1u;
}
