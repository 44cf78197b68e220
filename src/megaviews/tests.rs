use super::*;
use crate::views::splat::Canvas;
use manyview_shaders::cases::Random;
use manyview_shaders::scene_tree::SPHERE_OF_CUBE;
use manyview_shaders::svo::Svo;
use manyview_shaders::views::{PairStep, ViewNode, pair_step};
use std::f32::consts::{FRAC_PI_2, PI};

/// An octree of these leaves.
fn scene_of(depth: u32, cells: impl IntoIterator<Item = [u32; 3]>) -> SceneTree {
    let mut svo = Svo::of_cells([-8.0; 3], 16.0, depth, cells);
    for (number, level) in svo.levels.iter_mut().rev().enumerate() {
        for (i, color) in level.colors.iter_mut().enumerate() {
            *color = [i as u8, (i >> 8) as u8, number as u8];
        }
    }
    SceneTree::new(&svo, true)
}

/// Walls of a room of 2^depth voxels a side.
fn room(depth: u32) -> SceneTree {
    let last = (1u32 << depth) - 1;
    let walls = (0..3).flat_map(move |axis| {
        (0..=last).flat_map(move |a| {
            (0..=last).flat_map(move |b| {
                [0, last].map(|c| {
                    let mut cell = [a, b, c];
                    cell.rotate_left(axis);
                    cell
                })
            })
        })
    });
    scene_of(depth, walls)
}

fn scattered(depth: u32, count: u32, seed: u64) -> SceneTree {
    let mut random = Random::new(seed);
    let side = 1 << depth;
    scene_of(depth, (0..count).map(|_| [0; 3].map(|_| random.below(side))).collect::<Vec<_>>())
}

fn random_views(count: usize, reach: i32, half_angle: f32, seed: u64) -> Vec<View> {
    let mut random = Random::new(seed);
    let mut vector = |reach: i32| [0; 3].map(|_| random.range(-reach, reach) as f32 / 1000.0 + 1e-4);
    (0..count).map(|_| View::new(vector(reach), vector(1000), half_angle)).collect()
}

fn draw(scene: &SceneTree, sharing: Sharing, views: &[View], settings: &ViewSettings) -> ViewMaps {
    MegaViews::new(Arc::new(scene.clone())).with_sharing(sharing).render_views(views, settings).unwrap()
}

/// Breadth first as \[MV\] has it, with maps of all view nodes: the obvious version.
fn draw_breadth_first(
    scene: &SceneTree,
    tree: &ViewTree,
    settings: &ViewSettings,
) -> Vec<(Vec<f32>, Vec<u32>)> {
    let texels = TexelDirections::new(settings.resolution);
    let count = texel_count(settings.resolution);
    let mut maps = vec![(vec![f32::INFINITY; count], vec![u32::MAX; count]); tree.nodes.len()];
    let mut queue = vec![(NodeRef::ROOT, 0usize)];
    while !queue.is_empty() {
        let mut next = Vec::new();
        for (node, view_index) in queue {
            let view = &tree.nodes[view_index];
            let edge = scene.cell_size(scene.level(node));
            let offset = [0, 1, 2].map(|i| scene.cell_center(node)[i] - view.center[i]);
            let mean = [0, 1, 2].map(|i| scene.mean(node)[i] - view.center[i]);
            let scale = settings.scale();
            let (depths, nodes) = &mut maps[view_index];
            let mut canvas = Canvas { texels: &texels, depths, nodes };
            let radius = edge * SPHERE_OF_CUBE;
            match pair_step(offset, radius, node.is_leaf(), view, scale, settings.culling) {
                PairStep::Drop => {}
                PairStep::Point => canvas.point(mean, node.0),
                PairStep::Near if offset.iter().all(|c| c.abs() <= edge * 0.5) => {}
                PairStep::Near => canvas.leaf(offset, edge, node.0),
                PairStep::SplitScene => next.extend(scene.children(node).map(|child| (child, view_index))),
                PairStep::SplitViews => next.extend(view.range().map(|child| (node, child))),
            }
        }
        queue = next;
    }
    for index in 0..tree.nodes.len() {
        for child in tree.nodes[index].range().filter(|_| !tree.nodes[index].is_leaf()) {
            let offset = [0, 1, 2].map(|i| tree.nodes[child].center[i] - tree.nodes[index].center[i]);
            let (parent, mut own) = (maps[index].clone(), maps[child].clone());
            let before = own.0.clone();
            texels.fuse(&mut own.0, &parent.0, offset);
            for t in 0..count {
                own.1[t] = if own.0[t] == before[t] { own.1[t] } else { parent.1[t] };
            }
            maps[child] = own;
        }
    }
    maps
}

#[test]
fn depth_first_draws_what_breadth_first_draws() {
    for (scene, views) in [
        (room(5), random_views(300, 7000, FRAC_PI_2, 1)),
        (room(6), random_views(40, 9000, PI, 2)),
        (scattered(7, 3000, 3), random_views(500, 3000, 0.7, 4)),
        (scattered(3, 40, 3), random_views(200, 20_000, 1.2, 5)),
    ] {
        for sharing in [Sharing::Voxel, Sharing::None] {
            for texels in [0.5, 1.5] {
                let settings = ViewSettings { with_colors: true, texels, ..ViewSettings::default() };
                let sorted = SortedViews::new(&views, &scene);
                let tree = ViewTree::new(&views, &sorted.order, &sorted.keys, scene.depth, sharing);
                let expected = draw_breadth_first(&scene, &tree, &settings);
                let maps = draw(&scene, sharing, &views, &settings);
                for leaf in tree.nodes.iter().enumerate().filter(|(_, node)| node.is_leaf()) {
                    check_leaf(&scene, &sorted.order, leaf, &expected, &maps);
                }
            }
        }
    }
}

fn check_leaf(
    scene: &SceneTree,
    order: &[u32],
    (index, node): (usize, &ViewNode),
    expected: &[(Vec<f32>, Vec<u32>)],
    maps: &ViewMaps,
) {
    let (depths, nodes) = &expected[index];
    for place in node.range() {
        let view = order[place] as usize;
        let map = maps.map_of()[view] as usize;
        assert_eq!(maps.centers()[map], node.center);
        for (t, &expected) in depths.iter().enumerate() {
            let found = maps.depth(map, t);
            let same = found == expected || (found - expected).abs() <= 1e-5 * expected;
            assert!(same, "view {view}, texel {t}: {found}, not {expected}");
            if found == expected && nodes[t] != u32::MAX {
                let color = scene.colors[scene.color_index(NodeRef(nodes[t]))];
                assert_eq!(maps.colors()[map * depths.len() + t], color);
            }
        }
    }
}

/// By its stages too, whose maps may differ in rounding: along edges of near leaves, and where nodes are equally near.
#[test]
fn stages_give_the_same_colours() {
    let mut texels_of_all = [0usize; 4];
    for (scene, views) in [
        (room(5), random_views(300, 7000, FRAC_PI_2, 51)),
        (room(6), random_views(40, 9000, PI, 52)),
        (scattered(7, 3000, 3), random_views(500, 3000, 0.7, 53)),
        (scattered(3, 40, 3), random_views(200, 20_000, 1.2, 54)),
    ] {
        for (sharing, half_depths) in
            [(Sharing::Voxel, false), (Sharing::None, false), (Sharing::Voxel, true)]
        {
            let settings = ViewSettings { with_colors: true, half_depths, ..ViewSettings::default() };
            let expected = draw(&scene, sharing, &views, &settings);
            let stages = gpu::MegaViewsGpu::on_twins(&scene).unwrap().with_sharing(sharing);
            let found = stages.render_views(&views, &settings).unwrap();
            let count = texel_count(settings.resolution);
            for view in 0..views.len() {
                let [a, b] = [&found, &expected].map(|maps| maps.map_of()[view] as usize);
                for t in 0..count {
                    let (depth, color) = (found.depth(a, t), found.colors()[a * count + t]);
                    let (other_depth, other) = (expected.depth(b, t), expected.colors()[b * count + t]);
                    let close = depth == other_depth || (depth - other_depth).abs() <= 1e-5 * other_depth;
                    texels_of_all[0] += 1;
                    texels_of_all[1] += usize::from(depth.is_finite());
                    texels_of_all[2] += usize::from(!close);
                    texels_of_all[3] += usize::from(color != other);
                }
            }
        }
    }
    let [all, filled, far, colored] = texels_of_all;
    assert!(filled > all / 10, "{filled} of {all} show something");
    assert!(
        far * 10_000 < all && colored * 10_000 < all,
        "{far} depths and {colored} colours of {all} differ"
    );
}

#[test]
fn one_voxel_is_seen_where_it_is() {
    let scene = scene_of(6, [[40, 32, 32]]);
    let views = [View::around([0.1, 0.1, 0.1])];
    let maps = draw(&scene, Sharing::Voxel, &views, &ViewSettings::new(16));
    let depths = maps.view_depths(0);
    let filled: Vec<usize> = (0..512).filter(|&t| depths[t].is_finite()).collect();
    assert_eq!(filled, [8 * 16 + 8]);
    assert!((depths[filled[0]] - 2.025).abs() < 0.13, "{}", depths[filled[0]]);
    // A voxel's width away it fills what rays meet.
    let near = draw(&scene, Sharing::Voxel, &[View::around([1.8, 0.125, 0.125])], &ViewSettings::new(64));
    let depths = near.view_depths(0);
    assert!((depths[32 * 64 + 32] - 0.2).abs() < 1e-3);
    assert!(depths.iter().filter(|d| d.is_finite()).count() > 200);
}

#[test]
fn a_room_is_closed_and_as_far_as_its_walls() {
    let scene = room(8);
    // Nodes that fill a texel may leave one out beside them.
    for (texels, most_holes) in [(1.0, 8), (1.5, 400)] {
        let mut holes = 0;
        let settings = ViewSettings { texels, ..ViewSettings::new(32) };
        let views = random_views(50, 6000, PI, 9);
        let maps = draw(&scene, Sharing::Voxel, &views, &settings);
        let directions = TexelDirections::new(32);
        for (view, origin) in views.iter().enumerate() {
            let depths = maps.view_depths(view);
            for t in (0..2048).filter(|&t| manyview_shaders::paraboloid::is_inside(t, 32)) {
                let d = directions.direction(t as usize);
                let inner = 8.0 - scene.voxel_size() * 0.5;
                let exact = (0..3)
                    .map(|i| (inner * d[i].signum() - origin.position[i]) / d[i])
                    .fold(f32::INFINITY, f32::min);
                let found = depths[t as usize];
                // A texel is a sixteenth of a radian: at a flat angle it spans some depth.
                holes += usize::from(found == f32::INFINITY);
                assert!(
                    found == f32::INFINITY || (found / exact - 1.0).abs() < 0.5,
                    "{t}: {found}, not {exact}"
                );
            }
        }
        assert!(holes <= most_holes, "{holes} of 80,000 with {texels} texels");
    }
}

#[test]
fn culling_changes_nothing_that_a_view_sees() {
    let scene = room(6);
    for half_angle in [0.3, FRAC_PI_2, 2.5] {
        let views = random_views(200, 7000, half_angle, 11);
        let on = draw(&scene, Sharing::Voxel, &views, &ViewSettings::default());
        let off =
            draw(&scene, Sharing::Voxel, &views, &ViewSettings { culling: false, ..ViewSettings::default() });
        let directions = TexelDirections::new(16);
        let mut differing = 0;
        for (i, view) in views.iter().enumerate() {
            let (axis, [cosine, _]) = view.cone();
            let (on, off) = (on.view_depths(i), off.view_depths(i));
            for t in 0..512 {
                let d = directions.direction(t);
                // Texels wholly inside: half a texel's diagonal is 0.18 radians in the middle of a half.
                let angle = (0..3).map(|i| d[i] * axis[i]).sum::<f32>().clamp(-1.0, 1.0).acos();
                match angle + 0.18 < cosine.acos() {
                    true => assert_eq!(on[t], off[t], "view {i}, texel {t}"),
                    false => differing += usize::from(on[t] != off[t]),
                }
            }
        }
        assert!(differing > 1000, "culling did something");
    }
}

#[test]
fn passes_threads_and_vector_instructions_change_nothing() {
    let scene = scattered(7, 4000, 21);
    let mut views = random_views(400, 7000, FRAC_PI_2, 22);
    views[17].position[1] = f32::NAN;
    let settings = ViewSettings { with_colors: true, ..ViewSettings::default() };
    let whole = draw(&scene, Sharing::Voxel, &views, &settings);
    let texels = texel_count(16) as u64;
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    one_thread.install(|| {
        let budget_bytes = 400 * BYTES_PER_VIEW + MAPS_PER_THREAD * 8 * texels + 37 * 12 * texels;
        let small = ViewSettings { budget_bytes, ..settings };
        let mut passes = 0;
        let mut all = ViewMaps::new(&settings);
        let renderer = MegaViews::new(Arc::new(scene.clone())).with_simd(SimdLevel::Portable);
        let sink: &mut PassSink<'_> = &mut |pass| {
            assert!(pass.bytes() <= budget_bytes);
            passes += 1;
            all.append(pass);
            Ok(())
        };
        renderer.render_passes(&views, &small, sink).unwrap();
        all.sort();
        assert!(passes > 5, "{passes}");
        assert_eq!(all.centers(), whole.centers());
        assert_eq!(all, whole);
        let error =
            renderer.render_views(&views, &ViewSettings { budget_bytes: 1000, ..settings }).unwrap_err();
        assert!(matches!(error, ViewError::Budget { .. }), "{error}");
    });
}

#[test]
fn views_alone_are_drawn_as_if_there_were_no_others() {
    let scene = scattered(7, 4000, 41);
    let views = random_views(60, 7000, FRAC_PI_2, 42);
    let settings = ViewSettings { with_colors: true, ..ViewSettings::default() };
    let together = draw(&scene, Sharing::Alone, &views, &settings);
    for (i, view) in views.iter().enumerate() {
        let alone = draw(&scene, Sharing::None, &[*view], &settings);
        assert_eq!(together.view_depths(i), alone.view_depths(0));
    }
}

#[test]
fn sharing_is_counted() {
    let scene = room(6);
    let views = vec![View::around([0.1, 0.2, 0.3]); 10];
    let count = |sharing: Sharing| {
        let renderer = MegaViews::new(Arc::new(scene.clone())).with_sharing(sharing);
        renderer.render_counted(&views, &ViewSettings::default(), &mut |_| Ok(())).unwrap()
    };
    let (shared, alone) = (count(Sharing::Voxel), count(Sharing::Alone));
    assert_eq!((shared.views, shared.view_nodes, shared.sharing), (10, 1, 10.0));
    assert_eq!((alone.view_nodes, alone.sharing), (11, 1.0));
    assert_eq!(alone.points, 10 * shared.points);
}

#[test]
fn sixteen_bits_hold_depths_to_a_two_thousandth() {
    let scene = room(5);
    let views = random_views(30, 7000, PI, 31);
    let full = draw(&scene, Sharing::Voxel, &views, &ViewSettings::default());
    let half =
        draw(&scene, Sharing::Voxel, &views, &ViewSettings { half_depths: true, ..ViewSettings::default() });
    assert!(half.bytes() < full.bytes() * 6 / 10);
    for view in 0..views.len() {
        for (a, b) in full.view_depths(view).iter().zip(half.view_depths(view)) {
            assert!(*a == b || (a - b).abs() <= a / 2048.0);
        }
    }
}

#[test]
fn odd_views_have_defined_maps() {
    let scene = room(4);
    let settings = ViewSettings::new(8);
    let renderer = MegaViews::new(Arc::new(scene.clone()));
    assert_eq!(renderer.render_views(&[], &settings).unwrap().views().len(), 0);
    let views = [
        View::around([f32::NAN; 3]),
        View::around([100.0, 0.0, 0.0]),
        View::new([0.0; 3], [0.0; 3], 0.5),
        View::new([0.0; 3], [f32::NAN, 0.0, 0.0], f32::NAN),
        View::new([0.0; 3], [1.0, 0.0, 0.0], -1.0),
        View::around([-1e15, 3.0, 0.0]),
    ];
    for sharing in [Sharing::Voxel, Sharing::None] {
        let maps = draw(&scene, sharing, &views, &settings);
        assert_eq!(maps.views(), [0, 1, 2, 3, 4, 5]);
        assert_eq!(maps.map_of()[0], ViewMaps::NO_MAP);
        let filled = |view: usize| maps.view_depths(view).iter().filter(|d| d.is_finite()).count();
        assert!(filled(1) > 0 && filled(1) < 10, "the room is small from afar: {}", filled(1));
        assert_eq!(filled(2), filled(3));
        assert!(filled(2) > 90);
        assert_eq!(filled(5), 1);
    }
    let same = vec![View::around([1.0, 1.0, 1.0]); 1000];
    assert_eq!(draw(&scene, Sharing::Voxel, &same, &settings).centers().len(), 1);
    let uncolored = SceneTree { colors: Vec::new(), ..scene };
    let colors = ViewSettings { with_colors: true, ..settings };
    let error = MegaViews::new(Arc::new(uncolored)).render_views(&same, &colors).unwrap_err();
    assert!(matches!(error, ViewError::Unsupported { .. }));
}

/// Unfused queries are fused maps, bit for bit.
#[test]
fn queries_without_fusion_see_what_fused_maps_show() {
    let scene = scattered(7, 3000, 3);
    let mut views = random_views(300, 3000, 1.2, 4);
    views[17].position[1] = f32::NAN;
    // Some in one voxel.
    views[40].position = views[41].position;
    let settings = ViewSettings::default();
    for sharing in [Sharing::Voxel, Sharing::None, Sharing::Alone] {
        let fused = draw(&scene, sharing, &views, &settings);
        let renderer = MegaViews::new(Arc::new(scene.clone())).with_sharing(sharing);
        let unfused = renderer.render_unfused(&views, &settings).unwrap();
        assert!(unfused.bytes() > 2048 * fused.centers().len() as u64, "inner maps too");
        for view in 0..views.len() {
            let queried: Vec<f32> = (0..512).map(|texel| unfused.depth(view, texel)).collect();
            assert_eq!(queried, fused.view_depths(view), "{sharing:?}, view {view}");
        }
    }
}

#[test]
fn maps_of_all_nodes_must_fit() {
    let renderer = MegaViews::new(Arc::new(room(5)));
    let views = random_views(100, 7000, PI, 2);
    let error =
        renderer.render_unfused(&views, &ViewSettings { budget_bytes: 1 << 17, ..ViewSettings::default() });
    assert!(error.unwrap_err().to_string().contains("the maps of all nodes"));
    assert_eq!(renderer.render_unfused(&[], &ViewSettings::default()).unwrap().bytes(), 0);
    assert!(renderer.render_unfused(&views, &ViewSettings::new(12)).is_err());
}
