//! Puts the scene together, node after node.

use super::ImportOptions;
use super::animation::Pose;
use super::deform::Skin;
use super::error::ImportError;
use super::json::Json;
use super::materials::Materials;
use super::nodes::Graph;
use super::resources::Resources;
use super::{geometry, instancing, lights};
use crate::scene::{Instance, Scene};
use glam::DMat4;
use std::collections::BTreeMap;

/// Which deformation of a glTF mesh a scene mesh is: the mesh's index, and the bits of its morph weights.
type Variant = (usize, Vec<u32>);

/// Memory of a primitive beside its attributes. Counting it for primitives that draw nothing, too, bounds the time that
/// many nodes with one mesh of many primitives can take.
const PRIMITIVE_BYTES: u64 = 512;

/// Reads everything that the document's scene draws.
pub(super) fn assemble(resources: &Resources<'_>, options: &ImportOptions) -> Result<Scene, ImportError> {
    let pose = match options.time_seconds {
        Some(time) => Pose::sample(resources, options.animation, time)?,
        None => Pose::default(),
    };
    let graph = Graph::build(resources, &pose)?;
    let mut assembler = Assembler {
        resources,
        options,
        pose: &pose,
        graph: &graph,
        materials: Materials::default(),
        known: BTreeMap::new(),
        target_counts: BTreeMap::new(),
        scene: Scene::default(),
        drawn_triangles: 0,
    };
    for node in &graph.shown {
        assembler.add_node(*node)?;
    }
    let Assembler { materials, mut scene, .. } = assembler;
    (scene.materials, scene.textures) = materials.finish(resources)?;
    Ok(scene)
}

struct Assembler<'r, 'a> {
    resources: &'r Resources<'a>,
    options: &'r ImportOptions,
    pose: &'r Pose,
    graph: &'r Graph,
    materials: Materials,
    /// Scene meshes of the variants met so far.
    known: BTreeMap<Variant, Vec<u32>>,
    /// Morph targets of the glTF meshes met so far.
    target_counts: BTreeMap<usize, usize>,
    scene: Scene,
    drawn_triangles: u64,
}

impl Assembler<'_, '_> {
    fn add_node(&mut self, index: usize) -> Result<(), ImportError> {
        let node = self.resources.root.item("nodes", index)?;
        let world_from_node = self.graph.world_from_node[index];
        self.scene.lights.extend(lights::load(self.resources, &node, world_from_node)?);
        let Some(mesh_index) = node.reference("mesh", &self.resources.root, "meshes")? else { return Ok(()) };
        let mesh = self.resources.root.item("meshes", mesh_index)?;
        let weights = self.weights(index, &node, mesh_index, &mesh)?;
        if let Some(skin) = node.reference("skin", &self.resources.root, "skins")? {
            // Joints place a skinned mesh; the node's own transform counts for nothing.
            let skin = Skin::load(self.resources, self.graph, skin)?;
            let meshes = self.load(&mesh, &weights, Some(&skin))?;
            return self.place(&node, &meshes, &[DMat4::IDENTITY]);
        }
        let variant = (mesh_index, weights.iter().map(|weight| weight.to_bits()).collect());
        let meshes = match self.known.get(&variant) {
            Some(meshes) => meshes.clone(),
            None => {
                let meshes = self.load(&mesh, &weights, None)?;
                self.known.insert(variant, meshes.clone());
                meshes
            }
        };
        if meshes.is_empty() {
            return Ok(());
        }
        let mut placements = instancing::placements(self.resources, &node)?;
        for placement in &mut placements {
            *placement = world_from_node * *placement;
            if !placement.is_finite() {
                return Err(node.malformed("an instance's transform leads to infinite numbers"));
            }
        }
        self.place(&node, &meshes, &placements)
    }

    /// Morph weights of a node: the animation's, or its own, or the mesh's, or none.
    fn weights(
        &mut self,
        index: usize,
        node: &Json<'_>,
        mesh_index: usize,
        mesh: &Json<'_>,
    ) -> Result<Vec<f32>, ImportError> {
        let targets = match self.target_counts.get(&mesh_index) {
            Some(targets) => *targets,
            None => {
                let mut targets = 0;
                for primitive in mesh.items("primitives")? {
                    targets = targets.max(primitive.len("targets")?);
                }
                self.target_counts.insert(mesh_index, targets);
                targets
            }
        };
        if targets == 0 {
            return Ok(Vec::new());
        }
        let mut weights = match self.pose.node(index).and_then(|pose| pose.weights.clone()) {
            Some(weights) => weights,
            None => {
                let weights = match node.number_list("weights")? {
                    Some(weights) => Some(weights),
                    None => mesh.number_list("weights")?,
                };
                weights.unwrap_or_default().into_iter().map(|weight| weight as f32).collect()
            }
        };
        self.resources.charge(targets as u64 * 4, &node.place())?;
        weights.resize(targets, 0.0);
        Ok(weights)
    }

    /// Loads all primitives of a mesh and tells where they are in the scene.
    fn load(
        &mut self,
        mesh: &Json<'_>,
        weights: &[f32],
        skin: Option<&Skin>,
    ) -> Result<Vec<u32>, ImportError> {
        let mut meshes = Vec::new();
        let primitives = mesh.items("primitives")?;
        self.resources.charge(primitives.len() as u64 * PRIMITIVE_BYTES, &mesh.place())?;
        for primitive in primitives {
            let material = self
                .materials
                .get(self.resources, primitive.reference("material", &self.resources.root, "materials")?)?;
            let Some(mut loaded) =
                geometry::load(self.resources, &primitive, material, weights, skin.is_some())?
            else {
                continue;
            };
            let name = mesh.name();
            loaded.mesh.name = if name.is_empty() { primitive.place() } else { name };
            if let Some(skin) = skin {
                skin.apply(self.resources, &mut loaded.mesh, &loaded.influences)?;
            }
            meshes.push(self.scene.meshes.len() as u32);
            self.scene.meshes.push(loaded.mesh);
        }
        Ok(meshes)
    }

    fn place(&mut self, node: &Json<'_>, meshes: &[u32], placements: &[DMat4]) -> Result<(), ImportError> {
        let triangles: u64 =
            meshes.iter().map(|mesh| self.scene.meshes[*mesh as usize].triangles.len() as u64).sum();
        self.drawn_triangles =
            self.drawn_triangles.saturating_add(triangles.saturating_mul(placements.len() as u64));
        if self.drawn_triangles > self.options.max_triangles {
            return Err(ImportError::OverLimit {
                file: node.file().to_owned(),
                place: node.place(),
                what: "triangles drawn, instances counted,",
                value: self.drawn_triangles,
                limit: self.options.max_triangles,
                fix: "raise the limit, or make the scene smaller",
            });
        }
        let instances = (placements.len() * meshes.len()) as u64;
        self.resources.charge(instances * size_of::<Instance>() as u64, &node.place())?;
        for world_from_object in placements {
            let instance = |mesh: &u32| Instance { mesh: *mesh, world_from_object: *world_from_object };
            self.scene.instances.extend(meshes.iter().map(instance));
        }
        Ok(())
    }
}
