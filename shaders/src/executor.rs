//! Recordings of stages, and what can run them.
//!
//! Code that wants work done on a GPU allocates buffers on an [`Executor`], fills a [`Recording`] and runs it. It
//! never sees a GPU API: [`CpuExecutor`] runs the twin of every stage, another executor the shaders.

mod cpu;

pub use cpu::{CpuBinding, CpuExecutor, DepthImage};

use crate::device::DeviceError;
use crate::stages::{BindingKind, Stage};
use bytemuck::Pod;

/// A buffer of 32-bit words on an executor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct BufferId(pub u32);

/// A depth image (one 32-bit float per pixel) on an executor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct DepthId(pub u32);

/// A rows texture ([`crate::rows_texture`]) on an executor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct RowsId(pub u32);

/// What a stage is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Binding {
    /// A buffer.
    Buffer(BufferId),
    /// A depth image to read.
    Depth(DepthId),
    /// A rows texture to read.
    Rows(RowsId),
}

impl From<RowsId> for Binding {
    fn from(id: RowsId) -> Self {
        Binding::Rows(id)
    }
}

impl From<BufferId> for Binding {
    fn from(id: BufferId) -> Self {
        Binding::Buffer(id)
    }
}

impl From<DepthId> for Binding {
    fn from(id: DepthId) -> Self {
        Binding::Depth(id)
    }
}

/// One step of a [`Recording`].
#[derive(Debug)]
pub enum Command<'a> {
    /// Copies bytes (a multiple of four) to the start of a buffer.
    Upload {
        /// Where to.
        buffer: BufferId,
        /// What.
        bytes: &'a [u8],
    },
    /// Sets a buffer to zero.
    Clear {
        /// Which.
        buffer: BufferId,
    },
    /// Runs a compute stage.
    Dispatch {
        /// Which.
        stage: &'static Stage,
        /// Workgroups along x, y, z.
        workgroups: [u32; 3],
        /// In the order of [`Stage::bindings`].
        bindings: Vec<Binding>,
    },
    /// Runs a compute stage over as many workgroups as a buffer says.
    DispatchIndirect {
        /// Which.
        stage: &'static Stage,
        /// Holds the workgroups along x, y, z, each at most [`MAX_WORKGROUPS`](crate::constants::MAX_WORKGROUPS); the stage may read it, but not write to it.
        arguments: BufferId,
        /// Where in it, words.
        offset_words: u32,
        /// In the order of [`Stage::bindings`].
        bindings: Vec<Binding>,
    },
    /// Sets every pixel of a depth image.
    ClearDepth {
        /// Which.
        depth: DepthId,
        /// To what, in 0 ..= 1.
        value: f32,
    },
    /// Runs a depth stage over a depth image, which keeps the smallest depth.
    Draw {
        /// Which.
        stage: &'static Stage,
        /// Vertices (three a triangle) and instances.
        counts: [u32; 2],
        /// In the order of [`Stage::bindings`].
        bindings: Vec<Binding>,
        /// Drawn to.
        target: DepthId,
    },
    /// Copies the first words of a buffer back.
    Download {
        /// Which.
        buffer: BufferId,
        /// How many.
        words: usize,
    },
}

/// Steps to run in order.
#[derive(Debug, Default)]
pub struct Recording<'a> {
    commands: Vec<Command<'a>>,
}

impl<'a> Recording<'a> {
    /// Nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// The steps.
    pub fn commands(&self) -> &[Command<'a>] {
        &self.commands
    }

    /// Puts other steps behind these.
    pub fn append(&mut self, other: Recording<'a>) {
        self.commands.extend(other.commands);
    }

    /// Copies `data` (a multiple of four bytes) to the start of a buffer.
    pub fn upload<T: Pod>(&mut self, buffer: BufferId, data: &'a [T]) {
        self.commands.push(Command::Upload { buffer, bytes: bytemuck::cast_slice(data) });
    }

    /// Sets a buffer to zero.
    pub fn clear(&mut self, buffer: BufferId) {
        self.commands.push(Command::Clear { buffer });
    }

    /// Runs a compute stage.
    pub fn dispatch(&mut self, stage: &'static Stage, workgroups: [u32; 3], bindings: &[Binding]) {
        self.commands.push(Command::Dispatch { stage, workgroups, bindings: bindings.to_vec() });
    }

    /// Runs a compute stage over `[x, y, z]` workgroups that stand in `arguments` at `offset_words` when it is its turn.
    pub fn dispatch_indirect(
        &mut self,
        stage: &'static Stage,
        arguments: BufferId,
        offset_words: u32,
        bindings: &[Binding],
    ) {
        let bindings = bindings.to_vec();
        self.commands.push(Command::DispatchIndirect { stage, arguments, offset_words, bindings });
    }

    /// Sets every pixel of a depth image.
    pub fn clear_depth(&mut self, depth: DepthId, value: f32) {
        self.commands.push(Command::ClearDepth { depth, value });
    }

    /// Runs a depth stage with `[vertices, instances]`.
    pub fn draw(&mut self, stage: &'static Stage, counts: [u32; 2], bindings: &[Binding], target: DepthId) {
        self.commands.push(Command::Draw { stage, counts, bindings: bindings.to_vec(), target });
    }

    /// Copies the first `words` of a buffer back.
    pub fn download(&mut self, buffer: BufferId, words: usize) {
        self.commands.push(Command::Download { buffer, words });
    }
}

/// What an executor can hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ExecutorLimits {
    /// Bytes of a buffer that a stage can see.
    pub binding_bytes: u64,
    /// Side of a depth image, pixels.
    pub depth_side: u32,
}

impl ExecutorLimits {
    /// WebGPU's default limits.
    pub const DEFAULT: Self = Self { binding_bytes: 128 << 20, depth_side: 8192 };
}

/// Runs recordings. Buffers and images live until they are released or the executor is dropped.
pub trait Executor {
    /// What it can hold.
    fn limits(&self) -> ExecutorLimits;

    /// A new buffer of at least `bytes` bytes; its content is undefined. `what` names it in errors.
    fn buffer(&mut self, what: &'static str, bytes: u64) -> Result<BufferId, DeviceError>;

    /// A new depth image; its content is undefined.
    fn depth_image(&mut self, size: [u32; 2]) -> Result<DepthId, DeviceError>;

    /// Frees a buffer.
    fn release(&mut self, buffer: BufferId);

    /// Frees a depth image.
    fn release_depth(&mut self, depth: DepthId);

    /// Runs the steps and returns what was downloaded, in order.
    fn run(&mut self, recording: &Recording) -> Result<Vec<Vec<u32>>, DeviceError>;
}

/// Panics if `bindings` are not what the stage table says: a mistake in our own recordings.
pub fn check_bindings(stage: &Stage, bindings: &[Binding]) {
    assert_eq!(stage.bindings.len(), bindings.len(), "bindings of `{}`", stage.name);
    for (i, (kind, binding)) in stage.bindings.iter().zip(bindings).enumerate() {
        let fits = match binding {
            Binding::Buffer(_) => !matches!(kind, BindingKind::Depth | BindingKind::Rows),
            Binding::Depth(_) => matches!(kind, BindingKind::Depth),
            Binding::Rows(_) => matches!(kind, BindingKind::Rows),
        };
        assert!(fits, "binding {i} of `{}` is {kind:?}, not {binding:?}", stage.name);
        assert!(!bindings[..i].contains(binding), "binding {i} of `{}` is bound twice", stage.name);
    }
}

/// Panics if a stage would write to the buffer that says how many workgroups of it run: a mistake in our own recordings.
pub fn check_arguments(stage: &Stage, arguments: BufferId, bindings: &[Binding]) {
    for (kind, binding) in stage.bindings.iter().zip(bindings) {
        let writes = *kind == BindingKind::ReadWrite && *binding == Binding::Buffer(arguments);
        assert!(!writes, "`{}` writes to its own number of workgroups", stage.name);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows_texture::RowsImage;
    use crate::rows_texture::RowsTexture;
    use crate::stages::Kind;
    use std::sync::Arc;

    fn twin(_: [u32; 3], bindings: &mut [CpuBinding]) {
        let [rows, list, out] = bindings else { unreachable!("checked against the table") };
        let layout = *rows.rows().layout();
        for (i, &direction) in list.words().iter().enumerate() {
            out.words_mut()[i] = rows.rows().texel(layout.tile_origin(direction))[0];
        }
    }

    const STAGE: Stage = Stage {
        name: "first_words",
        bindings: &[BindingKind::Rows, BindingKind::Read, BindingKind::ReadWrite],
        kind: Kind::Compute { workgroup_size: [1; 3], twin },
        files: &[],
    };

    #[test]
    fn what_is_shared_is_read_in_place() {
        static STAGE_REF: &Stage = &STAGE;
        let layout = RowsTexture::new(5, 3).unwrap();
        let words = layout.words_a_direction();
        let rows = Arc::new((0..3 * words).map(|i| i as u32).collect::<Vec<u32>>());
        let list = Arc::new(vec![2, 0, 1]);
        let mut executor = CpuExecutor::default();
        let texture = executor.share_rows(RowsImage::new(layout, Arc::clone(&rows)));
        let shared = executor.share_buffer(Arc::clone(&list));
        let out = executor.buffer("first words", 12).unwrap();
        for _ in 0..2 {
            let mut recording = Recording::new();
            recording.dispatch(STAGE_REF, [1; 3], &[texture.into(), shared.into(), out.into()]);
            recording.download(out, 3);
            recording.download(shared, 3);
            let words = words as u32;
            let found = executor.run(&recording).unwrap();
            assert_eq!(found, [vec![2 * words, 0, words], vec![2, 0, 1]]);
        }
        executor.release(shared);
        drop(executor);
        assert_eq!(Arc::strong_count(&rows), 1);
        assert_eq!(Arc::strong_count(&list), 1);
    }

    /// Adds the number of workgroups to a word.
    fn count_twin(workgroups: [u32; 3], bindings: &mut [CpuBinding]) {
        bindings[0].words_mut()[0] += workgroups.iter().product::<u32>();
    }

    static COUNT: Stage = Stage {
        name: "count_workgroups",
        bindings: &[BindingKind::ReadWrite],
        kind: Kind::Compute { workgroup_size: [1; 3], twin: count_twin },
        files: &[],
    };

    #[test]
    fn a_buffer_says_how_many_workgroups_run() {
        let mut executor = CpuExecutor::default();
        let arguments = executor.buffer("workgroups", 24).unwrap();
        let shared = executor.share_buffer(Arc::new(vec![5, 1, 1]));
        let out = executor.buffer("a count", 4).unwrap();
        let mut recording = Recording::new();
        recording.upload(arguments, &[0u32, 9, 2, 3, 4, 0]);
        for (buffer, offset_words) in [(arguments, 2), (arguments, 0), (arguments, 3), (shared, 0)] {
            recording.dispatch_indirect(&COUNT, buffer, offset_words, &[out.into()]);
        }
        recording.download(out, 1);
        assert_eq!(executor.run(&recording).unwrap(), [[2 * 3 * 4 + 5]]);
    }

    #[test]
    #[should_panic(expected = "writes to its own number of workgroups")]
    fn a_stage_does_not_write_how_often_it_runs() {
        let mut executor = CpuExecutor::default();
        let arguments = executor.buffer("workgroups", 12).unwrap();
        let mut recording = Recording::new();
        recording.dispatch_indirect(&COUNT, arguments, 0, &[arguments.into()]);
        let _ = executor.run(&recording);
    }

    #[test]
    #[should_panic(expected = "over [65536, 1, 1] workgroups")]
    fn more_workgroups_than_webgpu_runs_are_noticed() {
        let mut executor = CpuExecutor::default();
        let (arguments, out) =
            (executor.share_buffer(Arc::new(vec![65_536, 1, 1])), executor.buffer("", 4).unwrap());
        let mut recording = Recording::new();
        recording.dispatch_indirect(&COUNT, arguments, 0, &[out.into()]);
        let _ = executor.run(&recording);
    }

    #[test]
    #[should_panic(expected = "binding 0 of `first_words` is Rows")]
    fn a_buffer_is_no_rows_texture() {
        check_bindings(&STAGE, &[BufferId(1).into(), BufferId(2).into(), BufferId(3).into()]);
    }
}
