// Which lights receivers do not see, by one or two rows of a bake.
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    hide_lights(id);
}
