//! What methods are compared on: a scene, what a camera sees of it, lights.

use crate::archive::Archive;
use crate::bench::{BenchError, BenchScene, Random};
use crate::exact::ExactRays;
use crate::preview::{Camera, CameraChoice, Scene as PreviewScene, choose_camera};
use crate::reference::{Reference, area_normal};
use crate::visibility::{LightPoint, Receiver};
use glam::DVec3;
use manyview_cache::archive::ArchiveWriter;
use manyview_pipeline::bake::{BakeOptions, Silent, bake};
use manyview_pipeline::rows::RowsOptions;
use rayon::prelude::*;

/// A scene with its judge, a view of it and an archive of its octree.
pub struct Subject<'a> {
    /// The scene.
    pub scene: &'a BenchScene,
    /// Exact rays: the judge, and a method itself.
    pub judge: ExactRays<'a>,
    /// The octree; no rows.
    pub archive: Archive,
    /// Surface points that the camera sees, a pixel each.
    pub receivers: Vec<Receiver>,
    bounds: [DVec3; 2],
}

/// Neighbouring receivers that are kept together: most squares are whole ones.
const PIECE_RECEIVERS: usize = (SQUARE * SQUARE) as usize;
/// Pixels a side of the squares that receivers are listed in.
const SQUARE: u32 = 8;

/// Deepest level of the octree that a camera is chosen by.
const CAMERA_LEVELS: u32 = 8;

impl<'a> Subject<'a> {
    /// Bakes an octree of `levels` levels and looks at the scene with a picture of `size` pixels.
    pub fn new(scene: &'a BenchScene, levels: u32, size: [u32; 2]) -> Result<Self, BenchError> {
        let load = |error| BenchError::Load { scene: scene.name.clone(), source: Box::new(error) };
        let archive = bake_octree(scene, levels)?;
        let judge = ExactRays::new(Reference::new(&scene.scene, &scene.row_triangles, &scene.cutouts));
        let (center, half) = (DVec3::from(scene.lattice.center), DVec3::from(scene.lattice.half_extent));
        let bounds: [DVec3; 2] = [center - half, center + half];
        let seen = PreviewScene::new(archive.svo_levels(..=levels.min(CAMERA_LEVELS)).map_err(load)?);
        let aspect = f64::from(size[0]) / f64::from(size[1]);
        let camera = choose_camera(&seen, bounds, aspect, CameraChoice::Auto);
        let receivers = look(judge.reference(), &camera, size);
        if receivers.is_empty() {
            return Err(BenchError::NothingSeen { scene: scene.name.clone() });
        }
        Ok(Self { scene, judge, archive, receivers, bounds })
    }

    /// The first `count` lights of a seed's sequence: points spread evenly over the scene's bounds, up to a quarter of
    /// its height above it, but none inside of closed bodies.
    pub fn lights(&self, count: u32, seed: u64) -> Vec<LightPoint> {
        let reference = self.judge.reference();
        let [min, max] = self.bounds;
        let size = (max - min) * DVec3::new(1.0, 1.25, 1.0);
        let light = |index: u32| {
            let mut random = Random::new(seed ^ (u64::from(index) + 1).wrapping_mul(0x2545_f491_4f6c_dd1d));
            let mut at = || min + size * DVec3::new(random.unit(), random.unit(), random.unit());
            let mut point = at();
            for _ in 0..64 {
                if !is_inside(reference, point) {
                    break;
                }
                point = at();
            }
            LightPoint::at(point.as_vec3().to_array())
        };
        (0..count).into_par_iter().map(light).collect()
    }

    /// At most `most` receivers: pieces of the picture, spread evenly over it. Within a piece they are neighbours, as in
    /// the whole picture, since that is what methods are fast on.
    pub fn some_receivers(&self, most: usize) -> Vec<Receiver> {
        let count = self.receivers.len();
        if most >= count {
            return self.receivers.clone();
        }
        let most = most.max(1);
        let pieces = (most / PIECE_RECEIVERS).max(1);
        let (length, apart) = (most / pieces, count / pieces);
        let piece = |i: usize| &self.receivers[i * apart + (apart - length) / 2..][..length];
        (0..pieces).flat_map(piece).copied().collect()
    }
}

/// A scene's octree, without rows.
pub(super) fn bake_octree(scene: &BenchScene, levels: u32) -> Result<Archive, BenchError> {
    bake_in_memory(scene, &BakeOptions { levels, rows: None, ..BakeOptions::default() })
}

/// An archive with these rows, and the least octree there is.
pub(super) fn bake_rows(scene: &BenchScene, rows: RowsOptions) -> Result<Archive, BenchError> {
    bake_in_memory(scene, &BakeOptions { levels: 4, rows: Some(rows), ..BakeOptions::default() })
}

fn bake_in_memory(scene: &BenchScene, options: &BakeOptions) -> Result<Archive, BenchError> {
    let refuse = |source| BenchError::Scene { scene: scene.name.clone(), source };
    let mut writer = ArchiveWriter::in_memory().map_err(|error| refuse(error.into()))?;
    bake(&scene.scene, options, None, &mut writer, &Silent).map_err(refuse)?;
    let (bytes, _) = writer.finish().map_err(|error| refuse(error.into()))?;
    Archive::from_bytes(bytes)
        .map_err(|error| BenchError::Load { scene: scene.name.clone(), source: Box::new(error) })
}

/// The surface point in each pixel of a picture, square by square; pixels of the sky have none.
fn look(reference: &Reference<'_>, camera: &Camera, [width, height]: [u32; 2]) -> Vec<Receiver> {
    let Ok(rays) = camera.ray_maker(width, height) else { return Vec::new() };
    let across = width.div_ceil(SQUARE);
    let squares = across * height.div_ceil(SQUARE);
    (0..squares * SQUARE * SQUARE)
        .into_par_iter()
        .filter_map(|index| {
            let (square, pixel) = (index / (SQUARE * SQUARE), index % (SQUARE * SQUARE));
            let x = square % across * SQUARE + pixel % SQUARE;
            let y = square / across * SQUARE + pixel / SQUARE;
            if x >= width || y >= height {
                return None;
            }
            let ray = rays.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let (origin, direction) = (DVec3::from(ray.origin), DVec3::from(ray.direction));
            let hit = reference.intersect(origin, direction, f64::INFINITY)?;
            let normal = area_normal(&reference.triangles()[hit.triangle as usize]).normalize_or_zero();
            let normal = if normal.dot(direction) > 0.0 { -normal } else { normal };
            let position = (origin + direction * hit.t).as_vec3().to_array();
            Some(Receiver { position, normal: normal.as_vec3().to_array() })
        })
        .collect()
}

/// Whether a point is inside of something: of six rays along the axes, most meet back sides.
fn is_inside(reference: &Reference<'_>, point: DVec3) -> bool {
    let backs = DVec3::AXES.iter().flat_map(|axis| [*axis, -*axis]).filter(|direction| {
        reference.intersect(point, *direction, f64::INFINITY).is_some_and(|hit| {
            area_normal(&reference.triangles()[hit.triangle as usize]).dot(*direction) > 0.0
        })
    });
    backs.count() > 3
}

#[cfg(test)]
mod tests {
    use super::*;
    use manyview_pipeline::generate::{SceneKind, generate};

    #[test]
    fn receivers_are_seen_and_lights_are_outside_of_walls() {
        let scene = BenchScene::new("city".to_owned(), generate(SceneKind::City, 3000, 1)).unwrap();
        let subject = Subject::new(&scene, 6, [40, 24]).unwrap();
        assert!((100..=960).contains(&subject.receivers.len()), "{}", subject.receivers.len());
        let lights = subject.lights(64, 5);
        assert_eq!(subject.lights(20, 5), lights[..20], "more lights begin with fewer");
        assert_ne!(subject.lights(20, 6), lights[..20]);
        for light in &lights {
            let at = DVec3::from_array(light.offset.map(f64::from));
            assert!(!is_inside(subject.judge.reference(), at), "{at}");
        }
        assert_eq!(subject.some_receivers(10).len(), 10);
        assert_eq!(subject.some_receivers(1 << 30), subject.receivers);
    }
}
