//! Gentle ground.

use glam::{Vec2, Vec3, vec2, vec3};

use super::rng::mix;

/// Smooth hills, flat around the origin.
#[derive(Debug, Clone, Copy)]
pub(super) struct Terrain {
    seed: u64,
    /// Metres between neighbouring hills.
    wavelength: f32,
    /// Metres between the lowest valley and the highest hill, about.
    amplitude: f32,
    /// Metres around the origin that are flat.
    flat_radius: f32,
}

impl Terrain {
    pub(super) fn new(seed: u64, wavelength: f32, amplitude: f32, flat_radius: f32) -> Self {
        Self { seed, wavelength, amplitude, flat_radius }
    }

    /// Metres above the origin's plane.
    pub(super) fn height(&self, x: f32, z: f32) -> f32 {
        let waves = self.noise(x / self.wavelength, z / self.wavelength)
            + 0.35 * self.noise(x / self.wavelength * 2.7 + 31.0, z / self.wavelength * 2.7 + 17.0);
        let distance = (x * x + z * z).sqrt();
        let hilly = smooth(((distance - self.flat_radius) / (0.8 * self.flat_radius + 1.0)).clamp(0.0, 1.0));
        (waves - 0.675) * self.amplitude * hilly
    }

    /// The point of the ground at (x, z).
    pub(super) fn point(&self, x: f32, z: f32) -> Vec3 {
        vec3(x, self.height(x, z), z)
    }

    /// The ground's corner points of a cell, counter-clockwise from above, and their texture coordinates.
    pub(super) fn cell(&self, low: Vec2, high: Vec2, repeats_per_metre: f32) -> ([Vec3; 4], [Vec2; 4]) {
        let corners = [(low.x, high.y), (high.x, high.y), (high.x, low.y), (low.x, low.y)];
        (
            corners.map(|(x, z)| self.point(x, z)),
            corners.map(|(x, z)| vec2(x * repeats_per_metre, z * repeats_per_metre)),
        )
    }

    fn noise(&self, x: f32, y: f32) -> f32 {
        let (column, row) = (x.floor(), y.floor());
        let at = |dx: i64, dy: i64| {
            let (i, j) = (column as i64 + dx, row as i64 + dy);
            let word = mix(mix(self.seed ^ i as u64).wrapping_add(j as u64));
            (word >> 40) as f32 / 16_777_216.0
        };
        let (tx, ty) = (smooth(x - column), smooth(y - row));
        let low = at(0, 0) + (at(1, 0) - at(0, 0)) * tx;
        let high = at(0, 1) + (at(1, 1) - at(0, 1)) * tx;
        low + (high - low) * ty
    }
}

fn smooth(t: f32) -> f32 {
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn is_flat_in_the_middle_and_continuous() {
        let terrain = Terrain::new(3, 60.0, 6.0, 20.0);
        assert_eq!(terrain.height(10.0, -9.0), 0.0);
        for i in 0..4_000 {
            let x = i as f32 * 0.05 - 100.0;
            let step = terrain.height(x + 0.05, 40.0) - terrain.height(x, 40.0);
            assert!(step.abs() < 0.1, "a step of {step} m at x = {x}");
        }
    }
}
