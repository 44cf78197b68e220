// Directions' frames. Reads the global `frames`.

struct DirectionFrame {
    row_from_lattice: array<array<i32, 3>, 3>,
    offset: array<i32, 3>,
}

// Raw coordinate along one axis of a direction's frame, 29 bits.
fn raw_along(direction: u32, axis: u32, p: vec3<i32>) -> i32 {
    let raw = frames[direction].row_from_lattice[axis][0] * p.x + frames[direction].row_from_lattice[axis][1] * p.y
        + frames[direction].row_from_lattice[axis][2] * p.z + frames[direction].offset[axis];
    return clamp(raw, 0i, (1i << ROW_RAW_BITS) - 1i);
}
