//! MegaViews as stages: on a GPU, or by their twins.
//!
//! # Practice
//! Views are sorted on the device; each run of them that fits is a pass ([`manyview_shaders::jobs::mega_views`]). How many pairs
//! a pass queues is not known before. One that needs more room than there is draws nothing, says so together with its results,
//! and is drawn again in halves: maps are never wrong, and passes come one after the other however the room was guessed.
//!
//! With colours maps also hold which scene node each texel shows (\[MV\]'s nodes have colours, and its maps too); the colours are
//! looked up here, so that they need no room on the device.
//!
//! # Differences from the paper
//! \[MV\] §3.5 starts its passes from the children of the view root. Here a pass is any run of sorted views, with a hierarchy
//! of its own, so that passes are as large as there is room for.

use super::colors;
use super::view_tree::Sharing;
use crate::gpu::{GpuContext, WgpuExecutor};
use crate::views::{Depths, PassSink, View, ViewError, ViewMaps, ViewRenderer, ViewSettings};
use half::f16;
use manyview_shaders::executor::{CpuExecutor, Executor, ExecutorLimits};
use manyview_shaders::jobs::mega_views::{MegaViewsDevice, MegaViewsSettings, PassMaps, PassResult, Room};
use manyview_shaders::mega_views::ViewCone;
use manyview_shaders::paraboloid::texel_count;
use manyview_shaders::scene_tree::SceneTree;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Bytes that a view takes while it is sorted: position and cone twice, key twice, order twice, counts, and copies.
const BYTES_PER_VIEW: u64 = 160;
/// Bytes that a node of the view hierarchy takes beside its map.
const BYTES_PER_NODE: u64 = 112;
/// Bytes of a pair.
const BYTES_PER_PAIR: u64 = 8;

/// MegaViews as stages on one device, which draws one frame after the other.
#[derive(Debug)]
pub struct MegaViewsGpu<'a> {
    device: Mutex<MegaViewsDevice<'a>>,
    sharing: Sharing,
    most: Room,
    /// What colours are looked up in, if the scene has some.
    colored: Option<SceneTree>,
}

impl<'a> MegaViewsGpu<'a> {
    /// Uploads a scene to a GPU.
    pub fn on_gpu(context: &'a GpuContext, scene: &SceneTree) -> Result<Self, ViewError> {
        Self::new(Box::new(WgpuExecutor::new(context, ExecutorLimits::DEFAULT)), scene)
    }

    /// The same by the twins of the stages, one thread: to find out which stage goes wrong.
    pub fn on_twins(scene: &SceneTree) -> Result<MegaViewsGpu<'static>, ViewError> {
        MegaViewsGpu::new(Box::new(CpuExecutor::default()), scene)
    }

    /// Uploads a scene to what runs stages.
    pub fn new(executor: Box<dyn Executor + Send + 'a>, scene: &SceneTree) -> Result<Self, ViewError> {
        let device = Mutex::new(MegaViewsDevice::new(executor, scene)?);
        let most = Room { nodes: u32::MAX, pairs: u32::MAX, near: u32::MAX };
        let colored = (!scene.colors.is_empty()).then(|| scene.clone());
        Ok(Self { device, sharing: Sharing::default(), most, colored })
    }

    /// Chooses which views share a map.
    #[must_use]
    pub fn with_sharing(self, sharing: Sharing) -> Self {
        Self { sharing, ..self }
    }

    /// Gives passes no more room than this, whatever the budget.
    #[must_use]
    pub fn with_most_room(self, most: Room) -> Self {
        Self { most, ..self }
    }

    /// Waits after every part of a frame from now on and takes its time, for [`MegaViewsGpu::timings`].
    pub fn take_times(&self) {
        self.device().take_times();
    }

    /// What parts of frames took since [`MegaViewsGpu::take_times`], in order.
    pub fn timings(&self) -> Vec<(&'static str, Duration)> {
        self.device().timings()
    }

    fn device(&self) -> std::sync::MutexGuard<'_, MegaViewsDevice<'a>> {
        self.device.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What a frame's memory is used for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Plan {
    /// Views of a pass.
    run: u32,
    room: Room,
}

impl Plan {
    /// For so many views: half of what they leave is for hierarchies and maps, a quarter each for the queue and for near
    /// pairs, unless less than that can be of use.
    fn new(
        settings: &ViewSettings,
        views: usize,
        device: &MegaViewsDevice<'_>,
        most: Room,
    ) -> Result<Self, ViewError> {
        let texel_words = if settings.with_colors { 2 } else { 1 };
        let map_bytes = 4 * texel_words * texel_count(settings.resolution) as u64;
        let node_bytes = map_bytes + BYTES_PER_NODE;
        // Packed, on its way to the CPU, and there with colours for numbers.
        let copies = 1 + texel_words;
        let leaf_bytes = copies * settings.map_bytes();
        let rest = settings.budget_bytes.saturating_sub(views as u64 * BYTES_PER_VIEW);
        let binding = device.binding_bytes();
        // Of five nodes about three are leaves.
        let nodes = (rest / 2 * 5 / (5 * node_bytes + 3 * leaf_bytes))
            .min(binding / map_bytes)
            .min(2 * views as u64)
            .min(u64::from(most.nodes));
        if nodes == 0 {
            let needed_bytes = 2 * (node_bytes + leaf_bytes) + views as u64 * BYTES_PER_VIEW;
            return Err(settings.over_budget("one view", needed_bytes));
        }
        let run = (nodes * 3 / 5).clamp(1, views as u64);
        let [inner, leaves] = device.scene_nodes().map(u64::from);
        let room_of = |bytes: u64, scene_nodes: u64, most: u32| {
            let pairs = bytes.min(binding) / BYTES_PER_PAIR;
            pairs.min((run + nodes) * scene_nodes.max(8)).clamp(1, u64::from(most).max(1)) as u32
        };
        let room = Room {
            nodes: nodes as u32,
            pairs: room_of(rest / 8, inner + leaves, most.pairs),
            near: room_of(rest / 4, leaves, most.near),
        };
        Ok(Self { run: run as u32, room })
    }
}

impl ViewRenderer for MegaViewsGpu<'_> {
    fn name(&self) -> &'static str {
        "megaviews-gpu"
    }

    fn render_passes(
        &self,
        views: &[View],
        settings: &ViewSettings,
        sink: &mut PassSink<'_>,
    ) -> Result<(), ViewError> {
        settings.check()?;
        if settings.with_colors && self.colored.is_none() {
            let problem = "was given a scene without colours; load it with them";
            return Err(ViewError::Unsupported { method: "megaviews-gpu", problem });
        }
        let (drawable, others): (Vec<u32>, Vec<u32>) =
            (0..views.len() as u32).partition(|&view| views[view as usize].is_drawable());
        if !others.is_empty() {
            sink(ViewMaps::without_maps(settings, others))?;
        }
        let mut device = self.device();
        // Views are sorted together as long as that leaves most of the budget.
        let together = (settings.budget_bytes / 4 / BYTES_PER_VIEW).clamp(1, device.most_views() as u64);
        for indices in drawable.chunks(together as usize) {
            self.frame(&mut device, views, indices, settings, sink)?;
        }
        Ok(())
    }
}

impl MegaViewsGpu<'_> {
    fn frame(
        &self,
        device: &mut MegaViewsDevice<'_>,
        views: &[View],
        indices: &[u32],
        settings: &ViewSettings,
        sink: &mut PassSink<'_>,
    ) -> Result<(), ViewError> {
        let Plan { mut run, room } = Plan::new(settings, indices.len(), device, self.most)?;
        let cones: Vec<ViewCone> = indices.iter().map(|&view| (&views[view as usize]).into()).collect();
        let sorted = device.sort(&cones)?;
        drop(cones);
        let of_pass = MegaViewsSettings {
            resolution: settings.resolution,
            texels: settings.texels,
            culling: settings.culling,
            sharing: self.sharing == Sharing::Voxel,
            half_depths: settings.half_depths,
            with_numbers: settings.with_colors,
        };
        let mut places = &sorted.order[..];
        while !places.is_empty() {
            let count = places.len().min(run as usize);
            let start = sorted.order.len() - places.len();
            match device.pass(start as u32, count as u32, &of_pass, room)? {
                PassResult::Maps(maps) => {
                    let (pass, rest) = places.split_at(count);
                    let pass = pass.iter().map(|&place| indices[place as usize]).collect();
                    sink(self.view_maps(pass, &maps, settings))?;
                    places = rest;
                }
                PassResult::NoRoom(_) if count == 1 => {
                    let needed_bytes = settings.budget_bytes.saturating_mul(2);
                    return Err(settings.over_budget("the queue of one view", needed_bytes));
                }
                PassResult::NoRoom(_) => run = count.div_ceil(2) as u32,
            }
        }
        Ok(())
    }

    /// The maps of a pass over `views`.
    fn view_maps(&self, views: Vec<u32>, maps: &PassMaps, settings: &ViewSettings) -> ViewMaps {
        let mut map_of = vec![ViewMaps::NO_MAP; views.len()];
        let mut centers = Vec::new();
        for leaf in maps.nodes.iter().filter(|node| node.is_leaf()) {
            map_of[leaf.range()].fill(centers.len() as u32);
            centers.push(leaf.center);
        }
        let depths = depths(&maps.depths, settings.half_depths);
        let colors = self.colored.as_ref().map_or_else(Vec::new, |scene| colors(scene, &maps.numbers));
        ViewMaps::from_parts(settings.resolution, views, map_of, centers, depths, colors)
    }
}

fn depths(words: &[u32], half: bool) -> Depths {
    if half {
        Depths::Half(words.iter().flat_map(|&w| [w as u16, (w >> 16) as u16].map(f16::from_bits)).collect())
    } else {
        Depths::Full(words.iter().map(|&word| f32::from_bits(word)).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use manyview_shaders::cases::Random;
    use manyview_shaders::svo::Svo;

    /// A floor of 16 × 16 voxels, each of a colour of its own.
    fn scene() -> SceneTree {
        let floor = (0..256).map(|i| [i % 16, 0, i / 16]);
        let mut svo = Svo::of_cells([-4.0; 3], 8.0, 4, floor);
        for (number, level) in svo.levels.iter_mut().enumerate() {
            for (i, color) in level.colors.iter_mut().enumerate() {
                *color = [i as u8, number as u8, 1];
            }
        }
        SceneTree::new(&svo, true)
    }

    fn views(count: usize) -> Vec<View> {
        let mut random = Random::new(11);
        let mut vector = |reach: i32| [0; 3].map(|_| random.range(-reach, reach) as f32 / 1000.0);
        (0..count).map(|_| View::new(vector(3900), vector(1000), 1.9)).collect()
    }

    fn renderer() -> MegaViewsGpu<'static> {
        MegaViewsGpu::on_twins(&scene()).unwrap()
    }

    #[test]
    fn odd_views_get_the_maps_they_should() {
        let settings = ViewSettings::new(16);
        let none = renderer().render_views(&[], &settings).unwrap();
        assert!(none.views().is_empty());
        let odd = [
            View::around([f32::NAN, 0.0, 0.0]),
            View::around([0.0; 3]),
            View::around([0.0, f32::INFINITY, 0.0]),
            View::around([0.0, 200.0, 0.0]),
        ];
        let maps = renderer().render_views(&odd, &settings).unwrap();
        assert_eq!(maps.views(), [0, 1, 2, 3]);
        let finite = |place: usize| maps.view_depths(place).iter().filter(|d| d.is_finite()).count();
        assert_eq!([maps.map_of()[0], maps.map_of()[2]], [ViewMaps::NO_MAP; 2]);
        assert!(finite(0) == 0 && finite(2) == 0 && finite(1) > 20);
        // From high above the floor fills one texel or a few.
        assert!((1..=4).contains(&finite(3)));
        let one = renderer().render_views(&odd[1..2], &settings).unwrap();
        assert_eq!(one.view_depths(0), maps.view_depths(1), "alone or among others");
    }

    #[test]
    fn a_scene_without_colours_and_no_budget_are_errors() {
        let settings = ViewSettings { with_colors: true, ..ViewSettings::new(16) };
        let uncolored = SceneTree { colors: Vec::new(), ..scene() };
        let error =
            MegaViewsGpu::on_twins(&uncolored).unwrap().render_views(&views(1), &settings).unwrap_err();
        assert!(matches!(error, ViewError::Unsupported { .. }), "{error}");
        for (budget_bytes, with_colors) in [(0, false), (1000, false), (5000, false), (12_000, true)] {
            let settings = ViewSettings { budget_bytes, with_colors, ..ViewSettings::new(16) };
            let error = renderer().render_views(&views(3), &settings).unwrap_err();
            assert!(matches!(error, ViewError::Budget { .. }), "{error}");
        }
        let no_queue = renderer().with_most_room(Room { nodes: 99, pairs: 2, near: 2 });
        let error = no_queue.render_views(&views(3), &ViewSettings::new(16)).unwrap_err();
        assert!(error.to_string().contains("the queue of one view"), "{error}");
    }

    /// What does not fit a binding or the budget is left to the next pass, with colours twice as early.
    #[test]
    fn colours_take_room_from_passes() {
        let renderer = renderer();
        let nodes = |settings: &ViewSettings, views: usize| {
            Plan::new(settings, views, &renderer.device(), renderer.most).unwrap().room.nodes
        };
        let [plain, colored] =
            [false, true].map(|with_colors| ViewSettings { with_colors, ..ViewSettings::new(1024) });
        assert_eq!([nodes(&plain, 1000), nodes(&colored, 1000)], [16, 8], "128 MiB");
        let small = |settings: ViewSettings| ViewSettings { budget_bytes: 256 << 20, ..settings };
        let counts = [nodes(&small(plain), 1000), nodes(&small(colored), 1000)];
        assert!(counts[1] < counts[0] && counts[1] > 0, "{counts:?}");
    }

    /// A pass is exactly what its views give if they are drawn alone, whether it was planned or found out.
    #[test]
    fn passes_too_large_are_drawn_again_in_parts() {
        let (views, settings) = (views(70), ViewSettings { with_colors: true, ..ViewSettings::new(16) });
        let whole = renderer();
        let most = u32::MAX;
        for room in [
            Room { nodes: most, pairs: 150, near: most },
            Room { nodes: most, pairs: most, near: 256 },
            Room { nodes: 30, pairs: most, near: most },
            Room { nodes: 1, pairs: most, near: most },
        ] {
            let mut passes = Vec::new();
            let limited = renderer().with_most_room(room);
            limited
                .render_passes(&views, &settings, &mut |pass| {
                    passes.push(pass);
                    Ok(())
                })
                .unwrap();
            let mut seen: Vec<u32> = passes.iter().flat_map(|pass| pass.views().to_vec()).collect();
            seen.sort_unstable();
            assert!(passes.len() > 1 && seen.into_iter().eq(0..70), "{room:?}");
            for pass in &passes {
                let of_pass: Vec<View> = pass.views().iter().map(|&view| views[view as usize]).collect();
                let alone = whole.render_views(&of_pass, &settings).unwrap();
                for place in 0..of_pass.len() {
                    assert_eq!(alone.view_depths(place), pass.view_depths(place), "{room:?}");
                }
                assert_eq!(alone.colors(), pass.colors(), "{room:?}");
            }
        }
    }
}
