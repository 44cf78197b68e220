// Spheres and cones of the nodes of a level, from their views or from the level below. One invocation a node.

@group(0) @binding(0) var<uniform> pass_params: PassParams;
@group(0) @binding(1) var<uniform> level_params: LevelParams;
@group(0) @binding(2) var<storage, read> tree: array<u32>;
@group(0) @binding(3) var<storage, read> views: array<ViewCone>;
@group(0) @binding(4) var<storage, read_write> view_nodes: array<ViewNode>;
// Smallest and largest corners of all nodes.
@group(0) @binding(5) var<storage, read_write> boxes: array<vec4<f32>>;

// The cone of a view or of a child: axis and cosine, and sine.
struct Cone {
    axis_cos: vec4<f32>,
    sin_psi: f32,
}

fn cone_of(is_leaf: bool, index: u32) -> Cone {
    if is_leaf {
        let view = views[pass_params.run_start + index];
        return Cone(vec4<f32>(view.axis, view.cos_psi), view.sin_psi);
    }
    let child = view_nodes[index];
    return Cone(vec4<f32>(child.axis, child.cos_psi), child.sin_psi);
}

fn merged_cone(is_leaf: bool, first: u32, count: u32) -> Cone {
    let all = Cone(vec4<f32>(1.0, 0.0, 0.0, -1.0), 0.0);
    var sum = vec3<f32>(0.0);
    for (var i = 0u; i < count; i += 1u) {
        let cone = cone_of(is_leaf, first + i);
        if cone.axis_cos.w <= -1.0 {
            return all;
        }
        sum += cone.axis_cos.xyz;
    }
    if count == 1u {
        return cone_of(is_leaf, first);
    }
    let len = sqrt(dot(sum, sum));
    if !(len > CONE_SLACK) {
        return all;
    }
    let axis = sum / len;
    var widest = 1.0;
    for (var i = 0u; i < count; i += 1u) {
        let cone = cone_of(is_leaf, first + i);
        let cos_alpha = clamp(dot(axis, cone.axis_cos.xyz), -1.0, 1.0);
        let sin_alpha = sqrt(1.0 - cos_alpha * cos_alpha);
        if sin_alpha * cone.axis_cos.w + cos_alpha * cone.sin_psi <= 0.0 {
            return all;
        }
        widest = min(widest, cos_alpha * cone.axis_cos.w - sin_alpha * cone.sin_psi);
    }
    let cosine = max(widest - CONE_SLACK, -1.0);
    return Cone(vec4<f32>(axis, cosine), sqrt(max(1.0 - cosine * cosine, 0.0)));
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = tree[TREE_STARTS + level_params.level] + group.x * 64u + lane;
    if node >= tree[TREE_STARTS + level_params.level + 1u] {
        return;
    }
    let count = view_nodes[node].count & ~VIEW_LEAF;
    let is_leaf = view_nodes[node].count >= VIEW_LEAF;
    let first = view_nodes[node].first;
    var low = vec3<f32>(LARGEST);
    var high = vec3<f32>(-LARGEST);
    for (var i = 0u; i < count; i += 1u) {
        if is_leaf {
            let position = views[pass_params.run_start + first + i].position;
            low = min(low, position);
            high = max(high, position);
        } else {
            low = min(low, boxes[2u * (first + i)].xyz);
            high = max(high, boxes[2u * (first + i) + 1u].xyz);
        }
    }
    boxes[2u * node] = vec4<f32>(low, 0.0);
    boxes[2u * node + 1u] = vec4<f32>(high, 0.0);
    let half_size = (high - low) * 0.5;
    if is_leaf && count == 1u {
        view_nodes[node].center = low;
        view_nodes[node].radius = 0.0;
    } else {
        view_nodes[node].center = (low + high) * 0.5;
        view_nodes[node].radius = sqrt(dot(half_size, half_size));
    }
    let cone = merged_cone(is_leaf, first, count);
    view_nodes[node].axis = cone.axis_cos.xyz;
    view_nodes[node].cos_psi = cone.axis_cos.w;
    view_nodes[node].sin_psi = cone.sin_psi;
    view_nodes[node].reserved = 0u;
}
