//! What is known of the surface in every pixel.
//!
//! # Practice
//! [`GBuffer::cast`] finds the nearest triangle of a pixel by a ray through its centre; [`GBuffer::resolve`] takes the
//! triangle from a rasterizer ([`super::raster`]) and meets its plane with the same ray. All else is computed by the same
//! code from the same triangle, so that both agree to the bit wherever they agree on the triangle.

use super::scene::RenderScene;
use super::textures::Textures;
use crate::preview::{Camera, CameraError, RayMaker};
use crate::reference::{Hit, Reference, area_normal, intersect_triangle};
use crate::visibility::Receiver;
use glam::{DVec2, DVec3, Vec3};
use manyview_pipeline::bake::Progress;
use manyview_pipeline::scene::{Instance, Material, Mesh};
use rayon::prelude::*;

/// Stands for "no triangle".
pub const NO_TRIANGLE: u32 = u32::MAX;
/// The largest side of a picture: a depth image within WebGPU's default limits.
pub const MAX_SIDE: u32 = 8192;
/// The most pixels of a picture; each takes about 100 bytes while it is made.
pub const MAX_PIXELS: u64 = 1 << 24;
/// A surface seen edge-on counts as turned at least this much to the viewer when its texture is filtered (a cosine):
/// blurring along one axis must not blur the other away.
const LEAST_COSINE: f64 = 0.15;

/// What is known of one pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pixel {
    /// World space, metres; +infinity where there is no surface.
    pub position: [f32; 3],
    /// Unit normal of the triangle, turned to the viewer.
    pub geometric_normal: [f32; 3],
    /// Unit normal for shading, on the same side.
    pub normal: [f32; 3],
    /// Linear base colour: factor, texture and vertex colours.
    pub albedo: [f32; 3],
    /// Emitted radiance.
    pub emissive: [f32; 3],
    /// Distance from the eye, metres; +infinity where there is no surface.
    pub depth: f32,
    /// Index into [`Reference::triangles`], or [`NO_TRIANGLE`].
    pub triangle: u32,
}

impl Pixel {
    /// A pixel without a surface.
    pub const EMPTY: Self = Self {
        position: [f32::INFINITY; 3],
        geometric_normal: [0.0; 3],
        normal: [0.0; 3],
        albedo: [0.0; 3],
        emissive: [0.0; 3],
        depth: f32::INFINITY,
        triangle: NO_TRIANGLE,
    };

    /// Whether there is a surface.
    pub fn is_surface(&self) -> bool {
        self.triangle != NO_TRIANGLE
    }

    /// The point that light falls on.
    pub fn receiver(&self) -> Receiver {
        Receiver { position: self.position, normal: self.geometric_normal }
    }
}

/// All pixels of a picture, row by row from the upper left corner.
#[derive(Debug, Clone, PartialEq)]
pub struct GBuffer {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// All of them.
    pub pixels: Vec<Pixel>,
}

impl GBuffer {
    /// Finds every pixel's surface by a ray through its centre. Stops early, with whatever there is, once `progress` is
    /// cancelled.
    pub fn cast(
        scene: &RenderScene,
        reference: &Reference<'_>,
        camera: &Camera,
        size: [u32; 2],
        progress: &dyn Progress,
    ) -> Result<Self, CameraError> {
        let rays = camera.ray_maker(size[0], size[1])?;
        Ok(Self::fill(scene, reference, &rays, size, progress, |_, origin, direction| {
            reference.intersect(origin, direction, f64::INFINITY)
        }))
    }

    /// Takes every pixel's triangle from `triangles` ([`NO_TRIANGLE`] where there is none).
    ///
    /// # Panics
    /// If `triangles` has another length than the picture has pixels, or names a triangle that does not exist.
    pub fn resolve(
        scene: &RenderScene,
        reference: &Reference<'_>,
        camera: &Camera,
        size: [u32; 2],
        triangles: &[u32],
        progress: &dyn Progress,
    ) -> Result<Self, CameraError> {
        assert_eq!(triangles.len(), size[0] as usize * size[1] as usize, "a triangle for each pixel");
        let rays = camera.ray_maker(size[0], size[1])?;
        Ok(Self::fill(scene, reference, &rays, size, progress, |index, origin, direction| {
            let triangle = triangles[index];
            (triangle != NO_TRIANGLE).then(|| plane_hit(reference, triangle, origin, direction))
        }))
    }

    fn fill(
        scene: &RenderScene,
        reference: &Reference<'_>,
        rays: &RayMaker,
        size: [u32; 2],
        progress: &dyn Progress,
        find: impl Fn(usize, DVec3, DVec3) -> Option<Hit> + Sync,
    ) -> Self {
        let looks = Looks::new(scene, reference, rays.pixel_spread());
        let width = size[0] as usize;
        let mut pixels = vec![Pixel::EMPTY; width * size[1] as usize];
        progress.begin("g-buffer", u64::from(size[1]), "rows");
        pixels.par_chunks_mut(width.max(1)).enumerate().for_each(|(y, row)| {
            if progress.cancelled() {
                return;
            }
            for (x, pixel) in row.iter_mut().enumerate() {
                let ray = rays.ray(x as f64 + 0.5, y as f64 + 0.5);
                let (origin, direction) = (DVec3::from(ray.origin), DVec3::from(ray.direction));
                if let Some(hit) = find(y * width + x, origin, direction) {
                    *pixel = looks.pixel(&hit, origin, direction);
                }
            }
            progress.advance(1);
        });
        Self { width: size[0], height: size[1], pixels }
    }

    /// Pixels that show a surface.
    pub fn surface_count(&self) -> usize {
        self.pixels.iter().filter(|pixel| pixel.is_surface()).count()
    }
}

/// Where a ray meets a triangle's plane, within the triangle: a rasterizer may count in a pixel whose centre lies
/// beside the triangle by a rounding error.
fn plane_hit(reference: &Reference<'_>, triangle: u32, origin: DVec3, direction: DVec3) -> Hit {
    let [a, b, c] = reference.triangles()[triangle as usize];
    if let Some((t, barycentric)) = intersect_triangle(&[a, b, c], origin, direction) {
        return Hit { t, triangle, barycentric };
    }
    let normal = area_normal(&[a, b, c]);
    let t = (a - origin).dot(normal) / direction.dot(normal);
    let at = origin + direction * t;
    let area = normal.length_squared();
    let weight = |v: DVec3, w: DVec3| (v.cross(w).dot(normal) / area).clamp(0.0, 1.0);
    let (b1, b2) = (weight(at - a, c - a), weight(b - a, at - a));
    // Of a triangle that is seen edge-on, its middle.
    if !(b1.is_finite() && b2.is_finite()) {
        let middle = (a + b + c) / 3.0;
        return Hit { t: (middle - origin).length(), triangle, barycentric: [1.0 / 3.0; 2] };
    }
    let sum = (b1 + b2).max(1.0);
    let barycentric = [b1 / sum, b2 / sum];
    let at = a + (b - a) * barycentric[0] + (c - a) * barycentric[1];
    Hit { t: (at - origin).length(), triangle, barycentric }
}

/// Looks surfaces up.
pub(crate) struct Looks<'a> {
    scene: &'a RenderScene,
    reference: &'a Reference<'a>,
    textures: Textures,
    /// Width of a pixel, metres per metre of distance.
    spread: f64,
}

impl<'a> Looks<'a> {
    /// For pixels that are `spread` metres wide per metre of distance.
    pub(crate) fn new(scene: &'a RenderScene, reference: &'a Reference<'a>, spread: f64) -> Self {
        Self { scene, reference, textures: Textures::new(&scene.scene), spread }
    }

    /// What a ray from `origin` along `direction` sees at `hit`.
    pub(crate) fn pixel(&self, hit: &Hit, origin: DVec3, direction: DVec3) -> Pixel {
        let corners = &self.reference.triangles()[hit.triangle as usize];
        let source = self.reference.sources()[hit.triangle as usize];
        let scene = &self.scene.scene;
        let instance = &scene.instances[source.instance as usize];
        let mesh = &scene.meshes[instance.mesh as usize];
        let default = Material::default();
        let material = scene.materials.get(mesh.material as usize).unwrap_or(&default);
        let vertices = mesh.triangles[source.triangle as usize].map(|v| v as usize);
        let [b1, b2] = hit.barycentric;
        let weights = [1.0 - b1 - b2, b1, b2];

        let area = area_normal(corners);
        let facing = area.normalize_or_zero();
        let geometric = if facing.dot(direction) > 0.0 { -facing } else { facing };
        let smooth = shading_normal(instance, mesh, vertices, weights).unwrap_or(geometric);
        let normal = if smooth.dot(geometric) < 0.0 { -smooth } else { smooth };

        // Area of the pixel on the surface, square metres; the triangle's area halves both, so it does not matter.
        let cosine = geometric.dot(direction).abs().max(LEAST_COSINE);
        let share = (self.spread * hit.t).powi(2) / cosine / area.length();
        let look = |texture: Option<u32>, uvs: &[glam::Vec2]| {
            let Some(texture) = texture.filter(|_| !uvs.is_empty()) else { return Vec3::ONE };
            let Some(size) = self.textures.size(texture) else { return Vec3::ONE };
            let [a, b, c] = vertices.map(|v| uvs[v].as_dvec2());
            let texels = ((b - a) * size).perp_dot((c - a) * size).abs() * share;
            let uv: DVec2 = a * weights[0] + b * weights[1] + c * weights[2];
            self.textures.sample(texture, uv, texels)
        };
        let mut albedo =
            material.base_color.truncate() * look(material.base_color_texture, &mesh.base_color_uvs);
        if !mesh.colors.is_empty() {
            albedo *= (0..3).map(|i| mesh.colors[vertices[i]].truncate() * weights[i] as f32).sum::<Vec3>();
        }
        let emissive = match material.emissive {
            Vec3::ZERO => Vec3::ZERO,
            emissive => emissive * look(material.emissive_texture, &mesh.emissive_uvs),
        };
        Pixel {
            position: (origin + direction * hit.t).as_vec3().to_array(),
            geometric_normal: geometric.as_vec3().to_array(),
            normal: normal.as_vec3().to_array(),
            albedo: albedo.to_array(),
            emissive: emissive.to_array(),
            depth: hit.t as f32,
            triangle: hit.triangle,
        }
    }
}

/// The unit normal between the vertices' normals in world space, if the mesh has any.
fn shading_normal(
    instance: &Instance,
    mesh: &Mesh,
    vertices: [usize; 3],
    weights: [f64; 3],
) -> Option<DVec3> {
    if mesh.normals.is_empty() {
        return None;
    }
    let object: DVec3 = (0..3).map(|i| mesh.normals[vertices[i]].as_dvec3() * weights[i]).sum();
    // Cofactors transform normals, also of singular matrices.
    let matrix = instance.world_from_object;
    let [x, y, z] = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(glam::DVec4::truncate);
    (y.cross(z) * object.x + z.cross(x) * object.y + x.cross(y) * object.z).try_normalize()
}
