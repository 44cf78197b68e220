// Views, and cones around cones.

// A view as stages read it.
struct ViewCone {
    position: vec3<f32>,
    // Cosine and sine of half its field of view; -1 and 0 if it sees all around.
    cos_psi: f32,
    axis: vec3<f32>,
    sin_psi: f32,
}
