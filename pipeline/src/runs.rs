//! The scene as pieces that change together, each with its place and its identity.
//!
//! A *run* is up to [`RUN_TRIANGLES`] successive triangles of a mesh in one instance. What is made of the scene is made
//! cell by cell of some grid, and depends on the runs that reach into the cell: on the *set* of them, since no step
//! sees an order. So a cell's key is made of its runs' digests, sorted. Names, node order, and everything else that is
//! neither shape nor look are in none.
//!
//! Every run has two digests:
//! - its *shape*: corners in object space, the instance's transform, and what alpha cuts away;
//! - its *look*: the shape, and all else that a fragment's colour, radiance and normal follow from.

use crate::scene::{Mesh, Scene, Texture, Wrap};
use crate::triangles::material_of;
use glam::DVec3;
use manyview_cache::digest::{Digest, DigestBuilder, KeyEncoder};
use rayon::prelude::*;
use std::ops::Range;

/// Triangles of a run, at most: few enough that a change of one triangle of a large mesh stays local, enough that
/// their bookkeeping costs nothing.
pub const RUN_TRIANGLES: usize = 512;

/// A piece of the scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// Index into [`Scene::instances`].
    pub instance: u32,
    /// Of the instance's mesh.
    pub triangles: Range<u32>,
    /// World bounds of the triangles: smallest and largest corner, metres.
    pub bounds: [DVec3; 2],
    /// Square metres of surface that fill a voxel each, if voxels had an edge of a metre: of a triangle, what it shows
    /// to the axis that it faces most, and half of what it shows to the others.
    pub surface: f64,
    /// Square metres that the triangles show to each axis. What alpha cuts away is left out of both.
    pub facing: [f64; 3],
    /// Identity of the mesh's part, wherever it is placed.
    pub mesh: Digest,
    /// Identity of the shape.
    pub shape: Digest,
    /// Identity of shape and look.
    pub look: Digest,
}

/// All runs of a scene, in the order of instances and triangles.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Runs {
    /// The runs.
    pub runs: Vec<Run>,
}

impl Run {
    /// About how many voxels of this edge (metres) the run fills: as many as it has surface, fewer where it has more
    /// surface than there is room for in its bounds, as foliage in large voxels.
    pub fn voxels(&self, edge: f64) -> f64 {
        let size = (self.bounds[1] - self.bounds[0]) / edge + DVec3::splat(2.0);
        let (surface, room) = (self.surface / (edge * edge), size.element_product());
        // What falls into random voxels of the room.
        let filled = room * -(-surface / room).exp_m1();
        if filled.is_finite() { filled } else { surface.min(room) }
    }
}

impl Runs {
    /// Cuts a scene into runs.
    pub fn new(scene: &Scene) -> Self {
        let mut drawn = vec![false; scene.meshes.len()];
        for instance in &scene.instances {
            drawn[instance.mesh as usize] = true;
        }
        let textures = TextureDigests::new(scene, &drawn);
        let digests: Vec<Vec<[Digest; 2]>> = scene
            .meshes
            .par_iter()
            .zip(&drawn)
            .map(|(mesh, drawn)| if *drawn { mesh_digests(scene, mesh, &textures) } else { Vec::new() })
            .collect();
        let covers = coverages(scene, &drawn);
        let runs = scene
            .instances
            .par_iter()
            .enumerate()
            .flat_map_iter(|(index, instance)| {
                let mesh = &scene.meshes[instance.mesh as usize];
                let transform = instance.world_from_object;
                let digests = &digests[instance.mesh as usize];
                let covers = covers[instance.mesh as usize];
                (0..).step_by(RUN_TRIANGLES).zip(mesh.triangles.chunks(RUN_TRIANGLES)).zip(digests).map(
                    move |((first, triangles), digests)| {
                        let [shape, look] = digests.map(|digest| {
                            let mut key = KeyEncoder::new("manyview.run");
                            key.digest(&digest);
                            transform.to_cols_array().iter().for_each(|c| _ = key.float(*c));
                            key.finish()
                        });
                        let mut bounds = [DVec3::INFINITY, DVec3::NEG_INFINITY];
                        let (mut surface, mut facing) = (0.0, DVec3::ZERO);
                        for triangle in triangles {
                            let p = triangle.map(|vertex| {
                                transform.transform_point3(mesh.positions[vertex as usize].as_dvec3())
                            });
                            bounds = p.iter().fold(bounds, |[lo, hi], p| [lo.min(*p), hi.max(*p)]);
                            let n = ((p[1] - p[0]).cross(p[2] - p[0]) * 0.5).abs();
                            // The axis that a plane faces most finds a voxel per pixel, the others new ones for up to
                            // half of theirs.
                            surface += n.max_element() + (n.element_sum() - n.max_element()) * 0.5;
                            facing += n;
                        }
                        let triangles = first..first + triangles.len() as u32;
                        let mesh = digests[0];
                        let (instance, facing) = (index as u32, (facing * covers).to_array());
                        let surface = surface * covers;
                        Run { instance, triangles, bounds, surface, facing, mesh, shape, look }
                    },
                )
            })
            .collect();
        Self { runs }
    }

    /// World bounds of all triangles, or `None` if there are none.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        let all = self.runs.iter().map(|run| run.bounds).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])?;
        Some((all[0], all[1]))
    }

    /// The identity of the shape of everything, whatever the order.
    pub fn shape(&self) -> Digest {
        let mut shapes: Vec<&Digest> = self.runs.iter().map(|run| &run.shape).collect();
        shapes.sort_unstable();
        let mut key = KeyEncoder::new("manyview.shape");
        key.sequence(shapes.len());
        shapes.iter().for_each(|shape| _ = key.digest(shape));
        key.finish()
    }
}

/// About which share of each mesh alpha leaves: that of its texture's texels.
fn coverages(scene: &Scene, drawn: &[bool]) -> Vec<f64> {
    let mut known = std::collections::BTreeMap::new();
    let of_mesh = |(mesh, drawn): (&Mesh, &bool)| {
        let material = material_of(scene, mesh);
        let (Some(cutoff), Some(texture), true) =
            (material.alpha_mode.cutoff(), material.base_color_texture, *drawn)
        else {
            return 1.0;
        };
        let threshold = cutoff / material.base_color.w.max(f32::MIN_POSITIVE);
        *known.entry((texture, threshold.to_bits())).or_insert_with(|| {
            let texels = &scene.textures[texture as usize].texels;
            // One in 16 is enough for a share.
            let some = || texels.iter().step_by(if texels.len() > 1 << 16 { 17 } else { 1 });
            let left = some().filter(|texel| f32::from(texel[3]) >= threshold * 255.0).count();
            left as f64 / some().count().max(1) as f64
        })
    };
    scene.meshes.iter().zip(drawn).map(of_mesh).collect()
}

/// Digests of the textures in use: of their alpha, and of all of them.
struct TextureDigests {
    alpha: Vec<Option<Digest>>,
    all: Vec<Option<Digest>>,
    /// Whether filtering weighs a texture's texels by their alpha, which follows from all meshes that show it.
    weighted: Vec<bool>,
    /// Whether anything emits light, which decides on a part of every node.
    emits: bool,
}

impl TextureDigests {
    fn new(scene: &Scene, drawn: &[bool]) -> Self {
        let count = scene.textures.len();
        let (mut cut, mut seen, mut weighted) = (vec![false; count], vec![false; count], vec![false; count]);
        let mut emits = false;
        for mesh in scene.meshes.iter().zip(drawn).filter_map(|(mesh, drawn)| drawn.then_some(mesh)) {
            let material = material_of(scene, mesh);
            if let Some(texture) = material.base_color_texture {
                let is_cut = material.alpha_mode.cutoff().is_some();
                seen[texture as usize] = true;
                cut[texture as usize] |= is_cut;
                weighted[texture as usize] |= is_cut;
            }
            if material.emissive.max_element() > 0.0 {
                emits = true;
                if let Some(texture) = material.emissive_texture {
                    seen[texture as usize] = true;
                }
            }
        }
        let digest_of = |wanted: &[bool], of: fn(&Texture) -> Digest| {
            let textures = scene.textures.par_iter().zip(wanted);
            textures.map(|(texture, wanted)| wanted.then(|| of(texture))).collect()
        };
        Self { alpha: digest_of(&cut, alpha_digest), all: digest_of(&seen, texture_digest), weighted, emits }
    }
}

fn texture_head(texture: &Texture) -> KeyEncoder {
    let mut key = KeyEncoder::new("manyview.texture");
    key.unsigned(texture.width.into()).unsigned(texture.height.into());
    for wrap in texture.wrap {
        key.unsigned(match wrap {
            Wrap::Repeat => 0,
            Wrap::MirroredRepeat => 1,
            Wrap::ClampToEdge => 2,
        });
    }
    key
}

fn alpha_digest(texture: &Texture) -> Digest {
    let mut alpha = DigestBuilder::new();
    let mut buffer = Vec::with_capacity(1 << 16);
    for texels in texture.texels.chunks(1 << 16) {
        buffer.clear();
        buffer.extend(texels.iter().map(|texel| texel[3]));
        alpha.update(&buffer);
    }
    texture_head(texture).text("alpha").digest(&alpha.finish()).finish()
}

fn texture_digest(texture: &Texture) -> Digest {
    texture_head(texture).digest(&Digest::of(bytemuck::cast_slice(&texture.texels))).finish()
}

/// Shape and look of each run of a mesh, wherever it is placed.
fn mesh_digests(scene: &Scene, mesh: &Mesh, textures: &TextureDigests) -> Vec<[Digest; 2]> {
    let material = material_of(scene, mesh);
    let texture_of = |index: Option<u32>, digests: &[Option<Digest>]| index.and_then(|t| digests[t as usize]);
    let mut shape_head = KeyEncoder::new("manyview.run.shape");
    let is_cut = material.alpha_mode.cutoff().is_some();
    match material.alpha_mode.cutoff() {
        None => _ = shape_head.none(),
        Some(cutoff) => {
            shape_head.float(cutoff.into()).float(material.base_color.w.into());
            match texture_of(material.base_color_texture, &textures.alpha) {
                Some(alpha) => shape_head.digest(&alpha),
                None => shape_head.none(),
            };
        }
    }
    let mut look_head = KeyEncoder::new("manyview.run.look");
    look_head.boolean(textures.emits);
    for factor in material.base_color.truncate().to_array().iter().chain(&material.emissive.to_array()) {
        look_head.float(f64::from(*factor));
    }
    let color = texture_of(material.base_color_texture, &textures.all);
    let glows = material.emissive.max_element() > 0.0;
    let emissive = texture_of(material.emissive_texture.filter(|_| glows), &textures.all);
    for digest in [color, emissive] {
        match digest {
            Some(digest) => look_head.digest(&digest),
            None => look_head.none(),
        };
    }
    look_head.boolean(material.base_color_texture.is_some_and(|t| textures.weighted[t as usize]));

    let mut buffer: Vec<u8> = Vec::new();
    let mut corners = |key: &mut KeyEncoder, triangles: &[[u32; 3]], values: &dyn Fn(usize, &mut Vec<u8>)| {
        buffer.clear();
        triangles.iter().flatten().for_each(|vertex| values(*vertex as usize, &mut buffer));
        key.bytes(&buffer);
    };
    mesh.triangles
        .chunks(RUN_TRIANGLES)
        .map(|triangles| {
            let mut shape = shape_head.clone();
            corners(&mut shape, triangles, &|v, out| {
                out.extend(bytemuck::bytes_of(&mesh.positions[v].to_array()));
            });
            if is_cut && !mesh.base_color_uvs.is_empty() {
                corners(&mut shape, triangles, &|v, out| {
                    out.extend(bytemuck::bytes_of(&mesh.base_color_uvs[v].to_array()));
                });
            }
            if is_cut && !mesh.colors.is_empty() {
                corners(&mut shape, triangles, &|v, out| out.extend(mesh.colors[v].w.to_le_bytes()));
            }
            let shape = shape.finish();
            let mut look = look_head.clone();
            look.digest(&shape);
            if !mesh.normals.is_empty() {
                look.text("normals");
                corners(&mut look, triangles, &|v, out| {
                    out.extend(bytemuck::bytes_of(&mesh.normals[v].to_array()));
                });
            }
            if color.is_some() && !mesh.base_color_uvs.is_empty() {
                look.text("uvs");
                corners(&mut look, triangles, &|v, out| {
                    out.extend(bytemuck::bytes_of(&mesh.base_color_uvs[v].to_array()));
                });
            }
            if emissive.is_some() && !mesh.emissive_uvs.is_empty() {
                look.text("emissive uvs");
                corners(&mut look, triangles, &|v, out| {
                    out.extend(bytemuck::bytes_of(&mesh.emissive_uvs[v].to_array()));
                });
            }
            if !mesh.colors.is_empty() {
                look.text("colors");
                corners(&mut look, triangles, &|v, out| {
                    out.extend(bytemuck::bytes_of(&mesh.colors[v].to_array()));
                });
            }
            [shape, look.finish()]
        })
        .collect()
}

/// The cells of a grid that runs reach into.
pub struct CellRuns {
    /// Cells in ascending order of their codes.
    pub cells: Vec<Cell>,
}

/// A cell, and who reaches into it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cell {
    /// Morton code of the cell.
    pub code: u32,
    /// Indices into [`Runs::runs`], ascending.
    pub runs: Vec<u32>,
}

/// Runs that reach into more cells than this are looked at triangle by triangle.
const COARSE_CELLS: i64 = 8;

impl CellRuns {
    /// Finds the cells of every run. `cell_of` takes a world position to its cell and must be monotone along each axis;
    /// `cells_of_triangle` visits the cells of a triangle with the given world corners, at least those that it matters
    /// for.
    pub fn new(
        scene: &Scene,
        runs: &Runs,
        cell_of: impl Fn(DVec3) -> [i64; 3] + Sync,
        cells_of_triangle: impl Fn([DVec3; 3], &mut dyn FnMut([i64; 3])) + Sync,
    ) -> Self {
        let code = |cell: [i64; 3]| crate::octree::morton(cell.map(|c| c as u32));
        let mut entries: Vec<(u32, u32)> = runs
            .runs
            .par_iter()
            .enumerate()
            .flat_map_iter(|(index, run)| {
                let (lo, hi) = (cell_of(run.bounds[0]), cell_of(run.bounds[1]));
                let mut codes = Vec::new();
                if (0..3).map(|i| hi[i] - lo[i] + 1).product::<i64>() <= COARSE_CELLS {
                    for z in lo[2]..=hi[2] {
                        for y in lo[1]..=hi[1] {
                            codes.extend((lo[0]..=hi[0]).map(|x| code([x, y, z])));
                        }
                    }
                } else {
                    let instance = &scene.instances[run.instance as usize];
                    let mesh = &scene.meshes[instance.mesh as usize];
                    for triangle in &mesh.triangles[run.triangles.start as usize..run.triangles.end as usize]
                    {
                        let corners = triangle.map(|v| {
                            let position = mesh.positions[v as usize].as_dvec3();
                            instance.world_from_object.transform_point3(position)
                        });
                        cells_of_triangle(corners, &mut |cell| codes.push(code(cell)));
                    }
                    codes.sort_unstable();
                    codes.dedup();
                }
                codes.into_iter().map(move |code| (code, index as u32))
            })
            .collect();
        entries.par_sort_unstable();
        let cells = entries
            .chunk_by(|a, b| a.0 == b.0)
            .map(|same| Cell { code: same[0].0, runs: same.iter().map(|(_, run)| *run).collect() })
            .collect();
        Self { cells }
    }
}

impl Cell {
    /// The identity of what reaches into the cell, of the digest of each run that `of` gives.
    pub fn digest(&self, runs: &Runs, of: impl Fn(&Run) -> Digest) -> Digest {
        let mut digests: Vec<Digest> = self.runs.iter().map(|run| of(&runs.runs[*run as usize])).collect();
        digests.sort_unstable();
        let mut key = KeyEncoder::new("manyview.cell");
        key.sequence(digests.len());
        digests.iter().for_each(|digest| _ = key.digest(digest));
        key.finish()
    }
}
