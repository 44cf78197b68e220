// Triangles as they are stored, and their vertices in a direction's frame. Reads the globals `params` and
// `triangles`.

struct PackedTriangle {
    // Nine signed 16-bit coordinates, x y z of vertex 0 first; the last half word is 0.
    words: array<u32, 5>,
    // Index into `masks` or UNMASKED.
    mask: u32,
    // Index of the triangle in the job.
    index: u32,
}

fn low_i16(word: u32) -> i32 {
    return i32(word << 16u) >> 16u;
}

fn high_i16(word: u32) -> i32 {
    return i32(word) >> 16u;
}

fn grid_point(axes: Axes, p: vec3<i32>) -> vec3<i32> {
    return raw_point(axes, p) >> vec3<u32>(ROW_RAW_BITS - params.grid_bits - params.sub_bits);
}

fn triangle_vertices(triangle: u32, direction: u32) -> array<vec3<i32>, 3> {
    let w = triangles[triangle].words;
    let a = vec3<i32>(low_i16(w[0]), high_i16(w[0]), low_i16(w[1]));
    let b = vec3<i32>(high_i16(w[1]), low_i16(w[2]), high_i16(w[2]));
    let c = vec3<i32>(low_i16(w[3]), high_i16(w[3]), low_i16(w[4]));
    if params.directions == 0u {
        return array<vec3<i32>, 3>(a, b, c);
    }
    let axes = axes_of(direction);
    return array<vec3<i32>, 3>(grid_point(axes, a), grid_point(axes, b), grid_point(axes, c));
}
