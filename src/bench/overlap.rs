//! Exact overlap of triangles and boxes, by separating axes.
//!
//! # Theory
//! T. Akenine-Möller, *Fast 3D Triangle-Box Overlap Testing*, 2001: two convex bodies are apart iff they are apart along
//! a normal of either or along a cross product of two of their edges. Triangle and cube have 13 such axes.
//!
//! # Practice
//! In `f64` every product of lattice coordinates below 2¹⁵ is exact, so the answer for snapped triangles is too.

use glam::DVec3;

/// Whether a triangle (with its border) touches a cube (with its border).
pub fn touches_cube(triangle: &[DVec3; 3], center: DVec3, half_edge: f64) -> bool {
    let v = triangle.map(|p| p - center);
    let low = v[0].min(v[1]).min(v[2]);
    let high = v[0].max(v[1]).max(v[2]);
    if low.max_element() > half_edge || high.min_element() < -half_edge {
        return false;
    }
    let apart = |axis: DVec3| {
        let reach = axis.abs().dot(DVec3::splat(half_edge));
        let [a, b, c] = v.map(|p| p.dot(axis));
        a.min(b).min(c) > reach || a.max(b).max(c) < -reach
    };
    let edges = [v[1] - v[0], v[2] - v[1], v[0] - v[2]];
    if apart(edges[0].cross(edges[1])) {
        return false;
    }
    !edges.iter().any(|e| {
        apart(DVec3::new(0.0, -e.z, e.y))
            || apart(DVec3::new(e.z, 0.0, -e.x))
            || apart(DVec3::new(-e.y, e.x, 0.0))
    })
}

/// Visits every cell of a grid of `2^bits` cells a side, each of edge `edge`, that a triangle touches.
pub fn touched_cells(triangle: &[DVec3; 3], bits: u32, edge: f64, visit: &mut impl FnMut([u32; 3])) {
    descend(triangle, [0; 3], bits, edge, visit);
}

fn descend(triangle: &[DVec3; 3], cell: [u32; 3], level: u32, edge: f64, visit: &mut impl FnMut([u32; 3])) {
    let half = edge * f64::from(1u32 << level) * 0.5;
    let center = DVec3::from_array(cell.map(|c| f64::from(c) * edge)) + half;
    if !touches_cube(triangle, center, half) {
        return;
    }
    if level == 0 {
        visit(cell);
        return;
    }
    let step = 1 << (level - 1);
    for child in 0..8u32 {
        let part = [0, 1, 2].map(|i| cell[i] + (child >> i & 1) * step);
        descend(triangle, part, level - 1, edge, visit);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::Random;

    fn touched(triangle: &[DVec3; 3]) -> Vec<[u32; 3]> {
        let mut cells = Vec::new();
        touched_cells(triangle, 3, 1.0, &mut |c| cells.push(c));
        cells.sort_unstable();
        cells
    }

    #[test]
    fn borders_belong_to_both() {
        let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
        assert_eq!(touched(&[at(1.2, 1.2, 1.5), at(1.8, 1.2, 1.5), at(1.5, 1.8, 1.5)]), [[1, 1, 1]]);
        let on_border = [at(1.2, 1.2, 2.0), at(1.8, 1.2, 2.0), at(1.5, 1.8, 2.0)];
        assert_eq!(touched(&on_border), [[1, 1, 1], [1, 1, 2]]);
        assert_eq!(touched(&[DVec3::splat(3.0); 3]).len(), 8, "a point at a corner");
        assert!(touched(&[DVec3::splat(9.0); 3]).is_empty());
    }

    #[test]
    fn a_long_diagonal_touches_only_its_neighbourhood() {
        let needle = [DVec3::splat(0.1), DVec3::splat(7.9), DVec3::new(7.9, 7.9, 7.8)];
        let cells = touched(&needle);
        assert!(cells.contains(&[4, 4, 4]) && !cells.contains(&[4, 4, 6]) && cells.len() < 40, "{cells:?}");
    }

    #[test]
    fn dense_samples_of_a_triangle_are_in_touched_cells_and_reach_all_of_them() {
        let mut random = Random::new(11);
        for _ in 0..50 {
            let triangle = [0; 3].map(|_: i32| DVec3::new(random.unit(), random.unit(), random.unit()) * 8.0);
            let cells = touched(&triangle);
            let mut reached = std::collections::BTreeSet::new();
            let n = 400;
            for i in 0..=n {
                for j in 0..=n - i {
                    let (a, b) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
                    let p = triangle[0] * (1.0 - a - b) + triangle[1] * a + triangle[2] * b;
                    reached.insert(p.to_array().map(|c| (c.floor() as u32).min(7)));
                }
            }
            assert!(reached.iter().all(|c| cells.binary_search(c).is_ok()));
            // Samples may miss a cell that is cut by less than their spacing.
            assert!(reached.len() * 100 >= cells.len() * 93, "{} of {}", reached.len(), cells.len());
        }
    }
}
