//! What the last bake of an output was made from, kept in the store only to say why the next one differs.
//!
//! Nothing that is reused is looked up by it: the keys of steps decide. A bake without a journal is as fast.

use crate::bake::BakeOptions;
use crate::cube::SceneCube;
use crate::import::SourceFile;
use crate::runs::Runs;
use crate::scene::Scene;
use crate::sections;
use crate::steps::{LATEST, Steps, step_key};
use manyview_cache::digest::{Digest, KeyEncoder};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// See the module.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Journal {
    /// Files by their path from the scene's folder; `None` for one that was missing.
    pub files: BTreeMap<String, Option<String>>,
    /// Parameters as people write them.
    pub parameters: BTreeMap<String, String>,
    /// Origin and edge of the scene cube, metres.
    pub cube: ([f64; 3], f64),
    /// World bounds of the scene, metres.
    pub bounds: [[f64; 3]; 2],
    /// Digest of the lights as the archive has them.
    pub lights: String,
    /// The drawn instances.
    pub objects: Vec<Object>,
}

/// An instance of a mesh.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Object {
    /// The mesh's name in the file.
    pub name: String,
    /// Identity of the mesh's shape, wherever it is.
    pub mesh: String,
    /// Identity of its shape where it is.
    pub shape: String,
    /// Identity of shape and look where it is.
    pub look: String,
    /// Where its origin is, metres.
    pub place: [f64; 3],
    /// Its world bounds, metres.
    pub bounds: [[f64; 3]; 2],
}

/// Enough of a digest to tell two apart in a message.
pub(crate) fn short(digest: &Digest) -> String {
    digest.to_string()[..16].to_owned()
}

fn journal_key(output: &Path) -> Digest {
    let folder = output.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let folder = fs_err::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
    let name = output.file_name().unwrap_or_default();
    step_key("journal", 1).text(&folder.join(name).to_string_lossy()).finish()
}

/// Every parameter that shows in an archive, as people write it.
pub(crate) fn parameters(options: &BakeOptions) -> BTreeMap<String, String> {
    let mut parameters = BTreeMap::from([("--levels".to_owned(), options.levels.to_string())]);
    let cube = options.cube.map_or("fitted".to_owned(), |SceneCube { origin: [x, y, z], size }| {
        format!("{size} m from ({x}, {y}, {z})")
    });
    parameters.insert("cube".to_owned(), cube);
    let rows = options.rows.map_or(0, |rows| 1 << rows.bits);
    parameters.insert("--rows".to_owned(), rows.to_string());
    if let Some(rows) = &options.rows {
        parameters.insert("--directions".to_owned(), rows.directions.to_string());
        parameters.insert("--grid".to_owned(), format!("{:?}", rows.fit).to_lowercase());
        parameters.insert("--rows-from".to_owned(), rows.from.to_string());
    }
    parameters
}

impl Journal {
    /// Notes what a bake is made from.
    pub(crate) fn new(
        scene: &Scene,
        runs: &Runs,
        files: &[SourceFile],
        options: &BakeOptions,
        cube: SceneCube,
    ) -> Self {
        let (min, max) = runs.bounds().unwrap_or_default();
        let hash = |file: &SourceFile| file.hash.map(|hash| hash.to_hex()[..16].to_owned());
        Self {
            files: files.iter().map(|file| (file.path.clone(), hash(file))).collect(),
            parameters: parameters(options),
            cube: (cube.origin, cube.size),
            bounds: [min.to_array(), max.to_array()],
            lights: short(&Digest::of(bytemuck::cast_slice(&sections::lights(scene)))),
            objects: objects(scene, runs),
        }
    }

    pub(crate) fn find(steps: &Steps, output: &Path) -> Option<Self> {
        steps.find(LATEST, &journal_key(output), |value| serde_json::from_slice(value).ok())
    }

    pub(crate) fn keep(&self, steps: &Steps, output: &Path) {
        if let Ok(value) = serde_json::to_vec(self) {
            steps.keep(LATEST, journal_key(output), value, None);
        }
    }
}

fn objects(scene: &Scene, runs: &Runs) -> Vec<Object> {
    runs.runs
        .chunk_by(|a, b| a.instance == b.instance)
        .map(|runs| {
            let instance = &scene.instances[runs[0].instance as usize];
            let joined = |of: &dyn Fn(&crate::runs::Run) -> Digest| {
                let mut key = KeyEncoder::new("manyview.object");
                runs.iter().for_each(|run| _ = key.digest(&of(run)));
                short(&key.finish())
            };
            let bounds = runs
                .iter()
                .map(|run| run.bounds)
                .fold(runs[0].bounds, |a, b| [a[0].min(b[0]), a[1].max(b[1])]);
            Object {
                name: scene.meshes[instance.mesh as usize].name.clone(),
                mesh: joined(&|run| run.mesh),
                shape: joined(&|run| run.shape),
                look: joined(&|run| run.look),
                place: instance.world_from_object.w_axis.truncate().to_array(),
                bounds: bounds.map(|corner| corner.to_array()),
            }
        })
        .collect()
}
