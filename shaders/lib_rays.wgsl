// What the stages that test rays share: which segments can be tested, and how long a test may take.

// Iterations that the current ray has left. A method's loop takes one each time round and ends when there is none; the
// job then tries again with more, or fails.
var<private> steps_left: u32;

// Set to false by a method before its loop, and to true where the loop ends because the ray does. Some drivers end loops
// themselves once all lanes of an invocation's group have gone round 65,535 times, which `steps_left` cannot count.
var<private> finished: bool;

struct Testable {
    origin: vec3<f32>,
    // Not named `target`: that is a reserved word.
    end: vec3<f32>,
    // Zero where the origin is free or the given normal is none.
    normal: vec3<f32>,
    is_testable: bool,
}

// Decided on bits: shaders may assume that there are no infinities.
fn is_finite(v: vec3<f32>) -> bool {
    return all((bitcast<vec3<u32>>(v) & vec3<u32>(INFINITY_BITS)) != vec3<u32>(INFINITY_BITS));
}

// A segment of a length that can be squared, ends included: testable.rs.
fn testable(origin: vec3<f32>, end: vec3<f32>, normal: vec3<f32>) -> Testable {
    let along = end - origin;
    let length_squared = along.x * along.x + along.y * along.y + along.z * along.z;
    let is_testable = is_finite(origin) && is_finite(end) && is_finite(vec3<f32>(length_squared))
        && length_squared > MIN_LENGTH_SQUARED;
    let is_normal = all((bitcast<vec3<u32>>(normal) & vec3<u32>(0x7fffffffu)) <= vec3<u32>(bitcast<u32>(MAX_NORMAL)));
    return Testable(origin, end, select(vec3<f32>(0.0), normal, is_normal), is_testable);
}
