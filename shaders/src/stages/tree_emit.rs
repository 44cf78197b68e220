use super::lib_view_tree::{Run, chunks};
use crate::executor::CpuBinding;
use crate::mega_views::{PassParams, SceneParams, tree};
use crate::views::ViewNode;

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let [scene, pass, tree, keys, chunk_sums, ranges, view_nodes, links] = bindings else {
        unreachable!("checked against the table")
    };
    let pass = pass.first::<PassParams>();
    let (tree, links, ranges) = (tree.words(), links.words_mut(), ranges.words_mut());
    let run = Run::new(&scene.first::<SceneParams>(), &pass, keys.slice());
    let nodes_words = view_nodes.words_mut();
    let mut put = |node: u32, first: u32, count: u32| {
        let words = &mut nodes_words[12 * node as usize..][..12];
        (words[9], words[10]) = (first, count);
    };
    let level = tree[tree::LEVEL] as usize - 1;
    for (chunk, nodes) in chunks(tree, level, workgroups).into_iter().enumerate() {
        let [mut next_child, mut next_leaf] = chunk_sums.slice::<[u32; 2]>()[chunk];
        for node in nodes {
            let range = [ranges[2 * node as usize], ranges[2 * node as usize + 1]];
            match run.children(range) {
                None => {
                    put(node, range[0], ViewNode::LEAF | (range[1] - range[0]));
                    links[(pass.node_capacity + next_leaf) as usize] = node;
                    next_leaf += 1;
                }
                // The pass will be done again.
                Some(_) if tree[tree::FLAGS] != 0 => put(node, 0, ViewNode::LEAF),
                Some(children) => {
                    put(node, next_child, children.len() as u32);
                    for child in children {
                        ranges[2 * next_child as usize..][..2].copy_from_slice(&child);
                        links[next_child as usize] = node;
                        next_child += 1;
                    }
                }
            }
        }
    }
}
