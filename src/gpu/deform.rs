use super::GpuContext;
use super::pipelines::Runs;
use manyview_shaders::constants::PAIRS_PER_INVOCATION;
use manyview_shaders::device::DeviceError;
use manyview_shaders::directions::DirectionFrame;
use manyview_shaders::stages;
use manyview_shaders::types::PointParams;
use std::ops::Range;

/// Bytes of rows that are filled at a time.
const BLOCK_BYTES: u64 = 64 << 20;
/// Directions of a block are a multiple of this many, so that their frames begin where a binding may: at 256 bytes.
const BLOCK_STEP: u64 = 16;
/// log2 of the bits of a texel.
const TEXEL_BITS: u32 = 7;
/// Most points: half of the words that a binding of WebGPU's default limit holds, three words for two points.
const MAX_POINTS: u32 = (128 << 20) / 12 * 2;

/// Rows of a deforming object, made anew each frame on the GPU ([`crate::deform`]): points in a buffer become texels of
/// a rows texture without leaving the device.
///
/// ```no_run
/// # use manyview::gpu::{AdapterChoice, GpuContext, GpuDeformingRows};
/// # fn draw(context: &GpuContext, frames: &[manyview_shaders::directions::DirectionFrame], texture: &wgpu::Texture,
/// #     skinned: &wgpu::Buffer, count: u32) -> Result<(), manyview_shaders::device::DeviceError> {
/// let rows = GpuDeformingRows::new(context, 7, frames)?;
/// // Each frame, after what writes `skinned`:
/// rows.set_point_count(context, count)?;
/// let mut encoder = context.device().create_command_encoder(&Default::default());
/// rows.record_to_texture(context, &mut encoder, skinned, texture, &|direction| [direction % 64 * 128, direction / 64 * 128, 0])?;
/// context.queue().submit([encoder.finish()]);
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct GpuDeformingRows {
    bits: u32,
    row_bits: u32,
    directions: u32,
    block_directions: u32,
    params: wgpu::Buffer,
    frames: wgpu::Buffer,
    rows: wgpu::Buffer,
    pairs: std::sync::atomic::AtomicU32,
}

impl GpuDeformingRows {
    /// Prepares for rows of `2^bits` voxels a side (5 to 8 bits) in these frames.
    pub fn new(context: &GpuContext, bits: u32, frames: &[DirectionFrame]) -> Result<Self, DeviceError> {
        if !(5..=8).contains(&bits) {
            return Err(DeviceError::Failed(format!("rows of 2^{bits} voxels: 5 to 8 bits can be done")));
        }
        let row_bits = bits.max(TEXEL_BITS);
        let direction_bytes = 1u64 << (2 * bits + row_bits - 3);
        let most = (BLOCK_BYTES / direction_bytes / BLOCK_STEP * BLOCK_STEP).max(BLOCK_STEP);
        let directions = u32::try_from(frames.len())
            .map_err(|_| DeviceError::Failed(format!("{} directions are more than 2^32", frames.len())))?;
        let block = most.min(u64::from(directions).next_multiple_of(BLOCK_STEP).max(BLOCK_STEP));
        let buffer = |label, size: u64, usage| {
            context.guarded(label, size, || {
                context.device().create_buffer(&wgpu::BufferDescriptor {
                    label: Some(label),
                    size,
                    usage,
                    mapped_at_creation: false,
                })
            })
        };
        let (storage, copy_to) = (wgpu::BufferUsages::STORAGE, wgpu::BufferUsages::COPY_DST);
        let frame_bytes = 48 * u64::from(directions).max(1);
        let made = Self {
            bits,
            row_bits,
            directions,
            block_directions: block as u32,
            params: buffer("parameters", 16, wgpu::BufferUsages::UNIFORM | copy_to)?,
            frames: buffer("direction frames", frame_bytes, storage | copy_to)?,
            rows: buffer(
                "rows of directions",
                block * direction_bytes,
                storage | copy_to | wgpu::BufferUsages::COPY_SRC,
            )?,
            pairs: std::sync::atomic::AtomicU32::new(0),
        };
        context.guarded("direction frames", 0, || {
            context.queue().write_buffer(&made.frames, 0, bytemuck::cast_slice(frames));
        })?;
        made.set_point_count(context, 0)?;
        Ok(made)
    }

    /// A buffer for points: three signed 16-bit coordinates of the row lattice each
    /// ([`RowLattice::snap`](manyview_shaders::directions::RowLattice::snap)), one after the other. An odd number of
    /// points needs its last one twice.
    pub fn points_buffer(context: &GpuContext, capacity: u32) -> Result<wgpu::Buffer, DeviceError> {
        let size = 6 * u64::from(capacity.max(2).next_multiple_of(2));
        context.guarded("points", size, || {
            context.device().create_buffer(&wgpu::BufferDescriptor {
                label: Some("points"),
                size,
                usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        })
    }

    /// Uploads points that are on the CPU into a [`GpuDeformingRows::points_buffer`], and sets their number.
    pub fn upload(
        &self,
        context: &GpuContext,
        points: &[[i16; 3]],
        buffer: &wgpu::Buffer,
    ) -> Result<(), DeviceError> {
        let mut padded = Vec::with_capacity(points.len() + 1);
        padded.extend_from_slice(points);
        if points.len() % 2 == 1 {
            padded.extend(points.last());
        }
        let needed_bytes = 6 * padded.len() as u64;
        if needed_bytes > buffer.size() {
            return Err(DeviceError::TooLarge { what: "points", needed_bytes, limit_bytes: buffer.size() });
        }
        self.set_point_count(context, padded.len() as u32)?;
        context.guarded("points", 0, || {
            // Larger pieces at once are several times slower.
            for (index, piece) in bytemuck::cast_slice::<_, u8>(&padded).chunks(4 << 20).enumerate() {
                context.queue().write_buffer(buffer, (index * (4 << 20)) as u64, piece);
            }
        })
    }

    /// Sets how many points the next recordings read; takes effect with the next submission.
    pub fn set_point_count(&self, context: &GpuContext, points: u32) -> Result<(), DeviceError> {
        if points > MAX_POINTS {
            let [needed_bytes, limit_bytes] = [points, MAX_POINTS].map(|points| 6 * u64::from(points));
            return Err(DeviceError::TooLarge { what: "points", needed_bytes, limit_bytes });
        }
        let pairs = points.div_ceil(2);
        self.pairs.store(pairs, std::sync::atomic::Ordering::Relaxed);
        let params = PointParams { pairs, grid_bits: self.bits, row_bits: self.row_bits, reserved: 0 };
        context.guarded("parameters", 0, || {
            context.queue().write_buffer(&self.params, 0, bytemuck::bytes_of(&params));
        })
    }

    /// Number of blocks that directions are filled in.
    pub fn blocks(&self) -> u32 {
        self.directions.div_ceil(self.block_directions)
    }

    /// Records what fills [`GpuDeformingRows::rows`] with a block of directions, and returns which these are. Rows
    /// shorter than a texel (128 bits) are followed by zeros up to its end.
    pub fn record_block(
        &self,
        context: &GpuContext,
        encoder: &mut wgpu::CommandEncoder,
        points: &wgpu::Buffer,
        block: u32,
    ) -> Result<Range<u32>, DeviceError> {
        let first = block * self.block_directions;
        let directions = first..self.directions.min(first + self.block_directions);
        let count = directions.len() as u64;
        let bytes = count * self.direction_bytes();
        let pipeline = context.pipelines.get(context, &stages::rotate_points)?;
        let Runs::Compute(compute) = &pipeline.runs else { unreachable!("rotate_points is a compute stage") };
        context.guarded("rows of directions", 0, || {
            encoder.clear_buffer(&self.rows, 0, Some(bytes));
            let part = |buffer, offset, size| {
                let size = std::num::NonZeroU64::new(size);
                wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer, offset, size })
            };
            let resources = [
                self.params.as_entire_binding(),
                part(&self.frames, 48 * u64::from(first), 48 * count),
                points.as_entire_binding(),
                part(&self.rows, 0, bytes),
            ];
            let entries: Vec<_> = (0..)
                .zip(resources)
                .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
                .collect();
            let group = context.device().create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("rotate_points"),
                layout: &pipeline.layout,
                entries: &entries,
            });
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(compute);
            pass.set_bind_group(0, &group, &[]);
            let pairs = self.pairs.load(std::sync::atomic::Ordering::Relaxed);
            pass.dispatch_workgroups(pairs.div_ceil(64 * PAIRS_PER_INVOCATION), count as u32, 1);
        })?;
        Ok(directions)
    }

    /// The rows of the block that was filled last, direction after direction.
    pub fn rows(&self) -> &wgpu::Buffer {
        &self.rows
    }

    /// Bytes from one direction to the next in [`GpuDeformingRows::rows`].
    pub fn direction_bytes(&self) -> u64 {
        1 << (2 * self.bits + self.row_bits - 3)
    }

    /// Records what fills all directions' tiles of a rows texture (`rgba32uint`, a texel for each 128 bits of a row):
    /// rows side by side along u, lines of them one below the other along v. `tile_origin` says where the tile of a
    /// direction is: texel x, y and layer.
    pub fn record_to_texture(
        &self,
        context: &GpuContext,
        encoder: &mut wgpu::CommandEncoder,
        points: &wgpu::Buffer,
        texture: &wgpu::Texture,
        tile_origin: &dyn Fn(u32) -> [u32; 3],
    ) -> Result<(), DeviceError> {
        let side = 1u32 << self.bits;
        let width = side << (self.row_bits - TEXEL_BITS);
        for block in 0..self.blocks() {
            let directions = self.record_block(context, encoder, points, block)?;
            context.guarded("rows texture", 0, || {
                for (place, direction) in (0u64..).zip(directions) {
                    let [x, y, z] = tile_origin(direction);
                    encoder.copy_buffer_to_texture(
                        wgpu::TexelCopyBufferInfo {
                            buffer: &self.rows,
                            layout: wgpu::TexelCopyBufferLayout {
                                offset: place * self.direction_bytes(),
                                bytes_per_row: Some(16 * width),
                                rows_per_image: Some(side),
                            },
                        },
                        wgpu::TexelCopyTextureInfo {
                            texture,
                            mip_level: 0,
                            origin: wgpu::Origin3d { x, y, z },
                            aspect: wgpu::TextureAspect::All,
                        },
                        wgpu::Extent3d { width, height: side, depth_or_array_layers: 1 },
                    );
                }
            })?;
        }
        Ok(())
    }
}
