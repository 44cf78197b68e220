use super::lib_keep::keep;
use super::lib_view_tree::flat_groups;
use crate::executor::CpuBinding;
use crate::mega_views::{PAIR_SPLITS_VIEWS, PAIR_WHOLE, PassParams, SceneParams, counter};
use crate::paraboloid::texel;
use crate::scene_tree::{NodeRef, SPHERE_OF_CUBE, SceneNode};
use crate::views::{PairStep, ViewNode, dot, pair_step};

#[derive(PartialEq)]
enum Task {
    Done,
    SplitScene,
    SplitViews,
    Near,
}

/// A scene node and where it is.
#[derive(Clone, Copy)]
struct Place {
    node: NodeRef,
    cell: [u32; 3],
    level: u32,
}

struct Step<'a> {
    scene: SceneParams,
    pass: PassParams,
    links: &'a [[u32; 2]],
    places: &'a [[u32; 2]],
    maps: &'a mut [u32],
}

impl Step<'_> {
    fn node(&self, index: u32) -> SceneNode {
        let ([a, b], [c, d]) = (self.links[index as usize], self.places[index as usize]);
        SceneNode { words: [a, b, c, d] }
    }

    fn place(&self, node: NodeRef) -> Place {
        if !node.is_leaf() {
            let inner = self.node(node.0);
            return Place { node, cell: inner.cell(), level: inner.level() };
        }
        let parent = self.node(self.scene.last_inner + ((node.0 & !NodeRef::LEAF) >> 3));
        let cell = [0, 1, 2].map(|i| parent.cell()[i] * 2 + (node.0 >> i & 1));
        Place { node, cell, level: self.scene.depth }
    }

    fn draw_point(&mut self, map: u32, offset: [f32; 3], node: NodeRef) {
        let length = dot(offset, offset).sqrt();
        if length > 0.0 {
            let texel = texel(offset, length, self.pass.resolution);
            keep(&self.pass, self.maps, [map, texel], length, node.0);
        }
    }

    fn look_at(&mut self, place: Place, view: &ViewNode, view_index: u32) -> Task {
        let Place { node, cell, level } = place;
        let edge = self.scene.size / (1u32 << level) as f32;
        let radius = SPHERE_OF_CUBE * edge;
        let offset =
            [0, 1, 2].map(|i| self.scene.origin[i] + (cell[i] as f32 + 0.5) * edge - view.center[i]);
        let culling = self.pass.culling == 1;
        match pair_step(offset, radius, node.is_leaf(), view, self.pass.scale, culling) {
            PairStep::Drop => Task::Done,
            PairStep::Point => {
                let mut at = offset;
                if !node.is_leaf() {
                    let mean = self.node(node.0).mean();
                    at = [0, 1, 2].map(|i| self.scene.origin[i] + mean[i] * edge - view.center[i]);
                }
                self.draw_point(view_index, at, node);
                Task::Done
            }
            PairStep::Near if offset.iter().all(|c| c.abs() <= edge * 0.5) => Task::Done,
            PairStep::Near => Task::Near,
            PairStep::SplitScene => Task::SplitScene,
            PairStep::SplitViews => Task::SplitViews,
        }
    }
}

pub(super) fn twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
    let [scene, pass, links, places, view_nodes, pairs, counters, queued, near_pairs, maps] = bindings else {
        unreachable!("checked against the table")
    };
    let mut step = Step {
        scene: scene.first(),
        pass: pass.first(),
        links: links.slice(),
        places: places.slice(),
        maps: maps.words_mut(),
    };
    let (views, counters) = (view_nodes.slice::<ViewNode>(), counters.words_mut());
    let count = counters[counter::PAIRS].min(flat_groups(workgroups) * 64) as usize;
    for &[node, view_word] in &pairs.slice::<[u32; 2]>()[..count] {
        let view = view_word & (PAIR_SPLITS_VIEWS - 1);
        let place = step.place(NodeRef(node));
        let children: Vec<(Place, u32)> = if view_word & PAIR_WHOLE != 0 {
            vec![(place, view)]
        } else if view_word & PAIR_SPLITS_VIEWS != 0 {
            views[view as usize].range().map(|child| (place, child as u32)).collect()
        } else {
            let parent = step.node(node);
            let octants = (0..8u32).filter(|octant| parent.child_mask() >> octant & 1 == 1);
            let child = |(number, octant): (u32, u32)| {
                let node = match place.level + 1 == step.scene.depth {
                    true => NodeRef::LEAF | (node - step.scene.last_inner) << 3 | octant,
                    false => parent.first_child() + number,
                };
                let cell = [0, 1, 2].map(|i| place.cell[i] * 2 + (octant >> i & 1));
                (Place { node: NodeRef(node), cell, level: place.level + 1 }, view)
            };
            (0..).zip(octants).map(child).collect()
        };
        for (place, view) in children {
            let task = step.look_at(place, &views[view as usize], view);
            let (list, number, capacity) = match task {
                Task::Done => continue,
                Task::Near => (&mut *near_pairs, counter::NEAR, step.pass.near_capacity),
                _ => (&mut *queued, counter::QUEUED, step.pass.pair_capacity),
            };
            let at = counters[number] as usize;
            counters[number] += 1;
            if at < capacity as usize {
                let splits = if task == Task::SplitViews { PAIR_SPLITS_VIEWS } else { 0 };
                list.words_mut()[2 * at..2 * at + 2].copy_from_slice(&[place.node.0, view | splits]);
            }
        }
    }
}
