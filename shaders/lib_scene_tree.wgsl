// The scene hierarchy; see scene_tree.rs. A stage has it in two buffers, so that each may be as large as a binding:
// `scene_links` holds words 0 and 1 of every inner node, `scene_places` words 2 and 3.

struct SceneParams {
    origin: vec3<f32>,
    size: f32,
    // Level of the leaves.
    depth: u32,
    // Index of the first node of the last inner level.
    last_inner: u32,
    // Cells of the last level of Morton keys per metre.
    key_cells_per_metre: f32,
    reserved: u32,
}

// Set in references to leaves.
const SCENE_LEAF: u32 = 0x80000000u;

fn cell_size(level: u32) -> f32 {
    return scene.size * bitcast<f32>((127u - level) << 23u);
}

fn place_cell(place: vec2<u32>) -> vec3<u32> {
    return vec3<u32>(place.x & 0x1fffu, (place.x >> 13u) & 0x1fffu, (place.x >> 26u) | ((place.y & 0x7fu) << 6u));
}

fn place_level(place: vec2<u32>) -> u32 {
    return (place.y >> 8u) & 0xfu;
}

fn place_mask(place: vec2<u32>) -> u32 {
    return (place.y >> 16u) & 0xffu;
}

fn octant_cell(parent: vec3<u32>, octant: u32) -> vec3<u32> {
    return parent * 2u + vec3<u32>(octant & 1u, (octant >> 1u) & 1u, octant >> 2u);
}

// Index of a leaf's parent.
fn leaf_parent(leaf: u32) -> u32 {
    return scene.last_inner + ((leaf & ~SCENE_LEAF) >> 3u);
}

fn cell_center(cell: vec3<u32>, edge: f32) -> vec3<f32> {
    return scene.origin + (vec3<f32>(cell) + 0.5) * edge;
}

// Mean of an inner node's leaves; `mean` is its word 1.
fn mean_position(cell: vec3<u32>, mean: u32, edge: f32) -> vec3<f32> {
    let parts = vec3<f32>(vec3<u32>(mean, mean >> 10u, mean >> 20u) & vec3<u32>(0x3ffu));
    return scene.origin + (vec3<f32>(cell) + (parts + 0.5) * (1.0 / 1024.0)) * edge;
}
