//! The rows as steps: packs of blocks of directions.
//!
//! A pack's key is made of its directions' frames and of the digest of the points (of the triangles, where those are
//! voxelized). So nothing that leaves the points alone touches a row, whatever else changes.
//!
//! Where something moves, every direction sees it, but in few of its rows. Then a pack is made from the last bake's:
//! the rows that a point has come to or gone from are emptied and filled anew from the points above and below them;
//! the others stay (`Change::patch`). The result is what a clean bake makes, bit for bit.

use crate::bake::{BakeError, Progress};
use crate::points::coarse_boxes;
use crate::points_step::{PointCell, PointCells, PointsJob, lattice_key, load_points};
use crate::rows::{RowsFrom, RowsOptions, RowsPlan, point_bits, rotated_centers};
use crate::rows_change::Change;
use crate::rows_frames::{fit_frames, refit_frames};
use crate::runs::{Cell, Runs};
use crate::scene::Scene;
use crate::steps::{FRAMES, LATEST, POINTS, ROWS, Reader, StepKind, Steps, step_key};
use crate::triangles::{Cutouts, LatticeTriangles};
use manyview_cache::archive::{ArchiveWriter, CompressedChunk};
use manyview_cache::digest::{Digest, KeyEncoder};
use manyview_cache::store::Claim;
use manyview_shaders::device::VoxelDevice;
use manyview_shaders::directions::{DirectionFrame, DirectionSet, Fit, RowLattice};
use manyview_shaders::sections::name;
use rayon::prelude::*;
use std::borrow::Cow;
use std::io::{Seek, Write};
use std::sync::Arc;

/// Versions of the steps: bumped when their results change.
const FRAMES_VERSION: u32 = 1;
const CENTERS_VERSION: u32 = 1;
const ROWS_VERSION: u32 = 4;

/// Blocks in one value of the store: enough that syncing files costs nothing, few enough that a killed bake loses
/// little.
const PACK_BLOCKS: usize = 16;

/// Everything that the drivers of the rows' steps need.
pub struct RowsJob<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Its runs.
    pub runs: &'a Runs,
    /// What rows to make.
    pub options: RowsOptions,
    /// The lattice of the rows.
    pub lattice: RowLattice,
    /// Where voxels are made.
    pub device: Option<&'a dyn VoxelDevice>,
    /// The store.
    pub steps: &'a Steps,
    /// Who watches.
    pub progress: &'a dyn Progress,
}

/// What the last bake with the same lattice and options left.
struct Last {
    points_key: Digest,
    frames_key: Digest,
    input: Digest,
}

impl Last {
    fn load(value: &[u8]) -> Option<Self> {
        let mut reader = Reader(value);
        let last =
            Self { points_key: reader.digest()?, frames_key: reader.digest()?, input: reader.digest()? };
        reader.end()?;
        Some(last)
    }

    fn save(&self) -> Vec<u8> {
        [self.points_key.0, self.frames_key.0, self.input.0].concat()
    }
}

/// The last bake, with what its rows were made from.
struct Base {
    frames: Vec<DirectionFrame>,
    input: Digest,
    change: Change,
}

/// Points and frames: what the blocks are made from.
pub struct Prepared {
    surface: PointCells,
    /// Those of [`RowsFrom::Rotate`].
    centers: Option<PointCells>,
    frames: Vec<DirectionFrame>,
    last: Last,
    base: Option<Base>,
}

impl Prepared {
    /// The points that are rotated.
    fn points(&self, from: RowsFrom) -> &[[i16; 3]] {
        match (from, &self.centers) {
            (RowsFrom::Peel, _) => &[],
            (RowsFrom::Rotate, Some(centers)) => &centers.points,
            _ => &self.surface.points,
        }
    }
}

fn options_key(key: &mut KeyEncoder, options: RowsOptions) {
    key.unsigned(options.bits.into());
    match options.directions {
        DirectionSet::LatLong { thetas, phis } => {
            key.text("latlong").unsigned(thetas.into()).unsigned(phis.into());
        }
        DirectionSet::Octahedral { size } => _ = key.text("octahedral").unsigned(size.into()),
    }
    key.boolean(options.fit == Fit::Extent).text(&options.from.to_string());
}

impl RowsJob<'_> {
    /// Where the next bake with the same lattice and options looks for this one.
    fn latest_key(&self) -> Digest {
        let mut key = step_key("latest rows", 1);
        lattice_key(&mut key, &self.lattice);
        options_key(&mut key, self.options);
        key.finish()
    }

    fn points_job(&self) -> PointsJob<'_> {
        PointsJob {
            scene: self.scene,
            runs: self.runs,
            lattice: self.lattice,
            bits: point_bits(self.options),
            steps: self.steps,
        }
    }

    /// Finds or makes points and frames, and the last bake to start from.
    pub fn prepare(&self) -> Prepared {
        let steps = self.steps;
        let last = steps.find(LATEST, &self.latest_key(), Last::load);
        let job = self.points_job();
        let cells = job.cells();
        let points_key = job.key(&cells);
        let last_points = last
            .as_ref()
            .filter(|last| last.points_key != points_key)
            .and_then(|last| load_points(steps, &last.points_key));
        let surface = job.run(&cells, points_key, last_points.as_ref());
        let boxes = coarse_boxes(&surface.points);
        let mut frames_key = step_key("frames", FRAMES_VERSION);
        lattice_key(&mut frames_key, &self.lattice);
        options_key(&mut frames_key, self.options);
        let frames_key = frames_key.bytes(bytemuck::cast_slice(&boxes)).finish();
        let mut last_frames = None;
        let frames = steps.find(FRAMES, &frames_key, load_frames).unwrap_or_else(|| {
            last_frames = last.as_ref().and_then(|last| steps.find(FRAMES, &last.frames_key, load_frames));
            let frames = match (&last_points, &last_frames) {
                (Some(points), Some(frames)) => {
                    let old_boxes = coarse_boxes(&points.points);
                    refit_frames(self.options, &self.lattice, &boxes, &old_boxes, frames)
                }
                _ => fit_frames(self.options, &self.lattice, &boxes),
            };
            steps.keep(FRAMES, frames_key, bytemuck::cast_slice(&frames).to_vec(), None);
            frames
        });
        let centers = (self.options.from == RowsFrom::Rotate).then(|| self.centers());
        let input = match (self.options.from, &centers) {
            (RowsFrom::Peel, _) => self.runs.shape(),
            (_, Some(centers)) => centers.digest(),
            _ => surface.digest(),
        };
        let base = last.filter(|last| last.input != input && self.options.from == RowsFrom::Points).and_then(
            |last| {
                let frames = match last_frames {
                    Some(frames) => frames,
                    None => steps.find(FRAMES, &last.frames_key, load_frames)?,
                };
                let change = Change::between(&last_points?, &surface)?;
                Some(Base { frames, input: last.input, change })
            },
        );
        Prepared { surface, centers, frames, last: Last { points_key, frames_key, input }, base }
    }

    /// The points of [`RowsFrom::Rotate`]: one voxelization of everything.
    fn centers(&self) -> PointCells {
        let mut key = step_key("voxel centers", CENTERS_VERSION);
        lattice_key(&mut key, &self.lattice);
        options_key(&mut key, self.options);
        let digest = self.runs.shape();
        let key = key.digest(&digest).finish();
        load_points(self.steps, &key).unwrap_or_else(|| {
            let (triangles, cutouts) = self.triangles();
            let points = rotated_centers(self.options, &self.lattice, &triangles, &cutouts);
            let count = points.len() as u32;
            let centers = PointCells { cells: vec![PointCell { code: 0, count, digest }], points };
            if self.steps.has_store() {
                self.steps.keep(POINTS, key, centers.save(), None);
            }
            centers
        })
    }

    fn triangles(&self) -> (LatticeTriangles, Cutouts) {
        let cutouts = Cutouts::new(self.scene);
        (LatticeTriangles::new(self.scene, &cutouts, |p| self.lattice.snap(p.to_array())), cutouts)
    }

    /// The key of a pack of blocks.
    fn pack_key(&self, input: &Digest, frames: &[DirectionFrame]) -> Digest {
        let mut key = step_key("rows", ROWS_VERSION);
        key.unsigned(self.options.bits.into()).boolean(self.options.from == RowsFrom::Peel);
        if self.options.from == RowsFrom::Peel {
            // Points say where they are; triangles do so in the world.
            lattice_key(&mut key, &self.lattice);
        }
        key.digest(input).bytes(bytemuck::cast_slice(frames)).finish()
    }

    /// What would be found, patched and made, as far as that is known before the points are.
    pub(crate) fn forecast(&self) -> Forecast {
        let steps = self.steps;
        let job = self.points_job();
        let cells = job.cells();
        let points_key = job.key(&cells);
        let last = steps.find(LATEST, &self.latest_key(), Last::load);
        let known = load_points(steps, &points_key);
        let is_known = known.is_some();
        let old = known.or_else(|| load_points(steps, &last.as_ref()?.points_key));
        let is_same = |(cell, digest): &&(Cell, Digest)| {
            let find = |old: &PointCells| {
                let at = old.cells.binary_search_by_key(&cell.code, |old| old.code).ok()?;
                Some(old.cells[at].digest == *digest)
            };
            old.as_ref().and_then(find).unwrap_or(false)
        };
        let same = cells.iter().filter(is_same).count() as u64;
        let triangles = |(cell, _): &(Cell, Digest)| {
            cell.runs.iter().map(|run| self.runs.runs[*run as usize].triangles.len() as u64).sum::<u64>()
        };
        let fresh = cells.iter().filter(|cell| !is_same(cell));
        let mut forecast = Forecast {
            points: (same, cells.len() as u64 - same),
            points_triangles: fresh.map(triangles).sum(),
            ..Forecast::default()
        };
        let directions = self.options.directions.count() as usize;
        let block = self.options.info(&self.lattice).block_directions as usize;
        let blocks = |directions: usize| directions.div_ceil(block) as u64;
        // The points are the last bake's: so are the frames.
        let is_last = is_known && last.as_ref().is_some_and(|last| last.points_key == points_key);
        let frames = last.as_ref().and_then(|last| steps.find(FRAMES, &last.frames_key, load_frames));
        for start in (0..directions).step_by(block * PACK_BLOCKS) {
            let end = directions.min(start + block * PACK_BLOCKS);
            let is_kept = frames.as_ref().zip(last.as_ref()).is_some_and(|(frames, last)| {
                frames.len() == directions
                    && steps.contains(ROWS, &self.pack_key(&last.input, &frames[start..end]))
            });
            let kind = match (is_kept, is_last) {
                (true, true) => 0,
                (true, false) if self.options.from == RowsFrom::Points => 1,
                _ => 2,
            };
            forecast.rows[kind] += blocks(end - start);
            match kind {
                1 => forecast.patched_directions += (end - start) as u64,
                2 => forecast.made_directions += (end - start) as u64,
                _ => {}
            }
        }
        forecast
    }

    /// A plan for what must be made.
    pub fn run(&self, prepared: Prepared) -> RowsRun<'_> {
        RowsRun { job: self, prepared }
    }
}

fn load_frames(value: &[u8]) -> Option<Vec<DirectionFrame>> {
    let size = size_of::<DirectionFrame>();
    value
        .len()
        .is_multiple_of(size)
        .then(|| value.chunks_exact(size).map(bytemuck::pod_read_unaligned).collect())
}

/// What would become of the steps of the rows.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Forecast {
    /// Cells of points that are the same, and others.
    pub(crate) points: (u64, u64),
    /// Triangles that reach into the others.
    pub(crate) points_triangles: u64,
    /// Blocks that are found, patched, made.
    pub(crate) rows: [u64; 3],
    pub(crate) patched_directions: u64,
    pub(crate) made_directions: u64,
}

/// The rows, about to be made.
pub struct RowsRun<'a> {
    job: &'a RowsJob<'a>,
    prepared: Prepared,
}

impl RowsRun<'_> {
    /// Finds or makes all blocks and appends the sections `rows.frames` and `rows.bits`; `head` has gone before.
    /// `most_packs` are made at the same time.
    pub fn write<W: Write + Seek + Send>(
        &self,
        writer: &mut ArchiveWriter<W>,
        most_packs: usize,
    ) -> Result<u64, BakeError> {
        let (job, prepared) = (self.job, &self.prepared);
        let empty = (LatticeTriangles::default(), Cutouts::default());
        let (triangles, cutouts) = if job.options.from == RowsFrom::Peel { job.triangles() } else { empty };
        let points = Cow::Borrowed(prepared.points(job.options.from));
        let frames = prepared.frames.clone();
        let plan = RowsPlan::with_frames(job.options, job.lattice, &triangles, &cutouts, points, frames);
        writer.begin_section(name::ROWS_FRAMES, 0)?;
        writer.append_raw(bytemuck::cast_slice(&prepared.frames))?;
        let block_directions = plan.info().block_directions as usize;
        job.progress.begin("rows", prepared.frames.len() as u64, "directions");
        let packs: Vec<Pack<'_>> = prepared
            .frames
            .chunks(block_directions * PACK_BLOCKS)
            .enumerate()
            .map(|(index, frames)| Pack {
                first: index * block_directions * PACK_BLOCKS,
                frames,
                key: job.pack_key(&prepared.last.input, frames),
            })
            .collect();
        let wave = if job.device.is_some() { 1 } else { rayon::current_num_threads().min(most_packs) };
        let make = |packs: &[Pack<'_>]| -> Result<Vec<Vec<CompressedChunk>>, BakeError> {
            let make = |pack: &Pack<'_>, waits| self.make(pack, &plan, block_directions, waits);
            let mut results: Vec<Option<Vec<CompressedChunk>>> =
                packs.par_iter().map(|pack| make(pack, false)).collect::<Result<_, _>>()?;
            // What other processes were at: theirs by now, or ours.
            for (pack, result) in packs.iter().zip(&mut results) {
                if result.is_none() {
                    *result = make(pack, true)?;
                }
            }
            Ok(results.into_iter().flatten().collect())
        };
        let mut item = 0;
        let mut write = |packs: Vec<Vec<CompressedChunk>>| -> Result<(), BakeError> {
            for chunk in packs.iter().flatten() {
                writer.begin_section(name::ROWS_BITS, item)?;
                writer.append(chunk)?;
                item += 1;
            }
            Ok(())
        };
        // One wave is written while the next is made.
        let mut made = Vec::new();
        for packs in packs.chunks(wave) {
            let (next, written) = rayon::join(|| make(packs), || write(std::mem::take(&mut made)));
            written?;
            made = next?;
        }
        write(made)?;
        Ok(plan.point_count() as u64)
    }

    /// Appends `rows.info`.
    pub fn write_info<W: Write + Seek + Send>(&self, writer: &mut ArchiveWriter<W>) -> Result<(), BakeError> {
        writer.begin_section(name::ROWS_INFO, 0)?;
        writer.append_raw(bytemuck::bytes_of(&self.job.options.info(&self.job.lattice)))?;
        Ok(())
    }

    /// Notes this bake as the one that the next starts from.
    pub fn finish(&self) {
        let steps = self.job.steps;
        if steps.has_store() {
            steps.keep(LATEST, self.job.latest_key(), self.prepared.last.save(), None);
        }
    }

    /// The blocks of a pack; `None` where another process is at it and `waits` is not set.
    fn make(
        &self,
        pack: &Pack<'_>,
        plan: &RowsPlan<'_>,
        block_directions: usize,
        waits: bool,
    ) -> Result<Option<Vec<CompressedChunk>>, BakeError> {
        let (job, steps) = (self.job, self.job.steps);
        let blocks = pack.frames.len().div_ceil(block_directions);
        let is_cancelled = || job.progress.cancelled();
        if is_cancelled() {
            return Err(BakeError::Cancelled);
        }
        let find = |key: &Digest| steps.find(ROWS, key, |value| load_chunks(value, blocks));
        let mut found = find(&pack.key);
        let mut claim = None;
        if found.is_none() {
            claim = match if waits {
                steps.claim_or_wait(&pack.key, is_cancelled)
            } else {
                steps.claim(&pack.key)
            } {
                Claim::Theirs if waits => return Err(BakeError::Cancelled),
                Claim::Theirs => return Ok(None),
                Claim::Mine(claim) => Some(Arc::new(claim)),
                Claim::Unknown => None,
            };
            if claim.is_some() && steps.contains(ROWS, &pack.key) {
                found = find(&pack.key);
            }
        }
        if let Some(chunks) = found {
            steps.count(StepKind::Rows, blocks, 0, 0);
            job.progress.advance(pack.frames.len() as u64);
            return Ok(Some(chunks));
        }
        let old = self.old_pack(pack, blocks);
        let patched = old.as_ref().map_or(0, |_| blocks);
        let chunks = match old {
            Some((old, old_frames)) => self.patch(pack, plan, block_directions, &old, old_frames)?,
            None => self.voxelize(pack, plan, block_directions)?,
        };
        steps.count(StepKind::Rows, 0, blocks, patched);
        if steps.has_store() {
            let mut value = Vec::new();
            chunks.iter().for_each(|chunk| chunk.save(&mut value));
            steps.keep(ROWS, pack.key, value, claim);
        }
        Ok(Some(chunks))
    }

    /// The last bake's blocks of the same directions, and their frames.
    fn old_pack(&self, pack: &Pack<'_>, blocks: usize) -> Option<(Vec<CompressedChunk>, &[DirectionFrame])> {
        let base = self.prepared.base.as_ref()?;
        let frames = base.frames.get(pack.first..pack.first + pack.frames.len())?;
        let key = self.job.pack_key(&base.input, frames);
        Some((self.job.steps.find(ROWS, &key, |value| load_chunks(value, blocks))?, frames))
    }

    fn patch(
        &self,
        pack: &Pack<'_>,
        plan: &RowsPlan<'_>,
        block_directions: usize,
        old: &[CompressedChunk],
        old_frames: &[DirectionFrame],
    ) -> Result<Vec<CompressedChunk>, BakeError> {
        let change = self.prepared.base.as_ref().map(|base| &base.change);
        let frames = pack.frames.chunks(block_directions).zip(old_frames.chunks(block_directions));
        let jobs: Vec<_> = frames.zip(old).collect();
        jobs.into_par_iter()
            .map(|((frames, old_frames), chunk)| {
                if self.job.progress.cancelled() {
                    return Err(BakeError::Cancelled);
                }
                let chunk = match change {
                    Some(change) => change.patch(plan, frames, old_frames, chunk)?,
                    None => plan.compress(&plan.block(frames)),
                };
                self.job.progress.advance(frames.len() as u64);
                Ok(chunk)
            })
            .collect()
    }

    fn voxelize(
        &self,
        pack: &Pack<'_>,
        plan: &RowsPlan<'_>,
        block_directions: usize,
    ) -> Result<Vec<CompressedChunk>, BakeError> {
        let progress = self.job.progress;
        let cancelled = || if progress.cancelled() { Err(BakeError::Cancelled) } else { Ok(()) };
        let blocks: Vec<_> = pack.frames.chunks(block_directions).collect();
        let Some(device) = self.job.device else {
            return blocks
                .into_par_iter()
                .map(|frames| {
                    cancelled()?;
                    let chunk = plan.compress(&plan.block(frames));
                    progress.advance(frames.len() as u64);
                    Ok(chunk)
                })
                .collect();
        };
        // Blocks from a device wait uncompressed, 4 MiB each.
        let mut chunks = Vec::with_capacity(blocks.len());
        for blocks in blocks.chunks(rayon::current_num_threads()) {
            let mut rows = Vec::with_capacity(blocks.len());
            for frames in blocks {
                cancelled()?;
                rows.push(plan.block_on(device, frames)?);
                progress.advance(frames.len() as u64);
            }
            chunks.par_extend(rows.into_par_iter().map(|rows| plan.compress(&rows)));
        }
        Ok(chunks)
    }
}

/// Some blocks of directions.
struct Pack<'a> {
    /// Its first direction.
    first: usize,
    frames: &'a [DirectionFrame],
    key: Digest,
}

fn load_chunks(value: &[u8], count: usize) -> Option<Vec<CompressedChunk>> {
    let mut reader = Reader(value);
    let chunks = (0..count).map(|_| CompressedChunk::load(&mut reader.0)).collect::<Option<_>>()?;
    reader.end()?;
    Some(chunks)
}
