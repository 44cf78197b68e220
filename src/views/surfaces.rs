//! What exact rays of views are cast at: a bake's leaves, or the scene's triangles.

use crate::preview::{Octree, Ray};
use manyview_shaders::svo::Svo;

#[cfg(feature = "bake")]
use crate::reference::Reference;
#[cfg(feature = "bake")]
use glam::DVec3;

/// What a ray of a view meets first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Metres from the view.
    pub distance: f64,
    /// sRGB colour with an empty fourth byte, where surfaces have colours.
    pub color: [u8; 4],
}

/// Surfaces that rays from views meet.
pub trait Surfaces: Sync {
    /// Name of the method that casts rays at them.
    fn name(&self) -> &'static str;

    /// Whether [`Seen::color`] is known.
    fn has_colors(&self) -> bool;

    /// What a view at `origin`, metres, sees along the unit vector `direction`.
    fn cast(&self, origin: [f64; 3], direction: [f64; 3]) -> Option<Seen>;
}

/// The leaves of an octree, each a cube, by an exact traversal in `f64`.
///
/// A view inside a leaf does not see that leaf: views of virtual lights lie on surfaces, and would see nothing but their own
/// voxel. Rays start where they leave it; distances are from the view all the same.
#[derive(Debug, Clone)]
pub struct OctreeSurfaces {
    octree: Octree,
    colors: Vec<[u8; 3]>,
}

impl OctreeSurfaces {
    /// Takes the leaves of a validated octree.
    pub fn new(svo: &Svo, with_colors: bool) -> Self {
        let leaves = svo.levels.last().filter(|_| with_colors);
        Self { octree: Octree::new(svo), colors: leaves.map_or(Vec::new(), |level| level.colors.clone()) }
    }

    /// Edge of a leaf, metres.
    pub fn voxel(&self) -> f64 {
        self.octree.voxel()
    }

    /// Distance, metres, and number in Morton order of the leaf that a view sees.
    pub(crate) fn leaf(&self, origin: [f64; 3], direction: [f64; 3]) -> Option<(f64, u32)> {
        let mut ray = Ray::new(origin, direction);
        if self.octree.contains(origin) {
            ray.t_min = self.octree.leaves_cell_at(&ray)?;
        }
        let hit = self.octree.intersect(&ray, self.octree.depth())?;
        Some((hit.t, hit.node))
    }
}

impl Surfaces for OctreeSurfaces {
    fn name(&self) -> &'static str {
        "raycast"
    }

    fn has_colors(&self) -> bool {
        !self.colors.is_empty()
    }

    fn cast(&self, origin: [f64; 3], direction: [f64; 3]) -> Option<Seen> {
        let (distance, leaf) = self.leaf(origin, direction)?;
        let [r, g, b] = self.colors.get(leaf as usize).copied().unwrap_or_default();
        Some(Seen { distance, color: [r, g, b, 0] })
    }
}

/// The scene's triangles, cut-outs included, by exact rays in `f64`.
///
/// A view on a surface does not see that surface at distance 0: rays start about as far from the view as `f32` rounds
/// coordinates.
#[cfg(feature = "bake")]
pub struct TriangleSurfaces<'a> {
    reference: &'a Reference<'a>,
    /// Corners of a box around the triangles, with room to spare.
    around: [DVec3; 2],
    start_metres: f64,
}

#[cfg(feature = "bake")]
impl<'a> TriangleSurfaces<'a> {
    /// Borrows the ray tracer.
    pub fn new(reference: &'a Reference<'a>) -> Self {
        let triangles = reference.triangles();
        let first = triangles.first().map_or(DVec3::ZERO, |t| t[0]);
        let (min, max) =
            triangles.iter().flatten().fold((first, first), |(min, max), &p| (min.min(p), max.max(p)));
        let diagonal = (max - min).length();
        let start_metres = crate::exact::lift_metres(min, max);
        Self { reference, around: [min - diagonal * 0.01, max + diagonal * 0.01], start_metres }
    }
}

#[cfg(feature = "bake")]
impl Surfaces for TriangleSurfaces<'_> {
    fn name(&self) -> &'static str {
        "raycast-triangles"
    }

    fn has_colors(&self) -> bool {
        false
    }

    fn cast(&self, origin: [f64; 3], direction: [f64; 3]) -> Option<Seen> {
        let (origin, direction) = (DVec3::from_array(origin), DVec3::from_array(direction));
        // Views far outside come to the scene's bounds first: the tree's `f32` cannot tell far places apart.
        let (mut enter, mut leave) = (self.start_metres, f64::INFINITY);
        for axis in 0..3 {
            let to = |corner: DVec3| (corner[axis] - origin[axis]) / direction[axis];
            let (a, b) = (to(self.around[0]), to(self.around[1]));
            // Not a number where the ray runs within a face: then the other axes decide.
            (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
        }
        if enter > leave {
            return None;
        }
        let hit = self.reference.intersect(origin + direction * enter, direction, f64::INFINITY)?;
        Some(Seen { distance: enter + hit.t, color: [0; 4] })
    }
}
