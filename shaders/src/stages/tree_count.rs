use super::lib_view_tree::{Run, chunks};
use crate::executor::CpuBinding;
use crate::mega_views::{PassParams, SceneParams, tree};

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let [scene, pass, tree, keys, ranges, chunk_sums] = bindings else {
        unreachable!("checked against the table")
    };
    let (tree, ranges) = (tree.words(), ranges.slice::<[u32; 2]>());
    let run = Run::new(&scene.first::<SceneParams>(), &pass.first::<PassParams>(), keys.slice());
    let level = tree[tree::LEVEL] as usize;
    for (chunk, nodes) in chunks(tree, level, workgroups).into_iter().enumerate() {
        let mut sums = [0; 2];
        for node in nodes {
            match run.children(ranges[node as usize]) {
                Some(children) => sums[0] += children.len() as u32,
                None => sums[1] += 1,
            }
        }
        chunk_sums.words_mut()[2 * chunk..2 * chunk + 2].copy_from_slice(&sums);
    }
}
