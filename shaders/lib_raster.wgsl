// Which pixels a triangle covers and at which depth: the arithmetic of raster.rs in 32 bits.
//
// Lattice coordinates have 15 bits, so twice the area of any triangle inside the triangle's bounds (that is, every
// edge function evaluated there) is below 2^30.

// One triangle set up for one projection axis. x and y are the pixel axes, z the depth axis.
struct Projected {
    a: vec3<i32>,
    b: vec3<i32>,
    c: vec3<i32>,
    // Twice the projected area; 0 if there is nothing to draw.
    area: i32,
    // Whether vertices 1 and 2 were exchanged to make the area positive.
    swapped: bool,
    // Pixels to visit, inclusive, within the clip box.
    pixel_min: vec2<i32>,
    pixel_max: vec2<i32>,
}

struct Sample {
    inside: bool,
    // Voxel along the depth axis.
    depth: i32,
    // Edge functions opposite the original vertices 1 and 2.
    edges: vec2<i32>,
}

// World axes to (x, y, z) of a projection: ((axis + 1) % 3, (axis + 2) % 3, axis).
fn to_projection(v: vec3<i32>, axis: u32) -> vec3<i32> {
    return select(select(v, v.zxy, axis == 1u), v.yzx, axis == 0u);
}

fn from_projection(v: vec3<i32>, axis: u32) -> vec3<i32> {
    return select(select(v, v.yzx, axis == 1u), v.zxy, axis == 0u);
}

fn cross_xy(p: vec3<i32>, q: vec3<i32>, r: vec3<i32>) -> i32 {
    return (q.x - p.x) * (r.y - p.y) - (q.y - p.y) * (r.x - p.x);
}

fn project(
    vertices: array<vec3<i32>, 3>,
    axis: u32,
    sub_bits: u32,
    clip_min: vec3<i32>,
    clip_max: vec3<i32>,
) -> Projected {
    var p: Projected;
    p.a = to_projection(vertices[0], axis);
    p.b = to_projection(vertices[1], axis);
    p.c = to_projection(vertices[2], axis);
    let step = 1i << sub_bits;
    let half = step >> 1u;
    let lo = min(p.a.xy, min(p.b.xy, p.c.xy));
    let hi = max(p.a.xy, max(p.b.xy, p.c.xy));
    p.pixel_min = max((lo - half + step - 1i) >> vec2<u32>(sub_bits), to_projection(clip_min, axis).xy);
    p.pixel_max = min((hi - half) >> vec2<u32>(sub_bits), to_projection(clip_max, axis).xy - 1i);
    p.area = 0;
    if any(p.pixel_min > p.pixel_max) {
        return p;
    }
    p.area = cross_xy(p.a, p.b, p.c);
    p.swapped = p.area < 0;
    if p.swapped {
        let b = p.b;
        p.b = p.c;
        p.c = b;
        p.area = -p.area;
    }
    return p;
}

// An edge owns the centres on it if it is a left or a top edge; any other must be passed by one.
fn edge_bias(p: vec3<i32>, q: vec3<i32>) -> i32 {
    let d = q.xy - p.xy;
    return select(-1i, 0i, d.y < 0 || (d.y == 0 && d.x > 0));
}

fn sample_pixel(p: Projected, pixel: vec2<i32>, sub_bits: u32) -> Sample {
    var s: Sample;
    let center = vec3<i32>((pixel << vec2<u32>(sub_bits)) + (1i << (sub_bits - 1u)), 0);
    let e1 = cross_xy(p.c, p.a, center);
    let e2 = cross_xy(p.a, p.b, center);
    let e0 = p.area - e1 - e2;
    s.inside = e0 + edge_bias(p.b, p.c) >= 0 && e1 + edge_bias(p.c, p.a) >= 0 && e2 + edge_bias(p.a, p.b) >= 0;
    if !s.inside {
        return s;
    }
    // The quotient floor(sum(e * z) / area) has 15 bits, so that a float is wrong by less than one; the remainder
    // then lies in (-area, 2 * area) and 32 bits that wrap around know it exactly.
    let estimate = f32(e0) * f32(p.a.z) + f32(e1) * f32(p.b.z) + f32(e2) * f32(p.c.z);
    var quotient = i32(floor(estimate / f32(p.area)));
    let rest = e0 * p.a.z + e1 * p.b.z + e2 * p.c.z - quotient * p.area;
    quotient += select(select(0i, 1i, rest >= p.area), -1i, rest < 0);
    s.depth = quotient >> sub_bits;
    s.edges = select(vec2<i32>(e1, e2), vec2<i32>(e2, e1), p.swapped);
    return s;
}

// Weights of vertices 1 and 2 in units of 2^-15.
fn barycentric(p: Projected, s: Sample) -> vec2<u32> {
    let shift = 16u - min(countLeadingZeros(u32(p.area)), 16u);
    return ((vec2<u32>(s.edges) >> vec2<u32>(shift)) << vec2<u32>(15u)) / (u32(p.area) >> shift);
}
