//! One bake from a scene file to an archive file: what the command line and build scripts call.

use crate::bake::{BakeError, BakeOptions, BakeReport, Progress, Silent, bake};
use crate::estimate::Estimate;
use crate::generate::generate;
use crate::import::{ImportError, ImportOptions, import};
use crate::recipe::SceneSource;
use crate::scene::Scene;
use manyview_cache::archive::{ArchiveError, ArchiveStats, ArchiveWriter};
use manyview_shaders::device::VoxelDevice;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A bake to run.
///
/// ```no_run
/// let summary = manyview_pipeline::run::Bake::new("scene.glb").output("scene.mvb").run()?;
/// println!("{} leaves", summary.report.leaves);
/// # Ok::<(), manyview_pipeline::run::RunError>(())
/// ```
#[derive(Debug, Clone)]
pub struct Bake {
    /// The scene.
    pub source: SceneSource,
    /// The archive; by default beside the scene, with the extension `mvb`.
    pub output: PathBuf,
    /// What to bake.
    pub options: BakeOptions,
    /// How to import it.
    pub import: ImportOptions,
    /// Threads, or `None` for one per processor.
    pub jobs: Option<usize>,
}

/// Why a bake gave no archive.
#[derive(Debug, Error)]
pub enum RunError {
    /// The scene could not be imported.
    #[error(transparent)]
    Import(#[from] ImportError),
    /// The bake failed.
    #[error("{}: {source}", scene.display())]
    Bake {
        /// The scene.
        scene: PathBuf,
        /// What went wrong.
        source: BakeError,
    },
    /// The archive could not be written.
    #[error(transparent)]
    Output(#[from] ArchiveError),
    /// The output would overwrite the scene or a file that it needs.
    #[error("{}: the archive would overwrite the scene or a part of it; choose another output", path.display())]
    OverwritesScene {
        /// The file of the scene.
        path: PathBuf,
    },
    /// Threads could not be started.
    #[error("cannot start {jobs} threads: {reason}; use fewer --jobs")]
    Threads {
        /// How many.
        jobs: usize,
        /// Why.
        reason: String,
    },
}

/// What a finished bake did.
#[derive(Debug, Clone)]
pub struct Summary {
    /// What was baked.
    pub report: BakeReport,
    /// Sizes of the archive.
    pub archive: ArchiveStats,
    /// Files that were read or looked for, as paths from the current folder; the scene first.
    pub files: Vec<PathBuf>,
    /// What was left out or forgiven.
    pub warnings: Vec<String>,
    /// Seconds for the import.
    pub import_seconds: f64,
}

impl Bake {
    /// A bake of a glTF file with the default settings.
    pub fn new(scene: impl Into<PathBuf>) -> Self {
        let scene = scene.into();
        let output = scene.with_extension("mvb");
        Self::from_source(SceneSource::File(scene), output)
    }

    /// A bake of any source with the default settings.
    pub fn from_source(source: SceneSource, output: PathBuf) -> Self {
        let (options, import) = (BakeOptions::default(), ImportOptions::default());
        Self { source, output, options, import, jobs: None }
    }

    /// Sets the archive's path.
    #[must_use]
    pub fn output(mut self, path: impl Into<PathBuf>) -> Self {
        self.output = path.into();
        self
    }

    /// Bakes on the CPU, silently.
    pub fn run(&self) -> Result<Summary, RunError> {
        self.run_on(None, &Silent)
    }

    /// Bakes; work that a GPU can do runs on `device` if there is one.
    pub fn run_on(
        &self,
        device: Option<&dyn VoxelDevice>,
        progress: &dyn Progress,
    ) -> Result<Summary, RunError> {
        self.in_pool(|| {
            self.options.check().map_err(|e| self.failed(e))?;
            if let SceneSource::File(scene) = &self.source {
                self.spare(scene)?;
            }
            // Before the long work: an output that cannot be written is known at once.
            let mut writer = ArchiveWriter::create(&self.output)?;
            let clock = std::time::Instant::now();
            let (scene, files) = self.load()?;
            files.iter().try_for_each(|file| self.spare(file))?;
            let import_seconds = clock.elapsed().as_secs_f64();
            let report =
                bake(&scene, &self.options, device, &mut writer, progress).map_err(|e| self.failed(e))?;
            let archive = writer.finish()?;
            Ok(Summary { report, archive, files, warnings: scene.warnings, import_seconds })
        })
    }

    /// Imports the scene and tells what the bake would cost, without baking.
    pub fn estimate(&self) -> Result<(Estimate, Vec<String>), RunError> {
        self.in_pool(|| {
            self.options.check().map_err(|e| self.failed(e))?;
            let (scene, _) = self.load()?;
            let placement = crate::bake::Placement::new(&scene, &self.options).map_err(|e| self.failed(e))?;
            Ok((Estimate::new(&scene, &self.options, placement.cube), scene.warnings))
        })
    }

    /// The scene, and the files that it came from as paths from the current folder.
    fn load(&self) -> Result<(Scene, Vec<PathBuf>), RunError> {
        match &self.source {
            SceneSource::File(path) => {
                let imported = import(path, &self.import)?;
                let folder = path.parent().unwrap_or(Path::new(""));
                Ok((imported.scene, imported.files.iter().map(|f| folder.join(&f.path)).collect()))
            }
            SceneSource::Generated { kind, triangles, seed } => {
                Ok((generate(*kind, *triangles, *seed), Vec::new()))
            }
        }
    }

    /// An error if the output is `file`, which the scene needs.
    fn spare(&self, file: &Path) -> Result<(), RunError> {
        if same_file(file, &self.output) {
            return Err(RunError::OverwritesScene { path: file.to_owned() });
        }
        Ok(())
    }

    fn failed(&self, source: BakeError) -> RunError {
        let scene = match &self.source {
            SceneSource::File(path) => path.clone(),
            SceneSource::Generated { kind, triangles, .. } => {
                PathBuf::from(format!("generated {kind} of {triangles}"))
            }
        };
        RunError::Bake { scene, source }
    }

    fn in_pool<T: Send>(&self, work: impl FnOnce() -> Result<T, RunError> + Send) -> Result<T, RunError> {
        let Some(jobs) = self.jobs else { return work() };
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(jobs)
            .build()
            .map_err(|e| RunError::Threads { jobs, reason: e.to_string() })?;
        pool.install(work)
    }
}

/// Whether two paths lead to one file.
pub fn same_file(a: &Path, b: &Path) -> bool {
    match (fs_err::canonicalize(a), fs_err::canonicalize(b)) {
        (Ok(a), Ok(b)) => a == b,
        _ => a == b,
    }
}
