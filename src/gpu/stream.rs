//! The work of streaming a scene: what is left, what is on its way to the GPU.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

use manyview_shaders::device::DeviceError;
use manyview_shaders::rows_texture::RowsTexture;
use manyview_shaders::svo_nodes::SvoNode;

use super::GpuContext;
use super::plan::Unit;
use crate::archive::{Archive, LoadError};

/// Bytes that are uploaded and submitted at once: larger pieces are several times slower.
const SUBMIT_BYTES: usize = 4 << 20;

/// A part of the scene that arrives as a whole.
#[derive(Debug, Clone)]
pub(super) enum Step {
    /// A level of the octree.
    Octree(u32),
    /// The rows of some directions.
    Rows(Unit),
}

/// Rows in memory, on their way.
#[derive(Debug)]
pub(super) struct Decoded {
    pub(super) unit: Unit,
    pub(super) rows: Vec<u32>,
}

/// What is left to do.
#[derive(Debug)]
pub(super) struct Refinement {
    /// Not begun, next first.
    pub(super) steps: VecDeque<Step>,
    /// Decoded and not uploaded.
    pub(super) decoded: VecDeque<Decoded>,
    /// Memory of rows that were uploaded, to be used again.
    spare: Vec<Vec<u32>>,
    texels: Vec<[u32; 4]>,
    pub(super) ring: Ring,
    /// Units of rows uploaded so far.
    pub(super) units_done: usize,
    /// Units of rows until the scene is usable.
    pub(super) coarse_units: usize,
    /// Units of rows in all.
    pub(super) all_units: usize,
    /// At so many units the nearest directions are found again.
    pub(super) next_refresh: usize,
    pub(super) bytes_done: u64,
    /// What the device said when it failed; nothing goes on then.
    pub(super) failure: Option<String>,
}

impl Refinement {
    pub(super) fn new(steps: VecDeque<Step>, coarse_units: usize, ring: Ring) -> Self {
        let all_units = steps.iter().filter(|step| matches!(step, Step::Rows(_))).count();
        Self {
            all_units,
            steps,
            decoded: VecDeque::new(),
            spare: Vec::new(),
            texels: Vec::new(),
            ring,
            units_done: 0,
            coarse_units,
            next_refresh: coarse_units,
            bytes_done: 0,
            failure: None,
        }
    }

    pub(super) fn is_done(&self) -> bool {
        self.steps.is_empty() && self.decoded.is_empty()
    }

    /// Takes up to `most` units of rows from the front of what is left, as far as nothing else comes before.
    pub(super) fn take_units(&mut self, most: usize) -> Vec<Unit> {
        let mut units = Vec::new();
        while units.len() < most
            && let Some(Step::Rows(unit)) = self.steps.front()
        {
            units.push(unit.clone());
            self.steps.pop_front();
        }
        units
    }

    /// Decodes `units` on the threads of the rayon pool while `meanwhile` runs on this one. A unit that cannot be decoded
    /// is left to do, and so are those behind it; the first error is returned.
    pub(super) fn decode<R>(
        &mut self,
        archive: &Archive,
        words_a_direction: usize,
        units: Vec<Unit>,
        meanwhile: impl FnOnce(&mut Self) -> R,
    ) -> (R, Result<(), LoadError>) {
        let mut slots: Vec<(Vec<u32>, Result<(), LoadError>)> =
            units.iter().map(|_| (self.spare.pop().unwrap_or_default(), Ok(()))).collect();
        let result = rayon::in_place_scope(|scope| {
            for (unit, (rows, result)) in units.iter().zip(&mut slots) {
                scope.spawn(move |_| {
                    rows.clear();
                    rows.resize(unit.directions.len() * words_a_direction, 0);
                    *result = archive.read_rows_into_zeros(unit.directions.clone(), rows);
                });
            }
            meanwhile(self)
        });
        let mut outcome = Ok(());
        let mut left = Vec::new();
        for (unit, (rows, result)) in units.into_iter().zip(slots) {
            match result {
                Ok(()) if outcome.is_ok() => self.decoded.push_back(Decoded { unit, rows }),
                Ok(()) => left.push(unit),
                Err(error) => {
                    left.push(unit);
                    outcome = outcome.and(Err(error));
                }
            }
        }
        for unit in left.into_iter().rev() {
            self.steps.push_front(Step::Rows(unit));
        }
        (result, outcome)
    }

    /// Uploads the rows of a unit's kept directions, and marks the end of it.
    pub(super) fn upload_rows(
        &mut self,
        context: &GpuContext,
        texture: &wgpu::Texture,
        layout: &RowsTexture,
        kept: &[u32],
        decoded: Decoded,
    ) -> Result<(), DeviceError> {
        let Decoded { unit, rows } = decoded;
        let words = layout.words_a_direction();
        let queue = context.queue();
        context.guarded("rows", rows.len() as u64 * 4, || {
            let mut staged = 0;
            for place in unit.kept.clone() {
                let first = (kept[place] - unit.directions.start) as usize * words;
                let rows = &rows[first..first + words];
                // The texture is zero to begin with.
                if rows.iter().all(|&word| word == 0) {
                    continue;
                }
                let texels: &[u8] = if layout.words_a_row() < 4 {
                    layout.write_tile(rows, &mut self.texels);
                    bytemuck::cast_slice(&self.texels)
                } else {
                    bytemuck::cast_slice(rows)
                };
                if staged + texels.len() > SUBMIT_BYTES {
                    queue.submit([]);
                    staged = 0;
                }
                staged += texels.len();
                write_tile(queue, texture, layout, place as u32, texels);
            }
            self.ring.mark(context);
        })?;
        self.spare.push(rows);
        Ok(())
    }

    /// Loads a level of the octree into a buffer of its own, and marks the end of it.
    pub(super) fn upload_octree_level(
        &mut self,
        context: &GpuContext,
        level: Vec<SvoNode>,
    ) -> Result<wgpu::Buffer, DeviceError> {
        let bytes: &[u8] = bytemuck::cast_slice(&level);
        let buffer = context.guarded("a level of the octree", bytes.len() as u64, || {
            context.device().create_buffer(&wgpu::BufferDescriptor {
                label: Some("octree level"),
                size: bytes.len() as u64,
                usage: wgpu::BufferUsages::STORAGE
                    | wgpu::BufferUsages::COPY_SRC
                    | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        })?;
        context.guarded("a level of the octree", bytes.len() as u64, || {
            for (i, piece) in bytes.chunks(SUBMIT_BYTES).enumerate() {
                context.queue().write_buffer(&buffer, (i * SUBMIT_BYTES) as u64, piece);
                context.queue().submit([]);
            }
            self.ring.mark(context);
        })?;
        Ok(buffer)
    }
}

fn write_tile(queue: &wgpu::Queue, texture: &wgpu::Texture, layout: &RowsTexture, tile: u32, texels: &[u8]) {
    let ([x, y, z], [width, height]) = (layout.tile_origin(tile), layout.tile_size());
    queue.write_texture(
        wgpu::TexelCopyTextureInfo {
            texture,
            mip_level: 0,
            origin: wgpu::Origin3d { x, y, z },
            aspect: wgpu::TextureAspect::All,
        },
        texels,
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(width * 16), rows_per_image: None },
        wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
    );
}

const FREE: u8 = 0;
const PENDING: u8 = 1;
const ARRIVED: u8 = 2;
const LOST: u8 = 3;

/// Marks in the queue that tell when what was submitted before them has arrived. There are as many as uploads may be
/// under way: staging memory is bounded by them. Each is a buffer of four bytes that is cleared and then mapped,
/// because mapping, unlike other signs of progress, also tells of a lost device.
#[derive(Debug)]
pub(super) struct Ring(Vec<Mark>);

#[derive(Debug)]
struct Mark {
    buffer: wgpu::Buffer,
    state: Arc<AtomicU8>,
    submission: Option<wgpu::SubmissionIndex>,
}

impl Ring {
    pub(super) fn new(context: &GpuContext, marks: usize) -> Result<Self, DeviceError> {
        let buffer = || {
            context.device().create_buffer(&wgpu::BufferDescriptor {
                label: Some("upload mark"),
                size: 4,
                usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let mark = |_| Mark { buffer: buffer(), state: Arc::default(), submission: None };
        context.guarded("marks of uploads", 4 * marks as u64, || Self((0..marks).map(mark).collect()))
    }

    /// Frees the marks that were reached; how many are free.
    pub(super) fn collect(&mut self, context: &GpuContext) -> Result<usize, DeviceError> {
        for mark in &mut self.0 {
            match mark.state.load(Ordering::Acquire) {
                ARRIVED => {
                    context.guarded("marks of uploads", 0, || mark.buffer.unmap())?;
                    mark.state.store(FREE, Ordering::Release);
                    mark.submission = None;
                }
                LOST => return Err(DeviceError::Failed("the device was lost during an upload".to_owned())),
                _ => {}
            }
        }
        Ok(self.0.iter().filter(|mark| mark.state.load(Ordering::Acquire) == FREE).count())
    }

    /// A submission that is not known to have arrived, if there is one.
    pub(super) fn pending(&self) -> Option<wgpu::SubmissionIndex> {
        self.0.iter().find_map(|mark| mark.submission.clone())
    }

    /// Submits everything before and a mark.
    fn mark(&mut self, context: &GpuContext) {
        let Some(mark) = self.0.iter_mut().find(|mark| mark.state.load(Ordering::Acquire) == FREE) else {
            unreachable!("uploads are begun only while marks are free");
        };
        let mut encoder = context.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.clear_buffer(&mark.buffer, 0, None);
        mark.submission = Some(context.queue().submit([encoder.finish()]));
        mark.state.store(PENDING, Ordering::Release);
        let state = Arc::clone(&mark.state);
        mark.buffer.map_async(wgpu::MapMode::Read, .., move |result| {
            state.store(if result.is_ok() { ARRIVED } else { LOST }, Ordering::Release);
        });
    }
}
