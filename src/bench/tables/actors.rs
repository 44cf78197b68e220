//! Things that move, made by code: an aeroplane, a walker, a bear that bends.

use glam::{DMat4, DVec3, Vec3};
use manyview_pipeline::scene::{Instance, Material, Mesh, Scene};
use manyview_shaders::trig::sin_cos;
use std::f64::consts::TAU;

/// A scene of one mesh in place.
pub(super) fn scene_of(mesh: Mesh) -> Scene {
    Scene {
        meshes: vec![mesh],
        instances: vec![Instance { mesh: 0, world_from_object: DMat4::IDENTITY }],
        materials: vec![Material::default()],
        ..Scene::default()
    }
}

/// An aeroplane of 10 m, its nose along +X, of about so many triangles.
pub(super) fn aeroplane(triangles: u32) -> Mesh {
    let mut mesh = Mesh::default();
    let part = triangles / 4;
    ellipsoid(&mut mesh, DVec3::ZERO, DVec3::new(5.0, 0.7, 0.7), part);
    ellipsoid(&mut mesh, DVec3::new(0.6, 0.1, 0.0), DVec3::new(0.9, 0.08, 5.5), part);
    ellipsoid(&mut mesh, DVec3::new(-4.3, 0.3, 0.0), DVec3::new(0.5, 0.06, 1.9), part);
    ellipsoid(&mut mesh, DVec3::new(-4.4, 0.9, 0.0), DVec3::new(0.5, 0.9, 0.07), part);
    mesh
}

/// A person of 1.8 m who stands on the ground, of about so many triangles.
pub(super) fn walker(triangles: u32) -> Mesh {
    let mut mesh = Mesh::default();
    let part = triangles / 4;
    ellipsoid(&mut mesh, DVec3::new(0.0, 1.2, 0.0), DVec3::new(0.16, 0.36, 0.26), part);
    ellipsoid(&mut mesh, DVec3::new(0.0, 1.66, 0.0), DVec3::new(0.11, 0.14, 0.11), part);
    for side in [-1.0, 1.0] {
        let hip = DVec3::new(0.14 * side, 0.45, 0.1 * side);
        ellipsoid(&mut mesh, hip, DVec3::new(0.1, 0.45, 0.1), part);
    }
    mesh
}

/// A bear of 2 m at rest, of about so many triangles.
pub(super) fn bear(triangles: u32) -> Mesh {
    let mut mesh = Mesh::default();
    ellipsoid(&mut mesh, DVec3::new(0.0, 0.95, 0.0), DVec3::new(0.9, 0.45, 0.42), triangles / 3);
    ellipsoid(&mut mesh, DVec3::new(1.05, 1.25, 0.0), DVec3::new(0.32, 0.26, 0.25), triangles / 9);
    for (x, z) in [(0.55, 0.25), (0.55, -0.25), (-0.55, 0.25), (-0.55, -0.25)] {
        ellipsoid(&mut mesh, DVec3::new(x, 0.45, z), DVec3::new(0.17, 0.45, 0.17), triangles / 9);
    }
    for z in [0.17, -0.17] {
        ellipsoid(&mut mesh, DVec3::new(1.0, 1.5, z), DVec3::new(0.06, 0.1, 0.1), triangles / 18);
    }
    mesh
}

/// Where a point of the bear is at a time in 0 … 1 of its dance: it sways, the more the higher.
pub(super) fn bent(p: Vec3, time: f64) -> Vec3 {
    let p = p.as_dvec3();
    let (sway, _) = sin_cos(TAU * time + 0.8 * p.x);
    let (sine, cosine) = sin_cos(0.5 * sway * p.y);
    DVec3::new(p.x, p.y * cosine - p.z * sine, p.y * sine + p.z * cosine).as_vec3()
}

/// Appends an ellipsoid of about so many triangles.
fn ellipsoid(mesh: &mut Mesh, center: DVec3, radii: DVec3, triangles: u32) {
    let mut rings = 3u32;
    while 4 * (rings + 1) * rings <= triangles {
        rings += 1;
    }
    let around = 2 * rings;
    let first = mesh.positions.len() as u32;
    for ring in 0..=rings {
        let (sine, cosine) = sin_cos(TAU / 2.0 * f64::from(ring) / f64::from(rings));
        for step in 0..around {
            let (z, x) = sin_cos(TAU * f64::from(step) / f64::from(around));
            mesh.positions.push((center + radii * DVec3::new(sine * x, cosine, sine * z)).as_vec3());
        }
    }
    for ring in 0..rings {
        for step in 0..around {
            let next = (step + 1) % around;
            let at = |ring: u32, step: u32| first + ring * around + step;
            let [a, b, c, d] = [at(ring, step), at(ring, next), at(ring + 1, next), at(ring + 1, step)];
            // At the poles one of the two has no area.
            if ring > 0 {
                mesh.triangles.push([a, b, c]);
            }
            if ring + 1 < rings {
                mesh.triangles.push([a, c, d]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn actors_have_about_the_triangles_asked_for_and_face_outwards() {
        for (mesh, wanted) in [(aeroplane(4000), 4000), (walker(1000), 1000), (bear(9000), 9000)] {
            let count = mesh.triangles.len();
            assert!((wanted * 6 / 10..=wanted).contains(&count), "{count} of {wanted}");
        }
        let mut ball = Mesh::default();
        ellipsoid(&mut ball, DVec3::ZERO, DVec3::ONE, 400);
        for triangle in &ball.triangles {
            let [a, b, c] = triangle.map(|v| ball.positions[v as usize]);
            assert!((b - a).cross(c - a).dot(a + b + c) > 0.0);
        }
    }

    #[test]
    fn the_bear_moves_and_its_feet_stay() {
        assert_eq!(bent(Vec3::new(0.3, 0.0, 0.0), 0.4), Vec3::new(0.3, 0.0, 0.0));
        let head = Vec3::new(1.0, 1.3, 0.0);
        assert!((bent(head, 0.1) - bent(head, 0.6)).length() > 0.5);
    }
}
