// What every stage that rasterizes is told.

struct RasterParams {
    // Voxels to fill: smallest, and one past the largest.
    clip_min: vec3<i32>,
    grid_bits: u32,
    clip_max: vec3<i32>,
    sub_bits: u32,
    // Distance in bits between neighbouring voxels along each axis, and between directions.
    bit_stride: vec3<u32>,
    direction_stride: u32,
    triangles: u32,
    // 0 if vertices are in the grid's lattice already.
    directions: u32,
    // Fragments there is room for.
    capacity: u32,
    reserved: u32,
}
