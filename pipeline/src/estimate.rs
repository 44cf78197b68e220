//! What a bake will cost, told before it starts.

use crate::bake::BakeOptions;
use crate::cube::SceneCube;
use crate::scene::Scene;
use manyview_shaders::device::PackedFragment;
use manyview_shaders::raster::Grid;
use rayon::prelude::*;

/// Costs to expect. Derived from the surface area and the settings; what surfaces share a voxel is not known yet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Estimate {
    /// Triangles drawn.
    pub triangles: u64,
    /// Leaves of the octree, if no two surfaces share a voxel.
    pub leaves: u64,
    /// Peak memory.
    pub peak_bytes: u64,
    /// Rows before compression.
    pub rows_raw_bytes: u64,
}

impl Estimate {
    /// Measures the scene's surface.
    pub fn new(scene: &Scene, options: &BakeOptions, cube: SceneCube) -> Self {
        let voxel_size = cube.size / f64::from(Grid::new(options.levels).size());
        // A plane with normal n has |nx| + |ny| + |nz| fragments per voxel area along the three axes. Those of the
        // largest component alone are in voxels of their own; of the others, about a tenth is (measured on the
        // scanned bunny, whose normals point everywhere).
        let leaves: f64 = scene
            .instances
            .par_iter()
            .map(|instance| {
                let mesh = &scene.meshes[instance.mesh as usize];
                mesh.triangles
                    .iter()
                    .map(|triangle| {
                        let p = triangle.map(|v| {
                            instance.world_from_object.transform_point3(mesh.positions[v as usize].as_dvec3())
                        });
                        let n = (p[1] - p[0]).cross(p[2] - p[0]) * 0.5;
                        let n = n.abs();
                        (n.max_element() + (n.element_sum() - n.max_element()) / 10.0)
                            / (voxel_size * voxel_size)
                    })
                    .sum::<f64>()
            })
            .sum();
        let leaves = if leaves.is_finite() { (leaves as u64).min(u64::MAX / 1024) } else { u64::MAX / 1024 };
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
        // 26 bytes a snapped triangle and about 2 bricks of 8 bytes each, sorted out of place; 11 bytes a leaf and a
        // third as much for inner nodes, twice while bricks are joined; fragments of a brick per thread are small.
        let octree_bytes = leaves * 15 * 2 + 64 * size_of::<PackedFragment>() as u64 * 4096;
        let rows_bytes = options.rows.map_or(0, |r| (1u64 << (2 * (r.bits + 2))) * 6 * 40);
        let peak_bytes =
            scene_bytes + triangles * (26 + 40) + octree_bytes.max(rows_bytes + leaves * 15) + (64 << 20);
        Self { triangles, leaves, peak_bytes, rows_raw_bytes }
    }
}
