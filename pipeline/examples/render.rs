use glam::*;
use manyview_pipeline::{generate::generate, scene::*};
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let s = generate(a[1].parse().unwrap(), a[2].parse().unwrap(), a[3].parse().unwrap());
    let n: Vec<f32> = a[5].split(',').map(|v| v.parse().unwrap()).collect();
    let (eye, at) = (vec3(n[0], n[1], n[2]), vec3(n[3], n[4], n[5]));
    let (w, h) = (1600usize, 1000usize);
    let view = glam::camera::rh::view::look_at_mat4(eye, at, Vec3::Y);
    let f = 1.3 * h as f32 / 1.0;
    let mut z = vec![f32::MAX; w * h];
    let mut img = vec![Vec3::new(0.25, 0.33, 0.5); w * h];
    let sun = vec3(0.5, 0.7, 0.4).normalize_or_zero();
    for i in &s.instances {
        let m = &s.meshes[i.mesh as usize];
        let mat = &s.materials[m.material as usize];
        let t = i.world_from_object.as_mat4();
        for tri in &m.triangles {
            let p = tri.map(|k| t.transform_point3(m.positions[k as usize]));
            let mut nn = (p[1] - p[0]).cross(p[2] - p[0]).normalize_or_zero();
            let facing = nn.dot(eye - p[0]);
            let mut back = false;
            if facing < 0.0 {
                if mat.double_sided { nn = -nn } else { back = true }
            }
            let c = p.map(|q| view.transform_point3(q));
            if c.iter().any(|q| q.z > -0.1) {
                continue;
            }
            let sc = c.map(|q| vec2(w as f32 / 2.0 + f * q.x / -q.z, h as f32 / 2.0 - f * q.y / -q.z));
            let lo = sc[0].min(sc[1]).min(sc[2]).max(Vec2::ZERO);
            let hi = sc[0].max(sc[1]).max(sc[2]).min(vec2(w as f32 - 1.0, h as f32 - 1.0));
            let area = (sc[1] - sc[0]).perp_dot(sc[2] - sc[0]);
            if area == 0.0 {
                continue;
            }
            for y in lo.y.floor() as usize..=hi.y.max(0.0).ceil() as usize {
                for x in lo.x.floor() as usize..=hi.x.max(0.0).ceil() as usize {
                    if x >= w || y >= h {
                        continue;
                    }
                    let q = vec2(x as f32 + 0.5, y as f32 + 0.5);
                    let b = [
                        (sc[2] - sc[1]).perp_dot(q - sc[1]) / area,
                        (sc[0] - sc[2]).perp_dot(q - sc[2]) / area,
                        (sc[1] - sc[0]).perp_dot(q - sc[0]) / area,
                    ];
                    if b.iter().any(|v| *v < 0.0) {
                        continue;
                    }
                    let iz = (0..3).map(|k| b[k] / -c[k].z).sum::<f32>();
                    let d = 1.0 / iz;
                    if d >= z[y * w + x] {
                        continue;
                    }
                    let pc: [f32; 3] = std::array::from_fn(|k| b[k] / -c[k].z * d);
                    let mut col = mat.base_color;
                    if !m.colors.is_empty() {
                        let v: Vec4 = (0..3).map(|k| m.colors[tri[k] as usize] * pc[k]).sum();
                        col *= v;
                    }
                    if let Some(ti) = mat.base_color_texture {
                        let uv: Vec2 = (0..3).map(|k| m.base_color_uvs[tri[k] as usize] * pc[k]).sum();
                        let tx = &s.textures[ti as usize];
                        let mut uv2 = uv - uv.floor();
                        if tx.wrap[0] == Wrap::ClampToEdge {
                            uv2 = uv.clamp(Vec2::ZERO, Vec2::splat(0.9999));
                        }
                        let e = tx.texels[((uv2.y * tx.height as f32) as usize).min(127) * 128
                            + ((uv2.x * tx.width as f32) as usize).min(127)];
                        let l = |v: u8| (v as f32 / 255.0).powf(2.2);
                        col *= vec4(l(e[0]), l(e[1]), l(e[2]), e[3] as f32 / 255.0);
                    }
                    if let Some(cut) = mat.alpha_mode.cutoff() {
                        if col.w < cut {
                            continue;
                        }
                    }
                    z[y * w + x] = d;
                    let light = nn.dot(sun).max(0.0) * 1.6 + 0.35 + 0.2 * nn.y;
                    let mut o = col.truncate() * light + mat.emissive * 0.25;
                    if back {
                        o = vec3(1.0, 0.0, 1.0);
                    }
                    img[y * w + x] = o.lerp(vec3(0.25, 0.33, 0.5), (d / 900.0).min(0.5));
                }
            }
        }
    }
    let px: Vec<u8> = img
        .iter()
        .flat_map(|c| {
            let c = *c * 1.4;
            let c = c / (Vec3::ONE + c * 0.35);
            c.to_array().map(|v| (v.clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0) as u8)
        })
        .collect();
    image::save_buffer(&a[4], &px, w as u32, h as u32, image::ExtendedColorType::Rgb8).unwrap();
}
