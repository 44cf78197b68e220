// One layer of depth peeling: draws every triangle into every view and keeps, per pixel, the nearest voxel behind the
// layer before. One instance is one view, three vertices are one triangle. What is drawn is a right triangle around the
// rectangle of its pixels, with corners in whole numbers: coverage and depth are decided in integers by the fragment
// shader, since no two rasterizers agree on them.

@group(0) @binding(0) var<uniform> params: RasterParams;
@group(0) @binding(1) var<uniform> peel: PeelParams;
@group(0) @binding(2) var<storage, read> frames: array<DirectionFrame>;
@group(0) @binding(3) var<storage, read> triangles: array<PackedTriangle>;
@group(0) @binding(4) var<storage, read> masks: array<TriangleMask>;
@group(0) @binding(5) var<storage, read> planes: array<PackedPlane>;
@group(0) @binding(6) var<storage, read> alpha: array<u32>;
@group(0) @binding(7) var<storage, read> views: array<PeelView>;
// The layer before; all 0 before the first.
@group(0) @binding(8) var previous: texture_depth_2d;

struct Corner {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat, either) a: vec3<i32>,
    @location(1) @interpolate(flat, either) b: vec3<i32>,
    @location(2) @interpolate(flat, either) c: vec3<i32>,
    // Grid pixels to visit: smallest and largest, inclusive.
    @location(3) @interpolate(flat, either) pixels: vec4<i32>,
    // View, mask, twice the area, and whether vertices were exchanged.
    @location(4) @interpolate(flat, either) ids: vec4<u32>,
}

@vertex
fn vertex(@builtin(vertex_index) index: u32, @builtin(instance_index) instance: u32) -> Corner {
    let triangle = index / 3u;
    let view = views[instance];
    let vertices = triangle_vertices(triangle, view.direction);
    var p = project(vertices, view.axis, params.sub_bits, params.clip_min, params.clip_max);
    let window = vec2<i32>(view.window_x, view.window_y);
    p.pixel_min = max(p.pixel_min, window);
    p.pixel_max = min(p.pixel_max, window + i32(peel.cell) - 1i);
    var corner: Corner;
    if p.area == 0 || any(p.pixel_min > p.pixel_max) {
        corner.position = vec4<f32>(-2.0, -2.0, 0.0, 1.0);
        return corner;
    }
    corner.a = p.a;
    corner.b = p.b;
    corner.c = p.c;
    corner.pixels = vec4<i32>(p.pixel_min, p.pixel_max);
    corner.ids = vec4<u32>(instance, triangles[triangle].mask, u32(p.area), select(0u, 1u, p.swapped));
    // The corner that the rectangle shares, and the ends of legs twice its sides long.
    let k = index % 3u;
    let legs = (p.pixel_max - p.pixel_min + 1i) * vec2<i32>(vec2<u32>(2u * (k & 1u), k & 2u));
    let pixel = cell_corner(instance, peel) - window + p.pixel_min + legs;
    let side = vec2<f32>(vec2<u32>(peel.columns, peel.rows) * peel.cell);
    let ndc = vec2<f32>(pixel) / side * 2.0 - 1.0;
    corner.position = vec4<f32>(ndc.x, -ndc.y, 0.5, 1.0);
    return corner;
}

@fragment
fn fragment(corner: Corner) -> @builtin(frag_depth) f32 {
    let at = vec2<i32>(corner.position.xy);
    let view = views[corner.ids.x];
    let pixel = at - cell_corner(corner.ids.x, peel) + vec2<i32>(view.window_x, view.window_y);
    if any(pixel < corner.pixels.xy) || any(pixel > corner.pixels.zw) {
        discard;
    }
    let swapped = corner.ids.w == 1u;
    let p = Projected(corner.a, corner.b, corner.c, i32(corner.ids.z), swapped, corner.pixels.xy, corner.pixels.zw);
    let s = sample_pixel(p, pixel, params.sub_bits);
    let near = to_projection(params.clip_min, view.axis).z;
    let far = to_projection(params.clip_max, view.axis).z;
    if !s.inside || s.depth < near || s.depth >= far {
        discard;
    }
    if corner.ids.y != UNMASKED && !mask_passes(corner.ids.y, barycentric(p, s)) {
        discard;
    }
    let depth = f32(s.depth - near + 1i) / PEEL_DEPTHS;
    if depth <= textureLoad(previous, at, 0i) {
        discard;
    }
    return depth;
}
