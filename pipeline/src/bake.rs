//! A scene in, an archive out: the steps of the bake in order.
//!
//! `triangles → peel → octree, rows → archive` (ARCHITECTURE.md). The archive's bytes depend on the scene and on
//! [`BakeOptions`] alone, not on threads, backend, machine or time.

use crate::cube::SceneCube;
use crate::estimate::{Estimate, Plan};
use crate::regions::{OctreeJob, RegionGrid};
use crate::rows::RowsOptions;
use crate::rows_step::RowsJob;
use crate::runs::Runs;
use crate::scene::Scene;
use crate::sections;
use crate::steps::Steps;
use manyview_cache::archive::{ArchiveError, ArchiveWriter};
use manyview_shaders::device::{DeviceError, PackedFragment, VoxelDevice};
use manyview_shaders::directions::{DirectionSet, Fit, RowLattice};
use manyview_shaders::raster::{Grid, VoxelBox};
use manyview_shaders::sections::{SceneInfo, SvoInfo};
use manyview_shaders::svo::MAX_LEVELS;
use std::io::{Seek, Write};
use std::ops::RangeInclusive;
use thiserror::Error;

pub use crate::rows::RowsFrom;

/// How the octree's voxels are found. Both ways give the same voxels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum VoxelsFrom {
    /// All fragments in one pass.
    #[default]
    Raster,
    /// Depth peeling, layer after layer until one is empty (needs a device).
    Peel,
}

/// What to bake.
#[derive(Debug, Clone, PartialEq)]
pub struct BakeOptions {
    /// Depth of the octree, 1 ..= 13; 11 gives 2048³ voxels.
    pub levels: u32,
    /// The rows, or `None` for an archive without them.
    pub rows: Option<RowsOptions>,
    /// How the octree's voxels are found.
    pub voxels_from: VoxelsFrom,
    /// The scene cube, or `None` for the smallest snapped cube around the scene.
    pub cube: Option<SceneCube>,
    /// Most memory that the bake may plan to use.
    pub max_memory_bytes: u64,
    /// Of it, what the process holds before the bake begins, such as a GPU's driver; 0 for what a program usually does.
    pub held_bytes: u64,
}

impl Default for BakeOptions {
    /// 11 levels; 90 × 90 latitude-longitude directions of 128³, fitted, from surface points; 8 GiB.
    fn default() -> Self {
        Self {
            levels: 11,
            rows: Some(RowsOptions {
                bits: 7,
                directions: DirectionSet::LatLong { thetas: 90, phis: 90 },
                fit: Fit::Extent,
                from: RowsFrom::Points,
            }),
            voxels_from: VoxelsFrom::Raster,
            cube: None,
            max_memory_bytes: 8 << 30,
            held_bytes: 0,
        }
    }
}

impl BakeOptions {
    /// Whether all parameters are in range, whatever the scene.
    pub fn check(&self) -> Result<(), BakeError> {
        let check = |parameter, found: u32, range: RangeInclusive<u32>, allowed| {
            if range.contains(&found) {
                Ok(())
            } else {
                Err(BakeError::Parameter { parameter, found: u64::from(found), allowed })
            }
        };
        check("--levels", self.levels, 1..=MAX_LEVELS, "1 to 13")?;
        if let Some(rows) = &self.rows {
            check("--rows (as log2)", rows.bits, 5..=8, "32, 64, 128 or 256 voxels a side")?;
        }
        Ok(())
    }
}

/// Why there is no archive.
#[derive(Debug, Error)]
pub enum BakeError {
    /// Nothing is drawn.
    #[error("the scene draws no triangle: there is nothing to bake{}", hint(.warnings))]
    Empty {
        /// The importer's warnings, which may say why.
        warnings: Vec<String>,
    },
    /// Every triangle is cut away by its alpha.
    #[error("alpha cuts away every triangle of the scene: check the materials' alpha cutoffs and textures")]
    AllTransparent,
    /// No triangle has a fragment.
    #[error(
        "no voxel is hit: every triangle of the scene has no area, is thinner than a voxel, or is cut away by alpha; \
         check the scene, or raise --levels (now {levels})"
    )]
    NoVoxels {
        /// Octree depth asked for.
        levels: u32,
    },
    /// The bounds are a point, not finite, or beyond what floats can hold.
    #[error(
        "the scene's bounds {min:?} .. {max:?} (metres) have no size or are not finite: check the node transforms for \
         zero scales and huge values"
    )]
    Bounds {
        /// Smallest corner.
        min: [f64; 3],
        /// Largest corner.
        max: [f64; 3],
    },
    /// The pinned cube does not hold the scene.
    #[error(
        "the pinned cube (origin {origin:?}, size {size} m) does not hold the scene ({min:?} .. {max:?}): enlarge it \
         or remove it from the recipe"
    )]
    CubeTooSmall {
        /// The cube's smallest corner.
        origin: [f64; 3],
        /// The cube's edge, metres.
        size: f64,
        /// The scene's smallest corner.
        min: [f64; 3],
        /// The scene's largest corner.
        max: [f64; 3],
    },
    /// A parameter is out of range.
    #[error("{parameter} is {found}, it must be {allowed}")]
    Parameter {
        /// The option's name.
        parameter: &'static str,
        /// Its value.
        found: u64,
        /// The range.
        allowed: &'static str,
    },
    /// The plan needs more memory than allowed.
    #[error(
        "even in the smallest pieces the bake needs about {} MiB, the limit is {} MiB: raise --max-memory, or lower \
         --levels (now {levels}), --rows or --jobs",
        needed_bytes >> 20,
        limit_bytes >> 20
    )]
    OverBudget {
        /// Estimated peak of the smallest pieces.
        needed_bytes: u64,
        /// `--max-memory`.
        limit_bytes: u64,
        /// Octree depth asked for.
        levels: u32,
    },
    /// Depth peeling was asked for without a device.
    #[error(
        "depth peeling of the octree needs a device: pass one (manyview_shaders::cpu_device::CpuDevice on the CPU), or \
         take VoxelsFrom::Raster, which gives the same voxels"
    )]
    PeelNeedsDevice,
    /// Two ways that must agree did not; a bug.
    #[error("internal: {0}")]
    Disagreement(String),
    /// The device failed.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The archive could not be written.
    #[error(transparent)]
    Archive(#[from] ArchiveError),
    /// The user asked to stop.
    #[error("cancelled")]
    Cancelled,
}

fn hint(warnings: &[String]) -> String {
    warnings.first().map_or(String::new(), |w| format!(" ({w})"))
}

/// Hears how far the bake is, and says when to stop. All methods may be called from any thread.
pub trait Progress: Sync {
    /// A step of `total` units begins.
    fn begin(&self, _step: &'static str, _total: u64, _unit: &'static str) {}
    /// More units of the current step are done.
    fn advance(&self, _units: u64) {}
    /// The bake is about to start and will cost about this.
    fn estimate(&self, _estimate: &Estimate) {}
    /// Whether to stop soon.
    fn cancelled(&self) -> bool {
        false
    }
}

/// A [`Progress`] that nobody watches.
pub struct Silent;

impl Progress for Silent {}

/// What was baked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BakeReport {
    /// Triangles drawn, instances counted.
    pub triangles: u64,
    /// Leaves of the octree.
    pub leaves: u64,
    /// Nodes of the octree.
    pub nodes: u64,
    /// Points that were rotated into the rows.
    pub points: u64,
    /// Seconds for snapping and cut-outs, the octree, and the rows.
    pub seconds: [f64; 3],
}

/// The scene's bounds and cube, checked.
pub(crate) struct Placement {
    pub(crate) info: SceneInfo,
    pub(crate) cube: SceneCube,
    pub(crate) runs: Runs,
    /// Sizes of the files that the scene was read from.
    pub(crate) read_bytes: u64,
}

impl Placement {
    pub(crate) fn new(scene: &Scene, options: &BakeOptions) -> Result<Self, BakeError> {
        options.check()?;
        let triangles = scene.drawn_triangles();
        let runs = Runs::new(scene);
        let (min, max) = match runs.bounds() {
            Some(bounds) if triangles > 0 => (bounds.0.to_array(), bounds.1.to_array()),
            _ => return Err(BakeError::Empty { warnings: scene.warnings.clone() }),
        };
        let around = SceneCube::around(min, max).ok_or(BakeError::Bounds { min, max })?;
        let cube = match options.cube {
            None => around,
            Some(pinned) if pinned.contains(min, max) => pinned,
            Some(SceneCube { origin, size }) => {
                return Err(BakeError::CubeTooSmall { origin, size, min, max });
            }
        };
        let info = SceneInfo {
            triangles,
            meshes: scene.meshes.len() as u64,
            instances: scene.instances.len() as u64,
            materials: scene.materials.len() as u64,
            lights: scene.lights.len() as u64,
            bounds_min: min,
            bounds_max: max,
        };
        Ok(Self { info, cube, runs, read_bytes: 0 })
    }
}

/// Bakes `scene` into `writer`, which the caller finishes. Work that a GPU can do runs on `device` if there is one.
pub fn bake<W: Write + Seek + Send>(
    scene: &Scene,
    options: &BakeOptions,
    device: Option<&dyn VoxelDevice>,
    writer: &mut ArchiveWriter<W>,
    progress: &dyn Progress,
) -> Result<BakeReport, BakeError> {
    bake_with(scene, options, device, &Steps::without_store(), writer, progress)
}

/// As [`bake`], with the results of steps that a store has. The bytes are the same.
pub fn bake_with<W: Write + Seek + Send>(
    scene: &Scene,
    options: &BakeOptions,
    device: Option<&dyn VoxelDevice>,
    steps: &Steps,
    writer: &mut ArchiveWriter<W>,
    progress: &dyn Progress,
) -> Result<BakeReport, BakeError> {
    bake_placed(scene, options, &Placement::new(scene, options)?, device, steps, writer, progress)
}

/// As [`bake_with`], of a scene whose place is known.
pub(crate) fn bake_placed<W: Write + Seek + Send>(
    scene: &Scene,
    options: &BakeOptions,
    placement: &Placement,
    device: Option<&dyn VoxelDevice>,
    steps: &Steps,
    writer: &mut ArchiveWriter<W>,
    progress: &dyn Progress,
) -> Result<BakeReport, BakeError> {
    let Placement { info, cube, runs, read_bytes } = placement;
    let cube = *cube;
    let Plan { estimate, budget, cells, costs } =
        Plan::new(scene, options, runs, cube, *read_bytes, steps.has_store());
    progress.estimate(&estimate);
    if estimate.least_bytes > options.max_memory_bytes {
        return Err(BakeError::OverBudget {
            needed_bytes: estimate.least_bytes,
            limit_bytes: options.max_memory_bytes,
            levels: options.levels,
        });
    }
    if options.voxels_from == VoxelsFrom::Peel && device.is_none() {
        return Err(BakeError::PeelNeedsDevice);
    }
    let clock = std::time::Instant::now();
    let mut seconds = [0.0; 3];
    sections::write_scene(writer, info, &sections::lights(scene))?;
    let grid = RegionGrid { cube, grid: Grid::new(options.levels) };
    seconds[0] += clock.elapsed().as_secs_f64();

    let clock = std::time::Instant::now();
    let spool = writer.spool(budget.spool_bytes);
    let octree = OctreeJob {
        scene,
        runs,
        options,
        grid,
        cells: &cells,
        costs: &costs,
        bricks_bytes: budget.bricks_bytes,
        spool: &spool,
        device,
        steps,
        progress,
    }
    .run()?;
    drop((cells, costs));
    sections::write_svo_info(writer, &octree.info)?;
    // Readers want all heads before the long sections, so the octree waits until the rows are planned.
    seconds[1] = clock.elapsed().as_secs_f64();

    let clock = std::time::Instant::now();
    let lattice = RowLattice::new(info.bounds_min, info.bounds_max);
    let mut points = 0;
    let rows_job =
        options.rows.map(|options| RowsJob { scene, runs, options, lattice, device, steps, progress });
    let rows = match &rows_job {
        Some(job) => {
            if progress.cancelled() {
                return Err(BakeError::Cancelled);
            }
            progress.begin("row points", 1, "sets");
            let prepared = job.prepare();
            progress.advance(1);
            Some(job.run(prepared))
        }
        None => None,
    };
    if let Some(rows) = &rows {
        rows.write_info(writer)?;
    }
    octree.write(writer, &spool)?;
    let svo_info = octree.info;
    drop(octree);
    drop(spool);
    if let Some(rows) = &rows {
        points = rows.write(writer, budget.rows_packs)?;
        rows.finish();
    }
    seconds[2] = clock.elapsed().as_secs_f64();
    let SvoInfo { leaves, nodes, .. } = svo_info;
    Ok(BakeReport { triangles: info.triangles, leaves, nodes, points, seconds })
}

/// Checks that depth peeling found exactly the voxels that hold a fragment.
pub(crate) fn same_voxels(
    clip: &VoxelBox,
    peeled: &[u32],
    fragments: &[PackedFragment],
) -> Result<(), BakeError> {
    let size = [0, 1, 2].map(|i| (clip.max[i] - clip.min[i]) as u32);
    let mut from_fragments = vec![0u32; peeled.len()];
    for fragment in fragments {
        let [x, y, z] = [0, 10, 20].map(|shift| fragment.voxel >> shift & 1023);
        let bit = (z * size[1] + y) * size[0] + x;
        from_fragments[(bit / 32) as usize] |= 1 << (bit % 32);
    }
    let differ: u32 = peeled.iter().zip(&from_fragments).map(|(a, b)| (a ^ b).count_ones()).sum();
    if differ == 0 {
        return Ok(());
    }
    Err(BakeError::Disagreement(format!(
        "depth peeling and rasterization differ in {differ} voxels of the brick at {:?}: please report this with the \
         name of the GPU; --voxels-from raster bakes without peeling",
        clip.min
    )))
}

/// Bakes `scene` into an archive in memory, on the CPU: for tests and small scenes.
pub fn bake_in_memory(scene: &Scene, options: &BakeOptions) -> Result<Vec<u8>, BakeError> {
    let mut writer = ArchiveWriter::in_memory()?;
    bake(scene, options, None, &mut writer, &Silent)?;
    Ok(writer.finish()?.0)
}
