//! What runs the twins: buffers, images and rows textures in the CPU's memory.

use super::{
    Binding, BufferId, Command, DepthId, Executor, ExecutorLimits, Recording, RowsId, check_arguments,
    check_bindings,
};
use crate::constants::MAX_WORKGROUPS;
use crate::device::DeviceError;
use crate::rows_texture::RowsImage;
use crate::stages::{Kind, Stage};
use bytemuck::Pod;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A depth image on the CPU.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthImage {
    /// Pixels along x and y.
    pub size: [u32; 2],
    /// Row by row.
    pub depths: Vec<f32>,
}

impl DepthImage {
    /// The depth at a pixel.
    pub fn at(&self, x: u32, y: u32) -> f32 {
        self.depths[(y * self.size[0] + x) as usize]
    }

    /// Keeps the smaller depth.
    pub fn keep_nearest(&mut self, x: u32, y: u32, depth: f32) {
        let kept = &mut self.depths[(y * self.size[0] + x) as usize];
        *kept = kept.min(depth);
    }
}

/// What a twin is given for a binding.
#[derive(Debug)]
pub enum CpuBinding<'a> {
    /// A buffer.
    Words(&'a mut Vec<u32>),
    /// A buffer that others use too, to read.
    Shared(&'a [u32]),
    /// A depth image.
    Depth(&'a DepthImage),
    /// A rows texture.
    Rows(&'a RowsImage),
}

impl CpuBinding<'_> {
    /// The buffer as a slice of structs; a rest too short for one is left out.
    pub fn slice<T: Pod>(&self) -> &[T] {
        let words = self.words();
        let whole = words.len() * 4 / size_of::<T>() * size_of::<T>() / 4;
        bytemuck::cast_slice(&words[..whole])
    }

    /// The struct at the start of the buffer.
    pub fn first<T: Pod>(&self) -> T {
        self.slice::<T>()[0]
    }

    /// The buffer.
    pub fn words(&self) -> &[u32] {
        match self {
            CpuBinding::Words(words) => words,
            CpuBinding::Shared(words) => words,
            _ => panic!("the stage table says that this binding is a buffer"),
        }
    }

    /// The buffer, to write.
    pub fn words_mut(&mut self) -> &mut [u32] {
        match self {
            CpuBinding::Words(words) => words,
            CpuBinding::Shared(_) => panic!("a shared buffer is only read"),
            _ => panic!("the stage table says that this binding is a buffer"),
        }
    }

    /// The depth image.
    pub fn depth(&self) -> &DepthImage {
        match self {
            CpuBinding::Depth(image) => image,
            _ => panic!("the stage table says that this binding is a depth image"),
        }
    }

    /// The rows texture.
    pub fn rows(&self) -> &RowsImage {
        match self {
            CpuBinding::Rows(image) => image,
            _ => panic!("the stage table says that this binding is a rows texture"),
        }
    }
}

/// Runs the twins, one after the other on one thread. For tests and for finding out which stage goes wrong.
#[derive(Debug)]
pub struct CpuExecutor {
    limits: ExecutorLimits,
    buffers: BTreeMap<BufferId, Vec<u32>>,
    shared: BTreeMap<BufferId, Arc<Vec<u32>>>,
    images: BTreeMap<DepthId, DepthImage>,
    rows: BTreeMap<RowsId, RowsImage>,
    next_id: u32,
}

impl Default for CpuExecutor {
    fn default() -> Self {
        Self::new(ExecutorLimits::DEFAULT)
    }
}

impl CpuExecutor {
    /// An executor that pretends to have these limits.
    pub fn new(limits: ExecutorLimits) -> Self {
        Self {
            limits,
            buffers: BTreeMap::new(),
            shared: BTreeMap::new(),
            images: BTreeMap::new(),
            rows: BTreeMap::new(),
            next_id: 0,
        }
    }

    /// Gives stages words to read that live elsewhere too. They are not copied; uploading to them, clearing them or
    /// binding them to be written is a mistake that panics.
    pub fn share_buffer(&mut self, words: Arc<Vec<u32>>) -> BufferId {
        let id = BufferId(self.next_id());
        self.shared.insert(id, words);
        id
    }

    /// Gives stages a rows texture, whose words live elsewhere too and are not copied.
    pub fn share_rows(&mut self, rows: RowsImage) -> RowsId {
        let id = RowsId(self.next_id());
        self.rows.insert(id, rows);
        id
    }

    fn next_id(&mut self) -> u32 {
        self.next_id += 1;
        self.next_id
    }

    fn with_bindings<R>(
        &mut self,
        stage: &Stage,
        bindings: &[Binding],
        run: impl FnOnce(&mut [CpuBinding]) -> R,
    ) -> R {
        check_bindings(stage, bindings);
        let mut taken: Vec<Vec<u32>> = bindings
            .iter()
            .map(|binding| match binding {
                Binding::Buffer(id) if !self.shared.contains_key(id) => {
                    std::mem::take(self.buffers.get_mut(id).expect("a live buffer"))
                }
                _ => Vec::new(),
            })
            .collect();
        let mut given: Vec<CpuBinding> = bindings
            .iter()
            .zip(&mut taken)
            .map(|(binding, words)| match binding {
                Binding::Buffer(id) => match self.shared.get(id) {
                    Some(shared) => CpuBinding::Shared(shared),
                    None => CpuBinding::Words(words),
                },
                Binding::Depth(id) => CpuBinding::Depth(&self.images[id]),
                Binding::Rows(id) => CpuBinding::Rows(&self.rows[id]),
            })
            .collect();
        let result = run(&mut given);
        for (binding, words) in bindings.iter().zip(taken) {
            if let Binding::Buffer(id) = binding
                && !self.shared.contains_key(id)
            {
                self.buffers.insert(*id, words);
            }
        }
        result
    }
}

impl Executor for CpuExecutor {
    fn limits(&self) -> ExecutorLimits {
        self.limits
    }

    fn buffer(&mut self, what: &'static str, bytes: u64) -> Result<BufferId, DeviceError> {
        if bytes > self.limits.binding_bytes {
            let limit_bytes = self.limits.binding_bytes;
            return Err(DeviceError::TooLarge { what, needed_bytes: bytes, limit_bytes });
        }
        let id = BufferId(self.next_id());
        self.buffers.insert(id, vec![0; (bytes as usize).div_ceil(4)]);
        Ok(id)
    }

    fn depth_image(&mut self, size: [u32; 2]) -> Result<DepthId, DeviceError> {
        let id = DepthId(self.next_id());
        self.images.insert(id, DepthImage { size, depths: vec![0.0; size[0] as usize * size[1] as usize] });
        Ok(id)
    }

    fn release(&mut self, buffer: BufferId) {
        self.buffers.remove(&buffer);
        self.shared.remove(&buffer);
    }

    fn release_depth(&mut self, depth: DepthId) {
        self.images.remove(&depth);
    }

    fn run(&mut self, recording: &Recording) -> Result<Vec<Vec<u32>>, DeviceError> {
        let mut downloads = Vec::new();
        for command in recording.commands() {
            match command {
                Command::Upload { buffer, bytes } => {
                    let words = self.buffers.get_mut(buffer).expect("a live buffer");
                    bytemuck::cast_slice_mut(words)[..bytes.len()].copy_from_slice(bytes);
                }
                Command::Clear { buffer } => {
                    self.buffers.get_mut(buffer).expect("a live buffer").fill(0);
                }
                Command::Dispatch { stage, workgroups, bindings } => {
                    let Kind::Compute { twin, .. } = stage.kind else {
                        panic!("`{}` cannot be dispatched", stage.name)
                    };
                    self.with_bindings(stage, bindings, |given| twin(*workgroups, given));
                }
                Command::DispatchIndirect { stage, arguments, offset_words, bindings } => {
                    let Kind::Compute { twin, .. } = stage.kind else {
                        panic!("`{}` cannot be dispatched", stage.name)
                    };
                    check_arguments(stage, *arguments, bindings);
                    let words = self.shared.get(arguments).map(|shared| &shared[..]);
                    let words = words.unwrap_or_else(|| &self.buffers[arguments]);
                    let workgroups = [0, 1, 2].map(|axis| words[*offset_words as usize + axis]);
                    assert!(
                        workgroups.iter().all(|&count| count <= MAX_WORKGROUPS),
                        "`{}` over {workgroups:?} workgroups",
                        stage.name
                    );
                    self.with_bindings(stage, bindings, |given| twin(workgroups, given));
                }
                Command::ClearDepth { depth, value } => {
                    self.images.get_mut(depth).expect("a live image").depths.fill(*value);
                }
                Command::Draw { stage, counts, bindings, target } => {
                    let Kind::Depth { twin } = stage.kind else { panic!("`{}` cannot be drawn", stage.name) };
                    let mut image = self.images.remove(target).expect("a live image");
                    self.with_bindings(stage, bindings, |given| twin(*counts, given, &mut image));
                    self.images.insert(*target, image);
                }
                Command::Download { buffer, words } => {
                    let shared = self.shared.get(buffer).map(|shared| &shared[..]);
                    let content = shared.unwrap_or_else(|| &self.buffers[buffer]);
                    downloads.push(content[..*words].to_vec());
                }
            }
        }
        Ok(downloads)
    }
}
