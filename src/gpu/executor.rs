use super::GpuContext;
use super::pipelines::{DEPTH_FORMAT, Runs};
use manyview_shaders::device::DeviceError;
use manyview_shaders::executor::{
    Binding, BufferId, Command, DepthId, Executor, ExecutorLimits, Recording, RowsId, check_arguments,
    check_bindings,
};
use manyview_shaders::stages::Stage;
use std::collections::BTreeMap;
use std::sync::mpsc;
use std::time::Duration;

/// Bytes that are uploaded and submitted at once: larger pieces are several times slower.
const UPLOAD_BYTES: usize = 4 << 20;
/// Longest time between the end of a copy and the callback that says so.
const CALLBACK_TIMEOUT: Duration = Duration::from_secs(60);
/// Smallest buffer: room for one element of whatever a shader declares.
const MIN_BUFFER_BYTES: u64 = 64;

/// Runs recordings on a device. Its buffers and images are freed when it is dropped.
pub struct WgpuExecutor<'a> {
    context: &'a GpuContext,
    limits: ExecutorLimits,
    buffers: BTreeMap<BufferId, wgpu::Buffer>,
    images: BTreeMap<DepthId, wgpu::TextureView>,
    rows: BTreeMap<RowsId, wgpu::TextureView>,
    next_id: u32,
}

impl std::fmt::Debug for WgpuExecutor<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("WgpuExecutor").field("context", self.context).finish_non_exhaustive()
    }
}

impl<'a> WgpuExecutor<'a> {
    /// An executor without buffers. `limits` are at most WebGPU's default ones.
    pub fn new(context: &'a GpuContext, limits: ExecutorLimits) -> Self {
        let (buffers, images, rows) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
        Self { context, limits, buffers, images, rows, next_id: 0 }
    }

    /// Gives stages a buffer of the same device that lives elsewhere too, such as a scene's. Its usages must fit what
    /// stages do with it; releasing it here frees nothing.
    pub fn share_buffer(&mut self, buffer: &wgpu::Buffer) -> BufferId {
        let id = BufferId(self.next_id());
        self.buffers.insert(id, buffer.clone());
        id
    }

    /// Gives stages a rows texture of the same device: a view of all layers of an `rgba32uint` 2D-array texture, such
    /// as [`GpuScene::rows_view`](super::GpuScene::rows_view).
    pub fn share_rows(&mut self, view: &wgpu::TextureView) -> RowsId {
        let id = RowsId(self.next_id());
        self.rows.insert(id, view.clone());
        id
    }

    fn next_id(&mut self) -> u32 {
        self.next_id += 1;
        self.next_id
    }

    fn buffer_of(&self, id: BufferId) -> &wgpu::Buffer {
        self.buffers.get(&id).expect("recordings use live buffers")
    }

    fn image_of(&self, id: DepthId) -> &wgpu::TextureView {
        self.images.get(&id).expect("recordings use live images")
    }

    fn rows_of(&self, id: RowsId) -> &wgpu::TextureView {
        self.rows.get(&id).expect("recordings use live rows textures")
    }

    fn upload(&self, buffer: &wgpu::Buffer, bytes: &[u8]) {
        let queue = self.context.queue();
        for (i, piece) in bytes.chunks(UPLOAD_BYTES).enumerate() {
            queue.write_buffer(buffer, (i * UPLOAD_BYTES) as u64, piece);
            if piece.len() == UPLOAD_BYTES {
                queue.submit([]);
            }
        }
    }

    fn bind(&self, stage: &Stage, layout: &wgpu::BindGroupLayout, bindings: &[Binding]) -> wgpu::BindGroup {
        check_bindings(stage, bindings);
        let entries: Vec<_> = (0..)
            .zip(bindings)
            .map(|(binding, bound)| wgpu::BindGroupEntry {
                binding,
                resource: match *bound {
                    Binding::Buffer(id) => self.buffer_of(id).as_entire_binding(),
                    Binding::Depth(id) => wgpu::BindingResource::TextureView(self.image_of(id)),
                    Binding::Rows(id) => wgpu::BindingResource::TextureView(self.rows_of(id)),
                },
            })
            .collect();
        self.context.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(stage.name),
            layout,
            entries: &entries,
        })
    }

    fn compute_pass(
        &self,
        encoding: &mut Encoding,
        stage: &'static Stage,
        bindings: &[Binding],
        dispatch: impl FnOnce(&mut wgpu::ComputePass),
    ) -> Result<(), DeviceError> {
        let pipeline = self.context.pipelines.get(self.context, stage)?;
        let Runs::Compute(compute) = &pipeline.runs else { panic!("`{}` cannot be dispatched", stage.name) };
        let group = self.bind(stage, &pipeline.layout, bindings);
        let descriptor = wgpu::ComputePassDescriptor { label: Some(stage.name), timestamp_writes: None };
        let mut pass = encoding.encoder().begin_compute_pass(&descriptor);
        pass.set_pipeline(compute);
        pass.set_bind_group(0, &group, &[]);
        dispatch(&mut pass);
        Ok(())
    }

    /// Encodes and submits; what is downloaded lies in `readback` afterwards.
    fn submit(
        &self,
        recording: &Recording,
        readback: Option<&wgpu::Buffer>,
    ) -> Result<wgpu::SubmissionIndex, DeviceError> {
        let mut encoding = Encoding::new(self.context);
        let mut read = 0;
        for command in recording.commands() {
            if let Some((depth, value)) = encoding.pending_clear
                && !matches!(command, Command::Draw { target, .. } if *target == depth)
            {
                encoding.draw_pass(self.image_of(depth), Some(value), |_| ());
                encoding.pending_clear = None;
            }
            match command {
                Command::Upload { buffer, bytes } => {
                    encoding.flush();
                    self.upload(self.buffer_of(*buffer), bytes);
                }
                Command::Clear { buffer } => {
                    encoding.encoder().clear_buffer(self.buffer_of(*buffer), 0, None);
                }
                Command::Dispatch { stage, workgroups, bindings } => {
                    let [x, y, z] = *workgroups;
                    self.compute_pass(&mut encoding, stage, bindings, |pass| {
                        pass.dispatch_workgroups(x, y, z);
                    })?;
                }
                Command::DispatchIndirect { stage, arguments, offset_words, bindings } => {
                    check_arguments(stage, *arguments, bindings);
                    self.compute_pass(&mut encoding, stage, bindings, |pass| {
                        let offset = 4 * u64::from(*offset_words);
                        pass.dispatch_workgroups_indirect(self.buffer_of(*arguments), offset);
                    })?;
                }
                Command::ClearDepth { depth, value } => encoding.pending_clear = Some((*depth, *value)),
                Command::Draw { stage, counts, bindings, target } => {
                    let pipeline = self.context.pipelines.get(self.context, stage)?;
                    let Runs::Depth(render) = &pipeline.runs else {
                        panic!("`{}` cannot be drawn", stage.name)
                    };
                    let group = self.bind(stage, &pipeline.layout, bindings);
                    let clear = encoding.pending_clear.take().map(|(_, value)| value);
                    encoding.draw_pass(self.image_of(*target), clear, |pass| {
                        pass.set_pipeline(render);
                        pass.set_bind_group(0, &group, &[]);
                        pass.draw(0..counts[0], 0..counts[1]);
                    });
                }
                Command::Download { buffer, words } => {
                    if let Some(readback) = readback
                        && *words > 0
                    {
                        let bytes = 4 * *words as u64;
                        let source = self.buffer_of(*buffer);
                        encoding.encoder().copy_buffer_to_buffer(source, 0, readback, read, bytes);
                        read += bytes;
                    }
                }
            }
        }
        if let Some((depth, value)) = encoding.pending_clear.take() {
            encoding.draw_pass(self.image_of(depth), Some(value), |_| ());
        }
        encoding.flush();
        // Uploads without a command after them.
        Ok(self.context.queue().submit([]))
    }

    fn read(
        &self,
        readback: &wgpu::Buffer,
        submission: &wgpu::SubmissionIndex,
        words: &[usize],
    ) -> Result<Vec<Vec<u32>>, DeviceError> {
        let failed = |reason: String| DeviceError::Failed(format!("reading back: {reason}"));
        let (send, receive) = mpsc::channel();
        self.context.guarded("reading back", 0, || {
            readback.map_async(wgpu::MapMode::Read, .., move |result| {
                // The receiver is gone only if waiting failed, which is reported then.
                let _ = send.send(result);
            });
        })?;
        self.context.wait(submission)?;
        // Another thread that waits may have taken our callback and not come to it yet.
        match receive.recv_timeout(CALLBACK_TIMEOUT) {
            Ok(Ok(())) => {}
            Ok(Err(error)) => return Err(failed(error.to_string())),
            Err(error) => return Err(failed(error.to_string())),
        }
        let mapped = readback.get_mapped_range(..).map_err(|error| failed(error.to_string()))?;
        let mut from = 0;
        let mut downloads = Vec::with_capacity(words.len());
        for &words in words {
            let bytes = &mapped[from..from + 4 * words];
            let mut download = vec![0u32; words];
            bytemuck::cast_slice_mut(&mut download).copy_from_slice(bytes);
            downloads.push(download);
            from += 4 * words;
        }
        Ok(downloads)
    }
}

/// Commands on their way to the queue.
struct Encoding<'a> {
    context: &'a GpuContext,
    encoder: Option<wgpu::CommandEncoder>,
    /// An image to be cleared by the next pass that draws to it.
    pending_clear: Option<(DepthId, f32)>,
}

impl<'a> Encoding<'a> {
    fn new(context: &'a GpuContext) -> Self {
        Self { context, encoder: None, pending_clear: None }
    }

    fn encoder(&mut self) -> &mut wgpu::CommandEncoder {
        self.encoder.get_or_insert_with(|| {
            self.context.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
        })
    }

    /// Submits what was encoded, so that an upload comes after it.
    fn flush(&mut self) {
        if let Some(encoder) = self.encoder.take() {
            self.context.queue().submit([encoder.finish()]);
        }
    }

    fn draw_pass(
        &mut self,
        target: &wgpu::TextureView,
        clear: Option<f32>,
        draw: impl FnOnce(&mut wgpu::RenderPass),
    ) {
        let load = clear.map_or(wgpu::LoadOp::Load, wgpu::LoadOp::Clear);
        let mut pass = self.encoder().begin_render_pass(&wgpu::RenderPassDescriptor {
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: target,
                depth_ops: Some(wgpu::Operations { load, store: wgpu::StoreOp::Store }),
                stencil_ops: None,
            }),
            ..wgpu::RenderPassDescriptor::default()
        });
        draw(&mut pass);
    }
}

impl Executor for WgpuExecutor<'_> {
    fn limits(&self) -> ExecutorLimits {
        self.limits
    }

    fn buffer(&mut self, what: &'static str, bytes: u64) -> Result<BufferId, DeviceError> {
        if bytes > self.limits.binding_bytes {
            let limit_bytes = self.limits.binding_bytes;
            return Err(DeviceError::TooLarge { what, needed_bytes: bytes, limit_bytes });
        }
        let buffer = self.context.guarded(what, bytes, || {
            self.context.device().create_buffer(&wgpu::BufferDescriptor {
                label: Some(what),
                size: bytes.max(MIN_BUFFER_BYTES).next_multiple_of(4),
                usage: wgpu::BufferUsages::STORAGE
                    | wgpu::BufferUsages::UNIFORM
                    | wgpu::BufferUsages::INDIRECT
                    | wgpu::BufferUsages::COPY_SRC
                    | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        })?;
        let id = BufferId(self.next_id());
        self.buffers.insert(id, buffer);
        Ok(id)
    }

    fn depth_image(&mut self, size: [u32; 2]) -> Result<DepthId, DeviceError> {
        let bytes = 4 * u64::from(size[0]) * u64::from(size[1]);
        let view = self.context.guarded("a depth image", bytes, || {
            let texture = self.context.device().create_texture(&wgpu::TextureDescriptor {
                label: Some("depth image"),
                size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: DEPTH_FORMAT,
                usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            });
            texture.create_view(&wgpu::TextureViewDescriptor::default())
        })?;
        let id = DepthId(self.next_id());
        self.images.insert(id, view);
        Ok(id)
    }

    fn release(&mut self, buffer: BufferId) {
        self.buffers.remove(&buffer);
    }

    fn release_depth(&mut self, depth: DepthId) {
        self.images.remove(&depth);
    }

    fn run(&mut self, recording: &Recording) -> Result<Vec<Vec<u32>>, DeviceError> {
        let words: Vec<usize> = recording
            .commands()
            .iter()
            .filter_map(|command| match command {
                Command::Download { words, .. } => Some(*words),
                _ => None,
            })
            .collect();
        let bytes = 4 * words.iter().map(|&words| words as u64).sum::<u64>();
        let readback = match bytes {
            0 => None,
            _ => Some(self.context.guarded("results", bytes, || {
                self.context.device().create_buffer(&wgpu::BufferDescriptor {
                    label: Some("results"),
                    size: bytes,
                    usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                    mapped_at_creation: false,
                })
            })?),
        };
        let submission =
            self.context.guarded("running stages", 0, || self.submit(recording, readback.as_ref()))??;
        match &readback {
            Some(readback) => self.read(readback, &submission, &words),
            None => Ok(vec![Vec::new(); words.len()]),
        }
    }
}
