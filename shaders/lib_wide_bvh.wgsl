// Traversal of a compressed wide BVH, operation by operation as wide_bvh.rs does; see there.

struct WideBvhParams {
    center: vec3<f32>,
    // Metres along the normal.
    lift: f32,
    nodes: u32,
    reserved_a: u32,
    reserved_b: u32,
    reserved_c: u32,
}

@group(0) @binding(METHOD_BINDING) var<uniform> tree: WideBvhParams;
// Five a node.
@group(0) @binding(METHOD_BINDING + 1u) var<storage, read> nodes: array<vec4<u32>>;
// Three a triangle: vertex 0 and mask, the edges to vertices 1 and 2.
@group(0) @binding(METHOD_BINDING + 2u) var<storage, read> triangles: array<vec4<f32>>;
@group(0) @binding(METHOD_BINDING + 3u) var<storage, read> masks: array<TriangleMask>;
@group(0) @binding(METHOD_BINDING + 4u) var<storage, read> planes: array<PackedPlane>;
@group(0) @binding(METHOD_BINDING + 5u) var<storage, read> alpha: array<u32>;

const BYTES: vec4<u32> = vec4<u32>(0u, 8u, 16u, 24u);

fn bytes(word: u32) -> vec4<f32> {
    return vec4<f32>((vec4<u32>(word) >> BYTES) & vec4<u32>(255u));
}


// Bits of the four children whose boxes the ray meets: inner ones from bit 24 on, primitives below.
fn children_met(
    meta4: u32, near_x: u32, near_y: u32, near_z: u32, far_x: u32, far_y: u32, far_z: u32,
    scale: vec3<f32>, shift: vec3<f32>, octant4: u32, t_max: f32,
) -> u32 {
    let near = max(
        max(bytes(near_x) * scale.x + shift.x, bytes(near_y) * scale.y + shift.y),
        max(bytes(near_z) * scale.z + shift.z, vec4<f32>(0.0)),
    );
    let far = min(
        min(bytes(far_x) * scale.x + shift.x, bytes(far_y) * scale.y + shift.y),
        min(bytes(far_z) * scale.z + shift.z, vec4<f32>(t_max)),
    );
    let inner4 = (((meta4 & (meta4 << 1u)) & 0x10101010u) >> 4u) * 0xffu;
    let index4 = (meta4 ^ (octant4 & inner4)) & 0x1f1f1f1fu;
    let child4 = (meta4 >> 5u) & 0x07070707u;
    let bits = ((vec4<u32>(child4) >> BYTES) & vec4<u32>(255u)) << ((vec4<u32>(index4) >> BYTES) & vec4<u32>(31u));
    let met = select(vec4<u32>(0u), bits, near <= far);
    return met.x | met.y | met.z | met.w;
}

// Distance in lengths of `along` where the ray meets triangle `index` before `t_max`, or -1.
fn meet(index: u32, start: vec3<f32>, along: vec3<f32>, t_max: f32) -> f32 {
    let first = triangles[3u * index];
    let e1 = triangles[3u * index + 1u].xyz;
    let e2 = triangles[3u * index + 2u].xyz;
    let p = vec3<f32>(
        along.y * e2.z - along.z * e2.y, along.z * e2.x - along.x * e2.z, along.x * e2.y - along.y * e2.x,
    );
    let determinant = e1.x * p.x + e1.y * p.y + e1.z * p.z;
    let s = start - first.xyz;
    let q = vec3<f32>(s.y * e1.z - s.z * e1.y, s.z * e1.x - s.x * e1.z, s.x * e1.y - s.y * e1.x);
    let inverse = 1.0 / determinant;
    let u = (s.x * p.x + s.y * p.y + s.z * p.z) * inverse;
    let v = (along.x * q.x + along.y * q.y + along.z * q.z) * inverse;
    let t = (e2.x * q.x + e2.y * q.y + e2.z * q.z) * inverse;
    // Written so that NaN is no hit.
    if !(determinant != 0.0 && u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 && t < t_max) {
        return -1.0;
    }
    let mask = bitcast<u32>(first.w);
    if mask != UNMASKED {
        let one = f32(1u << 15u);
        let w1 = min(u32(u * one), 1u << 15u);
        let w2 = min(u32(v * one), (1u << 15u) - w1);
        if !mask_passes(mask, vec2<u32>(w1, w2)) {
            return -1.0;
        }
    }
    return t;
}

// Distance in metres to the first triangle, or to any if `any_hit`; -1 if there is none.
fn traverse(origin: vec3<f32>, end: vec3<f32>, normal: vec3<f32>, any_hit: bool) -> f32 {
    let start = (origin - tree.center) + normal * tree.lift;
    let along = (end - tree.center) - start;
    let positive = along >= vec3<f32>(0.0);
    let magnitude = max(abs(along), vec3<f32>(MIN_DIRECTION));
    let inverse = vec3<f32>(1.0) / select(-magnitude, magnitude, positive);
    // Children are visited in the order in which a ray of its octant meets them, the nearest first.
    let octant = select(0u, 4u, positive.x) | select(0u, 2u, positive.y) | select(0u, 1u, positive.z);
    let octant4 = octant * 0x01010101u;
    var t_max = 1.0;
    var found = -1.0;
    var stack: array<vec2<u32>, BVH_STACK>;
    var depth = 0u;
    // Base index and, from bit 24 on, which children are still to be visited; below, which children are nodes.
    var group = vec2<u32>(0u, select(0u, 0x80000000u, tree.nodes > 0u));
    finished = false;
    while steps_left > 0u {
        var primitives = vec2<u32>(0u);
        if group.y > 0x00ffffffu {
            steps_left -= 1u;
            let bit = firstLeadingBit(group.y);
            let inner = group.y;
            group.y &= ~(1u << bit);
            if group.y > 0x00ffffffu && depth < BVH_STACK {
                stack[depth] = group;
                depth += 1u;
            }
            let slot = (bit - 24u) ^ octant;
            let at = 5u * (group.x + countOneBits(inner & ((1u << slot) - 1u)));
            let n0 = nodes[at];
            let n1 = nodes[at + 1u];
            let nx = nodes[at + 2u];
            let ny = nodes[at + 3u];
            let nz = nodes[at + 4u];
            let exponents = vec3<u32>(n0.w & 255u, (n0.w >> 8u) & 255u, (n0.w >> 16u) & 255u);
            let scale = bitcast<vec3<f32>>(exponents << vec3<u32>(23u)) * inverse;
            let shift = (bitcast<vec3<f32>>(n0.xyz) - start) * inverse;
            let near_x = select(nx.zw, nx.xy, positive.x);
            let far_x = select(nx.xy, nx.zw, positive.x);
            let near_y = select(ny.zw, ny.xy, positive.y);
            let far_y = select(ny.xy, ny.zw, positive.y);
            let near_z = select(nz.zw, nz.xy, positive.z);
            let far_z = select(nz.xy, nz.zw, positive.z);
            let met = children_met(
                n1.z, near_x.x, near_y.x, near_z.x, far_x.x, far_y.x, far_z.x, scale, shift, octant4, t_max,
            ) | children_met(
                n1.w, near_x.y, near_y.y, near_z.y, far_x.y, far_y.y, far_z.y, scale, shift, octant4, t_max,
            );
            group = vec2<u32>(n1.x, (met & 0xff000000u) | (n0.w >> 24u));
            primitives = vec2<u32>(n1.y, met & 0x00ffffffu);
        }
        while primitives.y != 0u && steps_left > 0u {
            steps_left -= 1u;
            let bit = firstTrailingBit(primitives.y);
            primitives.y &= primitives.y - 1u;
            let t = meet(primitives.x + bit, start, along, t_max);
            if t > 0.0 {
                t_max = t;
                found = t;
                if any_hit {
                    primitives.y = 0u;
                }
            }
        }
        if any_hit && found > 0.0 {
            finished = true;
            break;
        }
        if group.y <= 0x00ffffffu {
            if depth == 0u {
                finished = primitives.y == 0u;
                break;
            }
            depth -= 1u;
            group = stack[depth];
        }
    }
    if found < 0.0 {
        return -1.0;
    }
    return found * sqrt(along.x * along.x + along.y * along.y + along.z * along.z);
}

fn is_hidden(origin: vec3<f32>, end: vec3<f32>, normal: vec3<f32>) -> bool {
    return traverse(origin, end, normal, true) >= 0.0;
}

fn hit_distance(origin: vec3<f32>, end: vec3<f32>, normal: vec3<f32>) -> f32 {
    return traverse(origin, end, normal, false);
}
