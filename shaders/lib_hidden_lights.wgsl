// For every receiver and every light of a band: is the light hidden? One invocation does some lights of one receiver
// and sets their bits. The stage's own method comes as `is_hidden(origin, end, normal) -> bool`, which counts
// `steps_left` down and says whether it `finished` (lib_rays.wgsl); what it reads is bound from METHOD_BINDING on.

// First binding of the method's own.
const METHOD_BINDING: u32 = 4u;

struct HiddenLightsParams {
    receivers: u32,
    lights: u32,
    // Words of one receiver.
    light_words: u32,
    // Divides 32.
    lights_per_invocation: u32,
    steps_per_ray: u32,
    // Set to 1 where a ray ran out of steps.
    exhausted_word: u32,
    reserved: vec2<u32>,
}

struct Receiver {
    position: array<f32, 3>,
    normal: array<f32, 3>,
}

struct LightPoint {
    offset: array<f32, 3>,
    position_weight: f32,
}

@group(0) @binding(0) var<uniform> params: HiddenLightsParams;
@group(0) @binding(1) var<storage, read> receivers: array<Receiver>;
@group(0) @binding(2) var<storage, read> lights: array<LightPoint>;
// Receiver by receiver, then one word that says whether a ray ran out of steps.
@group(0) @binding(3) var<storage, read_write> hidden: array<atomic<u32>>;

// Neighbouring invocations take neighbouring receivers and the same lights: their rays are alike.
fn hide_lights(id: vec3<u32>) {
    let parts = 32u / params.lights_per_invocation;
    let word = id.y / parts;
    if id.x >= params.receivers || word >= params.light_words {
        return;
    }
    let position = vec3<f32>(receivers[id.x].position[0], receivers[id.x].position[1], receivers[id.x].position[2]);
    let normal = vec3<f32>(receivers[id.x].normal[0], receivers[id.x].normal[1], receivers[id.x].normal[2]);
    let first = word * 32u + id.y % parts * params.lights_per_invocation;
    let last = min(first + params.lights_per_invocation, params.lights);
    var bits = 0u;
    var exhausted = false;
    // This loop too may be ended by a driver.
    var visited = 0u;
    for (var i = first; i < last; i += 1u) {
        let light = lights[i];
        let offset = vec3<f32>(light.offset[0], light.offset[1], light.offset[2]);
        let end = offset + light.position_weight * position;
        let ray = testable(position, end, normal);
        if ray.is_testable {
            steps_left = params.steps_per_ray;
            finished = true;
            let along = end - position;
            let cosine = along.x * ray.normal.x + along.y * ray.normal.y + along.z * ray.normal.z;
            // What is not in front of a surface is hidden by it.
            let is_behind = any(ray.normal != vec3<f32>(0.0)) && !(cosine > 0.0);
            bits |= select(0u, 1u << (i & 31u), is_behind || is_hidden(ray.origin, ray.end, ray.normal));
            exhausted = exhausted || !finished;
        }
        visited |= 1u << (i & 31u);
    }
    atomicOr(&hidden[id.x * params.light_words + word], bits);
    if exhausted || countOneBits(visited) != max(last, first) - first {
        atomicStore(&hidden[params.exhausted_word], 1u);
    }
}
