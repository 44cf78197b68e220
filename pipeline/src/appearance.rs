//! What a fragment looks like: base colour, emitted radiance, normal.
//!
//! Everything is computed from integer barycentric weights with basic IEEE operations, so that averages over
//! fragments, summed in integers, are the same whatever the order, backend or machine.

use crate::scene::{Scene, Texture};
use crate::triangles::{TriangleRef, material_of, wrap_code};
use glam::{DVec2, DVec3};
use manyview_shaders::masks::{TexelMap, WrapCode, wrap_texel};
use manyview_shaders::raster::BARYCENTRIC_ONE;
use manyview_shaders::rgb9e5;
use manyview_shaders::srgb::{LINEAR_FROM_SRGB, srgb_from_linear};
use rayon::prelude::*;

/// Fixed point of [`Sample::emissive`]: one unit of radiance.
pub const EMISSIVE_ONE: f64 = 65536.0;

/// One fragment's appearance, ready for integer sums.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Linear base colour, of 65535.
    pub color: [u16; 3],
    /// Emitted radiance times [`EMISSIVE_ONE`].
    pub emissive: [u32; 3],
    /// Unit normal of the surface's front.
    pub normal: [f32; 3],
}

/// The looks of a scene's triangles.
pub struct Appearance<'s> {
    scene: &'s Scene,
    /// Edge of a voxel in metres: textures are filtered to about this size.
    voxel_size: f64,
    base_color: Vec<Option<MipChain>>,
    emissive: Vec<Option<MipChain>>,
    emits: bool,
}

impl<'s> Appearance<'s> {
    /// Prepares filtered textures for voxels of the given edge, in metres.
    pub fn new(scene: &'s Scene, voxel_size: f64) -> Self {
        Self::of_meshes(scene, voxel_size, |_| true)
    }

    /// As [`new`](Self::new), for those meshes that `is_wanted` tells by their index; the others must not be asked for.
    pub fn of_meshes(scene: &'s Scene, voxel_size: f64, is_wanted: impl Fn(usize) -> bool) -> Self {
        Self::prepared(scene, voxel_size, is_wanted, MipChain::new)
    }

    /// As [`of_meshes`](Self::of_meshes), with textures as they are: quick, and near enough for an estimate.
    pub(crate) fn unfiltered(scene: &'s Scene, voxel_size: f64, is_wanted: impl Fn(usize) -> bool) -> Self {
        Self::prepared(scene, voxel_size, is_wanted, |texture, _| MipChain::unfiltered(texture))
    }

    fn prepared(
        scene: &'s Scene,
        voxel_size: f64,
        is_wanted: impl Fn(usize) -> bool,
        chain: impl Fn(&Texture, bool) -> MipChain + Sync,
    ) -> Self {
        #[derive(Clone, Copy, Default)]
        struct Use {
            base_color: bool,
            weighted: bool,
            emissive: bool,
        }
        let mut uses = vec![Use::default(); scene.textures.len()];
        let mut emits = false;
        let mut drawn = vec![false; scene.meshes.len()];
        for instance in &scene.instances {
            drawn[instance.mesh as usize] = true;
        }
        for (index, mesh) in scene.meshes.iter().enumerate().filter(|(index, _)| drawn[*index]) {
            let material = material_of(scene, mesh);
            // How a texture is filtered follows from all meshes; whether it is needed, from the wanted ones.
            let is_wanted = is_wanted(index);
            if let Some(t) = material.base_color_texture {
                uses[t as usize].base_color |= is_wanted;
                uses[t as usize].weighted |= material.alpha_mode.cutoff().is_some();
            }
            if material.emissive.max_element() > 0.0 {
                emits = true;
                if let Some(t) = material.emissive_texture {
                    uses[t as usize].emissive |= is_wanted;
                }
            }
        }
        let chains: Vec<_> = uses
            .par_iter()
            .zip(&scene.textures)
            .map(|(wanted, texture)| {
                (
                    wanted.base_color.then(|| chain(texture, wanted.weighted)),
                    wanted.emissive.then(|| chain(texture, false)),
                )
            })
            .collect();
        let (base_color, emissive) = chains.into_iter().unzip();
        Self { scene, voxel_size, base_color, emissive, emits }
    }

    /// Whether any drawn material emits light.
    pub fn emits(&self) -> bool {
        self.emits
    }

    /// Sets one triangle up for sampling.
    pub fn surface(&self, source: TriangleRef) -> Surface<'_> {
        let instance = &self.scene.instances[source.instance as usize];
        let mesh = &self.scene.meshes[instance.mesh as usize];
        let material = material_of(self.scene, mesh);
        let vertices = mesh.triangles[source.triangle as usize].map(|v| v as usize);
        let world_from_object = instance.world_from_object;
        let world = vertices.map(|v| world_from_object.transform_point3(mesh.positions[v].as_dvec3()));
        let (edge1, edge2) = (world[1] - world[0], world[2] - world[0]);
        let mirror = if world_from_object.determinant() < 0.0 { -1.0 } else { 1.0 };
        let cross = edge1.cross(edge2);
        let geometric = unit(cross * mirror).unwrap_or(DVec3::Y);
        let normals = if mesh.normals.is_empty() {
            None
        } else {
            // Cofactors transform normals, also of singular matrices.
            let [x, y, z] = [world_from_object.x_axis, world_from_object.y_axis, world_from_object.z_axis];
            let (x, y, z) = (x.truncate(), y.truncate(), z.truncate());
            let cofactors = [y.cross(z) * mirror, z.cross(x) * mirror, x.cross(y) * mirror];
            Some(vertices.map(|v| {
                let n = mesh.normals[v].as_dvec3();
                unit(cofactors[0] * n.x + cofactors[1] * n.y + cofactors[2] * n.z).unwrap_or(geometric)
            }))
        };
        let texels_of = |texture: Option<u32>, uvs: &[glam::Vec2], chains: &'_ [Option<MipChain>]| {
            let texture = texture.filter(|_| !uvs.is_empty())? as usize;
            let chain = chains[texture].as_ref()?;
            let corners = vertices.map(|v| uvs[v].as_dvec2());
            let image = &self.scene.textures[texture];
            let size = [image.width, image.height];
            let wrap = image.wrap.map(wrap_code);
            let map = TexelMap::new(corners.map(|uv| uv.to_array()), size, wrap);
            let scale = DVec2::new(f64::from(size[0]), f64::from(size[1]));
            let texel_area =
                ((corners[1] - corners[0]) * scale).perp_dot((corners[2] - corners[0]) * scale).abs();
            let mut texels_per_voxel_area = texel_area * self.voxel_size * self.voxel_size / cross.length();
            let mut level = 0;
            while texels_per_voxel_area >= 4.0 && level + 1 < chain.levels.len() {
                texels_per_voxel_area *= 0.25;
                level += 1;
            }
            Some(Texels { map, wrap, size, chain_level: (texture, level) })
        };
        Surface {
            base_color: [material.base_color.x, material.base_color.y, material.base_color.z].map(f64::from),
            base_color_texels: texels_of(material.base_color_texture, &mesh.base_color_uvs, &self.base_color),
            vertex_colors: (!mesh.colors.is_empty())
                .then(|| vertices.map(|v| mesh.colors[v].truncate().to_array().map(f64::from))),
            emissive: material.emissive.to_array().map(f64::from),
            emissive_texels: texels_of(material.emissive_texture, &mesh.emissive_uvs, &self.emissive),
            geometric,
            normals,
            appearance: self,
        }
    }
}

/// One triangle set up for sampling.
pub struct Surface<'a> {
    appearance: &'a Appearance<'a>,
    base_color: [f64; 3],
    base_color_texels: Option<Texels>,
    vertex_colors: Option<[[f64; 3]; 3]>,
    emissive: [f64; 3],
    emissive_texels: Option<Texels>,
    geometric: DVec3,
    normals: Option<[DVec3; 3]>,
}

struct Texels {
    map: TexelMap,
    wrap: [WrapCode; 2],
    size: [u32; 2],
    /// Texture, mip level.
    chain_level: (usize, usize),
}

impl Texels {
    /// Linear colour of the texel at weights (b1, b2), 0 to 1.
    fn linear(&self, chains: &[Option<MipChain>], barycentric: [u32; 2]) -> [f64; 3] {
        let (texture, level) = self.chain_level;
        let mip = &chains[texture].as_ref().expect("set up from this chain").levels[level];
        let at = self.map.at(barycentric);
        let [s, t] = [0, 1].map(|i| {
            let texel = u64::from(wrap_texel(at[i], self.size[i], self.wrap[i]));
            (texel * u64::from(mip.size[i]) / u64::from(self.size[i])) as usize
        });
        mip.texels[t * mip.size[0] as usize + s]
            .map(|c| f64::from(LINEAR_FROM_SRGB[usize::from(c)]) / 65535.0)
    }
}

impl Surface<'_> {
    /// The triangle's look at weights (b1, b2).
    pub fn sample(&self, barycentric: [u32; 2]) -> Sample {
        let one = f64::from(BARYCENTRIC_ONE);
        let (b1, b2) = (f64::from(barycentric[0]) / one, f64::from(barycentric[1]) / one);
        let b0 = 1.0 - b1 - b2;
        let mut color = self.base_color;
        if let Some(texels) = &self.base_color_texels {
            let texel = texels.linear(&self.appearance.base_color, barycentric);
            color = [0, 1, 2].map(|c| color[c] * texel[c]);
        }
        if let Some(v) = &self.vertex_colors {
            color = [0, 1, 2].map(|c| color[c] * (v[0][c] * b0 + v[1][c] * b1 + v[2][c] * b2));
        }
        let mut emissive = self.emissive;
        if let Some(texels) = &self.emissive_texels {
            let texel = texels.linear(&self.appearance.emissive, barycentric);
            emissive = [0, 1, 2].map(|c| emissive[c] * texel[c]);
        }
        let normal = match &self.normals {
            None => self.geometric,
            Some(n) => unit(n[0] * b0 + n[1] * b1 + n[2] * b2).unwrap_or(self.geometric),
        };
        Sample {
            // `as` saturates and turns NaN into 0.
            color: color.map(|c| (c * 65535.0 + 0.5) as u16),
            emissive: emissive.map(|e| (e.clamp(0.0, rgb9e5::MAX) * EMISSIVE_ONE + 0.5) as u32),
            normal: normal.to_array().map(|c| c as f32),
        }
    }
}

/// An image at full size and halved again and again, colours averaged in linear light.
struct MipChain {
    levels: Vec<Mip>,
}

struct Mip {
    size: [u32; 2],
    texels: Vec<[u8; 3]>,
}

impl MipChain {
    fn unfiltered(texture: &Texture) -> Self {
        let texels = texture.texels.iter().map(|&[r, g, b, _]| [r, g, b]).collect();
        Self { levels: vec![Mip { size: [texture.width, texture.height], texels }] }
    }

    /// `weighted`: texels count by their alpha, so that the colour of what is cut away does not bleed in.
    fn new(texture: &Texture, weighted: bool) -> Self {
        let mut alphas: Vec<u8> = texture.texels.iter().map(|t| if weighted { t[3] } else { 255 }).collect();
        let mut levels = vec![Mip {
            size: [texture.width, texture.height],
            texels: texture.texels.iter().map(|&[r, g, b, _]| [r, g, b]).collect(),
        }];
        while let Some(last) = levels.last().filter(|l| l.size != [1, 1]) {
            let size = last.size.map(|s| (s / 2).max(1));
            let mut texels = Vec::with_capacity((size[0] * size[1]) as usize);
            let mut next_alphas = Vec::with_capacity(texels.capacity());
            for y in 0..size[1] {
                for x in 0..size[0] {
                    let (mut sum, mut plain, mut alpha) = ([0u64; 3], [0u64; 3], 0u64);
                    for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                        let sx = (x * 2 + dx).min(last.size[0] - 1);
                        let sy = (y * 2 + dy).min(last.size[1] - 1);
                        let i = (sy * last.size[0] + sx) as usize;
                        let a = u64::from(alphas[i]);
                        alpha += a;
                        for c in 0..3 {
                            let linear = u64::from(LINEAR_FROM_SRGB[usize::from(last.texels[i][c])]);
                            sum[c] += linear * a;
                            plain[c] += linear;
                        }
                    }
                    texels.push([0, 1, 2].map(|c| {
                        let weighted = (sum[c] + alpha / 2).checked_div(alpha);
                        srgb_from_linear(weighted.unwrap_or((plain[c] + 2) / 4) as u16)
                    }));
                    next_alphas.push(((alpha + 2) / 4) as u8);
                }
            }
            alphas = next_alphas;
            levels.push(Mip { size, texels });
        }
        Self { levels }
    }
}

fn unit(v: DVec3) -> Option<DVec3> {
    let length = v.dot(v).sqrt();
    (length > 0.0 && length.is_finite()).then(|| v / length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Instance, Material, Mesh, Wrap};
    use glam::{DMat4, Vec2, Vec3, Vec4};

    fn one_triangle(material: Material, textures: Vec<Texture>) -> Scene {
        Scene {
            meshes: vec![Mesh {
                positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
                base_color_uvs: vec![Vec2::ZERO, Vec2::X, Vec2::Y],
                colors: vec![Vec4::ONE, Vec4::ONE, Vec4::new(0.0, 0.0, 0.0, 1.0)],
                triangles: vec![[0, 1, 2]],
                ..Mesh::default()
            }],
            instances: vec![Instance { mesh: 0, world_from_object: DMat4::IDENTITY }],
            materials: vec![material],
            textures,
            ..Scene::default()
        }
    }

    const FIRST: TriangleRef = TriangleRef { instance: 0, triangle: 0 };

    #[test]
    fn factor_texture_and_vertex_colours_multiply_in_linear_light() {
        let texture =
            Texture { width: 1, height: 1, texels: vec![[255, 188, 0, 255]], wrap: [Wrap::Repeat; 2] };
        let material = Material {
            base_color: Vec4::new(0.5, 1.0, 1.0, 1.0),
            base_color_texture: Some(0),
            emissive: Vec3::new(0.0, 2.0, 0.0),
            ..Material::default()
        };
        let scene = one_triangle(material, vec![texture]);
        let appearance = Appearance::new(&scene, 1.0);
        let at_first = appearance.surface(FIRST).sample([0, 0]);
        assert_eq!(at_first.color, [32768, LINEAR_FROM_SRGB[188], 0]);
        assert_eq!(at_first.emissive, [0, 2 << 16, 0]);
        assert_eq!(at_first.normal, [0.0, 0.0, 1.0]);
        let halfway = appearance.surface(FIRST).sample([0, BARYCENTRIC_ONE / 2]);
        assert_eq!(halfway.color[0], 16384);
        assert!(appearance.emits());
    }

    #[test]
    fn mirrored_instances_keep_their_front() {
        let mut scene = one_triangle(Material::default(), Vec::new());
        scene.instances[0].world_from_object = DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0));
        assert_eq!(Appearance::new(&scene, 1.0).surface(FIRST).sample([0, 0]).normal, [0.0, 0.0, 1.0]);
        scene.meshes[0].normals = vec![Vec3::Z; 3];
        assert_eq!(Appearance::new(&scene, 1.0).surface(FIRST).sample([0, 0]).normal, [0.0, 0.0, 1.0]);
    }

    #[test]
    fn large_voxels_see_the_mean_of_the_texture_in_linear_light() {
        let texels = [[0, 0, 0, 255], [255, 255, 255, 255], [255, 255, 255, 255], [0, 0, 0, 255]].to_vec();
        let texture = Texture { width: 2, height: 2, texels, wrap: [Wrap::Repeat; 2] };
        let material = Material { base_color_texture: Some(0), ..Material::default() };
        let scene = one_triangle(material, vec![texture]);
        let color = Appearance::new(&scene, 10.0).surface(FIRST).sample([0, 0]).color;
        assert!(color[0].abs_diff(32768) < 300, "{color:?}");
    }
}
