//! ManyLoDs as recordings of stages: those of MegaViews ([`crate::mega_views`]), where every view is a leaf of its own and a
//! root of the traversal.
//!
//! # Practice
//! The first list pairs the root with every view; each of the following steps subdivides scene nodes alone. Not a word comes
//! from the CPU between the first stage and the last. Lists that were too short are told at the end.

use super::Workspace;
use crate::constants::{MAP_SLICE, MAX_WORKGROUPS};
use crate::device::DeviceError;
use crate::executor::{BufferId, Executor, Recording};
use crate::mega_views::{PAIR_WHOLE, PassParams, SceneParams, counter, tree};
use crate::paraboloid::texel_count;
use crate::scene_tree::SceneTree;
use crate::stages;
use crate::views::ViewNode;

/// How maps are drawn, and what there is room for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ManyLodsParams {
    /// Texels a side of each half of a map.
    pub resolution: u32,
    /// Resolution over the texels that a node may fill and still be drawn as a point.
    pub scale: f32,
    /// Drop what is outside views' fields.
    pub culling: bool,
    /// Node-views that each of the two active lists has room for.
    pub pairs: u32,
    /// Near leaves that there is room for.
    pub near: u32,
}

/// Maps of views, and how long lists were.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ManyLodsMaps {
    /// Bits of distances, map after map; empty if there was too little room.
    pub depths: Vec<u32>,
    /// Longest active list and number of near leaves; of both only as far as there was room.
    pub lists: [u32; 2],
}

/// A scene on an executor.
pub struct ManyLodsDevice<'a> {
    executor: Box<dyn Executor + Send + 'a>,
    params: BufferId,
    links: BufferId,
    places: BufferId,
    depth: u32,
}

impl std::fmt::Debug for ManyLodsDevice<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ManyLodsDevice").field("depth", &self.depth).finish_non_exhaustive()
    }
}

impl<'a> ManyLodsDevice<'a> {
    /// Uploads a scene.
    pub fn new(mut executor: Box<dyn Executor + Send + 'a>, scene: &SceneTree) -> Result<Self, DeviceError> {
        let words = |first: usize| -> Vec<[u32; 2]> {
            scene.nodes.iter().map(|node| [node.words[first], node.words[first + 1]]).collect()
        };
        let (head, links_words, places_words) = ([SceneParams::new(scene)], words(0), words(2));
        let params = executor.buffer("scene parameters", size_of::<SceneParams>() as u64)?;
        let links = executor.buffer("scene nodes", 8 * links_words.len() as u64)?;
        let places = executor.buffer("scene places", 8 * places_words.len() as u64)?;
        let mut recording = Recording::new();
        recording.upload(params, &head);
        recording.upload(links, &links_words);
        recording.upload(places, &places_words);
        executor.run(&recording)?;
        Ok(Self { executor, params, links, places, depth: scene.depth })
    }

    /// Bytes of a buffer that a stage can see.
    pub fn binding_bytes(&self) -> u64 {
        self.executor.limits().binding_bytes
    }

    /// Draws views, each a node of radius 0.
    pub fn draw(&mut self, views: &[ViewNode], params: &ManyLodsParams) -> Result<ManyLodsMaps, DeviceError> {
        let texels = texel_count(params.resolution) as u32;
        let count = views.len() as u32;
        let (scene, links, places) = (self.params.into(), self.links.into(), self.places.into());
        let mut workspace = Workspace::new(&mut *self.executor);
        let pass_params = [PassParams {
            resolution: params.resolution,
            texels,
            scale: params.scale,
            culling: u32::from(params.culling),
            run_start: 0,
            run_count: count,
            sharing: 0,
            // A lane looks at no more texels than drivers let it loop over.
            near_lanes: (texels / 32_768).clamp(8, 64),
            node_capacity: count,
            pair_capacity: params.pairs,
            near_capacity: params.near,
            half_depths: 0,
            slices: texels.div_ceil(MAP_SLICE),
            with_numbers: 0,
            draws_numbers: 0,
            reserved: 0,
        }];
        let mut head = [0u32; tree::WORDS];
        head[tree::NODES] = count;
        let mut first_counters = [0u32; counter::WORDS];
        first_counters[counter::QUEUED] = count;
        let roots: Vec<[u32; 2]> = (0..count).map(|view| [0, view | PAIR_WHOLE]).collect();

        let pass = workspace.buffer("pass parameters", 64)?;
        let tree = workspace.buffer("view hierarchy", 4 * tree::WORDS as u64)?;
        let nodes = workspace.buffer("view nodes", 48 * u64::from(count))?;
        let counters = workspace.buffer("counters", 4 * counter::WORDS as u64)?;
        let arguments = workspace.buffer("arguments", 24)?;
        let pairs = workspace.buffer("an active list", 8 * u64::from(params.pairs.max(count)))?;
        let queued = workspace.buffer("the next active list", 8 * u64::from(params.pairs))?;
        let near = workspace.buffer("near leaves", 8 * u64::from(params.near))?;
        let maps = workspace.buffer("maps", 4 * u64::from(texels) * u64::from(count))?;

        let mut recording = Recording::new();
        recording.upload(pass, &pass_params);
        recording.upload(tree, &head);
        recording.upload(nodes, views);
        recording.upload(counters, &first_counters);
        recording.upload(pairs, &roots);
        let (pass, tree, nodes) = (pass.into(), tree.into(), nodes.into());
        let maps_of = [count.min(MAX_WORKGROUPS), count.div_ceil(MAX_WORKGROUPS), pass_params[0].slices];
        recording.dispatch(&stages::maps_clear, maps_of, &[pass, tree, maps.into()]);
        let mut lists = [pairs.into(), queued.into()];
        let prepare = [pass, tree, counters.into(), arguments.into()];
        // The root itself, then its levels.
        for _ in 0..=self.depth {
            recording.dispatch(&stages::pairs_prepare, [1; 3], &prepare);
            let bindings = [
                scene,
                pass,
                links,
                places,
                nodes,
                lists[0],
                counters.into(),
                lists[1],
                near.into(),
                maps.into(),
            ];
            recording.dispatch_indirect(&stages::pairs_step, arguments, 0, &bindings);
            lists.swap(0, 1);
        }
        recording.dispatch(&stages::pairs_prepare, [1; 3], &prepare);
        let bindings = [scene, pass, places, nodes, counters.into(), near.into(), maps.into()];
        recording.dispatch_indirect(&stages::pairs_near, arguments, 3, &bindings);
        recording.download(counters, counter::WORDS);
        recording.download(maps, texels as usize * views.len());
        let mut found = workspace.executor.run(&recording)?;
        let mut depths = found.pop().unwrap_or_default();
        let counters = found.pop().unwrap_or_default();
        if counters[counter::FLAGS] != 0 {
            depths.clear();
        }
        Ok(ManyLodsMaps { depths, lists: [counters[counter::MOST], counters[counter::NEAR]] })
    }
}
