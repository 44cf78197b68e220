//! How well rows answer, and what they cost: sources, grids, direction sets, resolutions, densities.
//!
//! All variants of one scene answer the same rays (per direction set), and the exact ray tracer ([`crate::reference`])
//! says what is right. Only a sample of directions is voxelized: the whole array would take a hundred times longer and
//! say the same.

use super::segments::{Bundle, bundles};
use super::variants::{Keep, Variant};
use super::{BenchError, BenchScene, Cell, Table};
use crate::rays::paper::{DirectionRows, OriginBias};
use crate::reference::Reference;
use manyview_cache::archive::{CompressedChunk, MAX_CHUNK_BYTES};
use manyview_pipeline::bake::Progress;
use manyview_pipeline::rows::{POINT_BITS_ABOVE_VOXELS, RowsFrom, RowsOptions, RowsPlan};
use manyview_shaders::directions::{DirectionFrame, DirectionSet, Fit, ROW_RAW_BITS};
use rayon::prelude::*;
use std::time::Instant;

/// What to measure with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RowsSettings {
    /// Directions to sample (fewer where two samples are the same direction).
    pub directions: u32,
    /// Rays per direction.
    pub rays: u32,
    /// Seed of directions and rays.
    pub seed: u64,
    /// How rays leave their own surface.
    pub bias: OriginBias,
}

impl Default for RowsSettings {
    /// 64 directions, 1,024 rays each, seed 1, the specified bias.
    fn default() -> Self {
        Self { directions: 64, rays: 1024, seed: 1, bias: OriginBias::default() }
    }
}

/// Rays and exact answers of one direction set.
struct Rays {
    set: DirectionSet,
    bundles: Vec<Bundle>,
}

/// What the paper's method sets in the frames that variants are compared in.
struct Base {
    set: DirectionSet,
    fit: Fit,
    bits: u32,
    frames: Vec<DirectionFrame>,
    /// `None` where no variant peels.
    peeled: Option<Vec<u32>>,
    seconds: [f64; 2],
}

/// Counts of right and wrong answers.
#[derive(Debug, Clone, Copy, Default)]
struct Answers {
    rays: u64,
    occluded: u64,
    wrongly_occluded: u64,
    wrongly_visible: u64,
}

impl Answers {
    fn wrong(&self) -> u64 {
        self.wrongly_occluded + self.wrongly_visible
    }
}

/// Biases that every variant is also asked with: voxels along the normal, and over the cosine voxels skipped and the
/// longest run.
const BIASES: [[f64; 3]; 22] = [
    [0.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [1.5, 0.0, 0.0],
    [1.75, 0.0, 0.0],
    [2.0, 0.0, 0.0],
    [2.25, 0.0, 0.0],
    [2.5, 0.0, 0.0],
    [3.0, 0.0, 0.0],
    [0.0, 0.5, 0.0],
    [0.5, 0.5, 0.0],
    [1.0, 0.25, 0.0],
    [1.0, 0.5, 0.0],
    [1.5, 0.125, 0.0],
    [1.5, 0.25, 0.0],
    [1.5, 0.5, 0.0],
    [2.0, 0.125, 0.0],
    [1.0, 1.0, 0.0],
    [0.5, 0.0, 1.0],
    [0.5, 0.0, 2.0],
    [1.0, 0.0, 1.0],
    [1.5, 0.0, 0.5],
    [1.75, 0.0, 0.25],
];

/// Measures `variants` on a scene: a table of them, and one of origin biases on the default grid.
pub fn run(
    scene: &BenchScene,
    variants: &[Variant],
    settings: &RowsSettings,
    progress: &dyn Progress,
) -> Result<[Table; 2], BenchError> {
    let reference = Reference::new(&scene.scene, &scene.row_triangles, &scene.cutouts);
    let mut table = Table::new(
        format!("rows-{}", scene.name),
        format!(
            "{}: rows against exact rays ({} triangles, {} rays in {} directions)",
            scene.name,
            scene.scene.drawn_triangles(),
            settings.rays * settings.directions,
            settings.directions
        ),
        &[
            "source",
            "fit",
            "directions",
            "side",
            "points a voxel edge",
            "kept",
            "eps_v %",
            "wrongly occluded %",
            "wrongly visible %",
            "eps_v at the best bias %",
            "best bias",
            "occluded %",
            "bits set a direction",
            "missed of peel %",
            "beyond peel %",
            "points",
            "ms a direction, 1 thread",
            "ms a direction, all threads",
            "zstd-1 ratio",
        ],
    );
    let mut biases = bias_table(scene);
    let mut rays: Vec<Rays> = Vec::new();
    let mut bases: Vec<Base> = Vec::new();
    let mut plan: Option<((RowsOptions, u32), RowsPlan<'_>)> = None;
    progress.begin("rows", variants.len() as u64, "variants");
    for variant in variants {
        if progress.cancelled() {
            return Err(BenchError::Cancelled);
        }
        let RowsOptions { bits, directions: set, fit, from } = variant.options;
        if !rays.iter().any(|r| r.set == set) {
            let (count, per_direction) = (settings.directions, settings.rays);
            let bundles = bundles(set, count, per_direction, settings.seed, &reference, &scene.lattice);
            rays.push(Rays { set, bundles });
        }
        let rays = rays.iter().find(|r| r.set == set).expect("made above");
        if !bases.iter().any(|b| (b.set, b.fit, b.bits) == (set, fit, bits)) {
            let same = |v: &Variant| {
                let o = v.options;
                (o.directions, o.fit, o.bits) == (set, fit, bits) && o.from == RowsFrom::Peel
            };
            bases.push(Base::new(scene, variant.options, rays, variants.iter().any(same)));
        }
        let base = bases.iter().find(|b| (b.set, b.fit, b.bits) == (set, fit, bits)).expect("made above");

        let (rows, points, seconds) = if from == RowsFrom::Peel {
            (base.peeled.clone().expect("peeled for this variant"), 0, base.seconds)
        } else {
            // Variants that differ by the points they keep stand together and share a plan.
            let key = (variant.options, variant.point_bits);
            let (_, plan) = match plan.take().filter(|(of, _)| *of == key) {
                Some(same) => plan.insert(same),
                None => plan.insert((key, new_plan(scene, variant))),
            };
            let (rows, seconds) = match variant.keep {
                Keep::All => timed(&base.frames, |frames| plan.block(frames)),
                keep => {
                    let one = |f: &DirectionFrame| keep_points(f, bits, plan.points(), keep);
                    (base.frames.par_iter().map(one).collect::<Vec<_>>().concat(), [f64::NAN; 2])
                }
            };
            (rows, plan.point_count(), seconds)
        };

        let answers = ask(scene, rays, base, bits, &rows, settings.bias);
        let biased = BIASES.map(|bias| {
            let [normal_voxels, skip_voxels, run_voxels] = bias;
            let bias_of = OriginBias { normal_voxels, skip_voxels, run_voxels };
            (bias, ask(scene, rays, base, bits, &rows, bias_of))
        });
        let best = biased.iter().min_by_key(|(_, answers)| answers.wrong()).expect("there are biases");
        let count =
            |words: &mut dyn Iterator<Item = u32>| words.map(|w| u64::from(w.count_ones())).sum::<u64>();
        let set_bits = count(&mut rows.iter().copied());
        let [missed, beyond] = base.peeled.as_ref().map_or([Cell::None, Cell::None], |peeled| {
            let in_peel = count(&mut peeled.iter().copied());
            let missed = count(&mut rows.iter().zip(peeled).map(|(a, b)| b & !a));
            [Cell::percent(missed, in_peel), Cell::percent(set_bits + missed - in_peel, in_peel)]
        });
        table.push(vec![
            Cell::Text(from.to_string()),
            fit_name(fit).into(),
            Cell::Text(set.to_string()),
            Cell::Count(1 << bits),
            if from == RowsFrom::Points { Cell::Count(1 << variant.point_bits) } else { Cell::None },
            if from == RowsFrom::Points { Cell::Text(variant.keep.to_string()) } else { Cell::None },
            Cell::percent(answers.wrong(), answers.rays),
            Cell::percent(answers.wrongly_occluded, answers.rays),
            Cell::percent(answers.wrongly_visible, answers.rays),
            Cell::percent(best.1.wrong(), best.1.rays),
            Cell::Text(best.0.map(|b| b.to_string()).join("/")),
            Cell::percent(answers.occluded, answers.rays),
            Cell::Count(set_bits / base.frames.len() as u64),
            missed,
            beyond,
            if from == RowsFrom::Peel { Cell::None } else { Cell::Count(points as u64) },
            milliseconds(seconds[0]),
            milliseconds(seconds[1]),
            Cell::Number(zstd_ratio(&rows), 1),
        ]);
        let in_bias_table = set == DirectionSet::LatLong { thetas: 90, phis: 90 } && fit == Fit::Extent;
        if in_bias_table
            && bits == 7
            && variant.keep == Keep::All
            && variant.point_bits == POINT_BITS_ABOVE_VOXELS
        {
            for ([normal_voxels, skip_voxels, run_voxels], answers) in biased {
                biases.push(vec![
                    Cell::Text(from.to_string()),
                    Cell::Number(normal_voxels, 1),
                    Cell::Number(skip_voxels, 2),
                    Cell::Number(run_voxels, 1),
                    Cell::percent(answers.wrong(), answers.rays),
                    Cell::percent(answers.wrongly_occluded, answers.rays),
                    Cell::percent(answers.wrongly_visible, answers.rays),
                ]);
            }
        }
        progress.advance(1);
    }
    Ok([table, biases])
}

fn bias_table(scene: &BenchScene) -> Table {
    Table::new(
        format!("rows-bias-{}", scene.name),
        format!("{}: origin bias (latlong:90x90, extent, 128³)", scene.name),
        &[
            "source",
            "voxels along the normal",
            "skipped over the cosine",
            "longest run over the cosine",
            "eps_v %",
            "wrongly occluded %",
            "wrongly visible %",
        ],
    )
}

fn new_plan<'a>(scene: &'a BenchScene, variant: &Variant) -> RowsPlan<'a> {
    let (lattice, triangles, cutouts) = (scene.lattice, &scene.row_triangles, &scene.cutouts);
    RowsPlan::with_density(variant.options, lattice, triangles, cutouts, variant.point_bits)
}

impl Base {
    fn new(scene: &BenchScene, options: RowsOptions, rays: &Rays, peel: bool) -> Self {
        let options = RowsOptions { from: RowsFrom::Peel, ..options };
        let plan = RowsPlan::new(options, scene.lattice, &scene.row_triangles, &scene.cutouts);
        let frames: Vec<_> = rays.bundles.iter().map(|b| plan.frames[b.index as usize]).collect();
        let (peeled, seconds) = match peel {
            true => {
                let (peeled, seconds) = timed(&frames, |frames| plan.block(frames));
                (Some(peeled), seconds)
            }
            false => (None, [f64::NAN; 2]),
        };
        let RowsOptions { bits, directions: set, fit, .. } = options;
        Self { set, fit, bits, frames, peeled, seconds }
    }
}

/// The rows of all frames, and seconds a direction: on one thread (over a few frames), and on all.
fn timed(
    frames: &[DirectionFrame],
    voxelize: impl Fn(&[DirectionFrame]) -> Vec<u32> + Sync,
) -> (Vec<u32>, [f64; 2]) {
    let few = &frames[..frames.len().min(3)];
    // The better of two, because the first finds cold caches and machines are shared.
    let single = (0..2)
        .map(|_| {
            let clock = Instant::now();
            std::hint::black_box(voxelize(few));
            clock.elapsed().as_secs_f64() / few.len() as f64
        })
        .fold(f64::INFINITY, f64::min);
    let clock = Instant::now();
    let rows: Vec<u32> = frames.par_iter().map(|f| voxelize(&[*f])).collect::<Vec<_>>().concat();
    (rows, [single, clock.elapsed().as_secs_f64() / frames.len() as f64])
}

fn ask(scene: &BenchScene, rays: &Rays, base: &Base, bits: u32, rows: &[u32], bias: OriginBias) -> Answers {
    let words = 1usize << (3 * bits - 5);
    let one = |(direction, bundle): (usize, &Bundle)| {
        let rows = &rows[direction * words..(direction + 1) * words];
        let rows = DirectionRows::new(&base.frames[direction], &scene.lattice, bits, rows);
        let mut answers = Answers::default();
        for (segment, occluded) in &bundle.segments {
            let found = rows.is_occluded(segment, bias);
            answers.rays += 1;
            answers.occluded += u64::from(*occluded);
            answers.wrongly_occluded += u64::from(found && !occluded);
            answers.wrongly_visible += u64::from(!found && *occluded);
        }
        answers
    };
    rays.bundles.par_iter().enumerate().map(one).reduce(Answers::default, |a, b| Answers {
        rays: a.rays + b.rays,
        occluded: a.occluded + b.occluded,
        wrongly_occluded: a.wrongly_occluded + b.wrongly_occluded,
        wrongly_visible: a.wrongly_visible + b.wrongly_visible,
    })
}

/// One direction's rows from the points that `keep` lets pass; plain and slow.
fn keep_points(frame: &DirectionFrame, bits: u32, points: &[[i16; 3]], keep: Keep) -> Vec<u32> {
    let shift = ROW_RAW_BITS - bits;
    let mut rows = vec![0u32; 1 << (3 * bits - 5)];
    let bit_of = |raw: [i32; 3]| {
        let [u, v, w] = raw.map(|c| c as usize >> shift);
        (v << bits | u) << bits | w
    };
    let mut set = |bit: usize| rows[bit >> 5] |= 1 << (bit & 31);
    match keep {
        Keep::All => points.iter().for_each(|&p| set(bit_of(frame.raw(p)))),
        Keep::Core { across, along } => {
            let voxel = f64::from(1u32 << shift);
            let margins = [across, across, along].map(|m| (m * voxel) as i32);
            let edge = 1i32 << shift;
            for &p in points {
                let raw = frame.raw(p);
                let inside = |a: usize| {
                    let within = raw[a] & (edge - 1);
                    within >= margins[a] && within < edge - margins[a]
                };
                if inside(0) && inside(1) && inside(2) {
                    set(bit_of(raw));
                }
            }
        }
        Keep::AtLeast(least) => {
            let mut counts = vec![0u8; 1 << (3 * bits)];
            for &p in points {
                let count = &mut counts[bit_of(frame.raw(p))];
                *count = count.saturating_add(1);
            }
            counts.iter().enumerate().filter(|(_, c)| **c >= least).for_each(|(bit, _)| set(bit));
        }
    }
    rows
}

fn zstd_ratio(rows: &[u32]) -> f64 {
    let bytes: &[u8] = bytemuck::cast_slice(rows);
    let stored: usize = bytes
        .par_chunks(MAX_CHUNK_BYTES)
        .map(|chunk| CompressedChunk::compress(chunk, 1).stored().len())
        .sum();
    bytes.len() as f64 / stored.max(1) as f64
}

/// Times of a bench-only way of choosing points say nothing.
fn milliseconds(seconds: f64) -> Cell {
    if seconds.is_nan() { Cell::None } else { Cell::Number(seconds * 1e3, 3) }
}

fn fit_name(fit: Fit) -> &'static str {
    match fit {
        Fit::Cube => "cube",
        Fit::Extent => "extent",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use manyview_pipeline::bake::Silent;
    use manyview_pipeline::generate::{SceneKind, generate};

    fn town() -> BenchScene {
        BenchScene::new("town".to_owned(), generate(SceneKind::Town, 2000, 1)).unwrap()
    }

    fn small(from: RowsFrom) -> Variant {
        let directions = DirectionSet::Octahedral { size: 12 };
        let options = RowsOptions { bits: 5, directions, fit: Fit::Extent, from };
        Variant { options, point_bits: 2, keep: Keep::All }
    }

    #[test]
    fn keeping_all_points_is_what_the_bake_does() {
        let scene = town();
        let options = small(RowsFrom::Points).options;
        let plan = RowsPlan::new(options, scene.lattice, &scene.row_triangles, &scene.cutouts);
        let frame = &plan.frames[77];
        let all = plan.block(std::slice::from_ref(frame));
        assert_eq!(keep_points(frame, 5, plan.points(), Keep::All), all);
        assert_eq!(keep_points(frame, 5, plan.points(), Keep::AtLeast(1)), all);
        let core = keep_points(frame, 5, plan.points(), Keep::Core { across: 0.25, along: 0.0 });
        let bits = |rows: &[u32]| rows.iter().map(|w| w.count_ones()).sum::<u32>();
        assert!(core.iter().zip(&all).all(|(c, a)| c & !a == 0) && bits(&core) < bits(&all));
    }

    #[test]
    fn a_sample_is_measured_and_says_the_same_twice() {
        let scene = town();
        let settings = RowsSettings { directions: 6, rays: 100, ..RowsSettings::default() };
        let variants = RowsFrom::ALL.map(|(from, _)| small(from));
        let errors = || {
            let [table, _] = run(&scene, &variants, &settings, &Silent).unwrap();
            table.rows.iter().map(|row| row[6..15].to_vec()).collect::<Vec<_>>()
        };
        let first = errors();
        assert_eq!(first, errors());
        for row in &first {
            let Cell::Number(eps_v, _) = row[0] else { panic!("{row:?}") };
            assert!((0.1..35.0).contains(&eps_v), "{row:?}");
        }
        assert_eq!(first[0][7], Cell::Number(0.0, 2), "peeling misses nothing of itself");
    }
}
