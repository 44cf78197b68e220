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
use std::sync::atomic::AtomicBool;
use std::sync::{Mutex, PoisonError, RwLock};

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
    pub(super) context: GpuContext,
    pub(super) archive: Archive,
    pub(super) info: RowsInfo,
    pub(super) directions: DirectionSet,
    pub(super) kept: Vec<u32>,
    pub(super) tile_of: Vec<Option<u32>>,
    pub(super) layout: RowsTexture,
    pub(super) frames: Vec<DirectionFrame>,
    pub(super) rows: wgpu::Texture,
    pub(super) rows_view: wgpu::TextureView,
    pub(super) frames_buffer: wgpu::Buffer,
    pub(super) tile_table: wgpu::Buffer,
    pub(super) resident: RwLock<Resident>,
    pub(super) octree: RwLock<Vec<wgpu::Buffer>>,
    pub(super) octree_levels_kept: u32,
    pub(super) bytes_total: u64,
    pub(super) gpu_bytes: u64,
    pub(super) refinement: Mutex<Refinement>,
    pub(super) cancelled: AtomicBool,
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

    /// Allocates the scene, and uploads nothing but the frames. Never waits. [`poll`](Self::poll) and its kin do the
    /// rest, so that the coarse part too can be cancelled, and be left to a thread.
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
        let (rows, rows_view) = create_texture(&context, &plan.layout)?;
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

fn create_texture(
    context: &GpuContext,
    layout: &RowsTexture,
) -> Result<(wgpu::Texture, wgpu::TextureView), DeviceError> {
    let [width, height, depth_or_array_layers] = layout.size();
    context.guarded("the rows texture", layout.bytes(), || {
        let texture = context.device().create_texture(&wgpu::TextureDescriptor {
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
        });
        let view = texture.create_view(&wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2Array),
            ..wgpu::TextureViewDescriptor::default()
        });
        (texture, view)
    })
}
