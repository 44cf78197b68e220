//! The node hierarchy: a forest, checked to be one, with a world transform for every node.

use super::animation::Pose;
use super::error::ImportError;
use super::json::Json;
use super::resources::Resources;
use glam::{DMat4, DQuat, DVec3};

/// All nodes of a file, whether drawn or not: joints of skins may lie outside of the scene.
pub(super) struct Graph {
    /// World transforms by node.
    pub(super) world_from_node: Vec<DMat4>,
    /// Nodes that the scene shows, parents before children, in the order of the file.
    pub(super) shown: Vec<usize>,
}

impl Graph {
    /// Reads all nodes in the given pose.
    pub(super) fn build(resources: &Resources<'_>, pose: &Pose) -> Result<Self, ImportError> {
        let root = &resources.root;
        let nodes = root.items("nodes")?;
        resources.charge(nodes.len() as u64 * 512, "nodes")?;
        let children: Vec<Vec<usize>> =
            nodes.iter().map(|node| node.references("children", root, "nodes")).collect::<Result<_, _>>()?;
        let mut parents = vec![None; nodes.len()];
        for (parent, children) in children.iter().enumerate() {
            for child in children {
                let node = root.item("nodes", *child)?;
                if let Some(other) = parents[*child].replace(parent) {
                    return Err(node.malformed(format!(
                        "is a child of nodes[{other}] and of nodes[{parent}]; a node has one parent"
                    )));
                }
            }
        }
        let mut world_from_node = vec![None; nodes.len()];
        let mut pending: Vec<usize> =
            (0..nodes.len()).rev().filter(|node| parents[*node].is_none()).collect();
        while let Some(index) = pending.pop() {
            let node = &nodes[index];
            let mut world = local_transform(resources, node, pose, index)?;
            if let Some(parent) = parents[index].and_then(|parent| world_from_node[parent]) {
                world = parent * world;
            }
            if !world.is_finite() {
                return Err(node.malformed("its transform leads to infinite numbers"));
            }
            world_from_node[index] = Some(world);
            pending.extend(children[index].iter().rev());
        }
        let world_from_node = world_from_node
            .into_iter()
            .zip(&nodes)
            .map(|(world, node)| {
                world.ok_or_else(|| node.malformed("is its own ancestor; nodes must not form cycles"))
            })
            .collect::<Result<_, _>>()?;
        let shown = shown(resources, &nodes, &children, &parents)?;
        Ok(Self { world_from_node, shown })
    }
}

/// Nodes of the default scene, or else of the first one, or else all, without hidden ones.
fn shown(
    resources: &Resources<'_>,
    nodes: &[Json<'_>],
    children: &[Vec<usize>],
    parents: &[Option<usize>],
) -> Result<Vec<usize>, ImportError> {
    let root = &resources.root;
    let roots = if root.len("scenes")? == 0 {
        (0..nodes.len()).filter(|node| parents[*node].is_none()).collect()
    } else {
        let scene = root.item("scenes", root.reference("scene", root, "scenes")?.unwrap_or(0))?;
        let roots = scene.references("nodes", root, "nodes")?;
        for node in &roots {
            if let Some(parent) = parents[*node] {
                let place = scene.place_of("nodes");
                resources.warn(format!(
                    "{place}: nodes[{node}] is no root but a child of nodes[{parent}]; it is drawn there"
                ));
            }
        }
        roots
    };
    let mut seen = vec![false; nodes.len()];
    let mut order = Vec::new();
    let mut pending: Vec<usize> = roots.into_iter().rev().collect();
    while let Some(index) = pending.pop() {
        let visibility = nodes[index].extension("KHR_node_visibility");
        let hidden = visibility.and_then(|visibility| visibility.boolean("visible")) == Some(false);
        if !hidden && !std::mem::replace(&mut seen[index], true) {
            order.push(index);
            pending.extend(children[index].iter().rev());
        }
    }
    Ok(order)
}

fn local_transform(
    resources: &Resources<'_>,
    node: &Json<'_>,
    pose: &Pose,
    index: usize,
) -> Result<DMat4, ImportError> {
    let animated = pose.node(index);
    if let Some(matrix) = node.numbers::<16>("matrix")? {
        if animated.is_some_and(|node| node.moves()) {
            resources.warn(format!("{}: has a matrix, so its animation is ignored", node.place()));
        }
        return Ok(DMat4::from_cols_array(&matrix));
    }
    let translation = match animated.and_then(|node| node.translation) {
        Some(translation) => translation,
        None => node.numbers("translation")?.unwrap_or([0.0; 3]),
    };
    let rotation = match animated.and_then(|node| node.rotation) {
        Some(rotation) => rotation,
        None => node.numbers("rotation")?.unwrap_or([0.0, 0.0, 0.0, 1.0]),
    };
    let scale = match animated.and_then(|node| node.scale) {
        Some(scale) => scale,
        None => node.numbers("scale")?.unwrap_or([1.0; 3]),
    };
    Ok(transform(translation, rotation, scale))
}

/// Scale first, then rotation by a quaternion of any length, then translation.
pub(super) fn transform(translation: [f64; 3], rotation: [f64; 4], scale: [f64; 3]) -> DMat4 {
    let rotation = DQuat::from_array(unit(rotation));
    DMat4::from_scale_rotation_translation(DVec3::from_array(scale), rotation, DVec3::from_array(translation))
}

/// The quaternion at length 1; no rotation if it has no direction.
pub(super) fn unit(q: [f64; 4]) -> [f64; 4] {
    let length = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt();
    if length > 0.0 && length.is_finite() { q.map(|value| value / length) } else { [0.0, 0.0, 0.0, 1.0] }
}
