//! ManyLoDs as stages: on a GPU, or by their twins.
//!
//! # Practice
//! How long lists get is not known before. A pass whose lists were too short has drawn nothing that counts and says so at
//! its end; it is done again with longer lists, or with half as many views once lists are as long as the budget lets them be.

use super::octants::Eye;
use crate::gpu::{GpuContext, WgpuExecutor};
use crate::views::{Depths, PassSink, View, ViewError, ViewMaps, ViewRenderer, ViewSettings};
use half::f16;
use manyview_shaders::executor::{CpuExecutor, Executor, ExecutorLimits};
use manyview_shaders::jobs::many_lods::{ManyLodsDevice, ManyLodsParams};
use manyview_shaders::paraboloid::texel_count;
use manyview_shaders::scene_tree::SceneTree;
use manyview_shaders::views::ViewNode;
use std::sync::{Mutex, PoisonError};

/// Bytes of a view on the device beside its map: node and first pair.
const VIEW_BYTES: u64 = 56;
/// Bytes of the lists for each node-view that an active list has room for: two of them, and one of near leaves.
const PAIR_BYTES: u64 = 24;
/// Node-views a view that lists are made for at first.
const FIRST_PAIRS: u64 = 1024;
/// Node-views that lists have room for in any case.
const LEAST_PAIRS: u64 = 64;

/// Basic cuts through an octree on one device, which draws one frame after the other: method `manylods` on GPUs.
#[derive(Debug)]
pub struct SvoCutsGpu<'a> {
    device: Mutex<ManyLodsDevice<'a>>,
}

impl<'a> SvoCutsGpu<'a> {
    /// Uploads a scene to a GPU.
    pub fn on_gpu(context: &'a GpuContext, scene: &SceneTree) -> Result<Self, ViewError> {
        Self::new(Box::new(WgpuExecutor::new(context, ExecutorLimits::DEFAULT)), scene)
    }

    /// The same by the twins of the stages, one thread: to find out which stage goes wrong.
    pub fn on_twins(scene: &SceneTree) -> Result<SvoCutsGpu<'static>, ViewError> {
        SvoCutsGpu::new(Box::new(CpuExecutor::default()), scene)
    }

    /// Uploads a scene to what runs stages.
    pub fn new(executor: Box<dyn Executor + Send + 'a>, scene: &SceneTree) -> Result<Self, ViewError> {
        Ok(Self { device: Mutex::new(ManyLodsDevice::new(executor, scene)?) })
    }
}

/// How many views and node-views fit.
struct Room {
    views: u64,
    pairs: u64,
}

impl Room {
    fn new(settings: &ViewSettings, binding_bytes: u64) -> Result<Self, ViewError> {
        let map = 4 * texel_count(settings.resolution) as u64;
        let view = VIEW_BYTES + map + settings.map_bytes();
        let needed_bytes = view + LEAST_PAIRS * PAIR_BYTES;
        if map > binding_bytes || needed_bytes > settings.budget_bytes {
            return Err(settings.over_budget("the map of one view", needed_bytes));
        }
        let left = settings.budget_bytes - needed_bytes;
        let pairs = (LEAST_PAIRS + left / 2 / PAIR_BYTES).min(binding_bytes / 8).min(u64::from(u32::MAX));
        let views = 1 + (settings.budget_bytes - view - pairs * PAIR_BYTES) / view;
        Ok(Self { views: views.min(binding_bytes / map).min(binding_bytes / 48).min(pairs), pairs })
    }
}

impl ViewRenderer for SvoCutsGpu<'_> {
    fn name(&self) -> &'static str {
        "manylods"
    }

    fn render_passes(
        &self,
        views: &[View],
        settings: &ViewSettings,
        sink: &mut PassSink<'_>,
    ) -> Result<(), ViewError> {
        settings.check()?;
        if settings.with_colors {
            let problem = "draws no colours on a GPU; use it on the CPU";
            return Err(ViewError::Unsupported { method: "manylods", problem });
        }
        let mut device = self.device.lock().unwrap_or_else(PoisonError::into_inner);
        let room = Room::new(settings, device.binding_bytes())?;
        let scale = settings.scale();
        let (mut first, mut at_once) = (0, room.views as usize);
        let mut pairs_a_view = FIRST_PAIRS;
        while first < views.len() {
            let run = &views[first..views.len().min(first + at_once)];
            let drawn: Vec<u32> =
                (0..).zip(run).filter(|(_, view)| view.is_drawable()).map(|(i, _)| i).collect();
            let node = |&i: &u32| Eye::new(&run[i as usize], scale, settings.culling).view;
            let nodes: Vec<ViewNode> = drawn.iter().map(node).collect();
            let pairs = (nodes.len() as u64 * pairs_a_view).clamp(LEAST_PAIRS, room.pairs);
            let mut depths = Vec::new();
            if !nodes.is_empty() {
                let params = ManyLodsParams {
                    resolution: settings.resolution,
                    scale,
                    culling: settings.culling,
                    pairs: pairs as u32,
                    near: pairs as u32,
                };
                let found = device.draw(&nodes, &params)?;
                if found.depths.is_empty() {
                    if pairs < room.pairs {
                        pairs_a_view *= 4;
                    } else if nodes.len() > 1 {
                        at_once = nodes.len().div_ceil(2);
                    } else {
                        let needed = u64::from(found.lists[0].max(found.lists[1])).max(2 * pairs);
                        let what = "the lists of one view on a device";
                        return Err(settings.over_budget(what, settings.budget_bytes + needed * PAIR_BYTES));
                    }
                    continue;
                }
                depths = found.depths;
            }
            let mut map_of = vec![ViewMaps::NO_MAP; run.len()];
            for (map, &place) in (0..).zip(&drawn) {
                map_of[place as usize] = map;
            }
            let depths = match settings.half_depths {
                true => Depths::Half(depths.iter().map(|&d| f16::from_f32(f32::from_bits(d))).collect()),
                false => Depths::Full(bytemuck::cast_vec(depths)),
            };
            let numbers = (first as u32..).take(run.len()).collect();
            let centers = nodes.iter().map(|node| node.center).collect();
            sink(ViewMaps::from_parts(settings.resolution, numbers, map_of, centers, depths, Vec::new()))?;
            first += run.len();
        }
        Ok(())
    }
}
