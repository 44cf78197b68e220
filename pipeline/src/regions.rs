//! The octree as steps: brick by brick, each a pure function of the triangles that touch it.
//!
//! A *brick* is a cell of 256³ voxels (the whole cube where it has fewer). Two steps make it: its *shape* (child masks,
//! coverages) from the runs' shapes, its *look* (all other attributes) from the runs' looks; so another colour leaves
//! the shape alone. The results are pieces of the archive as they will stand in it: the [`FINE_LEVELS`] deepest levels
//! as compressed chunks, which end where a brick ends, the levels above as they are, since they are joined and
//! compressed anew.
//!
//! Voxels are made in smaller bricks ([`crate::octree`]), which show nowhere.

mod grid;
mod part;

use crate::appearance::Appearance;
use crate::bake::{BakeError, BakeOptions, Progress, VoxelsFrom, same_voxels};
use crate::octree::{self, Brick, Bricks, brick_fragments};
use crate::runs::{Cell, Runs};
use crate::scene::Scene;
use crate::steps::{LOOKS, Reader, SHAPES, StepKind, Steps};
use crate::triangles::{Cutouts, LatticeTriangles};
pub use grid::{BrickCost, FINE_LEVELS, REGION_BITS, RegionGrid, RegionKeys};
use manyview_cache::archive::{ArchiveError, ArchiveWriter, ChunkSpool, CompressedChunk, SpooledChunk};
use manyview_cache::store::{Claim, ClaimGuard};
use manyview_shaders::device::VoxelDevice;
use manyview_shaders::sections::{SvoInfo, name};
use manyview_shaders::svo::SvoLevel;
pub(crate) use part::byte_planes;
use part::{Part, SHAPE_PLANES, level_of, look_plane_count, look_planes, shape_planes, split};
use rayon::prelude::*;
use std::io::{Seek, Write};
use std::sync::Arc;

/// Bricks of 64³ keep a brick's bitmap in the first-level cache; a GPU wants more work per job.
const CPU_BRICK_BITS: u32 = 6;

/// A brick with its results: what is needed to join it with others, and its chunks.
struct Region {
    code: u32,
    /// Nodes of each level, the brick's root first.
    counts: Vec<u32>,
    /// Coarse levels of shape and look.
    coarse: [Vec<u8>; 2],
    /// Of shape and look, one list for each byte plane of each fine level.
    fine: [Vec<Vec<SpooledChunk>>; 2],
}

/// The octree, ready to be written.
pub struct Octree {
    grid: RegionGrid,
    emits: bool,
    regions: Vec<Region>,
    /// Levels above the fine ones.
    coarse: Vec<SvoLevel>,
    /// Its head.
    pub info: SvoInfo,
}

/// Everything that the drivers of the octree's steps need.
pub struct OctreeJob<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Its runs.
    pub runs: &'a Runs,
    /// What to bake.
    pub options: &'a BakeOptions,
    /// Where the octree lies.
    pub grid: RegionGrid,
    /// The bricks that runs reach into.
    pub cells: &'a [Cell],
    /// What each of them will cost.
    pub costs: &'a [BrickCost],
    /// What bricks may cost that are made at the same time.
    pub bricks_bytes: u64,
    /// Where finished bricks wait.
    pub spool: &'a ChunkSpool,
    /// Where voxels are made.
    pub device: Option<&'a dyn VoxelDevice>,
    /// The store.
    pub steps: &'a Steps,
    /// Who watches.
    pub progress: &'a dyn Progress,
}

/// What has become of a brick.
enum Done {
    /// Nothing is in it.
    Empty,
    Made(Region),
    /// It must be made.
    Missing,
}

impl OctreeJob<'_> {
    /// Finds or makes every brick, and joins them. Bricks are made in waves, so that memory holds.
    pub fn run(&self) -> Result<Octree, BakeError> {
        let (runs, grid, cells) = (self.runs, self.grid, self.cells);
        let emits = emits(self.scene);
        let keys: Vec<RegionKeys> = cells.par_iter().map(|cell| grid.keys(runs, cell)).collect();
        let find = |(cell, keys)| match self.find(keys, emits) {
            (Some(shape), Some(look)) => self.put_aside(cell, shape, look),
            _ => Ok(Done::Missing),
        };
        let mut done: Vec<Done> = cells.par_iter().zip(&keys).map(find).collect::<Result<_, BakeError>>()?;
        let missing: Vec<usize> = (0..cells.len()).filter(|&i| matches!(done[i], Done::Missing)).collect();
        let looks = done.iter().filter(|done| matches!(done, Done::Made(_))).count();
        self.steps.count(StepKind::Bricks, cells.len() - missing.len(), 0, 0);
        self.steps.count(StepKind::Attributes, looks, 0, 0);
        if !missing.is_empty() {
            let maker = Maker::new(self, emits, missing.iter().flat_map(|&i| &cells[i].runs));
            self.progress.begin("octree", missing.len() as u64, "bricks");
            let make = |index: usize, waits: bool| {
                let Some((shape, look)) = maker.make_or_wait(&cells[index], &keys[index], waits)? else {
                    return Ok((index, Done::Missing));
                };
                self.progress.advance(1);
                Ok::<_, BakeError>((index, self.put_aside(&cells[index], shape, look)?))
            };
            for wave in self.waves(&missing) {
                let results: Vec<(usize, Done)> = if self.device.is_some() {
                    wave.iter().map(|&index| make(index, false)).collect::<Result<_, _>>()?
                } else {
                    let wave = wave.par_iter().with_max_len(1);
                    wave.map(|&index| make(index, false)).collect::<Result<_, _>>()?
                };
                results.into_iter().for_each(|(index, result)| done[index] = result);
            }
            // What other processes were at: theirs by now, or ours.
            for &index in &missing {
                if matches!(done[index], Done::Missing) {
                    done[index] = make(index, true)?.1;
                }
            }
        }
        let made = |done| if let Done::Made(region) = done { Some(region) } else { None };
        let regions: Vec<Region> = done.into_iter().filter_map(made).collect();
        if regions.is_empty() {
            return Err(self.nothing());
        }
        Octree::join(grid, emits, regions)
    }

    /// Cuts bricks into pieces that may be made at the same time; at least one brick each.
    fn waves<'m>(&self, missing: &'m [usize]) -> Vec<&'m [usize]> {
        let mut waves = Vec::new();
        let (mut start, mut bytes) = (0, 0u64);
        for (at, &index) in missing.iter().enumerate() {
            let cost = self.costs[index].bytes();
            if at > start && bytes.saturating_add(cost) > self.bricks_bytes {
                waves.push(&missing[start..at]);
                (start, bytes) = (at, 0);
            }
            bytes = bytes.saturating_add(cost);
        }
        waves.push(&missing[start..]);
        waves
    }

    /// Keeps a brick's parts until the octree is written.
    fn put_aside(&self, cell: &Cell, shape: Part, look: Part) -> Result<Done, BakeError> {
        if look.counts.is_empty() {
            return Ok(Done::Empty);
        }
        let spooled = |lists: Vec<Vec<CompressedChunk>>| {
            let list = |chunks: Vec<CompressedChunk>| {
                chunks.into_iter().map(|chunk| self.spool.push(chunk)).collect::<Result<_, _>>()
            };
            lists.into_iter().map(list).collect::<Result<_, ArchiveError>>()
        };
        let fine = [spooled(shape.fine)?, spooled(look.fine)?];
        let coarse = [shape.coarse, look.coarse];
        Ok(Done::Made(Region { code: cell.code, counts: look.counts, coarse, fine }))
    }

    /// Why there are no voxels.
    fn nothing(&self) -> BakeError {
        if Cutouts::new(self.scene).leaves_nothing(self.scene) {
            return BakeError::AllTransparent;
        }
        BakeError::NoVoxels { levels: self.options.levels }
    }

    /// The parts of a brick that the store has. An empty shape stands for the look, too.
    fn find(&self, keys: &RegionKeys, emits: bool) -> (Option<Part>, Option<Part>) {
        let bits = self.grid.bits();
        let fine = FINE_LEVELS.min(bits + 1) as usize;
        let shape = self.steps.find(SHAPES, &keys.shape, |value| {
            Part::load(value, SHAPE_PLANES * fine.saturating_sub(1)).filter(|part| self.has_levels(part))
        });
        if shape.as_ref().is_some_and(|shape| shape.counts.is_empty()) {
            return (shape, Some(Part::nothing()));
        }
        let planes = look_plane_count(emits);
        let look = self.steps.find(LOOKS, &keys.look, |value| {
            Part::load(value, planes * fine).filter(|part| self.has_levels(part))
        });
        (shape, look)
    }

    fn has_levels(&self, part: &Part) -> bool {
        part.counts.is_empty() || part.counts.len() == self.grid.bits() as usize + 1
    }
}

/// Whether any drawn material emits light.
fn emits(scene: &Scene) -> bool {
    let glows = |mesh| crate::triangles::material_of(scene, mesh).emissive.max_element() > 0.0;
    scene.instances.iter().any(|instance| glows(&scene.meshes[instance.mesh as usize]))
}

/// Makes bricks.
struct Maker<'a> {
    job: &'a OctreeJob<'a>,
    emits: bool,
    cutouts: Cutouts,
    appearance: Appearance<'a>,
}

impl<'a> Maker<'a> {
    /// Prepares for the bricks that these runs reach into.
    fn new<'r>(job: &'a OctreeJob<'a>, emits: bool, runs: impl Iterator<Item = &'r u32>) -> Self {
        let mut wanted = vec![false; job.scene.meshes.len()];
        for run in runs {
            let instance = job.runs.runs[*run as usize].instance;
            wanted[job.scene.instances[instance as usize].mesh as usize] = true;
        }
        let cutouts = Cutouts::of_meshes(job.scene, |mesh| wanted[mesh]);
        let voxel_size = job.grid.cube.size / f64::from(job.grid.grid.size());
        let appearance = Appearance::of_meshes(job.scene, voxel_size, |mesh| wanted[mesh]);
        Self { job, emits, cutouts, appearance }
    }

    /// A brick's parts; `None` where another process is at it and `waits` is not set.
    fn make_or_wait(
        &self,
        cell: &Cell,
        keys: &RegionKeys,
        waits: bool,
    ) -> Result<Option<(Part, Part)>, BakeError> {
        let steps = self.job.steps;
        let is_cancelled = || self.job.progress.cancelled();
        if is_cancelled() {
            return Err(BakeError::Cancelled);
        }
        let claim =
            if waits { steps.claim_or_wait(&keys.look, is_cancelled) } else { steps.claim(&keys.look) };
        let claim = match claim {
            Claim::Theirs if waits => return Err(BakeError::Cancelled),
            Claim::Theirs => return Ok(None),
            Claim::Mine(claim) => Some(Arc::new(claim)),
            Claim::Unknown => None,
        };
        // Another process may have finished between our look into the store and our claim.
        let (shape, look) = self.job.find(keys, self.emits);
        let (has_shape, has_look) = (shape.is_some(), look.is_some());
        let (shape, look) = match (shape, look) {
            (Some(shape), Some(look)) => (shape, look),
            (shape, _) => {
                let [made, look] = self.make(cell)?;
                (shape.unwrap_or(made), look)
            }
        };
        self.keep(keys, (&shape, has_shape), (&look, has_look), claim);
        Ok(Some((shape, look)))
    }

    fn keep(
        &self,
        keys: &RegionKeys,
        (shape, has_shape): (&Part, bool),
        (look, has_look): (&Part, bool),
        claim: Option<Arc<ClaimGuard>>,
    ) {
        let steps = self.job.steps;
        steps.count(StepKind::Bricks, usize::from(has_shape), usize::from(!has_shape), 0);
        if !look.counts.is_empty() {
            steps.count(StepKind::Attributes, usize::from(has_look), usize::from(!has_look), 0);
        }
        if steps.has_store() && !has_shape {
            steps.keep(SHAPES, keys.shape, shape.save(), claim.clone());
        }
        if steps.has_store() && !has_look && !look.counts.is_empty() {
            steps.keep(LOOKS, keys.look, look.save(), claim);
        }
    }

    fn make(&self, cell: &Cell) -> Result<[Part; 2], BakeError> {
        let job = self.job;
        let RegionGrid { cube, grid } = job.grid;
        let pieces: Vec<_> = cell
            .runs
            .iter()
            .map(|run| &job.runs.runs[*run as usize])
            .map(|run| (run.instance, run.triangles.clone()))
            .collect();
        // Runs may reach far beyond the brick.
        let place = octree::cell_of_morton(cell.code).map(i64::from);
        let (step, half) = (1i32 << grid.sub_bits, 1i32 << (grid.sub_bits - 1));
        let is_near = |triangle: &[[i16; 3]; 3]| {
            // A fragment is at the middle of a voxel along two axes; most triangles that are small in voxels have none.
            let has_middle = |i: &usize| {
                let [a, b, c] = triangle.each_ref().map(|p| i32::from(p[*i]));
                let [lo, hi] = [a.min(b).min(c), a.max(b).max(c)];
                (lo - half + step - 1) >> grid.sub_bits <= (hi - half) >> grid.sub_bits
            };
            if (0..3).filter(has_middle).count() < 2 {
                return false;
            }
            (0..3).all(|i| {
                let cells = triangle.each_ref().map(|p| i64::from(p[i]) >> job.grid.shift());
                cells.iter().any(|cell| *cell <= place[i]) && cells.iter().any(|cell| *cell >= place[i])
            })
        };
        let triangles = LatticeTriangles::of_pieces_where(
            job.scene,
            &self.cutouts,
            &pieces,
            |p| cube.snap(grid, p.to_array()),
            is_near,
        );
        let bits = job.grid.bits();
        let brick_bits = if job.device.is_some() { bits } else { CPU_BRICK_BITS.min(bits) };
        let first = place.map(|c| c << (bits - brick_bits));
        let last = place.map(|c| ((c + 1) << (bits - brick_bits)) - 1);
        let bricks = Bricks::within(grid, brick_bits, [first, last], &triangles.triangles);
        let below = 3 * (bits - brick_bits);
        let inside = 0..bricks.len();
        let finish = |code: u32, fragments, members: &[u32]| {
            let local = code & ((1 << below) - 1);
            Brick::new(local, brick_bits, fragments, members, &triangles, &self.appearance)
        };
        let made: Vec<Brick> = match job.device {
            None => inside
                .into_par_iter()
                .filter_map(|i| {
                    let (code, clip, members) = bricks.brick(i);
                    let fragments = brick_fragments(grid, &clip, &triangles, &self.cutouts, &members);
                    finish(code, fragments, &members)
                })
                .collect(),
            Some(device) => {
                let mut made = Vec::new();
                for i in inside {
                    let (code, clip, members) = bricks.brick(i);
                    let part = triangles.part(&members);
                    let batch = part.batch(&self.cutouts);
                    let fragments = device.fragments(grid, &clip, &batch)?;
                    if job.options.voxels_from == VoxelsFrom::Peel {
                        let peeled = device.peel(grid, &clip, &batch)?;
                        same_voxels(&clip, &peeled, &fragments)?;
                    }
                    made.extend(finish(code, fragments, &members));
                }
                made
            }
        };
        if made.is_empty() {
            return Ok([Part::nothing(), Part::nothing()]);
        }
        Ok(split(job.grid, self.emits, &octree::join(bits, brick_bits, made)))
    }
}

impl Octree {
    fn join(grid: RegionGrid, emits: bool, mut regions: Vec<Region>) -> Result<Self, BakeError> {
        let disagree =
            || BakeError::Disagreement("a brick of the octree does not fit its neighbours".to_owned());
        let depth = grid.grid.bits;
        let bits = grid.bits();
        let top = (depth - bits) as usize;
        let coarse_levels = (bits + 1).saturating_sub(FINE_LEVELS) as usize;
        let planes = look_plane_count(emits);
        let mut coarse = vec![SvoLevel::default(); if coarse_levels == 0 { 0 } else { top + coarse_levels }];
        for (local, level) in coarse.iter_mut().skip(top).enumerate() {
            let nodes = regions.iter().map(|region| region.counts[local] as usize).sum();
            level.child_masks.reserve_exact(nodes);
            level.coverages.reserve_exact(nodes);
            level.colors.reserve_exact(nodes);
            level.normals.reserve_exact(nodes);
            level.cones.reserve_exact(nodes);
            level.emissive.reserve_exact(if emits { nodes } else { 0 });
        }
        for region in &mut regions {
            let bytes = std::mem::take(&mut region.coarse);
            let [mut shape, mut look] = bytes.each_ref().map(|bytes| Reader(bytes));
            for local in 0..coarse_levels {
                let nodes = region.counts[local] as usize;
                let take = |reader: &mut Reader<'_>, count: usize| -> Option<Vec<Vec<u8>>> {
                    (0..count).map(|_| reader.bytes(nodes).map(<[u8]>::to_vec)).collect()
                };
                let shape = take(&mut shape, SHAPE_PLANES).ok_or_else(disagree)?;
                let look = take(&mut look, planes).ok_or_else(disagree)?;
                let from = level_of(&shape, &look).ok_or_else(disagree)?;
                coarse[top + local].append(from);
            }
        }
        let mut codes: Vec<u32> = regions.iter().map(|region| region.code).collect();
        octree::build_above(&mut coarse, top, &mut codes);
        let mut nodes = vec![0u64; depth as usize + 1];
        for (level, count) in coarse.iter().zip(&mut nodes) {
            *count = level.colors.len() as u64;
        }
        for region in &regions {
            for (local, count) in region.counts.iter().enumerate().skip(coarse_levels) {
                nodes[top + local] += u64::from(*count);
            }
        }
        let info = SvoInfo {
            origin: grid.cube.origin,
            size: grid.cube.size,
            levels: depth,
            emissive: u32::from(emits),
            leaves: nodes[depth as usize],
            nodes: nodes.iter().sum(),
        };
        Ok(Self { grid, emits, regions, coarse, info })
    }

    /// Appends the octree's levels: geometry of all levels first, then attributes, coarse levels first. The bricks wait
    /// in `spool`.
    pub fn write<W: Write + Seek>(
        &self,
        writer: &mut ArchiveWriter<W>,
        spool: &ChunkSpool,
    ) -> Result<(), BakeError> {
        let depth = self.grid.grid.bits;
        let look_sections = [
            (name::SVO_COLORS, 0..3),
            (name::SVO_NORMALS, 3..5),
            (name::SVO_CONES, 5..6),
            (name::SVO_EMISSIVE, 6..10),
        ];
        // The deepest masks first, of which those of the fine levels above are parts.
        let fine = self.coarse.len() as u32..depth;
        for level in (0..fine.start.min(depth)).chain(fine.rev()) {
            self.write_section(writer, spool, name::SVO_MASKS, level, 0..1, false)?;
        }
        for level in 0..=depth {
            if level < depth {
                self.write_section(writer, spool, name::SVO_COVERAGES, level, 1..2, false)?;
            }
            for (section, planes) in &look_sections[..if self.emits { 4 } else { 3 }] {
                self.write_section(writer, spool, section, level, planes.clone(), true)?;
            }
        }
        Ok(())
    }

    /// Appends some planes of the shape or of the look of a level.
    fn write_section<W: Write + Seek>(
        &self,
        writer: &mut ArchiveWriter<W>,
        spool: &ChunkSpool,
        section: &str,
        level: u32,
        planes: std::ops::Range<usize>,
        is_look: bool,
    ) -> Result<(), BakeError> {
        writer.begin_section(section, level)?;
        if let Some(level) = self.coarse.get(level as usize) {
            let all = if is_look { look_planes(level, self.emits) } else { shape_planes(level).to_vec() };
            writer.append_raw(&all[planes].concat())?;
            return Ok(());
        }
        let per_level = if is_look { look_plane_count(self.emits) } else { SHAPE_PLANES };
        let fine_level = level as usize - self.coarse.len();
        for plane in planes {
            for region in &self.regions {
                let fine = &region.fine[usize::from(is_look)];
                for chunk in &fine[fine_level * per_level + plane] {
                    writer.append(spool.get(chunk)?.as_ref())?;
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::Silent;
    use crate::cube::SceneCube;
    use crate::generate::{SceneKind, generate};
    use manyview_shaders::raster::Grid;

    /// An octree of 8 bricks in a file, made within these limits; and whether bricks waited on disk.
    fn octree_bytes(bricks_bytes: u64, spool_bytes: u64) -> (Vec<u8>, bool) {
        let scene = generate(SceneKind::Town, 2_000, 1);
        let options = BakeOptions { levels: 9, rows: None, ..BakeOptions::default() };
        let runs = Runs::new(&scene);
        let (min, max) = runs.bounds().unwrap();
        let cube = SceneCube::around(min.to_array(), max.to_array()).unwrap();
        let grid = RegionGrid { cube, grid: Grid::new(options.levels) };
        let cells = grid.cells(&scene, &runs).cells;
        assert!(cells.len() > 2, "{}", cells.len());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.mvb");
        let mut writer = ArchiveWriter::create(&path).unwrap();
        crate::sections::write_scene(&mut writer, &bytemuck::Zeroable::zeroed(), &[]).unwrap();
        let spool = writer.spool(spool_bytes);
        let job = OctreeJob {
            scene: &scene,
            runs: &runs,
            options: &options,
            grid,
            cells: &cells,
            costs: &grid.costs(&runs, &cells),
            bricks_bytes,
            spool: &spool,
            device: None,
            steps: &Steps::without_store(),
            progress: &Silent,
        };
        job.run().unwrap().write(&mut writer, &spool).unwrap();
        writer.finish().unwrap();
        let is_on_disk = spool.is_on_disk();
        drop(spool);
        assert_eq!(fs_err::read_dir(folder.path()).unwrap().count(), 1, "the archive alone is left");
        (fs_err::read(&path).unwrap(), is_on_disk)
    }

    #[test]
    fn bricks_one_by_one_and_on_disk_give_the_same_bytes() {
        let (usual, is_on_disk) = octree_bytes(1 << 40, 1 << 40);
        assert!(!is_on_disk);
        let (little, is_on_disk) = octree_bytes(0, 0);
        assert!(is_on_disk);
        assert!(usual == little);
    }
}
