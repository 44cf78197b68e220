//! The methods of testing segments by name: the one place that makes them.
//!
//! A new method is a variant of [`Method`], a line in its list of names and an arm in [`visibility`]; if it reads an
//! archive, [`Method::needs_archive`] says so.

use super::scene::RenderScene;
use crate::Archive;
use crate::exact::ExactRays;
use crate::gpu::GpuContext;
use crate::visibility::Visibility;
use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// A method of testing segments.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Exact rays over the triangles, on the CPU.
    RayTrace,
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
    /// Every method with its name; of several names for one the first is its own.
    const NAMES: &[(Self, &'static str)] = &[(Self::RayTrace, "raytrace"), (Self::RayTrace, "bvh")];

    /// The name that [`FromStr`] reads.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(method, _)| *method == self).map_or("", |(_, name)| name)
    }

    /// Whether it reads an archive.
    pub fn needs_archive(self) -> bool {
        match self {
            Self::RayTrace => false,
        }
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
    match method {
        Method::RayTrace => Ok(Box::new(ingredients.exact)),
    }
}
