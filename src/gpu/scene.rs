//! A bake on the GPU, usable while it is still arriving.
//!
//! # Practice
//! [`GpuScene::stream`] reads the heads, allocates everything, uploads a coarse part and returns. From then on the scene
//! answers for every direction; what answers gets finer while the caller calls [`GpuScene::poll`] (once a frame, say),
//! or [`GpuScene::finish`], or leaves it to a thread ([`GpuScene::refine_in_background`]).
//!
//! On the GPU there are
//! - the *rows texture* ([`manyview_shaders::rows_texture`]): one tile for each direction that is kept;
//! - the *frames*: an array of [`DirectionFrame`]s, one for each tile;
//! - the *tile table*: for each direction of the set the tile that answers for it, a `u32` each. A direction that is not
//!   resident is answered by the nearest one that is: once it arrives, by itself; the others are looked up anew when
//!   the number of resident ones has doubled;
//! - the *octree levels*: one buffer of [`SvoNode`]s for each level from the root down to
//!   [`Progress::octree_levels`].
//!
//! Before the coarse part has arrived ([`GpuScene::begin`]) the texture is empty and nothing is occluded.

use std::collections::VecDeque;
use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError, RwLock};

use manyview_shaders::device::DeviceError;
use manyview_shaders::directions::{DirectionFrame, DirectionSet, RowLattice};
use manyview_shaders::executor::ExecutorLimits;
use manyview_shaders::rows_texture::RowsTexture;
use manyview_shaders::sections::RowsInfo;
use manyview_shaders::svo_nodes::SvoNode;
use thiserror::Error;

use super::GpuContext;
use super::plan::Plan;
use super::resident::Resident;
use super::stream::{Refinement, Ring, Step};
use crate::archive::{Archive, LoadError};

/// The octree gets at most one in so many bytes of the budget unless the caller says otherwise.
const OCTREE_SHARE: u64 = 16;
/// Levels of the octree that belong to the coarse part take at most so many bytes.
const COARSE_OCTREE_BYTES: u64 = 1 << 20;

/// What a scene may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct StreamOptions {
    /// The most GPU memory for all buffers and textures of the scene. Where the rows do not fit, every second direction
    /// of the set is kept, or fewer ([`GpuScene::directions_kept`]). Staging memory of some 4 MiB a thread comes on top.
    pub budget_bytes: u64,
    /// The most of it that goes to the octree: levels from the root on, as far as the rows leave room. A level takes as
    /// much memory on the CPU while it is loaded.
    pub octree_bytes: u64,
}

impl StreamOptions {
    /// Rows and, for at most a sixteenth of the budget, octree.
    pub fn new(budget_bytes: u64) -> Self {
        Self { budget_bytes, octree_bytes: budget_bytes / OCTREE_SHARE }
    }

    /// With this limit for the octree; 0 leaves it out.
    #[must_use]
    pub fn with_octree_bytes(self, octree_bytes: u64) -> Self {
        Self { octree_bytes, ..self }
    }
}

/// How far streaming is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Bytes uploaded, as they are in memory.
    pub bytes_done: u64,
    /// Bytes when all has arrived.
    pub bytes_total: u64,
    /// Directions that answer for themselves.
    pub directions_resident: u32,
    /// Directions that will.
    pub directions_kept: u32,
    /// Levels of the octree that have arrived, root included.
    pub octree_levels: u32,
    /// Levels that will.
    pub octree_levels_kept: u32,
    /// Whether the coarse part has arrived, so that there is an answer for every direction.
    pub is_usable: bool,
    /// Whether all has been uploaded.
    pub is_complete: bool,
}

/// Why a scene could not be streamed.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum StreamError {
    /// The archive has no rows, or is corrupt.
    #[error(transparent)]
    Load(#[from] LoadError),
    /// The device was lost, is out of memory or refused a command.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// Not even the smallest part that is of use fits.
    #[error(
        "{archive}: the smallest part of the rows takes {needed_bytes} bytes of GPU memory, more than the budget of {budget_bytes}; raise the budget, or bake fewer directions or voxels"
    )]
    OverBudget {
        /// The archive's path or name.
        archive: String,
        /// What the smallest part takes.
        needed_bytes: u64,
        /// What there is.
        budget_bytes: u64,
    },
    /// Somebody cancelled.
    #[error("streaming was cancelled")]
    Cancelled,
}

/// The rows and the coarse octree of a bake on the GPU. See the [module](self).
///
/// ```no_run
/// use manyview::gpu::{AdapterChoice, GpuContext, GpuScene, StreamOptions};
///
/// let gpu = GpuContext::open(&AdapterChoice::default())?; // or a device and queue of your own
/// let bake = manyview::Archive::open("city.mvb")?;
/// let scene = GpuScene::stream(gpu.device(), gpu.queue(), &bake, StreamOptions::new(3 << 30))?;
/// loop {
///     let progress = scene.poll(16 << 20)?; // a frame's share
///     // … draw with scene.rows_view(), scene.frames_buffer(), scene.tile_table() …
///     if progress.is_complete {
///         break;
///     }
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct GpuScene {
    context: GpuContext,
    archive: Archive,
    info: RowsInfo,
    directions: DirectionSet,
    kept: Vec<u32>,
    tile_of: Vec<Option<u32>>,
    layout: RowsTexture,
    frames: Vec<DirectionFrame>,
    rows: wgpu::Texture,
    rows_view: wgpu::TextureView,
    frames_buffer: wgpu::Buffer,
    tile_table: wgpu::Buffer,
    resident: RwLock<Resident>,
    octree: RwLock<Vec<wgpu::Buffer>>,
    octree_levels_kept: u32,
    bytes_total: u64,
    gpu_bytes: u64,
    refinement: Mutex<Refinement>,
    cancelled: AtomicBool,
}

impl fmt::Debug for GpuScene {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("GpuScene")
            .field("archive", &self.archive.name())
            .field("context", &self.context)
            .finish_non_exhaustive()
    }
}

impl GpuScene {
    /// Allocates the scene on the caller's device, which needs no more than WebGPU's default limits, and uploads the
    /// coarse part: a sixteenth of the rows, spread over all directions, and the first levels of the octree. Waits for
    /// uploads where more than a few are under way; a browser calls [`begin`](Self::begin) instead.
    pub fn stream(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        archive: &Archive,
        options: StreamOptions,
    ) -> Result<Self, StreamError> {
        let scene = Self::begin(device, queue, archive, options)?;
        scene.drive(|progress| progress.is_usable)?;
        Ok(scene)
    }

    /// Allocates the scene, and uploads nothing but the frames. Never waits.
    pub fn begin(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        archive: &Archive,
        options: StreamOptions,
    ) -> Result<Self, StreamError> {
        let no_rows = || LoadError::NoRows { archive: archive.name().to_owned() };
        let info = *archive.rows_info().ok_or_else(no_rows)?;
        let directions = archive.direction_set().ok_or_else(no_rows)?;
        let all_frames = archive.frames()?;
        let axes: Vec<[f32; 3]> =
            (0..directions.count()).map(|d| directions.frame(d)[2].map(|c| c as f32)).collect();
        let budget_bytes = options.budget_bytes;
        let bytes_of = |layout: &RowsTexture| {
            let frames = u64::from(layout.directions()) * size_of::<DirectionFrame>() as u64;
            layout.bytes() + frames + u64::from(directions.count()) * 4
        };
        let plan = Plan::new(&info, directions, &axes, budget_bytes, bytes_of).map_err(|needed_bytes| {
            let archive = archive.name().to_owned();
            StreamError::OverBudget { archive, needed_bytes, budget_bytes }
        })?;
        let rows_bytes = bytes_of(&plan.layout);
        let octree = octree_levels(archive, options.octree_bytes.min(budget_bytes - rows_bytes));
        let octree_bytes = octree.iter().sum::<u64>();

        let context = GpuContext::from_device(device.clone(), queue.clone());
        let rows = create_texture(&context, &plan.layout)?;
        let rows_view = rows.create_view(&wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2Array),
            ..wgpu::TextureViewDescriptor::default()
        });
        let frames: Vec<DirectionFrame> = plan.kept.iter().map(|&d| all_frames[d as usize]).collect();
        let frames_bytes: &[u8] = bytemuck::cast_slice(&frames);
        let frames_buffer = create_buffer(&context, "direction frames", frames_bytes.len() as u64)?;
        // Zero to begin with: tile 0.
        let tile_table = create_buffer(&context, "tile table", u64::from(directions.count()) * 4)?;
        context.guarded("direction frames", frames_bytes.len() as u64, || {
            queue.write_buffer(&frames_buffer, 0, frames_bytes);
        })?;
        let ring = Ring::new(&context, 2 * rayon::current_num_threads().max(1))?;

        let mut tile_of = vec![None; axes.len()];
        for (tile, &direction) in (0..).zip(&plan.kept) {
            tile_of[direction as usize] = Some(tile);
        }
        let mut steps = VecDeque::new();
        let mut before = 0;
        let (mut coarse, mut fine) = (Vec::new(), Vec::new());
        for (level, bytes) in (0..).zip(&octree) {
            before += bytes;
            if before <= COARSE_OCTREE_BYTES { &mut coarse } else { &mut fine }.push(Step::Octree(level));
        }
        steps.extend(coarse);
        steps.extend(plan.units.into_iter().map(Step::Rows));
        steps.extend(fine);
        Ok(Self {
            archive: archive.clone(),
            info,
            directions,
            layout: plan.layout,
            frames,
            rows,
            rows_view,
            frames_buffer,
            tile_table,
            resident: RwLock::new(Resident::new(axes)),
            octree: RwLock::default(),
            octree_levels_kept: octree.len() as u32,
            bytes_total: plan.kept.len() as u64 * info.direction_bytes() as u64 + octree_bytes,
            gpu_bytes: rows_bytes + octree_bytes,
            kept: plan.kept,
            tile_of,
            refinement: Mutex::new(Refinement::new(steps, plan.coarse_units, ring)),
            cancelled: AtomicBool::new(false),
            context,
        })
    }

    /// Goes on for about `max_bytes`, at least one piece, unless too much is under way to the GPU already. Decodes on the
    /// threads of the current rayon pool, and never waits for the GPU. After an error of the archive what has arrived
    /// stays usable, and the next call tries again.
    pub fn poll(&self, max_bytes: u64) -> Result<Progress, StreamError> {
        self.go_on(&mut self.lock(), max_bytes)
    }

    /// Goes on until all has arrived on the GPU. Waits.
    pub fn finish(&self) -> Result<Progress, StreamError> {
        self.drive(|progress| progress.is_complete)?;
        self.wait()?;
        Ok(self.progress())
    }

    /// Waits until what was uploaded so far has arrived on the GPU, or for the reason why it has not.
    pub fn wait(&self) -> Result<(), StreamError> {
        loop {
            let pending = {
                let refinement = &mut *self.lock();
                let collected = self.context.pump().and_then(|()| refinement.ring.collect(&self.context));
                if let Err(error) = collected {
                    refinement.failure.get_or_insert(error.to_string());
                    return Err(error.into());
                }
                refinement.ring.pending()
            };
            match pending {
                Some(submission) => self.context.wait(&submission)?,
                None => return Ok(()),
            }
        }
    }

    /// Ends streaming: [`poll`](Self::poll) and [`finish`](Self::finish), also those under way on other threads, return
    /// [`StreamError::Cancelled`]. The scene stays as it is.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }

    /// How far streaming is. Waits while another thread is in [`poll`](Self::poll).
    pub fn progress(&self) -> Progress {
        self.progress_of(&self.lock())
    }

    /// The direction that answers for `direction`: itself once it is resident, else one near it. Before the coarse part
    /// has arrived it may be one whose rows are still empty.
    ///
    /// # Panics
    /// If the set has no such direction.
    pub fn resident_direction(&self, direction: u32) -> u32 {
        self.resident.read().unwrap_or_else(PoisonError::into_inner).nearest()[direction as usize]
    }

    /// Whether the rows of a direction have been uploaded.
    pub fn is_resident(&self, direction: u32) -> bool {
        self.resident.read().unwrap_or_else(PoisonError::into_inner).has(direction)
    }

    /// The tile of a direction in the rows texture, its place in [`frames`](Self::frames); `None` for directions that
    /// are not kept.
    pub fn tile_of(&self, direction: u32) -> Option<u32> {
        self.tile_of.get(direction as usize).copied().flatten()
    }

    /// The directions that have a tile, tile by tile: all, or as many as the budget holds. Tiles are numbered in the order
    /// in which they arrive.
    pub fn directions_kept(&self) -> &[u32] {
        &self.kept
    }

    /// What the rows are.
    pub fn rows_info(&self) -> &RowsInfo {
        &self.info
    }

    /// The sampled directions.
    pub fn direction_set(&self) -> DirectionSet {
        self.directions
    }

    /// Where the frames start from.
    pub fn row_lattice(&self) -> RowLattice {
        RowLattice { center: self.info.center, half_extent: self.info.half_extent }
    }

    /// Where tiles lie in the rows texture.
    pub fn layout(&self) -> &RowsTexture {
        &self.layout
    }

    /// The frame of each tile.
    pub fn frames(&self) -> &[DirectionFrame] {
        &self.frames
    }

    /// The device with its pipelines, for a [`WgpuExecutor`](super::WgpuExecutor).
    pub fn context(&self) -> &GpuContext {
        &self.context
    }

    /// The rows texture, `rgba32uint`.
    pub fn rows_texture(&self) -> &wgpu::Texture {
        &self.rows
    }

    /// All layers of the rows texture: a `texture_2d_array<u32>`.
    pub fn rows_view(&self) -> &wgpu::TextureView {
        &self.rows_view
    }

    /// [`frames`](Self::frames) as a storage buffer.
    pub fn frames_buffer(&self) -> &wgpu::Buffer {
        &self.frames_buffer
    }

    /// For each direction of the set the tile that answers for it: a storage buffer of `u32`. Changes in place while the
    /// scene is refined.
    pub fn tile_table(&self) -> &wgpu::Buffer {
        &self.tile_table
    }

    /// The levels of the octree that have arrived, from the root on: storage buffers of [`SvoNode`]s. The nodes of the
    /// last one stand for all below them.
    pub fn octree_levels(&self) -> Vec<wgpu::Buffer> {
        self.octree.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// GPU memory that the scene takes once complete.
    pub fn gpu_bytes(&self) -> u64 {
        self.gpu_bytes
    }

    fn lock(&self) -> MutexGuard<'_, Refinement> {
        self.refinement.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Polls until `reached`, waiting for the GPU where nothing else is to be done.
    fn drive(&self, reached: impl Fn(&Progress) -> bool) -> Result<(), StreamError> {
        loop {
            let (progress, pending) = {
                let mut refinement = self.lock();
                let progress = self.go_on(&mut refinement, u64::MAX)?;
                let is_full = refinement.ring.collect(&self.context)? == 0;
                (progress, refinement.ring.pending().filter(|_| is_full))
            };
            if reached(&progress) {
                return Ok(());
            }
            if let Some(submission) = pending {
                self.context.wait(&submission)?;
            }
        }
    }

    fn go_on(&self, refinement: &mut Refinement, max_bytes: u64) -> Result<Progress, StreamError> {
        if self.cancelled.load(Ordering::Relaxed) {
            return Err(StreamError::Cancelled);
        }
        let result = self.try_go_on(refinement, max_bytes);
        if let Err(StreamError::Device(error)) = &result {
            // What was under way is lost, so that nobody may take the scene for complete.
            refinement.failure.get_or_insert(error.to_string());
        }
        result
    }

    fn try_go_on(&self, refinement: &mut Refinement, max_bytes: u64) -> Result<Progress, StreamError> {
        if let Some(failure) = &refinement.failure {
            return Err(DeviceError::Failed(format!("streaming ended earlier: {failure}")).into());
        }
        self.context.pump()?;
        let free = refinement.ring.collect(&self.context)?;
        let threads = rayon::current_num_threads().max(1);
        let unit_bytes = refinement.decoded.front().map_or(1, |decoded| decoded.rows.len() as u64 * 4).max(1);
        let most =
            usize::try_from(max_bytes / unit_bytes).unwrap_or(usize::MAX).max(1).min(free).min(threads);
        if refinement.decoded.is_empty()
            && free > 0
            && let Some(&Step::Octree(level)) = refinement.steps.front()
        {
            self.load_octree_level(refinement, level)?;
            return Ok(self.progress_of(refinement));
        }
        // While rows are uploaded on this thread, the next ones are decoded on the others.
        let uploads = refinement.decoded.len().min(most);
        let wave =
            if refinement.decoded.len() == uploads { refinement.take_units(threads) } else { Vec::new() };
        let words = self.layout.words_a_direction();
        let (uploaded, decoded) =
            refinement.decode(&self.archive, words, wave, |refinement| self.upload(refinement, uploads));
        uploaded?;
        decoded?;
        Ok(self.progress_of(refinement))
    }

    fn load_octree_level(&self, refinement: &mut Refinement, level: u32) -> Result<(), StreamError> {
        let nodes = SvoNode::of_level(&self.archive.svo_level_alone(level)?);
        refinement.bytes_done += size_of_val(&nodes[..]) as u64;
        let buffer = refinement.upload_octree_level(&self.context, nodes)?;
        refinement.steps.pop_front();
        self.octree.write().unwrap_or_else(PoisonError::into_inner).push(buffer);
        Ok(())
    }

    fn upload(&self, refinement: &mut Refinement, units: usize) -> Result<(), DeviceError> {
        for _ in 0..units {
            let Some(decoded) = refinement.decoded.pop_front() else { break };
            let unit = decoded.unit.clone();
            refinement.upload_rows(&self.context, &self.rows, &self.layout, &self.kept, decoded)?;
            refinement.units_done += 1;
            refinement.bytes_done += unit.kept.len() as u64 * self.info.direction_bytes() as u64;
            let mut resident = self.resident.write().unwrap_or_else(PoisonError::into_inner);
            for &direction in &self.kept[unit.kept.clone()] {
                resident.insert(direction);
            }
            let mut changed = unit.directions;
            if refinement.units_done >= refinement.next_refresh {
                resident.refresh();
                refinement.next_refresh = refinement.units_done * 2;
                changed = 0..self.directions.count();
            } else if refinement.is_done() {
                resident.refresh();
                changed = 0..self.directions.count();
            }
            let tile = |direction: &u32| self.tile_of(*direction).unwrap_or(0);
            let tiles: Vec<u32> =
                resident.nearest()[changed.start as usize..changed.end as usize].iter().map(tile).collect();
            drop(resident);
            self.context.guarded("the tile table", tiles.len() as u64 * 4, || {
                let offset = u64::from(changed.start) * 4;
                self.context.queue().write_buffer(&self.tile_table, offset, bytemuck::cast_slice(&tiles));
                self.context.queue().submit([]);
            })?;
        }
        Ok(())
    }

    fn progress_of(&self, refinement: &Refinement) -> Progress {
        let resident = self.resident.read().unwrap_or_else(PoisonError::into_inner).count();
        Progress {
            bytes_done: refinement.bytes_done,
            bytes_total: self.bytes_total,
            directions_resident: resident as u32,
            directions_kept: self.kept.len() as u32,
            octree_levels: self.octree.read().unwrap_or_else(PoisonError::into_inner).len() as u32,
            octree_levels_kept: self.octree_levels_kept,
            is_usable: refinement.units_done >= refinement.coarse_units,
            is_complete: refinement.is_done(),
        }
    }
}

/// Bytes of each level of the octree that is kept, root first: as many as fit, each in one binding.
fn octree_levels(archive: &Archive, most_bytes: u64) -> Vec<u64> {
    let mut left = most_bytes;
    (0..=archive.svo_info().levels)
        .map_while(|level| {
            let bytes = archive.svo_node_count(level)? * size_of::<SvoNode>() as u64;
            left = left.checked_sub(bytes)?;
            (bytes <= ExecutorLimits::DEFAULT.binding_bytes).then_some(bytes)
        })
        .collect()
}

fn create_buffer(context: &GpuContext, what: &'static str, bytes: u64) -> Result<wgpu::Buffer, DeviceError> {
    let limit_bytes = ExecutorLimits::DEFAULT.binding_bytes;
    if bytes > limit_bytes {
        return Err(DeviceError::TooLarge { what, needed_bytes: bytes, limit_bytes });
    }
    context.guarded(what, bytes, || {
        context.device().create_buffer(&wgpu::BufferDescriptor {
            label: Some(what),
            size: bytes,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        })
    })
}

fn create_texture(context: &GpuContext, layout: &RowsTexture) -> Result<wgpu::Texture, DeviceError> {
    let [width, height, depth_or_array_layers] = layout.size();
    context.guarded("the rows texture", layout.bytes(), || {
        context.device().create_texture(&wgpu::TextureDescriptor {
            label: Some("rows"),
            size: wgpu::Extent3d { width, height, depth_or_array_layers },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba32Uint,
            usage: wgpu::TextureUsages::TEXTURE_BINDING
                | wgpu::TextureUsages::COPY_SRC
                | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        })
    })
}
