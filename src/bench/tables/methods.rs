//! The methods that tables compare.

use super::subject::{Subject, bake_rows};
use crate::bench::{BenchError, BenchScene};
use crate::gpu::{GpuContext, GpuScene, StreamOptions, WgpuExecutor};
use crate::rays::paper::PaperRows;
use crate::rays::{self, RowTester, TestSettings};
use crate::rivals::brickmap::{self, BrickmapVisibility};
use crate::rivals::bvh::BvhVisibility;
use crate::rivals::ism::{IsmOptions, IsmVisibility};
use crate::rivals::wide_bvh::WideBvh;
use crate::visibility::Visibility;
use manyview_pipeline::rows::{RowsOptions, RowsPlan};
use manyview_shaders::brickmap::Brickmap;
use manyview_shaders::device::DeviceError;
use manyview_shaders::directions::{DirectionFrame, Fit};
use manyview_shaders::executor::ExecutorLimits;
use rayon::prelude::*;
use std::sync::Arc;
use std::time::Instant;

/// A method that was made for a scene.
pub struct Method<'a> {
    /// Answers.
    pub visibility: Box<dyn Visibility + 'a>,
    /// Memory that it answers from, bytes.
    pub bytes: u64,
    /// Time to make it from the scene, seconds.
    pub prepare_seconds: f64,
}

/// Makes methods by name.
pub trait MethodSource: Sync {
    /// All names, ours first.
    fn names(&self) -> Vec<&'static str>;

    /// Makes a method for a subject. `rows` are the settings of methods that work by rows.
    fn make<'a>(
        &'a self,
        name: &str,
        subject: &'a Subject<'_>,
        rows: RowsOptions,
    ) -> Result<Method<'a>, BenchError>;
}

/// The methods of this library.
///
/// | name | what it is |
/// |---|---|
/// | `rows` | rows with the settings asked for, the most exact test |
/// | `rows-fast` | the same, one row a segment |
/// | `rows-paper` | the paper's test in the paper's grid, one cube around the bounding sphere |
/// | `brickmap` | marching through the octree's cells |
/// | `ism` | imperfect shadow maps |
/// | `bvh` | ray tracing with a compressed wide BVH |
/// | `wgsl-rows`, `wgsl-rows-fast`, `wgsl-brickmap`, `wgsl-bvh` | the same on a GPU, if there is one |
#[derive(Debug, Default)]
pub struct OurMethods {
    /// Where methods on a GPU run.
    pub gpu: Option<GpuContext>,
}

impl OurMethods {
    fn context(&self) -> Result<&GpuContext, DeviceError> {
        self.gpu.as_ref().ok_or_else(|| DeviceError::Failed("there is no GPU to run it on".to_owned()))
    }

    fn executor(&self) -> Result<Box<WgpuExecutor<'_>>, DeviceError> {
        Ok(Box::new(WgpuExecutor::new(self.context()?, ExecutorLimits::DEFAULT)))
    }
}

impl MethodSource for OurMethods {
    fn names(&self) -> Vec<&'static str> {
        let mut names = vec!["rows", "rows-fast", "rows-paper", "brickmap", "ism", "bvh"];
        if self.gpu.is_some() {
            names.extend(["wgsl-rows", "wgsl-rows-fast", "wgsl-brickmap", "wgsl-bvh"]);
        }
        names
    }

    fn make<'a>(
        &'a self,
        name: &str,
        subject: &'a Subject<'_>,
        rows: RowsOptions,
    ) -> Result<Method<'a>, BenchError> {
        let begun = Instant::now();
        let failed =
            |source: DeviceError| BenchError::Method { method: name.to_owned(), source: source.into() };
        let reference = subject.judge.reference();
        let (visibility, bytes): (Box<dyn Visibility + 'a>, u64) = match name {
            "rows" | "rows-fast" => {
                let settings = if name == "rows" { TestSettings::EXACT } else { TestSettings::FAST };
                let tester = row_tester_of(subject.scene, rows).with_settings(settings);
                (Box::new(tester), rows_bytes(&rows))
            }
            "rows-paper" => {
                let rows = RowsOptions { fit: Fit::Cube, ..rows };
                let (frames, words) = rows_of(subject.scene, rows);
                let RowsOptions { directions, bits, .. } = rows;
                let lattice = subject.scene.lattice;
                let paper = PaperRows::new(directions, lattice, bits, Arc::new(frames), Arc::new(words));
                (Box::new(paper), rows_bytes(&rows))
            }
            "wgsl-rows" | "wgsl-rows-fast" => {
                let settings = if name == "wgsl-rows" { TestSettings::EXACT } else { TestSettings::FAST };
                let context = self.context().map_err(failed)?;
                let archive = bake_rows(subject.scene, rows)?;
                let options = StreamOptions::new(u64::MAX).with_octree_bytes(0);
                let scene = GpuScene::stream(context.device(), context.queue(), &archive, options)
                    .map_err(|error| failed(DeviceError::Failed(error.to_string())))?;
                scene.finish().map_err(|error| failed(DeviceError::Failed(error.to_string())))?;
                let made = rays::on_gpu(context, &scene, &settings)
                    .map_err(|source| BenchError::Method { method: name.to_owned(), source })?;
                (Box::new(made), scene.gpu_bytes())
            }
            "brickmap" => {
                let map = brickmap_of(subject)?;
                let bytes = brickmap_bytes(&map);
                (Box::new(BrickmapVisibility::new(map)), bytes)
            }
            "wgsl-brickmap" => {
                let map = brickmap_of(subject)?;
                let made = brickmap::on_executor(&map, self.executor().map_err(failed)?).map_err(failed)?;
                (Box::new(made), brickmap_bytes(&map))
            }
            "ism" => {
                let ism = IsmVisibility::new(reference, IsmOptions::default());
                (Box::new(ism), 0)
            }
            "bvh" => {
                // A node of 80 bytes for about three triangles of 48 bytes.
                let bytes = reference.triangles().len() as u64 * (80 / 3 + 48);
                (Box::new(BvhVisibility::new(reference)), bytes)
            }
            "wgsl-bvh" => {
                let bvh = WideBvh::new(reference);
                let made = bvh.on_executor(self.executor().map_err(failed)?).map_err(failed)?;
                (Box::new(made), bvh.bytes())
            }
            _ => {
                let known = self.names().join(", ");
                return Err(BenchError::NoSuchMethod { name: name.to_owned(), known });
            }
        };
        Ok(Method { visibility, bytes, prepare_seconds: begun.elapsed().as_secs_f64() })
    }
}

fn brickmap_of(subject: &Subject<'_>) -> Result<Brickmap, BenchError> {
    let load = |error| BenchError::Load { scene: subject.scene.name.clone(), source: Box::new(error) };
    let svo = subject.archive.svo().map_err(load)?;
    Ok(brickmap::from_svo(&svo, u32::MAX, brickmap::DEFAULT_BIAS))
}

fn brickmap_bytes(map: &Brickmap) -> u64 {
    let bytes = size_of_val(&map.coarse[..]) + size_of_val(&map.blocks[..]) + size_of_val(&map.bricks[..]);
    bytes as u64
}

fn rows_bytes(rows: &RowsOptions) -> u64 {
    u64::from(rows.directions.count()) << (3 * rows.bits - 3)
}

/// Rows in memory, ready for tests.
pub(super) fn row_tester_of(scene: &BenchScene, options: RowsOptions) -> RowTester {
    let (frames, rows) = rows_of(scene, options);
    RowTester::new(options.directions, scene.lattice, options.bits, &frames, Arc::new(rows))
}

/// Voxelizes all directions in memory.
fn rows_of(scene: &BenchScene, options: RowsOptions) -> (Vec<DirectionFrame>, Vec<u32>) {
    let plan = RowsPlan::new(options, scene.lattice, &scene.row_triangles, &scene.cutouts);
    let words = 1usize << (3 * options.bits - 5);
    let mut rows = vec![0; words * plan.frames.len()];
    rows.par_chunks_mut(words)
        .zip(&plan.frames)
        .for_each(|(rows, frame)| rows.copy_from_slice(&plan.block(std::slice::from_ref(frame))));
    (plan.frames.clone(), rows)
}
