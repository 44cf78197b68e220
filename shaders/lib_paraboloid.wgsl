// The dual paraboloid; see paraboloid.rs.

// Index of the texel that an offset of length `len`, which is not 0, falls in.
fn paraboloid_texel(offset: vec3<f32>, len: f32, resolution: u32) -> u32 {
    let scale = 1.0 / (len + abs(offset.x));
    let at = (offset.yz * scale + 1.0) * (f32(resolution) * 0.5);
    let place = min(vec2<u32>(max(at, vec2<f32>(0.0))), vec2<u32>(resolution - 1u));
    return (select(0u, 1u, offset.x < 0.0) * resolution + place.y) * resolution + place.x;
}

// Unit direction of the middle of a texel.
fn texel_direction(index: u32, resolution: u32) -> vec3<f32> {
    let row = index / resolution;
    let at = vec2<f32>(vec2<u32>(index % resolution, row % resolution)) + 0.5;
    let ab = at / f32(resolution) * 2.0 - 1.0;
    let square = dot(ab, ab);
    let scale = 1.0 / (1.0 + square);
    let x = (1.0 - square) * scale;
    return vec3<f32>(select(-x, x, row < resolution), 2.0 * ab * scale);
}

// Whether the middle of the texel in a column and row of a half lies in the disc that the half fills.
fn is_inside(column: u32, row: u32, resolution: u32) -> bool {
    let a = vec2<i32>(vec2<u32>(column, row) * 2u + 1u) - i32(resolution);
    return a.x * a.x + a.y * a.y <= i32(resolution * resolution);
}
