//! Rays among many mirrors that are spheres.

use super::Reflected;
use crate::views::View;
use glam::Vec3;

/// A mirror all around.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    /// Metres.
    pub center: Vec3,
    /// Metres, more than 0.
    pub radius: f32,
}

impl Sphere {
    /// The view that its map is drawn for.
    pub fn view(&self) -> View {
        View::around(self.center.to_array())
    }

    /// How far a ray from outside along the unit vector `direction` goes until it meets the sphere, metres.
    pub fn meet(&self, origin: Vec3, direction: Vec3) -> Option<f32> {
        let to_center = self.center - origin;
        let along = to_center.dot(direction);
        // The nearest point to the center, which is more exact than a difference of squares.
        let off = to_center - direction * along;
        let half2 = self.radius * self.radius - off.length_squared();
        (along > 0.0 && half2 >= 0.0).then(|| (along - half2.sqrt()).max(0.0))
    }
}

/// Mirrors that see their surroundings and each other.
#[derive(Debug, Clone, PartialEq)]
pub struct Mirrors {
    /// None within another.
    pub spheres: Vec<Sphere>,
    /// Share of light that they send back, linear.
    pub tint: Vec3,
    /// After so many mirrors the next one is passed through.
    pub bounces: u32,
}

impl Mirrors {
    /// The linear colour that a ray from outside all mirrors shows.
    ///
    /// `see` says what of the surroundings a ray meets from a point along a unit vector; it starts at the surface of the
    /// mirror of this number, or if there is none at the eye.
    pub fn trace(
        &self,
        origin: Vec3,
        direction: Vec3,
        see: impl Fn(Option<usize>, Vec3, Vec3) -> Option<Reflected>,
    ) -> Vec3 {
        let (mut origin, mut direction, mut from) = (origin, direction, None);
        let mut share = Vec3::ONE;
        for bounce in 0..=self.bounces {
            let seen = see(from, origin, direction);
            let distance = seen.map_or(f32::INFINITY, |seen| seen.distance);
            let next = self.first(origin, direction, from).filter(|&(t, _)| t < distance);
            let Some((t, mirror)) = next.filter(|_| bounce < self.bounces) else {
                return share * seen.map_or(Vec3::ZERO, |seen| seen.color);
            };
            let sphere = self.spheres[mirror];
            let point = origin + direction * t;
            let normal = (point - sphere.center).normalize_or(-direction);
            // On the sphere, whatever the rounding.
            origin = sphere.center + normal * sphere.radius;
            direction = (direction - normal * (2.0 * direction.dot(normal))).normalize_or(normal);
            from = Some(mirror);
            share *= self.tint;
        }
        Vec3::ZERO
    }

    /// The first mirror that a ray meets, but not the one it starts on, and how far away it is.
    pub fn first(&self, origin: Vec3, direction: Vec3, from: Option<usize>) -> Option<(f32, usize)> {
        let meet = |(mirror, sphere): (usize, &Sphere)| {
            sphere.meet(origin, direction).filter(|_| Some(mirror) != from).map(|t| (t, mirror))
        };
        self.spheres.iter().enumerate().filter_map(meet).min_by(|a, b| a.0.total_cmp(&b.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit(x: f32, y: f32, z: f32) -> Vec3 {
        Vec3::new(x, y, z).normalize_or_zero()
    }

    #[test]
    fn rays_meet_spheres_where_they_should() {
        let sphere = Sphere { center: Vec3::new(5.0, 0.0, 0.0), radius: 2.0 };
        assert_eq!(sphere.meet(Vec3::ZERO, Vec3::X), Some(3.0));
        assert_eq!(sphere.meet(Vec3::ZERO, Vec3::NEG_X), None);
        assert_eq!(sphere.meet(Vec3::Y * 2.01, Vec3::X), None);
        assert!((sphere.meet(Vec3::Y * 2.0, Vec3::X).unwrap() - 5.0).abs() < 1e-3, "it touches");
        let far = Sphere { center: Vec3::X * 1e5, radius: 1.0 };
        assert!((far.meet(Vec3::ZERO, Vec3::X).unwrap() - (1e5 - 1.0)).abs() < 0.01);
    }

    /// Colours are directions, so that where a ray leaves to can be read off.
    fn sky(_: Option<usize>, _: Vec3, direction: Vec3) -> Option<Reflected> {
        Some(Reflected { color: direction, distance: f32::INFINITY })
    }

    #[test]
    fn light_leaves_by_the_law_of_reflection_as_often_as_there_are_mirrors() {
        let tint = Vec3::splat(0.5);
        let at = |x: f32, y: f32| Sphere { center: Vec3::new(x, y, 0.0), radius: 1.0 };
        let one = Mirrors { spheres: vec![at(5.0, 0.0)], tint, bounces: 3 };
        assert_eq!(one.trace(Vec3::ZERO, Vec3::X, sky), Vec3::NEG_X * 0.5);
        assert_eq!(one.trace(Vec3::ZERO, Vec3::Y, sky), Vec3::Y, "past it");
        // Met at 45 degrees a ray turns by a right angle, up to the next mirror, and back the way it came.
        let offset = 0.5f32.sqrt();
        let two = Mirrors { spheres: vec![at(5.0, -offset), at(5.0 - offset, 8.0)], tint, bounces: 4 };
        let found = two.trace(Vec3::ZERO, Vec3::X, sky);
        assert!((found - Vec3::NEG_X * 0.125).length() < 1e-4, "{found}");
        let few = Mirrors { bounces: 1, ..two.clone() };
        assert!((few.trace(Vec3::ZERO, Vec3::X, sky) - Vec3::Y * 0.5).length() < 1e-5, "through the second");
        // What is nearer than a mirror hides it.
        let wall = |_: Option<usize>, _: Vec3, _: Vec3| Some(Reflected { color: Vec3::ONE, distance: 2.0 });
        assert_eq!(two.trace(Vec3::ZERO, Vec3::X, wall), Vec3::ONE);
        assert_eq!(one.trace(Vec3::ZERO, Vec3::X, |_, _, _| None), Vec3::ZERO);
    }

    #[test]
    fn a_mirror_does_not_see_itself() {
        let mirrors = Mirrors {
            spheres: vec![Sphere { center: Vec3::ZERO, radius: 1.0 }],
            tint: Vec3::ONE,
            bounces: 8,
        };
        for direction in [unit(-1.0, 0.02, 0.01), unit(-5.0, 0.5, 0.5), unit(-5.0, -0.99, 0.1)] {
            let met = std::cell::Cell::new(0);
            let count = |from: Option<usize>, at: Vec3, along: Vec3| {
                met.set(met.get() + u32::from(from.is_some()));
                sky(from, at, along)
            };
            let found = mirrors.trace(Vec3::X * 5.0, direction, count);
            assert!((found.length() - 1.0).abs() < 1e-5 && met.get() == 1, "{direction}");
        }
        let none = Mirrors { spheres: Vec::new(), tint: Vec3::ONE, bounces: 0 };
        assert_eq!(none.trace(Vec3::ZERO, Vec3::Z, sky), Vec3::Z);
    }
}
