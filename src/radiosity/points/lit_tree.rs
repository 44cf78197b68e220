//! The lit tree: an octree that knows what light its nodes send out, and to which side.
//!
//! # Theory
//! \[ML\] (Applications) lights the points of a tree once and takes means up the tree; a cut of such a *lit* tree is then
//! all that a receiver needs to know of the scene.
//!
//! # Sides
//! A surface that is lit in front must not shine behind. Leaves are lit on both sides of their normal, apart. A node sums up
//! the fronts of its leaves by the six faces of a cube: a front adds to the three faces that it is turned to, by the cosine.
//! Towards a direction the node then shines with the mean of the three faces that are turned there, again by the cosine; so
//! that of a pillar's four sides that one counts which is seen. Backs are one sum. They count where no front can be seen: where
//! the node's fronts all face one octant, as those of a sheet do, and the mean of them faces away. Backs of closed surfaces,
//! which nobody sees, are black and do not darken the fronts.
//!
//! \[ML\] Holländer et al., *ManyLoDs*, CGF 30(4), 2011.

use crate::render::gbuffer::{GBuffer, Pixel};
use crate::render::image::{RenderError, render_with};
use crate::render::scene::RenderScene;
use crate::render::shade::Lighting;
use crate::visibility::Visibility;
use glam::{Vec3, Vec4};
use manyview_pipeline::bake::Progress;
use manyview_pipeline::scene::PunctualLight;
use manyview_shaders::srgb;
use manyview_shaders::svo::Svo;
use manyview_shaders::{octahedral, rgb9e5};
use rayon::prelude::*;

/// The most nodes of the deepest level that light is kept for: \[ML\] has as many points.
pub const MOST_LIT_NODES: usize = 1 << 20;
/// The most segments from samples to lights, unless the level is a coarse one.
const MOST_SEGMENTS: usize = 1 << 28;
/// Levels that are lit whatever the number of lights.
const LEAST_LEVELS: u32 = 5;
/// Leaves of the octree that are lit for a node of the deepest lit level.
const SAMPLES: usize = 4;
/// Lit nodes whose samples are in memory together.
const NODES_AT_ONCE: usize = 1 << 15;
/// Samples are so many leaves off the middle of their leaf, in front and behind: off the surface, which is in the leaf.
const LIFT_VOXELS: f32 = 1.0;
/// A node is one sheet if the sum of its normals is at least this share of what it were if all faced one octant.
const SHEET: f32 = 0.9;

/// Light of a node: radiances weighted by area and cosine, and in the last place the weights.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Node {
    /// Fronts by the face that they are turned to: −x, +x, −y, +y, −z, +z.
    fronts: [Vec4; 6],
    /// Backs, whichever way they face.
    back: Vec4,
}

/// An octree's light, down to a level.
#[derive(Debug, Clone, PartialEq)]
pub struct LitTree {
    /// Breadth first.
    nodes: Vec<Node>,
    level: u32,
    samples: u64,
}

/// What of a surface is lit: one leaf's.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    pub(super) position: Vec3,
    pub(super) normal: Vec3,
    pub(super) albedo: Vec3,
    pub(super) emissive: Vec3,
    /// How many leaves it stands for.
    pub(super) weight: f32,
}

impl LitTree {
    /// Lights a validated octree of a scene by `lights`, as far as `method` says that they are seen. What glows shines on both
    /// sides.
    pub fn new(
        svo: &Svo,
        scene: &RenderScene,
        lights: &[PunctualLight],
        method: &dyn Visibility,
        progress: &dyn Progress,
    ) -> Result<Self, RenderError> {
        let lighting = Lighting::new(lights, scene).without_ambient();
        let voxel = svo.voxel_size() as f32;
        Self::with_radiances(svo, lights.len(), |samples| {
            let sides = samples.iter().flat_map(|sample| {
                [1.0, -1.0].map(|side| {
                    let normal = (sample.normal * side).to_array();
                    Pixel {
                        position: (sample.position + sample.normal * (side * voxel * LIFT_VOXELS)).to_array(),
                        geometric_normal: normal,
                        normal,
                        albedo: sample.albedo.to_array(),
                        emissive: sample.emissive.to_array(),
                        depth: 0.0,
                        triangle: 0,
                    }
                })
            });
            let pixels: Vec<Pixel> = sides.collect();
            let gbuffer = GBuffer { width: pixels.len() as u32, height: 1, pixels };
            let image = render_with(&lighting, scene, &gbuffer, lights, method, None, progress)?;
            Ok(image.radiance.chunks(2).map(|sides| [sides[0].into(), sides[1].into()]).collect())
        })
    }

    /// An octree whose leaves shine by what they emit alone.
    pub fn glowing(svo: &Svo) -> Self {
        let glow = |samples: &[Sample]| -> Result<_, std::convert::Infallible> {
            Ok(samples.iter().map(|sample| [sample.emissive; 2]).collect())
        };
        let Ok(tree) = Self::with_radiances(svo, 0, glow);
        tree
    }

    /// `light` says what samples shine with in front and behind.
    pub(super) fn with_radiances<E>(
        svo: &Svo,
        lights: usize,
        mut light: impl FnMut(&[Sample]) -> Result<Vec<[Vec3; 2]>, E>,
    ) -> Result<Self, E> {
        let level = lit_level(svo, lights);
        let leaves = leaves_below(svo, level);
        let samples = Samples::new(svo);
        let mut deepest = vec![Node::default(); svo.node_count(level as usize)];
        let mut count = 0;
        for (nodes, bounds) in deepest.chunks_mut(NODES_AT_ONCE).zip(windows(&leaves, NODES_AT_ONCE)) {
            let of_node = |bounds: &[u32]| samples.of(bounds[0], bounds[1]);
            let taken: Vec<Vec<Sample>> = bounds.par_windows(2).map(of_node).collect();
            let radiances = light(&taken.concat())?;
            let mut of_samples = radiances.iter();
            for (node, taken) in nodes.iter_mut().zip(&taken) {
                for (sample, &[front, back]) in taken.iter().zip(&mut of_samples) {
                    node.add(sample, front, back);
                }
            }
            count += radiances.len() as u64;
        }
        let mut levels = vec![deepest];
        for above in (0..level as usize).rev() {
            let below = &levels[levels.len() - 1];
            let first = svo.first_children(above);
            let sum = |bounds: &[u32]| {
                let children = &below[bounds[0] as usize..bounds[1] as usize];
                children.iter().fold(Node::default(), |sum, child| sum.and(child))
            };
            levels.push(first.par_windows(2).map(sum).collect());
        }
        levels.reverse();
        Ok(Self { nodes: levels.concat(), level, samples: count })
    }

    /// The deepest level that light is known for.
    pub fn level(&self) -> u32 {
        self.level
    }

    /// Number of nodes, of all levels.
    pub fn node_count(&self) -> usize {
        self.nodes.len()
    }

    /// How many leaves of the octree were lit.
    pub fn sample_count(&self) -> u64 {
        self.samples
    }

    /// For every node of the octree, breadth first, the node of this tree that tells its light: itself, or the one above it
    /// at [`LitTree::level`].
    pub fn node_of(&self, svo: &Svo) -> Vec<u32> {
        let mut all: Vec<u32> = (0..self.nodes.len() as u32).collect();
        let mut above: Vec<u32> = all[all.len() - svo.node_count(self.level as usize)..].to_vec();
        for level in &svo.levels[self.level as usize..svo.depth() as usize] {
            let children = level.child_masks.iter().map(|mask| mask.count_ones() as usize);
            above = above
                .iter()
                .zip(children)
                .flat_map(|(&node, count)| std::iter::repeat_n(node, count))
                .collect();
            all.extend_from_slice(&above);
        }
        all
    }

    /// Radiance that a node sends along a unit vector.
    #[inline]
    pub fn radiance(&self, node: u32, direction: Vec3) -> Vec3 {
        let node = &self.nodes[node as usize];
        let mut sum = Vec4::ZERO;
        let (mut facing, mut normals, mut areas) = (0.0, 0.0, 0.0);
        for axis in 0..3 {
            let [minus, plus] = [node.fronts[2 * axis], node.fronts[2 * axis + 1]];
            let along = direction[axis];
            sum += if along < 0.0 { minus } else { plus } * along.abs();
            let (normal, area) = (plus.w - minus.w, plus.w + minus.w);
            facing += normal * along;
            normals += normal * normal;
            areas += area * area;
        }
        let is_behind = facing < 0.0 && normals >= areas * (SHEET * SHEET);
        let shown = if is_behind || sum.w <= 0.0 { node.back } else { sum };
        if shown.w > 0.0 { shown.truncate() / shown.w } else { Vec3::ZERO }
    }
}

impl Node {
    fn add(&mut self, sample: &Sample, front: Vec3, back: Vec3) {
        for axis in 0..3 {
            let cosine = sample.normal[axis];
            let face = 2 * axis + usize::from(cosine > 0.0);
            self.fronts[face] += front.extend(1.0) * (cosine.abs() * sample.weight);
        }
        self.back += back.extend(1.0) * sample.weight;
    }

    fn and(self, other: &Self) -> Self {
        Self {
            fronts: [0, 1, 2, 3, 4, 5].map(|face| self.fronts[face] + other.fronts[face]),
            back: self.back + other.back,
        }
    }
}

/// The deepest level of which not too many nodes have to be lit.
fn lit_level(svo: &Svo, lights: usize) -> u32 {
    let fits = |level: u32| {
        let nodes = svo.node_count(level as usize);
        nodes <= MOST_LIT_NODES && (level <= LEAST_LEVELS || nodes * SAMPLES * lights.max(1) <= MOST_SEGMENTS)
    };
    (0..=svo.depth()).rev().find(|&level| fits(level)).unwrap_or(0)
}

/// Where the leaves below every node of a level begin, and the number of leaves.
fn leaves_below(svo: &Svo, level: u32) -> Vec<u32> {
    let mut bounds: Vec<u32> = (0..=svo.node_count(level as usize) as u32).collect();
    for level in level..svo.depth() {
        let first = svo.first_children(level as usize);
        bounds.iter_mut().for_each(|bound| *bound = first[*bound as usize]);
    }
    bounds
}

/// Runs of `count` spans of the list of their bounds.
fn windows(bounds: &[u32], count: usize) -> impl Iterator<Item = &[u32]> {
    (0..bounds.len() - 1).step_by(count).map(move |at| &bounds[at..=(at + count).min(bounds.len() - 1)])
}

/// The leaves of an octree, as they can be lit.
struct Samples<'a> {
    svo: &'a Svo,
    cells: Vec<[u16; 3]>,
}

impl<'a> Samples<'a> {
    fn new(svo: &'a Svo) -> Self {
        Self { svo, cells: svo.cells(svo.depth() as usize) }
    }

    /// A few of the leaves from `start` to `end`, which are in Morton order, so that evenly spaced ones are well spread.
    fn of(&self, start: u32, end: u32) -> Vec<Sample> {
        let leaves = (end - start) as usize;
        let count = leaves.min(SAMPLES);
        let of = |number: usize| {
            let leaf = start as usize + (2 * number + 1) * leaves / (2 * count);
            self.leaf(leaf, leaves as f32 / count as f32)
        };
        (0..count).map(of).collect()
    }

    fn leaf(&self, leaf: usize, weight: f32) -> Sample {
        let level = &self.svo.levels[self.svo.depth() as usize];
        let voxel = self.svo.voxel_size();
        let cell = self.cells[leaf];
        let position = [0, 1, 2].map(|i| (self.svo.origin[i] + (f64::from(cell[i]) + 0.5) * voxel) as f32);
        let emissive = level.emissive.get(leaf).map_or([0.0; 3], |&packed| rgb9e5::decode(packed));
        Sample {
            position: position.into(),
            normal: octahedral::decode(level.normals[leaf]).map(|c| c as f32).into(),
            albedo: level.colors[leaf].map(srgb::linear).into(),
            emissive: emissive.map(|c| c as f32).into(),
            weight,
        }
    }
}
