//! Points bound to triangles, and a hierarchy over them.
//!
//! # Theory
//! \[ML\] §3: a surface is sampled by n = 2^d points, each spot as likely, each bound to its triangle by barycentric
//! coordinates (s, t), so that it follows when the triangle moves. Over them stands a perfect binary tree, which needs no pointers:
//! node i has the children 2i and 2i + 1, the root is 1, leaf j is node n + j. A node is a sphere around its points and a
//! cone around their normals. All points are sorted once along each axis; a node's are split in halves along the axis where the
//! two halves' boxes have the smallest volume together. When triangles move, the tree stays and its spheres and cones
//! are computed anew, leaves first.

use glam::Vec3;
use manyview_shaders::cases::Random;
use rayon::prelude::*;

/// Nodes below which the rest is done by one thread.
const ALONE: usize = 4096;

/// Where a point is: on a triangle, at a + s (b − a) + t (c − a).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// The triangle.
    pub triangle: u32,
    /// See there.
    pub s: f32,
    /// See there.
    pub t: f32,
}

/// A sphere around points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    /// Metres.
    pub center: Vec3,
    /// Metres.
    pub radius: f32,
}

/// A cone around normals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalCone {
    /// Unit vector, or 0 for normals in all directions.
    pub axis: Vec3,
    /// Cosine of the half angle.
    pub cosine: f32,
}

/// The hierarchy.
#[derive(Debug, Clone, PartialEq)]
pub struct PointTree {
    samples: Vec<Sample>,
    /// By node; number 0 is unused.
    spheres: Vec<Sphere>,
    cones: Vec<NormalCone>,
    /// Area of a point's disc over that of its triangle, when it was made.
    disc_share: Vec<f32>,
}

impl PointTree {
    /// Samples triangles by 2^`depth` points of a seed's sequence. `None` if no triangle has an area, or `depth` exceeds 26.
    pub fn new(triangles: &[[Vec3; 3]], depth: u32, seed: u64) -> Option<Self> {
        let area = |t: &[Vec3; 3]| {
            let area = f64::from((t[1] - t[0]).cross(t[2] - t[0]).length()) * 0.5;
            if area.is_finite() { area } else { 0.0 }
        };
        let mut whole = 0.0;
        let areas: Vec<f64> = triangles
            .iter()
            .map(|t| {
                whole += area(t);
                whole
            })
            .collect();
        if whole <= 0.0 || depth > 26 {
            return None;
        }
        let count = 1usize << depth;
        let mut random = Random::new(seed);
        let mut unit = || f64::from(random.below(1 << 24)) / f64::from(1 << 24);
        // One point in each of equal pieces of the area: more even than points anywhere.
        let samples: Vec<Sample> = (0..count)
            .map(|i| {
                let at = (i as f64 + unit()) / count as f64 * whole;
                let triangle = areas.partition_point(|&a| a <= at).min(areas.len() - 1);
                let (mut s, mut t) = (unit(), unit());
                if s + t > 1.0 {
                    (s, t) = (1.0 - s, 1.0 - t);
                }
                Sample { triangle: triangle as u32, s: s as f32, t: t as f32 }
            })
            .collect();
        let positions: Vec<Vec3> = samples.iter().map(|s| position(s, triangles)).collect();
        let samples: Vec<Sample> = order(&positions).into_iter().map(|i| samples[i as usize]).collect();
        let disc = whole / count as f64;
        let disc_share =
            samples.iter().map(|s| (disc / area(&triangles[s.triangle as usize])) as f32).collect();
        let no_sphere = Sphere { center: Vec3::ZERO, radius: 0.0 };
        let no_cone = NormalCone { axis: Vec3::ZERO, cosine: -1.0 };
        let (spheres, cones) = (vec![no_sphere; 2 * count], vec![no_cone; 2 * count]);
        let mut tree = Self { samples, spheres, cones, disc_share };
        tree.update(triangles);
        Some(tree)
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.samples.len()
    }

    /// Never: a tree has a point at least.
    pub fn is_empty(&self) -> bool {
        self.samples.is_empty()
    }

    /// Points in the order of leaves.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// Spheres by node.
    pub fn spheres(&self) -> &[Sphere] {
        &self.spheres
    }

    /// Cones by node.
    pub fn cones(&self) -> &[NormalCone] {
        &self.cones
    }

    /// Bytes of the tree.
    pub fn bytes(&self) -> u64 {
        let node = size_of::<Sphere>() + size_of::<NormalCone>();
        (self.len() * (size_of::<Sample>() + 4) + self.spheres.len() * node) as u64
    }

    /// Follows triangles that have moved.
    ///
    /// # Panics
    /// If there are fewer triangles than before.
    pub fn update(&mut self, triangles: &[[Vec3; 3]]) {
        let count = self.len();
        let (samples, shares) = (&self.samples, &self.disc_share);
        let leaves = self.spheres[count..].par_iter_mut().zip(&mut self.cones[count..]);
        leaves.zip(samples.par_iter().zip(shares)).with_min_len(ALONE).for_each(
            |((sphere, cone), (sample, share))| {
                let [a, b, c] = triangles[sample.triangle as usize];
                let normal = (b - a).cross(c - a);
                let radius = (normal.length() * 0.5 * share * std::f32::consts::FRAC_1_PI).sqrt();
                *sphere = Sphere { center: position(sample, triangles), radius };
                *cone = NormalCone { axis: normal.normalize_or_zero(), cosine: 1.0 };
            },
        );
        let mut level = count / 2;
        while level >= 1 {
            let (spheres, below) = self.spheres.split_at_mut(2 * level);
            let (cones, cones_below) = self.cones.split_at_mut(2 * level);
            let pairs = below[..2 * level].par_chunks(2).zip(cones_below[..2 * level].par_chunks(2));
            let nodes = spheres[level..].par_iter_mut().zip(&mut cones[level..]);
            nodes.zip(pairs).with_min_len(ALONE).for_each(|((sphere, cone), (spheres, cones))| {
                *sphere = around(spheres[0], spheres[1]);
                *cone = cone_around(cones[0], cones[1]);
            });
            level /= 2;
        }
    }
}

fn position(sample: &Sample, triangles: &[[Vec3; 3]]) -> Vec3 {
    let [a, b, c] = triangles[sample.triangle as usize];
    a + (b - a) * sample.s + (c - a) * sample.t
}

/// The smallest sphere around two.
fn around(a: Sphere, b: Sphere) -> Sphere {
    let way = b.center - a.center;
    let distance = way.length();
    if distance + b.radius <= a.radius {
        return a;
    }
    if distance + a.radius <= b.radius {
        return b;
    }
    let radius = (a.radius + b.radius + distance) * 0.5;
    // Rounding must not leave a child outside.
    Sphere { center: a.center + way * ((radius - a.radius) / distance), radius: radius * (1.0 + 1e-6) }
}

/// A cone around two; all directions if it would be wider than a half space.
fn cone_around(a: NormalCone, b: NormalCone) -> NormalCone {
    let all = NormalCone { axis: Vec3::ZERO, cosine: -1.0 };
    if a.cosine < 0.0 || b.cosine < 0.0 {
        return all;
    }
    let axis = (a.axis + b.axis).normalize_or_zero();
    // The half angle is half of the axes' and the wider cone's.
    let half = |cone: NormalCone| {
        let cos_way = axis.dot(cone.axis).clamp(-1.0, 1.0);
        let sin_way = (1.0 - cos_way * cos_way).sqrt();
        let sine = (1.0 - cone.cosine * cone.cosine).max(0.0).sqrt();
        cos_way * cone.cosine - sin_way * sine
    };
    let cosine = half(a).min(half(b)) - 1e-6;
    if cosine > 0.0 && axis != Vec3::ZERO { NormalCone { axis, cosine } } else { all }
}

/// The order of points as leaves.
fn order(positions: &[Vec3]) -> Vec<u32> {
    let count = positions.len();
    let sorted = |axis: usize| {
        let mut order: Vec<u32> = (0..count as u32).collect();
        order.par_sort_by(|&a, &b| {
            positions[a as usize][axis].total_cmp(&positions[b as usize][axis]).then(a.cmp(&b))
        });
        order
    };
    let mut orders = [sorted(0), sorted(1), sorted(2)];
    let mut spare = vec![0u32; count];
    // Which half each point goes to; halves of different nodes are different points.
    let side: Vec<std::sync::atomic::AtomicBool> = (0..count).map(|_| false.into()).collect();
    let [x, y, z] = &mut orders;
    split(positions, [&mut x[..], &mut y[..], &mut z[..]], &mut spare, &side);
    let [x, ..] = orders;
    x
}

/// Puts points of a node in order: halves along one axis, then each half's.
fn split(
    positions: &[Vec3],
    orders: [&mut [u32]; 3],
    spare: &mut [u32],
    side: &[std::sync::atomic::AtomicBool],
) {
    use std::sync::atomic::Ordering::Relaxed;
    let count = spare.len();
    if count <= 1 {
        return;
    }
    let volume = |order: &[u32]| {
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for &i in order {
            low = low.min(positions[i as usize]);
            high = high.max(positions[i as usize]);
        }
        let size = high - low;
        // Flat halves have no volume: their areas and lengths tell them apart.
        (size.element_product(), size.x * size.y + size.y * size.z + size.z * size.x, size.element_sum())
    };
    let sums = [0, 1, 2].map(|axis: usize| {
        let (a, b) = orders[axis].split_at(count / 2);
        let (a, b) = (volume(a), volume(b));
        (a.0 + b.0, a.1 + b.1, a.2 + b.2)
    });
    let less = |a: &usize, b: &usize| {
        let (a, b) = (sums[*a], sums[*b]);
        a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.total_cmp(&b.2))
    };
    let best = (0..3).min_by(less).unwrap_or(0);
    for (place, &i) in orders[best].iter().enumerate() {
        side[i as usize].store(place >= count / 2, Relaxed);
    }
    let [x, y, z] = orders;
    for order in [&mut *x, &mut *y, &mut *z] {
        let (mut low, mut high) = (0, count / 2);
        for &i in order.iter() {
            let place = if side[i as usize].load(Relaxed) { &mut high } else { &mut low };
            spare[*place] = i;
            *place += 1;
        }
        order.copy_from_slice(spare);
    }
    let (ax, bx) = x.split_at_mut(count / 2);
    let (ay, by) = y.split_at_mut(count / 2);
    let (az, bz) = z.split_at_mut(count / 2);
    let (low, high) = spare.split_at_mut(count / 2);
    let mut a = || split(positions, [ax, ay, az], low, side);
    let mut b = || split(positions, [bx, by, bz], high, side);
    if count > ALONE {
        rayon::join(a, b);
    } else {
        a();
        b();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scattered(count: usize) -> Vec<[Vec3; 3]> {
        let mut random = Random::new(7);
        let mut point = || Vec3::from_array([0; 3].map(|_| random.range(-1000, 1000) as f32 / 100.0));
        (0..count).map(|_| [point(), point(), point()]).collect()
    }

    /// Whether all nodes hold their children, by spheres and by cones.
    fn check(tree: &PointTree) {
        for node in 1..tree.len() {
            let (sphere, cone) = (tree.spheres[node], tree.cones[node]);
            for child in [2 * node, 2 * node + 1] {
                let (inner, normals) = (tree.spheres[child], tree.cones[child]);
                let reach = (inner.center - sphere.center).length() + inner.radius;
                assert!(reach <= sphere.radius * 1.0001 + 1e-5, "{node}: {reach} {}", sphere.radius);
                if cone.cosine > 0.0 {
                    let way = cone.axis.dot(normals.axis).clamp(-1.0, 1.0).acos();
                    assert!(way + normals.cosine.min(1.0).acos() <= cone.cosine.acos() + 2e-3);
                }
            }
        }
    }

    #[test]
    fn nodes_hold_what_is_below_them_also_after_moves() {
        let mut triangles = scattered(50);
        let mut tree = PointTree::new(&triangles, 10, 3).unwrap();
        check(&tree);
        let before = tree.clone();
        for (i, triangle) in triangles.iter_mut().enumerate() {
            *triangle = triangle.map(|p| p * 1.5 + Vec3::X * i as f32);
        }
        tree.update(&triangles);
        check(&tree);
        assert!(tree.samples == before.samples && tree.spheres != before.spheres);
        triangles = scattered(50);
        tree.update(&triangles);
        assert_eq!(tree, before);
    }

    #[test]
    fn points_are_as_many_as_their_triangles_are_large() {
        // Areas of 1 and 3.
        let small = [Vec3::ZERO, Vec3::X, Vec3::Y * 2.0];
        let triangles = [small, small.map(|p| p * 3.0f32.sqrt() + Vec3::Z), [Vec3::ONE; 3]];
        let tree = PointTree::new(&triangles, 12, 1).unwrap();
        let on_small = tree.samples.iter().filter(|s| s.triangle == 0).count();
        assert!(on_small.abs_diff(1024) <= 1, "{on_small}");
        let discs: f32 =
            (0..4096).map(|i| tree.spheres[4096 + i].radius.powi(2) * std::f32::consts::PI).sum();
        assert!((discs - 4.0).abs() < 0.01, "{discs}");
        assert!(tree.samples.iter().all(|s| s.s >= 0.0 && s.t >= 0.0 && s.s + s.t <= 1.0));
        assert!(PointTree::new(&[[Vec3::ONE; 3]], 4, 1).is_none() && PointTree::new(&[], 4, 1).is_none());
    }

    #[test]
    fn halves_are_on_two_sides_of_a_plane() {
        let tree = PointTree::new(&scattered(40), 8, 5).unwrap();
        let centers: Vec<Vec3> = tree.spheres[256..].iter().map(|s| s.center).collect();
        for node in 1..256usize {
            let level = node.ilog2();
            let size = 256usize >> level;
            let (low, high) = centers[(node - (1 << level)) * size..][..size].split_at(size / 2);
            let apart = |axis: usize| {
                let most = low.iter().map(|p| p[axis]).fold(f32::NEG_INFINITY, f32::max);
                most <= high.iter().map(|p| p[axis]).fold(f32::INFINITY, f32::min)
            };
            assert!((0..3).any(apart), "{node}");
        }
    }
}
