//! Views made from a seed, for tests and measurements.

use super::View;
use crate::bench::Random;
use glam::DVec3;
use manyview_shaders::octahedral;
use manyview_shaders::svo::Svo;
use std::f32::consts::FRAC_PI_2;
use std::str::FromStr;

/// The most views that are made: about as many as octrees have leaves.
pub const MAX_VIEWS: u32 = 100_000_000;

/// Where made views lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SampleKind {
    /// Anywhere in the scene's bounds, seeing all around: lights in the air.
    Random,
    /// In front of surfaces, seeing a hemisphere: virtual lights.
    Surface,
}

/// Views to be made: `random:N[:SEED]` or `surface:N[:SEED]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sample {
    /// Where they lie.
    pub kind: SampleKind,
    /// How many.
    pub count: u32,
    /// Of the random numbers.
    pub seed: u64,
}

impl FromStr for Sample {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parse = || {
            let (kind, rest) = text.split_once(':')?;
            let kind = match kind {
                "random" => SampleKind::Random,
                "surface" => SampleKind::Surface,
                _ => return None,
            };
            let (count, seed) = rest.split_once(':').unwrap_or((rest, "1"));
            let count = count.parse().ok().filter(|count| *count <= MAX_VIEWS)?;
            Some(Self { kind, count, seed: seed.parse().ok()? })
        };
        parse().ok_or_else(|| {
            format!(
                "`{text}`: write random:N or surface:N, or random:N:SEED, of at most {MAX_VIEWS} views, as in \
                 surface:1000:7"
            )
        })
    }
}

impl Sample {
    /// Whether a text is meant as one, right or wrong, and not as a file.
    pub fn is_meant(text: &str) -> bool {
        text.starts_with("random:") || text.starts_with("surface:")
    }

    /// The views, in a fixed order: those of a smaller count are the first of a larger one's. `bounds` are the scene's,
    /// metres. An octree without voxels has no surfaces: then there are no views.
    pub fn views(&self, svo: &Svo, bounds: [[f64; 3]; 2]) -> Vec<View> {
        match self.kind {
            SampleKind::Random => random(bounds, self.count, self.seed),
            SampleKind::Surface => surface(svo, self.count, self.seed),
        }
    }
}

/// Views anywhere in a box, seeing all around.
pub fn random(bounds: [[f64; 3]; 2], count: u32, seed: u64) -> Vec<View> {
    let mut random = Random::new(seed);
    let [min, max] = bounds.map(DVec3::from_array);
    let views = (0..count).map(|_| {
        let share = DVec3::new(random.unit(), random.unit(), random.unit());
        View::around((min + (max - min) * share).as_vec3().to_array())
    });
    views.collect()
}

/// Views in front of leaves of an octree, each leaf as likely as another: a voxel and a half off its middle along its
/// normal, seeing the hemisphere around that.
pub fn surface(svo: &Svo, count: u32, seed: u64) -> Vec<View> {
    let mut random = Random::new(seed ^ 0x7375_7266_6163_6573);
    let depth = svo.levels.len().saturating_sub(1);
    let (cells, normals) = match svo.levels.last() {
        Some(level) if !level.normals.is_empty() => (svo.cells(depth), &level.normals),
        _ => return Vec::new(),
    };
    let voxel = svo.size / (1u64 << depth) as f64;
    let views = (0..count).map(|_| {
        let leaf = ((random.unit() * cells.len() as f64) as usize).min(cells.len() - 1);
        let normal = octahedral::decode(normals[leaf]);
        let at = [0, 1, 2].map(|i| {
            let middle = svo.origin[i] + (f64::from(cells[leaf][i]) + 0.5) * voxel;
            (middle + 1.5 * voxel * normal[i]) as f32
        });
        View::new(at, normal.map(|c| c as f32), FRAC_PI_2)
    });
    views.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::views::raycast::tests::room;

    #[test]
    fn samples_are_named() {
        let parse = |text: &str| text.parse::<Sample>();
        assert_eq!(parse("random:9"), Ok(Sample { kind: SampleKind::Random, count: 9, seed: 1 }));
        assert_eq!(parse("surface:0:3"), Ok(Sample { kind: SampleKind::Surface, count: 0, seed: 3 }));
        for wrong in ["random", "random:", "random:x", "surface:1:", "random:100000001", "vpl:4", "a.npy"] {
            assert!(parse(wrong).unwrap_err().contains("surface:1000:7"), "{wrong}");
        }
        assert!(Sample::is_meant("random:x") && !Sample::is_meant("random.npy"));
    }

    #[test]
    fn views_are_in_bounds_and_before_surfaces() {
        let svo = room();
        let bounds = [[1.0, 2.0, 3.0], [9.0, 10.0, 11.0]];
        let of = |text: &str| text.parse::<Sample>().unwrap().views(&svo, bounds);
        let random = of("random:100");
        assert!(random.iter().all(|v| (0..3).all(|i| (bounds[0][i] as f32..=bounds[1][i] as f32)
            .contains(&v.position[i]))));
        assert_eq!(random[..10], of("random:10"));
        assert_ne!(random, of("random:100:2"));
        // All of the room's normals are the one that zeros stand for, +Z.
        let surface = of("surface:50");
        for view in &surface {
            let cell = [0, 1, 2].map(|i| (f64::from(view.position[i]) - bounds[0][i]) / 0.25 - 0.5);
            assert!(
                (cell[0] - cell[0].round()).abs() < 1e-4 && (cell[2].fract() - 0.5).abs() < 1e-4,
                "{cell:?}"
            );
            assert_eq!((view.axis, view.half_angle), ([0.0, 0.0, 1.0], FRAC_PI_2));
        }
        assert_eq!(surface[..7], of("surface:7"));
        assert!(of("random:0").is_empty());
    }
}
