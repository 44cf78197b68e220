//! Exact ray traversal of a sparse voxel octree.
//!
//! # Theory
//! Depth-first, front to back, with the parametric distances of cell planes (Revelles et al. 2000, *An efficient
//! parametric algorithm for octree traversal*). The ray is mirrored so that it never runs backwards; then a cell is
//! left through the nearest of its three far planes, and the next sibling or the next ancestor's sibling follows.
//!
//! # Exactness
//! A plane's distance is computed from its integer coordinate alone, so that two cells which share a plane agree on
//! it: no ray slips between cells, and none is advanced by a step that could be too long. Cells are half open along an
//! axis the ray is parallel to (a ray in a cell's smallest face meets it, one in its largest face does not), and a ray
//! which meets a cell in a single point only passes it by.

use manyview_shaders::svo::Svo;

/// A ray segment in world space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Metres.
    pub origin: [f64; 3],
    /// Of any length: distances along the ray are in units of it.
    pub direction: [f64; 3],
    /// Where the segment begins.
    pub t_min: f64,
    /// Where the segment ends; infinity for a ray.
    pub t_max: f64,
    /// Width of the ray's footprint in metres per distance: a cell no wider than it is met as if it were a leaf.
    /// 0 for a thin ray.
    pub spread: f64,
}

impl Ray {
    /// A ray without end.
    pub fn new(origin: [f64; 3], direction: [f64; 3]) -> Self {
        Self { origin, direction, t_min: 0.0, t_max: f64::INFINITY, spread: 0.0 }
    }

    /// The point at distance `t`.
    pub fn at(&self, t: f64) -> [f64; 3] {
        [0, 1, 2].map(|i| self.origin[i] + t * self.direction[i])
    }
}

/// Where a ray meets a node.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Distance along the ray, in units of its direction: where it enters the cell, or `t_min` if that lies inside.
    pub t: f64,
    /// Level of the node.
    pub level: u32,
    /// Index of the node in its level.
    pub node: u32,
    /// The axis and sign of the outward normal of the face through which the ray enters; `None` if it begins inside.
    pub face: Option<(usize, f64)>,
}

/// One inner node, all that traversal needs of it.
#[derive(Debug, Clone, Copy)]
struct InnerNode {
    first_child: u32,
    child_mask: u32,
}

/// The geometry of an octree, ready for rays.
#[derive(Debug, Clone)]
pub struct Octree {
    origin: [f64; 3],
    /// Edge of a cell at the deepest level, metres.
    voxel: f64,
    depth: u32,
    inner: Vec<Vec<InnerNode>>,
}

impl Octree {
    /// Takes the geometry of a validated octree.
    pub fn new(svo: &Svo) -> Self {
        let depth = svo.depth();
        let inner = svo.levels[..depth as usize].iter().map(|level| {
            let mut first_child = 0;
            let nodes = level.child_masks.iter().map(|&mask| {
                let node = InnerNode { first_child, child_mask: u32::from(mask) };
                first_child += mask.count_ones();
                node
            });
            nodes.collect()
        });
        Self { origin: svo.origin, voxel: svo.size / f64::from(1u32 << depth), depth, inner: inner.collect() }
    }

    /// Number of the deepest level.
    pub fn depth(&self) -> u32 {
        self.depth
    }

    /// Edge of a cell at the deepest level, metres.
    pub fn voxel(&self) -> f64 {
        self.voxel
    }

    /// Smallest corner of the scene cube, metres.
    pub fn origin(&self) -> [f64; 3] {
        self.origin
    }

    /// Whether the cell that holds a point is there.
    pub fn contains(&self, point: [f64; 3]) -> bool {
        self.node_at(point, self.depth).is_some()
    }

    /// The node at `level` whose cell holds a point. Cells contain their smallest faces.
    pub fn node_at(&self, point: [f64; 3], level: u32) -> Option<u32> {
        let side = f64::from(1u32 << self.depth);
        let cell = [0, 1, 2].map(|i| (point[i] - self.origin[i]) / self.voxel);
        if !cell.iter().all(|c| (0.0..side).contains(c)) {
            return None;
        }
        let cell = cell.map(|c| c as u32);
        let mut node = 0;
        for (l, nodes) in self.inner.iter().enumerate().take(level as usize) {
            let shift = self.depth - 1 - l as u32;
            let child = (0..3).map(|i| (cell[i] >> shift & 1) << i).sum::<u32>();
            node = nodes[node as usize].child(child)?;
        }
        Some(node)
    }

    /// Smallest corners of the cells at `level` that are there, metres, in Morton order.
    pub fn corners(&self, level: u32) -> Vec<[f64; 3]> {
        let level = level.min(self.depth);
        let mut cells = vec![[0u32; 3]];
        for nodes in &self.inner[..level as usize] {
            let children = cells.iter().zip(nodes).flat_map(|(cell, node)| {
                let octants = (0..8u32).filter(|octant| node.child_mask >> octant & 1 == 1);
                octants.map(|octant| [0, 1, 2].map(|i| cell[i] * 2 + (octant >> i & 1)))
            });
            cells = children.collect();
        }
        let edge = self.cell_size(level);
        cells.into_iter().map(|cell| [0, 1, 2].map(|i| self.origin[i] + f64::from(cell[i]) * edge)).collect()
    }

    /// Edge of a cell at `level`, metres.
    pub fn cell_size(&self, level: u32) -> f64 {
        self.voxel * f64::from(1u32 << (self.depth - level))
    }

    /// The closest node at `level` (or the deepest level, if there are fewer) that a ray meets. A ray with a
    /// coordinate that is not finite meets nothing.
    pub fn intersect(&self, ray: &Ray, level: u32) -> Option<Hit> {
        let level = level.min(self.depth);
        let mut walk = Walk::start(self, ray)?;
        // Voxels of footprint per distance.
        let spread = ray.spread / self.voxel;
        if level == 0 || f64::from(1u32 << self.depth) <= spread * walk.t {
            return Some(walk.hit(ray, 0, 0));
        }
        // The path from the root to the current node: indices, and the octants that lead down.
        let mut nodes = [0u32; 32];
        let mut octants = [0u32; 32];
        let mut l = 0usize;
        let mut half = 1u32 << (self.depth - 1);
        let mut inner = self.inner[0][0];
        let mut octant = walk.octant(half);
        loop {
            let exits = [0, 1, 2].map(|i| walk.plane(i, walk.corner[i] + (half << (octant >> i & 1))));
            let axis = if exits[0] <= exits[1] {
                if exits[0] <= exits[2] { 0 } else { 2 }
            } else if exits[1] <= exits[2] {
                1
            } else {
                2
            };
            if walk.t < exits[axis]
                && let Some(child) = inner.child(octant ^ walk.mirror)
            {
                if l as u32 + 1 == level || f64::from(half) <= spread * walk.t {
                    return Some(walk.hit(ray, l as u32 + 1, child));
                }
                octants[l] = octant;
                l += 1;
                nodes[l] = child;
                inner = self.inner[l][child as usize];
                for i in 0..3 {
                    walk.corner[i] += half * (octant >> i & 1);
                }
                half >>= 1;
                octant = walk.octant(half);
                continue;
            }
            if exits[axis] > walk.t {
                walk.t = exits[axis];
                walk.axis = axis as u8;
            }
            if walk.t >= walk.t_end {
                return None;
            }
            // On to the next octant along the axis; if the node has none there, to its parent's.
            while octant >> axis & 1 == 1 {
                if l == 0 {
                    return None;
                }
                l -= 1;
                octant = octants[l];
                half <<= 1;
                for i in 0..3 {
                    walk.corner[i] &= !(half * 2 - 1);
                }
            }
            octant |= 1 << axis;
            inner = self.inner[l][nodes[l] as usize];
        }
    }

    /// Where a ray leaves the deepest cell that holds its origin, exactly as traversal sees that cell's planes; `None` if
    /// the origin is outside the scene cube or not finite.
    pub fn leaves_cell_at(&self, ray: &Ray) -> Option<f64> {
        let side = f64::from(1u32 << self.depth);
        let cell = [0, 1, 2].map(|i| (ray.origin[i] - self.origin[i]) / self.voxel);
        if !cell.iter().all(|c| (0.0..side).contains(c)) {
            return None;
        }
        let walk = Walk::start(self, &Ray { t_min: 0.0, t_max: f64::INFINITY, ..*ray })?;
        let last = (1u32 << self.depth) - 1;
        let exits = [0, 1, 2].map(|i| {
            let coordinate = cell[i] as u32;
            let mirrored = if walk.mirror >> i & 1 == 1 { last - coordinate } else { coordinate };
            walk.plane(i, mirrored + 1)
        });
        Some(exits.into_iter().fold(f64::INFINITY, f64::min))
    }

    /// Whether a ray meets any node at the deepest level.
    pub fn is_occluded(&self, ray: &Ray) -> bool {
        self.intersect(ray, self.depth).is_some()
    }
}

impl InnerNode {
    #[inline]
    fn child(self, octant: u32) -> Option<u32> {
        let below = self.child_mask & ((1 << octant) - 1);
        (self.child_mask >> octant & 1 == 1).then(|| self.first_child + below.count_ones())
    }
}

/// A ray in voxels of the deepest level, mirrored so that no component of its direction is negative.
struct Walk {
    origin: [f64; 3],
    /// Reciprocals of the direction's components.
    inverse: [f64; 3],
    /// Bit i is set where axis i is mirrored.
    mirror: u32,
    /// Smallest corner of the current node, voxels.
    corner: [u32; 3],
    t: f64,
    t_end: f64,
    /// The axis of the plane at `t`; 3 at the start of the segment.
    axis: u8,
}

impl Walk {
    /// `None` if the ray misses the cube.
    #[inline]
    fn start(octree: &Octree, ray: &Ray) -> Option<Self> {
        let side = f64::from(1u32 << octree.depth);
        let mut walk = Walk {
            origin: [0, 1, 2].map(|i| (ray.origin[i] - octree.origin[i]) / octree.voxel),
            inverse: ray.direction.map(|d| octree.voxel / d.abs()),
            mirror: 0,
            corner: [0; 3],
            t: ray.t_min,
            t_end: ray.t_max,
            axis: 3,
        };
        if !(walk.origin.iter().chain(&ray.direction).all(|c| c.is_finite()) && ray.t_min.is_finite()) {
            return None;
        }
        for i in 0..3 {
            if walk.inverse[i].is_infinite() {
                // Parallel to the planes: the cell's middle serves as well, and no distance becomes 0 · ∞.
                walk.origin[i] = walk.origin[i].floor() + 0.5;
            } else if ray.direction[i] < 0.0 {
                walk.mirror |= 1 << i;
                walk.origin[i] = side - walk.origin[i];
            }
        }
        for i in 0..3 {
            let enter = walk.plane(i, 0);
            if enter > walk.t {
                walk.t = enter;
                walk.axis = i as u8;
            }
            walk.t_end = walk.t_end.min(walk.plane(i, 1 << octree.depth));
        }
        (walk.t < walk.t_end).then_some(walk)
    }

    /// Distance to the plane at an integer coordinate. Never decreases as the coordinate grows.
    #[inline]
    fn plane(&self, axis: usize, coordinate: u32) -> f64 {
        (f64::from(coordinate) - self.origin[axis]) * self.inverse[axis]
    }

    /// The octant of the current node that the ray is in, or about to enter, at `t`.
    #[inline]
    fn octant(&self, half: u32) -> u32 {
        (0..3).map(|i| u32::from(self.plane(i, self.corner[i] + half) <= self.t) << i).sum()
    }

    fn hit(&self, ray: &Ray, level: u32, node: u32) -> Hit {
        let axis = usize::from(self.axis);
        // Through a face it runs against, the ray enters.
        let face = (axis < 3).then(|| (axis, -ray.direction[axis].signum()));
        Hit { t: self.t, level, node, face }
    }
}
