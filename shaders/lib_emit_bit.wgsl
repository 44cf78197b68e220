// A fragment sets its voxel's bit. Writes the global `bits`.

fn emit(p: Projected, s: Sample, triangle: u32, direction: u32, voxel: vec3<i32>) {
    let at = vec3<u32>(voxel - params.clip_min) * params.bit_stride;
    let bit = direction * params.direction_stride + at.x + at.y + at.z;
    atomicOr(&bits[bit >> 5u], 1u << (bit & 31u));
}
