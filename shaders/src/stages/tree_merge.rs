use crate::executor::CpuBinding;
use crate::mega_views::{CONE_SLACK, LevelParams, PassParams, ViewCone, tree};
use crate::views::{ALL_AROUND, ViewNode, dot};

/// Unit axis, cosine and sine.
type Cone = ([f32; 3], [f32; 2]);

fn merged(cones: &[Cone]) -> Cone {
    let all = ([1.0, 0.0, 0.0], ALL_AROUND);
    if let [cone] = cones {
        return if cone.1[0] <= -1.0 { all } else { *cone };
    }
    let mut sum = [0.0f32; 3];
    for (axis, [cosine, _]) in cones {
        if *cosine <= -1.0 {
            return all;
        }
        sum = [0, 1, 2].map(|i| sum[i] + axis[i]);
    }
    let length = dot(sum, sum).sqrt();
    if length <= CONE_SLACK {
        return all;
    }
    let axis = sum.map(|c| c / length);
    let mut widest = 1.0f32;
    for &(other, [cos_psi, sin_psi]) in cones {
        let cos_alpha = dot(axis, other).clamp(-1.0, 1.0);
        let sin_alpha = (1.0 - cos_alpha * cos_alpha).sqrt();
        if sin_alpha * cos_psi + cos_alpha * sin_psi <= 0.0 {
            return all;
        }
        widest = widest.min(cos_alpha * cos_psi - sin_alpha * sin_psi);
    }
    let cosine = (widest - CONE_SLACK).max(-1.0);
    (axis, [cosine, (1.0 - cosine * cosine).max(0.0).sqrt()])
}

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
        let (axis, [cos_psi, sin_psi]) = merged(&cones);
        nodes[index] = ViewNode { center, radius, axis, cos_psi, sin_psi, reserved: 0, ..node };
    }
}
