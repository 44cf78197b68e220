//! glTF 2.0 in: `.glb` and `.gltf` files become a [`Scene`].
//!
//! Files are hostile until proven otherwise. The JSON is read through a cursor (`json`) that checks just what the bake
//! needs and names the place of what is wrong; buffers, images and buffer views are read only when something that is
//! drawn refers to them (`resources`), so broken parts that nothing needs do no harm; and memory is counted against a
//! limit before it is allocated.
//!
//! | module | what it knows |
//! |---|---|
//! | `container`, `uri`, `resources` | where bytes come from |
//! | `meshopt`, `draco` | packed buffer views and primitives |
//! | `accessor` | bytes as numbers |
//! | `animation`, `nodes`, `instancing` | where things are at the time asked for |
//! | `geometry`, `deform` | triangles and attributes, morph targets, skins |
//! | `materials`, `textures`, `lights` | the rest of what is kept |
//! | `assemble` | the walk over the scene's nodes |
//! | `extensions` | which required extensions are taken |

mod accessor;
mod animation;
mod assemble;
mod container;
mod deform;
mod draco;
mod error;
mod extensions;
mod geometry;
mod instancing;
mod json;
mod lights;
mod materials;
mod meshopt;
mod nodes;
mod read_file;
mod resources;
#[cfg(test)]
mod tests;
mod textures;
mod uri;

pub use error::ImportError;

use crate::scene::Scene;
use json::Json;
use resources::Resources;
use std::path::Path;

/// How to import a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportOptions {
    /// URIs may leave the scene's folder.
    pub allow_outside: bool,
    /// Time of the animation, or `None` for the rest pose: nodes and weights as the file has them, skins applied.
    pub time_seconds: Option<f64>,
    /// Which animation the time belongs to.
    pub animation: usize,
    /// Most triangles drawn, instances counted.
    pub max_triangles: u64,
    /// Most memory that files, attributes and textures may take together.
    pub max_memory_bytes: u64,
}

impl Default for ImportOptions {
    /// The rest pose, within the scene's folder, up to 2^32 triangles and 8 GiB.
    fn default() -> Self {
        Self {
            allow_outside: false,
            time_seconds: None,
            animation: 0,
            max_triangles: 1 << 32,
            max_memory_bytes: 8 << 30,
        }
    }
}

/// A file that the import depends on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SourceFile {
    /// Path from the scene's folder, with `/` between names.
    pub path: String,
    /// BLAKE3 of its content, or `None` for an image that is missing.
    pub hash: Option<blake3::Hash>,
}

/// An imported scene and the files that it came from.
#[derive(Debug, Clone, PartialEq)]
pub struct Imported {
    /// The scene; without instances if nothing is drawn.
    pub scene: Scene,
    /// Every file that was read or looked for: the scene file first, then the others by path.
    pub files: Vec<SourceFile>,
}

/// Imports the glTF scene at `path`.
pub fn import(path: &Path, options: &ImportOptions) -> Result<Imported, ImportError> {
    let file = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
    let unreadable = |source| ImportError::Unreadable {
        file: file.clone(),
        path: path.to_owned(),
        place: "the scene".to_owned(),
        source,
    };
    let metadata = fs_err::metadata(path).map_err(unreadable)?;
    if !metadata.is_file() {
        return Err(unreadable(std::io::Error::other(format!("`{}` is no regular file", path.display()))));
    }
    if metadata.len() > options.max_memory_bytes {
        return Err(ImportError::OverLimit {
            file,
            place: "the scene file".to_owned(),
            what: "bytes",
            value: metadata.len(),
            limit: options.max_memory_bytes,
            fix: "raise the memory limit",
        });
    }
    let bytes = read_file::read_unchanged(path).map_err(unreadable)?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    import_bytes(&file, &bytes, folder, options)
}

/// Imports a scene whose file holds `bytes`. The name of the `file` is for messages; relative URIs start at `folder`.
pub fn import_bytes(
    file: &str,
    bytes: &[u8],
    folder: &Path,
    options: &ImportOptions,
) -> Result<Imported, ImportError> {
    let container = container::split(file, bytes)?;
    let value = serde_json::from_slice(&bytes[container.json.clone()]).map_err(|error| {
        let (line, column, text) = (error.line(), error.column(), error.to_string());
        ImportError::Malformed {
            file: file.to_owned(),
            place: format!("JSON line {line}, column {column}"),
            rule: text.rsplit_once(" at line ").map_or(text.as_str(), |(rule, _)| rule).to_owned(),
        }
    })?;
    let root = Json::root(file, &value);
    extensions::check(&root, options.time_seconds.is_some())?;
    let bin = container.bin.map(|range| &bytes[range]);
    let resources = Resources::new(root, folder, bin, options)?;
    resources.charge(bytes.len() as u64, "the scene file")?;
    let mut scene = assemble::assemble(&resources, options)?;
    let (others, warnings) = resources.finish();
    scene.warnings = warnings;
    for warning in &scene.warnings {
        // Whoever called shows them; here they only help to find where a bake goes wrong.
        tracing::debug!("{file}: {warning}");
    }
    let mut files = vec![SourceFile { hash: Some(blake3::hash(bytes)), path: file.to_owned() }];
    files.extend(others);
    Ok(Imported { scene, files })
}
