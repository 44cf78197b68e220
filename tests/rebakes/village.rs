//! A scene of small boxes far apart, for edits, and bakes of it that tell what they did.

use crate::scenes::{box_mesh, floor_mesh};
use crate::workplace::Workplace;
use glam::{DMat4, DVec3, Vec3, Vec4};
use manyview_pipeline::scene::{
    AlphaMode, Instance, LightKind, Material, PunctualLight, Scene, Texture, Wrap,
};
use serde_json::Value;

/// Settings under which the village has several bricks (2 × 2 × 2 of 256³ voxels) and a few blocks of rows.
pub(crate) const SETTINGS: [&str; 8] =
    ["--levels", "9", "--rows", "64", "--directions", "latlong:12x12", "--backend", "cpu"];

/// Instances that stand at the corners, so that edits of the others leave the bounds alone.
pub(crate) const CORNERS: usize = 2;

/// Edge of the village, metres.
pub(crate) const EDGE: f64 = 60.0;

/// A texture of 2 × 2 texels.
pub(crate) fn texture(texels: [[u8; 4]; 4]) -> Texture {
    Texture { width: 2, height: 2, texels: texels.to_vec(), wrap: [Wrap::Repeat; 2] }
}

fn material(name: &str, color: [f32; 3], texture: Option<u32>) -> Material {
    let base_color = Vec4::from((Vec3::from_array(color), 1.0));
    Material { name: name.to_owned(), base_color, base_color_texture: texture, ..Material::default() }
}

/// 24 boxes, some with a texture, some cut out by one, one that glows; two lights.
pub(crate) fn village() -> Scene {
    let named = |name: &str, mut mesh: manyview_pipeline::scene::Mesh, material| {
        mesh.name = name.to_owned();
        mesh.material = material;
        mesh
    };
    let boxed = |size: f32| box_mesh(Vec3::ZERO, Vec3::new(size, size * 1.5, size));
    let meshes = vec![
        named("post", box_mesh(Vec3::ZERO, Vec3::ONE), 0),
        named("house", boxed(2.0), 1),
        named("barn", boxed(3.0), 0),
        named("fence", floor_mesh(0.0, 3.0, 0.3), 2),
        named("lamp", boxed(0.7), 3),
    ];
    let at = |mesh: u32, x: f64, y: f64, z: f64| Instance {
        mesh,
        world_from_object: DMat4::from_translation(DVec3::new(x, y, z)),
    };
    let mut instances = vec![at(0, 0.0, 0.0, 0.0), at(0, EDGE - 1.0, EDGE - 1.0, EDGE - 1.0)];
    for i in 0..22u32 {
        let place = |step: u32| 2.0 + f64::from(i * step % 11) * 5.0;
        instances.push(at(1 + i % 4, place(3), place(5), place(7)));
    }
    let mut cut = material("leaves", [1.0; 3], Some(1));
    cut.alpha_mode = AlphaMode::Mask { cutoff: 0.5 };
    let mut glowing = material("glow", [0.2; 3], None);
    glowing.emissive = Vec3::new(3.0, 2.0, 1.0);
    let light = |x: f32| PunctualLight {
        position: Vec3::new(x, 5.0, 5.0),
        direction: -Vec3::Y,
        intensity: Vec3::splat(100.0),
        range: f32::INFINITY,
        kind: LightKind::Point,
    };
    Scene {
        meshes,
        instances,
        materials: vec![
            material("stone", [0.5, 0.4, 0.3], None),
            material("wall", [1.0; 3], Some(0)),
            cut,
            glowing,
        ],
        textures: vec![
            texture([[200, 30, 30, 255], [30, 200, 30, 255], [30, 30, 200, 255], [200, 200, 30, 255]]),
            texture([[20, 90, 20, 255], [20, 90, 20, 0], [60, 120, 20, 255], [20, 90, 20, 0]]),
        ],
        lights: vec![light(3.0), light(30.0)],
        ..Scene::default()
    }
}

/// A folder with a scene, a cache, and bakes into `out.mvb`.
pub(crate) struct Bakes {
    pub(crate) work: Workplace,
}

/// What a bake did.
pub(crate) struct Did {
    pub(crate) summary: Value,
    pub(crate) stderr: String,
}

impl Bakes {
    /// Writes the village and bakes it.
    pub(crate) fn of_village() -> Self {
        let bakes = Self { work: Workplace::new() };
        let first = bakes.bake_scene(&village());
        assert_eq!(first.rebuilt("bricks"), 8, "{}", first.summary);
        bakes
    }

    /// Writes a scene and bakes it.
    pub(crate) fn bake_scene(&self, scene: &Scene) -> Did {
        self.work.write_scene("scene.glb", scene);
        self.bake(&[])
    }

    /// Bakes `scene.glb`, checks the result against a clean bake, and tells what was done.
    pub(crate) fn bake(&self, arguments: &[&str]) -> Did {
        let settings: Vec<&str> = SETTINGS.to_vec();
        self.bake_with(&settings, arguments)
    }

    /// The same with other settings.
    pub(crate) fn bake_with(&self, settings: &[&str], arguments: &[&str]) -> Did {
        let usual = ["bake", "scene.glb", "-o", "out.mvb", "--cache", "cache", "--format", "json"];
        let run = self.work.run([&usual[..], settings, arguments].concat()).succeeded();
        let clean = ["bake", "scene.glb", "-o", "clean.mvb", "--no-cache"];
        self.work.run([&clean[..], settings].concat()).succeeded();
        assert!(self.work.read("out.mvb") == self.work.read("clean.mvb"), "not what a clean bake writes");
        Did { summary: serde_json::from_str(&run.stdout).unwrap(), stderr: run.stderr }
    }
}

impl Did {
    fn count(&self, kind: &str, what: &str) -> u64 {
        self.summary["steps"]["kinds"][kind][what].as_u64().unwrap_or(0)
    }

    pub(crate) fn rebuilt(&self, kind: &str) -> u64 {
        self.count(kind, "rebuilt")
    }

    pub(crate) fn reused(&self, kind: &str) -> u64 {
        self.count(kind, "reused")
    }

    pub(crate) fn patched(&self, kind: &str) -> u64 {
        self.count(kind, "patched")
    }

    pub(crate) fn is_up_to_date(&self) -> bool {
        self.summary["up_to_date"] == true
    }

    /// Kinds of steps of which some were made, in the order of the bake.
    pub(crate) fn kinds(&self) -> Vec<&'static str> {
        let all = ["import", "bricks", "attributes", "points", "rows", "archive"];
        all.into_iter().filter(|kind| self.rebuilt(kind) > 0).collect()
    }
}
