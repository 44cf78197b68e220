//! Octrees of scenes whose voxels are known.

use crate::scenes::{
    baked, box_mesh, cut_in_half, floor_mesh, geometry_digests, metre_voxels, moved, one_mesh, plain, small,
    sphere_mesh,
};
use glam::{DMat4, DVec3, Vec3};
use manyview::Archive;
use manyview_pipeline::cube::SceneCube;
use manyview_pipeline::generate::{SceneKind, generate};
use manyview_pipeline::reduce::reduce_level;
use manyview_pipeline::rows::RowsFrom;
use manyview_pipeline::scene::{Instance, Material, Mesh, Scene};
use manyview_pipeline::triangles::{Cutouts, LatticeTriangles};
use manyview_shaders::octahedral;
use manyview_shaders::raster::{Grid, VoxelBox, fragments_basic};
use manyview_shaders::rgb9e5;
use manyview_shaders::srgb::srgb_from_linear;
use std::collections::BTreeSet;

type Voxels = BTreeSet<[i32; 3]>;

/// The voxels of the deepest level, as the archive has them.
fn leaves(archive: &Archive) -> Voxels {
    let svo = archive.svo().unwrap();
    let depth = svo.depth() as usize;
    let stats = svo.validate().unwrap();
    let cells = svo.cells(depth);
    assert_eq!(stats.leaves, cells.len() as u64);
    let voxels: Voxels = cells.into_iter().map(|cell| cell.map(i32::from)).collect();
    assert_eq!(stats.leaves, voxels.len() as u64, "no voxel twice");
    voxels
}

/// Drawn triangles on the lattice of the archive's own grid, with what cuts them.
fn snapped(scene: &Scene, archive: &Archive) -> (Grid, LatticeTriangles, Cutouts) {
    let info = archive.svo_info();
    let (grid, cube) = (Grid::new(info.levels), SceneCube { origin: info.origin, size: info.size });
    let cutouts = Cutouts::new(scene);
    let triangles = LatticeTriangles::new(scene, &cutouts, |p| cube.snap(grid, p.to_array()));
    (grid, triangles, cutouts)
}

/// All voxels by the slow, obvious rasterizer over the whole grid.
fn brute_force(scene: &Scene, archive: &Archive) -> Voxels {
    let (grid, all, cutouts) = snapped(scene, archive);
    let mut voxels = Voxels::new();
    for (index, triangle) in all.triangles.iter().enumerate() {
        let mask = all.mask(&cutouts, index);
        for f in fragments_basic(grid, &triangle.map(|v| v.map(i32::from)), &VoxelBox::whole(grid)) {
            if mask.is_none_or(|m| m.passes(&cutouts.planes, f.barycentric)) {
                voxels.insert(f.voxel);
            }
        }
    }
    voxels
}

/// Whether a triangle touches a closed box, exactly: no axis of the 13 that can separates them.
fn touches(triangle: &[[i64; 3]; 3], min: [i64; 3], max: [i64; 3]) -> bool {
    let minus = |a: [i64; 3], b: [i64; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let cross = |a: [i64; 3], b: [i64; 3]| {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let edges = [0, 1, 2].map(|i| minus(triangle[(i + 1) % 3], triangle[i]));
    let units = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    let mut axes = units.to_vec();
    axes.push(cross(edges[0], edges[1]));
    axes.extend(edges.iter().flat_map(|&edge| units.map(|unit| cross(edge, unit))));
    axes.iter().all(|axis| {
        let dot = |p: [i64; 3]| (0..3).map(|i| axis[i] * p[i]).sum::<i64>();
        let of_triangle = triangle.map(dot);
        let corner = |low: bool| dot([0, 1, 2].map(|i| if (axis[i] < 0) == low { max[i] } else { min[i] }));
        of_triangle.iter().max() >= Some(&corner(true)) && of_triangle.iter().min() <= Some(&corner(false))
    })
}

/// Voxels that a triangle touches at all.
fn touched(scene: &Scene, archive: &Archive) -> Voxels {
    let (grid, all, _) = snapped(scene, archive);
    let step = 1i64 << grid.sub_bits;
    let mut voxels = Voxels::new();
    for triangle in &all.triangles {
        let triangle = triangle.map(|v| v.map(i64::from));
        let range = [0, 1, 2].map(|i| {
            let of = triangle.map(|v| v[i]);
            let (lo, hi) = (of.iter().min().unwrap(), of.iter().max().unwrap());
            // A box is closed: the one below a border touches it too.
            ((lo - 1).max(0) / step)..=(hi / step).min(i64::from(grid.size()) - 1)
        });
        for x in range[0].clone() {
            for y in range[1].clone() {
                for z in range[2].clone() {
                    let voxel = [x, y, z];
                    if touches(&triangle, voxel.map(|c| c * step), voxel.map(|c| (c + 1) * step)) {
                        voxels.insert(voxel.map(|c| c as i32));
                    }
                }
            }
        }
    }
    voxels
}

/// Scenes of different kinds: flat, curved, thin, cut by alpha.
fn scenes() -> Vec<(&'static str, Scene)> {
    let sphere = sphere_mesh(Vec3::new(0.3, -2.0, 7.0), 3.0, 8);
    vec![
        ("box", one_mesh(box_mesh(Vec3::new(-1.0, 0.2, 3.0), Vec3::new(2.0, 1.7, 3.9)), Material::default())),
        ("sphere", one_mesh(sphere, Material::default())),
        ("hairball", generate(SceneKind::Hairball, 1000, 3)),
        ("forest", generate(SceneKind::Forest, 1500, 3)),
        ("town", generate(SceneKind::Town, 1500, 3)),
    ]
}

#[test]
fn voxels_are_those_of_the_plain_rasterizer() {
    for (name, scene) in scenes() {
        for levels in [3, 5] {
            let mut options = small(RowsFrom::Points);
            (options.levels, options.rows) = (levels, None);
            let archive = baked(&scene, &options);
            assert!(leaves(&archive) == brute_force(&scene, &archive), "{name} at {levels} levels");
        }
    }
}

#[test]
fn no_voxel_is_set_that_no_triangle_touches() {
    for (name, scene) in scenes() {
        let mut options = small(RowsFrom::Points);
        (options.levels, options.rows) = (5, None);
        let archive = baked(&scene, &options);
        let (found, touched) = (leaves(&archive), touched(&scene, &archive));
        let extra: Vec<_> = found.difference(&touched).collect();
        assert!(extra.is_empty(), "{name}: {extra:?}");
        println!("{name}: {} voxels of {} that are touched", found.len(), touched.len());
        // Thin things, such as hair, may pass between the samples.
        let closed = ["box", "sphere"].contains(&name);
        assert!(!closed || found.len() * 2 > touched.len(), "{name}: sampling finds most of what is touched");
    }
}

#[test]
fn a_box_has_exactly_the_voxels_of_its_faces() {
    let color = [0.5, 0.25, 1.0];
    let mut scene = one_mesh(box_mesh(Vec3::splat(4.25), Vec3::splat(12.25)), plain(color));
    scene.materials[0].emissive = Vec3::new(3.0, 0.0, 0.75);
    let archive = baked(&scene, &metre_voxels(5));
    // Pixel centres 4.5 … 11.5 lie in the faces, which lie at 4.25 and 12.25.
    let mut expected = Voxels::new();
    for axis in 0..3 {
        for (a, b) in (4..12).flat_map(|a| (4..12).map(move |b| (a, b))) {
            for depth in [4, 12] {
                let mut voxel = [a; 3];
                voxel[axis] = depth;
                voxel[(axis + 1) % 3] = b;
                expected.insert(voxel);
            }
        }
    }
    assert_eq!(leaves(&archive), expected);

    let svo = archive.svo().unwrap();
    let deepest = svo.levels.last().unwrap();
    let srgb = color.map(|c| srgb_from_linear((f64::from(c) * 65535.0 + 0.5) as u16));
    assert!(deepest.colors.iter().all(|&found| found == srgb), "one colour everywhere");
    let radiance = rgb9e5::encode([3.0, 0.0, 0.75]);
    assert!(deepest.emissive.iter().all(|&found| found == radiance), "one radiance everywhere");
    for level in &svo.levels {
        assert!(level.colors.iter().all(|&found| found == srgb), "averages of one colour are that colour");
        assert!(level.emissive.iter().all(|&found| found == radiance));
    }
    let mut on_one_face = 0;
    for (node, cell) in svo.cells(5).into_iter().enumerate() {
        let sides: Vec<(usize, f64)> = (0..3)
            .flat_map(|axis| [(axis, 4, -1.0), (axis, 12, 1.0)])
            .filter(|&(axis, at, _)| {
                let covers = |other: usize| other == axis || (4..12).contains(&cell[other]);
                cell[axis] == at && (0..3).all(covers)
            })
            .map(|(axis, _, sign)| (axis, sign))
            .collect();
        if let [(axis, sign)] = sides[..] {
            let mut normal = [0.0; 3];
            normal[axis] = sign;
            assert_eq!(deepest.normals[node], octahedral::encode(normal), "{cell:?} faces outside");
            assert_eq!(deepest.cones[node], 0, "{cell:?}: all normals are equal");
            on_one_face += 1;
        } else {
            assert!(deepest.cones[node] > 0, "{cell:?} lies on an edge of the box");
        }
    }
    // Two faces per axis: two borders of the low one are shared with other low ones.
    assert_eq!(on_one_face, 3 * (7 * 7 + 8 * 8));
}

#[test]
fn a_floor_is_one_voxel_thick_and_complete() {
    let scene = one_mesh(floor_mesh(0.0, 32.0, 5.25), Material::default());
    let archive = baked(&scene, &metre_voxels(5));
    let expected: Voxels = (0..32).flat_map(|x| (0..32).map(move |z| [x, 5, z])).collect();
    assert_eq!(leaves(&archive), expected);
    let nodes: Vec<u64> = (0..=5).filter_map(|level| archive.svo_node_count(level)).collect();
    assert_eq!(nodes, [1, 4, 16, 64, 256, 1024]);
    // On a border between voxels the upper one is taken.
    let archive = baked(&one_mesh(floor_mesh(0.0, 32.0, 6.0), Material::default()), &metre_voxels(5));
    assert!(leaves(&archive).iter().all(|voxel| voxel[1] == 6));
    // The upper border of the cube belongs to the last voxel.
    let archive = baked(&one_mesh(floor_mesh(0.0, 32.0, 32.0), Material::default()), &metre_voxels(5));
    assert!(leaves(&archive).iter().all(|voxel| voxel[1] == 31));
}

#[test]
fn a_sphere_is_watertight_and_no_thicker_than_it_must_be() {
    let (center, radius) = (Vec3::new(16.2, 15.7, 16.0), 11.0);
    let scene = one_mesh(sphere_mesh(center, radius, 24), Material::default());
    let voxels = leaves(&baked(&scene, &metre_voxels(5)));
    for voxel in &voxels {
        let middle = Vec3::from_array(voxel.map(|c| c as f32 + 0.5));
        let distance = (middle.distance(center) - radius).abs();
        assert!(distance < 0.5 * 3.0f32.sqrt() + 0.1, "{voxel:?} is {distance} m from the sphere");
    }
    // From a corner, steps through faces of empty voxels do not lead inside.
    let mut outside = Voxels::from([[0; 3]]);
    let mut open = vec![[0; 3]];
    while let Some(voxel) = open.pop() {
        for (axis, step) in (0..3).flat_map(|axis| [(axis, -1), (axis, 1)]) {
            let mut next: [i32; 3] = voxel;
            next[axis] += step;
            if (0..32).contains(&next[axis]) && !voxels.contains(&next) && outside.insert(next) {
                open.push(next);
            }
        }
    }
    assert!(!outside.contains(&[16, 15, 16]), "a leak");
    let volume = 32 * 32 * 32 - outside.len() - voxels.len();
    let expected = 4.0 / 3.0 * std::f64::consts::PI * f64::from(radius).powi(3);
    assert!((volume as f64) < expected && volume as f64 > 0.8 * expected, "{volume} of {expected} inside");
}

#[test]
fn alpha_cuts_exactly_the_half_that_it_should() {
    let (material, texture) = cut_in_half();
    let mut scene = one_mesh(floor_mesh(0.0, 32.0, 5.25), material);
    scene.textures.push(texture);
    let archive = baked(&scene, &metre_voxels(5));
    let expected: Voxels = (16..32).flat_map(|x| (0..32).map(move |z| [x, 5, z])).collect();
    assert_eq!(leaves(&archive), expected);
    let svo = archive.svo().unwrap();
    let green = [0, 255, 0];
    assert!(svo.levels[5].colors.iter().all(|&color| color == green), "what is cut away lends no colour");
}

#[test]
fn inner_nodes_follow_from_their_children() {
    for (name, scene) in scenes() {
        let svo = baked(&scene, &small(RowsFrom::Points)).svo().unwrap();
        svo.validate().unwrap();
        for level in 0..svo.depth() as usize {
            let expected = reduce_level(svo.levels[level].child_masks.clone(), &svo.levels[level + 1]);
            assert_eq!(svo.levels[level], expected, "{name}, level {level}");
        }
    }
}

#[test]
fn instances_are_what_their_copies_would_be() {
    let mut mesh = sphere_mesh(Vec3::new(1.0, 2.0, 3.0), 0.75, 4);
    // Few digits, so that copies have exactly the same coordinates. The last place mirrors.
    for position in &mut mesh.positions {
        *position = (*position * 1024.0).round() / 1024.0;
    }
    let places = [
        DMat4::IDENTITY,
        DMat4::from_translation(DVec3::new(4.0, 0.5, -2.0)),
        DMat4::from_translation(DVec3::new(-1.0, 0.0, 8.0)) * DMat4::from_scale(DVec3::new(-2.0, 1.0, 0.5)),
    ];
    let mut instanced = one_mesh(mesh.clone(), plain([0.2, 0.4, 0.6]));
    instanced.instances =
        places.iter().map(|&world_from_object| Instance { mesh: 0, world_from_object }).collect();
    let mut copies = Scene { materials: instanced.materials.clone(), ..Scene::default() };
    for (number, place) in places.iter().enumerate() {
        let mirrors = place.determinant() < 0.0;
        copies.meshes.push(Mesh {
            positions: mesh
                .positions
                .iter()
                .map(|p| place.transform_point3(p.as_dvec3()).as_vec3())
                .collect(),
            triangles: mesh
                .triangles
                .iter()
                .map(|&[a, b, c]| if mirrors { [a, c, b] } else { [a, b, c] })
                .collect(),
            ..mesh.clone()
        });
        copies.instances.push(Instance { mesh: number as u32, world_from_object: DMat4::IDENTITY });
    }
    for (mesh, place) in copies.meshes.iter().zip(&places) {
        for (copy, original) in mesh.positions.iter().zip(&instanced.meshes[0].positions) {
            assert_eq!(copy.as_dvec3(), place.transform_point3(original.as_dvec3()), "copies are exact");
        }
    }
    for way in [RowsFrom::Points, RowsFrom::Peel, RowsFrom::Rotate] {
        let digests = |scene| geometry_digests(&baked(scene, &small(way)));
        assert_eq!(digests(&instanced), digests(&copies), "{way}");
    }
}

#[test]
fn a_scene_far_from_the_origin_has_the_voxels_that_it_has_there() {
    let scene = one_mesh(sphere_mesh(Vec3::splat(2.0), 1.5, 6), Material::default());
    // Multiples of every step that the cube may be snapped to, so that it moves along.
    let far = DVec3::new(57344.0, -28672.0, 3584.0);
    let mut options = small(RowsFrom::Points);
    options.levels = 7;
    let (here, there) = (baked(&scene, &options), baked(&moved(scene.clone(), far), &options));
    assert_eq!(here.svo_info().size, there.svo_info().size);
    assert!(leaves(&here) == leaves(&there));
}
