//! `wgsl-bvh`: the tree of `bvh` traversed by our own shader ([`manyview_shaders::wide_bvh`]).

use super::bvh::{BUILD, Tree};
use crate::reference::Reference;
use crate::visibility::{MethodStages, StageVisibility};
use manyview_shaders::device::DeviceError;
use manyview_shaders::executor::Executor;
use manyview_shaders::masks::TriangleMask;
use manyview_shaders::stages;
use manyview_shaders::types::{PackedPlane, WideBvhParams, pack_planes};
use manyview_shaders::wide_bvh::{BVH_STACK, BvhTriangle, bvh_triangle, depth};
use obvhs::BvhBuildParams;

/// Rays of one dispatch.
const RAYS_PER_DISPATCH: u64 = 1 << 24;

/// A tree, packed for shaders.
#[derive(Debug, Clone)]
pub struct WideBvh {
    params: WideBvhParams,
    /// 80 bytes each.
    nodes: Vec<[u32; 20]>,
    /// 48 bytes each, in the tree's order.
    triangles: Vec<BvhTriangle>,
    masks: Vec<TriangleMask>,
    planes: Vec<PackedPlane>,
    alpha: Vec<u32>,
}

impl WideBvh {
    /// Builds a tree over the reference's triangles.
    pub fn new(reference: &Reference) -> Self {
        Self::with_build(reference, BUILD)
    }

    /// Builds a tree in another way.
    pub fn with_build(reference: &Reference, build: BvhBuildParams) -> Self {
        let tree = Tree::new(reference, build);
        let nodes: Vec<[u32; 20]> = bytemuck::cast_slice(&tree.bvh.nodes).to_vec();
        let triangles = tree.bvh.primitive_indices.iter().map(|&i| {
            let t = &tree.triangles[i as usize];
            bvh_triangle([t.v0, t.v1, t.v2].map(|v| v.to_array()), reference.mask_of(i))
        });
        let params = WideBvhParams {
            center: reference.center().as_vec3().to_array(),
            lift: tree.lift(),
            nodes: nodes.len() as u32,
            reserved_a: 0,
            reserved_b: 0,
            reserved_c: 0,
        };
        let cutouts = reference.cutouts();
        let (planes, alpha) = pack_planes(&cutouts.planes);
        Self { params, triangles: triangles.collect(), nodes, masks: cutouts.masks.clone(), planes, alpha }
    }

    /// Bytes of all arrays.
    pub fn bytes(&self) -> u64 {
        (size_of_val(&self.nodes[..])
            + size_of_val(&self.triangles[..])
            + size_of_val(&self.masks[..])
            + size_of_val(&self.planes[..])
            + size_of_val(&self.alpha[..])) as u64
    }

    /// The method on an executor: a GPU's, or the one that runs twins. Each array must fit a binding: 2.8 million
    /// triangles (less where large ones are split), 3.3 million cut ones, 134 million texels.
    pub fn on_executor<'a>(
        &self,
        executor: Box<dyn Executor + Send + 'a>,
    ) -> Result<StageVisibility<'a>, DeviceError> {
        let depth = depth(&self.nodes);
        if depth > BVH_STACK {
            return Err(DeviceError::Failed(format!(
                "the scene's BVH is {depth} nodes deep, shaders traverse {BVH_STACK}; use the method `bvh`"
            )));
        }
        let stages = MethodStages {
            name: "wgsl-bvh",
            hidden_lights: &stages::wide_bvh_hidden_lights,
            segments: &stages::wide_bvh_segments,
            rays_per_dispatch: RAYS_PER_DISPATCH,
        };
        StageVisibility::new(
            stages,
            executor,
            &[
                ("parameters of the BVH", bytemuck::bytes_of(&self.params)),
                ("the BVH's nodes", bytemuck::cast_slice(&self.nodes)),
                ("the BVH's triangles", bytemuck::cast_slice(&self.triangles)),
                ("the triangles' masks", bytemuck::cast_slice(&self.masks)),
                ("alpha planes", bytemuck::cast_slice(&self.planes)),
                ("alpha texels", bytemuck::cast_slice(&self.alpha)),
            ],
        )
    }
}
