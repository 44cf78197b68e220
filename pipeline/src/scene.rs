//! A scene as the bake sees it: indexed triangle meshes, instances of them, small materials, decoded textures, lights.
//!
//! Everything here is in glTF's space (metres, right-handed, +Y up) and independent of the file format it came from.
//! Importers ([`crate::import`]) and generators ([`crate::generate`]) make it; the voxelizer and the reference ray
//! tracer read it.

use glam::{DMat4, Vec2, Vec3, Vec4};

/// A complete scene, finite and in range: every index is valid and every number is finite.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scene {
    /// Triangle meshes in object space, each with one material; a glTF mesh of three primitives gives three of them.
    pub meshes: Vec<Mesh>,
    /// Placements of meshes, in the order of the file's node traversal.
    pub instances: Vec<Instance>,
    /// Materials. Index 0 need not exist if no mesh refers to it.
    pub materials: Vec<Material>,
    /// Decoded images with their sampling rule.
    pub textures: Vec<Texture>,
    /// Punctual lights in world space.
    pub lights: Vec<PunctualLight>,
    /// What was left out or forgiven, for people; one sentence each, naming the place in the file.
    pub warnings: Vec<String>,
}

/// Indexed triangles in object space. All attribute vectors are either empty or as long as `positions`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// Name in the file, for messages only; in no key and no archive.
    pub name: String,
    /// Object space, metres, finite.
    pub positions: Vec<Vec3>,
    /// Unit normals in object space; empty if the file has none (then the geometric normal is used).
    pub normals: Vec<Vec3>,
    /// Texture coordinates of the base colour texture, `KHR_texture_transform` already applied.
    pub base_color_uvs: Vec<Vec2>,
    /// Texture coordinates of the emissive texture, `KHR_texture_transform` already applied.
    pub emissive_uvs: Vec<Vec2>,
    /// Linear vertex colours, alpha included.
    pub colors: Vec<Vec4>,
    /// Triangles as vertex indices, counter-clockwise front, each `< positions.len()`.
    pub triangles: Vec<[u32; 3]>,
    /// Index into [`Scene::materials`].
    pub material: u32,
}

/// One placement of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Instance {
    /// Index into [`Scene::meshes`].
    pub mesh: u32,
    /// Finite; may be singular, mirror or shear.
    pub world_from_object: DMat4,
}

/// How alpha decides what is there.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum AlphaMode {
    /// Alpha is ignored.
    #[default]
    Opaque,
    /// A surface point exists iff alpha ≥ cutoff.
    Mask {
        /// Threshold on the product of factor, texture and vertex alpha.
        cutoff: f32,
    },
    /// Blended surfaces are voxelized as a mask with cutoff 0.5: mostly opaque parts block light, the rest lets it
    /// through.
    Blend,
}

impl AlphaMode {
    /// The cutoff below which a surface point is not there, if any.
    pub fn cutoff(self) -> Option<f32> {
        match self {
            AlphaMode::Opaque => None,
            AlphaMode::Mask { cutoff } => Some(cutoff),
            AlphaMode::Blend => Some(0.5),
        }
    }
}

/// The part of a glTF material that the bake keeps.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// Name in the file, for messages only.
    pub name: String,
    /// Linear base colour and alpha.
    pub base_color: Vec4,
    /// Index into [`Scene::textures`]; multiplies `base_color`.
    pub base_color_texture: Option<u32>,
    /// Linear emitted radiance (factor times `KHR_materials_emissive_strength`).
    pub emissive: Vec3,
    /// Index into [`Scene::textures`]; multiplies `emissive`.
    pub emissive_texture: Option<u32>,
    /// How alpha decides what is there.
    pub alpha_mode: AlphaMode,
    /// Both sides are drawn. The voxelizer treats every surface as two-sided; kept for renderers.
    pub double_sided: bool,
}

impl Default for Material {
    /// glTF's default material: white, opaque, dark.
    fn default() -> Self {
        Self {
            name: String::new(),
            base_color: Vec4::ONE,
            base_color_texture: None,
            emissive: Vec3::ZERO,
            emissive_texture: None,
            alpha_mode: AlphaMode::Opaque,
            double_sided: false,
        }
    }
}

/// What happens outside the unit square of texture coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Wrap {
    /// Tile.
    #[default]
    Repeat,
    /// Tile, every other one mirrored.
    MirroredRepeat,
    /// The border texel goes on.
    ClampToEdge,
}

/// A decoded image and its wrap modes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Texture {
    /// Width in texels, at least 1.
    pub width: u32,
    /// Height in texels, at least 1.
    pub height: u32,
    /// Row-major RGBA, colour sRGB-encoded, alpha linear; `width * height` texels.
    pub texels: Vec<[u8; 4]>,
    /// Wrap modes along u and v.
    pub wrap: [Wrap; 2],
}

/// A light of `KHR_lights_punctual`, in world space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PunctualLight {
    /// Metres; meaningless for directional lights.
    pub position: Vec3,
    /// Unit direction in which the light shines; meaningless for point lights.
    pub direction: Vec3,
    /// Linear colour times intensity: candela for point and spot, lux for directional.
    pub intensity: Vec3,
    /// Metres beyond which it may be cut off; infinity if the file has none.
    pub range: f32,
    /// Point, spot or directional.
    pub kind: LightKind,
}

/// Kinds of [`PunctualLight`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LightKind {
    /// Shines along one direction from infinitely far away.
    Directional,
    /// Shines everywhere from a point.
    Point,
    /// Shines into a cone from a point.
    Spot {
        /// Radians from the axis where the falloff starts.
        inner_angle: f32,
        /// Radians from the axis where the light ends.
        outer_angle: f32,
    },
}

impl Scene {
    /// Triangles drawn: those of every mesh, times its instances.
    pub fn drawn_triangles(&self) -> u64 {
        self.instances.iter().map(|i| self.meshes[i.mesh as usize].triangles.len() as u64).sum()
    }

    /// World-space bounds of all drawn triangles (vertices that no triangle uses do not count), or `None` if nothing
    /// is drawn. Computed in f64, returned as `(min, max)`.
    pub fn bounds(&self) -> Option<(glam::DVec3, glam::DVec3)> {
        let mut bounds: Option<(glam::DVec3, glam::DVec3)> = None;
        for instance in &self.instances {
            let mesh = &self.meshes[instance.mesh as usize];
            let mut used = vec![false; mesh.positions.len()];
            for index in mesh.triangles.iter().flatten() {
                used[*index as usize] = true;
            }
            for (position, _) in mesh.positions.iter().zip(used).filter(|(_, used)| *used) {
                let p = instance.world_from_object.transform_point3(position.as_dvec3());
                let (lo, hi) = bounds.get_or_insert((p, p));
                *lo = lo.min(p);
                *hi = hi.max(p);
            }
        }
        bounds
    }
}
