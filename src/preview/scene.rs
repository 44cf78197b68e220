//! What rays find: an octree with its attributes.

use glam::DVec3;
use manyview_shaders::svo::Svo;
use manyview_shaders::{octahedral, rgb9e5};

use super::octree::{Hit, Octree, Ray};
use super::picture;

/// From this value on, a packed normal cone is wider than a half space: its axis tells nothing of one surface.
const WIDE_CONE: u8 = 181;

/// An octree with its attributes, ready for rays.
pub struct Scene {
    octree: Octree,
    svo: Svo,
}

impl Scene {
    /// Takes a validated octree.
    pub fn new(mut svo: Svo) -> Self {
        let octree = Octree::new(&svo);
        // The traversal has them in another form.
        for level in &mut svo.levels {
            level.child_masks = Vec::new();
            level.coverages = Vec::new();
        }
        Self { octree, svo }
    }

    /// The geometry.
    pub fn octree(&self) -> &Octree {
        &self.octree
    }

    /// The linear base colour of a hit node.
    pub fn base_color(&self, hit: &Hit) -> [f32; 3] {
        picture::linear(self.svo.levels[hit.level as usize].colors[hit.node as usize])
    }

    /// The normal of a hit node if its surfaces face about one way, as stored: it may face away from the ray.
    pub fn stored_normal(&self, hit: &Hit) -> Option<DVec3> {
        let level = &self.svo.levels[hit.level as usize];
        let node = hit.node as usize;
        (level.cones[node] < WIDE_CONE).then(|| DVec3::from(octahedral::decode(level.normals[node])))
    }

    /// The normal to shade a hit by, facing the ray: the stored one, or where there is none the entered face's.
    pub fn shading_normal(&self, ray: &Ray, hit: &Hit) -> DVec3 {
        let back = -DVec3::from(ray.direction).normalize_or_zero();
        let Some(normal) = self.stored_normal(hit) else { return face_normal(ray, hit) };
        if normal.dot(back) < 0.0 { -normal } else { normal }
    }

    /// The emitted radiance of a hit node.
    pub fn emitted(&self, hit: &Hit) -> [f32; 3] {
        let emissive = &self.svo.levels[hit.level as usize].emissive;
        emissive.get(hit.node as usize).map_or([0.0; 3], |&packed| rgb9e5::decode(packed).map(|c| c as f32))
    }
}

/// Outward normal of the face through which a ray enters a cell; against the ray if it begins inside.
pub fn face_normal(ray: &Ray, hit: &Hit) -> DVec3 {
    match hit.face {
        Some((axis, sign)) => DVec3::AXES[axis] * sign,
        None => -DVec3::from(ray.direction).normalize_or_zero(),
    }
}
