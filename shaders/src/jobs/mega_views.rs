//! MegaViews as recordings of stages ([`crate::mega_views`]).
//!
//! # Practice
//! [`MegaViewsDevice`] has a scene on an executor. [`MegaViewsDevice::sort`] puts views in Morton order;
//! [`MegaViewsDevice::pass`] then draws any run of them, without a word from the CPU between its first stage and its last.
//! A pass for which there was too little room says so and draws nothing that could be taken for a map: the run is drawn
//! again in parts.

mod recordings;

use crate::constants::{SCAN_CHUNK, SORT_CHUNK};
use crate::device::DeviceError;
use crate::executor::{Binding, BufferId, Executor, Recording};
use crate::mega_views::{
    LevelParams, MOST_TREE_LEVELS, PAIR_WHOLE, PassParams, SORT_DIGITS, ScanParams, SceneParams, SortParams,
    ViewCone, counter, tree,
};
use crate::paraboloid::texel_count;
use crate::scene_tree::SceneTree;
use crate::stages;
use crate::views::ViewNode;
use bytemuck::Pod;
use recordings::{first_node, most_levels};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// How maps are drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MegaViewsSettings {
    /// Texels a side of each half of a map.
    pub resolution: u32,
    /// How many texels a node may fill and still be drawn as a point.
    pub texels: f32,
    /// Drop what is outside all fields of view.
    pub culling: bool,
    /// Whether all views in one voxel share a map.
    pub sharing: bool,
    /// Pack depths as 16-bit floats.
    pub half_depths: bool,
    /// Also find the scene node that each texel shows, which walks both hierarchies twice.
    pub with_numbers: bool,
}

impl MegaViewsSettings {
    /// As the paper has them: maps of so many texels a side, depths alone.
    pub const fn new(resolution: u32) -> Self {
        Self {
            resolution,
            texels: 1.0,
            culling: true,
            sharing: true,
            half_depths: false,
            with_numbers: false,
        }
    }
}

/// What a pass has room for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Room {
    /// Nodes of the view hierarchy, each with a map.
    pub nodes: u32,
    /// Pairs in the queue of one step.
    pub pairs: u32,
    /// Pairs of two leaves of all steps together.
    pub near: u32,
}

/// What a pass gave.
#[derive(Debug, Clone, PartialEq)]
pub enum PassResult {
    /// The maps of all views of the run.
    Maps(PassMaps),
    /// There was too little room for what these [`crate::mega_views::flag`]s say.
    NoRoom(u32),
}

/// The view hierarchy of a run and the maps of its leaves.
#[derive(Debug, Clone, PartialEq)]
pub struct PassMaps {
    /// Nodes breadth first; views are numbered from the run's first.
    pub nodes: Vec<ViewNode>,
    /// Index of the first node of each level, and the number of nodes.
    pub level_starts: Vec<u32>,
    /// Maps of the leaves, in the order of [`PassMaps::nodes`]: floats of 32 bits, or two of 16 in a word.
    pub depths: Vec<u32>,
    /// For each texel of these maps the number of the scene node that it shows
    /// ([`NodeRef`](crate::scene_tree::NodeRef)), or [`NO_NUMBER`](crate::mega_views::NO_NUMBER). Empty unless wanted.
    pub numbers: Vec<u32>,
    /// Most pairs in the queue, and pairs of two leaves.
    pub pairs: [u32; 2],
}

/// Views in Morton order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SortedOrder {
    /// Index of each in the list that was given.
    pub order: Vec<u32>,
    /// Morton keys in that order: the low 30 bits and the high 9.
    pub keys: Vec<[u32; 2]>,
}

/// A scene on an executor, and buffers that are kept from one frame to the next.
pub struct MegaViewsDevice<'a> {
    executor: Box<dyn Executor + Send + 'a>,
    scene: SceneParams,
    inner_nodes: u32,
    leaves: u32,
    kept: BTreeMap<&'static str, (BufferId, u64)>,
    levels: Vec<BufferId>,
    digits: Vec<BufferId>,
    scans: Vec<BufferId>,
    timings: Option<Vec<(&'static str, Duration)>>,
}

impl std::fmt::Debug for MegaViewsDevice<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("MegaViewsDevice").field("scene", &self.scene).finish_non_exhaustive()
    }
}

impl<'a> MegaViewsDevice<'a> {
    /// Uploads a scene.
    pub fn new(executor: Box<dyn Executor + Send + 'a>, scene: &SceneTree) -> Result<Self, DeviceError> {
        let mut device = Self {
            executor,
            scene: SceneParams::new(scene),
            inner_nodes: scene.nodes.len() as u32,
            leaves: scene.leaf_count(),
            kept: BTreeMap::new(),
            levels: Vec::new(),
            digits: Vec::new(),
            scans: Vec::new(),
            timings: None,
        };
        let words = |first: usize| -> Vec<[u32; 2]> {
            scene.nodes.iter().map(|node| [node.words[first], node.words[first + 1]]).collect()
        };
        let (links, places) = (words(0), words(2));
        let level_params: Vec<[LevelParams; 1]> = (0..MOST_TREE_LEVELS as u32)
            .map(|level| [LevelParams { level, reserved_a: 0, reserved_b: 0, reserved_c: 0 }])
            .collect();
        let head = [device.scene];
        let (head_buffer, links_buffer, places_buffer) = (
            device.keep("scene parameters", 32)?,
            device.keep("scene nodes", 8 * links.len() as u64)?,
            device.keep("scene places", 8 * places.len() as u64)?,
        );
        let zeros = device.keep("zeros", 64)?;
        for _ in 0..MOST_TREE_LEVELS {
            device.levels.push(device.executor.buffer("level parameters", 16)?);
        }
        for _ in 0..SORT_DIGITS {
            device.digits.push(device.executor.buffer("sort parameters", 16)?);
        }
        for _ in 0..3 {
            device.scans.push(device.executor.buffer("prefix sum parameters", 16)?);
        }
        let mut recording = Recording::new();
        recording.upload(head_buffer, &head);
        recording.upload(links_buffer, &links);
        recording.upload(places_buffer, &places);
        recording.clear(zeros);
        for (buffer, params) in device.levels.iter().zip(&level_params) {
            recording.upload(*buffer, params);
        }
        device.executor.run(&recording)?;
        Ok(device)
    }

    /// Inner nodes and leaves of the scene.
    pub fn scene_nodes(&self) -> [u32; 2] {
        [self.inner_nodes, self.leaves]
    }

    /// Bytes of a buffer that a stage can see.
    pub fn binding_bytes(&self) -> u64 {
        self.executor.limits().binding_bytes
    }

    /// Waits after every stage from now on and takes the time; see [`MegaViewsDevice::timings`].
    pub fn take_times(&mut self) {
        self.timings = Some(Vec::new());
    }

    /// What stages took since [`MegaViewsDevice::take_times`].
    pub fn timings(&mut self) -> Vec<(&'static str, Duration)> {
        self.timings.take().unwrap_or_default()
    }

    /// The buffer of this name, of at least so many bytes.
    fn keep(&mut self, what: &'static str, bytes: u64) -> Result<BufferId, DeviceError> {
        if let Some(&(buffer, size)) = self.kept.get(what) {
            if size >= bytes && size / 4 <= bytes.max(1 << 16) {
                return Ok(buffer);
            }
            self.executor.release(buffer);
            self.kept.remove(what);
        }
        let buffer = self.executor.buffer(what, bytes)?;
        self.kept.insert(what, (buffer, bytes));
        Ok(buffer)
    }

    fn kept(&self, what: &'static str) -> BufferId {
        self.kept[what].0
    }

    fn bindings<const N: usize>(&self, names: [&'static str; N]) -> [Binding; N] {
        names.map(|name| self.kept(name).into())
    }

    /// Runs a part of a frame that downloads nothing, at once or when times are taken.
    fn run(&mut self, parts: Vec<(&'static str, Recording<'_>)>) -> Result<(), DeviceError> {
        let zeros = self.kept("zeros");
        for (name, mut part) in parts {
            let start = Instant::now();
            if self.timings.is_some() {
                part.download(zeros, 1);
            }
            self.executor.run(&part)?;
            if let Some(timings) = &mut self.timings {
                timings.push((name, start.elapsed()));
            }
        }
        Ok(())
    }

    fn download<T: Pod>(&mut self, buffer: BufferId, count: usize) -> Result<Vec<T>, DeviceError> {
        let mut recording = Recording::new();
        recording.download(buffer, count * size_of::<T>() / 4);
        let start = Instant::now();
        let words = self.executor.run(&recording)?.pop().unwrap_or_default();
        if let Some(timings) = &mut self.timings {
            timings.push(("download", start.elapsed()));
        }
        // Words are aligned for all that is made of words.
        Ok(bytemuck::cast_slice(&words).to_vec())
    }

    /// Most views that [`MegaViewsDevice::sort`] takes at once.
    pub fn most_views(&self) -> usize {
        (self.binding_bytes() / size_of::<ViewCone>() as u64).min(1 << 24) as usize
    }

    /// Puts views in Morton order, for [`MegaViewsDevice::pass`]. Equal keys stay in their order.
    ///
    /// # Panics
    /// If there are no views, or more than [`MegaViewsDevice::most_views`].
    pub fn sort(&mut self, views: &[ViewCone]) -> Result<SortedOrder, DeviceError> {
        assert!(!views.is_empty() && views.len() <= self.most_views(), "some views, and not too many");
        let count = views.len() as u64;
        let chunks = views.len().div_ceil(SORT_CHUNK as usize) as u32;
        for (what, bytes) in [
            ("views", 32 * count),
            ("keys", 8 * count),
            ("order", 4 * count),
            ("next order", 4 * count),
            ("digit counts", 4 * 256 * u64::from(chunks)),
            ("sums of counts", 4 * u64::from(chunks)),
            ("sums of sums", 4 * u64::from(chunks.div_ceil(SCAN_CHUNK))),
            ("sorted keys", 8 * count),
            ("sorted views", 32 * count),
        ] {
            self.keep(what, bytes)?;
        }
        let digit_params: Vec<[SortParams; 1]> = (0..SORT_DIGITS)
            .map(|digit| [SortParams { count: count as u32, digit, chunks, reserved: 0 }])
            .collect();
        let scan_counts = [256 * chunks, chunks, chunks.div_ceil(SCAN_CHUNK)];
        let scan_params =
            scan_counts.map(|count| [ScanParams { count, reserved_a: 0, reserved_b: 0, reserved_c: 0 }]);

        let of_views = grid(views.len().div_ceil(64) as u32);
        let of_chunks = [chunks.div_ceil(64), 1, 1];
        let mut recording = Recording::new();
        recording.upload(self.kept("views"), views);
        for (buffer, params) in self.digits.iter().zip(&digit_params) {
            recording.upload(*buffer, params);
        }
        for (buffer, params) in self.scans.iter().zip(&scan_params) {
            recording.upload(*buffer, params);
        }
        let uploads = std::mem::take(&mut recording);
        let [scene, views_buffer, keys] = self.bindings(["scene parameters", "views", "keys"]);
        let mut orders: [Binding; 2] = self.bindings(["order", "next order"]);
        let sort: Vec<Binding> = self.digits.iter().map(|&buffer| buffer.into()).collect();
        recording.dispatch(&stages::view_keys, of_views, &[scene, sort[0], views_buffer, keys, orders[0]]);
        let counts = self.kept("digit counts");
        for &digit in &sort {
            recording.clear(counts);
            recording.dispatch(&stages::sort_count, of_chunks, &[digit, keys, orders[0], counts.into()]);
            self.scan_digits(&mut recording, chunks);
            let bindings = [digit, keys, orders[0], counts.into(), orders[1]];
            recording.dispatch(&stages::sort_scatter, of_chunks, &bindings);
            orders.swap(0, 1);
        }
        let [sorted_keys, sorted_views] = self.bindings(["sorted keys", "sorted views"]);
        let bindings = [sort[0], orders[0], keys, views_buffer, sorted_keys, sorted_views];
        recording.dispatch(&stages::sort_gather, of_views, &bindings);
        self.run(vec![("upload", uploads), ("sort", recording)])?;
        let order = if orders[0] == self.kept("order").into() { "order" } else { "next order" };
        let order = self.download(self.kept(order), views.len())?;
        let keys = self.download(self.kept("sorted keys"), views.len())?;
        Ok(SortedOrder { order, keys })
    }

    /// Turns the counts of digits into places.
    fn scan_digits(&self, recording: &mut Recording<'_>, chunks: u32) {
        let names = ["digit counts", "sums of counts", "sums of sums", "zeros"];
        let buffers: [Binding; 4] = self.bindings(names);
        // Prefix sums of at most SCAN_CHUNK values are one invocation's.
        let levels = if chunks <= SCAN_CHUNK { 2 } else { 3 };
        let groups = |level: u32| {
            let values = (256 * u64::from(chunks)).div_ceil(u64::from(SCAN_CHUNK).pow(level));
            [values.div_ceil(64 * u64::from(SCAN_CHUNK)) as u32, 1, 1]
        };
        for level in 0..levels - 1 {
            let bindings = [self.scans[level].into(), buffers[level], buffers[level + 1]];
            recording.dispatch(&stages::scan_sums, groups(level as u32), &bindings);
        }
        for level in (0..levels).rev() {
            let offsets = if level + 1 == levels { buffers[3] } else { buffers[level + 1] };
            let bindings = [self.scans[level].into(), offsets, buffers[level]];
            recording.dispatch(&stages::scan_apply, groups(level as u32), &bindings);
        }
    }

    /// Draws `count` sorted views from number `start` on.
    pub fn pass(
        &mut self,
        start: u32,
        count: u32,
        settings: &MegaViewsSettings,
        room: Room,
    ) -> Result<PassResult, DeviceError> {
        let texels = texel_count(settings.resolution) as u32;
        let number_words = if settings.with_numbers { texels } else { 0 };
        let depth_words = if settings.half_depths { texels / 2 } else { texels };
        let packed_words = depth_words + number_words;
        let leaves = room.nodes.min(count);
        for (what, bytes) in [
            ("pass parameters", 64),
            ("parameters of numbers", 64),
            ("view hierarchy", 4 * tree::WORDS as u64),
            ("ranges", 8 * u64::from(room.nodes)),
            ("sums of chunks", 8 * u64::from(room.nodes)),
            ("view nodes", 48 * u64::from(room.nodes)),
            ("links", 4 * u64::from(room.nodes + leaves)),
            ("boxes", 32 * u64::from(room.nodes)),
            ("counters", 4 * counter::WORDS as u64),
            ("arguments", 24),
            ("pairs", 8 * u64::from(room.pairs)),
            ("queued pairs", 8 * u64::from(room.pairs)),
            ("near pairs", 8 * u64::from(room.near)),
            ("maps", 4 * u64::from(texels + number_words) * u64::from(room.nodes)),
            ("leaf maps", 4 * u64::from(packed_words) * u64::from(leaves)),
        ] {
            self.keep(what, bytes)?;
        }
        let params = PassParams {
            resolution: settings.resolution,
            texels,
            scale: settings.resolution as f32 / settings.texels,
            culling: u32::from(settings.culling),
            run_start: start,
            run_count: count,
            sharing: u32::from(settings.sharing),
            // A lane looks at no more texels than drivers let it loop over.
            near_lanes: (texels / 32_768).clamp(NEAR_LANES, 64),
            node_capacity: room.nodes,
            pair_capacity: room.pairs,
            near_capacity: room.near,
            half_depths: u32::from(settings.half_depths),
            slices: texels.div_ceil(crate::constants::MAP_SLICE),
            with_numbers: u32::from(settings.with_numbers),
            draws_numbers: 0,
            reserved: 0,
        };
        let of_numbers = [PassParams { draws_numbers: 1, ..params }];
        let head = first_node(params.slices);
        let params = [params];
        let (whole_run, root_pair) = ([[0, count]], [[0, PAIR_WHOLE]]);
        let mut first_counters = [0u32; counter::WORDS];
        first_counters[counter::QUEUED] = 1;
        let mut uploads = Recording::new();
        uploads.upload(self.kept("pass parameters"), &params);
        uploads.upload(self.kept("parameters of numbers"), &of_numbers);
        uploads.upload(self.kept("view hierarchy"), &head);
        uploads.upload(self.kept("ranges"), &whole_run);
        uploads.upload(self.kept("pairs"), &root_pair);
        uploads.upload(self.kept("counters"), &first_counters);

        let levels = most_levels(count, settings.sharing);
        let mut parts = vec![("upload", uploads)];
        parts.extend(self.record_hierarchy(levels));
        parts.extend(self.record_traversal(levels + self.scene.depth as usize, settings.with_numbers));
        parts.extend(self.record_maps(levels));
        if self.timings.is_none() {
            // Everything at once.
            self.run_together(parts)?;
        } else {
            self.run(parts)?;
        }

        let counters: Vec<u32> = self.download(self.kept("counters"), counter::WORDS)?;
        if counters[counter::FLAGS] != 0 {
            return Ok(PassResult::NoRoom(counters[counter::FLAGS]));
        }
        let head: Vec<u32> = self.download(self.kept("view hierarchy"), tree::WORDS)?;
        if counters[counter::PAIRS] != 0 || head[tree::STARTS + levels] != head[tree::STARTS + levels + 1] {
            return Err(DeviceError::Failed("MegaViews came to no end; please report this".to_owned()));
        }
        let nodes = self.download(self.kept("view nodes"), head[tree::NODES] as usize)?;
        let maps = head[tree::LEAVES] as usize;
        let mut depths: Vec<u32> = self.download(self.kept("leaf maps"), maps * packed_words as usize)?;
        let numbers = depths.split_off(maps * depth_words as usize);
        let mut level_starts = head[tree::STARTS..=tree::STARTS + levels].to_vec();
        level_starts.dedup();
        let pairs = [counters[counter::MOST], counters[counter::NEAR]];
        Ok(PassResult::Maps(PassMaps { nodes, level_starts, depths, numbers, pairs }))
    }

    fn run_together(&mut self, parts: Vec<(&'static str, Recording<'_>)>) -> Result<(), DeviceError> {
        let mut whole = Recording::new();
        for (_, part) in parts {
            whole.append(part);
        }
        self.executor.run(&whole)?;
        Ok(())
    }
}

/// Invocations that share a near pair where that is not too few.
const NEAR_LANES: u32 = 8;

fn grid(groups: u32) -> [u32; 3] {
    let most = crate::constants::MAX_WORKGROUPS;
    [groups.min(most), groups.div_ceil(most), 1]
}
