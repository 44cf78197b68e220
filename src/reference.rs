//! Exact ray tracing over the scene's triangles: the judge of every approximation.
//!
//! # Theory
//! A compressed wide BVH (H. Ylitie, T. Karras, S. Laine, *Efficient Incoherent Ray Traversal on GPUs Through Compressed
//! Wide BVHs*, HPG 2017, as the `obvhs` crate builds it) finds candidates; each is intersected in `f64` (T. Möller,
//! B. Trumbore, *Fast, Minimum Storage Ray/Triangle Intersection*, 1997).
//!
//! # Practice
//! Triangles are those that the bake sees, before snapping, in world space. Alpha cuts them by the bake's own rule: the
//! same texel, threshold and integer weights decide ([`manyview_shaders::masks`]).

use glam::{DVec3, Vec3A};
use manyview_pipeline::scene::Scene;
use manyview_pipeline::triangles::{Cutouts, LatticeTriangles, TriangleRef};
use manyview_shaders::masks::{TriangleMask, UNMASKED};
use manyview_shaders::raster::BARYCENTRIC_ONE;
use obvhs::BvhBuildParams;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::ray::{Ray, RayHit};
use std::time::Duration;

/// A point on a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Distance from the ray's origin in units of its direction's length.
    pub t: f64,
    /// Index into [`Reference::triangles`].
    pub triangle: u32,
    /// Weights of the triangle's second and third vertex.
    pub barycentric: [f64; 2],
}

/// The scene's drawn triangles, ready for exact rays.
pub struct Reference<'a> {
    bvh: CwBvh,
    /// Taken from every position before it is rounded to the BVH's `f32`.
    center: DVec3,
    /// The BVH's rays begin this far before the origin, metres: it passes over boxes that end within 1e-4 of their
    /// start, however near the surfaces in them are looked for.
    back_metres: f64,
    triangles: Vec<[DVec3; 3]>,
    sources: Vec<TriangleRef>,
    mask_of: Vec<u32>,
    cutouts: &'a Cutouts,
}

impl<'a> Reference<'a> {
    /// The triangles that `drawn` lists (its lattice does not matter), in its order without those of no area, which no
    /// ray can hit.
    pub fn new(scene: &Scene, drawn: &LatticeTriangles, cutouts: &'a Cutouts) -> Self {
        let (min, max) = scene.bounds().unwrap_or_default();
        let center = (min + max) * 0.5;
        let mut triangles = Vec::with_capacity(drawn.sources.len());
        let mut sources = Vec::with_capacity(drawn.sources.len());
        let mut mask_of = Vec::with_capacity(drawn.sources.len());
        for (index, source) in drawn.sources.iter().enumerate() {
            let triangle = world_triangle(scene, source.instance, source.triangle);
            if area_normal(&triangle).length_squared() > 0.0 {
                triangles.push(triangle);
                sources.push(*source);
                mask_of.push(drawn.mask_of.get(index).copied().unwrap_or(UNMASKED));
            }
        }
        let rounded: Vec<_> = triangles
            .iter()
            .map(|t| {
                let [v0, v1, v2] = t.map(|p| Vec3A::from((p - center).as_vec3()));
                obvhs::triangle::Triangle { v0, v1, v2 }
            })
            .collect();
        let bvh = match rounded.is_empty() {
            true => CwBvh::default(),
            false => build_cwbvh_from_tris(&rounded, BvhBuildParams::fast_build(), &mut Duration::default()),
        };
        let back_metres = 1.0 / 1024.0 + 1e-6 * (max - min).length();
        Self { bvh, center, back_metres, triangles, sources, mask_of, cutouts }
    }

    /// The triangles in world space, metres.
    pub fn triangles(&self) -> &[[DVec3; 3]] {
        &self.triangles
    }

    /// Which triangle of the scene each of [`Self::triangles`] is.
    pub fn sources(&self) -> &[TriangleRef] {
        &self.sources
    }

    /// For each triangle the index of its mask in [`Self::cutouts`], or [`UNMASKED`].
    pub fn mask_indices(&self) -> &[u32] {
        &self.mask_of
    }

    /// Index of a triangle's mask in [`Self::cutouts`], or [`UNMASKED`].
    pub fn mask_of(&self, triangle: u32) -> u32 {
        self.mask_of[triangle as usize]
    }

    /// How alpha cuts the triangles.
    pub fn cutouts(&self) -> &'a Cutouts {
        self.cutouts
    }

    /// The middle of the scene's bounds, metres.
    pub fn center(&self) -> DVec3 {
        self.center
    }

    /// Whether the surface is there at these weights of a triangle's second and third vertex, or cut out by its alpha.
    pub fn exists(&self, triangle: u32, barycentric: [f64; 2]) -> bool {
        self.mask(triangle).is_none_or(|mask| mask.passes(&self.cutouts.planes, fixed_point(barycentric)))
    }

    /// Whether anything lies strictly between two points.
    pub fn is_occluded(&self, origin: DVec3, target: DVec3) -> bool {
        let Some(ray) = self.ray(origin, target - origin, 1.0) else { return false };
        !self.bvh.ray_traverse_miss(ray, |_, primitive| {
            let found = self.intersect_one(primitive, origin, target - origin);
            // The comparison there is `t < t_max` in `f32`; what is beyond the target in `f64` never gets that far.
            found.filter(|hit| hit.t < 1.0).map_or(f32::INFINITY, |_| 0.0)
        })
    }

    /// The first hit from `origin` along `direction` (any length) before `t_max` times that length.
    pub fn intersect(&self, origin: DVec3, direction: DVec3, t_max: f64) -> Option<Hit> {
        let ray = self.ray(origin, direction, t_max)?;
        let mut closest: Option<Hit> = None;
        self.bvh.ray_traverse(ray, &mut RayHit::none(), |_, primitive| {
            let nearer = self.intersect_one(primitive, origin, direction).filter(|hit| {
                // Of equally near triangles the one with the smallest index, whatever the order of traversal.
                closest.map_or(hit.t < t_max, |old| (hit.t, hit.triangle) < (old.t, old.triangle))
            });
            let Some(hit) = nearer else { return f32::INFINITY };
            closest = Some(hit);
            // Rounded away from the origin, so that an equally near triangle is still looked at.
            ((hit.t * direction.length() + self.back_metres) * (1.0 + 1e-6)) as f32
        });
        closest
    }

    /// The ray for the BVH: its direction has unit length, since it takes components below 1e-7 for zero.
    fn ray(&self, origin: DVec3, direction: DVec3, t_max: f64) -> Option<Ray> {
        let length = direction.length();
        let usable = length.is_finite() && origin.is_finite() && length > 0.0;
        if !usable || self.triangles.is_empty() {
            return None;
        }
        let unit = direction / length;
        let nearby = Vec3A::from((origin - unit * self.back_metres - self.center).as_vec3());
        let t_max = (t_max * length + self.back_metres) * (1.0 + 1e-6);
        Some(Ray::new(nearby, Vec3A::from(unit.as_vec3()), 0.0, t_max as f32))
    }

    fn mask(&self, triangle: u32) -> Option<&TriangleMask> {
        self.cutouts.masks.get(self.mask_of[triangle as usize] as usize)
    }

    fn intersect_one(&self, primitive: usize, origin: DVec3, direction: DVec3) -> Option<Hit> {
        let triangle = self.bvh.primitive_indices[primitive];
        let (t, barycentric) = intersect_triangle(&self.triangles[triangle as usize], origin, direction)?;
        (t > 0.0 && self.exists(triangle, barycentric)).then_some(Hit { t, triangle, barycentric })
    }
}

/// In how many times the given lengths [`tree_ray`] counts.
pub(crate) const TREE_LENGTHS: f32 = (1 << 20) as f32;

/// A ray through a tree of `obvhs`, whose distances are [`TREE_LENGTHS`] for each length of `direction`: the tree's boxes
/// are not met nearer than 10⁻⁴, which would leave out what is small and close to the origin. For the same reason the
/// inverse is exact where `obvhs` would round it to that of 10⁻⁷.
pub(crate) fn tree_ray(origin: Vec3A, direction: Vec3A, t_max: f32) -> Ray {
    let direction = direction / TREE_LENGTHS;
    let inverse = |c: f32| 1.0 / if c < 0.0 { c.min(-1e-30) } else { c.max(1e-30) };
    let inv_direction = Vec3A::new(inverse(direction.x), inverse(direction.y), inverse(direction.z));
    Ray { origin, direction, inv_direction, tmin: 0.0, tmax: t_max * TREE_LENGTHS }
}

/// Twice a triangle's area along its normal.
pub fn area_normal([a, b, c]: &[DVec3; 3]) -> DVec3 {
    (*b - *a).cross(*c - *a)
}

/// Vertices of a drawn triangle in world space.
pub fn world_triangle(scene: &Scene, instance: u32, triangle: u32) -> [DVec3; 3] {
    let instance = &scene.instances[instance as usize];
    let mesh = &scene.meshes[instance.mesh as usize];
    mesh.triangles[triangle as usize]
        .map(|v| instance.world_from_object.transform_point3(mesh.positions[v as usize].as_dvec3()))
}

/// Distance (in lengths of `direction`, either sign) and weights of the second and third vertex where a line meets a
/// triangle; both sides count, borders included.
pub fn intersect_triangle(
    [a, b, c]: &[DVec3; 3],
    origin: DVec3,
    direction: DVec3,
) -> Option<(f64, [f64; 2])> {
    let (ab, ac, from_a) = (*b - *a, *c - *a, origin - *a);
    let across = direction.cross(ac);
    let determinant = ab.dot(across);
    if determinant == 0.0 {
        return None;
    }
    let b1 = from_a.dot(across) / determinant;
    let turned = from_a.cross(ab);
    let b2 = direction.dot(turned) / determinant;
    let inside = b1 >= 0.0 && b2 >= 0.0 && b1 + b2 <= 1.0;
    inside.then(|| (ac.dot(turned) / determinant, [b1, b2]))
}

/// Weights in the raster's fixed point, rounded down as it does.
pub(crate) fn fixed_point(barycentric: [f64; 2]) -> [u32; 2] {
    let one = f64::from(BARYCENTRIC_ONE);
    let b1 = ((barycentric[0] * one) as u32).min(BARYCENTRIC_ONE);
    [b1, ((barycentric[1] * one) as u32).min(BARYCENTRIC_ONE - b1)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat4, Vec2, Vec3};
    use manyview_pipeline::generate::{SceneKind, generate};
    use manyview_pipeline::scene::{AlphaMode, Instance, Material, Mesh, Texture, Wrap};

    fn drawn(scene: &Scene) -> (LatticeTriangles, Cutouts) {
        let cutouts = Cutouts::new(scene);
        (LatticeTriangles::new(scene, &cutouts, |_| [0; 3]), cutouts)
    }

    /// A unit square at z = 0, whose texture keeps only the half x ≥ 0.5.
    fn half_a_square() -> Scene {
        Scene {
            meshes: vec![Mesh {
                positions: vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y],
                base_color_uvs: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
                triangles: vec![[0, 1, 2], [0, 2, 3]],
                ..Mesh::default()
            }],
            instances: vec![Instance { mesh: 0, world_from_object: DMat4::from_scale(DVec3::splat(2.0)) }],
            materials: vec![Material {
                base_color_texture: Some(0),
                alpha_mode: AlphaMode::Mask { cutoff: 0.5 },
                ..Material::default()
            }],
            textures: vec![Texture {
                width: 2,
                height: 1,
                texels: vec![[0, 0, 0, 0], [0, 0, 0, 255]],
                wrap: [Wrap::ClampToEdge; 2],
            }],
            ..Scene::default()
        }
    }

    #[test]
    fn alpha_lets_rays_through_where_it_cuts() {
        let scene = half_a_square();
        let (drawn, cutouts) = drawn(&scene);
        let reference = Reference::new(&scene, &drawn, &cutouts);
        let through = |x: f64, y: f64| (DVec3::new(x, y, 3.0), DVec3::new(x, y, -1.0));
        for (x, occluded) in [(0.5, false), (0.9, false), (1.1, true), (1.9, true), (2.1, false)] {
            let (a, b) = through(x, 0.7);
            assert_eq!(reference.is_occluded(a, b), occluded, "x = {x}");
            assert_eq!(reference.is_occluded(b, a), occluded, "x = {x} from behind");
        }
        let hit = reference.intersect(DVec3::new(1.5, 0.5, 3.0), DVec3::new(0.0, 0.0, -2.0), 10.0).unwrap();
        assert_eq!((hit.t, hit.triangle), (1.5, 0));
        assert!(reference.intersect(DVec3::new(1.5, 0.5, 3.0), DVec3::new(0.0, 0.0, -2.0), 1.4).is_none());
    }

    #[test]
    fn a_segment_ends_where_its_target_is() {
        let scene = half_a_square();
        let (drawn, cutouts) = drawn(&scene);
        let reference = Reference::new(&scene, &drawn, &cutouts);
        let from = DVec3::new(1.5, 0.5, 3.0);
        assert!(!reference.is_occluded(from, DVec3::new(1.5, 0.5, 1e-6)));
        assert!(reference.is_occluded(from, DVec3::new(1.5, 0.5, -1e-6)));
        assert!(!reference.is_occluded(from, from), "a segment of no length");
        assert!(!reference.is_occluded(from, DVec3::NAN));
    }

    #[test]
    fn what_is_close_to_a_long_ray_s_origin_is_found() {
        // A square of 2 mm, 3 mm from the origin, and a target 900 m away; another makes the scene large.
        let mut scene = half_a_square();
        scene.materials.clear();
        let small =
            DMat4::from_translation(DVec3::new(-1e-3, -1e-3, 3e-3)) * DMat4::from_scale(DVec3::splat(2e-3));
        scene.instances = vec![
            Instance { mesh: 0, world_from_object: small },
            Instance { mesh: 0, world_from_object: DMat4::from_translation(DVec3::splat(900.0)) },
        ];
        let (drawn, cutouts) = drawn(&scene);
        let reference = Reference::new(&scene, &drawn, &cutouts);
        let target = DVec3::new(1e-5, 1e-5, 900.0);
        assert!(reference.is_occluded(DVec3::ZERO, target));
        let hit = reference.intersect(DVec3::ZERO, target, 1.0).unwrap();
        assert!((hit.t * 900.0 - 3e-3).abs() < 1e-9);
    }

    #[test]
    fn the_tree_finds_what_testing_every_triangle_finds() {
        let scene = generate(SceneKind::Forest, 3000, 5);
        let (drawn, cutouts) = drawn(&scene);
        let reference = Reference::new(&scene, &drawn, &cutouts);
        let (min, max) = scene.bounds().unwrap();
        let mut random = crate::bench::Random::new(3);
        let mut point = || min + (max - min) * DVec3::from_array([0; 3].map(|_: i32| random.unit()));
        let mut hits = 0;
        for _ in 0..300 {
            let (origin, target) = (point(), point());
            let every = (0..reference.triangles.len() as u32)
                .filter_map(|i| {
                    let (t, b) =
                        intersect_triangle(&reference.triangles[i as usize], origin, target - origin)?;
                    (t > 0.0 && t < 1.0 && reference.exists(i, b)).then_some((t, i))
                })
                .min_by(|a, b| a.partial_cmp(b).unwrap());
            let found = reference.intersect(origin, target - origin, 1.0);
            assert_eq!(found.map(|h| (h.t, h.triangle)), every);
            assert_eq!(reference.is_occluded(origin, target), every.is_some());
            hits += usize::from(every.is_some());
        }
        assert!((30..270).contains(&hits), "{hits} of 300 rays hit something");
    }

    #[test]
    fn a_surface_next_to_the_origin_is_found_however_long_or_short_the_segment() {
        let scene = half_a_square();
        let (drawn, cutouts) = drawn(&scene);
        let reference = Reference::new(&scene, &drawn, &cutouts);
        for before in [1e-9, 1e-6, 1e-3] {
            for behind in [1e-9, 1e-5, 1.0, 1e4] {
                let at = |z: f64| DVec3::new(1.5, 0.7, z);
                assert!(reference.is_occluded(at(-before), at(behind)), "{before} {behind}");
                assert!(reference.is_occluded(at(before), at(-behind)), "{before} {behind}");
                assert!(!reference.is_occluded(at(before), at(before + behind)), "{before} {behind}");
            }
        }
    }

    #[test]
    fn an_empty_scene_occludes_nothing() {
        let scene = Scene::default();
        let (drawn, cutouts) = drawn(&scene);
        let reference = Reference::new(&scene, &drawn, &cutouts);
        assert!(!reference.is_occluded(DVec3::ZERO, DVec3::ONE));
        assert!(reference.intersect(DVec3::ZERO, DVec3::ONE, 1.0).is_none());
    }
}
