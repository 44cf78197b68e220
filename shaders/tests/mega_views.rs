//! MegaViews by the twins of its stages, against known answers and against a walk written down recursively. Needs no GPU.

use manyview_shaders::cases::Random;
use manyview_shaders::executor::CpuExecutor;
use manyview_shaders::jobs::mega_views::{
    MegaViewsDevice, MegaViewsSettings, PassMaps, PassResult, Room, SortedOrder,
};
use manyview_shaders::mega_views::{NO_NUMBER, SceneParams, ViewCone, flag, half_bits};
use manyview_shaders::paraboloid::{is_inside, texel, texel_count, texel_direction};
use manyview_shaders::scene_tree::{NodeRef, SPHERE_OF_CUBE, SceneTree};
use manyview_shaders::svo::Svo;
use manyview_shaders::views::{PairStep, View, ViewNode, pair_step};

const SETTINGS: MegaViewsSettings = MegaViewsSettings::new(16);
const ROOM: Room = Room { nodes: 3000, pairs: 200_000, near: 100_000 };

/// The octree of some voxels over a cube of edge 8 around the origin.
fn scene(depth: u32, voxels: &[[u32; 3]]) -> SceneTree {
    SceneTree::new(&Svo::of_cells([-4.0; 3], 8.0, depth, voxels.iter().copied()), false)
}

/// The walls of a room of `2^depth` voxels a side.
fn room(depth: u32) -> SceneTree {
    let last = (1u32 << depth) - 1;
    let all = (0..=last).flat_map(|x| (0..=last).flat_map(move |y| (0..=last).map(move |z| [x, y, z])));
    let walls: Vec<_> = all.filter(|cell| cell.iter().any(|&c| c == 0 || c == last)).collect();
    scene(depth, &walls)
}

fn random_views(count: usize, seed: u64, reach: i32) -> Vec<View> {
    let mut random = Random::new(seed);
    let mut vector = |reach: i32| [0; 3].map(|_| random.range(-reach, reach) as f32 / 1000.0);
    (0..count).map(|i| View::new(vector(reach), vector(1000), (i % 5) as f32 * 0.8)).collect()
}

fn cones(views: &[View]) -> Vec<ViewCone> {
    views.iter().map(ViewCone::from).collect()
}

fn device(scene: &SceneTree) -> MegaViewsDevice<'static> {
    MegaViewsDevice::new(Box::new(CpuExecutor::default()), scene).unwrap()
}

fn draw(scene: &SceneTree, views: &[View], settings: &MegaViewsSettings) -> (SortedOrder, PassMaps) {
    let mut device = device(scene);
    let sorted = device.sort(&cones(views)).unwrap();
    match device.pass(0, views.len() as u32, settings, ROOM).unwrap() {
        PassResult::Maps(maps) => (sorted, maps),
        PassResult::NoRoom(flags) => panic!("no room: {flags}"),
    }
}

fn length(v: [f32; 3]) -> f32 {
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
}

/// The distance at which a ray from the origin enters a cube.
fn enters(direction: [f32; 3], center: [f32; 3], edge: f32) -> Option<f64> {
    let (mut enter, mut exit) = (0.0f64, f64::INFINITY);
    for i in 0..3 {
        let [a, b] = [-0.5, 0.5].map(|s| f64::from(center[i] + s * edge) / f64::from(direction[i]));
        (enter, exit) = (enter.max(a.min(b)), exit.min(a.max(b)));
    }
    (enter <= exit).then_some(enter)
}

#[test]
fn keys_are_sorted_and_equal_ones_keep_their_order() {
    let scene = room(3);
    let params = SceneParams::new(&scene);
    for count in [1, 2, 255, 257, 70_000] {
        let mut views = random_views(count, 1 + count as u64, 5000);
        let copies = views.len() / 3;
        views[copies..2 * copies].iter_mut().for_each(|view| view.position = [1.0, 2.0, 3.0]);
        let sorted = device(&scene).sort(&cones(&views)).unwrap();
        let mut expected: Vec<(u64, u32)> = (0..)
            .zip(&views)
            .map(|(i, view)| {
                let [low, high] = params.key(view.position);
                (u64::from(high) << 30 | u64::from(low), i)
            })
            .collect();
        expected.sort_unstable();
        let found: Vec<(u64, u32)> = sorted
            .keys
            .iter()
            .zip(&sorted.order)
            .map(|(&[low, high], &view)| (u64::from(high) << 30 | u64::from(low), view))
            .collect();
        assert_eq!(found, expected, "{count}");
    }
    assert_eq!(params.key([-4.0; 3]), [0; 2]);
    assert_eq!(params.key([9.0, 4.0, 1e9]), [(1 << 30) - 1, (1 << 9) - 1]);
    assert_eq!(params.key([3.9999, -4.0, -1e9]), [0o1_111_111_111, 0o111]);
}

#[test]
fn one_voxel_is_seen_where_it_is() {
    // The cell [6, 3, 5] of 8 has its middle at [2.5, -0.5, 1.5].
    let scene = scene(3, &[[6, 3, 5]]);
    for (position, resolution) in
        [([0.0, 0.1, 0.2], 16), ([-3.0, 2.0, -1.0], 64), ([2.5, -0.5, 2.3], 16), ([20.0, 3.0, -30.0], 8)]
    {
        let settings = MegaViewsSettings { resolution, ..SETTINGS };
        let (_, maps) = draw(&scene, &[View::around(position)], &settings);
        assert_eq!((maps.nodes.len(), maps.depths.len()), (1, texel_count(resolution)));
        let center = [0, 1, 2].map(|i| [2.5, -0.5, 1.5][i] - position[i]);
        let middle = texel(center, length(center), resolution) as usize;
        for (t, &depth) in maps.depths.iter().enumerate() {
            let depth = f32::from_bits(depth);
            let hit = enters(texel_direction(t as u32, resolution), center, 1.0)
                .filter(|_| is_inside(t as u32, resolution));
            match hit {
                _ if t == middle => assert!(depth <= length(center) * 1.001, "{position:?} {depth}"),
                // A leaf that fills less than a texel is a point.
                Some(_) if maps.pairs[1] == 0 => assert_eq!(depth, f32::INFINITY),
                Some(distance) => assert!((f64::from(depth) - distance).abs() < 1e-4, "{position:?} {t}"),
                None => assert_eq!(depth, f32::INFINITY, "{position:?} {t}"),
            }
        }
    }
}

#[test]
fn a_room_is_closed() {
    let scene = room(5);
    let views =
        [View::around([0.1, 0.2, 0.3]), View::around([-2.0, 1.0, 3.0]), View::around([2.0, -3.0, 1.0])];
    let (_, maps) = draw(&scene, &views, &SETTINGS);
    let mut leaf = 0;
    for node in maps.nodes.iter().filter(|node| node.is_leaf()) {
        for t in (0..512u32).filter(|&t| is_inside(t, 16)) {
            let depth = f32::from_bits(maps.depths[leaf * 512 + t as usize]);
            let d = texel_direction(t, 16);
            // The inner faces are 3.75 from the middle. What is nearest in a texel is at most half its diagonal, 0.18, beside
            // the middle.
            let place = [0, 1, 2].map(|i| (node.center[i] + d[i] * depth).abs());
            let outermost = place[0].max(place[1]).max(place[2]);
            let slack = 0.18 * depth + 0.01;
            assert!(outermost > 3.75 - slack && outermost < 4.0 + slack, "{t}: {depth}, {place:?}");
        }
        leaf += 1;
    }
    assert_eq!(leaf, 3);
}

/// The traversal, written down recursively: for every texel of every node's map its depth and what it shows.
struct Walk<'a> {
    scene: &'a SceneTree,
    nodes: &'a [ViewNode],
    settings: MegaViewsSettings,
    maps: Vec<Vec<(f32, u32)>>,
    near: u32,
}

impl Walk<'_> {
    fn pair(&mut self, s: NodeRef, v: usize) {
        let view = self.nodes[v];
        let edge = self.scene.cell_size(self.scene.level(s));
        let center = self.scene.cell_center(s);
        let offset = [0, 1, 2].map(|i| center[i] - view.center[i]);
        let radius = edge * SPHERE_OF_CUBE;
        let scale = self.settings.resolution as f32 / self.settings.texels;
        match pair_step(offset, radius, s.is_leaf(), &view, scale, self.settings.culling) {
            PairStep::Drop => {}
            PairStep::Point => {
                let mean = self.scene.mean(s);
                self.draw_point(v, [0, 1, 2].map(|i| mean[i] - view.center[i]), s);
            }
            PairStep::Near if offset.iter().all(|c| c.abs() <= edge * 0.5) => {}
            PairStep::Near => {
                self.near += 1;
                self.draw_point(v, offset, s);
                for t in 0..texel_count(self.settings.resolution) as u32 {
                    let direction = texel_direction(t, self.settings.resolution);
                    if let Some(distance) = enters(direction, offset, edge)
                        && is_inside(t, self.settings.resolution)
                    {
                        self.keep(v, t, distance as f32, s);
                    }
                }
            }
            PairStep::SplitViews => view.range().for_each(|child| self.pair(s, child)),
            PairStep::SplitScene => self.scene.children(s).for_each(|child| self.pair(child, v)),
        }
    }

    fn draw_point(&mut self, v: usize, offset: [f32; 3], s: NodeRef) {
        let length = length(offset);
        if length > 0.0 {
            self.keep(v, texel(offset, length, self.settings.resolution), length, s);
        }
    }

    fn keep(&mut self, v: usize, texel: u32, depth: f32, s: NodeRef) {
        let kept = &mut self.maps[v][texel as usize];
        if depth < kept.0 || depth == kept.0 && s.0 < kept.1 {
            *kept = (depth, s.0);
        }
    }

    fn fuse(&mut self) {
        for (index, node) in self.nodes.iter().enumerate() {
            for child in if node.is_leaf() { 0..0 } else { node.range() } {
                let offset = [0, 1, 2].map(|i| self.nodes[child].center[i] - node.center[i]);
                for t in 0..self.maps[index].len() {
                    let (depth, number) = self.maps[index][t];
                    let d = texel_direction(t as u32, self.settings.resolution);
                    if depth < f32::INFINITY {
                        let moved = length([0, 1, 2].map(|i| d[i] * depth - offset[i]));
                        if moved < self.maps[child][t].0 {
                            self.maps[child][t] = (moved, number);
                        }
                    }
                }
            }
        }
    }
}

/// Share of texels whose depths differ by more than a hundred thousandth part, and of those that show something else.
fn differing(found: &PassMaps, expected: &[(f32, u32)]) -> [f64; 2] {
    let (mut depths, mut numbers) = (0, 0);
    for ((&bits, &number), expected) in found.depths.iter().zip(&found.numbers).zip(expected) {
        let depth = f32::from_bits(bits);
        let close = depth == expected.0 || (depth - expected.0).abs() <= 1e-5 * expected.0;
        depths += usize::from(!close);
        numbers += usize::from(number != expected.1);
        assert_eq!(depth == f32::INFINITY, number == NO_NUMBER);
    }
    [depths, numbers].map(|count| count as f64 / expected.len() as f64)
}

#[test]
fn maps_are_those_of_a_recursive_walk() {
    for (scene, reach) in [(room(5), 3700), (scene(4, &[[1, 2, 3], [9, 9, 9], [15, 0, 4]]), 9000)] {
        for settings in [
            SETTINGS,
            MegaViewsSettings { culling: false, sharing: false, ..SETTINGS },
            MegaViewsSettings { resolution: 8, texels: 3.0, ..SETTINGS },
        ] {
            let views = random_views(300, 5, reach);
            let settings = MegaViewsSettings { with_numbers: true, ..settings };
            let (sorted, found) = draw(&scene, &views, &settings);
            check_tree(&scene, &views, &sorted, &found, settings.sharing);
            let empty = (f32::INFINITY, NO_NUMBER);
            let maps = vec![vec![empty; texel_count(settings.resolution)]; found.nodes.len()];
            let mut walk = Walk { scene: &scene, nodes: &found.nodes, settings, maps, near: 0 };
            walk.pair(NodeRef::ROOT, 0);
            walk.fuse();
            assert_eq!(walk.near, found.pairs[1]);
            let leaves = found.nodes.iter().zip(&walk.maps).filter(|(node, _)| node.is_leaf());
            let expected: Vec<(f32, u32)> = leaves.flat_map(|(_, map)| map.iter().copied()).collect();
            assert_eq!([expected.len(); 2], [found.depths.len(), found.numbers.len()]);
            assert!(expected.iter().filter(|(depth, _)| depth.is_finite()).count() > 300);
            // Rays along edges of near leaves hit or miss by rounding, and of leaves side by side either may be nearer.
            let shares = differing(&found, &expected);
            assert!(shares[0] < 1e-4 && shares[1] < 1e-3, "{shares:?}");
        }
    }
}

/// Every view in one leaf; nodes are cut as they should be, and enclose what they hold.
fn check_tree(scene: &SceneTree, views: &[View], sorted: &SortedOrder, maps: &PassMaps, sharing: bool) {
    let key = |place: usize| u64::from(sorted.keys[place][1]) << 30 | u64::from(sorted.keys[place][0]);
    let voxel_shift = 3 * (13 - scene.depth);
    let mut next_place = 0;
    let mut stack = vec![0usize];
    while let Some(index) = stack.pop() {
        let node = &maps.nodes[index];
        if !node.is_leaf() {
            assert!((2..=8).contains(&node.len()) && node.range().start > index);
            stack.extend(node.range().rev());
            continue;
        }
        let range = node.range();
        assert_eq!(range.start, next_place);
        next_place = range.end;
        let shares = sharing && key(range.start) >> voxel_shift == key(range.end - 1) >> voxel_shift;
        assert!(node.len() == 1 || shares, "{range:?}");
        for place in range {
            let view = &views[sorted.order[place] as usize];
            let away = length([0, 1, 2].map(|i| view.position[i] - node.center[i]));
            assert!(away <= node.radius * 1.0001 + 1e-6);
            assert!(node.len() > 1 || (away == 0.0 && node.radius == 0.0));
        }
    }
    assert_eq!(next_place, views.len());
    assert_eq!(maps.level_starts.last().copied(), Some(maps.nodes.len() as u32));
    assert!(maps.nodes.len() < 2 * views.len().max(1));
}

#[test]
fn views_at_one_point_make_no_deep_tree() {
    let scene = room(3);
    let views = vec![View::around([1.0, 1.1, 1.2]); 20_000];
    let (sorted, maps) = draw(&scene, &views, &SETTINGS);
    check_tree(&scene, &views, &sorted, &maps, true);
    assert_eq!(maps.nodes.len(), 9, "eight leaves of 2500");
    assert!(maps.depths.chunks(512).all(|map| map == &maps.depths[..512]));
    let (sorted, maps) = draw(&scene, &views[..100], &MegaViewsSettings { sharing: false, ..SETTINGS });
    check_tree(&scene, &views[..100], &sorted, &maps, false);
    assert_eq!(maps.nodes.iter().filter(|node| node.is_leaf()).count(), 100);
}

#[test]
fn too_little_room_is_noticed_whatever_it_is_of() {
    let scene = room(5);
    let views = random_views(500, 9, 3700);
    let mut device = device(&scene);
    device.sort(&cones(&views)).unwrap();
    let settings = MegaViewsSettings { sharing: false, with_numbers: true, ..SETTINGS };
    let PassResult::Maps(whole) = device.pass(0, 500, &settings, ROOM).unwrap() else { panic!() };
    let room = Room { nodes: whole.nodes.len() as u32, pairs: whole.pairs[0], near: whole.pairs[1] };
    assert_eq!(device.pass(0, 500, &settings, room).unwrap(), PassResult::Maps(whole.clone()));
    for (less, expected) in [
        (Room { nodes: room.nodes - 1, ..room }, flag::NODES),
        (Room { nodes: 3, ..room }, flag::NODES),
        (Room { pairs: room.pairs - 1, ..room }, flag::PAIRS),
        (Room { near: room.near - 1, ..room }, flag::NEAR),
    ] {
        assert_eq!(device.pass(0, 500, &settings, less).unwrap(), PassResult::NoRoom(expected));
    }
    // The device goes on working, and a part of the run is a pass of its own.
    let PassResult::Maps(part) = device.pass(100, 1, &settings, ROOM).unwrap() else { panic!() };
    assert_eq!((part.nodes.len(), part.depths.len()), (1, 512));
    assert_eq!(device.pass(0, 500, &settings, room).unwrap(), PassResult::Maps(whole));
}

#[test]
fn half_depths_are_the_nearest_halves() {
    for (float, half) in [
        (0.0, 0),
        (1.0, 0x3c00),
        (65504.0, 0x7bff),
        (65519.99, 0x7bff),
        (65520.0, 0x7c00),
        (f32::INFINITY, 0x7c00),
        // 2^-14, 2^-24, half of it (to even), and a little more than half.
        (6.103_515_6e-5, 0x400),
        (5.960_464_5e-8, 1),
        (2.980_232_2e-8, 0),
        (2.980_233e-8, 1),
        // Ties between 1 and 1 + 2^-10, and between that and 1 + 2^-9.
        (1.0 + 1.0 / 2048.0, 0x3c00),
        (1.0 + 3.0 / 2048.0, 0x3c02),
    ] {
        assert_eq!(half_bits(f32::to_bits(float)), half, "{float}");
    }
    let scene = room(4);
    let views = random_views(50, 3, 3700);
    let (_, full) = draw(&scene, &views, &SETTINGS);
    let (_, half) = draw(&scene, &views, &MegaViewsSettings { half_depths: true, ..SETTINGS });
    let pairs = full.depths.chunks(2).map(|pair| half_bits(pair[0]) | half_bits(pair[1]) << 16);
    assert_eq!(half.depths, pairs.collect::<Vec<_>>());
}

#[test]
fn numbers_change_no_depth_and_are_the_same_for_halves() {
    let scene = room(4);
    let views = random_views(50, 3, 3700);
    let (_, without) = draw(&scene, &views, &SETTINGS);
    let with_numbers = MegaViewsSettings { with_numbers: true, ..SETTINGS };
    let (_, full) = draw(&scene, &views, &with_numbers);
    assert!(without.numbers.is_empty());
    assert_eq!(PassMaps { numbers: Vec::new(), ..full.clone() }, without);
    assert_eq!(full.numbers.len(), full.depths.len());
    let (_, half) = draw(&scene, &views, &MegaViewsSettings { half_depths: true, ..with_numbers });
    let (_, half_without) = draw(&scene, &views, &MegaViewsSettings { half_depths: true, ..SETTINGS });
    assert_eq!((half.depths, half.numbers), (half_without.depths, full.numbers));
}
