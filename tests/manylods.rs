//! ManyLoDs against known answers, brute force, odd views and itself.

mod support;

use glam::Vec3;
use manyview::manylods::{CutState, PointCutState, PointCuts, Steps, SvoCuts};
use manyview::views::splat::{Canvas, TexelDirections};
use manyview::views::{Depths, View, ViewError, ViewMaps, ViewRenderer, ViewSettings};
use manyview_shaders::paraboloid::{is_inside, texel, texel_count, texel_direction};
use manyview_shaders::scene_tree::{NodeRef, SceneTree};
use manyview_shaders::views::ViewNode;
use std::collections::BTreeSet;
use std::f32::consts::{FRAC_PI_2, PI};
use std::sync::Arc;
use support::{Numbers, octree};

fn cuts(depth: u32, voxels: &[[u32; 3]]) -> SvoCuts {
    let size = f64::from(1 << depth);
    SvoCuts::new(Arc::new(SceneTree::new(&octree([0.0; 3], size, depth, voxels), true)))
}

/// The faces of a room whose inside is 1 … side − 1.
fn room(side: u32) -> Vec<[u32; 3]> {
    let all = (0..side.pow(3)).map(|i| [i % side, i / side % side, i / side / side]);
    all.filter(|cell| cell.iter().any(|&c| c == 0 || c == side - 1)).collect()
}

fn scattered(side: u32, count: usize, numbers: &mut Numbers) -> Vec<[u32; 3]> {
    (0..count).map(|_| [(); 3].map(|()| (numbers.unit() * f64::from(side)) as u32)).collect()
}

/// Views in and around a cube, some all around, some narrow.
fn views(count: usize, side: f32, numbers: &mut Numbers) -> Vec<View> {
    let mut views: Vec<View> = (0..count)
        .map(|i| {
            let mut number = |low: f32, high: f32| low + numbers.unit() as f32 * (high - low);
            let reach = if i % 7 == 6 { 2.0 * side } else { 0.0 };
            let position = [(); 3].map(|()| number(-reach, side + reach));
            let axis = [(); 3].map(|()| number(-1.0, 1.0));
            View::new(position, axis, [PI, FRAC_PI_2, 0.6, 0.1][i % 4])
        })
        .collect();
    if count > 5 {
        views[2].position = views[1].position;
        views[3].axis = [0.0; 3];
        views[4].position[1] = f32::NAN;
        views[5].half_angle = f32::NAN;
    }
    views
}

fn full(maps: &ViewMaps) -> &[f32] {
    match maps.depths() {
        Depths::Full(depths) => depths,
        Depths::Half(_) => panic!("depths in full were asked for"),
    }
}

#[test]
fn a_single_voxel_is_where_it_is() {
    let cuts = cuts(6, &[[40, 20, 33]]);
    let middle = [40.5f32, 20.5, 33.5];
    for (position, culling) in
        [([1.0, 2.0, 3.0], true), ([100.0, -30.0, 60.0], true), ([40.5, 20.5, 70.0], false)]
    {
        let offset = [0, 1, 2].map(|i: usize| middle[i] - position[i]);
        let length = offset.iter().map(|c| c * c).sum::<f32>().sqrt();
        let settings = ViewSettings { culling, with_colors: true, ..ViewSettings::new(16) };
        let maps = cuts.render_views(&[View::around(position)], &settings).unwrap();
        let at = texel(offset, length, 16) as usize;
        for (i, &depth) in full(&maps).iter().enumerate() {
            // A node's mean is kept to 1024ths of its edge.
            let right = if i == at { (depth - length).abs() < 64.0 / 1024.0 } else { depth == f32::INFINITY };
            assert!(right, "{position:?}: {depth} in {i}, not {length} in {at}");
            assert_eq!(maps.colors()[i] != [0; 4], i == at);
        }
    }
}

#[test]
fn a_room_has_walls_all_around() {
    let cuts = cuts(6, &room(64));
    for resolution in [8, 16, 32, 64, 128] {
        let position = [32.0, 30.0, 35.0];
        let maps = cuts.render_views(&[View::around(position)], &ViewSettings::new(resolution)).unwrap();
        let mut empty = 0;
        for t in (0..texel_count(resolution) as u32).filter(|&t| is_inside(t, resolution)) {
            let direction = texel_direction(t, resolution);
            // Where the ray leaves the inside of the room.
            let exact = (0..3)
                .map(|i| {
                    let wall = if direction[i] > 0.0 { 63.0 } else { 1.0 };
                    (wall - position[i]) / direction[i]
                })
                .fold(f32::INFINITY, f32::min);
            let depth = maps.depth(0, t as usize);
            empty += u32::from(depth == f32::INFINITY);
            // Walls are a voxel thick, and a texel spans some of a slanted one.
            let slack = 1.5 + exact * 8.0 / resolution as f32;
            assert!(
                depth == f32::INFINITY || (depth - exact).abs() < slack,
                "{resolution}: {depth} not {exact}"
            );
        }
        // Nodes of less than a texel may miss some.
        assert!(empty * 8 < texel_count(resolution) as u32, "{resolution}: {empty} empty");
    }
}

#[test]
fn a_plane_next_to_a_view_is_closed() {
    let plane: Vec<[u32; 3]> = (0..64 * 64).map(|i| [i % 64, i / 64, 20]).collect();
    let cuts = cuts(6, &plane);
    let settings = ViewSettings { texels: 0.25, ..ViewSettings::new(16) };
    for height in [21.2f32, 23.0, 19.4] {
        let view = View::around([32.2, 31.7, height]);
        let maps = cuts.render_views(&[view], &settings).unwrap();
        for t in (0..512).filter(|&t| is_inside(t, 16)) {
            let direction = texel_direction(t, 16);
            let (top, steep) = if height > 20.5 { (21.0, -direction[2]) } else { (20.0, direction[2]) };
            let exact = (top - height).abs() / steep;
            let depth = maps.depth(0, t as usize);
            if steep > 0.3 && exact < 30.0 {
                assert!((depth - exact).abs() <= 1.0 + 0.25 * exact, "{height} {t}: {depth} not {exact}");
            }
            if steep < -0.5 {
                assert_eq!(depth, f32::INFINITY, "nothing is on the other side");
            }
        }
    }
}

/// Every leaf drawn by itself.
fn brute_force(tree: &SceneTree, view: &View, resolution: u32) -> Vec<f32> {
    let texels = TexelDirections::new(resolution);
    let mut depths = vec![f32::INFINITY; texel_count(resolution)];
    let mut canvas = Canvas { texels: &texels, depths: &mut depths, nodes: &mut [] };
    let mut nodes = vec![NodeRef::ROOT];
    while let Some(node) = nodes.pop() {
        nodes.extend(tree.children(node));
        let center = tree.cell_center(node);
        let offset = [0, 1, 2].map(|i: usize| center[i] - view.position[i]);
        let edge = tree.voxel_size();
        if node.is_leaf() && offset.iter().any(|c| c.abs() > edge * 0.5) {
            canvas.leaf(offset, edge, 0);
        }
    }
    depths
}

#[test]
fn fine_cuts_are_brute_force() {
    let mut numbers = Numbers(3);
    for depth in 1..=5 {
        let cuts = cuts(depth, &scattered(1 << depth, 40 * depth as usize, &mut numbers));
        for resolution in [8, 32] {
            // Points of nearly no texels: all leaves are near.
            let settings = ViewSettings { texels: 1e-4, culling: false, ..ViewSettings::new(resolution) };
            let views = views(12, (1 << depth) as f32, &mut numbers);
            let maps = cuts.render_views(&views, &settings).unwrap();
            for (i, view) in views.iter().enumerate() {
                if view.is_drawable() {
                    assert_eq!(maps.view_depths(i), brute_force(cuts.tree(), view, resolution), "{view:?}");
                }
            }
        }
    }
}

#[test]
fn odd_views_are_drawn_or_empty() {
    let cuts = cuts(5, &room(32));
    let settings = ViewSettings::new(8);
    let mut passes = 0;
    cuts.render_passes(&[], &settings, &mut |_| {
        passes += 1;
        Ok(())
    })
    .unwrap();
    assert_eq!(passes, 0);
    let mut odd = vec![View::around([16.0; 3]); 9];
    odd[1].position[0] = f32::NAN;
    odd[2].position[2] = f32::INFINITY;
    odd[3].axis = [f32::NAN; 3];
    odd[4].half_angle = f32::NAN;
    odd[5].position = [-1e6, 0.0, 0.0];
    odd[6].position = [1e17, -1e17, 0.0];
    odd[7].position = [1e19, 0.0, 0.0];
    let maps = cuts.render_views(&odd, &settings).unwrap();
    let drawn = |i: usize| maps.view_depths(i).iter().filter(|d| d.is_finite()).count();
    assert!(drawn(0) > 50);
    for i in [3, 4, 8] {
        assert_eq!(maps.view_depths(i), maps.view_depths(0));
    }
    for i in [1, 2, 7] {
        assert_eq!((drawn(i), maps.map_of()[i]), (0, ViewMaps::NO_MAP));
    }
    assert_eq!([drawn(5), drawn(6)], [1, 1], "all in one texel");
    // In the middle of a voxel, on its face and on its corner.
    for position in [[0.5, 16.5, 16.5], [1.0, 16.5, 16.5], [1.0, 1.0, 1.0], [0.0; 3]] {
        let maps = cuts.render_views(&[View::around(position)], &settings).unwrap();
        assert!(full(&maps).iter().all(|d| *d > 0.0), "{position:?}");
        assert!(full(&maps).iter().any(|d| d.is_finite()));
    }
}

#[test]
fn passes_threads_and_half_depths_change_nothing() {
    let mut numbers = Numbers(11);
    let cuts = cuts(6, &room(64));
    let views = views(200, 64.0, &mut numbers);
    let settings = ViewSettings { with_colors: true, ..ViewSettings::new(16) };
    let all = cuts.render_views(&views, &settings).unwrap();
    for threads in [1, 2, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert_eq!(pool.install(|| cuts.render_views(&views, &settings)).unwrap(), all);
        let (mut passes, mut together) = (0, ViewMaps::new(&settings));
        let tight = ViewSettings { budget_bytes: 70_000, ..settings };
        pool.install(|| {
            cuts.render_passes(&views, &tight, &mut |pass| {
                assert!(pass.bytes() <= tight.budget_bytes);
                passes += 1;
                together.append(pass);
                Ok(())
            })
        })
        .unwrap();
        assert!(passes > 10 && together == all, "{passes} passes on {threads} threads");
    }
    let half = cuts.render_views(&views, &ViewSettings { half_depths: true, ..settings }).unwrap();
    for (i, &depth) in full(&all).iter().enumerate() {
        let rounded = half.depth(i / 512, i % 512);
        assert!(rounded == depth || (rounded - depth).abs() <= depth * 5e-4);
    }
    let error = cuts.render_views(&views, &ViewSettings { budget_bytes: 9000, ..settings }).unwrap_err();
    let ViewError::Budget { needed_bytes, .. } = error else { panic!("{error}") };
    assert!(
        cuts.render_passes(&views, &ViewSettings { budget_bytes: needed_bytes, ..settings }, &mut |_| Ok(()))
            .is_ok()
    );
}

#[test]
fn culling_changes_no_texel_inside_the_field() {
    let mut numbers = Numbers(17);
    let cuts = cuts(6, &room(64));
    let views = views(120, 64.0, &mut numbers);
    let settings = ViewSettings::new(32);
    let culled = cuts.render_views(&views, &settings).unwrap();
    let all = cuts.render_views(&views, &ViewSettings { culling: false, ..settings }).unwrap();
    let (mut same, mut dropped) = (0, 0);
    for (i, view) in views.iter().enumerate().filter(|(_, view)| view.is_drawable()) {
        let node = ViewNode::of_view(view, 0);
        let (with, without) = (culled.view_depths(i), all.view_depths(i));
        for t in 0..texel_count(32) {
            // What is drawn in a texel lies up to a texel's width beside its middle.
            if is_inner(texel_direction(t as u32, 32), &node) {
                assert_eq!(with[t], without[t], "{view:?} {t}");
                same += usize::from(with[t].is_finite());
            } else {
                dropped += usize::from(with[t] != without[t]);
            }
        }
    }
    assert!(same > 1000 && dropped > 1000, "{same} {dropped}");
}

/// Whether a direction lies a texel's width inside of a view's field.
fn is_inner(direction: [f32; 3], node: &ViewNode) -> bool {
    let along: f32 = (0..3).map(|i| direction[i] * node.axis[i]).sum();
    let half_angle = node.sin_psi.atan2(node.cos_psi);
    along.clamp(-1.0, 1.0).acos() < half_angle - 0.2
}

fn set(nodes: Vec<NodeRef>) -> BTreeSet<NodeRef> {
    let count = nodes.len();
    let set: BTreeSet<NodeRef> = nodes.into_iter().collect();
    assert_eq!(set.len(), count, "nothing is drawn twice");
    set
}

#[test]
fn incremental_cuts_are_basic_cuts() {
    let mut numbers = Numbers(23);
    let cuts = cuts(7, &room(128));
    let settings = ViewSettings::new(16);
    let mut state = CutState::new();
    let mut views = views(40, 128.0, &mut numbers);
    views[4].position = [3.0; 3];
    for frame in 0..40 {
        for (place, view) in views.iter_mut().enumerate() {
            // Some stand, some walk, some jump.
            let step = [0.0, 0.1, 2.0, 60.0][place % 4];
            view.position =
                view.position.map(|c| (c + (numbers.unit() as f32 * 2.0 - 1.0) * step).clamp(-40.0, 160.0));
            let kept = set(cuts.advance_cut(&mut state, place, view, &settings, Steps::All));
            assert_eq!(kept, set(cuts.cut(view, &settings)), "frame {frame}, {view:?}");
        }
    }
}

#[test]
fn lazy_cuts_get_there() {
    let mut numbers = Numbers(29);
    let cuts = cuts(7, &room(128));
    let settings = ViewSettings::new(16);
    let mut state = CutState::new();
    let mut views: Vec<View> = views(30, 128.0, &mut numbers);
    views[4].position = [3.0; 3];
    for round in 0..4 {
        for view in &mut views {
            view.position = view.position.map(|c| c + (numbers.unit() as f32 - 0.5) * 30.0);
        }
        let basic = cuts.render_views(&views, &settings).unwrap();
        let mut frames = 0;
        loop {
            let (maps, stats) = cuts.render_frame(&mut state, &views, &settings, Steps::AtMost(1)).unwrap();
            frames += 1;
            assert!(stats.list_bytes == state.bytes() && stats.drawn > 0);
            if maps == basic {
                break;
            }
            assert!(frames < 16, "round {round}: as many frames as there are edges to walk");
        }
        assert!(round > 0 || frames > 3, "it takes some frames from the root");
        let (maps, _) = cuts.render_frame(&mut state, &views, &settings, Steps::All).unwrap();
        assert_eq!(maps, basic);
    }
    // More views, then fewer.
    let more: Vec<View> = views.iter().chain(&views).copied().collect();
    let (maps, _) = cuts.render_frame(&mut state, &more, &settings, Steps::All).unwrap();
    assert_eq!(maps, cuts.render_views(&more, &settings).unwrap());
    let (maps, _) = cuts.render_frame(&mut state, &views[..3], &settings, Steps::All).unwrap();
    assert_eq!(maps, cuts.render_views(&views[..3], &settings).unwrap());
    let tight = ViewSettings { budget_bytes: 20_000, ..settings };
    let error = cuts.render_frame(&mut state, &views, &tight, Steps::All).unwrap_err();
    assert!(matches!(error, ViewError::Budget { .. }), "{error}");
}

#[test]
fn what_lists_take_is_told() {
    let cuts = cuts(6, &room(64));
    let settings = ViewSettings::new(16);
    let views = vec![View::around([32.0; 3]); 10];
    let stats = cuts.render_counted(&views, &settings, &mut |_| Ok(())).unwrap();
    let drawn = cuts.cut(&views[0], &settings).len() as u64;
    assert_eq!(stats.drawn, 10 * drawn);
    assert!(stats.visited > stats.drawn && stats.list_bytes > 0);
    assert!(stats.paper_list_bytes >= 8 * stats.drawn);
}

/// The inside of a cube of edge 8 around the origin, and a small triangle in it.
fn box_of_triangles() -> Vec<[Vec3; 3]> {
    let corner = |i: u32| Vec3::from_array([0, 1, 2].map(|axis| if i >> axis & 1 == 1 { 4.0 } else { -4.0 }));
    let faces = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
    let mut triangles: Vec<[Vec3; 3]> =
        faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]].map(|t| t.map(corner))).collect();
    triangles.push([Vec3::new(1.0, 0.0, 2.0), Vec3::new(1.5, 0.0, 2.0), Vec3::new(1.0, 0.5, 2.0)]);
    triangles
}

#[test]
fn points_show_a_box_and_follow_it() {
    let mut triangles = box_of_triangles();
    let mut cuts = PointCuts::new(&triangles, 15, 1).unwrap();
    let settings = ViewSettings::new(16);
    for scale in [1.0f32, 2.0] {
        let position = [0.5, -1.0, -0.25];
        let maps = cuts.render_views(&[View::around(position)], &settings).unwrap();
        let (mut empty, mut wrong) = (0, 0);
        for t in (0..512).filter(|&t| is_inside(t, 16)) {
            let direction = texel_direction(t, 16);
            let exact = (0..3)
                .map(|i| (4.0 * scale * direction[i].signum() - position[i]) / direction[i])
                .fold(f32::INFINITY, f32::min);
            let depth = maps.depth(0, t as usize);
            empty += u32::from(depth == f32::INFINITY);
            wrong += u32::from(depth.is_finite() && (depth - exact).abs() > 0.35 * exact);
        }
        assert!(empty < 10 && wrong < 20, "{scale}: {empty} empty, {wrong} wrong");
        triangles.iter_mut().flatten().for_each(|p| *p *= 2.0);
        cuts.update(&triangles);
    }
    assert!(PointCuts::new(&[], 3, 1).is_none());
}

#[test]
fn kept_cuts_of_points_are_basic_cuts_also_of_moving_ones() {
    let mut numbers = Numbers(31);
    let mut triangles = box_of_triangles();
    let mut cuts = PointCuts::new(&triangles, 13, 1).unwrap();
    let settings = ViewSettings::new(16);
    let mut state = PointCutState::new();
    let mut views = views(24, 6.0, &mut numbers);
    for frame in 0..12 {
        for (place, view) in views.iter_mut().enumerate() {
            let step = [0.0, 0.05, 0.5, 3.0][place % 4];
            view.position = view.position.map(|c| c - 0.2 + (numbers.unit() as f32 * 2.0 - 1.0) * step);
        }
        if frame % 3 == 2 {
            triangles.iter_mut().flatten().for_each(|p| p.x += 0.1 * p.y);
            cuts.update(&triangles);
        }
        let basic = cuts.render_views(&views, &settings).unwrap();
        let (maps, stats) = cuts.render_frame(&mut state, &views, &settings, Steps::All).unwrap();
        assert!(maps == basic && stats.drawn > 0, "frame {frame}");
    }
    for view in &mut views {
        view.position = view.position.map(|c| c * 0.7);
    }
    let basic = cuts.render_views(&views, &settings).unwrap();
    let lazy =
        |state: &mut PointCutState| cuts.render_frame(state, &views, &settings, Steps::AtMost(1)).unwrap().0;
    assert!((0..40).any(|_| lazy(&mut state) == basic), "lazy cuts get there");
    let tight = ViewSettings { budget_bytes: 60_000, ..settings };
    let (mut passes, mut together) = (0, ViewMaps::new(&settings));
    cuts.render_passes(&views, &tight, &mut |pass| {
        passes += 1;
        together.append(pass);
        Ok(())
    })
    .unwrap();
    assert!(together == basic && passes > 1);
}
