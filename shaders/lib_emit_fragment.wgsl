// A fragment is appended to the global `fragments`. Nothing is counted once the list is full, so that the count never
// wraps around; `overflow` then says that the list is not complete.

struct PackedFragment {
    voxel: u32,
    triangle: u32,
    barycentric: u32,
}

struct FragmentList {
    count: atomic<u32>,
    overflow: atomic<u32>,
    items: array<PackedFragment>,
}

fn emit(p: Projected, s: Sample, triangle: u32, direction: u32, voxel: vec3<i32>) {
    if atomicLoad(&fragments.count) >= params.capacity {
        atomicStore(&fragments.overflow, 1u);
        return;
    }
    let slot = atomicAdd(&fragments.count, 1u);
    if slot >= params.capacity {
        atomicStore(&fragments.overflow, 1u);
        return;
    }
    let at = vec3<u32>(voxel - params.clip_min);
    let weights = barycentric(p, s);
    fragments.items[slot] = PackedFragment(
        at.x | (at.y << 10u) | (at.z << 20u),
        triangles[triangle].index,
        weights.x | (weights.y << 16u),
    );
}
