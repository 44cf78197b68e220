//! What a bake will cost, told before it starts.

use crate::bake::BakeOptions;
use crate::cube::SceneCube;
use crate::scene::{Instance, Scene};
use manyview_cache::archive::MAX_CHUNK_BYTES;
use manyview_shaders::device::PackedFragment;
use manyview_shaders::raster::Grid;
use rayon::prelude::*;

/// Costs to expect, derived from the surface and the settings. What surfaces share a voxel is not known yet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Estimate {
    /// Triangles drawn.
    pub triangles: u64,
    /// Leaves of the octree: an upper bound for surfaces that are wide in voxels.
    pub leaves: u64,
    /// Peak memory.
    pub peak_bytes: u64,
    /// Rows before compression.
    pub rows_raw_bytes: u64,
}

/// Sums over the triangles of a scene.
#[derive(Clone, Copy, Default)]
struct Surface {
    /// Voxels that the triangles fill.
    voxels: f64,
    /// Longest extents of the triangles along an axis, in voxels.
    lengths: f64,
}

impl Surface {
    fn new(scene: &Scene, voxel_size: f64) -> Self {
        let of_instance = |instance: &Instance| {
            let mesh = &scene.meshes[instance.mesh as usize];
            let mut surface = Self::default();
            for triangle in &mesh.triangles {
                let p = triangle.map(|v| {
                    instance.world_from_object.transform_point3(mesh.positions[v as usize].as_dvec3())
                });
                let n = ((p[1] - p[0]).cross(p[2] - p[0]) * 0.5).abs();
                // The axis that a plane faces most finds a voxel per pixel, the others new ones for up to half of theirs.
                let voxels = n.max_element() + (n.element_sum() - n.max_element()) * 0.5;
                let extent = p[0].max(p[1]).max(p[2]) - p[0].min(p[1]).min(p[2]);
                surface.voxels += voxels / (voxel_size * voxel_size);
                surface.lengths += extent.max_element() / voxel_size;
            }
            surface
        };
        let sum = |a: Self, b: Self| Self { voxels: a.voxels + b.voxels, lengths: a.lengths + b.lengths };
        scene.instances.par_iter().map(of_instance).reduce(Self::default, sum)
    }
}

impl Estimate {
    /// Measures the scene's surface.
    pub fn new(scene: &Scene, options: &BakeOptions, cube: SceneCube) -> Self {
        let grid = Grid::new(options.levels);
        let surface = Surface::new(scene, cube.size / f64::from(grid.size()));
        // `as` saturates; halves of the largest number can still be added.
        let whole = |x: f64| if x.is_finite() { (x.ceil() as u64).min(1 << 56) } else { 1 << 56 };
        let leaves = whole(surface.voxels).min(1 << (3 * grid.bits));
        let triangles = scene.drawn_triangles();
        let scene_bytes: u64 = scene
            .meshes
            .iter()
            .map(|m| {
                (m.positions.len() * 12
                    + m.normals.len() * 12
                    + (m.base_color_uvs.len() + m.emissive_uvs.len()) * 8
                    + m.colors.len() * 16
                    + m.triangles.len() * 12) as u64
            })
            .sum::<u64>()
            // Texels, their alpha and their mip levels.
            + scene.textures.iter().map(|t| t.texels.len() as u64 * 9).sum::<u64>();
        let direction_bytes = |bits: u32| 1u64 << (3 * bits) >> 3;
        let rows_raw_bytes =
            options.rows.map_or(0, |r| u64::from(r.directions.count()) * direction_bytes(r.bits));
        // 26 bytes a snapped triangle. A triangle is in the bricks of 64³ along its length, 8 bytes each, twice while
        // they are sorted. 11 bytes a leaf and a third as much for inner nodes, twice while bricks are joined; the
        // fragments of a brick per thread are small.
        let brick_entries =
            triangles.saturating_add(whole(surface.lengths * 3.0 / 64.0 + surface.voxels / 1024.0));
        let octree_bytes = leaves * 15 * 2 + 64 * size_of::<PackedFragment>() as u64 * 4096;
        // Rows are made from points in cells of a quarter voxel: those of the bounds' faces or of the surface, 48 bytes
        // each while they are sorted.
        let rows_bytes = options.rows.map_or(0, |r| {
            let cells = 1u64 << (2 * (r.bits + 2));
            let of_surface = surface.voxels * cells as f64 / f64::from(grid.size()).powi(2);
            whole(of_surface).max(6 * cells).min(1 << (3 * (r.bits + 2))) * 48
        });
        // Every thread has a block of rows and its compressed form, and waits for some blocks before its own.
        let threads = rayon::current_num_threads() as u64;
        let blocks_bytes = rows_raw_bytes.min(threads * 6 * MAX_CHUNK_BYTES as u64);
        let peak_bytes = scene_bytes
            + triangles * (26 + 24)
            + brick_entries * 16
            + octree_bytes.max(rows_bytes + leaves * 15)
            + blocks_bytes
            + (32 << 20);
        Self { triangles, leaves, peak_bytes, rows_raw_bytes }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Mesh;
    use glam::{DMat4, Vec3};

    /// A square of 32 × 32 voxels across the cube.
    fn square(corners: [[f32; 3]; 4]) -> Estimate {
        let mesh = Mesh {
            positions: corners.map(Vec3::from_array).to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        let scene = Scene {
            meshes: vec![mesh],
            instances: vec![Instance { mesh: 0, world_from_object: DMat4::IDENTITY }],
            ..Scene::default()
        };
        let options = BakeOptions { levels: 5, rows: None, ..BakeOptions::default() };
        Estimate::new(&scene, &options, SceneCube { origin: [0.0; 3], size: 32.0 })
    }

    #[test]
    fn a_plane_has_as_many_leaves_as_it_shows_to_the_axis_it_faces() {
        let flat = square([[0.0, 5.0, 0.0], [32.0, 5.0, 0.0], [32.0, 5.0, 32.0], [0.0, 5.0, 32.0]]);
        assert_eq!((flat.triangles, flat.leaves, flat.rows_raw_bytes), (2, 1024, 0));
        // At 45 degrees half of the other axis' samples may fall into new voxels.
        let slanted = square([[0.0, 0.0, 0.0], [32.0, 32.0, 0.0], [32.0, 32.0, 32.0], [0.0, 0.0, 32.0]]);
        assert_eq!(slanted.leaves, 1536);
    }

    #[test]
    fn there_are_no_more_leaves_than_cells_and_sums_do_not_overflow() {
        let huge = square([[-1e30, 0.0, 0.0], [1e30, 0.0, 0.0], [1e30, 1.0, 1e30], [-1e30, 1.0, 1e30]]);
        assert_eq!(huge.leaves, 1 << 15);
        assert!(huge.peak_bytes > 1 << 60);
    }
}
