//! Skins: vertices bent by joints, baked into world space.

use super::accessor::Accessor;
use super::error::ImportError;
use super::geometry::{repair_normals, unit_or_zero};
use super::nodes::Graph;
use super::resources::Resources;
use crate::scene::Mesh;
use glam::{DMat3, DMat4};

/// Joints and weights of vertices, all of the first set, then all of the second one, and so on.
#[derive(Debug, Default)]
pub(super) struct Influences {
    sets: Vec<Vec<([u32; 4], [f32; 4])>>,
}

impl Influences {
    /// Adds a set of four joints and weights a vertex.
    pub(super) fn push_set(&mut self, joints: &[f32], weights: &[f32]) {
        let joints = joints.as_chunks::<4>().0.iter().map(|joints| joints.map(|joint| joint as u32));
        self.sets.push(joints.zip(weights.as_chunks::<4>().0.iter().copied()).collect());
    }

    fn of(&self, vertex: usize) -> impl Iterator<Item = (u32, f64)> {
        let sets = self.sets.iter().map(move |set| set[vertex]);
        sets.flat_map(|(joints, weights)| joints.into_iter().zip(weights.map(f64::from)))
            .filter(|(_, weight)| *weight > 0.0 && weight.is_finite())
    }
}

/// Matrices that take a mesh from its bind pose into the world, one a joint.
pub(super) struct Skin {
    world_from_bind: Vec<DMat4>,
    place: String,
}

impl Skin {
    /// Skin `index` of the document, in the pose of `graph`.
    pub(super) fn load(resources: &Resources<'_>, graph: &Graph, index: usize) -> Result<Self, ImportError> {
        let skin = resources.root.item("skins", index)?;
        let joints = skin.references("joints", &resources.root, "nodes")?;
        if joints.is_empty() {
            return Err(skin.malformed_at("joints", "must name at least one node"));
        }
        resources.charge(joints.len() as u64 * size_of::<DMat4>() as u64, &skin.place())?;
        let mut world_from_bind = Vec::with_capacity(joints.len());
        for joint in &joints {
            world_from_bind.push(graph.world_from_node[*joint]);
        }
        if let Some(inverse) = skin.reference("inverseBindMatrices", &resources.root, "accessors")? {
            let accessor = Accessor::parse(resources, inverse)?;
            if accessor.width != 16 || accessor.count < joints.len() {
                return Err(accessor
                    .malformed(format!("must hold a 4 x 4 matrix for each of {} joints", joints.len())));
            }
            let matrices = accessor.read(resources, None, &skin.place())?;
            for (joint, (world, matrix)) in
                world_from_bind.iter_mut().zip(matrices.as_chunks::<16>().0).enumerate()
            {
                let matrix = DMat4::from_cols_array(&matrix.map(f64::from));
                if !matrix.is_finite() {
                    return Err(accessor.malformed(format!("element {joint} is not finite")));
                }
                *world *= matrix;
            }
        }
        Ok(Self { world_from_bind, place: skin.place() })
    }

    /// Bends `mesh` into world space. A vertex without weights follows the first joint.
    pub(super) fn apply(
        &self,
        resources: &Resources<'_>,
        mesh: &mut Mesh,
        influences: &Influences,
    ) -> Result<(), ImportError> {
        let malformed = |rule: String| ImportError::Malformed {
            file: resources.root.file().to_owned(),
            place: format!("{} with mesh \"{}\"", self.place, mesh.name),
            rule,
        };
        for vertex in 0..mesh.positions.len() {
            let total: f64 = influences.of(vertex).map(|(_, weight)| weight).sum();
            let mut world_from_bind = if total > 0.0 { DMat4::ZERO } else { self.world_from_bind[0] };
            for (joint, weight) in influences.of(vertex) {
                let Some(matrix) = self.world_from_bind.get(joint as usize) else {
                    let joints = self.world_from_bind.len();
                    return Err(malformed(format!(
                        "vertex {vertex} follows joint {joint}, but there are {joints} joints"
                    )));
                };
                world_from_bind += *matrix * (weight / total);
            }
            let position = world_from_bind.transform_point3(mesh.positions[vertex].as_dvec3()).as_vec3();
            if !position.is_finite() {
                return Err(malformed(format!("vertex {vertex} ends at a position that is not finite")));
            }
            mesh.positions[vertex] = position;
            if let Some(normal) = mesh.normals.get_mut(vertex) {
                // Cofactors are the inverse transpose up to a factor, and exist for singular matrices, too.
                let m = DMat3::from_mat4(world_from_bind);
                let cofactors = DMat3::from_cols(
                    m.y_axis.cross(m.z_axis),
                    m.z_axis.cross(m.x_axis),
                    m.x_axis.cross(m.y_axis),
                );
                let bent = cofactors * normal.as_dvec3();
                let side = if m.determinant() < 0.0 { -1.0 } else { 1.0 };
                let length = bent.length();
                *normal = if length > 0.0 {
                    unit_or_zero((bent / length * side).as_vec3())
                } else {
                    glam::Vec3::ZERO
                };
            }
        }
        let mut normals = std::mem::take(&mut mesh.normals);
        repair_normals(&mut normals, mesh);
        mesh.normals = normals;
        Ok(())
    }
}
