//! `brickmap`: marching through the octree's cells at a level ([`manyview_shaders::brickmap`]), on the CPU or the GPU.

use crate::visibility::parallel;
use crate::visibility::{MethodStages, StageVisibility};
use crate::visibility::{Visibility, VisibilityError};
pub use manyview_shaders::brickmap::{Brickmap, BrickmapBias};
use manyview_shaders::device::DeviceError;
use manyview_shaders::executor::Executor;
use manyview_shaders::stages;
use manyview_shaders::svo::Svo;
use manyview_shaders::types::{LightPoint, Receiver, Segment};

/// The method's name.
const NAME: &str = "brickmap";
/// Rays of one dispatch.
const RAYS_PER_DISPATCH: u64 = 1 << 25;

/// The bias that errs least at a pixel's many lights: of lifts from 0 to 2 and skips from 0 to 1.5 cells the least sum
/// of eps_v over a town (4.4 %, without bias 29.9 %) and the Sponza (1.4 %, without 8.2 %) at level 9. Half a cell more or
/// less of lift costs a tenth, a skip instead of the lift several times as much. `examples/rivals.rs --bias` measures it.
pub const DEFAULT_BIAS: BrickmapBias = BrickmapBias { normal_cells: 1.25, skip_cells: 0.0 };

/// The cells of an octree at `level`, or at its deepest level if that is coarser.
pub fn from_svo(svo: &Svo, level: u32, bias: BrickmapBias) -> Brickmap {
    let level = level.min(svo.depth());
    Brickmap::new(svo.origin, svo.size, level, &svo.cells(level as usize), bias)
}

/// Marches on all threads of the CPU.
#[derive(Debug)]
pub struct BrickmapVisibility {
    map: Brickmap,
}

impl BrickmapVisibility {
    /// Takes a map.
    pub fn new(map: Brickmap) -> Self {
        Self { map }
    }

    /// The map.
    pub fn map(&self) -> &Brickmap {
        &self.map
    }
}

/// No ray through a map takes more steps than it has planes of cells, so that these never run out.
const ENDLESS: u32 = u32::MAX;

impl Visibility for BrickmapVisibility {
    fn name(&self) -> &'static str {
        NAME
    }

    fn occluded(&self, segments: &[Segment], occluded: &mut [u8]) -> Result<(), VisibilityError> {
        let view = self.map.view();
        parallel::occluded(segments, occluded, |segment| view.march(segment, &mut { ENDLESS }).is_some());
        Ok(())
    }

    fn distances(&self, segments: &[Segment], distances: &mut [f32]) -> Result<(), VisibilityError> {
        let view = self.map.view();
        parallel::distances(segments, distances, |segment| view.march(segment, &mut { ENDLESS }));
        Ok(())
    }

    fn hidden_lights(
        &self,
        receivers: &[Receiver],
        lights: &[LightPoint],
        hidden: &mut [u32],
    ) -> Result<(), VisibilityError> {
        let view = self.map.view();
        parallel::hidden_lights(receivers, lights, hidden, |segment| {
            view.march(segment, &mut { ENDLESS }).is_some()
        });
        Ok(())
    }
}

/// Marches as stages on an executor: a GPU's, or the one that runs twins.
pub fn on_executor<'a>(
    map: &Brickmap,
    executor: Box<dyn Executor + Send + 'a>,
) -> Result<StageVisibility<'a>, DeviceError> {
    let stages = MethodStages {
        name: NAME,
        hidden_lights: &stages::brickmap_hidden_lights,
        segments: &stages::brickmap_segments,
        rays_per_dispatch: RAYS_PER_DISPATCH,
    };
    StageVisibility::new(
        stages,
        executor,
        &[
            ("parameters of the brickmap", bytemuck::bytes_of(&map.params)),
            ("the brickmap's coarse grid", bytemuck::cast_slice(&map.coarse)),
            ("the brickmap's blocks", bytemuck::cast_slice(&map.blocks)),
            ("the brickmap's bricks", bytemuck::cast_slice(&map.bricks)),
        ],
    )
}
