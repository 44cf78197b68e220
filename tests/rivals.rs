//! The rivals of the row method: known answers, brute force, and shaders against their twins.
//!
//! Without an adapter the tests of shaders are reported as ignored, or as failed if `MANYVIEW_REQUIRE_GPU` is 1.
//! `MANYVIEW_ADAPTER` chooses among adapters.

use glam::{DMat4, DVec3, Vec3};
use libtest_mimic::{Arguments, Failed, Trial};
use manyview::Archive;
use manyview::gpu::{AdapterChoice, GpuContext, WgpuExecutor};
use manyview::preview::{Octree, Ray};
use manyview::reference::{Reference, intersect_triangle};
use manyview::rivals::brickmap::{self, BrickmapBias, BrickmapVisibility};
use manyview::rivals::bvh::{BvhVisibility, ExactVisibility};
use manyview::rivals::ism::{IsmOptions, IsmVisibility};
use manyview::rivals::wide_bvh::WideBvh;
use manyview::visibility::{LightPoint, Receiver, Segment, Visibility, VisibilityError, light_words};
use manyview_pipeline::bake::{BakeOptions, bake_in_memory};
use manyview_pipeline::generate::{SceneKind, generate};
use manyview_pipeline::scene::{Instance, Material, Mesh, Scene};
use manyview_pipeline::triangles::{Cutouts, LatticeTriangles};
use manyview_shaders::cases::Random;
use manyview_shaders::device::DeviceError;
use manyview_shaders::executor::{CpuExecutor, Executor, ExecutorLimits};
use manyview_shaders::svo::Svo;
use std::sync::OnceLock;

fn main() {
    let arguments = Arguments::from_args();
    let required = std::env::var("MANYVIEW_REQUIRE_GPU").is_ok_and(|value| value == "1");
    let opened = GpuContext::open(&AdapterChoice::from_env());
    let reason = match &opened {
        Ok(context) => {
            eprintln!("adapter: {}", context.name());
            String::new()
        }
        Err(error) => {
            eprintln!("no adapter: {error}");
            error.to_string()
        }
    };
    static CONTEXT: OnceLock<Option<GpuContext>> = OnceLock::new();
    let found = CONTEXT.get_or_init(|| opened.ok()).is_some();
    type Check = fn() -> Result<(), Failed>;
    let checks: [(&str, Check); 9] = [
        ("a_plane_hides_what_is_behind_it", a_plane_hides_what_is_behind_it),
        ("a_closed_room_leaks_nothing", a_closed_room_leaks_nothing),
        ("a_sphere_is_hit_between_its_radii", a_sphere_is_hit_between_its_radii),
        ("rooms_see_each_other_through_the_door", rooms_see_each_other_through_the_door),
        ("trees_find_what_testing_every_triangle_finds", trees_find_what_testing_every_triangle_finds),
        ("a_brickmap_finds_the_octrees_cells", a_brickmap_finds_the_octrees_cells),
        ("what_is_no_segment_is_not_occluded", what_is_no_segment_is_not_occluded),
        ("imperfect_shadow_maps_are_not_far_off", imperfect_shadow_maps_are_not_far_off),
        ("what_does_not_fit_is_an_error", what_does_not_fit_is_an_error),
    ];
    let mut trials: Vec<Trial> = checks.into_iter().map(|(name, check)| Trial::test(name, check)).collect();
    type GpuCheck = fn(&'static GpuContext) -> Result<(), Failed>;
    let gpu_checks: [(&str, GpuCheck); 2] = [
        ("shaders_equal_their_twins", shaders_equal_their_twins),
        ("shaders_have_known_answers_too", shaders_have_known_answers_too),
    ];
    trials.extend(gpu_checks.map(|(name, check)| {
        let reason = reason.clone();
        Trial::test(name, move || match CONTEXT.get().and_then(Option::as_ref) {
            Some(context) => check(context),
            None => Err(format!("MANYVIEW_REQUIRE_GPU is 1, but {reason}").into()),
        })
        .with_ignored_flag(!found && !required)
    }));
    libtest_mimic::run(&arguments, trials).exit();
}

macro_rules! ensure {
    ($condition:expr, $($text:tt)+) => {
        if !$condition {
            return Err(format!($($text)+).into());
        }
    };
}

/// A scene, its exact answers and its octree.
struct Place {
    scene: Scene,
    cutouts: Cutouts,
    drawn: LatticeTriangles,
    svo: Svo,
}

impl Place {
    fn new(scene: Scene, levels: u32) -> Result<Self, Failed> {
        let options = BakeOptions { levels, rows: None, ..BakeOptions::default() };
        let archive = Archive::from_bytes(bake_in_memory(&scene, &options)?)?;
        let cutouts = Cutouts::new(&scene);
        let drawn = LatticeTriangles::new(&scene, &cutouts, |_| [0; 3]);
        Ok(Self { svo: archive.svo_levels(..)?, cutouts, drawn, scene })
    }

    fn of_quads(quads: &[[[f32; 3]; 4]], levels: u32) -> Result<Self, Failed> {
        let mut mesh = Mesh::default();
        for quad in quads {
            let first = mesh.positions.len() as u32;
            mesh.positions.extend(quad.map(Vec3::from_array));
            mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
        Self::of_mesh(mesh, levels)
    }

    fn of_mesh(mesh: Mesh, levels: u32) -> Result<Self, Failed> {
        let instances = vec![Instance { mesh: 0, world_from_object: DMat4::IDENTITY }];
        let materials = vec![Material::default()];
        Self::new(Scene { meshes: vec![mesh], instances, materials, ..Scene::default() }, levels)
    }

    fn reference(&self) -> Reference<'_> {
        Reference::new(&self.scene, &self.drawn, &self.cutouts)
    }

    /// Edge of a cell of the octree, metres.
    fn voxel(&self) -> f64 {
        self.svo.size / f64::from(1u32 << self.svo.depth())
    }
}

/// Methods whose answers are those of the triangles, and methods whose answers are those of the octree's cells.
type Methods<'a> = [Vec<Box<dyn Visibility + 'a>>; 2];

fn twins<'a>() -> Result<Box<dyn Executor + Send + 'a>, DeviceError> {
    Ok(Box::new(CpuExecutor::default()))
}

fn methods<'a>(place: &'a Place, reference: &'a Reference<'a>) -> Result<Methods<'a>, Failed> {
    let map = brickmap::from_svo(&place.svo, u32::MAX, brickmap::DEFAULT_BIAS);
    Ok([
        vec![
            Box::new(ExactVisibility::new(reference)),
            Box::new(BvhVisibility::new(reference)),
            Box::new(WideBvh::new(reference).on_executor(twins()?)?),
        ],
        vec![Box::new(brickmap::on_executor(&map, twins()?)?), Box::new(BrickmapVisibility::new(map))],
    ])
}

fn gpu_methods<'a>(
    place: &Place,
    reference: &Reference,
    context: &'a GpuContext,
) -> Result<Methods<'a>, Failed> {
    let executor = || Box::new(WgpuExecutor::new(context, ExecutorLimits::DEFAULT));
    let map = brickmap::from_svo(&place.svo, u32::MAX, brickmap::DEFAULT_BIAS);
    Ok([
        vec![Box::new(WideBvh::new(reference).on_executor(executor())?)],
        vec![Box::new(brickmap::on_executor(&map, executor())?)],
    ])
}

fn uniform(random: &mut Random) -> f64 {
    f64::from(random.below(1 << 24)) / f64::from(1 << 24)
}

fn point_in(random: &mut Random, min: DVec3, max: DVec3) -> DVec3 {
    min + (max - min) * DVec3::new(uniform(random), uniform(random), uniform(random))
}

fn free(origin: DVec3, target: DVec3) -> Segment {
    Segment { origin: origin.as_vec3().to_array(), target: target.as_vec3().to_array(), normal: [0.0; 3] }
}

/// Compares a method with known distances (`None` where nothing is hit) within `tolerance` metres.
fn expect(
    method: &dyn Visibility,
    segments: &[Segment],
    known: &[Option<f64>],
    tolerance: f64,
) -> Result<(), Failed> {
    let mut occluded = vec![9; segments.len()];
    method.occluded(segments, &mut occluded)?;
    let mut distances = vec![0.0; segments.len()];
    method.distances(segments, &mut distances)?;
    for (((segment, known), occluded), distance) in segments.iter().zip(known).zip(occluded).zip(distances) {
        let name = method.name();
        ensure!(occluded == u8::from(known.is_some()), "{name}: {occluded}, not {known:?}: {segment:?}");
        match known {
            Some(known) => {
                let error = (f64::from(distance) - known).abs();
                ensure!(error <= tolerance, "{name}: {distance} m, not {known}: {segment:?}");
            }
            None => ensure!(distance == f32::INFINITY, "{name}: hit at {distance}: {segment:?}"),
        }
    }
    Ok(())
}

/// `known` of a segment, or `None` if an approximation by cells may answer either way.
type Known<'a> = dyn Fn(DVec3, DVec3, f64) -> Option<Option<f64>> + 'a;

/// Asks all methods of a place about the same segments. `known` is told how far from a border of things it must keep.
fn expect_all(
    place: &Place,
    [exact, cells]: &Methods,
    ends: &[(DVec3, DVec3)],
    known: &Known,
) -> Result<(), Failed> {
    for (methods, margin, tolerance) in
        [(exact, 1e-4, 1e-4), (cells, 3.0 * place.voxel(), 24.0 * place.voxel())]
    {
        let asked: Vec<_> =
            ends.iter().filter_map(|&(a, b)| known(a, b, margin).map(|k| (free(a, b), k))).collect();
        ensure!(asked.len() * 2 > ends.len(), "only {} of {} segments are certain", asked.len(), ends.len());
        let (segments, known): (Vec<_>, Vec<_>) = asked.into_iter().unzip();
        let hits = known.iter().flatten().count();
        ensure!(hits * 20 > known.len(), "only {hits} of {} segments hit anything", known.len());
        for method in methods {
            expect(&**method, &segments, &known, tolerance)?;
        }
    }
    Ok(())
}

fn plane() -> Result<Place, Failed> {
    // Off the borders of cells.
    let h = 0.013;
    Place::of_quads(&[[[-5.0, h, -5.0], [5.0, h, -5.0], [5.0, h, 5.0], [-5.0, h, 5.0]]], 8)
}

fn a_plane_hides_what_is_behind_it() -> Result<(), Failed> {
    let place = plane()?;
    let reference = place.reference();
    plane_answers(&place, &methods(&place, &reference)?)
}

fn plane_answers(place: &Place, methods: &Methods) -> Result<(), Failed> {
    let mut random = Random::new(1);
    let corner = DVec3::new(6.0, 4.0, 6.0);
    let ends: Vec<_> = (0..2000)
        .map(|_| (point_in(&mut random, -corner, corner), point_in(&mut random, -corner, corner)))
        .collect();
    expect_all(place, methods, &ends, &|a, b, margin| {
        let (from, to) = (a.y - 0.013, b.y - 0.013);
        if from.abs() < margin || to.abs() < margin {
            return None;
        }
        if from * to > 0.0 {
            return Some(None);
        }
        let share = from / (from - to);
        let at = a + (b - a) * share;
        let border = at.x.abs().max(at.z.abs()) - 5.0;
        // A flat ray stays long in the cells of the plane.
        let slope = (b - a).length() / (b.y - a.y).abs();
        let uncertain = border.abs() < margin * slope || slope > 8.0;
        (!uncertain).then_some((border < 0.0).then_some((at - a).length()))
    })
}

/// The six sides of a box, whose walls lie off the borders of cells.
fn box_quads(min: [f32; 3], max: [f32; 3]) -> Vec<[[f32; 3]; 4]> {
    let mut quads = Vec::new();
    for axis in 0..3 {
        for side in [min[axis], max[axis]] {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            quads.push([(min[u], min[v]), (max[u], min[v]), (max[u], max[v]), (min[u], max[v])].map(
                |(a, b)| {
                    let mut p = [side; 3];
                    (p[u], p[v]) = (a, b);
                    p
                },
            ));
        }
    }
    quads
}

fn room() -> Result<Place, Failed> {
    Place::of_quads(&box_quads([-2.0, -1.0, -1.5], [2.1, 1.3, 1.7]), 7)
}

fn a_closed_room_leaks_nothing() -> Result<(), Failed> {
    let place = room()?;
    let reference = place.reference();
    room_answers(&methods(&place, &reference)?)
}

fn room_answers(methods: &Methods) -> Result<(), Failed> {
    let mut random = Random::new(2);
    let (min, max) = (DVec3::new(-2.0, -1.0, -1.5), DVec3::new(2.1, 1.3, 1.7));
    let mut out = Vec::new();
    while out.len() < 20_000 {
        let from = point_in(&mut random, min * 0.9, max * 0.9);
        let to = point_in(&mut random, min * 3.0, max * 3.0);
        if (to - to.clamp(min, max)).length() > 0.2 {
            // Some along axes and into corners.
            let to = match out.len() % 8 {
                0 => DVec3::new(to.x, from.y, from.z).max(DVec3::new(2.5, from.y, from.z)),
                1 => from + (max - from) * 1.5,
                _ => to,
            };
            out.push(free(from, to));
            out.push(free(to, from));
        }
    }
    let within: Vec<Segment> = (0..5000)
        .map(|_| {
            free(point_in(&mut random, min * 0.9, max * 0.9), point_in(&mut random, min * 0.9, max * 0.9))
        })
        .collect();
    for method in methods.iter().flatten() {
        let mut occluded = vec![0; out.len()];
        method.occluded(&out, &mut occluded)?;
        if let Some(leak) = occluded.iter().position(|&o| o == 0) {
            return Err(format!("{}: {:?} leaks", method.name(), out[leak]).into());
        }
        let mut occluded = vec![0; within.len()];
        method.occluded(&within, &mut occluded)?;
        ensure!(!occluded.contains(&1), "{}: something is in the empty room", method.name());
    }
    Ok(())
}

fn a_sphere_is_hit_between_its_radii() -> Result<(), Failed> {
    // Meridians and parallels, radius 1.5: facets lie at most 1 % inside.
    let (rings, sectors) = (40u32, 80u32);
    let mut mesh = Mesh::default();
    for ring in 0..=rings {
        for sector in 0..=sectors {
            let (sine, cosine) = (std::f32::consts::PI * ring as f32 / rings as f32).sin_cos();
            let (s, c) = (std::f32::consts::TAU * sector as f32 / sectors as f32).sin_cos();
            mesh.positions.push(Vec3::new(sine * c, cosine, sine * s) * 1.5);
        }
    }
    for ring in 0..rings {
        for sector in 0..sectors {
            let at = ring * (sectors + 1) + sector;
            let below = at + sectors + 1;
            mesh.triangles.extend([[at, below, below + 1], [at, below + 1, at + 1]]);
        }
    }
    let place = Place::of_mesh(mesh, 8)?;
    let reference = place.reference();
    let methods = methods(&place, &reference)?;
    let mut random = Random::new(3);
    let corner = DVec3::splat(2.5);
    let ends: Vec<_> = (0..2000)
        .map(|_| (point_in(&mut random, -corner, corner), point_in(&mut random, -corner, corner)))
        .filter(|(a, b)| a.length() > 1.6 && b.length() > 1.6)
        .collect();
    expect_all(&place, &methods, &ends, &|a, b, margin| {
        let direction = (b - a).normalize();
        let along = -a.dot(direction);
        let nearest = (a + direction * along.clamp(0.0, (b - a).length())).length();
        if nearest > 1.5 + margin {
            return Some(None);
        }
        // Rays that graze the sphere may answer either way; those in the middle are known within the facets' sagitta,
        // which only the tolerance of cells covers, so that distances are compared with the exact method's.
        (nearest < 1.3).then(|| {
            let exact = reference.intersect(a, b - a, 1.0).expect("hits the sphere");
            let ideal = along - (1.5f64.powi(2) - nearest.powi(2)).sqrt();
            let found = exact.t * (b - a).length();
            assert!((found - ideal).abs() < 0.03, "{found} {ideal}");
            Some(found)
        })
    })
}

/// Two rooms side by side along x, and a door in the wall between them: x = 0.03, |z| < 0.5, y < 1.
fn two_rooms() -> Result<Place, Failed> {
    let mut quads = box_quads([-4.0, -1.0, -2.0], [4.1, 2.0, 2.1]);
    let x = 0.03;
    let wall =
        |y: [f32; 2], z: [f32; 2]| [[x, y[0], z[0]], [x, y[1], z[0]], [x, y[1], z[1]], [x, y[0], z[1]]];
    quads.extend([
        wall([-1.0, 2.0], [-2.0, -0.5]),
        wall([-1.0, 2.0], [0.5, 2.1]),
        wall([1.0, 2.0], [-0.5, 0.5]),
    ]);
    Place::of_quads(&quads, 8)
}

fn rooms_see_each_other_through_the_door() -> Result<(), Failed> {
    let place = two_rooms()?;
    let reference = place.reference();
    rooms_answers(&place, &methods(&place, &reference)?)
}

fn rooms_answers(place: &Place, methods: &Methods) -> Result<(), Failed> {
    let mut random = Random::new(4);
    let (min, max) = (DVec3::new(-3.8, -0.8, -1.8), DVec3::new(3.9, 1.8, 1.9));
    let ends: Vec<_> = (0..3000)
        .map(|_| {
            let mut from = point_in(&mut random, min, max);
            from.x = -from.x.abs().min(3.5) - 0.2;
            let mut to = point_in(&mut random, min, max);
            to.x = to.x.abs().min(3.5) + 0.2;
            if random.below(2) == 0 { (from, to) } else { (to, from) }
        })
        .collect();
    expect_all(place, methods, &ends, &|a, b, margin| {
        let share = (0.03 - a.x) / (b.x - a.x);
        let at = a + (b - a) * share;
        let slope = (b - a).length() / (b.x - a.x).abs();
        let outside = (at.z.abs() - 0.5).max(at.y - 1.0);
        let certain = outside.abs() > margin * slope && slope < 8.0;
        certain.then_some((outside > 0.0).then_some((at - a).length()))
    })
}

fn forest() -> Result<Place, Failed> {
    let place = Place::new(generate(SceneKind::Forest, 3000, 5), 8)?;
    ensure!(!place.cutouts.masks.is_empty(), "the forest has no cut-out leaves");
    Ok(place)
}

fn random_segments(place: &Place, seed: u64, count: usize) -> Vec<Segment> {
    let mut random = Random::new(seed);
    let (min, max) = place.scene.bounds().expect("triangles");
    let point = |random: &mut Random| point_in(random, min, max);
    (0..count).map(|_| free(point(&mut random), point(&mut random))).collect()
}

fn trees_find_what_testing_every_triangle_finds() -> Result<(), Failed> {
    let place = forest()?;
    let reference = place.reference();
    let [trees, _] = methods(&place, &reference)?;
    let segments = random_segments(&place, 6, 1500);
    let known: Vec<Option<f64>> = segments
        .iter()
        .map(|segment| {
            let [origin, target] = [segment.origin, segment.target].map(|p| Vec3::from_array(p).as_dvec3());
            let hit = |(i, triangle): (usize, &[DVec3; 3])| {
                let (t, weights) = intersect_triangle(triangle, origin, target - origin)?;
                (t > 0.0 && t < 1.0 && reference.exists(i as u32, weights)).then_some(t)
            };
            let nearest = reference.triangles().iter().enumerate().filter_map(hit).min_by(f64::total_cmp);
            nearest.map(|t| t * (target - origin).length())
        })
        .collect();
    let hits = known.iter().flatten().count();
    ensure!((150..1350).contains(&hits), "{hits} of 1500 segments hit something");
    for tree in trees {
        let mut occluded = vec![9; segments.len()];
        tree.occluded(&segments, &mut occluded)?;
        let mut distances = vec![0.0; segments.len()];
        tree.distances(&segments, &mut distances)?;
        let mut wrong = 0;
        for ((known, occluded), distance) in known.iter().zip(occluded).zip(distances) {
            let far = (f64::from(distance) - known.unwrap_or(f64::INFINITY)).abs() > 1e-3;
            wrong += usize::from(occluded != u8::from(known.is_some()) || (known.is_some() && far));
        }
        // The judge is right; `f32` may read the texel beside the one that `f64` reads.
        let most = if tree.name() == "exact" { 0 } else { 3 };
        ensure!(wrong <= most, "{}: {wrong} of 1500 are wrong", tree.name());
    }
    Ok(())
}

fn a_brickmap_finds_the_octrees_cells() -> Result<(), Failed> {
    let place = Place::new(generate(SceneKind::Town, 5000, 3), 8)?;
    let octree = Octree::new(&place.svo);
    for level in [3, 6, 8] {
        let map = brickmap::from_svo(&place.svo, level, BrickmapBias::NONE);
        let method = BrickmapVisibility::new(map);
        let segments = random_segments(&place, 7 + u64::from(level), 20_000);
        let mut distances = vec![0.0; segments.len()];
        method.distances(&segments, &mut distances)?;
        let (mut wrong, mut hits) = (0, 0);
        for (segment, distance) in segments.iter().zip(distances) {
            let [origin, target] = [segment.origin, segment.target].map(|p| Vec3::from_array(p).as_dvec3());
            let ray = Ray { t_max: 1.0, ..Ray::new(origin.to_array(), (target - origin).to_array()) };
            let exact = octree.intersect(&ray, level).map(|hit| hit.t * (target - origin).length());
            hits += usize::from(exact.is_some());
            wrong += usize::from(match exact {
                Some(exact) => (f64::from(distance) - exact).abs() > 1e-2 * place.voxel(),
                None => distance != f32::INFINITY,
            });
        }
        ensure!((1000..20_000).contains(&hits), "level {level}: {hits} segments hit something");
        // Rays that pass a cell's edge within rounding.
        ensure!(wrong <= 20, "level {level}: {wrong} of 20000 are wrong");
    }
    Ok(())
}

fn what_is_no_segment_is_not_occluded() -> Result<(), Failed> {
    let place = plane()?;
    let reference = place.reference();
    let up =
        |from: f32, to: f32| Segment { origin: [0.1, from, 0.2], target: [0.1, to, 0.2], normal: [0.0; 3] };
    let segments = [
        up(f32::NAN, 1.0),
        up(-1.0, f32::NAN),
        up(-1.0, f32::INFINITY),
        up(f32::NEG_INFINITY, 1.0),
        up(0.013, 0.013),
        up(-3e38, 3e38),
        up(5.0, 6.0),
        // The last two are segments, the second from far outside.
        up(-1.0, 1.0),
        up(-1000.0, 1.0),
    ];
    let expected = [0, 0, 0, 0, 0, 0, 0, 1, 1];
    let receivers = segments.map(|s| Receiver { position: s.origin, normal: [0.0, -1.0, 0.0] });
    let mut lights: Vec<LightPoint> = segments.iter().map(|s| LightPoint::at(s.target)).collect();
    lights.push(LightPoint::directional([0.0, -1.0, 0.0], 30.0));
    lights.extend((0..40).map(|i| LightPoint::at([0.3, i as f32 * 0.1 - 2.04, 0.1])));
    for method in methods(&place, &reference)?.iter().flatten() {
        let mut occluded = [9; 9];
        method.occluded(&segments, &mut occluded)?;
        ensure!(occluded == expected, "{}: {occluded:?}", method.name());
        let mut distances = [0.0; 9];
        method.distances(&segments, &mut distances)?;
        for (distance, expected) in distances.iter().zip(expected) {
            ensure!(distance.is_finite() == (expected == 1), "{}: {distances:?}", method.name());
        }
        // Every pair of a receiver and a light is a segment.
        let words = light_words(lights.len());
        let mut hidden = vec![u32::MAX; receivers.len() * words];
        method.hidden_lights(&receivers, &lights, &mut hidden)?;
        for (receiver, hidden) in receivers.iter().zip(hidden.chunks(words)) {
            let segments: Vec<Segment> = lights.iter().map(|light| light.segment_from(receiver)).collect();
            let mut occluded = vec![9; segments.len()];
            method.occluded(&segments, &mut occluded)?;
            for (i, &occluded) in occluded.iter().enumerate() {
                let bit = (hidden[i / 32] >> (i % 32) & 1) as u8;
                ensure!(bit == occluded, "{}: light {i} from {receiver:?}", method.name());
            }
            ensure!(hidden[1] >> (lights.len() - 32) == 0, "bits beyond the last light are 0");
        }
        method.hidden_lights(&receivers, &[], &mut [])?;
        method.hidden_lights(&[], &lights, &mut [])?;
        method.occluded(&[], &mut [])?;
    }
    Ok(())
}

fn imperfect_shadow_maps_are_not_far_off() -> Result<(), Failed> {
    // A box on a floor; lights all around above, receivers on the floor.
    let mut quads = box_quads([-1.0, 0.0, -1.0], [1.0, 2.0, 1.0]);
    quads.push([[-6.0, 0.0, -6.0], [6.0, 0.0, -6.0], [6.0, 0.0, 6.0], [-6.0, 0.0, 6.0]]);
    let place = Place::of_quads(&quads, 7)?;
    let reference = place.reference();
    let mut random = Random::new(11);
    let receivers: Vec<Receiver> = (0..500)
        .map(|_| point_in(&mut random, DVec3::new(-5.0, 0.0, -5.0), DVec3::new(5.0, 0.0, 5.0)))
        .filter(|p| p.x.abs().max(p.z.abs()) > 1.2)
        .map(|p| Receiver { position: p.as_vec3().to_array(), normal: [0.0, 1.0, 0.0] })
        .collect();
    let lights: Vec<LightPoint> = (0..70)
        .map(|_| point_in(&mut random, DVec3::new(-6.0, 2.5, -6.0), DVec3::new(6.0, 4.0, 6.0)))
        .map(|p| LightPoint::at(p.as_vec3().to_array()))
        .collect();
    let words = light_words(lights.len());
    let mut exact = vec![0; receivers.len() * words];
    ExactVisibility::new(&reference).hidden_lights(&receivers, &lights, &mut exact)?;
    let share = |bits: &[u32]| {
        f64::from(bits.iter().map(|w| w.count_ones()).sum::<u32>()) / (receivers.len() * lights.len()) as f64
    };
    ensure!((0.04..0.5).contains(&share(&exact)), "{} hidden", share(&exact));
    let error = |options: IsmOptions| -> Result<f64, Failed> {
        let mut hidden = vec![u32::MAX; exact.len()];
        IsmVisibility::new(&reference, options).hidden_lights(&receivers, &lights, &mut hidden)?;
        Ok(share(&hidden.iter().zip(&exact).map(|(a, b)| a ^ b).collect::<Vec<_>>()))
    };
    let default = error(IsmOptions::default())?;
    ensure!(default < 0.03, "eps_v is {default}");
    let coarse = error(IsmOptions { points_per_light: 200, resolution: 8, ..IsmOptions::default() })?;
    ensure!(coarse > default, "few points and texels err more: {coarse} and {default}");

    let ism = IsmVisibility::new(&reference, IsmOptions::default());
    let refused = ism.occluded(&[Segment::default()], &mut [0]);
    ensure!(matches!(refused, Err(VisibilityError::Unsupported { .. })), "{refused:?}");
    let sun = [LightPoint::directional([0.0, -1.0, 0.0], 30.0)];
    let refused = ism.hidden_lights(&receivers[..1], &sun, &mut [0]);
    ensure!(matches!(refused, Err(VisibilityError::Unsupported { .. })), "{refused:?}");
    Ok(())
}

fn what_does_not_fit_is_an_error() -> Result<(), Failed> {
    let place = forest()?;
    let reference = place.reference();
    let small = |binding_bytes| -> Box<dyn Executor + Send> {
        Box::new(CpuExecutor::new(ExecutorLimits { binding_bytes, depth_side: 8 }))
    };
    let refused = WideBvh::new(&reference).on_executor(small(100_000)).err();
    let names_it = |error: &DeviceError| error.to_string().contains("BVH");
    ensure!(refused.as_ref().is_some_and(names_it), "{refused:?}");
    let map = brickmap::from_svo(&place.svo, 8, BrickmapBias::NONE);
    let refused = brickmap::on_executor(&map, small(1000)).err();
    ensure!(matches!(refused, Some(DeviceError::TooLarge { .. })), "{refused:?}");
    Ok(())
}

fn shaders_have_known_answers_too(context: &'static GpuContext) -> Result<(), Failed> {
    let place = plane()?;
    plane_answers(&place, &gpu_methods(&place, &place.reference(), context)?)?;
    let place = room()?;
    room_answers(&gpu_methods(&place, &place.reference(), context)?)?;
    let place = two_rooms()?;
    rooms_answers(&place, &gpu_methods(&place, &place.reference(), context)?)
}

fn shaders_equal_their_twins(context: &'static GpuContext) -> Result<(), Failed> {
    // Software adapters neither fuse nor approximate. Others may: then a ray that passes a border within rounding
    // differs.
    let most = if context.is_software() { 0 } else { 20 };
    for place in [forest()?, Place::new(generate(SceneKind::Town, 5000, 3), 8)?] {
        let reference = place.reference();
        let map = brickmap::from_svo(&place.svo, 8, brickmap::DEFAULT_BIAS);
        let twins: Methods = [
            vec![Box::new(WideBvh::new(&reference).on_executor(twins()?)?)],
            vec![Box::new(brickmap::on_executor(&map, twins()?)?)],
        ];
        let segments = random_segments(&place, 21, 20_000);
        let receivers: Vec<Receiver> = segments[..300]
            .iter()
            .map(|s| Receiver { position: s.origin, normal: [0.6, 0.8, 0.0] })
            .collect();
        let lights: Vec<LightPoint> = segments[..70].iter().map(|s| LightPoint::at(s.target)).collect();
        for (gpu, twin) in
            gpu_methods(&place, &reference, context)?.iter().flatten().zip(twins.iter().flatten())
        {
            let both = |ask: &dyn Fn(&dyn Visibility) -> Result<Vec<u32>, VisibilityError>| {
                let (found, expected) = (ask(&**gpu)?, ask(&**twin)?);
                let differing = found.iter().zip(&expected).filter(|(a, b)| a != b).count();
                let any = expected.iter().any(|&word| word != expected[0]);
                Ok::<_, Failed>((differing, any))
            };
            let occluded = both(&|method| {
                let mut occluded = vec![9; segments.len()];
                method.occluded(&segments, &mut occluded)?;
                Ok(occluded.into_iter().map(u32::from).collect())
            })?;
            let distances = both(&|method| {
                let mut distances = vec![0.0f32; segments.len()];
                method.distances(&segments, &mut distances)?;
                // To a part in 2^16, but on a software adapter to the bit.
                let bits = if most == 0 { 0 } else { 7 };
                Ok(distances.into_iter().map(|d| d.to_bits() >> bits).collect())
            })?;
            let hidden = both(&|method| {
                let mut hidden = vec![9; receivers.len() * light_words(lights.len())];
                method.hidden_lights(&receivers, &lights, &mut hidden)?;
                Ok(hidden)
            })?;
            for (what, (differing, any)) in
                [("occluded", occluded), ("distances", distances), ("hidden lights", hidden)]
            {
                let name = gpu.name();
                ensure!(differing <= most && any, "{name}: {differing} {what} differ from the twin's");
            }
        }
    }
    Ok(())
}
