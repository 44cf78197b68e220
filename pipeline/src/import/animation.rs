//! Node transforms and morph weights at one time of an animation.

use super::accessor::Accessor;
use super::error::ImportError;
use super::json::Json;
use super::nodes::unit;
use super::resources::Resources;
use std::collections::BTreeMap;

/// What an animation sets of a node.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct NodePose {
    pub(super) translation: Option<[f64; 3]>,
    pub(super) rotation: Option<[f64; 4]>,
    pub(super) scale: Option<[f64; 3]>,
    pub(super) weights: Option<Vec<f32>>,
}

impl NodePose {
    /// The node's transform is animated.
    pub(super) fn moves(&self) -> bool {
        self.translation.is_some() || self.rotation.is_some() || self.scale.is_some()
    }
}

/// What an animation sets at one time; empty for the rest pose.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Pose(BTreeMap<usize, NodePose>);

impl Pose {
    /// What is set of node `index`.
    pub(super) fn node(&self, index: usize) -> Option<&NodePose> {
        self.0.get(&index)
    }

    /// The pose of `animations[animation]` at `time_seconds`, before its first and after its last keyframe that keyframe.
    pub(super) fn sample(
        resources: &Resources<'_>,
        animation: usize,
        time_seconds: f64,
    ) -> Result<Self, ImportError> {
        let mut pose = Self::default();
        if resources.root.len("animations")? == 0 {
            resources.warn("the scene has no animations: the time asked for changes nothing".to_owned());
            return Ok(pose);
        }
        let animation = resources.root.item("animations", animation)?;
        for channel in animation.items("channels")? {
            let target =
                channel.object("target")?.ok_or_else(|| channel.malformed_at("target", "is missing"))?;
            let path = target.string("path")?;
            let Some(node_index) = target.reference("node", &resources.root, "nodes")? else {
                if path == Some("pointer") {
                    resources.warn(format!("{}: KHR_animation_pointer is ignored", target.place()));
                }
                continue;
            };
            let node = resources.root.item("nodes", node_index)?;
            let sampler = animation.item("samplers", channel.required_index("sampler")?)?;
            let width = match path {
                Some("translation" | "scale") => 3,
                Some("rotation") => 4,
                Some("weights") => morph_target_count(resources, &node)?,
                _ => continue,
            };
            if width == 0 {
                continue;
            }
            let value = sample(resources, &sampler, width, path == Some("rotation"), time_seconds)?;
            let node_pose = pose.0.entry(node_index).or_default();
            match (path, value.as_slice()) {
                (Some("translation"), &[x, y, z]) => node_pose.translation = Some([x, y, z]),
                (Some("scale"), &[x, y, z]) => node_pose.scale = Some([x, y, z]),
                (Some("rotation"), &[x, y, z, w]) => node_pose.rotation = Some([x, y, z, w]),
                _ => node_pose.weights = Some(value.iter().map(|weight| *weight as f32).collect()),
            }
        }
        Ok(pose)
    }
}

/// Morph targets of the node's mesh.
fn morph_target_count(resources: &Resources<'_>, node: &Json<'_>) -> Result<usize, ImportError> {
    let Some(mesh) = node.reference("mesh", &resources.root, "meshes")? else { return Ok(0) };
    let mesh = resources.root.item("meshes", mesh)?;
    if mesh.len("primitives")? == 0 { Ok(0) } else { mesh.item("primitives", 0)?.len("targets") }
}

fn sample(
    resources: &Resources<'_>,
    sampler: &Json<'_>,
    width: usize,
    rotation: bool,
    time: f64,
) -> Result<Vec<f64>, ImportError> {
    let input = Accessor::parse(resources, sampler.required_index("input")?)?;
    let output = Accessor::parse(resources, sampler.required_index("output")?)?;
    let interpolation = sampler.string("interpolation")?.unwrap_or("LINEAR");
    let parts = if interpolation == "CUBICSPLINE" { 3 } else { 1 };
    let times = input.read(resources, None, &sampler.place())?;
    let ascending = times.iter().all(|time| time.is_finite()) && times.is_sorted_by(|a, b| a < b);
    if input.width != 1 || times.is_empty() || !ascending {
        return Err(input.malformed("keyframe times must be finite scalars, each larger than the one before"));
    }
    let values = output.read(resources, None, &sampler.place())?;
    if values.len() != times.len() * width * parts {
        return Err(output.malformed(format!(
            "holds {} numbers, but {} keyframes of {width} need {}",
            values.len(),
            times.len(),
            times.len() * width * parts
        )));
    }
    if values.iter().any(|value| !value.is_finite()) {
        return Err(output.malformed("keyframe values must be finite"));
    }
    let part = |key: usize, part: usize| -> Vec<f64> {
        values[(key * parts + part) * width..][..width].iter().map(|value| f64::from(*value)).collect()
    };
    let middle = parts / 2;
    let next = times.partition_point(|key| f64::from(*key) <= time);
    if next == 0 || next == times.len() || interpolation == "STEP" {
        return Ok(part(next.saturating_sub(1), middle));
    }
    let (start, end) = (f64::from(times[next - 1]), f64::from(times[next]));
    let t = (time - start) / (end - start);
    let (a, b) = (part(next - 1, middle), part(next, middle));
    if parts == 3 {
        let (tangent_out, tangent_in) = (part(next - 1, 2), part(next, 0));
        let span = end - start;
        let value = |i: usize| hermite(a[i], span * tangent_out[i], b[i], span * tangent_in[i], t);
        return Ok((0..width).map(value).collect());
    }
    if let (true, &[ax, ay, az, aw], &[bx, by, bz, bw]) = (rotation, a.as_slice(), b.as_slice()) {
        return Ok(slerp([ax, ay, az, aw], [bx, by, bz, bw], t).to_vec());
    }
    Ok(a.iter().zip(&b).map(|(a, b)| a + (b - a) * t).collect())
}

/// Cubic from `a` to `b` with slopes `da` and `db`.
fn hermite(a: f64, da: f64, b: f64, db: f64, t: f64) -> f64 {
    let (t2, t3) = (t * t, t * t * t);
    a * (2.0 * t3 - 3.0 * t2 + 1.0) + da * (t3 - 2.0 * t2 + t) + b * (3.0 * t2 - 2.0 * t3) + db * (t3 - t2)
}

/// Spherical interpolation along the shorter way, by halving the arc: no sine, which differs between hosts, is needed.
fn slerp(a: [f64; 4], b: [f64; 4], t: f64) -> [f64; 4] {
    let mut low = unit(a);
    let mut high = unit(b);
    let dot: f64 = low.iter().zip(high).map(|(a, b)| a * b).sum();
    if dot < 0.0 {
        high = high.map(|value| -value);
    }
    let mut t = t.clamp(0.0, 1.0);
    for _ in 0..f64::MANTISSA_DIGITS {
        let middle = unit([low[0] + high[0], low[1] + high[1], low[2] + high[2], low[3] + high[3]]);
        t *= 2.0;
        if t >= 1.0 {
            low = middle;
            t -= 1.0;
        } else {
            high = middle;
        }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_third_of_a_right_angle_is_thirty_degrees() {
        // Quaternions hold half the angle: 0 and 45 degrees, so 15 degrees at a third.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let q = slerp([0.0, 0.0, 0.0, 1.0], [0.0, half, 0.0, half], 1.0 / 3.0);
        let (sin_15, cos_15) = (0.258_819_045_102_520_76, 0.965_925_826_289_068_3);
        assert!((q[1] - sin_15).abs() < 1e-14 && (q[3] - cos_15).abs() < 1e-14, "{q:?}");
    }

    #[test]
    fn the_shorter_way_is_taken_and_ends_are_met() {
        let a = [0.0, 0.0, 0.0, 1.0];
        let b = [0.0, -0.6, 0.0, -0.8];
        assert_eq!(slerp(a, b, 0.0), a);
        let end = slerp(a, b, 1.0);
        assert!((end[1] - 0.6).abs() < 1e-12 && (end[3] - 0.8).abs() < 1e-12, "{end:?}");
    }

    #[test]
    fn a_cubic_meets_its_ends_and_a_line_stays_one() {
        assert_eq!(hermite(2.0, 5.0, 7.0, -3.0, 0.0), 2.0);
        assert_eq!(hermite(2.0, 5.0, 7.0, -3.0, 1.0), 7.0);
        assert_eq!(hermite(1.0, 2.0, 3.0, 2.0, 0.25), 1.5);
    }
}
