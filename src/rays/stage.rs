use super::TestSettings;
use crate::gpu::{GpuContext, GpuScene, WgpuExecutor};
use crate::scene_cpu::CpuScene;
use crate::visibility::{MethodStages, StageVisibility, VisibilityError};
use manyview_shaders::device::DeviceError;
use manyview_shaders::direction_table::{DirectionTable, packed_cells};
use manyview_shaders::directions::{DirectionFrame, DirectionSet, RowLattice};
use manyview_shaders::executor::{Binding, CpuExecutor, Executor, ExecutorLimits, Recording};
use manyview_shaders::row_test::{PackedFrame, RowTestParams, TestFrame};
use manyview_shaders::rows_texture::RowsTexture;
use manyview_shaders::stages;

/// Rays of one dispatch.
const RAYS_PER_DISPATCH: u64 = 1 << 27;

const STAGES: MethodStages = MethodStages {
    name: "wgsl-rows",
    hidden_lights: &stages::rows_hidden_lights,
    segments: &stages::rows_segments,
    rays_per_dispatch: RAYS_PER_DISPATCH,
};

/// Segment tests on the GPU against a scene that is there, or still arriving. `context` is of the scene's device:
/// [`GpuScene::context`], or the caller's own.
pub fn on_gpu<'a>(
    context: &'a GpuContext,
    scene: &GpuScene,
    settings: &TestSettings,
) -> Result<StageVisibility<'a>, VisibilityError> {
    let mut executor = WgpuExecutor::new(context, ExecutorLimits::DEFAULT);
    let tiles = executor.share_buffer(scene.tile_table());
    let rows = executor.share_rows(scene.rows_view());
    let tables =
        RowTables::new(scene.direction_set(), &scene.row_lattice(), scene.layout(), scene.frames(), settings);
    let bindings = tables.bindings(&mut executor, tiles.into(), rows.into())?;
    Ok(StageVisibility::with_bindings(STAGES, Box::new(executor), bindings))
}

/// The same by the twins of the stages, one thread: to find out which stage goes wrong.
pub fn on_twins(
    scene: &CpuScene,
    settings: &TestSettings,
) -> Result<StageVisibility<'static>, VisibilityError> {
    let image = scene.rows_image().map_err(|error| DeviceError::Failed(error.to_string()))?;
    let layout = *image.layout();
    let mut executor = CpuExecutor::default();
    let every: Vec<u32> = (0..layout.directions()).collect();
    let tiles = executor.buffer("tile table", 4 * u64::from(layout.directions()))?;
    let mut recording = Recording::new();
    recording.upload(tiles, &every);
    executor.run(&recording)?;
    let rows = executor.share_rows(image);
    let tables =
        RowTables::new(scene.direction_set(), &scene.row_lattice(), &layout, scene.frames(), settings);
    let bindings = tables.bindings(&mut executor, tiles.into(), rows.into())?;
    Ok(StageVisibility::with_bindings(STAGES, Box::new(executor), bindings))
}

/// What `lib_rows.wgsl` reads beside the rows texture and the tile table.
#[derive(Debug, Clone)]
pub struct RowTables {
    /// Binding 0: a uniform buffer.
    pub params: RowTestParams,
    /// Binding 1: for each cell of the direction table the direction, two cells a word.
    pub cells: Vec<u32>,
    /// Binding 3: one frame a tile.
    pub frames: Vec<PackedFrame>,
}

impl RowTables {
    /// For the tiles of `layout`, whose frames are `frames`.
    pub fn new(
        set: DirectionSet,
        lattice: &RowLattice,
        layout: &RowsTexture,
        frames: &[DirectionFrame],
        settings: &TestSettings,
    ) -> Self {
        let with_corner = |(tile, frame): (u32, &DirectionFrame)| {
            TestFrame::new(frame, lattice).packed(layout.tile_origin(tile))
        };
        Self {
            params: RowTestParams::new(lattice, layout.bits(), settings),
            cells: packed_cells(&DirectionTable::new(set, |direction| direction).directions),
            frames: (0..).zip(frames).map(with_corner).collect(),
        }
    }

    fn bindings(
        &self,
        executor: &mut dyn Executor,
        tiles: Binding,
        rows: Binding,
    ) -> Result<Vec<Binding>, DeviceError> {
        let params = executor.buffer("row test parameters", size_of::<RowTestParams>() as u64)?;
        let cells = executor.buffer("direction table", size_of_val(&*self.cells) as u64)?;
        let frames = executor.buffer("row test frames", size_of_val(&*self.frames) as u64)?;
        let params_bytes = [self.params];
        let mut recording = Recording::new();
        recording.upload(params, &params_bytes);
        recording.upload(cells, &self.cells);
        recording.upload(frames, &self.frames);
        executor.run(&recording)?;
        Ok(vec![params.into(), cells.into(), tiles, frames.into(), rows])
    }
}
