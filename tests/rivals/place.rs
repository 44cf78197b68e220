//! Scenes, and the methods that are asked about them.

use glam::{DMat4, DVec3, Vec3};
use libtest_mimic::Failed;
use manyview::Archive;
use manyview::exact::ExactRays;
use manyview::gpu::{GpuContext, WgpuExecutor};
use manyview::reference::Reference;
use manyview::rivals::brickmap::{self, BrickmapVisibility};
use manyview::rivals::bvh::BvhVisibility;
use manyview::rivals::wide_bvh::WideBvh;
use manyview::visibility::{Segment, Visibility};
use manyview_pipeline::bake::{BakeOptions, bake_in_memory};
use manyview_pipeline::generate::{SceneKind, generate};
use manyview_pipeline::scene::{Instance, Material, Mesh, Scene};
use manyview_pipeline::triangles::{Cutouts, LatticeTriangles};
use manyview_shaders::cases::Random;
use manyview_shaders::device::DeviceError;
use manyview_shaders::executor::{CpuExecutor, Executor, ExecutorLimits};
use manyview_shaders::svo::Svo;

/// A scene, its exact answers and its octree.
pub(crate) struct Place {
    pub(crate) scene: Scene,
    pub(crate) cutouts: Cutouts,
    pub(crate) drawn: LatticeTriangles,
    pub(crate) svo: Svo,
}

impl Place {
    pub(crate) fn new(scene: Scene, levels: u32) -> Result<Self, Failed> {
        let options = BakeOptions { levels, rows: None, ..BakeOptions::default() };
        let archive = Archive::from_bytes(bake_in_memory(&scene, &options)?)?;
        let cutouts = Cutouts::new(&scene);
        let drawn = LatticeTriangles::new(&scene, &cutouts, |_| [0; 3]);
        Ok(Self { svo: archive.svo_levels(..)?, cutouts, drawn, scene })
    }

    pub(crate) fn of_quads(quads: &[[[f32; 3]; 4]], levels: u32) -> Result<Self, Failed> {
        let mut mesh = Mesh::default();
        for quad in quads {
            let first = mesh.positions.len() as u32;
            mesh.positions.extend(quad.map(Vec3::from_array));
            mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
        Self::of_mesh(mesh, levels)
    }

    pub(crate) fn of_mesh(mesh: Mesh, levels: u32) -> Result<Self, Failed> {
        let instances = vec![Instance { mesh: 0, world_from_object: DMat4::IDENTITY }];
        let materials = vec![Material::default()];
        Self::new(Scene { meshes: vec![mesh], instances, materials, ..Scene::default() }, levels)
    }

    pub(crate) fn reference(&self) -> Reference<'_> {
        Reference::new(&self.scene, &self.drawn, &self.cutouts)
    }

    /// Edge of a cell of the octree, metres.
    pub(crate) fn voxel(&self) -> f64 {
        self.svo.voxel_size()
    }
}

/// Methods whose answers are those of the triangles, and methods whose answers are those of the octree's cells.
pub(crate) type Methods<'a> = [Vec<Box<dyn Visibility + 'a>>; 2];

pub(crate) fn twins<'a>() -> Result<Box<dyn Executor + Send + 'a>, DeviceError> {
    Ok(Box::new(CpuExecutor::default()))
}

pub(crate) fn methods<'a>(place: &'a Place, reference: &'a Reference<'a>) -> Result<Methods<'a>, Failed> {
    let map = brickmap::from_svo(&place.svo, u32::MAX, brickmap::DEFAULT_BIAS);
    Ok([
        vec![
            Box::new(ExactRays::new(reference)),
            Box::new(BvhVisibility::new(reference)),
            Box::new(WideBvh::new(reference).on_executor(twins()?)?),
        ],
        vec![Box::new(brickmap::on_executor(&map, twins()?)?), Box::new(BrickmapVisibility::new(map))],
    ])
}

pub(crate) fn gpu_methods<'a>(
    place: &Place,
    reference: &Reference,
    context: &'a GpuContext,
) -> Result<Methods<'a>, Failed> {
    let executor = || Box::new(WgpuExecutor::new(context, ExecutorLimits::DEFAULT));
    let map = brickmap::from_svo(&place.svo, u32::MAX, brickmap::DEFAULT_BIAS);
    Ok([
        vec![Box::new(WideBvh::new(reference).on_executor(executor())?)],
        vec![Box::new(brickmap::on_executor(&map, executor())?)],
    ])
}

pub(crate) fn uniform(random: &mut Random) -> f64 {
    f64::from(random.below(1 << 24)) / f64::from(1 << 24)
}

pub(crate) fn point_in(random: &mut Random, min: DVec3, max: DVec3) -> DVec3 {
    min + (max - min) * DVec3::new(uniform(random), uniform(random), uniform(random))
}

pub(crate) fn free(origin: DVec3, target: DVec3) -> Segment {
    Segment { origin: origin.as_vec3().to_array(), target: target.as_vec3().to_array(), normal: [0.0; 3] }
}

pub(crate) fn forest() -> Result<Place, Failed> {
    let place = Place::new(generate(SceneKind::Forest, 3000, 5), 8)?;
    ensure!(!place.cutouts.masks.is_empty(), "the forest has no cut-out leaves");
    Ok(place)
}

pub(crate) fn random_segments(place: &Place, seed: u64, count: usize) -> Vec<Segment> {
    let mut random = Random::new(seed);
    let (min, max) = place.scene.bounds().expect("triangles");
    let point = |random: &mut Random| point_in(random, min, max);
    (0..count).map(|_| free(point(&mut random), point(&mut random))).collect()
}
