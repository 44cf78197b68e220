use super::lib_view_tree::flat_groups;
use crate::executor::CpuBinding;
use crate::mega_views::{PassParams, SceneParams, counter};
use crate::paraboloid::{is_inside, texel, texel_count, texel_direction};
use crate::scene_tree::{NodeRef, SceneNode};
use crate::views::{ViewNode, dot};

/// Looks at all texels instead of those in a rectangle, which must change nothing.
pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let [scene, pass, places, view_nodes, counters, near_pairs, maps] = bindings else {
        unreachable!("checked against the table")
    };
    let (scene, pass) = (scene.first::<SceneParams>(), pass.first::<PassParams>());
    let (places, views, maps) =
        (places.slice::<[u32; 2]>(), view_nodes.slice::<ViewNode>(), maps.words_mut());
    let (resolution, edge) = (pass.resolution, scene.size / (1u32 << scene.depth) as f32);
    let directions: Vec<(u32, [f32; 3])> = (0..texel_count(resolution) as u32)
        .filter(|&index| is_inside(index, resolution))
        .map(|index| (index, texel_direction(index, resolution).map(|d| 1.0 / d)))
        .collect();
    let count = counters.words()[counter::NEAR].min(flat_groups(workgroups) * (64 / pass.near_lanes));
    for &[leaf, view] in &near_pairs.slice::<[u32; 2]>()[..count as usize] {
        let [c, d] = places[(scene.last_inner + ((leaf & !NodeRef::LEAF) >> 3)) as usize];
        let cell = SceneNode { words: [0, 0, c, d] }.cell();
        let offset = [0, 1, 2].map(|i| {
            let cell = cell[i] * 2 + (leaf >> i & 1);
            scene.origin[i] + (cell as f32 + 0.5) * edge - views[view as usize].center[i]
        });
        let mut keep = |index: u32, distance: f32| {
            super::lib_keep::keep(&pass, maps, [view, index], distance, leaf);
        };
        let length = dot(offset, offset).sqrt();
        if length <= 0.0 {
            continue;
        }
        keep(texel(offset, length, resolution), length);
        for &(index, inverse) in &directions {
            let (mut enter, mut exit) = (f32::NEG_INFINITY, f32::INFINITY);
            for i in 0..3 {
                let a = (offset[i] - edge * 0.5) * inverse[i];
                let b = (offset[i] + edge * 0.5) * inverse[i];
                (enter, exit) = (enter.max(a.min(b)), exit.min(a.max(b)));
            }
            if enter <= exit && enter > 0.0 {
                keep(index, enter);
            }
        }
    }
}
