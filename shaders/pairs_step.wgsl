// One step of the traversal. One invocation subdivides a pair of a scene node and a view node and looks at its up to eight
// children: outside all fields of view they are dropped, small ones are drawn as points into the view node's map, two
// leaves are put aside for `pairs_near`, and all others are queued for the next step.

@group(0) @binding(0) var<uniform> scene: SceneParams;
@group(0) @binding(1) var<uniform> pass_params: PassParams;
@group(0) @binding(2) var<storage, read> scene_links: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> scene_places: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> view_nodes: array<ViewNode>;
// A scene node, and a view node with PAIR_SPLITS_VIEWS or PAIR_WHOLE.
@group(0) @binding(5) var<storage, read> pairs: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read_write> counters: array<atomic<u32>>;
// The pairs of the next step.
@group(0) @binding(7) var<storage, read_write> queued: array<vec2<u32>>;
@group(0) @binding(8) var<storage, read_write> near_pairs: array<vec2<u32>>;
@group(0) @binding(9) var<storage, read_write> maps: array<atomic<u32>>;

const DONE: u32 = 0u;
const SPLIT_SCENE: u32 = 1u;
const SPLIT_VIEWS: u32 = 2u;
const NEAR: u32 = 3u;

fn draw_point(map: u32, offset: vec3<f32>, node: u32) {
    let len = sqrt(dot(offset, offset));
    if len > 0.0 {
        keep(map, paraboloid_texel(offset, len, pass_params.resolution), len, node);
    }
}

// Draws the pair of a scene node, of which `cell` and `level` say where it is, and a view node; or says what is to be done.
fn look_at(node: u32, cell: vec3<u32>, level: u32, view: ViewNode, view_index: u32) -> u32 {
    let edge = cell_size(level);
    let radius = SPHERE_OF_CUBE * edge;
    let offset = cell_center(cell, edge) - view.center;
    let len = sqrt(dot(offset, offset));
    if pass_params.culling == 1u && is_culled(offset, len, radius, view) {
        return DONE;
    }
    let is_leaf = node >= SCENE_LEAF;
    if is_small(offset, len, max(radius, PARALLAX * view.radius), view.radius, pass_params.scale) {
        if is_leaf {
            draw_point(view_index, offset, node);
        } else {
            draw_point(view_index, mean_position(cell, scene_links[node].y, edge) - view.center, node);
        }
        return DONE;
    }
    let view_is_leaf = view.count >= VIEW_LEAF;
    if is_leaf && view_is_leaf {
        // From inside the leaf nothing else would be seen.
        return select(NEAR, DONE, all(abs(offset) <= vec3<f32>(edge * 0.5)));
    }
    if view_is_leaf || (!is_leaf && PARALLAX * view.radius <= radius) {
        return SPLIT_SCENE;
    }
    return SPLIT_VIEWS;
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = flat_group(group) * 64u + lane;
    if index >= atomicLoad(&counters[COUNTER_PAIRS]) {
        return;
    }
    let pair = pairs[index];
    let view_index = pair.y & PAIR_VIEW;
    let view = view_nodes[view_index];
    var parent = pair.x;
    if parent >= SCENE_LEAF {
        parent = leaf_parent(pair.x);
    }
    let place = scene_places[parent];
    var cell = place_cell(place);
    var level = place_level(place);
    if pair.x >= SCENE_LEAF {
        cell = octant_cell(cell, pair.x & 7u);
        level += 1u;
    }

    // What is to be done with each child, two bits each.
    var tasks = 0u;
    var count = 1u;
    // Of the first child: its index, or for leaves of the scene the number before the octant.
    var first = 0u;
    let mask = place_mask(place);
    let splits_scene = pair.y < PAIR_SPLITS_VIEWS;
    let are_leaves = level + 1u == scene.depth;
    if splits_scene {
        count = countOneBits(mask);
        first = scene_links[pair.x].x;
        if are_leaves {
            first = SCENE_LEAF | ((pair.x - scene.last_inner) << 3u);
        }
        var rest = mask;
        for (var i = 0u; i < count; i += 1u) {
            let octant = firstTrailingBit(rest);
            rest &= rest - 1u;
            let child = first + select(i, octant, are_leaves);
            tasks |= look_at(child, octant_cell(cell, octant), level + 1u, view, view_index) << (2u * i);
        }
    } else if pair.y < PAIR_WHOLE {
        count = view.count;
        first = view.first;
        for (var i = 0u; i < count; i += 1u) {
            tasks |= look_at(pair.x, cell, level, view_nodes[first + i], first + i) << (2u * i);
        }
    } else {
        first = view_index;
        tasks = look_at(pair.x, cell, level, view, view_index);
    }
    if tasks == 0u {
        return;
    }

    let near = tasks & (tasks >> 1u) & 0x5555u;
    let others = (tasks | (tasks >> 1u)) & 0x5555u & ~near;
    var near_place = 0u;
    var place_in_queue = 0u;
    if near != 0u {
        near_place = atomicAdd(&counters[COUNTER_NEAR], countOneBits(near));
    }
    if others != 0u {
        place_in_queue = atomicAdd(&counters[COUNTER_QUEUED], countOneBits(others));
    }
    var rest = mask;
    for (var i = 0u; i < count; i += 1u) {
        let octant = firstTrailingBit(rest);
        rest &= rest - 1u;
        let task = (tasks >> (2u * i)) & 3u;
        var node = pair.x;
        var child_view = view_index;
        if splits_scene {
            node = first + select(i, octant, are_leaves);
        } else {
            child_view = first + i;
        }
        if task == NEAR {
            if near_place < pass_params.near_capacity {
                near_pairs[near_place] = vec2<u32>(node, child_view);
            }
            near_place += 1u;
        } else if task != DONE {
            if place_in_queue < pass_params.pair_capacity {
                let splits = select(0u, PAIR_SPLITS_VIEWS, task == SPLIT_VIEWS);
                queued[place_in_queue] = vec2<u32>(node, child_view | splits);
            }
            place_in_queue += 1u;
        }
    }
}
