//! Many rigid instances of a few baked objects.
//!
//! # Theory
//! \[WMP\] Algorithm 4: an array of rows for the static part and one for each *type* of object. A segment is taken into
//! the frame of every instance and tested against the array of its type; it is occluded if any test says so.
//!
//! # Differences from the paper
//! - Instances are found by a bounding volume hierarchy over their world bounds, not by a loop over all of them.
//! - A segment is clipped to an instance's bounds before it is tested: what it meets is inside of them, and a shorter
//!   segment leaves its row less far.
//! - Transforms may scale uniformly and mirror.
//!
//! # The origin's own surface
//! A method that skips the surface which a segment starts on ([`Segment::normal`]) must do so in the instance that the
//! surface belongs to, and a segment does not say which that is. So the normal is kept for instances whose bounds hold
//! the origin, and zero for all others. Where bounds overlap, an object that only stands beside the origin, within a
//! voxel of its type's rows, may be skipped as if it were its surface: a shadow begins that much later. The static part
//! holds most origins, and there the voxel is that of the static rows.
//!
//! # Practice
//! Segments come in blocks, and the pairs of a segment and an instance of one type go to that type's method together,
//! whatever instance they belong to: few calls with many segments. Each segment's instances are tested in the order in
//! which it enters them, in rounds of 1, 1, 2, 4 … of them, so that most are never tested where one hides the target.

mod transform;
mod tree;

pub use transform::{Similarity, TransformProblem};
pub use tree::TreeUpdate;

use crate::visibility::{LightPoint, Receiver, Segment, Visibility, VisibilityError, light_words};
use glam::DVec3;
use manyview_shaders::testable::testable;
use rayon::prelude::*;
use thiserror::Error;
use tree::{Bounds, Tree};

/// Segments of a block: what is in flight between the hierarchy and the methods.
const BLOCK: usize = 1 << 15;
/// Bounds are widened by this share of their diagonal, so that clipped ends lie clear of a surface in them.
const MARGIN: f64 = 1e-4;

/// Why there is no scene of instances.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum InstanceError {
    /// An object's bounds are no box.
    #[error("the bounds of object type {kind}, {min:?} to {max:?}, are no box of finite numbers")]
    Bounds {
        /// Index of the type.
        kind: usize,
        /// Its smallest corner.
        min: [f64; 3],
        /// Its largest corner.
        max: [f64; 3],
    },
    /// An instance is of a type that is not there.
    #[error("instance {instance} is of object type {kind}; there are {kinds}")]
    NoSuchType {
        /// Index of the instance.
        instance: usize,
        /// The type it names.
        kind: usize,
        /// Number of types.
        kinds: usize,
    },
    /// An instance that is not there was moved.
    #[error("there is no instance {instance}; there are {instances}")]
    NoSuchInstance {
        /// The index.
        instance: usize,
        /// Number of instances.
        instances: usize,
    },
    /// More instances than an index of 32 bits can tell apart.
    #[error("{instances} instances are more than 2^31")]
    TooMany {
        /// Number of instances.
        instances: usize,
    },
}

/// A type of objects: how segments are tested against one, in its own space.
pub struct ObjectType<'a> {
    /// The method, in object space.
    pub visibility: Box<dyn Visibility + 'a>,
    /// Smallest and largest corner of what it holds, object space, metres.
    pub bounds: [DVec3; 2],
}

/// One object of a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Instance {
    /// Index of its type.
    pub kind: usize,
    /// Where it stands.
    pub world_from_object: Similarity,
}

/// A scene of instances. The part that does not move is one of them, with the identity as its transform.
pub struct InstancedScene<'a> {
    kinds: Vec<ObjectType<'a>>,
    instances: Vec<Instance>,
    /// Instances in place that span most of the scene: every segment is tested against them, first.
    in_place: Vec<u32>,
    tree: Tree,
}

/// A segment against one instance.
struct Job {
    kind: u32,
    /// Index of the segment in its block.
    owner: u32,
    /// In object space, clipped.
    segment: Segment,
    /// World-space metres from the segment's origin to the clipped one.
    before_metres: f64,
    /// World-space metres for each in object space.
    scale: f64,
}

/// Tests jobs of one type by its method.
type TestJobs<'a> = dyn FnMut(&dyn Visibility, &[Job]) -> Result<(), VisibilityError> + 'a;

impl<'a> InstancedScene<'a> {
    /// Puts instances of objects into a scene.
    pub fn new(kinds: Vec<ObjectType<'a>>, instances: Vec<Instance>) -> Result<Self, InstanceError> {
        let mut kinds = kinds;
        for (kind, object) in kinds.iter_mut().enumerate() {
            let [min, max] = object.bounds;
            if !(min.is_finite() && max.is_finite() && min.cmple(max).all()) {
                return Err(InstanceError::Bounds { kind, min: min.to_array(), max: max.to_array() });
            }
            let margin = ((max - min).length() * MARGIN).max(f64::from(f32::MIN_POSITIVE));
            object.bounds = [min - margin, max + margin];
        }
        if instances.len() > 1 << 31 {
            return Err(InstanceError::TooMany { instances: instances.len() });
        }
        if let Some((instance, found)) = instances.iter().enumerate().find(|(_, i)| i.kind >= kinds.len()) {
            return Err(InstanceError::NoSuchType { instance, kind: found.kind, kinds: kinds.len() });
        }
        let mut scene = Self { kinds, instances, in_place: Vec::new(), tree: Tree::default() };
        scene.rebuild();
        Ok(scene)
    }

    /// The instances.
    pub fn instances(&self) -> &[Instance] {
        &self.instances
    }

    /// Moves instances, each by its index, and adapts the hierarchy: fitted to the new bounds, or built anew where
    /// that would make it slow. Either way answers are the same as those of a new scene.
    pub fn move_instances(&mut self, moves: &[(usize, Similarity)]) -> Result<TreeUpdate, InstanceError> {
        let instances = self.instances.len();
        if let Some(&(instance, _)) = moves.iter().find(|(instance, _)| *instance >= instances) {
            return Err(InstanceError::NoSuchInstance { instance, instances });
        }
        let mut in_place_moved = false;
        for &(instance, world_from_object) in moves {
            self.instances[instance].world_from_object = world_from_object;
            in_place_moved |= self.in_place.binary_search(&(instance as u32)).is_ok();
        }
        if in_place_moved {
            self.rebuild();
            return Ok(TreeUpdate::Rebuilt);
        }
        let (kinds, all) = (&self.kinds, &self.instances);
        let update = self.tree.refit(|index| world_bounds(kinds, &all[index as usize]));
        if update == TreeUpdate::Rebuilt {
            self.rebuild();
        }
        Ok(update)
    }

    fn rebuild(&mut self) {
        let (kinds, instances) = (&self.kinds, &self.instances);
        let bounds: Vec<Bounds> = instances.par_iter().map(|i| world_bounds(kinds, i)).collect();
        let whole = bounds.iter().fold(Bounds::EMPTY, |all, one| all.union(one));
        let spans_most = |index: usize| bounds[index].diagonal() * 2.0 >= whole.diagonal();
        let all = 0..instances.len() as u32;
        let (in_place, others): (Vec<u32>, Vec<u32>) = all.partition(|&index| {
            let index = index as usize;
            instances[index].world_from_object == Similarity::IDENTITY && spans_most(index)
        });
        self.in_place = in_place;
        self.tree = Tree::new(others, &bounds);
    }

    /// The part of a segment within an instance's bounds, in object space.
    fn job(&self, owner: usize, segment: &Segment, index: u32) -> Option<Job> {
        let segment = testable(segment)?;
        let instance = &self.instances[index as usize];
        let transform = &instance.world_from_object;
        let [origin, target] = [segment.origin, segment.target].map(|p| transform.object_point(point(p)));
        let [min, max] = self.kinds[instance.kind].bounds;
        let (enter, leave) = clip(origin, target - origin, min, max)?;
        let normal = match enter {
            0.0 => transform.object_normal(point(segment.normal)),
            _ => DVec3::ZERO,
        };
        let at = |t: f64| match t {
            0.0 => origin,
            1.0 => target,
            t => origin + (target - origin) * t,
        };
        let as_f32 = |v: DVec3| v.as_vec3().to_array();
        let segment =
            Segment { origin: as_f32(at(enter)), target: as_f32(at(leave)), normal: as_f32(normal) };
        let before_metres = enter * (target - origin).length() * transform.scale();
        let kind = instance.kind as u32;
        Some(Job { kind, owner: owner as u32, segment, before_metres, scale: transform.scale() })
    }

    /// Tests the segments that `undecided` says against the instances of the hierarchy, round by round. `test` is
    /// given the jobs of one type at a time; `undecided` takes a segment's index and the distance, in metres, from
    /// which on it goes through the next instance.
    fn rounds(
        &self,
        segments: &[Segment],
        undecided: &(dyn Fn(usize, f64) -> bool + Sync),
        test: &mut TestJobs<'_>,
    ) -> Result<(), VisibilityError> {
        let candidates: Vec<Vec<(f64, u32)>> = segments
            .par_iter()
            .enumerate()
            .map_init(Vec::new, |stack, (index, segment)| match undecided(index, 0.0) {
                true if testable(segment).is_some() => {
                    self.tree.candidates(point(segment.origin), point(segment.target), stack)
                }
                _ => Vec::new(),
            })
            .collect();
        let (mut from, mut count) = (0, 1);
        loop {
            let of_segment = |(index, candidates): (usize, &Vec<(f64, u32)>)| {
                let length = (point(segments[index].target) - point(segments[index].origin)).length();
                let end = candidates.len().min(from + count);
                let these = candidates.get(from..end).unwrap_or(&[]);
                let these = these.iter().take_while(move |(enter, _)| undecided(index, enter * length));
                these
                    .filter_map(|&(_, instance)| self.job(index, &segments[index], instance))
                    .collect::<Vec<_>>()
            };
            if !candidates.iter().any(|candidates| candidates.len() > from) {
                return Ok(());
            }
            let mut jobs: Vec<Job> = candidates.par_iter().enumerate().flat_map_iter(of_segment).collect();
            jobs.sort_by_key(|job| job.kind);
            for jobs in jobs.chunk_by(|a, b| a.kind == b.kind) {
                test(&*self.kinds[jobs[0].kind as usize].visibility, jobs)?;
            }
            (from, count) = (from + count, if from == 0 { 1 } else { count * 2 });
        }
    }

    /// ORs into `occluded` what the instances of the hierarchy hide.
    fn occlude(&self, segments: &[Segment], occluded: &mut [u8]) -> Result<(), VisibilityError> {
        let found: Vec<std::sync::atomic::AtomicBool> =
            occluded.iter().map(|&hit| std::sync::atomic::AtomicBool::new(hit != 0)).collect();
        let order = std::sync::atomic::Ordering::Relaxed;
        let mut answers = Vec::new();
        self.rounds(segments, &|index, _| !found[index].load(order), &mut |method, jobs| {
            let segments: Vec<Segment> = jobs.iter().map(|job| job.segment).collect();
            answers.clear();
            answers.resize(jobs.len(), 0);
            method.occluded(&segments, &mut answers)?;
            for (job, _) in jobs.iter().zip(&answers).filter(|(_, answer)| **answer != 0) {
                found[job.owner as usize].store(true, order);
            }
            Ok(())
        })?;
        for (occluded, found) in occluded.iter_mut().zip(found) {
            *occluded = u8::from(found.into_inner());
        }
        Ok(())
    }

    fn method_in_place(&self, instance: u32) -> &dyn Visibility {
        &*self.kinds[self.instances[instance as usize].kind].visibility
    }
}

impl Visibility for InstancedScene<'_> {
    fn name(&self) -> &'static str {
        "instances"
    }

    fn occluded(&self, segments: &[Segment], occluded: &mut [u8]) -> Result<(), VisibilityError> {
        assert_eq!(segments.len(), occluded.len(), "one answer for each segment");
        occluded.fill(0);
        let mut answers = vec![0; if self.in_place.is_empty() { 0 } else { segments.len() }];
        for &instance in &self.in_place {
            self.method_in_place(instance).occluded(segments, &mut answers)?;
            for (occluded, answer) in occluded.iter_mut().zip(&answers) {
                *occluded |= answer;
            }
        }
        for (segments, occluded) in segments.chunks(BLOCK).zip(occluded.chunks_mut(BLOCK)) {
            self.occlude(segments, occluded)?;
        }
        Ok(())
    }

    fn distances(&self, segments: &[Segment], distances: &mut [f32]) -> Result<(), VisibilityError> {
        assert_eq!(segments.len(), distances.len(), "one answer for each segment");
        distances.fill(f32::INFINITY);
        let mut answers = vec![0.0; if self.in_place.is_empty() { 0 } else { segments.len() }];
        for &instance in &self.in_place {
            self.method_in_place(instance).distances(segments, &mut answers)?;
            for (distance, answer) in distances.iter_mut().zip(&answers) {
                *distance = distance.min(*answer);
            }
        }
        for (segments, distances) in segments.chunks(BLOCK).zip(distances.chunks_mut(BLOCK)) {
            // Bits of a positive float are in the order of its values.
            let nearest: Vec<std::sync::atomic::AtomicU32> =
                distances.iter().map(|d| std::sync::atomic::AtomicU32::new(d.to_bits())).collect();
            let order = std::sync::atomic::Ordering::Relaxed;
            let undecided =
                |index: usize, enter: f64| enter < f64::from(f32::from_bits(nearest[index].load(order)));
            self.rounds(segments, &undecided, &mut |method, jobs| {
                let segments: Vec<Segment> = jobs.iter().map(|job| job.segment).collect();
                let mut answers = vec![0.0; jobs.len()];
                method.distances(&segments, &mut answers)?;
                for (job, answer) in jobs.iter().zip(answers).filter(|(_, answer)| answer.is_finite()) {
                    let distance = (job.before_metres + f64::from(answer) * job.scale) as f32;
                    nearest[job.owner as usize].fetch_min(distance.to_bits(), order);
                }
                Ok(())
            })?;
            for (distance, nearest) in distances.iter_mut().zip(nearest) {
                *distance = f32::from_bits(nearest.into_inner());
            }
        }
        Ok(())
    }

    fn hidden_lights(
        &self,
        receivers: &[Receiver],
        lights: &[LightPoint],
        hidden: &mut [u32],
    ) -> Result<(), VisibilityError> {
        let words = light_words(lights.len());
        assert_eq!(hidden.len(), receivers.len() * words, "one bit for each receiver and light");
        hidden.fill(0);
        let mut answers = vec![0; if self.in_place.is_empty() { 0 } else { hidden.len() }];
        for &instance in &self.in_place {
            self.method_in_place(instance).hidden_lights(receivers, lights, &mut answers)?;
            for (hidden, answer) in hidden.iter_mut().zip(&answers) {
                *hidden |= answer;
            }
        }
        if words == 0 {
            return Ok(());
        }
        receivers.par_iter().zip(hidden.par_chunks_mut(words)).for_each(|(receiver, hidden)| {
            for (index, _) in lights.iter().enumerate().filter(|(_, light)| light.is_behind(receiver)) {
                hidden[index / 32] |= 1 << (index % 32);
            }
        });
        if self.tree.is_empty() {
            return Ok(());
        }
        // Whole words of lights for a tile of receivers, light after light: neighbours ask about the same instances.
        let tile = (BLOCK / 32).min(receivers.len()).max(1);
        let (mut segments, mut pairs, mut occluded) = (Vec::new(), Vec::new(), Vec::new());
        for (tile, receivers) in receivers.chunks(tile).enumerate().map(|(i, r)| (i * tile, r)) {
            for word in 0..words {
                segments.clear();
                pairs.clear();
                for (bit, light) in lights[word * 32..].iter().take(32).enumerate() {
                    for (index, receiver) in receivers.iter().enumerate() {
                        let at = (tile + index) * words + word;
                        if hidden[at] >> bit & 1 == 0 {
                            segments.push(light.segment_from(receiver));
                            pairs.push((at, bit));
                        }
                    }
                }
                occluded.clear();
                occluded.resize(segments.len(), 0);
                self.occlude(&segments, &mut occluded)?;
                for (&(at, bit), &occluded) in pairs.iter().zip(&occluded) {
                    hidden[at] |= u32::from(occluded) << bit;
                }
            }
        }
        Ok(())
    }
}

fn point(v: [f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}

/// Where a segment enters and leaves a box, as shares of its way.
fn clip(origin: DVec3, way: DVec3, min: DVec3, max: DVec3) -> Option<(f64, f64)> {
    let (mut enter, mut leave) = (0.0f64, 1.0f64);
    for axis in 0..3 {
        if way[axis] == 0.0 {
            if origin[axis] < min[axis] || origin[axis] > max[axis] {
                return None;
            }
            continue;
        }
        let (a, b) = ((min[axis] - origin[axis]) / way[axis], (max[axis] - origin[axis]) / way[axis]);
        (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
    }
    (enter < leave).then_some((enter, leave))
}

/// World-space bounds of an instance.
fn world_bounds(kinds: &[ObjectType<'_>], instance: &Instance) -> Bounds {
    let [min, max] = kinds[instance.kind].bounds;
    let transform = &instance.world_from_object;
    let center = transform.world_point((min + max) * 0.5);
    let half = transform.world_reach((max - min) * 0.5);
    Bounds::around(center - half, center + half)
}

#[cfg(all(test, feature = "bake"))]
mod tests;
