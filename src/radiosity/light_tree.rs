//! A tree over virtual lights.
//!
//! # Theory
//! B. Walter et al., *Lightcuts*, SIGGRAPH 2005, and \[MV\] (Applications): subtrees of lights that cannot shine on a group of
//! receivers are left out at once, by the test that culls views ([`is_culled`]); others are chosen by how much they may
//! give.
//!
//! # Practice
//! Lights are sorted along a Morton curve, with the sides they face in the middle of its bits, so that lights in one corner of
//! a room come apart. A node is a run of them; its children are the run's halves. Node n of a level of 2ˡ nodes has the
//! lights from count · n / 2ˡ on: nothing is stored of that.

use super::VirtualLight;
use crate::preview::luminance;
use glam::Vec3;
use manyview_shaders::views::{ALL_AROUND, ViewNode, is_culled};
use rayon::prelude::*;
use std::ops::Range;

/// About how many lights a leaf has.
const LEAF_LIGHTS: usize = 16;
/// Bits of the Morton code before those of the side that a light faces.
const BITS_BEFORE_SIDE: u32 = 15;
/// Bits an axis.
const AXIS_BITS: u32 = 10;

/// Lights in the tree's order, and its nodes.
#[derive(Debug, Clone)]
pub struct LightTree {
    lights: Vec<VirtualLight>,
    /// Index that each had in the list that the tree was made of.
    order: Vec<u32>,
    /// Level after level from the root.
    nodes: Vec<LightNode>,
    levels: u32,
}

/// A run of lights.
#[derive(Debug, Clone, Copy)]
pub(super) struct LightNode {
    /// Their sphere and the cone that they shine into; the range is the run.
    pub(super) view: ViewNode,
    /// Luminance of their intensities together.
    pub(super) intensity: f32,
}

/// Receivers close to each other that face one way.
#[derive(Debug, Clone, Copy)]
pub(super) struct Group {
    /// As a view: its sphere, and the half space that they face together.
    pub(super) view: ViewNode,
}

/// A node that may shine on a group, and how likely it is chosen.
#[derive(Debug, Clone, Copy)]
pub(super) struct Choice {
    pub(super) first: u32,
    pub(super) count: u32,
    /// Sum of probabilities up to and with this one.
    pub(super) until: f64,
    pub(super) probability: f32,
}

impl LightTree {
    /// Sorts lights; those with a number that is not finite, or without intensity, are left out.
    pub fn new(lights: &[VirtualLight]) -> Self {
        let usable = |light: &VirtualLight| {
            let numbers = [light.position, light.normal, light.intensity];
            numbers.iter().flatten().all(|c| c.abs() < 1e18) && light.intensity.iter().any(|&c| c > 0.0)
        };
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for light in lights.iter().filter(|light| usable(light)) {
            (low, high) = (low.min(light.position.into()), high.max(light.position.into()));
        }
        let scale = ((1 << AXIS_BITS) - 1) as f32 / (high - low).max_element().max(f32::MIN_POSITIVE);
        let key = |(index, light): (usize, &VirtualLight)| {
            usable(light).then(|| {
                let cell = ((Vec3::from(light.position) - low) * scale).as_uvec3();
                (key(cell.to_array(), light.normal), index as u32)
            })
        };
        let mut keys: Vec<(u64, u32)> = lights.par_iter().enumerate().filter_map(key).collect();
        keys.par_sort_unstable();
        let order: Vec<u32> = keys.into_iter().map(|(_, index)| index).collect();
        let lights: Vec<VirtualLight> = order.par_iter().map(|&index| lights[index as usize]).collect();
        let levels = match lights.len() {
            0 => 0,
            count => count.div_ceil(LEAF_LIGHTS).next_power_of_two().ilog2() + 1,
        };
        let mut tree = Self { lights, order, nodes: Vec::new(), levels };
        for level in 0..levels {
            let of = |n| LightNode::new(&tree.lights, tree.run(level, n));
            let nodes: Vec<LightNode> = (0..1u32 << level).into_par_iter().map(of).collect();
            tree.nodes.extend(nodes);
        }
        tree
    }

    /// The lights, in the tree's order.
    pub fn lights(&self) -> &[VirtualLight] {
        &self.lights
    }

    /// Index that each light had in the list that the tree was made of.
    pub fn order(&self) -> &[u32] {
        &self.order
    }

    fn run(&self, level: u32, node: u32) -> Range<usize> {
        let at = |n: u64| ((self.lights.len() as u64 * n) >> level) as usize;
        at(u64::from(node))..at(u64::from(node) + 1)
    }

    /// Runs of lights that may shine on a group, at least all that do within `cutoff` metres, with probabilities: even ones, or
    /// by about how much light they give. Lights nearer than `near` metres shine as from there. Returns how many lights
    /// there are in all.
    pub(super) fn choose(&self, group: &Group, rule: &ChoiceRule, choices: &mut Vec<Choice>) -> usize {
        choices.clear();
        if self.levels == 0 {
            return 0;
        }
        // Nodes of one level as indices in it, with their weights; what is fine enough moves to the choices.
        let mut level_nodes = vec![0u32];
        let mut next = Vec::new();
        let mut total = 0usize;
        let mut sum = 0.0f64;
        for level in 0..self.levels {
            let first = (1usize << level) - 1;
            let may_split = level + 1 < self.levels && choices.len() + level_nodes.len() <= rule.most_nodes;
            for &n in &level_nodes {
                let node = &self.nodes[first + n as usize];
                let Some((weight, is_coarse)) = node.weight_on(group, rule) else { continue };
                if is_coarse && may_split {
                    next.extend([2 * n, 2 * n + 1]);
                    continue;
                }
                total += node.view.len() as usize;
                sum += f64::from(weight);
                choices.push(Choice {
                    first: node.view.first,
                    count: node.view.len(),
                    until: 0.0,
                    probability: weight,
                });
            }
            std::mem::swap(&mut level_nodes, &mut next);
            next.clear();
        }
        let mut until = 0.0f64;
        for choice in choices.iter_mut() {
            let even = choice.count as f32 / total as f32;
            let share = (f64::from(choice.probability) / sum) as f32;
            choice.probability = match rule.by_importance && share.is_finite() {
                true => share + (even - share) * EVEN_SHARE,
                false => even,
            };
            until += f64::from(choice.probability);
            choice.until = until;
        }
        total
    }
}

/// This share of the choices takes any light with the same probability, so that a wrong guess of a node's weight makes noise
/// but no spikes.
const EVEN_SHARE: f32 = 0.15;

/// How [`LightTree::choose`] chooses.
#[derive(Debug, Clone, Copy)]
pub(super) struct ChoiceRule {
    /// Metres beyond which no light is wanted.
    pub(super) cutoff: f32,
    /// Metres, squared.
    pub(super) near2: f32,
    /// By weight, or evenly.
    pub(super) by_importance: bool,
    /// About how many nodes there are at most.
    pub(super) most_nodes: usize,
}

fn key([x, y, z]: [u32; 3], normal: [f32; 3]) -> u64 {
    let mut code = 0;
    for bit in (0..AXIS_BITS).rev() {
        code =
            code << 3 | u64::from(z >> bit & 1) << 2 | u64::from(y >> bit & 1) << 1 | u64::from(x >> bit & 1);
    }
    let side = match Vec3::from(normal) {
        Vec3::ZERO => 6,
        normal => {
            let axis = normal.abs().max_position();
            2 * axis as u64 + u64::from(normal[axis] < 0.0)
        }
    };
    let after = 3 * AXIS_BITS - BITS_BEFORE_SIDE;
    (code >> after) << (after + 3) | side << after | code & ((1 << after) - 1)
}

impl LightNode {
    fn new(lights: &[VirtualLight], run: Range<usize>) -> Self {
        let lights = &lights[run.clone()];
        let mut view = ViewNode {
            center: [0.0; 3],
            radius: 0.0,
            axis: [1.0, 0.0, 0.0],
            cos_psi: ALL_AROUND[0],
            sin_psi: ALL_AROUND[1],
            first: run.start as u32,
            count: run.len() as u32,
            reserved: 0,
        };
        if lights.is_empty() {
            return Self { view, intensity: 0.0 };
        }
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        let mut normals = Vec3::ZERO;
        let mut intensity = 0.0;
        for light in lights {
            (low, high) = (low.min(light.position.into()), high.max(light.position.into()));
            normals += Vec3::from(light.normal);
            intensity += luminance(light.intensity.into());
        }
        let center = (low + high) * 0.5;
        view.center = center.to_array();
        let axis = normals.normalize_or(Vec3::X);
        let mut cosine = 1.0f32;
        for light in lights {
            view.radius = view.radius.max(center.distance(light.position.into()));
            // A light without a normal is a cosine of 0 from any axis; it shines all around.
            cosine = cosine.min(if light.normal == [0.0; 3] { -1.0 } else { axis.dot(light.normal.into()) });
        }
        if cosine <= 0.0 {
            return Self { view, intensity };
        }
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        // A right angle more.
        (view.axis, view.cos_psi, view.sin_psi) = (axis.to_array(), -sine, cosine);
        Self { view, intensity }
    }

    /// About how much light it gives the group, and whether its lights differ much in that; `None` if none at all.
    fn weight_on(&self, group: &Group, rule: &ChoiceRule) -> Option<(f32, bool)> {
        if self.view.is_empty() {
            return None;
        }
        let to_group = Vec3::from(group.view.center) - Vec3::from(self.view.center);
        let length = to_group.length();
        let reach = self.view.radius + group.view.radius;
        if length - reach > rule.cutoff
            || is_culled(to_group.to_array(), length, group.view.radius, &self.view)
            || is_culled((-to_group).to_array(), length, self.view.radius, &group.view)
        {
            return None;
        }
        // The largest cosines that are possible, roughly.
        let blur = reach / length.max(reach);
        let at_group = facing(-to_group, length, &group.view);
        let at_light = facing(to_group, length, &self.view);
        let spread = 0.5 * reach;
        let distance2 = (length * length).max(spread * spread).max(rule.near2);
        let weight = self.intensity * (at_group + blur).min(1.0) * (at_light + blur).min(1.0) / distance2;
        let is_coarse = self.view.radius > 0.25 * (length - group.view.radius).max(rule.near2.sqrt());
        Some((weight, is_coarse))
    }
}

/// The largest cosine between an offset and the normals of what shines, or is lit, in the cone of a node.
fn facing(offset: Vec3, length: f32, view: &ViewNode) -> f32 {
    // The cone is a right angle wider than that of the normals.
    let (cosine, sine) = (view.sin_psi, -view.cos_psi);
    if cosine <= 0.0 {
        return 1.0;
    }
    let along = offset.dot(view.axis.into());
    let across = (length * length - along * along).max(0.0).sqrt();
    // Within the cone the largest is one.
    if along * sine >= across * cosine {
        return 1.0;
    }
    ((along * cosine + across * sine) / length.max(f32::MIN_POSITIVE)).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use manyview_shaders::cases::Random;

    fn lights(count: usize, seed: u64) -> Vec<VirtualLight> {
        let mut random = Random::new(seed);
        let mut unit = || random.range(-1000, 1000) as f32 / 1000.0;
        (0..count)
            .map(|_| {
                let normal = Vec3::new(unit(), unit(), unit()).normalize_or(Vec3::Y);
                VirtualLight {
                    position: [unit() * 5.0, unit(), unit() * 3.0],
                    normal: normal.to_array(),
                    intensity: [unit().abs() + 0.01; 3],
                }
            })
            .collect()
    }

    fn rule(by_importance: bool) -> ChoiceRule {
        ChoiceRule { cutoff: f32::INFINITY, near2: 1e-4, by_importance, most_nodes: 64 }
    }

    fn group(center: Vec3, normal: Vec3, radius: f32) -> Group {
        let half_space = ViewNode {
            center: center.to_array(),
            radius,
            axis: normal.to_array(),
            cos_psi: 0.0,
            sin_psi: 1.0,
            first: 0,
            count: 0,
            reserved: 0,
        };
        Group { view: half_space }
    }

    #[test]
    fn every_light_is_in_each_level_once() {
        for count in [1, 2, 15, 17, 33, 1000, 4097] {
            let given = lights(count, 3);
            let tree = LightTree::new(&given);
            let mut order = tree.order().to_vec();
            order.sort_unstable();
            assert_eq!(order, (0..count as u32).collect::<Vec<_>>());
            assert_eq!(tree.lights()[count / 2], given[tree.order()[count / 2] as usize]);
            for level in 0..tree.levels {
                let runs: Vec<_> = (0..1 << level).flat_map(|n| tree.run(level, n)).collect();
                assert_eq!(runs, (0..count).collect::<Vec<_>>(), "{count} {level}");
            }
            for node in &tree.nodes {
                for light in &tree.lights[node.view.range()] {
                    let away = Vec3::from(node.view.center).distance(light.position.into());
                    assert!(away <= node.view.radius * 1.0001);
                }
            }
        }
    }

    #[test]
    fn lights_that_shine_on_a_group_are_among_the_choices_with_probabilities_that_sum_to_one() {
        let tree = LightTree::new(&lights(5000, 9));
        let mut choices = Vec::new();
        let mut left_out = 0;
        for by_importance in [false, true] {
            for (center, normal) in [
                (Vec3::ZERO, Vec3::Y),
                (Vec3::new(9.0, 0.0, 0.0), Vec3::X),
                (Vec3::new(0.0, 2.0, 0.0), Vec3::Z),
            ] {
                let group = group(center, normal, 0.05);
                let total = tree.choose(&group, &rule(by_importance), &mut choices);
                assert_eq!(total, choices.iter().map(|c| c.count as usize).sum::<usize>());
                let mut is_chosen = vec![false; tree.lights().len()];
                for c in &choices {
                    assert!(c.probability > 0.0);
                    is_chosen[c.first as usize..(c.first + c.count) as usize].fill(true);
                }
                let sum = choices.last().map_or(1.0, |c| c.until);
                assert!((sum - 1.0).abs() < 1e-3, "{sum}");
                for (light, &is_chosen) in tree.lights().iter().zip(&is_chosen) {
                    let way = Vec3::from(light.position) - center;
                    let shines = way.dot(normal) > 0.0 && way.dot(light.normal.into()) < 0.0;
                    assert!(is_chosen || !shines);
                    left_out += usize::from(!is_chosen);
                }
            }
        }
        assert!(left_out > 10_000, "of 30,000 lights {left_out} were left out");
    }

    #[test]
    fn odd_lights_are_left_out() {
        let mut given = lights(9, 1);
        given[2].position[1] = f32::NAN;
        given[3].intensity = [0.0; 3];
        given[4].normal[0] = f32::INFINITY;
        let tree = LightTree::new(&given);
        assert_eq!(tree.lights().len(), 6);
        let none = LightTree::new(&[]);
        assert_eq!(none.choose(&group(Vec3::ZERO, Vec3::Y, 0.0), &rule(true), &mut Vec::new()), 0);
        // All at one place.
        let one = VirtualLight { position: [1.0; 3], normal: [0.0; 3], intensity: [1.0; 3] };
        let tree = LightTree::new(&[one; 100]);
        let total = tree.choose(&group(Vec3::ZERO, Vec3::Y, 0.0), &rule(true), &mut Vec::new());
        assert_eq!(total, 100);
    }
}
