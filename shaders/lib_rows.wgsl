// The constant-time segment test: row_test.rs and row_bits.rs, line by line. Everything after the lattice is in integers,
// so that all processors agree on every bit.

struct RowTestParams {
    center: vec3<f32>,
    bits: u32,
    steps_per_metre: vec3<f32>,
    normal_quarter: i32,
    normal_steps: vec3<f32>,
    skip: i32,
    split: u32,
    consensus: u32,
    zero: u32,
    reserved: u32,
}

struct PackedFrame {
    words: array<vec4<u32>, 3>,
}

struct TestFrame {
    raw_from_lattice: RowMatrix,
    offset: vec3<i32>,
    edge_squared: vec3<i32>,
    // Texel of the tile.
    corner: vec3<i32>,
}

// Rows of a matrix.
struct RowMatrix {
    u: vec3<i32>,
    v: vec3<i32>,
    w: vec3<i32>,
}

@group(0) @binding(METHOD_BINDING) var<uniform> row_params: RowTestParams;
// For each cell of the direction table the direction, two cells a word.
@group(0) @binding(METHOD_BINDING + 1u) var<storage, read> table_cells: array<u32>;
// For each direction the tile that answers for it.
@group(0) @binding(METHOD_BINDING + 2u) var<storage, read> tile_table: array<u32>;
// One frame a tile.
@group(0) @binding(METHOD_BINDING + 3u) var<storage, read> packed_frames: array<PackedFrame>;
@group(0) @binding(METHOD_BINDING + 4u) var rows_texture: texture_2d_array<u32>;

fn within(v: vec3<f32>, limit: f32) -> bool {
    return all((bitcast<vec3<u32>>(v) & vec3<u32>(0x7fffffffu)) <= vec3<u32>(bitcast<u32>(limit)));
}

fn max_abs(v: vec3<f32>) -> f32 {
    let a = abs(v);
    return max(max(a.x, a.y), a.z);
}

// What no compiler can look through: no product before it is fused with a sum after it.
fn opaque_to_compilers(v: vec3<f32>) -> vec3<f32> {
    return bitcast<vec3<f32>>(bitcast<vec3<u32>>(v) | vec3<u32>(row_params.zero));
}

fn lattice_from_world(position: vec3<f32>) -> vec3<f32> {
    return (position - row_params.center) * row_params.steps_per_metre;
}

fn table_border(column: i32, major: f32) -> f32 {
    return (f32(column) * (2.0 / f32(TABLE_SIDE)) - 1.0) * major;
}

fn table_column(minor: f32, major: f32) -> u32 {
    let last = i32(TABLE_SIDE) - 1;
    let proposed = clamp(i32(floor((minor / major + 1.0) * f32(TABLE_SIDE / 2u))), 0, last);
    let down = select(0, 1, minor < table_border(proposed, major));
    let up = select(0, 1, minor >= table_border(proposed + 1, major));
    return u32(clamp(proposed - down + up, 0, last));
}

fn table_cell(d: vec3<f32>) -> u32 {
    let a = abs(d);
    var face = 2u;
    var v = d.zxy;
    if a.x >= a.y && a.x >= a.z {
        face = 0u;
        v = d.xyz;
    } else if a.y >= a.z {
        face = 1u;
        v = d.yzx;
    }
    v *= select(1.0, -1.0, v.x < 0.0);
    return (face * TABLE_SIDE + table_column(v.y, v.x)) * TABLE_SIDE + table_column(v.z, v.x);
}

struct LatticeSegment {
    origin: vec3<i32>,
    way: vec3<i32>,
    // Shares of the segment before the origin, and that are left.
    cut: f32,
    share: f32,
    is_valid: bool,
}

fn shortening(length: f32) -> f32 {
    let exponent = i32(bitcast<u32>(length) >> 23u) - 127;
    return bitcast<f32>(u32(127 - max(exponent - 15, 0)) << 23u);
}

fn to_steps(v: vec3<f32>) -> vec3<i32> {
    return vec3<i32>(floor(v));
}

fn cut_segment(origin: vec3<f32>, way: vec3<f32>) -> LatticeSegment {
    let share = shortening(max_abs(way));
    let is_valid = within(way, LONGEST) && !within(way, SHORTEST);
    return LatticeSegment(to_steps(origin), to_steps(way * share), 0.0, share, is_valid);
}

fn is_beyond(a: vec3<f32>, b: vec3<f32>) -> bool {
    let edge = vec3<f32>(ROW_LATTICE);
    return any((a > edge) & (b > edge)) || any((a < -edge) & (b < -edge));
}

fn cut_far_segment(origin: vec3<f32>, end: vec3<f32>) -> LatticeSegment {
    var none: LatticeSegment;
    if !within(origin, LONGEST) || !within(end, LONGEST) {
        return none;
    }
    var first = origin;
    var last = end;
    var cut = 0.0;
    var share = 1.0;
    var pivot = end;
    var pivot_at = 1.0;
    if max_abs(end) > NEAR_STEPS {
        for (var halvings = 0u; ; halvings += 1u) {
            if halvings == MAX_HALVINGS || is_beyond(first, last) {
                return none;
            }
            let middle = first * 0.5 + last * 0.5;
            let half = share * 0.5;
            if max_abs(middle) <= NEAR_STEPS {
                pivot = middle;
                pivot_at = cut + half;
                break;
            }
            if is_beyond(first, middle) {
                first = middle;
                cut += half;
            } else {
                last = middle;
            }
            share = half;
        }
    }
    let before = first - pivot;
    let after = last - pivot;
    let s = shortening(max_abs(before));
    let e = shortening(max_abs(after));
    let start_at = pivot_at - (pivot_at - cut) * s;
    return LatticeSegment(
        to_steps(pivot + before * s),
        to_steps(after * e - before * s),
        start_at,
        pivot_at + (cut + share - pivot_at) * e - start_at,
        true,
    );
}

struct RowPart {
    // Along u and v.
    row: vec2<i32>,
    first: i32,
    last: i32,
    // To the neighbours on the segment's side.
    step: vec2<i32>,
}

struct RowPlan {
    near: RowPart,
    far: RowPart,
    origin_w: i32,
    way_w: i32,
}

fn low_half(word: u32) -> i32 {
    return i32(word << 16u) >> 16u;
}

fn high_half(word: u32) -> i32 {
    return i32(word) >> 16u;
}

fn test_frame(tile: u32) -> TestFrame {
    let a = packed_frames[tile].words[0];
    let b = packed_frames[tile].words[1];
    let c = packed_frames[tile].words[2];
    return TestFrame(
        RowMatrix(
            vec3<i32>(low_half(a.x), high_half(a.x), low_half(a.y)),
            vec3<i32>(high_half(a.y), low_half(a.z), high_half(a.z)),
            vec3<i32>(low_half(a.w), high_half(a.w), low_half(b.x)),
        ),
        vec3<i32>(i32(b.z), i32(b.w), i32(c.x)),
        vec3<i32>(high_half(b.x), low_half(b.y), high_half(b.y)),
        vec3<i32>(i32(c.y & 0xffffu), i32(c.y >> 16u), i32(c.z)),
    );
}

fn times(m: RowMatrix, v: vec3<i32>) -> vec3<i32> {
    return vec3<i32>(
        m.u.x * v.x + m.u.y * v.y + m.u.z * v.z,
        m.v.x * v.x + m.v.y * v.y + m.v.z * v.z,
        m.w.x * v.x + m.w.y * v.y + m.w.z * v.z,
    );
}

fn row_part(at: vec2<i32>, start: i32, end: i32, upwards: bool) -> RowPart {
    let shift = TEST_RAW_BITS - row_params.bits;
    let size = 1i << row_params.bits;
    let row = at >> vec2<u32>(shift);
    let low = select(end, start, upwards);
    let high = select(start, end, upwards);
    let is_inside = ((row.x | row.y) & ~(size - 1)) == 0 && low <= high;
    let first = select(1, max(low >> shift, 0), is_inside);
    let last = select(0, min(high >> shift, size - 1), is_inside);
    let side = vec2<i32>((at >> vec2<u32>(shift - 1u)) & vec2<i32>(1));
    return RowPart(row & vec2<i32>(size - 1), first, last, side * 2 - 1);
}

fn plan_rows(frame: TestFrame, segment: LatticeSegment, normal_steps: vec3<i32>) -> RowPlan {
    let matrix = frame.raw_from_lattice;
    let raw = times(matrix, segment.origin) + frame.offset;
    let way = times(matrix, segment.way);
    let normal = (times(matrix, normal_steps) >> vec3<u32>(NORMAL_DROP)) * frame.edge_squared;
    let size = abs(normal);
    let largest = max(max(size.x, size.y), size.z);
    let eight = size * 8;
    let quarters = select(vec3<i32>(0), vec3<i32>(1), eight > vec3<i32>(largest))
        + select(vec3<i32>(0), vec3<i32>(1), eight > vec3<i32>(largest * 3))
        + select(vec3<i32>(0), vec3<i32>(1), eight > vec3<i32>(largest * 5))
        + select(vec3<i32>(0), vec3<i32>(1), eight > vec3<i32>(largest * 7));
    let shift = quarters * row_params.normal_quarter;
    let lifted = raw + select(shift, -shift, normal < vec3<i32>(0));
    let skip = select(row_params.skip, 0, largest == 0);
    let end = raw + way;
    let along = end - lifted;
    let upwards = way.z >= 0;
    let start = lifted.z + select(-skip, skip, upwards);
    let border = lifted.z + (along.z >> 2u);
    let is_split = row_params.split == 1u;
    let eighth = vec2<u32>(3u);
    let single = lifted.xy + (along.xy >> eighth) + (along.xy >> vec2<u32>(4u));
    let near_at = select(single, lifted.xy + (along.xy >> eighth), is_split);
    let far_at = lifted.xy + (along.xy >> vec2<u32>(1u)) + (along.xy >> eighth);
    // Where skipping the origin's surface skips the first row's piece, it goes on in the second.
    let is_skipped = select((start < border), (start > border), upwards);
    var far = row_part(far_at, select(border, start, is_skipped), end.z, upwards);
    far.last = select(-1, far.last, is_split);
    return RowPlan(row_part(near_at, start, select(end.z, border, is_split), upwards), far, raw.z, way.z);
}

fn texels_a_row() -> i32 {
    return 1i << max(row_params.bits, 7u) >> 7u;
}

fn row_texel(corner: vec3<i32>, row: vec2<i32>, texel: i32) -> vec4<u32> {
    return textureLoad(rows_texture, corner.xy + vec2<i32>(row.x * texels_a_row() + texel, row.y), corner.z, 0);
}

// A texel of a row with every bit spread to its neighbours; nothing outside the grid.
fn beside(corner: vec3<i32>, row: vec2<i32>, texel: i32) -> vec4<u32> {
    if ((row.x | row.y) & ~((1i << row_params.bits) - 1)) != 0 {
        return vec4<u32>(0u);
    }
    let here = row_texel(corner, row, texel);
    var before = 0u;
    var after = 0u;
    if texels_a_row() > 1 {
        if texel > 0 {
            before = row_texel(corner, row, texel - 1).w;
        }
        if texel + 1 < texels_a_row() {
            after = row_texel(corner, row, texel + 1).x;
        }
    }
    return here | (here << vec4<u32>(1u)) | (here >> vec4<u32>(1u))
        | (vec4<u32>(before, here.xyz) >> vec4<u32>(31u)) | (vec4<u32>(here.yzw, after) << vec4<u32>(31u));
}

// The bits of a part in one texel that count.
fn found_bits(corner: vec3<i32>, part: RowPart, texel: i32) -> vec4<u32> {
    let word = vec4<i32>(0, 32, 64, 96) + vec4<i32>(128 * texel);
    let lowest = max(vec4<i32>(part.first) - word, vec4<i32>(0));
    let highest = min(vec4<i32>(part.last) - word, vec4<i32>(31));
    let mask = (vec4<u32>(0xffffffffu) >> vec4<u32>(31 - (highest - lowest))) << vec4<u32>(lowest);
    var found = select(vec4<u32>(0u), row_texel(corner, part.row, texel) & mask, lowest <= highest);
    if row_params.consensus == 1u && any(found != vec4<u32>(0u)) {
        found &= beside(corner, part.row + vec2<i32>(part.step.x, 0), texel);
        if any(found != vec4<u32>(0u)) {
            found &= beside(corner, part.row + vec2<i32>(0, part.step.y), texel);
        }
    }
    return found;
}

// The first bit of a part, seen from its start or from its end; -1 if there is none.
fn first_bit(corner: vec3<i32>, part: RowPart, upwards: bool) -> i32 {
    if part.first > part.last {
        return -1;
    }
    let lowest = part.first >> 7u;
    let highest = part.last >> 7u;
    for (var i = 0; i <= highest - lowest; i += 1) {
        let texel = select(highest - i, lowest + i, upwards);
        let found = found_bits(corner, part, texel);
        for (var k = 0; k < 4; k += 1) {
            let word = select(3 - k, k, upwards);
            if found[word] != 0u {
                let bit = select(firstLeadingBit(found[word]), firstTrailingBit(found[word]), upwards);
                return texel * 128 + word * 32 + i32(bit);
            }
        }
    }
    return -1;
}

fn any_bit(corner: vec3<i32>, part: RowPart) -> bool {
    for (var texel = part.first >> 7u; texel <= part.last >> 7u; texel += 1) {
        if any(found_bits(corner, part, texel) != vec4<u32>(0u)) {
            return true;
        }
    }
    return false;
}

struct RowTest {
    plan: RowPlan,
    segment: LatticeSegment,
    // Texel of the direction's tile.
    corner: vec3<i32>,
}

fn row_test(origin: vec3<f32>, end: vec3<f32>, normal: vec3<f32>) -> RowTest {
    var test: RowTest;
    let way = end - origin;
    let from_center = lattice_from_world(origin);
    var normal_steps = vec3<i32>(floor(normal * row_params.normal_steps));
    if within(from_center, NEAR_STEPS) {
        test.segment = cut_segment(from_center, way * row_params.steps_per_metre);
    } else {
        test.segment =
            cut_far_segment(opaque_to_compilers(from_center), opaque_to_compilers(lattice_from_world(end)));
        // So far away no surface is the origin's.
        normal_steps = vec3<i32>(0);
    }
    if test.segment.is_valid {
        let cell = table_cell(way);
        let direction = (table_cells[cell >> 1u] >> (16u * (cell & 1u))) & 0xffffu;
        let frame = test_frame(tile_table[direction]);
        test.corner = frame.corner;
        test.plan = plan_rows(frame, test.segment, normal_steps);
    }
    return test;
}

fn is_hidden(origin: vec3<f32>, end: vec3<f32>, normal: vec3<f32>) -> bool {
    let test = row_test(origin, end, normal);
    return test.segment.is_valid && (any_bit(test.corner, test.plan.near) || any_bit(test.corner, test.plan.far));
}

// Metres to the near face of the first voxel; negative where nothing is hit.
fn hit_distance(origin: vec3<f32>, end: vec3<f32>, normal: vec3<f32>) -> f32 {
    let test = row_test(origin, end, normal);
    if !test.segment.is_valid {
        return -1.0;
    }
    let upwards = test.plan.way_w >= 0;
    var bit = first_bit(test.corner, test.plan.near, upwards);
    if bit < 0 {
        bit = first_bit(test.corner, test.plan.far, upwards);
    }
    if bit < 0 {
        return -1.0;
    }
    let face = (bit + select(1, 0, upwards)) << (TEST_RAW_BITS - row_params.bits);
    var share = 0.0;
    if test.plan.way_w != 0 {
        share = clamp(f32(face - test.plan.origin_w) / f32(test.plan.way_w), 0.0, 1.0);
    }
    let way = end - origin;
    return (test.segment.cut + test.segment.share * share) * sqrt(way.x * way.x + way.y * way.y + way.z * way.z);
}
