//! Methods of drawing views by their names.

use super::{OctreeSurfaces, RayCast, ViewError, ViewRenderer};
#[cfg(feature = "bake")]
use super::{Polygons, TriangleSurfaces};
use crate::gpu::GpuContext;
use crate::manylods::{SvoCuts, SvoCutsGpu};
use crate::megaviews::MegaViews;
use crate::megaviews::gpu::MegaViewsGpu;
#[cfg(feature = "bake")]
use crate::reference::Reference;
use manyview_shaders::scene_tree::SceneTree;
use manyview_shaders::svo::Svo;
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

/// A method.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ViewMethod {
    /// The octree against a hierarchy of the views.
    MegaViews,
    /// A cut through the octree for each view.
    ManyLods,
    /// Exact rays through the octree.
    RayCast,
    /// Exact rays through the triangles.
    RayCastTriangles,
    /// All triangles into each view.
    Polygons,
}

impl ViewMethod {
    /// All methods with their names.
    pub const NAMES: [(Self, &'static str); 5] = [
        (Self::MegaViews, "megaviews"),
        (Self::ManyLods, "manylods"),
        (Self::RayCast, "raycast"),
        (Self::RayCastTriangles, "raycast-triangles"),
        (Self::Polygons, "polygons"),
    ];

    /// The name that [`FromStr`] reads.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(method, _)| *method == self).map_or("", |(_, name)| name)
    }

    /// Whether it needs the scene's triangles; others need an octree.
    pub fn needs_triangles(self) -> bool {
        matches!(self, Self::RayCastTriangles | Self::Polygons)
    }

    /// Whether it can run on a GPU.
    pub fn runs_on_gpu(self) -> bool {
        matches!(self, Self::MegaViews | Self::ManyLods)
    }
}

impl fmt::Display for ViewMethod {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for ViewMethod {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::NAMES.iter().find(|(_, name)| *name == text);
        found.map(|(method, _)| *method).ok_or_else(|| {
            let names = Self::NAMES.map(|(_, name)| name);
            format!("there is no method `{text}`; use {}", names.join(", "))
        })
    }
}

/// What methods are made of.
#[derive(Clone, Copy, Default)]
pub struct Ingredients<'a> {
    /// The octree, for methods that need no triangles.
    pub svo: Option<&'a Svo>,
    /// Whether maps shall have colours.
    pub with_colors: bool,
    /// The triangles, for methods that need them.
    #[cfg(feature = "bake")]
    pub reference: Option<&'a Reference<'a>>,
    /// Where methods run that can; without it on the CPU.
    pub gpu: Option<&'a GpuContext>,
}

/// Makes a method.
pub fn renderer<'a>(
    method: ViewMethod,
    ingredients: &Ingredients<'a>,
) -> Result<Box<dyn ViewRenderer + 'a>, ViewError> {
    let missing = |problem| ViewError::Unsupported { method: method.name(), problem };
    let svo = || ingredients.svo.ok_or_else(|| missing("needs an octree: name an archive"));
    Ok(match method {
        ViewMethod::MegaViews | ViewMethod::ManyLods => {
            let scene = SceneTree::new(svo()?, ingredients.with_colors);
            match (method, ingredients.gpu) {
                (ViewMethod::MegaViews, None) => Box::new(MegaViews::new(Arc::new(scene))),
                (ViewMethod::MegaViews, Some(gpu)) => Box::new(MegaViewsGpu::on_gpu(gpu, &scene)?),
                (_, None) => Box::new(SvoCuts::new(Arc::new(scene))),
                (_, Some(gpu)) => Box::new(SvoCutsGpu::on_gpu(gpu, &scene)?),
            }
        }
        ViewMethod::RayCast => Box::new(RayCast::new(OctreeSurfaces::new(svo()?, ingredients.with_colors))),
        #[cfg(feature = "bake")]
        ViewMethod::RayCastTriangles | ViewMethod::Polygons => {
            let reference = ingredients.reference;
            let reference =
                reference.ok_or_else(|| missing("needs triangles: name a scene, not an archive"))?;
            match method {
                ViewMethod::Polygons => Box::new(Polygons::new(reference)),
                _ => Box::new(RayCast::new(TriangleSurfaces::new(reference))),
            }
        }
        #[cfg(not(feature = "bake"))]
        _ => return Err(missing("needs triangles, which only builds with the feature `bake` read")),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_and_written() {
        for (method, name) in ViewMethod::NAMES {
            assert_eq!((name.parse(), method.to_string().as_str()), (Ok(method), name));
        }
        assert!("maps".parse::<ViewMethod>().unwrap_err().contains("raycast-triangles"));
    }

    #[test]
    fn what_a_method_lacks_is_told() {
        for (method, _) in ViewMethod::NAMES {
            let error = renderer(method, &Ingredients::default()).err().unwrap();
            assert!(matches!(error, ViewError::Unsupported { .. }), "{error}");
        }
    }
}
