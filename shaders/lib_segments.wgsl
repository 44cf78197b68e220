// For every segment: is it occluded, or how far is its first hit? One invocation does one segment. The stage's own method
// comes as `is_hidden(origin, end, normal) -> bool` and `hit_distance(origin, end, normal) -> f32` (metres, negative where
// nothing is hit), which count `steps_left` down and says whether it `finished` (lib_rays.wgsl); what it reads is bound from METHOD_BINDING on.

// First binding of the method's own.
const METHOD_BINDING: u32 = 3u;

struct SegmentParams {
    segments: u32,
    // 1 for distances, 0 for whether anything is there.
    wants_distance: u32,
    steps_per_ray: u32,
    // Set to 1 where a ray ran out of steps.
    exhausted_word: u32,
}

@group(0) @binding(0) var<uniform> params: SegmentParams;
// Nine a segment: origin, target, normal.
@group(0) @binding(1) var<storage, read> segments: array<f32>;
// 0 or 1, or the bits of a distance; then one word that says whether a ray ran out of steps.
@group(0) @binding(2) var<storage, read_write> results: array<u32>;

fn test_segment(id: vec3<u32>) {
    if id.x >= params.segments {
        return;
    }
    let at = 9u * id.x;
    let ray = testable(
        vec3<f32>(segments[at], segments[at + 1u], segments[at + 2u]),
        vec3<f32>(segments[at + 3u], segments[at + 4u], segments[at + 5u]),
        vec3<f32>(segments[at + 6u], segments[at + 7u], segments[at + 8u]),
    );
    var result = select(0u, INFINITY_BITS, params.wants_distance == 1u);
    if ray.is_testable {
        steps_left = params.steps_per_ray;
        finished = true;
        if params.wants_distance == 1u {
            let distance = hit_distance(ray.origin, ray.end, ray.normal);
            result = select(INFINITY_BITS, bitcast<u32>(distance), distance >= 0.0);
        } else {
            result = select(0u, 1u, is_hidden(ray.origin, ray.end, ray.normal));
        }
        if !finished {
            results[params.exhausted_word] = 1u;
        }
    }
    results[id.x] = result;
}
