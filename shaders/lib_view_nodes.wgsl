// Nodes of the view hierarchy and the two tests of a pair; see views.rs.

struct ViewNode {
    center: vec3<f32>,
    radius: f32,
    axis: vec3<f32>,
    // Cosine and sine of the cone's half angle; -1 and 0 where all directions are seen.
    cos_psi: f32,
    sin_psi: f32,
    // Index of the first child or view.
    first: u32,
    // Number of children or views; VIEW_LEAF is set in leaves.
    count: u32,
    reserved: u32,
}

const VIEW_LEAF: u32 = 0x80000000u;

// Whether a sphere at `offset`, `len` away, is outside the field of every view of a node.
fn is_culled(offset: vec3<f32>, len: f32, radius: f32, view: ViewNode) -> bool {
    if view.cos_psi <= -1.0 {
        return false;
    }
    let along = dot(offset, view.axis);
    let across = sqrt(max(len * len - along * along, 0.0));
    let outside = across * view.cos_psi - along * view.sin_psi;
    let facing = along * view.cos_psi + across * view.sin_psi;
    let distance = select(outside, len, facing < 0.0);
    return outside > 0.0 && distance > radius + view.radius;
}

// Whether a sphere fills less than a texel for every view within `view_radius` of the middle.
fn is_small(offset: vec3<f32>, len: f32, radius: f32, view_radius: f32, scale: f32) -> bool {
    return radius * scale * len < (len - view_radius) * (len + abs(offset.x));
}
