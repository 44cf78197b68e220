// Draws a leaf that fills more than a texel as the cube it is: every texel whose middle ray meets it gets the distance
// where it enters. The stage has `keep(map, texel, distance, node)`.

// Below this sum of cosines a leaf's sphere reaches so far around a half's pole that the whole half is tried.
const WHOLE_HALF: f32 = 1e-3;

// First and last column or row, or first > last for none.
fn candidate_span(along: f32, reach: f32, resolution: u32) -> vec2<i32> {
    let half_side = f32(resolution) * 0.5;
    let first = max(ceil((along + 1.0 - reach) * half_side - 0.5), 0.0);
    let last = min(floor((along + 1.0 + reach) * half_side - 0.5), f32(resolution) - 1.0);
    return vec2<i32>(vec2<f32>(first, max(last, -1.0)));
}

// First and last column, first and last row of a half whose texels' middles the sphere around a cube may cover.
fn leaf_candidates(half: u32, offset: vec3<f32>, len: f32, edge: f32, resolution: u32) -> vec4<i32> {
    let whole = vec4<i32>(0, i32(resolution) - 1, 0, i32(resolution) - 1);
    let radius = SPHERE_OF_CUBE * edge;
    if len <= radius {
        return whole;
    }
    let cos_middle = select(-offset.x, offset.x, half == 0u) / len;
    let sin_beta = radius / len;
    let sum = cos_middle + sqrt(max(1.0 - sin_beta * sin_beta, 0.0));
    if sum <= WHOLE_HALF {
        return select(vec4<i32>(0, -1, 0, -1), whole, cos_middle + sin_beta >= 0.0);
    }
    let reach = sin_beta / sum;
    return vec4<i32>(
        candidate_span(offset.y / len / sum, reach, resolution),
        candidate_span(offset.z / len / sum, reach, resolution),
    );
}

// The part of lane `lane` of `lanes`, for a leaf that does not hold the middle of the map.
fn draw_near_leaf(
    map: u32,
    leaf: u32,
    offset: vec3<f32>,
    edge: f32,
    resolution: u32,
    lane: u32,
    lanes: u32,
) {
    let len = sqrt(dot(offset, offset));
    if !(len > 0.0) {
        return;
    }
    if lane == 0u {
        keep(map, paraboloid_texel(offset, len, resolution), len, leaf);
    }
    let low = offset - edge * 0.5;
    let high = offset + edge * 0.5;
    for (var half = 0u; half < 2u; half += 1u) {
        let span = leaf_candidates(half, offset, len, edge, resolution);
        if span.x > span.y || span.z > span.w {
            continue;
        }
        let columns = u32(span.y - span.x + 1);
        let count = columns * u32(span.w - span.z + 1);
        for (var i = lane; i < count; i += lanes) {
            let column = u32(span.x) + i % columns;
            let row = u32(span.z) + i / columns;
            if !is_inside(column, row, resolution) {
                continue;
            }
            let texel = (half * resolution + row) * resolution + column;
            let inverse = 1.0 / texel_direction(texel, resolution);
            let a = low * inverse;
            let b = high * inverse;
            let near = min(a, b);
            let far = max(a, b);
            let enter = max(near.x, max(near.y, near.z));
            if enter <= min(far.x, min(far.y, far.z)) && enter > 0.0 {
                keep(map, texel, enter, leaf);
            }
        }
    }
}
