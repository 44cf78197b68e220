use crate::executor::CpuBinding;
use crate::mega_views::{LevelParams, PassParams, ViewCone, tree};
use crate::views::{ViewNode, dot, merged_cone};

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let [pass, level, tree, views, view_nodes, boxes] = bindings else {
        unreachable!("checked against the table")
    };
    let level = level.first::<LevelParams>().level as usize;
    let tree = tree.words();
    let views = &views.slice::<ViewCone>()[pass.first::<PassParams>().run_start as usize..];
    let words = view_nodes.words_mut();
    let whole = words.len() / 12 * 12;
    let nodes: &mut [ViewNode] = bytemuck::cast_slice_mut(&mut words[..whole]);
    let boxes: &mut [f32] = bytemuck::cast_slice_mut(boxes.words_mut());
    let range = tree[tree::STARTS + level]..tree[tree::STARTS + level + 1];
    for index in range.take(workgroups[0] as usize * 64) {
        let index = index as usize;
        let node = nodes[index];
        let (mut low, mut high) = ([f32::MAX; 3], [-f32::MAX; 3]);
        let mut cones = Vec::new();
        for i in node.range() {
            let (min, max, cone) = if node.is_leaf() {
                let view = &views[i];
                (view.position, view.position, (view.axis, [view.cos_psi, view.sin_psi]))
            } else {
                let corner = |at: usize| [0, 1, 2].map(|axis| boxes[8 * i + at + axis]);
                (corner(0), corner(4), (nodes[i].axis, [nodes[i].cos_psi, nodes[i].sin_psi]))
            };
            low = [0, 1, 2].map(|axis| low[axis].min(min[axis]));
            high = [0, 1, 2].map(|axis| high[axis].max(max[axis]));
            cones.push(cone);
        }
        boxes[8 * index..][..8]
            .copy_from_slice(&[low[0], low[1], low[2], 0.0, high[0], high[1], high[2], 0.0]);
        let half = [0, 1, 2].map(|axis| (high[axis] - low[axis]) * 0.5);
        let (center, radius) = match node.is_leaf() && node.len() == 1 {
            true => (low, 0.0),
            false => ([0, 1, 2].map(|axis| (low[axis] + high[axis]) * 0.5), dot(half, half).sqrt()),
        };
        let (axis, [cos_psi, sin_psi]) = merged_cone(cones.iter().copied());
        nodes[index] = ViewNode { center, radius, axis, cos_psi, sin_psi, reserved: 0, ..node };
    }
}
