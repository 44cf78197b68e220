// Which triangle a camera sees in every pixel. Drawn twice: first the depth image keeps the nearest distance per pixel,
// then every fragment at that distance offers its triangle, and the smallest index wins, whatever the order of drawing.
// Distance and cut-outs come from where the pixel's ray meets the triangle, not from interpolation, so that both passes
// and the CPU compute the same.

struct ViewParams {
    // World axes, from the eye: to the middle of the picture, and from there to its right and upper edge, at distance 1.
    forward: vec3<f32>,
    near_metres: f32,
    right: vec3<f32>,
    far_metres: f32,
    up: vec3<f32>,
    width: u32,
    right_over_square: vec3<f32>,
    height: u32,
    up_over_square: vec3<f32>,
    // 0: keep the nearest; 1: offer triangles.
    collect: u32,
}

struct EyeTriangle {
    // World axes, from the eye, metres: x y z of vertex 0 first.
    vertices: array<f32, 9>,
    // Index into `masks` or UNMASKED.
    mask: u32,
    // What is offered.
    index: u32,
}

@group(0) @binding(0) var<uniform> view: ViewParams;
@group(0) @binding(1) var<storage, read> triangles: array<EyeTriangle>;
@group(0) @binding(2) var<storage, read> masks: array<TriangleMask>;
@group(0) @binding(3) var<storage, read> planes: array<PackedPlane>;
@group(0) @binding(4) var<storage, read> alpha: array<u32>;
@group(0) @binding(5) var nearest: texture_depth_2d;
@group(0) @binding(6) var<storage, read_write> seen: array<atomic<u32>>;

struct Corner {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat, either) triangle: u32,
}

fn eye_vertex(triangle: u32, vertex: u32) -> vec3<f32> {
    let at = 3u * vertex;
    return vec3<f32>(
        triangles[triangle].vertices[at],
        triangles[triangle].vertices[at + 1u],
        triangles[triangle].vertices[at + 2u],
    );
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> Corner {
    let p = eye_vertex(index / 3u, index % 3u);
    let z = dot(p, view.forward);
    let position = vec4<f32>(dot(p, view.right_over_square), dot(p, view.up_over_square), z - view.near_metres, z);
    return Corner(position, index / 3u);
}

@fragment
fn fragment(corner: Corner) -> @builtin(frag_depth) f32 {
    let size = vec2<f32>(vec2<u32>(view.width, view.height));
    let at = 2.0 * corner.position.xy / size - 1.0;
    let direction = view.forward + view.right * at.x - view.up * at.y;
    let a = eye_vertex(corner.triangle, 0u);
    let ab = eye_vertex(corner.triangle, 1u) - a;
    let ac = eye_vertex(corner.triangle, 2u) - a;
    let across = cross(direction, ac);
    let determinant = dot(ab, across);
    if determinant == 0.0 {
        discard;
    }
    let turned = cross(-a, ab);
    let metres = dot(ac, turned) / determinant;
    let mask = triangles[corner.triangle].mask;
    if mask != UNMASKED {
        let b1 = clamp(dot(-a, across) / determinant, 0.0, 1.0);
        let b2 = clamp(dot(direction, turned) / determinant, 0.0, 1.0 - b1);
        if !mask_passes(mask, vec2<u32>(vec2<f32>(b1, b2) * BARYCENTRIC_ONE)) {
            discard;
        }
    }
    let depth = clamp(metres / view.far_metres, 0.0, 1.0);
    if view.collect == 1u {
        let pixel = vec2<u32>(corner.position.xy);
        if depth == textureLoad(nearest, pixel, 0i) {
            atomicMin(&seen[pixel.y * view.width + pixel.x], triangles[corner.triangle].index);
        }
    }
    return depth;
}
