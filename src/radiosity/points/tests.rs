use super::lit_tree::Sample;
use super::*;
use crate::Archive;
use crate::bench::Random;
use crate::exact::ExactRays;
use crate::megaviews::{MegaViews, Sharing};
use crate::render::gbuffer::{Looks, Pixel};
use crate::render::lights::{light_points, point_light};
use crate::render::scene::RenderScene;
use crate::render::shade::{Lighting, reflected};
use crate::views::RayCast;
use crate::visibility::Visibility;
use glam::{DMat4, DVec3};
use manyview_pipeline::bake::{BakeOptions, Silent, bake_in_memory};
use manyview_pipeline::scene::{Instance, Material, Mesh, PunctualLight, Scene};
use manyview_shaders::trig::sin_cos;
use manyview_shaders::{octahedral, rgb9e5};
use std::convert::Infallible;

fn receiver(position: Vec3, normal: Vec3) -> PointReceiver {
    PointReceiver { position, geometric_normal: normal, normal }
}

/// Irradiances by \[MV\] and by exact casts, at positions as they are.
fn both(svo: &Svo, lit: &LitTree, receivers: &[PointReceiver], resolution: u32) -> [Vec<Vec3>; 2] {
    let settings = ViewSettings::new(resolution);
    let maps = MegaViews::new(coded_tree(svo, lit).into()).with_sharing(Sharing::None);
    let casts = RayCast::new(CodedLeaves::new(svo, lit));
    let renderers: [&dyn ViewRenderer; 2] = [&maps, &casts];
    renderers.map(|renderer| irradiance(renderer, lit, receivers, 0.0, &settings, &Silent).unwrap())
}

fn close(found: Vec3, expected: Vec3, share: f32) {
    let error = (found - expected).abs().max_element();
    assert!(error <= share * expected.max_element(), "{found} is not {expected}");
}

/// The outermost cells of a cube from −1 to 1, which all glow.
fn glowing_box(depth: u32, radiance: [f64; 3]) -> Svo {
    let side = 1u32 << depth;
    let cells = (0..side.pow(3)).map(|i| [i % side, i / side % side, i / side / side]);
    let outermost = cells.filter(|cell| cell.iter().any(|&c| c == 0 || c == side - 1));
    let mut svo = Svo::of_cells([-1.0; 3], 2.0, depth, outermost);
    let leaves = svo.node_count(depth as usize);
    svo.levels[depth as usize].emissive = vec![rgb9e5::encode(radiance); leaves];
    svo
}

/// A horizontal sheet of one layer of cells, two metres a side, whose normals face up.
fn sheet(depth: u32) -> Svo {
    let side = 1u32 << depth;
    let cells = (0..side * side).map(|i| [i % side, side / 2, i / side]);
    let mut svo = Svo::of_cells([-1.0; 3], 2.0, depth, cells);
    svo.levels[depth as usize].normals.fill(octahedral::encode([0.0, 1.0, 0.0]));
    svo
}

#[test]
fn solid_angles_are_a_sphere_together() {
    for (resolution, error) in [(16, 0.03), (64, 0.01), (256, 0.003)] {
        let all: f32 = Texel::all(resolution).iter().map(|texel| texel.solid_angle).sum();
        assert!((all / (4.0 * PI) - 1.0).abs() < error, "{resolution}: {all}");
    }
}

#[test]
fn in_a_closed_box_that_glows_irradiance_is_pi_times_radiance() {
    let radiance = Vec3::new(2.0, 1.0, 0.5);
    let svo = glowing_box(5, radiance.to_array().map(f64::from));
    let lit = LitTree::glowing(&svo);
    let mut random = Random::new(3);
    let mut vector = || Vec3::from([0; 3].map(|_| random.signed() as f32));
    let receivers: Vec<PointReceiver> =
        (0..40).map(|_| receiver(vector() * 0.9, vector().normalize_or(Vec3::X))).collect();
    for resolution in [16, 32] {
        let [maps, casts] = both(&svo, &lit, &receivers, resolution);
        // Exact casts find a closed box closed; of maps a few texels stay empty.
        maps.into_iter().for_each(|found| close(found, radiance * PI, 0.01));
        casts.into_iter().for_each(|found| close(found, radiance * PI, 1e-5));
    }
}

/// Share of the hemisphere, by cosine, that a square of `half` metres to each side fills over a point `height` metres
/// away from its middle (four times the form factor of a corner).
fn square_share(half: f32, height: f32) -> f32 {
    let a = half / height;
    let root = (1.0 + a * a).sqrt();
    4.0 / (2.0 * PI) * 2.0 * (a / root) * (a / root).atan()
}

#[test]
fn a_sheet_shines_on_the_side_that_is_lit() {
    let svo = sheet(6);
    let radiance = Vec3::new(3.0, 1.0, 0.0);
    let light = |samples: &[Sample]| Ok::<_, Infallible>(vec![[radiance, Vec3::ZERO]; samples.len()]);
    let Ok(lit) = LitTree::with_radiances(&svo, 1, light);
    // From near the sheet's leaves are seen, from far away its inner nodes. Its middle is at 1/64.
    for height in [0.4, 1.0, 4.0] {
        let at = |side: f32| Vec3::new(0.003, 1.0 / 64.0 + side * height, 0.002);
        let receivers = [
            receiver(at(1.0), Vec3::NEG_Y),
            receiver(at(-1.0), Vec3::Y),
            receiver(at(1.0), Vec3::Y),
            receiver(at(1.0), Vec3::new(0.6, -0.8, 0.0)),
        ];
        // Seen from so far away the sheet's cells are thicker than none by their half edge.
        let share = square_share(1.0, height);
        for found in both(&svo, &lit, &receivers, 128) {
            close(found[0], radiance * PI * share, 0.06);
            assert_eq!(found[1..3], [Vec3::ZERO; 2], "behind, and turned away");
            assert!(found[3].x > 0.0 && found[3].x < found[0].x);
        }
    }
}

#[test]
fn nodes_show_the_side_that_is_seen() {
    // A block of cells whose outer sides shine by the axis that they face; nobody sees what is behind them.
    let faces = [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]];
    let side = 8u32;
    let cells = (0..side.pow(3)).map(|i| [i % side, i / side % side, i / side / side]);
    let rim = |c: u32| c == 0 || c == side - 1;
    // Without edges every cell has one normal.
    let outer = cells.filter(|cell| cell.iter().filter(|&&c| rim(c)).count() == 1);
    let mut svo = Svo::of_cells([0.0; 3], 1.0, 3, outer);
    let normals = svo.cells(3).into_iter().map(|cell| {
        let axis = (0..3).find(|&axis| rim(cell[axis].into())).unwrap();
        let mut normal = [0.0; 3];
        normal[axis] = if cell[axis] == 0 { -1.0 } else { 1.0 };
        octahedral::encode(normal)
    });
    svo.levels[3].normals = normals.collect();
    let light = |samples: &[Sample]| {
        let of = |sample: &Sample| {
            let axis = (0..3).find(|&axis| sample.normal[axis].abs() > 0.5).unwrap();
            [Vec3::splat(faces[axis][usize::from(sample.normal[axis] > 0.0)]), Vec3::ZERO]
        };
        Ok::<_, Infallible>(samples.iter().map(of).collect())
    };
    let Ok(lit) = LitTree::with_radiances(&svo, 1, light);
    for axis in 0..3 {
        for (sign, expected) in [(-1.0, faces[axis][0]), (1.0, faces[axis][1])] {
            let mut direction = Vec3::ZERO;
            direction[axis] = sign;
            close(lit.radiance(0, direction), Vec3::splat(expected), 1e-5);
        }
    }
    let diagonal = Vec3::new(1.0, 1.0, -1.0).normalize_or_zero();
    close(lit.radiance(0, diagonal), Vec3::splat((2.0 + 4.0 + 5.0) / 3.0), 1e-5);
    assert_eq!(lit.node_of(&svo).len(), lit.node_count());
}

/// A floor six metres a side, lit by a lamp, and a wall behind it; winding is such that the wall's front faces the floor.
fn room() -> RenderScene {
    let quad = |a: Vec3, u: Vec3, v: Vec3| [[a, a + u, a + u + v], [a, a + u + v, a + v]];
    let floor = quad(Vec3::new(-3.0, 0.0, -3.0), Vec3::Z * 6.0, Vec3::X * 6.0);
    let wall = quad(Vec3::new(-3.0, 0.0, -3.0), Vec3::X * 6.0, Vec3::Y * 3.0);
    let table = quad(Vec3::new(-0.5, 0.8, -1.5), Vec3::Z, Vec3::X);
    let triangles = [floor, wall, table].concat();
    let count = triangles.len() as u32;
    RenderScene::new(Scene {
        meshes: vec![Mesh {
            positions: triangles.concat(),
            triangles: (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
            ..Mesh::default()
        }],
        instances: vec![Instance { mesh: 0, world_from_object: DMat4::IDENTITY }],
        materials: vec![Material { base_color: Vec3::new(0.8, 0.4, 0.2).extend(1.0), ..Material::default() }],
        ..Scene::default()
    })
    .unwrap()
}

fn lamp() -> PunctualLight {
    point_light(Vec3::new(0.4, 2.0, 0.2), Vec3::splat(30.0))
}

fn octree(scene: &RenderScene, levels: u32) -> Svo {
    let options = BakeOptions { levels, rows: None, ..BakeOptions::default() };
    let bytes = bake_in_memory(&scene.scene, &options).unwrap();
    Archive::from_bytes(bytes).unwrap().svo().unwrap()
}

/// Irradiance from surfaces by rays at the triangles, as likely as their cosine is large, each on to the lamp.
fn by_rays(scene: &RenderScene, exact: &ExactRays<'_>, at: &PointReceiver, rays: u32) -> Vec3 {
    let looks = Looks::new(scene, exact.reference(), 0.0);
    let lights = [lamp()];
    let lighting = Lighting::new(&lights, scene);
    let points = light_points(&lights, scene);
    let (x, y) = at.normal.as_dvec3().any_orthonormal_pair();
    let origin = (at.position + at.geometric_normal * 1e-4).as_dvec3();
    let mut random = Random::new(11);
    let mut sum = Vec3::ZERO;
    for _ in 0..rays {
        let (square, turn) = (random.unit(), random.unit() * std::f64::consts::TAU);
        let (sine, cosine) = sin_cos(turn);
        let across = x * cosine + y * sine;
        let direction: DVec3 = across * square.sqrt() + at.normal.as_dvec3() * (1.0 - square).sqrt();
        let Some(hit) = exact.reference().intersect(origin, direction, f64::INFINITY) else { continue };
        let pixel = looks.pixel(&hit, origin, direction);
        let mut hidden = [0];
        exact.hidden_lights(&[pixel.receiver()], &points, &mut hidden).unwrap();
        sum += reflected(&pixel, lighting.direct(&pixel, &hidden));
    }
    sum * (PI / rays as f32)
}

#[test]
fn light_from_a_floor_to_a_wall_is_as_rays_say() {
    let scene = room();
    let exact = ExactRays::new(scene.reference());
    let svo = octree(&scene, 8);
    let lit = LitTree::new(&svo, &scene, &[lamp()], &exact, &Silent).unwrap();
    let receivers: Vec<PointReceiver> = [
        // On the wall, on the floor under the table and beside it, on the wall's back, on the table.
        ([0.2, 1.0, -3.0], Vec3::Z),
        ([-1.9, 0.3, -3.0], Vec3::Z),
        ([2.1, 2.4, -3.0], Vec3::Z),
        ([0.1, 0.0, -1.1], Vec3::Y),
        ([0.0, 0.0, -2.3], Vec3::Y),
        ([0.2, 1.0, -3.0], Vec3::NEG_Z),
        ([0.1, 0.8, -1.0], Vec3::Y),
        ([0.1, 0.8, -1.0], Vec3::NEG_Y),
    ]
    .map(|(position, normal)| receiver(position.into(), normal))
    .into();
    let settings = ViewSettings::new(64);
    let voxel = (svo.size / 256.0) as f32;
    let maps = MegaViews::new(coded_tree(&svo, &lit).into()).with_sharing(Sharing::None);
    let casts = RayCast::new(CodedLeaves::new(&svo, &lit));
    // Points fill the texels at edges that they only touch, so that a table seen edge-on is too high.
    let renderers: [(&dyn ViewRenderer, f32); 2] = [(&maps, 0.12), (&casts, 0.07)];
    let expected: Vec<Vec3> = receivers.iter().map(|at| by_rays(&scene, &exact, at, 20_000)).collect();
    let most = expected.iter().map(|e| e.x).fold(0.0, f32::max);
    for (renderer, share) in renderers {
        let found = irradiance(renderer, &lit, &receivers, voxel, &settings, &Silent).unwrap();
        for (found, expected) in found.iter().zip(&expected) {
            let error = (found.x - expected.x).abs();
            assert!(error <= share * expected.x + 0.01 * most, "{}: {found} {expected}", renderer.name());
        }
    }
}

#[test]
fn threads_change_nothing() {
    let scene = room();
    let exact = ExactRays::new(scene.reference());
    let svo = octree(&scene, 6);
    let draw = || {
        let lit = LitTree::new(&svo, &scene, &[lamp()], &exact, &Silent).unwrap();
        let receivers: Vec<PointReceiver> = (0..50)
            .map(|i| receiver(Vec3::new(0.05 * i as f32 - 1.0, 0.03 * i as f32, -3.0), Vec3::Z))
            .collect();
        let maps = MegaViews::new(coded_tree(&svo, &lit).into());
        let found = irradiance(&maps, &lit, &receivers, 0.1, &ViewSettings::new(16), &Silent).unwrap();
        (lit, found)
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(pool.install(draw), draw());
}

#[test]
fn an_octree_of_one_leaf_and_dark_ones_are_lit() {
    let svo = Svo::of_cells([0.0; 3], 1.0, 0, [[0; 3]]);
    let lit = LitTree::glowing(&svo);
    assert_eq!((lit.level(), lit.node_count()), (0, 1));
    let tree = coded_tree(&svo, &lit);
    assert_eq!(tree.colors.len(), 9);
    let at = [receiver(Vec3::splat(3.0), Vec3::NEG_X), receiver(Vec3::splat(f32::NAN), Vec3::X)];
    assert_eq!(both(&svo, &lit, &at, 8).concat(), [Vec3::ZERO; 4]);
}

#[test]
fn light_is_kept_down_to_a_level_and_found_from_all_below() {
    let svo = sheet(4);
    let mut deep = svo.clone();
    // 64 leaves for each of 256: more lights than can be asked of them all leave fewer levels.
    deep.levels[4].child_masks = vec![0xff; 256];
    deep.levels[4].coverages = vec![255; 256];
    for _ in 0..2 {
        let nodes = deep.levels.last().unwrap().child_masks.iter().map(|m| m.count_ones() as usize).sum();
        let mut below = manyview_shaders::svo::SvoLevel::of_masks(vec![0xff; nodes], nodes);
        below.normals.fill(octahedral::encode([0.0, 1.0, 0.0]));
        deep.levels.push(below);
    }
    let last = deep.levels.last_mut().unwrap();
    last.child_masks.clear();
    last.coverages.clear();
    let light = |samples: &[Sample]| {
        Ok::<_, Infallible>(samples.iter().map(|s| [Vec3::splat(s.position.x + 2.0), Vec3::ZERO]).collect())
    };
    let Ok(lit) = LitTree::with_radiances(&deep, 100_000, light);
    assert_eq!(lit.level(), 5);
    assert_eq!(lit.sample_count(), 256 * 8 * 4);
    let nodes = lit.node_of(&deep);
    let count = deep.levels.iter().map(|level| level.colors.len()).sum::<usize>();
    assert_eq!(nodes.len(), count);
    // A leaf shines like the lit node that it is in.
    let leaves = deep.cells(6);
    for (leaf, cell) in leaves.iter().enumerate().step_by(97) {
        let node = nodes[count - leaves.len() + leaf];
        let middle = -1.0 + (f32::from(cell[0] / 2) + 0.5) * 2.0 / 32.0;
        close(lit.radiance(node, Vec3::Y), Vec3::splat(middle + 2.0), 0.02);
    }
}

#[test]
fn receivers_are_the_surfaces_of_their_pixels() {
    let pixel = Pixel {
        position: [1.0, 2.0, 3.0],
        geometric_normal: [0.0, 1.0, 0.0],
        normal: [0.6, 0.8, 0.0],
        triangle: 0,
        depth: 1.0,
        ..Pixel::EMPTY
    };
    let gbuffer = GBuffer { width: 2, height: 1, pixels: vec![Pixel::EMPTY, pixel] };
    let places = Places::choose(&gbuffer, 5, 0.1);
    let expected = PointReceiver {
        position: Vec3::new(1.0, 2.0, 3.0),
        geometric_normal: Vec3::Y,
        normal: Vec3::new(0.6, 0.8, 0.0),
    };
    assert_eq!(receivers(&gbuffer, &places), [expected]);
}
