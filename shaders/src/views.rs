//! Views, nodes of the view hierarchy, and the two tests of a pair of a scene node and a view node.
//!
//! # Theory
//! \[MV\] §3.3: a pair of a scene node s and a view node v is dropped if s is outside the field of every view of v
//! ([`is_culled`]), drawn if s fills at most one texel of the map of each of them ([`is_small`]), and else subdivided.
//! The same tests with a view alone, whose node has radius 0, are those of \[ML\].
//!
//! # Differences from the paper
//! Angles appear as cosines and sines of the view node alone, so that a test is a square root, products and comparisons: no
//! trigonometry, and no operation that a GPU may round in another way than the CPU. Spheres around view nodes are those
//! of the views they hold, not of their cells.
//!
//! \[MV\] Kol et al., *MegaViews*, CGF 2018, doi 10.1111/cgf.13527. \[ML\] Holländer et al., *ManyLoDs*, CGF 30(4), 2011.

use crate::mega_views::CONE_SLACK;
use bytemuck::{Pod, Zeroable};
use std::f32::consts::PI;

/// A view, 32 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct View {
    /// Metres.
    pub position: [f32; 3],
    /// Half of its field of view, radians; π or more sees all around.
    pub half_angle: f32,
    /// The middle of its field of view; of any length but 0.
    pub axis: [f32; 3],
    /// Zero.
    pub reserved: u32,
}

impl View {
    /// A view from `position` along `axis`.
    pub fn new(position: [f32; 3], axis: [f32; 3], half_angle: f32) -> Self {
        Self { position, half_angle, axis, reserved: 0 }
    }

    /// A view that sees all around.
    pub fn around(position: [f32; 3]) -> Self {
        Self::new(position, [1.0, 0.0, 0.0], PI)
    }

    /// Whether it can be drawn: its position is finite and squares of distances to it are, too. An axis or angle that is
    /// no number makes it see all around; others get empty maps.
    pub fn is_drawable(&self) -> bool {
        self.position.iter().all(|c| c.abs() < 1e18)
    }

    /// Unit axis, cosine and sine of the half angle; −1 and 0 for a view that sees all around.
    pub fn cone(&self) -> Cone {
        let length = dot(self.axis, self.axis).sqrt();
        if !(self.half_angle < PI && length.is_finite() && length > 0.0) {
            return ([1.0, 0.0, 0.0], ALL_AROUND);
        }
        let (sine, cosine) = crate::trig::sin_cos(f64::from(self.half_angle.max(0.0)));
        (self.axis.map(|c| c / length), [cosine as f32, sine as f32])
    }
}

/// Cosine and sine of a cone that holds all directions.
pub const ALL_AROUND: [f32; 2] = [-1.0, 0.0];

/// A node of the view hierarchy, 48 bytes: the sphere around its views, and a cone around all their fields of view.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct ViewNode {
    /// Middle of the sphere, and of the node's map: metres.
    pub center: [f32; 3],
    /// Radius of the sphere, 0 for views at one position.
    pub radius: f32,
    /// Unit axis of the cone.
    pub axis: [f32; 3],
    /// Cosine of the cone's half angle ψ; −1 where all directions are seen.
    pub cos_psi: f32,
    /// Sine of the cone's half angle.
    pub sin_psi: f32,
    /// Inner node: index of its first child. Leaf: index of its first view, in the hierarchy's order.
    pub first: u32,
    /// Number of children or views; bit 31 is set in leaves.
    pub count: u32,
    /// Zero.
    pub reserved: u32,
}

impl ViewNode {
    /// Set in [`ViewNode::count`] of leaves.
    pub const LEAF: u32 = 1 << 31;

    /// A leaf of one view, number `first`.
    pub fn of_view(view: &View, first: u32) -> Self {
        let (axis, [cos_psi, sin_psi]) = view.cone();
        let center = view.position;
        Self { center, radius: 0.0, axis, cos_psi, sin_psi, first, count: Self::LEAF | 1, reserved: 0 }
    }

    /// Whether it has views instead of children.
    #[inline]
    pub fn is_leaf(&self) -> bool {
        self.count & Self::LEAF != 0
    }

    /// Number of children or views.
    #[inline]
    pub fn len(&self) -> u32 {
        self.count & !Self::LEAF
    }

    /// Whether there is nothing in it.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Indices of its children or views.
    #[inline]
    pub fn range(&self) -> std::ops::Range<usize> {
        self.first as usize..(self.first + self.len()) as usize
    }
}

/// Whether a sphere at `offset` from the middle of a view node, of `radius` metres, is outside the field of every view in
/// the node. `length` is the offset's. \[MV\] §3.3, "Cull".
#[inline]
pub fn is_culled(offset: [f32; 3], length: f32, radius: f32, view: &ViewNode) -> bool {
    if view.cos_psi <= -1.0 {
        return false;
    }
    let along = dot(offset, view.axis);
    let across = (length * length - along * along).max(0.0).sqrt();
    // The sine and cosine of the angle between the offset and the cone, times the length.
    let outside = across * view.cos_psi - along * view.sin_psi;
    let facing = along * view.cos_psi + across * view.sin_psi;
    // More than a right angle away the cone's apex is its nearest point.
    let distance = if facing < 0.0 { length } else { outside };
    outside > 0.0 && distance > radius + view.radius
}

/// Whether a sphere fills less than a texel for every view within `view_radius` of the middle: its diameter there, seen
/// from the nearest of them, times `scale`, which is the resolution over the texels that it may fill. \[MV\] §3.3, "Equivalent
/// view"; a texel's angle follows from [`crate::paraboloid`].
#[inline]
pub fn is_small(offset: [f32; 3], length: f32, radius: f32, view_radius: f32, scale: f32) -> bool {
    radius * scale * length < (length - view_radius) * (length + offset[0].abs())
}

/// Unit axis, cosine and sine of a cone.
pub type Cone = ([f32; 3], [f32; 2]);

/// A cone around cones: its axis is the mean of theirs. The rule of every form of the view hierarchy.
pub fn merged_cone(cones: impl Iterator<Item = Cone> + Clone) -> Cone {
    let all = ([1.0, 0.0, 0.0], ALL_AROUND);
    let mut sum = [0.0f32; 3];
    let mut count = 0;
    for (axis, [cosine, _]) in cones.clone() {
        if cosine <= -1.0 {
            return all;
        }
        sum = [0, 1, 2].map(|i| sum[i] + axis[i]);
        count += 1;
    }
    if count == 1 {
        return cones.clone().next().unwrap_or(all);
    }
    let length = dot(sum, sum).sqrt();
    if length.is_nan() || length <= CONE_SLACK {
        return all;
    }
    let axis = sum.map(|c| c / length);
    let mut widest = 1.0f32;
    for (other, [cos_psi, sin_psi]) in cones {
        let cos_alpha = dot(axis, other).clamp(-1.0, 1.0);
        let sin_alpha = (1.0 - cos_alpha * cos_alpha).sqrt();
        if sin_alpha * cos_psi + cos_alpha * sin_psi <= 0.0 {
            return all;
        }
        widest = widest.min(cos_alpha * cos_psi - sin_alpha * sin_psi);
    }
    let cosine = (widest - CONE_SLACK).max(-1.0);
    (axis, [cosine, (1.0 - cosine * cosine).max(0.0).sqrt()])
}

/// Of a view node's sphere this share must fill less than a texel where something is drawn once for all its views: it then
/// moves by at most a texel between the node's middle and any of them. \[MV\] keeps the sphere no larger than the scene
/// node's, which 1 would come to. Half of it draws a million views in 0.7 of the time, and nothing is less exact by the
/// measure of `views::agreement`.
pub const PARALLAX: f32 = 0.5;

/// What a pair comes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PairStep {
    /// Outside all fields of view.
    Drop,
    /// A point in v's map.
    Point,
    /// Two leaves: s is drawn as what it is.
    Near,
    /// On with the children of s.
    SplitScene,
    /// On with the children of v.
    SplitViews,
}

/// What a pair comes to whose scene node is a sphere of `radius` at `offset` from the view node's middle. \[MV\] §3.3; the
/// larger of the two is subdivided, spheres compared as they are drawn.
#[inline]
pub fn pair_step(
    offset: [f32; 3],
    radius: f32,
    scene_is_leaf: bool,
    view: &ViewNode,
    scale: f32,
    culling: bool,
) -> PairStep {
    let length = dot(offset, offset).sqrt();
    if culling && is_culled(offset, length, radius, view) {
        return PairStep::Drop;
    }
    if is_small(offset, length, radius.max(PARALLAX * view.radius), view.radius, scale) {
        return PairStep::Point;
    }
    if splits_views(radius, scene_is_leaf, view) {
        PairStep::SplitViews
    } else if scene_is_leaf {
        PairStep::Near
    } else {
        PairStep::SplitScene
    }
}

/// Whether a pair that is not drawn goes on with the children of its view node.
#[inline(always)]
pub fn splits_views(radius: f32, scene_is_leaf: bool, view: &ViewNode) -> bool {
    !view.is_leaf() && (scene_is_leaf || PARALLAX * view.radius > radius)
}

#[inline]
pub(crate) fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cases::Random;

    fn unit(random: &mut Random) -> [f32; 3] {
        loop {
            let v = [0; 3].map(|_| random.range(-1000, 1000) as f32 / 1000.0);
            let length = dot(v, v).sqrt();
            if length > 0.1 && length < 1.0 {
                return v.map(|c| c / length);
            }
        }
    }

    /// \[MV\]'s formula in angles.
    fn culled_by_angles(offset: [f32; 3], radius: f32, axis: [f32; 3], psi: f64) -> bool {
        let length = f64::from(dot(offset, offset)).sqrt();
        let alpha = (f64::from(dot(offset, axis)) / length).clamp(-1.0, 1.0).acos();
        let (sine, _) = crate::trig::sin_cos((alpha - psi).max(0.0));
        let distance = if alpha - psi > std::f64::consts::FRAC_PI_2 { length } else { sine * length };
        alpha > psi && distance > f64::from(radius)
    }

    #[test]
    fn culling_is_the_papers_without_angles() {
        let mut random = Random::new(5);
        let mut both = [0; 2];
        for _ in 0..20_000 {
            let axis = unit(&mut random);
            let psi = random.below(3142) as f32 / 1000.0;
            let view = ViewNode::of_view(&View::new([0.0; 3], axis, psi), 0);
            let distance = random.below(4000) as f32 / 100.0 + 0.01;
            let offset = unit(&mut random).map(|c| c * distance);
            let radius = random.below(2000) as f32 / 100.0;
            let found = is_culled(offset, dot(offset, offset).sqrt(), radius, &view);
            let near = |r: f32| culled_by_angles(offset, r, axis, f64::from(psi));
            both[usize::from(found)] += 1;
            // Rounding may decide otherwise within a ten thousandth.
            let slack = 1e-4 * (distance + radius);
            assert!(
                found == near(radius) || near(radius + slack) != near(radius - slack),
                "{offset:?} {psi}"
            );
        }
        assert!(both[0] > 4000 && both[1] > 4000, "{both:?}");
    }

    #[test]
    fn nothing_seen_is_culled() {
        let mut random = Random::new(6);
        for _ in 0..20_000 {
            let axis = unit(&mut random);
            let psi = random.below(3142) as f32 / 1000.0;
            let position = unit(&mut random);
            let node = ViewNode { radius: 1.01, ..ViewNode::of_view(&View::new([0.0; 3], axis, psi), 0) };
            // A direction inside the cone, seen from a view in the node.
            let ray = unit(&mut random);
            if f64::from(dot(ray, axis)).acos() > f64::from(psi) {
                continue;
            }
            let distance = random.below(4000) as f32 / 100.0;
            let point = [0, 1, 2].map(|i| position[i] + ray[i] * distance);
            assert!(!is_culled(point, dot(point, point).sqrt(), 1e-3, &node));
        }
    }

    #[test]
    fn small_is_less_than_a_texel() {
        for x in [1.0, 0.0, -1.0, 0.5] {
            let y = (1.0f32 - x * x).sqrt();
            // Radians of a texel there: 4 / R in the middle, 2 / R at the rim.
            let texel = 2.0 * (1.0 + x.abs()) / 16.0;
            let offset = [10.0 * x, 10.0 * y, 0.0];
            assert!(is_small(offset, 10.0, 0.49 * texel * 10.0, 0.0, 16.0));
            assert!(!is_small(offset, 10.0, 0.51 * texel * 10.0, 0.0, 16.0));
            assert!(is_small(offset, 10.0, 0.49 * texel * 7.0, 3.0, 16.0));
            assert!(!is_small(offset, 10.0, 0.51 * texel * 7.0, 3.0, 16.0));
        }
        assert!(
            !is_small([0.1, 0.0, 0.0], 0.1, 1e-6, 0.2, 16.0),
            "inside the views' sphere nothing is small"
        );
    }

    #[test]
    fn odd_views_see_all_around_or_nothing() {
        let (_, cone) = View::new([0.0; 3], [0.0; 3], 1.0).cone();
        assert_eq!(cone, ALL_AROUND);
        assert_eq!(View::new([0.0; 3], [1.0, 0.0, 0.0], f32::NAN).cone().1, ALL_AROUND);
        assert_eq!(View::new([0.0; 3], [f32::INFINITY, 0.0, 0.0], 1.0).cone().1, ALL_AROUND);
        assert!(!View::around([f32::NAN, 0.0, 0.0]).is_drawable());
        assert!(!View::around([0.0, f32::INFINITY, 0.0]).is_drawable());
    }
}
