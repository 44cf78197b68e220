//! Shapes added to triangle meshes, one mesh a material.

use glam::{DMat4, DVec3, Vec2, Vec3, Vec4, vec2, vec3};
use manyview_shaders::trig::{sin_cos, sin_cos_turns};

use crate::scene::{Instance, Mesh, Scene};

/// What a surface is made of: a material, and what its vertices carry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Brush {
    /// Index into the scene's materials.
    pub(crate) material: u32,
    /// Texture repeats in one metre, if the material has a texture.
    pub(crate) repeats_per_metre: Option<f32>,
    /// Linear vertex colour in 1/255, if the material is to be tinted. All users of one material agree on having one.
    pub(crate) tint: Option<[u8; 3]>,
}

impl Brush {
    /// The same material in another colour.
    pub(crate) fn tinted(self, tint: [u8; 3]) -> Self {
        Self { tint: Some(tint), ..self }
    }
}

/// A place and three orthonormal, right-handed axes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Frame {
    pub(crate) origin: Vec3,
    pub(crate) x: Vec3,
    pub(crate) y: Vec3,
    pub(crate) z: Vec3,
}

impl Frame {
    /// World axes, moved to `origin`.
    pub(crate) const fn at(origin: Vec3) -> Self {
        Self { origin, x: Vec3::X, y: Vec3::Y, z: Vec3::Z }
    }

    /// World axes turned about +Y, +Z towards +X, by `angle` radians.
    pub(crate) fn turned(origin: Vec3, angle: f32) -> Self {
        let (sin, cos) = sin_cos_f32(angle);
        Self { origin, x: vec3(cos, 0.0, -sin), y: Vec3::Y, z: vec3(sin, 0.0, cos) }
    }

    /// World axes turned about +Y, +Z towards +X, by quarter turns.
    pub(crate) fn quarter_turned(origin: Vec3, quarter_turns: u32) -> Self {
        let (sin, cos) = sin_cos_turns(quarter_turns % 4, 4);
        let (sin, cos) = (sin as f32, cos as f32);
        Self { origin, x: vec3(cos, 0.0, -sin), y: Vec3::Y, z: vec3(sin, 0.0, cos) }
    }

    /// Axes with +Y along `up`, which has unit length.
    pub(crate) fn along(origin: Vec3, up: Vec3) -> Self {
        let helper = if up.x.abs() < 0.6 { Vec3::X } else { Vec3::Z };
        let z = helper.cross(up).normalize_or_zero();
        Self { origin, x: up.cross(z), y: up, z }
    }

    /// A point given in this frame's coordinates.
    pub(crate) fn point(&self, p: Vec3) -> Vec3 {
        self.origin + self.vector(p)
    }

    /// A vector given in this frame's coordinates.
    pub(crate) fn vector(&self, v: Vec3) -> Vec3 {
        self.x * v.x + self.y * v.y + self.z * v.z
    }

    /// The same axes at a point of this frame.
    pub(crate) fn moved(&self, p: Vec3) -> Self {
        Self { origin: self.point(p), ..*self }
    }

    /// A frame at a point of this one, turned about its own +Y by quarter turns (+Z towards +X).
    pub(crate) fn side(&self, p: Vec3, quarter_turns: u32) -> Self {
        let (x, z) = match quarter_turns % 4 {
            0 => (self.x, self.z),
            1 => (-self.z, self.x),
            2 => (-self.x, -self.z),
            _ => (self.z, -self.x),
        };
        Self { origin: self.point(p), x, y: self.y, z }
    }

    /// A frame at the same place, rolled about its own +Z by a quarter turn (+Y towards −X).
    pub(crate) fn rolled(&self) -> Self {
        Self { x: self.y, y: -self.x, ..*self }
    }

    /// This frame as a matrix, uniformly scaled.
    pub(crate) fn world_from_object(&self, scale: f32) -> DMat4 {
        let column = |axis: Vec3| (axis * scale).as_dvec3().extend(0.0);
        DMat4::from_cols(column(self.x), column(self.y), column(self.z), self.origin.as_dvec3().extend(1.0))
    }
}

/// Sine and cosine rounded to f32, the same on every host.
pub(crate) fn sin_cos_f32(radians: f32) -> (f32, f32) {
    let (sin, cos) = sin_cos(f64::from(radians));
    (sin as f32, cos as f32)
}

/// A set of meshes, one a material, that are placed together.
#[derive(Debug, Clone, Default)]
pub(crate) struct Model {
    parts: Vec<Mesh>,
}

/// Faces of a box left out, for [`Model::block`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Hidden {
    /// All six faces are there.
    Nothing,
    /// It stands on something.
    Bottom,
    /// It is fixed to a wall at its −Z side.
    Back,
}

impl Model {
    /// Triangles in all parts.
    pub(crate) fn triangles(&self) -> u64 {
        self.parts.iter().map(|part| part.triangles.len() as u64).sum()
    }

    fn part(&mut self, brush: Brush) -> &mut Mesh {
        let index = match self.parts.iter().position(|part| part.material == brush.material) {
            Some(index) => index,
            None => {
                self.parts.push(Mesh { material: brush.material, ..Mesh::default() });
                self.parts.len() - 1
            }
        };
        &mut self.parts[index]
    }

    fn vertex(part: &mut Mesh, brush: Brush, position: Vec3, normal: Option<Vec3>, uv: Vec2) -> u32 {
        let index = part.positions.len() as u32;
        part.positions.push(position);
        part.normals.extend(normal);
        if brush.repeats_per_metre.is_some() {
            part.base_color_uvs.push(uv);
        }
        if let Some([r, g, b]) = brush.tint {
            let channel = |value: u8| f32::from(value) / 255.0;
            part.colors.push(Vec4::new(channel(r), channel(g), channel(b), 1.0));
        }
        index
    }

    /// One flat triangle, counter-clockwise.
    pub(crate) fn triangle(&mut self, brush: Brush, corners: [Vec3; 3]) {
        let scale = brush.repeats_per_metre.unwrap_or(0.0);
        let along = (corners[1] - corners[0]).normalize_or_zero();
        let normal = along.cross(corners[2] - corners[0]).normalize_or_zero();
        let up = normal.cross(along);
        let part = self.part(brush);
        let indices = corners.map(|p| {
            let uv = vec2((p - corners[0]).dot(along), (p - corners[0]).dot(up)) * scale;
            Self::vertex(part, brush, p, None, uv)
        });
        part.triangles.push(indices);
    }

    /// One flat quadrilateral, counter-clockwise; texture u runs along its first edge, v along the last one backwards.
    pub(crate) fn quad(&mut self, brush: Brush, corners: [Vec3; 4]) {
        let scale = brush.repeats_per_metre.unwrap_or(0.0);
        let width = (corners[1] - corners[0]).length() * scale;
        let height = (corners[3] - corners[0]).length() * scale;
        self.quad_with_uvs(
            brush,
            corners,
            [vec2(0.0, 0.0), vec2(width, 0.0), vec2(width, height), vec2(0.0, height)],
        );
    }

    /// One flat quadrilateral with texture coordinates.
    pub(crate) fn quad_with_uvs(&mut self, brush: Brush, corners: [Vec3; 4], uvs: [Vec2; 4]) {
        let part = self.part(brush);
        let mut indices = [0; 4];
        for i in 0..4 {
            indices[i] = Self::vertex(part, brush, corners[i], None, uvs[i]);
        }
        let [a, b, c, d] = indices;
        part.triangles.extend([[a, b, c], [a, c, d]]);
    }

    /// An axis-aligned box in `frame`, from `low` to `high`: 12 triangles, or 10 with a hidden face.
    pub(crate) fn block(&mut self, brush: Brush, frame: &Frame, low: Vec3, high: Vec3, hidden: Hidden) {
        let corner = |x: bool, y: bool, z: bool| {
            let axis = |upper: bool, low: f32, high: f32| if upper { high } else { low };
            frame.point(vec3(axis(x, low.x, high.x), axis(y, low.y, high.y), axis(z, low.z, high.z)))
        };
        let (o, i) = (false, true);
        self.quad(brush, [corner(o, o, i), corner(i, o, i), corner(i, i, i), corner(o, i, i)]);
        if hidden != Hidden::Back {
            self.quad(brush, [corner(i, o, o), corner(o, o, o), corner(o, i, o), corner(i, i, o)]);
        }
        self.quad(brush, [corner(i, o, i), corner(i, o, o), corner(i, i, o), corner(i, i, i)]);
        self.quad(brush, [corner(o, o, o), corner(o, o, i), corner(o, i, i), corner(o, i, o)]);
        self.quad(brush, [corner(o, i, i), corner(i, i, i), corner(i, i, o), corner(o, i, o)]);
        if hidden != Hidden::Bottom {
            self.quad(brush, [corner(o, o, o), corner(i, o, o), corner(i, o, i), corner(o, o, i)]);
        }
    }

    /// A tube along `points`, `radii` at each, of `2 * sides` triangles a segment, smoothly shaded and open at its ends.
    /// Fewer than two points make nothing.
    pub(crate) fn tube(&mut self, brush: Brush, points: &[Vec3], radii: &[f32], sides: u32) {
        if points.len() < 2 {
            return;
        }
        let scale = brush.repeats_per_metre.unwrap_or(0.0);
        let part = self.part(brush);
        let mut frame = Frame::along(points[0], (points[1] - points[0]).normalize_or(Vec3::Y));
        let mut length = 0.0;
        let mut previous_ring = 0;
        for (i, point) in points.iter().enumerate() {
            let (before, after) = (points[i.saturating_sub(1)], points[(i + 1).min(points.len() - 1)]);
            let up = (after - before).normalize_or(frame.y);
            // The last ring's axes, made perpendicular to the new direction: the tube does not twist.
            let x = (frame.x - up * frame.x.dot(up)).normalize_or_zero();
            frame = if x == Vec3::ZERO {
                Frame::along(*point, up)
            } else {
                Frame { origin: *point, x, y: up, z: x.cross(up) }
            };
            length += (*point - before).length();
            let ring = part.positions.len() as u32;
            for side in 0..sides {
                let (sin, cos) = sin_cos_turns(side, sides);
                let normal = (frame.x * cos as f32 + frame.z * sin as f32).normalize_or(frame.x);
                let uv = vec2(side as f32 / sides as f32, length * scale);
                Self::vertex(part, brush, *point + normal * radii[i], Some(normal), uv);
            }
            if i > 0 {
                for side in 0..sides {
                    let next = (side + 1) % sides;
                    let (a, b) = (previous_ring + side, previous_ring + next);
                    let (c, d) = (ring + next, ring + side);
                    part.triangles.extend([[a, c, b], [a, d, c]]);
                }
            }
            previous_ring = ring;
        }
    }

    /// A solid of revolution about the frame's +Y: `profile` holds (radius, height) from bottom to top. Costs
    /// `2 * sides` triangles a step of the profile.
    pub(crate) fn lathe(&mut self, brush: Brush, frame: &Frame, profile: &[(f32, f32)], sides: u32) {
        for step in profile.windows(2) {
            let [(low_radius, low), (high_radius, high)] = [step[0], step[1]];
            for side in 0..sides {
                let at = |side: u32, radius: f32, height: f32| {
                    let (sin, cos) = sin_cos_turns(side % sides, sides);
                    frame.point(vec3(sin as f32 * radius, height, cos as f32 * radius))
                };
                let corners = [
                    at(side, low_radius, low),
                    at(side + 1, low_radius, low),
                    at(side + 1, high_radius, high),
                    at(side, high_radius, high),
                ];
                if low_radius == 0.0 {
                    self.triangle(brush, [corners[0], corners[2], corners[3]]);
                } else if high_radius == 0.0 {
                    self.triangle(brush, [corners[0], corners[1], corners[2]]);
                } else {
                    self.quad(brush, corners);
                }
            }
        }
    }

    /// A ball with three radii along the frame's axes: `2 * around * (rings - 1)` triangles, smoothly shaded.
    pub(crate) fn ellipsoid(&mut self, brush: Brush, frame: &Frame, radii: Vec3, around: u32, rings: u32) {
        let part = self.part(brush);
        let first = part.positions.len() as u32;
        for ring in 0..=rings {
            let (sin_polar, cos_polar) = sin_cos_turns(ring, 2 * rings);
            let count = if ring == 0 || ring == rings { 1 } else { around };
            for i in 0..count {
                let (sin, cos) = sin_cos_turns(i, around);
                let unit = DVec3::new(sin * sin_polar, cos_polar, cos * sin_polar).as_vec3();
                let normal = frame.vector(unit / radii).normalize_or(frame.y);
                Self::vertex(part, brush, frame.point(unit * radii), Some(normal), vec2(0.0, 0.0));
            }
        }
        let at = |ring: u32, i: u32| match ring {
            0 => first,
            _ if ring == rings => first + 1 + (rings - 1) * around,
            _ => first + 1 + (ring - 1) * around + i % around,
        };
        for ring in 0..rings {
            for i in 0..around {
                if ring > 0 {
                    part.triangles.push([at(ring, i), at(ring + 1, i + 1), at(ring, i + 1)]);
                }
                if ring + 1 < rings {
                    part.triangles.push([at(ring, i), at(ring + 1, i), at(ring + 1, i + 1)]);
                }
            }
        }
    }

    /// Moves the meshes into the scene and says where they are, for [`place`]. Empty models give an empty range.
    pub(crate) fn into_scene(self, scene: &mut Scene, name: &str) -> std::ops::Range<u32> {
        let first = scene.meshes.len() as u32;
        for mut part in self.parts.into_iter().filter(|part| !part.triangles.is_empty()) {
            // A part that mixes flat and smooth shapes would need normals everywhere: flat shading serves both.
            if part.normals.len() != part.positions.len() {
                part.normals.clear();
            }
            part.name = format!("{name} {}", scene.materials[part.material as usize].name);
            scene.meshes.push(part);
        }
        first..scene.meshes.len() as u32
    }
}

/// Adds an instance of each mesh.
pub(crate) fn place(scene: &mut Scene, meshes: std::ops::Range<u32>, world_from_object: DMat4) {
    scene.instances.extend(meshes.map(|mesh| Instance { mesh, world_from_object }));
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAIN: Brush = Brush { material: 0, repeats_per_metre: None, tint: None };

    /// Volume by the divergence theorem: positive only if faces are counter-clockwise from outside.
    fn signed_volume(model: &Model) -> f32 {
        let part = &model.parts[0];
        let p = |i: u32| part.positions[i as usize];
        part.triangles.iter().map(|[a, b, c]| p(*a).dot(p(*b).cross(p(*c))) / 6.0).sum()
    }

    #[test]
    fn a_block_has_its_volume_in_any_frame() {
        for turns in 0..4 {
            let mut model = Model::default();
            let frame = Frame::quarter_turned(vec3(5.0, 1.0, -2.0), turns);
            model.block(PLAIN, &frame, vec3(-1.0, 0.0, -2.0), vec3(1.0, 3.0, 2.0), Hidden::Nothing);
            assert_eq!(model.triangles(), 12);
            assert!((signed_volume(&model) - 24.0).abs() < 1e-4);
        }
        let mut model = Model::default();
        let frame = Frame::along(Vec3::ONE, vec3(0.6, 0.0, 0.8));
        model.block(PLAIN, &frame, Vec3::ZERO, Vec3::ONE, Hidden::Nothing);
        assert!((signed_volume(&model) - 1.0).abs() < 1e-5);
    }

    #[test]
    fn round_shapes_face_outwards() {
        let mut ball = Model::default();
        ball.ellipsoid(PLAIN, &Frame::at(Vec3::ONE), vec3(1.0, 2.0, 3.0), 64, 48);
        assert_eq!(ball.triangles(), 2 * 64 * 47);
        let exact = 4.0 / 3.0 * std::f32::consts::PI * 6.0;
        assert!((signed_volume(&ball) / exact - 1.0).abs() < 0.01);

        let mut cone = Model::default();
        cone.lathe(PLAIN, &Frame::at(Vec3::ZERO), &[(1.0, 0.0), (0.0, 3.0)], 64);
        assert!((signed_volume(&cone) / std::f32::consts::PI - 1.0).abs() < 0.01);

        let mut tube = Model::default();
        tube.tube(PLAIN, &[Vec3::ZERO, Vec3::Y, Vec3::Y * 2.0], &[0.5; 3], 16);
        assert_eq!(tube.triangles(), 64);
        let part = &tube.parts[0];
        for [a, b, c] in &part.triangles {
            let p = |i: &u32| part.positions[*i as usize];
            let geometric = (p(b) - p(a)).cross(p(c) - p(a));
            assert!(geometric.dot(part.normals[*a as usize]) > 0.0);
        }
    }

    #[test]
    fn shapes_of_one_material_share_a_mesh() {
        let mut model = Model::default();
        let other = Brush { material: 1, repeats_per_metre: Some(2.0), tint: Some([255, 0, 0]) };
        model.triangle(PLAIN, [Vec3::ZERO, Vec3::X, Vec3::Y]);
        model.triangle(other, [Vec3::ZERO, Vec3::X, Vec3::Y]);
        model.triangle(PLAIN, [Vec3::ZERO, Vec3::X, Vec3::Z]);
        assert_eq!(model.parts.len(), 2);
        assert_eq!(model.parts[1].base_color_uvs, [vec2(0.0, 0.0), vec2(2.0, 0.0), vec2(0.0, 2.0)]);
        assert_eq!(model.parts[1].colors[0], Vec4::new(1.0, 0.0, 0.0, 1.0));
    }
}
