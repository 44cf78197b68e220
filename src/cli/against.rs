//! Whether an archive is what its scene bakes to now: `manyview verify --against`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use manyview::Archive;
use manyview_cache::archive::ArchiveWriter;
use manyview_pipeline::bake::{BakeError, BakeOptions, RowsFrom, bake};
use manyview_pipeline::cube::SceneCube;
use manyview_pipeline::import::{ImportOptions, import};
use manyview_pipeline::rows::RowsOptions;
use manyview_pipeline::run::RunError;
use manyview_pipeline::scene::Scene;
use manyview_shaders::directions::Fit;
use serde_json::{Value, json};

use super::Format;
use super::bake::memory_size;
use super::cancel;
use super::diff::{State, section_states};
use super::error::CliError;
use super::output::counted;
use super::progress::Progress;

/// How to bake the scene again. What the archive does not tell has to be given as it was given to `bake`.
#[derive(Debug, clap::Args)]
pub(crate) struct Against {
    /// Bake this scene again with the archive's settings, and say which sections differ
    #[arg(long, value_name = "SCENE")]
    against: Option<PathBuf>,
    /// Seconds into the scene's first animation, as given to `bake`
    #[arg(long, value_name = "SECONDS", requires = "against")]
    time: Option<f64>,
    /// Let the scene's URIs leave its folder
    #[arg(long, requires = "against")]
    allow_outside: bool,
    /// Most memory to plan for when baking again
    #[arg(long, value_name = "SIZE", requires = "against", default_value = "8GiB", value_parser = memory_size)]
    max_memory: u64,
}

/// How an archive and a new bake of the scene compare.
pub(crate) struct Comparison {
    scene: PathBuf,
    sections: usize,
    /// Names of sections with their items that differ.
    differing: BTreeMap<String, Vec<u32>>,
}

impl Comparison {
    /// Whether all sections are the same.
    pub(crate) fn is_same(&self) -> bool {
        self.differing.is_empty()
    }

    /// What was found, in one line.
    pub(crate) fn text(&self) -> String {
        let scene = self.scene.display();
        let sections = counted(self.sections as u64, "section");
        if self.is_same() {
            return format!("same as a new bake of {scene}: all of {sections}");
        }
        let names: Vec<String> =
            self.differing.iter().map(|(name, items)| format!("{name} {items:?}")).collect();
        format!("differs from a new bake of {scene} in: {}", names.join(", "))
    }

    /// What was found, for programs.
    pub(crate) fn json(&self) -> Value {
        json!({
            "scene": self.scene.display().to_string(),
            "same": self.is_same(),
            "sections": self.sections,
            "differing": self.differing,
        })
    }
}

/// Bakes the scene again and compares, if asked to.
pub(crate) fn compare(
    archive: &Archive,
    options: &Against,
    format: Format,
) -> Result<Option<Comparison>, CliError> {
    let Some(path) = &options.against else { return Ok(None) };
    if options.time.is_some_and(|t| !t.is_finite()) {
        return Err(CliError::usage("--time must be a finite number of seconds"));
    }
    let import_options = ImportOptions {
        allow_outside: options.allow_outside,
        time_seconds: options.time,
        max_memory_bytes: options.max_memory,
        ..ImportOptions::default()
    };
    let scene = import(path, &import_options).map_err(RunError::from)?.scene;
    let mut settings = settings_of(archive);
    settings.max_memory_bytes = options.max_memory;
    let again = bake_again(path, &scene, settings, format)?;
    let mut differing = BTreeMap::<String, Vec<u32>>::new();
    let states = section_states(archive, &again);
    for (id, _) in states.iter().filter(|(_, state)| **state != State::Same) {
        differing.entry(id.name.to_string()).or_default().push(id.item);
    }
    Ok(Some(Comparison { scene: path.clone(), sections: states.len(), differing }))
}

/// The settings that an archive was baked with.
fn settings_of(archive: &Archive) -> BakeOptions {
    let svo = archive.svo_info();
    let rows = archive.rows_info().zip(archive.direction_set()).map(|(info, directions)| RowsOptions {
        bits: info.bits,
        directions,
        // Their ranges were checked when the archive was opened.
        fit: if info.fit == 0 { Fit::Cube } else { Fit::Extent },
        from: match info.source {
            0 => RowsFrom::Peel,
            1 => RowsFrom::Rotate,
            _ => RowsFrom::Points,
        },
    });
    BakeOptions {
        levels: svo.levels,
        rows,
        // It may have been pinned.
        cube: Some(SceneCube { origin: svo.origin, size: svo.size }),
        ..BakeOptions::default()
    }
}

/// A new bake of the scene, in memory.
fn bake_again(
    path: &Path,
    scene: &Scene,
    mut settings: BakeOptions,
    format: Format,
) -> Result<Archive, CliError> {
    let fail = |source| CliError::from(RunError::Bake { scene: path.to_owned(), source });
    let progress = Progress::new(format, cancel::watch());
    loop {
        let mut writer = ArchiveWriter::in_memory().map_err(|e| fail(e.into()))?;
        let result = bake(scene, &settings, None, &mut writer, &progress);
        progress.finish();
        match result {
            Ok(_) => {
                let (bytes, _) = writer.finish().map_err(|e| fail(e.into()))?;
                return Ok(Archive::from_bytes(bytes)?);
            }
            // The scene has outgrown the archive's cube, which is a difference to tell and no error.
            Err(BakeError::CubeTooSmall { .. }) if settings.cube.is_some() => settings.cube = None,
            Err(error) => return Err(fail(error)),
        }
    }
}
