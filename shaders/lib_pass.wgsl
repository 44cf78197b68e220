// One pass of MegaViews: a run of sorted views, their hierarchy and its maps. See mega_views.rs.

struct PassParams {
    resolution: u32,
    // Texels of a map.
    texels: u32,
    // Resolution over the texels that a node may fill and still be drawn as a point.
    scale: f32,
    culling: u32,
    // The run: its first view and how many there are.
    run_start: u32,
    run_count: u32,
    // 1 if all views in one voxel share a map.
    sharing: u32,
    // Invocations that share a near pair; a power of two.
    near_lanes: u32,
    // Room for nodes and maps, pairs of the queue, and near pairs.
    node_capacity: u32,
    pair_capacity: u32,
    near_capacity: u32,
    half_depths: u32,
    // Workgroups that share a map where it is cleared, fused or packed.
    slices: u32,
    // 1 if behind all depths `maps` holds, texel for texel, numbers of scene nodes.
    with_numbers: u32,
    // 1 to draw those numbers: all depths are known.
    draws_numbers: u32,
    reserved: u32,
}

// Where the node number of a texel stands in `maps`, of which `at` is the depth.
fn number_at(at: u32) -> u32 {
    return pass_params.node_capacity * pass_params.texels + at;
}
