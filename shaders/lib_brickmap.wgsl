// Marching through a brickmap, operation by operation as brickmap.rs does; see there.

struct BrickmapParams {
    origin: vec3<f32>,
    cells_per_metre: f32,
    side: u32,
    coarse_bits: u32,
    normal_cells: f32,
    skip_cells: f32,
}

@group(0) @binding(METHOD_BINDING) var<uniform> brickmap: BrickmapParams;
// x fastest: the block of a coarse cell, or BRICKMAP_EMPTY plus log2 of the cells a side that are empty around it.
@group(0) @binding(METHOD_BINDING + 1u) var<storage, read> coarse: array<u32>;
// Mask of bricks (low, high half), first brick, 0.
@group(0) @binding(METHOD_BINDING + 2u) var<storage, read> blocks: array<vec4<u32>>;
// Mask of cells (low, high half).
@group(0) @binding(METHOD_BINDING + 3u) var<storage, read> bricks: array<vec2<u32>>;

// Number of a cell in a group of 4^3, in Morton order: eight that are neighbours follow each other.
fn group_bit(p: vec3<u32>) -> u32 {
    let low = p & vec3<u32>(1u);
    let high = p & vec3<u32>(2u);
    return low.x | (low.y << 1u) | (low.z << 2u) | (high.x << 2u) | (high.y << 3u) | (high.z << 4u);
}

// log2 of the empty cells a side around `cell`, or 32 if it is set. `*brick_at` is the brick that `*bits` are of: rays
// stay in a brick for some steps.
fn empty_bits(cell: vec3<u32>, brick_at: ptr<function, vec3<u32>>, bits: ptr<function, vec2<u32>>) -> u32 {
    let brick_cell = cell >> vec3<u32>(2u);
    if any(brick_cell != *brick_at) {
        let at = cell >> vec3<u32>(4u);
        let entry = coarse[(((at.z << brickmap.coarse_bits) | at.y) << brickmap.coarse_bits) | at.x];
        if entry >= BRICKMAP_EMPTY {
            return entry - BRICKMAP_EMPTY;
        }
        let block = blocks[entry];
        let brick = group_bit(brick_cell);
        let in_high = brick >= 32u;
        let word = select(block.x, block.y, in_high);
        let shift = brick & 31u;
        if ((word >> shift) & 1u) == 0u {
            return select(3u, 2u, ((word >> (shift & 24u)) & 255u) != 0u);
        }
        let before = countOneBits(word & ((1u << shift) - 1u)) + select(0u, countOneBits(block.x), in_high);
        *brick_at = brick_cell;
        *bits = bricks[block.z + before];
    }
    let index = group_bit(cell);
    let half = select((*bits).x, (*bits).y, index >= 32u);
    let bit = index & 31u;
    if ((half >> bit) & 1u) == 1u {
        return 32u;
    }
    return select(1u, 0u, ((half >> (bit & 24u)) & 255u) != 0u);
}

// Distance in metres to the first set cell, or -1.
fn march(origin: vec3<f32>, end: vec3<f32>, normal: vec3<f32>) -> f32 {
    let scale = brickmap.cells_per_metre;
    var start = (origin - brickmap.origin) * scale + normal * brickmap.normal_cells;
    var along = (end - brickmap.origin) * scale - start;
    let length = sqrt(along.x * along.x + along.y * along.y + along.z * along.z);
    var t = 0.0;
    if any(normal != vec3<f32>(0.0)) {
        let cosine = abs(along.x * normal.x + along.y * normal.y + along.z * normal.z) / length;
        t = brickmap.skip_cells / max(cosine, MIN_COSINE) / length;
    }
    // Mirrored, so that the ray never runs backwards.
    let side = f32(brickmap.side);
    let backwards = along < vec3<f32>(0.0);
    let mirror = select(vec3<u32>(0u), vec3<u32>(brickmap.side - 1u), backwards);
    start = select(start, vec3<f32>(side) - start, backwards);
    along = abs(along);
    let inverse = vec3<f32>(1.0) / max(along, vec3<f32>(MIN_DIRECTION));
    let enter = -start * inverse;
    let leave = (vec3<f32>(side) - start) * inverse;
    t = max(t, max(enter.x, max(enter.y, enter.z)));
    let t_end = min(min(1.0, leave.x), min(leave.y, leave.z));
    // Written so that NaN is no hit.
    if !(t < t_end) {
        return -1.0;
    }
    // No number here is below -1: cutting off fractions rounds down, but for those that are clamped anyway.
    var cell = clamp(vec3<i32>(start + along * t), vec3<i32>(0i), vec3<i32>(i32(brickmap.side) - 1i));
    var brick_at = vec3<u32>(BRICKMAP_EMPTY);
    var bits = vec2<u32>(0u);
    finished = false;
    while steps_left > 0u {
        steps_left -= 1u;
        let empty = empty_bits(vec3<u32>(cell) ^ mirror, &brick_at, &bits);
        if empty == 32u {
            finished = true;
            return t * length / scale;
        }
        // Out of the empty cube, through the nearest of its far planes: their distances follow start whole numbers
        // alone. Along the other axes the ray stays in the cube, whatever rounding says.
        let far = (cell | vec3<i32>((1i << empty) - 1i)) + vec3<i32>(1i);
        let planes = (vec3<f32>(far) - start) * inverse;
        t = max(t, min(planes.x, min(planes.y, planes.z)));
        if !(t < t_end) {
            finished = true;
            return -1.0;
        }
        let next = clamp(vec3<i32>(start + along * t), cell, far - vec3<i32>(1i));
        let x_first = planes.x <= planes.y && planes.x <= planes.z;
        let y_first = !x_first && planes.y <= planes.z;
        cell = select(next, far, vec3<bool>(x_first, y_first, !x_first && !y_first));
        if any(cell >= vec3<i32>(i32(brickmap.side))) {
            finished = true;
            return -1.0;
        }
    }
    return -1.0;
}

fn is_hidden(origin: vec3<f32>, end: vec3<f32>, normal: vec3<f32>) -> bool {
    return march(origin, end, normal) >= 0.0;
}

fn hit_distance(origin: vec3<f32>, end: vec3<f32>, normal: vec3<f32>) -> f32 {
    return march(origin, end, normal);
}
