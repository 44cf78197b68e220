//! A bake on disk, with types: what [`manyview_shaders::sections`] says its sections mean, checked.
//!
//! Opening reads the index and the three heads (scene, octree, rows) and checks the size of every section against
//! them; nothing else is read until asked for. So a wrong or hostile archive is refused before memory is taken for
//! it, and what is loaded later takes the memory that [`Archive::svo_bytes`] and the like announce.

mod error;
mod layout;

use std::ops::{Bound, Range, RangeBounds};
use std::path::Path;
use std::sync::Arc;

use bytemuck::{AnyBitPattern, Zeroable};
use manyview_cache::archive::{Archive as Container, ByteSource, Section};
use manyview_shaders::directions::{DirectionFrame, DirectionSet, RowLattice};
use manyview_shaders::sections::{Light, RowsInfo, SceneInfo, SvoInfo, name};
use manyview_shaders::svo::{Svo, SvoError, SvoLevel};
use rayon::prelude::*;

use error::Broken;
pub use error::LoadError;

/// What one load may take unless the caller says otherwise.
const DEFAULT_MEMORY_LIMIT_BYTES: u64 = 16 << 30;

/// A bake, open for reading.
///
/// ```no_run
/// let bake = manyview::Archive::open("city.mvb")?;
/// let coarse = bake.svo_levels(..=5)?;
/// println!("{} cells at level 5", coarse.node_count(5));
/// # Ok::<(), manyview::LoadError>(())
/// ```
///
/// Clones are further handles to the same open archive.
#[derive(Clone)]
pub struct Archive {
    container: Arc<Container>,
    scene: SceneInfo,
    svo: SvoInfo,
    nodes_of: Vec<u64>,
    rows: Option<(RowsInfo, DirectionSet)>,
    memory_limit_bytes: u64,
}

impl Archive {
    /// Opens the bake at `path`.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, LoadError> {
        Self::from_container(Container::open(path)?)
    }

    /// Opens a bake in memory.
    pub fn from_bytes(bytes: Vec<u8>) -> Result<Self, LoadError> {
        Self::from_container(Container::from_bytes(bytes)?)
    }

    /// Opens a bake anywhere: a server, a browser's cache. The `name` is for messages.
    pub fn from_source(source: Box<dyn ByteSource>, name: String) -> Result<Self, LoadError> {
        Self::from_container(Container::from_source(source, name)?)
    }

    /// Takes an open container for a bake, once its heads and sizes are checked.
    pub fn from_container(container: Container) -> Result<Self, LoadError> {
        let scene: SceneInfo = read_head(&container, container.expect_section(name::SCENE_INFO, 0)?)?;
        let svo: SvoInfo = read_head(&container, container.expect_section(name::SVO_INFO, 0)?)?;
        let rows: Option<RowsInfo> = match container.section(name::ROWS_INFO, 0) {
            Some(section) => Some(read_head(&container, section)?),
            None => None,
        };
        let named = |broken: Broken| broken.in_archive(container.name());
        layout::check_scene(&container, &scene).map_err(named)?;
        let nodes_of = layout::check_svo(&container, &svo).map_err(named)?;
        let rows = match rows {
            Some(info) => Some((info, layout::check_rows(&container, &info).map_err(named)?)),
            None => None,
        };
        let container = Arc::new(container);
        Ok(Self { container, scene, svo, nodes_of, rows, memory_limit_bytes: DEFAULT_MEMORY_LIMIT_BYTES })
    }

    /// Sets the memory that one load may take (16 GiB unless set): a small file can hold an octree of terabytes.
    #[must_use]
    pub fn with_memory_limit(mut self, bytes: u64) -> Self {
        self.memory_limit_bytes = bytes;
        self
    }

    /// The path or name, for messages.
    pub fn name(&self) -> &str {
        self.container.name()
    }

    /// The container: sections, chunks, digests.
    pub fn container(&self) -> &Container {
        &self.container
    }

    /// Counts and bounds of the scene.
    pub fn scene_info(&self) -> &SceneInfo {
        &self.scene
    }

    /// The scene's punctual lights.
    pub fn lights(&self) -> Result<Vec<Light>, LoadError> {
        let Some(section) = self.container.section(name::SCENE_LIGHTS, 0) else { return Ok(Vec::new()) };
        let lights: Vec<Light> = self.read_array(section)?;
        for (index, light) in lights.iter().enumerate() {
            let finite =
                light.position.iter().chain(&light.direction).chain(&light.intensity).all(|c| c.is_finite());
            if light.kind > 2 || !finite {
                let found = format!("kind {} at {:?} in light {index}", light.kind, light.position);
                let broken = Broken::new(section.id, "light", "kind 0, 1 or 2 and finite numbers", found);
                return Err(broken.in_archive(self.name()));
            }
        }
        Ok(lights)
    }

    /// Where the octree lies and how large it is.
    pub fn svo_info(&self) -> &SvoInfo {
        &self.svo
    }

    /// Nodes of a level of the octree, known without reading it.
    pub fn svo_node_count(&self, level: u32) -> Option<u64> {
        self.nodes_of.get(level as usize).copied()
    }

    /// Edge of a cell at `level`, metres.
    pub fn cell_size(&self, level: u32) -> f64 {
        self.svo.size / f64::from(level).exp2()
    }

    /// The memory that the levels 0 to `last` of the octree take once loaded.
    pub fn svo_bytes(&self, last: u32) -> u64 {
        let bytes_a_node = 8 + if self.svo.emissive == 1 { 4 } else { 0 };
        self.nodes_of.iter().take(last as usize + 1).map(|nodes| nodes * bytes_a_node).sum()
    }

    /// The whole octree, validated.
    pub fn svo(&self) -> Result<Svo, LoadError> {
        self.svo_levels(..)
    }

    /// The octree from the root to the last level of `levels`, validated; that level's nodes become leaves, so their
    /// child masks and coverages are left out. The start of the range makes no difference: without the levels above,
    /// a level has no positions.
    pub fn svo_levels(&self, levels: impl RangeBounds<u32>) -> Result<Svo, LoadError> {
        let last = match levels.end_bound() {
            Bound::Included(&last) => last,
            Bound::Excluded(&end) => end.saturating_sub(1),
            Bound::Unbounded => self.svo.levels,
        };
        self.check_item("level", u64::from(last), u64::from(self.svo.levels))?;
        self.check_memory(|| format!("the octree down to level {last}"), self.svo_bytes(last))?;
        let mut svo = Svo { origin: self.svo.origin, size: self.svo.size, levels: Vec::new() };
        for level in 0..=last {
            svo.levels.push(self.svo_level(level, level == last)?);
        }
        svo.validate().map_err(|source| LoadError::Octree { archive: self.name().to_owned(), source })?;
        Ok(svo)
    }

    /// One level of the octree on its own, with its child masks and coverages unless it is the deepest one. Of the rules
    /// that [`Svo::validate`] checks, those that concern this level and the number of nodes of the next are checked.
    pub fn svo_level_alone(&self, level: u32) -> Result<SvoLevel, LoadError> {
        self.check_item("level", u64::from(level), u64::from(self.svo.levels))?;
        let bytes = self.svo_bytes(level) - level.checked_sub(1).map_or(0, |above| self.svo_bytes(above));
        self.check_memory(|| format!("level {level} of the octree"), bytes)?;
        let leaves = level == self.svo.levels;
        let content = self.svo_level(level, leaves)?;
        let broken = |rule, found: u64, expected: u64| {
            let source = SvoError { level: level as usize, rule, found, expected };
            Err(LoadError::Octree { archive: self.name().to_owned(), source })
        };
        if let Some(at) = content.child_masks.iter().position(|&mask| mask == 0) {
            return broken("an inner node without children, at index", at as u64, 0);
        }
        let children = content.child_masks.iter().map(|mask| u64::from(mask.count_ones())).sum();
        let expected = self.svo_node_count(level + 1).unwrap_or(0);
        if children != expected {
            return broken("children of a level", children, expected);
        }
        Ok(content)
    }

    fn svo_level(&self, level: u32, leaves: bool) -> Result<SvoLevel, LoadError> {
        // The size of every section was checked when the archive was opened; none is read that is empty.
        let read = |kind: &str, wanted: bool| match self.container.section(kind, level) {
            Some(section) if wanted => self.container.read_section(section),
            _ => Ok(Vec::new()),
        };
        let colors = read(name::SVO_COLORS, true)?;
        let normals = read(name::SVO_NORMALS, true)?;
        let emissive = read(name::SVO_EMISSIVE, self.svo.emissive == 1)?;
        let nodes = colors.len() / 3;
        Ok(SvoLevel {
            child_masks: read(name::SVO_MASKS, !leaves)?,
            coverages: read(name::SVO_COVERAGES, !leaves)?,
            colors: (0..nodes).map(|i| [0, 1, 2].map(|plane| colors[plane * nodes + i])).collect(),
            normals: (0..nodes).map(|i| [0, 1].map(|plane| normals[plane * nodes + i] as i8)).collect(),
            cones: read(name::SVO_CONES, true)?,
            emissive: (0..emissive.len() / 4)
                .map(|i| u32::from_le_bytes([0, 1, 2, 3].map(|plane| emissive[plane * nodes + i])))
                .collect(),
        })
    }

    /// What the rows are, if the bake has any.
    pub fn rows_info(&self) -> Option<&RowsInfo> {
        self.rows.as_ref().map(|(info, _)| info)
    }

    /// The sampled directions of the rows, if the bake has any.
    pub fn direction_set(&self) -> Option<DirectionSet> {
        self.rows.map(|(_, set)| set)
    }

    /// The lattice that the frames start from, if the bake has rows.
    pub fn row_lattice(&self) -> Option<RowLattice> {
        self.rows_info().map(|info| RowLattice { center: info.center, half_extent: info.half_extent })
    }

    /// The frame of every direction, each in range.
    pub fn frames(&self) -> Result<Vec<DirectionFrame>, LoadError> {
        self.expect_rows()?;
        let section = self.container.expect_section(name::ROWS_FRAMES, 0)?;
        let frames: Vec<DirectionFrame> = self.read_array(section)?;
        if let Some(index) = frames.iter().position(|frame| !layout::frame_is_in_range(frame)) {
            let expected = "entries below 2^15, coordinates within 32 bits";
            let found = format!("{:?} in direction {index}", frames[index]);
            return Err(Broken::new(section.id, "frame", expected, found).in_archive(self.name()));
        }
        Ok(frames)
    }

    /// Number of `rows.bits` blocks; 0 for a bake without rows.
    pub fn row_block_count(&self) -> u32 {
        self.rows_info().map_or(0, |info| info.directions.div_ceil(info.block_directions))
    }

    /// The rows of a block of [`RowsInfo::block_directions`] directions.
    pub fn row_block(&self, block: u32) -> Result<Vec<u32>, LoadError> {
        self.expect_rows()?;
        self.check_item("block", u64::from(block), u64::from(self.row_block_count()) - 1)?;
        self.read_array(self.container.expect_section(name::ROWS_BITS, block)?)
    }

    /// The rows of one direction: v by v, u by u, `2^bits` bits along w each. Reads only the chunks that they are in.
    pub fn direction_rows(&self, index: u32) -> Result<Vec<u32>, LoadError> {
        let info = self.expect_rows()?;
        self.check_item("direction", u64::from(index), u64::from(info.directions) - 1)?;
        self.rows(index..index + 1)
    }

    /// The rows of some directions, one after the other, as [`direction_rows`](Self::direction_rows) has them each.
    pub fn rows(&self, directions: Range<u32>) -> Result<Vec<u32>, LoadError> {
        let info = self.expect_rows()?;
        let bytes =
            u64::from(directions.end.saturating_sub(directions.start)) * info.direction_bytes() as u64;
        let what = || format!("the rows of {} directions", directions.len());
        self.check_memory(what, bytes)?;
        let out_of_memory =
            || LoadError::OutOfMemory { archive: self.name().to_owned(), what: what(), needed_bytes: bytes };
        let words = usize::try_from(bytes / 4).map_err(|_| out_of_memory())?;
        // Allocating zeros aborts where it fails; this, which is freed again, does not.
        Vec::<u32>::new().try_reserve_exact(words).map_err(|_| out_of_memory())?;
        let mut rows = vec![0; words];
        self.read_rows_into_zeros(directions, &mut rows)?;
        Ok(rows)
    }

    /// As [`rows`](Self::rows), into memory of the caller that is all zero. Chunks are read, checked and decoded in
    /// parallel, each straight to its place if it lies in the range as a whole; zeros are not written. After an error
    /// the content is undefined.
    ///
    /// # Panics
    /// If `zeros` is not as large as the rows of these directions.
    pub fn read_rows_into_zeros(&self, directions: Range<u32>, zeros: &mut [u32]) -> Result<(), LoadError> {
        let info = *self.expect_rows()?;
        let (start, end) =
            (u64::from(directions.start), u64::from(directions.end).max(directions.start.into()));
        if start < end {
            self.check_item("direction", end - 1, u64::from(info.directions) - 1)?;
        }
        let direction_bytes = info.direction_bytes() as u64;
        assert_eq!(zeros.len() as u64 * 4, (end - start) * direction_bytes, "words of the directions");
        let mut rest: &mut [u8] = bytemuck::cast_slice_mut(zeros);
        let mut jobs = Vec::new();
        let block_directions = u64::from(info.block_directions);
        for block in start / block_directions..end.div_ceil(block_directions).max(start / block_directions) {
            let section = self.container.expect_section(name::ROWS_BITS, block as u32)?;
            let mut chunk_start = block * block_directions * direction_bytes;
            for number in section.chunks.clone() {
                let raw_bytes = self.container.chunks()[number as usize].raw_bytes;
                let chunk_end = chunk_start + u64::from(raw_bytes);
                let from = chunk_start.max(start * direction_bytes);
                let to = chunk_end.min(end * direction_bytes);
                if from < to {
                    let (place, behind) = rest.split_at_mut((to - from) as usize);
                    rest = behind;
                    jobs.push((number, (from - chunk_start) as usize, raw_bytes as usize, place));
                }
                chunk_start = chunk_end;
            }
        }
        // All jobs end before the first error in file order is returned: the same error for any thread count.
        let results: Vec<Result<(), LoadError>> = jobs
            .into_par_iter()
            .map(|(number, from, raw_bytes, place)| {
                if place.len() == raw_bytes {
                    return Ok(self.container.read_chunk_into_zeros(number, place)?);
                }
                let mut chunk = Vec::new();
                self.container.read_chunk(number, &mut chunk)?;
                place.copy_from_slice(&chunk[from..from + place.len()]);
                Ok(())
            })
            .collect();
        results.into_iter().collect()
    }

    /// A section as little-endian values of one type. The section's size is a multiple of theirs, as checked before.
    fn read_array<T: AnyBitPattern + Zeroable + bytemuck::NoUninit>(
        &self,
        section: &Section,
    ) -> Result<Vec<T>, LoadError> {
        self.check_memory(|| format!("section {}", section.id), section.raw_bytes)?;
        let bytes = self.container.read_section(section)?;
        let mut values = vec![T::zeroed(); bytes.len() / size_of::<T>()];
        bytemuck::cast_slice_mut::<T, u8>(&mut values).copy_from_slice(&bytes);
        Ok(values)
    }

    fn expect_rows(&self) -> Result<&RowsInfo, LoadError> {
        self.rows_info().ok_or_else(|| LoadError::NoRows { archive: self.name().to_owned() })
    }

    fn check_item(&self, what: &'static str, index: u64, last: u64) -> Result<(), LoadError> {
        if index <= last {
            Ok(())
        } else {
            Err(LoadError::NoSuchItem { archive: self.name().to_owned(), what, index, last })
        }
    }

    fn check_memory(&self, what: impl FnOnce() -> String, needed_bytes: u64) -> Result<(), LoadError> {
        let limit_bytes = self.memory_limit_bytes;
        if needed_bytes <= limit_bytes {
            return Ok(());
        }
        Err(LoadError::OverBudget {
            archive: self.name().to_owned(),
            what: what(),
            needed_bytes,
            limit_bytes,
        })
    }
}

/// Reads the struct at the head of a group. Its size is checked first, so that nothing larger is read.
fn read_head<T: bytemuck::Pod>(container: &Container, section: &Section) -> Result<T, LoadError> {
    let expected = size_of::<T>() as u64;
    Broken::unless_equal(section.id, "bytes of the section", expected, section.raw_bytes)
        .map_err(|broken| broken.in_archive(container.name()))?;
    Ok(bytemuck::pod_read_unaligned(&container.read_section(section)?))
}

// Structs and words are read in place: on a big-endian machine their bytes would have to be swapped first.
const _: () = assert!(cfg!(target_endian = "little"), "manyview runs on little-endian machines");
