// Dispatches of more workgroups than fit along one axis: rows of MAX_WORKGROUPS, one above the other.

fn flat_group(group: vec3<u32>) -> u32 {
    return group.y * MAX_WORKGROUPS + group.x;
}

// Workgroups along x and y of `count` in all; some of the last row are too many.
fn grid_of(count: u32) -> vec2<u32> {
    return vec2<u32>(min(count, MAX_WORKGROUPS), (count + MAX_WORKGROUPS - 1u) / MAX_WORKGROUPS);
}
