//! Scene in, snapped triangles out: instances flattened onto an integer lattice, alpha cut-outs prepared.
//!
//! Both voxel products start here: the octree from a lattice over the scene cube, the rows from a lattice over the
//! scene's bounds. Nothing after this step sees a float position.

use crate::scene::{Material, Mesh, Scene, Wrap};
use glam::DVec3;
use manyview_shaders::device::TriangleBatch;
use manyview_shaders::masks::{AlphaPlane, TexelMap, TriangleMask, UNMASKED, WrapCode};
use rayon::prelude::*;
use std::ops::Range;

/// Which triangle of the scene a snapped triangle is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct TriangleRef {
    /// Index into [`Scene::instances`].
    pub instance: u32,
    /// Index into the mesh's triangles.
    pub triangle: u32,
}

/// The drawn triangles of a scene on a lattice.
#[derive(Debug, Default)]
pub struct LatticeTriangles {
    /// Vertices in lattice coordinates.
    pub triangles: Vec<[[i16; 3]; 3]>,
    /// Where each came from.
    pub sources: Vec<TriangleRef>,
    /// Index into the [`Cutouts`]' masks for each, or [`UNMASKED`]; empty if the scene has no cut-outs.
    pub mask_of: Vec<u32>,
}

impl LatticeTriangles {
    /// Snaps every drawn triangle of `scene`, in the order of instances and triangles. `snap` takes a world position
    /// to lattice coordinates. Triangles that their cut-out removes altogether are left out.
    pub fn new(scene: &Scene, cutouts: &Cutouts, snap: impl Fn(DVec3) -> [i16; 3] + Sync) -> Self {
        let whole = |instance: u32| {
            let mesh = &scene.meshes[scene.instances[instance as usize].mesh as usize];
            (instance, 0..mesh.triangles.len() as u32)
        };
        let pieces: Vec<_> = (0..scene.instances.len() as u32).map(whole).collect();
        Self::of_pieces(scene, cutouts, &pieces, snap)
    }

    /// As [`new`](Self::new), of some triangles: instances, each with a range of its mesh's triangles.
    pub fn of_pieces(
        scene: &Scene,
        cutouts: &Cutouts,
        pieces: &[(u32, Range<u32>)],
        snap: impl Fn(DVec3) -> [i16; 3] + Sync,
    ) -> Self {
        Self::of_pieces_where(scene, cutouts, pieces, snap, |_| true)
    }

    /// As [`of_pieces`](Self::of_pieces), of those snapped triangles that `is_wanted`.
    pub fn of_pieces_where(
        scene: &Scene,
        cutouts: &Cutouts,
        pieces: &[(u32, Range<u32>)],
        snap: impl Fn(DVec3) -> [i16; 3] + Sync,
        is_wanted: impl Fn(&[[i16; 3]; 3]) -> bool + Sync,
    ) -> Self {
        let parts: Vec<Self> = pieces
            .par_iter()
            .map(|(index, triangles)| {
                let instance = &scene.instances[*index as usize];
                let mesh = &scene.meshes[instance.mesh as usize];
                let snapped = |vertex: u32| {
                    let position = mesh.positions[vertex as usize].as_dvec3();
                    snap(instance.world_from_object.transform_point3(position))
                };
                // Vertices are shared by several triangles, but a piece may use few of them.
                let lattice: Vec<[i16; 3]> = if triangles.len() == mesh.triangles.len() {
                    (0..mesh.positions.len() as u32).map(snapped).collect()
                } else {
                    Vec::new()
                };
                let mask_of = &cutouts.mask_of[instance.mesh as usize];
                let mut part = Self::default();
                for t in triangles.clone() {
                    let mask = mask_of.get(t as usize).copied().unwrap_or(Cut::Solid);
                    if mask == Cut::Away {
                        continue;
                    }
                    let triangle = mesh.triangles[t as usize];
                    let triangle = if lattice.is_empty() {
                        triangle.map(snapped)
                    } else {
                        triangle.map(|v| lattice[v as usize])
                    };
                    if !is_wanted(&triangle) {
                        continue;
                    }
                    part.triangles.push(triangle);
                    part.sources.push(TriangleRef { instance: *index, triangle: t });
                    if !cutouts.masks.is_empty() {
                        part.mask_of.push(if let Cut::Masked(mask) = mask { mask } else { UNMASKED });
                    }
                }
                part
            })
            .collect();
        let mut all = Self::default();
        let count = parts.iter().map(|p| p.triangles.len()).sum();
        all.triangles.reserve_exact(count);
        all.sources.reserve_exact(count);
        for part in parts {
            all.triangles.extend(part.triangles);
            all.sources.extend(part.sources);
            all.mask_of.extend(part.mask_of);
        }
        all
    }

    /// The mask of triangle `index`, if it is cut.
    #[inline]
    pub fn mask<'a>(&self, cutouts: &'a Cutouts, index: usize) -> Option<&'a TriangleMask> {
        self.mask_of.get(index).and_then(|&m| cutouts.masks.get(m as usize))
    }

    /// The triangles that `members` name, in that order.
    pub fn part(&self, members: &[u32]) -> Self {
        let of = |index: &u32| *index as usize;
        Self {
            triangles: members.iter().map(|m| self.triangles[of(m)]).collect(),
            sources: members.iter().map(|m| self.sources[of(m)]).collect(),
            mask_of: if self.mask_of.is_empty() {
                Vec::new()
            } else {
                members.iter().map(|m| self.mask_of[of(m)]).collect()
            },
        }
    }

    /// All triangles as a job for a [`VoxelDevice`](manyview_shaders::device::VoxelDevice).
    pub fn batch<'a>(&'a self, cutouts: &'a Cutouts) -> TriangleBatch<'a> {
        TriangleBatch {
            triangles: &self.triangles,
            mask_of: &self.mask_of,
            masks: &cutouts.masks,
            planes: &cutouts.planes,
        }
    }
}

/// What alpha does to one triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Cut {
    /// Nothing.
    Solid,
    /// All of it is below the cutoff.
    Away,
    /// Texels decide: index of the mask.
    Masked(u32),
}

/// How alpha cuts the scene's meshes, per mesh triangle and shared by all instances.
#[derive(Debug, Default)]
pub struct Cutouts {
    /// Alpha planes of the textures that cut something.
    pub planes: Vec<AlphaPlane>,
    /// One per triangle that its texture cuts.
    pub masks: Vec<TriangleMask>,
    /// For each mesh: empty if nothing is cut, else one entry per triangle.
    mask_of: Vec<Vec<Cut>>,
}

impl Cutouts {
    /// Prepares the cut-outs of every mesh whose material has an alpha cutoff. A triangle's threshold takes in the
    /// material's alpha and the mean of its vertex alphas.
    pub fn new(scene: &Scene) -> Self {
        Self::of_meshes(scene, |_| true)
    }

    /// Whether alpha cuts away every drawn triangle.
    pub fn leaves_nothing(&self, scene: &Scene) -> bool {
        scene.instances.iter().all(|instance| {
            let cuts = &self.mask_of[instance.mesh as usize];
            let is_empty = scene.meshes[instance.mesh as usize].triangles.is_empty();
            is_empty || (!cuts.is_empty() && cuts.iter().all(|cut| *cut == Cut::Away))
        })
    }

    /// As [`new`](Self::new), for those meshes that `is_wanted` tells by their index; the others must not be asked for.
    pub fn of_meshes(scene: &Scene, is_wanted: impl Fn(usize) -> bool) -> Self {
        let mut cutouts = Self { mask_of: vec![Vec::new(); scene.meshes.len()], ..Self::default() };
        let mut plane_of_texture = vec![None; scene.textures.len()];
        // Many meshes may share one large texture.
        let mut range_of_texture = vec![None; scene.textures.len()];
        for (m, mesh) in scene.meshes.iter().enumerate().filter(|(m, _)| is_wanted(*m)) {
            let material = material_of(scene, mesh);
            let Some(cutoff) = material.alpha_mode.cutoff() else { continue };
            let texture = material.base_color_texture.filter(|_| !mesh.base_color_uvs.is_empty());
            let range = texture.map_or((255, 255), |t| {
                *range_of_texture[t as usize].get_or_insert_with(|| {
                    let alphas = scene.textures[t as usize].texels.iter().map(|t| t[3]);
                    alphas.fold((255, 0), |(lo, hi): (u8, u8), a| (lo.min(a), hi.max(a)))
                })
            });
            let cuts: Vec<Cut> = mesh
                .triangles
                .iter()
                .map(|&triangle| {
                    let vertex_alpha = if mesh.colors.is_empty() {
                        1.0
                    } else {
                        triangle.iter().map(|&v| f64::from(mesh.colors[v as usize].w)).sum::<f64>() / 3.0
                    };
                    let threshold =
                        alpha_threshold(f64::from(cutoff), f64::from(material.base_color.w) * vertex_alpha);
                    if threshold <= u32::from(range.0) {
                        return Cut::Solid;
                    }
                    if threshold > u32::from(range.1) {
                        return Cut::Away;
                    }
                    let texture_index = texture.expect("only a texture has a range of alphas") as usize;
                    let texture = &scene.textures[texture_index];
                    let wrap = texture.wrap.map(wrap_code);
                    let plane = *plane_of_texture[texture_index].get_or_insert_with(|| {
                        cutouts.planes.push(AlphaPlane {
                            width: texture.width,
                            height: texture.height,
                            wrap,
                            alpha: texture.texels.iter().map(|t| t[3]).collect(),
                        });
                        cutouts.planes.len() as u32 - 1
                    });
                    let uvs = triangle.map(|v| mesh.base_color_uvs[v as usize].to_array().map(f64::from));
                    let map = TexelMap::new(uvs, [texture.width, texture.height], wrap);
                    cutouts.masks.push(TriangleMask { plane, threshold, map, reserved: 0 });
                    Cut::Masked(cutouts.masks.len() as u32 - 1)
                })
                .collect();
            if cuts.iter().any(|c| *c != Cut::Solid) {
                cutouts.mask_of[m] = cuts;
            }
        }
        cutouts
    }
}

/// The material of a mesh; glTF's default where the index names none.
pub(crate) fn material_of<'s>(scene: &'s Scene, mesh: &Mesh) -> &'s Material {
    static DEFAULT: std::sync::LazyLock<Material> = std::sync::LazyLock::new(Material::default);
    scene.materials.get(mesh.material as usize).unwrap_or(&DEFAULT)
}

pub(crate) fn wrap_code(wrap: Wrap) -> WrapCode {
    match wrap {
        Wrap::Repeat => WrapCode::Repeat,
        Wrap::MirroredRepeat => WrapCode::Mirror,
        Wrap::ClampToEdge => WrapCode::Clamp,
    }
}

/// The smallest 8-bit alpha a with `a / 255 · factor ≥ cutoff`; 256 if there is none.
fn alpha_threshold(cutoff: f64, factor: f64) -> u32 {
    (0..=255u32).find(|&a| f64::from(a) / 255.0 * factor >= cutoff).unwrap_or(256)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{AlphaMode, Instance, Texture};
    use glam::{DMat4, Vec2, Vec3, Vec4};

    fn scene(alpha_mode: AlphaMode, base_alpha: f32, texels: Option<Vec<[u8; 4]>>) -> Scene {
        let texture =
            texels.map(|texels| Texture { width: 2, height: 1, texels, wrap: [Wrap::ClampToEdge; 2] });
        Scene {
            meshes: vec![Mesh {
                positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
                base_color_uvs: vec![Vec2::ZERO, Vec2::X, Vec2::Y],
                triangles: vec![[0, 1, 2]],
                ..Mesh::default()
            }],
            instances: vec![Instance { mesh: 0, world_from_object: DMat4::from_translation(DVec3::X) }; 2],
            materials: vec![Material {
                base_color: Vec4::new(1.0, 1.0, 1.0, base_alpha),
                base_color_texture: texture.as_ref().map(|_| 0),
                alpha_mode,
                ..Material::default()
            }],
            textures: texture.into_iter().collect(),
            ..Scene::default()
        }
    }

    fn snapped(scene: &Scene) -> (LatticeTriangles, Cutouts) {
        let cutouts = Cutouts::new(scene);
        (LatticeTriangles::new(scene, &cutouts, |p| (p * 10.0).to_array().map(|c| c as i16)), cutouts)
    }

    #[test]
    fn instances_are_flattened_in_world_space() {
        let (all, _) = snapped(&scene(AlphaMode::Opaque, 0.0, None));
        assert_eq!(all.triangles, [[[10, 0, 0], [20, 0, 0], [10, 10, 0]]; 2]);
        assert_eq!(all.sources[1], TriangleRef { instance: 1, triangle: 0 });
        assert!(all.mask_of.is_empty());
    }

    #[test]
    fn blend_is_a_mask_with_cutoff_one_half() {
        assert_eq!(snapped(&scene(AlphaMode::Blend, 0.4, None)).0.triangles.len(), 0);
        assert_eq!(snapped(&scene(AlphaMode::Blend, 0.6, None)).0.triangles.len(), 2);
    }

    #[test]
    fn only_textures_that_cut_make_masks() {
        let cut = Some(vec![[0, 0, 0, 0], [0, 0, 0, 255]]);
        let (all, cutouts) = snapped(&scene(AlphaMode::Mask { cutoff: 0.5 }, 1.0, cut.clone()));
        assert_eq!((cutouts.masks.len(), cutouts.masks[0].threshold), (1, 128));
        assert_eq!(all.mask_of, [0, 0]);
        assert!(all.mask(&cutouts, 0).is_some());
        let (_, cutouts) = snapped(&scene(AlphaMode::Opaque, 1.0, cut));
        assert!(cutouts.masks.is_empty());
        let solid = Some(vec![[0, 0, 0, 200], [0, 0, 0, 255]]);
        let (all, cutouts) = snapped(&scene(AlphaMode::Mask { cutoff: 0.5 }, 1.0, solid));
        assert!(cutouts.masks.is_empty() && all.triangles.len() == 2);
    }
}
