// Directions' frames. Reads the global `frames`.

struct DirectionFrame {
    row_from_lattice: array<array<i32, 3>, 3>,
    offset: array<i32, 3>,
}

// A direction's axes; the fourth component is the offset.
struct Axes {
    u: vec4<i32>,
    v: vec4<i32>,
    w: vec4<i32>,
}

fn axis_of(direction: u32, axis: u32) -> vec4<i32> {
    return vec4<i32>(
        frames[direction].row_from_lattice[axis][0],
        frames[direction].row_from_lattice[axis][1],
        frames[direction].row_from_lattice[axis][2],
        frames[direction].offset[axis],
    );
}

fn axes_of(direction: u32) -> Axes {
    return Axes(axis_of(direction, 0u), axis_of(direction, 1u), axis_of(direction, 2u));
}

// Raw coordinates of a point of the row lattice, ROW_RAW_BITS bits each.
fn raw_point(axes: Axes, p: vec3<i32>) -> vec3<i32> {
    let raw = vec3<i32>(
        dot(axes.u.xyz, p) + axes.u.w,
        dot(axes.v.xyz, p) + axes.v.w,
        dot(axes.w.xyz, p) + axes.w.w,
    );
    return clamp(raw, vec3<i32>(0i), vec3<i32>((1i << ROW_RAW_BITS) - 1i));
}
