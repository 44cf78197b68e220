//! The scene cube: where the octree lies.

use manyview_shaders::raster::Grid;

/// The axis-aligned cube of the octree.
///
/// Edge and origin are snapped, so that an edit which stays inside the cube does not move it: edges are 1, 1.25, 1.5
/// or 1.75 times a power of two, origins multiples of a 16th of the edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneCube {
    /// Smallest corner, metres.
    pub origin: [f64; 3],
    /// Edge, metres.
    pub size: f64,
}

impl SceneCube {
    /// The smallest snapped cube around world bounds, or `None` if they are empty, of zero size or not finite.
    pub fn around(min: [f64; 3], max: [f64; 3]) -> Option<Self> {
        let extent = (0..3).map(|i| max[i] - min[i]).fold(0.0, f64::max);
        let normal = |x: &f64| x.is_finite() && x.abs() < 1e30;
        if !(min.iter().chain(&max).all(normal) && extent > 1e-30) {
            return None;
        }
        // The vertices on the upper faces must fall into the last voxel, whatever the number of levels.
        let padded = extent * (1.0 + 1.0 / 1024.0);
        let mut power = 1.0;
        while power > padded {
            power *= 0.5;
        }
        while power * 2.0 <= padded {
            power *= 2.0;
        }
        loop {
            for quarter in 4..8 {
                let size = power * f64::from(quarter) / 4.0;
                let step = size / 16.0;
                let origin = min.map(|m| (m / step).floor() * step);
                if (0..3).all(|i| origin[i] + size * (1.0 - 1.0 / 1024.0) >= max[i]) {
                    return Some(Self { origin, size });
                }
            }
            power *= 2.0;
        }
    }

    /// Whether world bounds lie inside.
    pub fn contains(&self, min: [f64; 3], max: [f64; 3]) -> bool {
        (0..3).all(|i| min[i] >= self.origin[i] && max[i] <= self.origin[i] + self.size)
    }

    /// Lattice coordinates of a world position.
    #[inline]
    pub fn snap(&self, grid: Grid, world: [f64; 3]) -> [i16; 3] {
        let voxels_per_metre = f64::from(grid.size()) / self.size;
        [0, 1, 2].map(|i| grid.snap((world[i] - self.origin[i]) * voxels_per_metre) as i16)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn an_edit_inside_does_not_move_the_cube() {
        let a = SceneCube::around([-10.0, 0.0, -7.0], [10.0, 5.0, 9.0]).unwrap();
        let b = SceneCube::around([-9.9, 0.0, -7.1], [10.05, 6.0, 8.0]).unwrap();
        assert_eq!(a, b);
    }

    #[test]
    fn nothing_and_infinity_have_no_cube() {
        assert_eq!(SceneCube::around([1.0; 3], [1.0; 3]), None);
        assert_eq!(SceneCube::around([0.0; 3], [f64::INFINITY; 3]), None);
        assert_eq!(SceneCube::around([f64::NAN; 3], [1.0; 3]), None);
        assert!(SceneCube::around([0.0; 3], [1.0, 0.0, 0.0]).is_some(), "a line has a cube");
    }

    proptest! {
        #[test]
        fn the_cube_holds_the_scene_and_is_not_much_larger(
            min in prop::array::uniform3(-1e4f64..1e4), extent in prop::array::uniform3(1e-3f64..1e4),
        ) {
            let max = [0, 1, 2].map(|i| min[i] + extent[i]);
            let cube = SceneCube::around(min, max).unwrap();
            let largest = extent.iter().copied().fold(0.0, f64::max);
            prop_assert!(cube.contains(min, max));
            prop_assert!(cube.size <= largest * 1.4, "{} for {largest}", cube.size);
        }
    }
}
