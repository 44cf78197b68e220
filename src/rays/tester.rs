use super::kernel::{self, LANES, View};
use super::{Rows, TestSettings};
use crate::archive::{Archive, LoadError};
use crate::scene_cpu::CpuScene;
use crate::simd::SimdLevel;
use crate::visibility::{LightPoint, Receiver, Segment, Visibility, VisibilityError, light_words};
use manyview_shaders::direction_table::DirectionTable;
use manyview_shaders::directions::{DirectionFrame, DirectionSet, RowLattice};
use manyview_shaders::row_test::{RowTestParams, TestFrame};
use rayon::prelude::*;
use std::sync::Arc;

/// Receivers that one task tests; a multiple of [`LANES`].
const TASK_RECEIVERS: usize = 16 * LANES;
/// Segments that one task tests.
const TASK_SEGMENTS: usize = 1 << 14;

/// The rows of a bake, ready for tests on the CPU. Clones share the rows.
#[derive(Debug, Clone)]
pub struct RowTester {
    lattice: RowLattice,
    bits: u32,
    params: RowTestParams,
    settings: TestSettings,
    frames: Vec<TestFrame>,
    table: DirectionTable,
    level: SimdLevel,
    rows: Arc<Vec<u32>>,
}

impl RowTester {
    /// Loads all rows of a bake.
    pub fn load(archive: &Archive) -> Result<Self, LoadError> {
        Ok(Self::of(&CpuScene::load(archive)?))
    }

    /// Tests against a scene in memory; its rows are shared.
    pub fn of(scene: &CpuScene) -> Self {
        let rows = Arc::clone(scene.words());
        Self::new(scene.direction_set(), scene.row_lattice(), scene.rows_info().bits, scene.frames(), rows)
    }
    /// Takes the rows of all directions of `set`, `2^bits` voxels a side, layout of `rows.bits`
    /// ([`manyview_shaders::sections`]).
    ///
    /// # Panics
    /// If there are fewer frames or rows than directions, or more than 65,536 directions.
    pub fn new(
        set: DirectionSet,
        lattice: RowLattice,
        bits: u32,
        frames: &[DirectionFrame],
        rows: Arc<Vec<u32>>,
    ) -> Self {
        assert!(frames.len() >= set.count() as usize, "one frame per direction");
        assert!(rows.len() >= (set.count() as usize) << (3 * bits - 5), "rows of every direction");
        assert!(set.count() <= 1 << 16, "at most 65,536 directions");
        let settings = TestSettings::default();
        Self {
            lattice,
            bits,
            params: RowTestParams::new(&lattice, bits, &settings),
            settings,
            frames: frames.iter().map(|frame| TestFrame::new(frame, &lattice)).collect(),
            table: DirectionTable::new(set, |direction| direction),
            level: SimdLevel::detect(),
            rows,
        }
    }

    /// Tests with other settings.
    #[must_use]
    pub fn with_settings(mut self, settings: TestSettings) -> Self {
        self.settings = settings;
        self.params = RowTestParams::new(&self.lattice, self.bits, &settings);
        self
    }

    /// Uses no better instructions than these; the answers stay the same.
    #[must_use]
    pub fn with_simd(mut self, level: SimdLevel) -> Self {
        self.level = level.min(SimdLevel::detect());
        self
    }

    /// How segments are tested.
    pub fn settings(&self) -> &TestSettings {
        &self.settings
    }

    fn view(&self) -> View<'_> {
        View { params: &self.params, frames: &self.frames, table: &self.table.directions, rows: &self.rows }
    }

    /// Indices of segments in the order of their directions: neighbours share frames and rows.
    fn order(&self, segments: &[Segment]) -> Vec<u32> {
        let mut cells = vec![0; segments.len()];
        kernel::cells(self.level, segments, &mut cells);
        let mut keyed: Vec<u64> = (0u32..)
            .zip(&cells)
            .map(|(i, &cell)| u64::from(self.table.directions[cell as usize]) << 32 | u64::from(i))
            .collect();
        keyed.sort_unstable();
        keyed.into_iter().map(|key| key as u32).collect()
    }
}

impl Visibility for RowTester {
    fn name(&self) -> &'static str {
        match (self.settings.rows, self.settings.consensus) {
            (Rows::Single, false) => "rows-fast",
            _ => "rows",
        }
    }

    fn occluded(&self, segments: &[Segment], occluded: &mut [u8]) -> Result<(), VisibilityError> {
        assert_eq!(segments.len(), occluded.len(), "one answer per segment");
        segments.par_chunks(TASK_SEGMENTS).zip(occluded.par_chunks_mut(TASK_SEGMENTS)).for_each(
            |(segments, occluded)| {
                let order = self.order(segments);
                kernel::occluded(self.level, &self.view(), segments, &order, &mut |index, hit| {
                    occluded[index as usize] = u8::from(hit);
                });
            },
        );
        Ok(())
    }

    fn distances(&self, segments: &[Segment], distances: &mut [f32]) -> Result<(), VisibilityError> {
        assert_eq!(segments.len(), distances.len(), "one answer per segment");
        segments.par_chunks(TASK_SEGMENTS).zip(distances.par_chunks_mut(TASK_SEGMENTS)).for_each(
            |(segments, distances)| {
                let order = self.order(segments);
                kernel::distances(self.level, &self.view(), segments, &order, &mut |index, distance| {
                    distances[index as usize] = distance;
                });
            },
        );
        Ok(())
    }

    fn hidden_lights(
        &self,
        receivers: &[Receiver],
        lights: &[LightPoint],
        hidden: &mut [u32],
    ) -> Result<(), VisibilityError> {
        let words = light_words(lights.len());
        assert_eq!(hidden.len(), receivers.len() * words, "one bit for each receiver and light");
        if words == 0 {
            return Ok(());
        }
        receivers.par_chunks(TASK_RECEIVERS).zip(hidden.par_chunks_mut(TASK_RECEIVERS * words)).for_each(
            |(receivers, hidden)| {
                kernel::hidden_lights(self.level, &self.view(), receivers, lights, hidden);
            },
        );
        Ok(())
    }
}
