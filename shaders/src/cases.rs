//! Inputs on which backends are compared, bit for bit: seeded random, degenerate, masked, and cut into many pieces.
//!
//! # Practice
//! Run every one of [`cases`] on two [`VoxelDevice`]s and compare what [`Case::run`] gives.

use crate::device::{DeviceError, TriangleBatch, VoxelDevice};
use crate::directions::{DirectionFrame, DirectionSet, Fit, RowLattice, extents_along};
use crate::masks::{AlphaPlane, TexelMap, TriangleMask, UNMASKED, WrapCode};
use crate::raster::{Grid, VoxelBox};

/// A small seeded generator (SplitMix64).
#[derive(Debug, Clone)]
pub struct Random(u64);

impl Random {
    /// Starts from `seed`.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Uniform in `0 .. below`.
    pub fn below(&mut self, below: u32) -> u32 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 32) as u32 % below
    }

    /// Uniform in `min ..= max`.
    pub fn range(&mut self, min: i32, max: i32) -> i32 {
        min + self.below((max - min + 1) as u32) as i32
    }
}

/// What is asked of a device.
#[derive(Debug, Clone)]
pub enum Job {
    /// [`VoxelDevice::fragments`].
    Fragments(Grid, VoxelBox),
    /// [`VoxelDevice::peel`].
    Peel(Grid, VoxelBox),
    /// [`VoxelDevice::rotate_points`] with bits and frames.
    RotatePoints(u32, Vec<DirectionFrame>),
    /// [`VoxelDevice::raster_rows`] with bits, frames and whether to peel.
    RasterRows(u32, Vec<DirectionFrame>, bool),
}

/// Triangles and how they are cut, or points.
#[derive(Debug, Clone, Default)]
pub struct Geometry {
    /// [`TriangleBatch::triangles`].
    pub triangles: Vec<[[i16; 3]; 3]>,
    /// [`TriangleBatch::mask_of`].
    pub mask_of: Vec<u32>,
    /// [`TriangleBatch::masks`].
    pub masks: Vec<TriangleMask>,
    /// [`TriangleBatch::planes`].
    pub planes: Vec<AlphaPlane>,
    /// Points, for [`Job::RotatePoints`].
    pub points: Vec<[i16; 3]>,
}

impl Geometry {
    /// The triangles as devices take them.
    pub fn batch(&self) -> TriangleBatch<'_> {
        TriangleBatch {
            triangles: &self.triangles,
            mask_of: &self.mask_of,
            masks: &self.masks,
            planes: &self.planes,
        }
    }
}

/// A job with its input.
#[derive(Debug, Clone)]
pub struct Case {
    /// For reports.
    pub name: String,
    /// What to do.
    pub job: Job,
    /// With what.
    pub geometry: Geometry,
}

impl Case {
    /// What `device` answers, as words; fragments are sorted.
    pub fn run(&self, device: &dyn VoxelDevice) -> Result<Vec<u32>, DeviceError> {
        let batch = self.geometry.batch();
        match &self.job {
            Job::Fragments(grid, clip) => {
                let mut fragments = device.fragments(*grid, clip, &batch)?;
                fragments.sort_unstable();
                Ok(bytemuck::cast_slice(&fragments).to_vec())
            }
            Job::Peel(grid, clip) => device.peel(*grid, clip, &batch),
            Job::RotatePoints(bits, frames) => device.rotate_points(*bits, frames, &self.geometry.points),
            Job::RasterRows(bits, frames, peel) => device.raster_rows(*bits, frames, &batch, *peel),
        }
    }
}

/// `count` triangles with vertices within `spread` lattice steps of each other, in `min ..= max`.
pub fn random_triangles(
    random: &mut Random,
    count: usize,
    min: i32,
    max: i32,
    spread: i32,
) -> Vec<[[i16; 3]; 3]> {
    let mut triangle = || {
        let at: [i32; 3] = [0; 3].map(|_| random.range(min, max));
        [0; 3].map(|_| at.map(|c| (c + random.range(-spread, spread)).clamp(min, max) as i16))
    };
    (0..count).map(|_| triangle()).collect()
}

/// Triangles that are hard to get right, in `min ..= max` with pixels of `step` lattice steps.
pub fn degenerate_triangles(min: i32, max: i32, step: i32) -> Vec<[[i16; 3]; 3]> {
    let mid = (min + max) / 2;
    let half = step / 2;
    let base = min + (mid - min) / step * step;
    let mut triangles = vec![
        // A point, a line, and two vertices in one.
        [[mid; 3]; 3],
        [[min; 3], [mid; 3], [max; 3]],
        [[min; 3], [max, mid, min], [max, mid, min]],
        // Over the whole grid, both ways round.
        [[min, min, min], [max, min, max], [min, max, mid]],
        [[min, min, min], [min, max, mid], [max, min, max]],
        [[max, max, max], [min, max, min], [max, min, mid]],
        // Slivers.
        [[min, min, min], [max, max, max - 1], [max, max - 1, max]],
        [[min, mid, mid], [max, mid + 1, mid], [max, mid, mid + 1]],
        [[min, min, mid], [min + 1, max, mid], [min, max, mid + 1]],
        // In a plane of pixel centres, and in one between voxels.
        [[min, min, base + half], [max, min, base + half], [min, max, base + half]],
        [[min, min, base], [max, min, base], [min, max, base]],
        // Edge-on along each axis.
        [[mid, min, min], [mid, max, min], [mid, min, max]],
        [[min, mid, min], [max, mid, min], [min, mid, max]],
    ];
    // A quad of two triangles with its corners on pixel centres, along each axis, both diagonals: the shared edge and
    // the borders hold centres.
    let (a, b) = (base - 3 * step + half, base + 4 * step + half);
    let clamp = |c: i32| c.clamp(min, max);
    let (a, b) = (clamp(a), clamp(b));
    for axis in 0..3 {
        let p = |x: i32, y: i32| {
            let mut v = [base + half; 3];
            v[(axis + 1) % 3] = x;
            v[(axis + 2) % 3] = y;
            v
        };
        triangles.push([p(a, a), p(b, a), p(b, b)]);
        triangles.push([p(a, a), p(b, b), p(a, b)]);
        triangles.push([p(a, b), p(a, a), p(b, a)]);
        triangles.push([p(b, a), p(b, b), p(a, b)]);
    }
    triangles.into_iter().map(|t| t.map(|v| v.map(|c| c as i16))).collect()
}

/// Cuts about two thirds of the triangles by masks over `textures` small textures.
pub fn mask(random: &mut Random, geometry: &mut Geometry, textures: u32) {
    let wraps = [WrapCode::Repeat, WrapCode::Mirror, WrapCode::Clamp];
    for i in 0..textures {
        let (width, height) = (1 + random.below(160), 1 + random.below(160));
        geometry.planes.push(AlphaPlane {
            width,
            height,
            wrap: [wraps[i as usize % 3], wraps[random.below(3) as usize]],
            alpha: (0..width * height).map(|_| random.below(256) as u8).collect(),
        });
    }
    let uv = |random: &mut Random| f64::from(random.range(-3000, 3000)) / 500.0;
    for _ in 0..geometry.triangles.len() {
        if random.below(3) == 0 {
            geometry.mask_of.push(UNMASKED);
            continue;
        }
        let plane = random.below(textures);
        let texture = &geometry.planes[plane as usize];
        let uvs = [0; 3].map(|_| [uv(random), uv(random)]);
        let map = TexelMap::new(uvs, [texture.width, texture.height], texture.wrap);
        geometry.mask_of.push(geometry.masks.len() as u32);
        geometry.masks.push(TriangleMask { plane, threshold: random.below(257), map, reserved: 0 });
    }
}

/// Frames of `count` directions of the paper's set over an oblong scene, some cubic, some fitted.
pub fn frames(count: u32) -> Vec<DirectionFrame> {
    let set = DirectionSet::LatLong { thetas: 90, phis: 90 };
    let lattice = RowLattice::new([-3.0, 0.0, -20.0], [5.0, 2.0, 9.0]);
    let corner = crate::directions::ROW_LATTICE as i16;
    (0..count)
        .map(|i| {
            let index = (i * 2_654_435) % set.count();
            let extents = extents_along(set.frame(index), &lattice, &[[[-corner; 3], [corner; 3]]]);
            let fit = if i % 2 == 0 { Fit::Extent } else { Fit::Cube };
            DirectionFrame::new(set.frame(index), &lattice, fit, extents)
        })
        .collect()
}

/// Clip boxes inside a grid of 11 bits: around its middle, in its corners, odd sides, one voxel.
fn boxes() -> Vec<VoxelBox> {
    [
        ([1000, 960, 990], [1064, 1024, 1054]),
        ([0, 0, 0], [128, 128, 128]),
        ([1920, 2000, 2041], [2048, 2048, 2048]),
        ([1023, 900, 1010], [1024, 1033, 1047]),
        ([1024, 1024, 1024], [1025, 1025, 1025]),
    ]
    .map(|(min, max)| VoxelBox { min, max })
    .to_vec()
}

/// Small, large, degenerate and masked triangles in `min ..= max`, around `min`-to-`max`'s middle if `spread` is small.
fn geometries(seed: u64, min: i32, max: i32, step: i32) -> Vec<(&'static str, Geometry)> {
    let mut random = Random::new(seed);
    let of = |triangles| Geometry { triangles, ..Geometry::default() };
    let small = of(random_triangles(&mut random, 700, min, max, 3 * step));
    let large = of(random_triangles(&mut random, 40, min, max, max - min));
    let mut cut = of(degenerate_triangles(min, max, step));
    cut.triangles.extend(random_triangles(&mut random, 200, min, max, 4 * step));
    cut.triangles.extend(random_triangles(&mut random, 20, min, max, max - min));
    mask(&mut random, &mut cut, 7);
    let one = of(vec![[[min as i16; 3], [max as i16, min as i16, max as i16], [max as i16; 3]]]);
    vec![
        ("nothing", Geometry::default()),
        ("one", one),
        ("small", small),
        ("large", large),
        ("degenerate", of(degenerate_triangles(min, max, step))),
        ("masked", cut),
    ]
}

/// Every case. Takes seconds on a slow device.
pub fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for bits in 3..=7 {
        let grid = Grid::new(bits);
        for (kind, geometry) in geometries(u64::from(bits), 0, grid.lattice_size() - 1, 1 << grid.sub_bits) {
            let clip = VoxelBox::whole(grid);
            for (job_name, job) in
                [("fragments", Job::Fragments(grid, clip)), ("peel", Job::Peel(grid, clip))]
            {
                let name = format!("{job_name}: {kind}, {bits} bits");
                cases.push(Case { name, job, geometry: geometry.clone() });
            }
        }
        let step = 32768 >> bits;
        for (kind, geometry) in geometries(u64::from(100 + bits), -16384, 16384, step) {
            for (job_name, peel) in [("raster_rows in one pass", false), ("raster_rows by peeling", true)] {
                let name = format!("{job_name}: {kind}, {bits} bits");
                let job = Job::RasterRows(bits, frames(3), peel);
                cases.push(Case { name, job, geometry: geometry.clone() });
            }
        }
    }
    let grid = Grid::new(11);
    for (i, clip) in boxes().into_iter().enumerate() {
        // Most triangles lie around the box, some far away.
        let (lo, hi) = (clip.min[0] * 16 - 500, clip.max[2] * 16 + 500);
        let (min, max) = (lo.clamp(0, 32767), hi.clamp(0, 32767));
        for (kind, mut geometry) in geometries(200 + i as u64, min, max, 16) {
            if kind == "large" {
                let mut random = Random::new(300);
                geometry.triangles.extend(random_triangles(&mut random, 40, 0, 32767, 32767));
            }
            for (job_name, job) in
                [("fragments", Job::Fragments(grid, clip)), ("peel", Job::Peel(grid, clip))]
            {
                let name = format!("{job_name}: {kind}, box {i} in 11 bits");
                cases.push(Case { name, job, geometry: geometry.clone() });
            }
        }
    }
    for bits in 3..=8 {
        for count in [0, 1, 2, 5001] {
            let mut random = Random::new(400);
            let points = (0..count).map(|_| [0; 3].map(|_| random.range(-16384, 16384) as i16)).collect();
            cases.push(Case {
                name: format!("rotate_points: {count}, {bits} bits"),
                job: Job::RotatePoints(bits, frames(if bits == 8 { 3 } else { 9 })),
                geometry: Geometry { points, ..Geometry::default() },
            });
        }
    }
    cases.extend(long_loops());
    cases
}

/// Cases in which one triangle covers more pixels than some drivers let one invocation loop over (65,535).
pub fn long_loops() -> Vec<Case> {
    let whole = |min: i16, max: i16| Geometry {
        triangles: vec![
            [[min, min, 5], [max, min, max], [max, max, min]],
            [[min, min, 5], [max, max, min], [min, max, max]],
            [[min, max, 5], [max, min, max - 7], [min, min, min]],
        ],
        ..Geometry::default()
    };
    let clip = VoxelBox { min: [512; 3], max: [1536; 3] };
    vec![
        Case {
            name: "fragments: triangles over 1024 x 1024 pixels".to_owned(),
            job: Job::Fragments(Grid::new(11), clip),
            geometry: whole(0, 32767),
        },
        Case {
            name: "raster_rows in one pass: triangles over 256 x 256 pixels".to_owned(),
            job: Job::RasterRows(8, frames(2), false),
            geometry: whole(-16384, 16384),
        },
    ]
}
