//! Scenes and cameras whose visible triangles are known from rays.

use glam::{DMat4, DVec3, Vec3};
use manyview::preview::Camera;
use manyview::render::gbuffer::GBuffer;
use manyview::render::raster::triangles_on;
use manyview::render::scene::RenderScene;
use manyview_pipeline::bake::Silent;
use manyview_pipeline::generate::{SceneKind, generate};
use manyview_pipeline::scene::{Instance, Mesh, Scene};
use manyview_shaders::executor::Executor;

/// What is looked at, and from where.
pub(crate) struct Case {
    /// For messages.
    pub(crate) name: &'static str,
    /// The scene.
    pub(crate) scene: RenderScene,
    /// The camera.
    pub(crate) camera: Camera,
    /// Width and height.
    pub(crate) size: [u32; 2],
}

/// From outside and from inside, with and without alpha, near the origin and far from it.
pub(crate) fn cases() -> Vec<Case> {
    let town = || generate(SceneKind::Town, 6000, 1);
    let moved = |mut scene: Scene| {
        for instance in &mut scene.instances {
            instance.world_from_object =
                DMat4::from_translation(DVec3::new(30_000.0, 0.0, -10_000.0)) * instance.world_from_object;
        }
        scene
    };
    // A floor that the camera stands on and that reaches behind it: clipped at the near plane.
    let floor = Scene {
        meshes: vec![Mesh {
            positions: [[-50.0, -50.0], [50.0, -50.0], [50.0, 50.0], [-50.0, 50.0]]
                .map(|[x, z]| Vec3::new(x, 0.0, z))
                .to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        }],
        instances: vec![Instance { mesh: 0, world_from_object: DMat4::IDENTITY }],
        ..Scene::default()
    };
    let case = |name, scene, share: [f64; 3], towards: [f64; 3]| {
        let scene = RenderScene::new(scene).unwrap();
        let [min, max] = scene.bounds;
        let eye = min + (max - min) * DVec3::from(share);
        let target = eye + DVec3::from(towards);
        let camera = Camera { eye, target, up: DVec3::Y, fov_degrees: 60.0 };
        Case { name, scene, camera, size: [160, 90] }
    };
    vec![
        case("town from above", town(), [0.9, 1.2, 1.1], [-0.4, -0.35, -0.5]),
        case("town from a street", town(), [0.5, 0.12, 0.4], [0.3, 0.05, -1.0]),
        case(
            "forest with leaves of alpha",
            generate(SceneKind::Forest, 8000, 2),
            [0.5, 0.3, 1.1],
            [0.0, -0.1, -1.0],
        ),
        case("town far from the origin", moved(town()), [0.9, 1.2, 1.1], [-0.4, -0.35, -0.5]),
        case("a floor around the camera", floor, [0.5, 1.0, 0.5], [1.0, -0.02, 0.3]),
    ]
    .into_iter()
    .map(|mut case| {
        // The floor has no height to share out.
        case.camera.eye.y += if case.name.contains("floor") { 1.7 } else { 0.0 };
        case.camera.target.y += if case.name.contains("floor") { 1.7 } else { 0.0 };
        case
    })
    .collect()
}

/// What an executor sees.
pub(crate) fn seen(executor: &mut dyn Executor, case: &Case) -> Vec<u32> {
    triangles_on(executor, &case.scene, &case.scene.reference(), &case.camera, case.size).unwrap()
}

/// Expects the triangles that rays find, but for a few pixels on edges.
pub(crate) fn expect_agreement(case: &Case, found: &[u32]) -> Result<(), String> {
    let cast = GBuffer::cast(&case.scene, &case.scene.reference(), &case.camera, case.size, &Silent).unwrap();
    let differing = cast.pixels.iter().zip(found).filter(|(pixel, found)| pixel.triangle != **found).count();
    let share = differing as f64 / found.len() as f64;
    eprintln!("{}: {differing} of {} pixels differ", case.name, found.len());
    if cast.surface_count() < found.len() / 4 {
        return Err(format!("{}: only {} pixels show a surface", case.name, cast.surface_count()));
    }
    if share > 0.005 { Err(format!("{}: {differing} pixels differ", case.name)) } else { Ok(()) }
}
