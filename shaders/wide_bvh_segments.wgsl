// Segments, by traversing a compressed wide BVH over the scene's triangles.
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    test_segment(id);
}
