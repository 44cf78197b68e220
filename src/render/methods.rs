//! The methods of testing segments by name: the one place that makes them.
//!
//! A new method is a variant of [`Method`], a line in its list of names and an arm in [`visibility`]; if it reads an
//! archive, or runs on a GPU alone, [`Method::needs_archive`] and [`Method::needs_gpu`] say so.

use super::scene::RenderScene;
use crate::Archive;
use crate::exact::ExactRays;
use crate::gpu::{GpuContext, GpuScene, StreamOptions, WgpuExecutor};
use crate::manylods::SvoCuts;
use crate::megaviews::MegaViews;
use crate::rays::{self, RowTester, TestSettings};
use crate::rivals::brickmap::{self, BrickmapVisibility};
use crate::rivals::bvh::BvhVisibility;
use crate::rivals::ism::{IsmOptions, IsmVisibility};
use crate::rivals::wide_bvh::WideBvh;
use crate::views::{ViewRenderer, ViewSettings};
use crate::visibility::{Bias, MapVisibility, NoShadows, Visibility};
use manyview_shaders::executor::{Executor, ExecutorLimits};
use manyview_shaders::scene_tree::SceneTree;
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use thiserror::Error;

/// The most GPU memory for the rows of an archive; where they do not fit, fewer directions are kept.
const GPU_BUDGET_BYTES: u64 = 4 << 30;

/// A method of testing segments.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Exact rays over the triangles, on the CPU: the judge of the others.
    RayTrace,
    /// Rows of the archive, on the CPU: the most exact test.
    Rows,
    /// The same, one row a segment.
    RowsFast,
    /// Rows of the archive on a GPU.
    WgslRows,
    /// A compressed wide BVH over the triangles in `f32`, on the CPU.
    Bvh,
    /// The same BVH on a GPU.
    WgslBvh,
    /// Marching through the archive's octree, on the GPU if there is one to use.
    Brickmap,
    /// Imperfect shadow maps, on the CPU.
    Ism,
    /// Maps from octree and lights' hierarchy at once, on the CPU.
    MegaViews,
    /// Maps of a cut through the octree for each light, on the CPU.
    ManyLods,
    /// No shadows at all.
    None,
}

/// What methods are made of; each takes what it needs.
pub struct Ingredients<'a> {
    /// The scene.
    pub scene: &'a RenderScene,
    /// Exact rays over its triangles.
    pub exact: &'a ExactRays<'a>,
    /// Its archive, if the method [needs](Method::needs_archive) one.
    pub archive: Option<&'a Archive>,
    /// A GPU, if one shall be used.
    pub gpu: Option<&'a GpuContext>,
    /// How maps of lights are drawn, by methods that [draw them](Method::draws_maps).
    pub maps: ViewSettings,
}

/// Why a method cannot be made.
#[derive(Debug, Error)]
#[error("--visibility {method}: {source}")]
pub struct MethodError {
    /// Its name.
    pub method: Method,
    /// What is missing or failed.
    pub source: Box<dyn std::error::Error + Send + Sync>,
}

impl Method {
    /// Every method with its name.
    const NAMES: &[(Self, &'static str)] = &[
        (Self::RayTrace, "raytrace"),
        (Self::Rows, "rows"),
        (Self::RowsFast, "rows-fast"),
        (Self::WgslRows, "wgsl-rows"),
        (Self::Bvh, "bvh"),
        (Self::WgslBvh, "wgsl-bvh"),
        (Self::Brickmap, "brickmap"),
        (Self::Ism, "ism"),
        (Self::MegaViews, "megaviews"),
        (Self::ManyLods, "manylods"),
        (Self::None, "none"),
    ];

    /// The name that [`FromStr`] reads.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(method, _)| *method == self).map_or("", |(_, name)| name)
    }

    /// Whether it reads an archive.
    pub fn needs_archive(self) -> bool {
        self.needs_rows() || matches!(self, Self::Brickmap | Self::MegaViews | Self::ManyLods)
    }

    /// Whether it reads an archive's rows.
    pub fn needs_rows(self) -> bool {
        matches!(self, Self::Rows | Self::RowsFast | Self::WgslRows)
    }

    /// Whether it draws a map for each light, and so answers for lights only, not for segments.
    pub fn draws_maps(self) -> bool {
        matches!(self, Self::Ism | Self::MegaViews | Self::ManyLods)
    }

    /// Whether it runs on a GPU alone, be it a software one.
    pub fn needs_gpu(self) -> bool {
        matches!(self, Self::WgslBvh | Self::WgslRows)
    }
}

impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Method {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::NAMES.iter().find(|(_, name)| *name == text);
        found.map(|(method, _)| *method).ok_or_else(|| {
            let names: Vec<_> = Self::NAMES.iter().map(|(_, name)| *name).collect();
            format!("there is no method `{text}`; use {}", names.join(", "))
        })
    }
}

/// Makes a method.
pub fn visibility<'a>(
    method: Method,
    ingredients: &Ingredients<'a>,
) -> Result<Box<dyn Visibility + 'a>, MethodError> {
    make(method, ingredients).map_err(|source| MethodError { method, source })
}

/// What draws the maps of a method that [draws them](Method::draws_maps), and the bias of receivers against them.
pub fn map_renderer<'a>(
    method: Method,
    ingredients: &Ingredients<'a>,
) -> Result<(Box<dyn ViewRenderer + 'a>, Bias), MethodError> {
    make_renderer(method, ingredients).map_err(|source| MethodError { method, source })
}

fn make_renderer<'a>(
    method: Method,
    ingredients: &Ingredients<'a>,
) -> Result<(Box<dyn ViewRenderer + 'a>, Bias), Failure> {
    let tree = || -> Result<Arc<SceneTree>, Failure> {
        let archive = ingredients.archive.ok_or("it reads an archive: give one")?;
        Ok(Arc::new(SceneTree::new(&archive.svo()?, false)))
    };
    Ok(match method {
        Method::Ism => {
            let options = IsmOptions { resolution: ingredients.maps.resolution, ..IsmOptions::default() };
            // It has no voxels; points on a light's own surface must not hide what it lights.
            let bias = Bias::new(ingredients.scene.extent() as f32 / 1024.0);
            (Box::new(IsmVisibility::new(ingredients.exact.reference(), options)), bias)
        }
        Method::MegaViews | Method::ManyLods => {
            let tree = tree()?;
            let bias = Bias::new(tree.voxel_size());
            match method {
                Method::MegaViews => (Box::new(MegaViews::new(tree)), bias),
                _ => (Box::new(SvoCuts::new(tree)), bias),
            }
        }
        _ => return Err("it draws no maps".into()),
    })
}

type Failure = Box<dyn std::error::Error + Send + Sync>;

fn make<'a>(method: Method, ingredients: &Ingredients<'a>) -> Result<Box<dyn Visibility + 'a>, Failure> {
    let reference = ingredients.exact.reference();
    let archive = || ingredients.archive.ok_or("it reads an archive: give one");
    let executor = |context: &'a GpuContext| -> Box<dyn Executor + Send + 'a> {
        Box::new(WgpuExecutor::new(context, ExecutorLimits::DEFAULT))
    };
    Ok(match method {
        Method::RayTrace => Box::new(ingredients.exact),
        Method::Rows => Box::new(RowTester::load(archive()?)?),
        Method::RowsFast => Box::new(RowTester::load(archive()?)?.with_settings(TestSettings::FAST)),
        Method::WgslRows => {
            let context = ingredients.gpu.ok_or("it runs on a GPU; use rows without one")?;
            let options = StreamOptions::new(GPU_BUDGET_BYTES).with_octree_bytes(0);
            let scene = GpuScene::stream(context.device(), context.queue(), archive()?, options)?;
            scene.finish()?;
            Box::new(rays::on_gpu(context, &scene, &TestSettings::default())?)
        }
        Method::Bvh => Box::new(BvhVisibility::new(reference)),
        Method::WgslBvh => {
            let context = ingredients.gpu.ok_or("it runs on a GPU; use bvh without one")?;
            Box::new(WideBvh::new(reference).on_executor(executor(context))?)
        }
        Method::Brickmap => {
            let map = brickmap::from_svo(&archive()?.svo()?, u32::MAX, brickmap::DEFAULT_BIAS);
            match ingredients.gpu {
                Some(context) => Box::new(brickmap::on_executor(&map, executor(context))?),
                None => Box::new(BrickmapVisibility::new(map)),
            }
        }
        Method::Ism => Box::new(IsmVisibility::new(reference, IsmOptions::default())),
        Method::MegaViews | Method::ManyLods => {
            let (renderer, bias) = make_renderer(method, ingredients)?;
            Box::new(MapVisibility::new(renderer, ingredients.maps, bias))
        }
        Method::None => Box::new(NoShadows),
    })
}
