//! One bake from a scene file to an archive file: what the command line and build scripts call.

use crate::bake::{BakeError, BakeOptions, BakeReport, Placement, Progress, Silent, bake_placed};
use crate::estimate::{Estimate, Plan};
use crate::explain::{Step, explain};
use crate::generate::generate;
use crate::import::{ImportError, ImportOptions, SourceFile, import};
use crate::journal::Journal;
use crate::recipe::SceneSource;
use crate::record::{Record, record_key};
use crate::scene::Scene;
use crate::steps::{StepCounts, StepKind, Steps};
use manyview_cache::archive::{ArchiveError, ArchiveStats, ArchiveWriter};
use manyview_cache::digest::Digest;
use manyview_cache::store::Store;
use manyview_shaders::device::VoxelDevice;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use thiserror::Error;

/// A bake to run.
///
/// ```no_run
/// let summary = manyview_pipeline::run::Bake::new("scene.glb").output("scene.mvb").run()?;
/// println!("{} leaves", summary.report.leaves);
/// # Ok::<(), manyview_pipeline::run::RunError>(())
/// ```
#[derive(Clone)]
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
    /// Where results of steps are kept, if anywhere.
    pub store: Option<Arc<Store>>,
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
    /// Steps that were reused and made.
    pub steps: StepCounts,
    /// The archive was there already, and is what a bake would make: nothing was done.
    pub is_up_to_date: bool,
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
        Self { source, output, options, import, jobs: None, store: None }
    }

    /// Sets the archive's path.
    #[must_use]
    pub fn output(mut self, path: impl Into<PathBuf>) -> Self {
        self.output = path.into();
        self
    }

    /// Keeps results of steps in `store` and takes them from there.
    #[must_use]
    pub fn store(mut self, store: Arc<Store>) -> Self {
        self.store = Some(store);
        self
    }

    /// Bakes in a build script: prints `cargo:rerun-if-changed` for every file that is read or looked for, so that
    /// cargo runs the script again when one of them changes. With a [store](Self::store) the next run takes little time.
    ///
    /// ```no_run
    /// // build.rs
    /// use manyview_pipeline::run::Bake;
    /// let out = std::path::PathBuf::from(std::env::var_os("OUT_DIR").unwrap());
    /// Bake::new("assets/scene.glb").output(out.join("scene.mvb")).run_in_build_script().unwrap();
    /// ```
    pub fn run_in_build_script(&self) -> Result<Summary, RunError> {
        let changed = |path: &Path| println!("cargo:rerun-if-changed={}", path.display());
        // Also where the bake fails: a scene that is repaired must be baked again.
        if let SceneSource::File(scene) = &self.source {
            changed(scene);
        }
        let summary = self.run()?;
        summary.files.iter().skip(1).for_each(|file| changed(file));
        for warning in &summary.warnings {
            println!("cargo:warning={warning}");
        }
        Ok(summary)
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
            let steps = Steps::new(self.store.clone());
            if let Some(summary) = self.find_archive(&steps) {
                self.touch_output();
                return Ok(summary);
            }
            // Before the long work: an output that cannot be written is known at once.
            let mut writer = ArchiveWriter::create(&self.output)?;
            let clock = std::time::Instant::now();
            let (scene, sources) = self.load()?;
            let files = self.paths(sources.iter().map(|file| file.path.as_str()));
            files.iter().try_for_each(|file| self.spare(file))?;
            let import_seconds = clock.elapsed().as_secs_f64();
            steps.count(StepKind::Import, 0, 1, 0);
            let mut placement = Placement::new(&scene, &self.options).map_err(|e| self.failed(e))?;
            placement.read_bytes = file_bytes(&files);
            let report =
                bake_placed(&scene, &self.options, &placement, device, &steps, &mut writer, progress)
                    .map_err(|e| self.failed(e))?;
            let archive = writer.finish()?;
            steps.count(StepKind::Archive, 0, 1, 0);
            let counts = steps.counts();
            if steps.has_store() {
                let total = counts.total();
                let all = total.reused + total.rebuilt;
                let record = Record::new(&sources, &report, &archive, &scene.warnings, all);
                record.keep(&steps, self.record_key(sources.first()));
                let Placement { runs, cube, .. } = &placement;
                Journal::new(&scene, runs, &sources, &self.options, *cube).keep(&steps, &self.output);
            }
            steps.flush();
            let warnings = scene.warnings;
            Ok(Summary {
                report,
                archive,
                files,
                warnings,
                import_seconds,
                steps: counts,
                is_up_to_date: false,
            })
        })
    }

    /// What there is to say if nothing has changed since the archive was baked: then [`run`](Self::run) would do
    /// nothing. Reads the scene's files, to hash them, and the archive's index.
    pub fn up_to_date(&self) -> Result<Option<Summary>, RunError> {
        self.options.check().map_err(|e| self.failed(e))?;
        if let SceneSource::File(scene) = &self.source {
            self.spare(scene)?;
        }
        Ok(self.find_archive(&Steps::new(self.store.clone())))
    }

    /// Gives an archive that is [up to date](Self::up_to_date) the time of now, so that `make`, which knows times only,
    /// does not ask again.
    pub fn touch_output(&self) {
        if let Ok(file) = fs_err::OpenOptions::new().append(true).open(&self.output) {
            // Failing costs another look.
            _ = file.file().set_modified(std::time::SystemTime::now());
        }
    }

    fn find_archive(&self, steps: &Steps) -> Option<Summary> {
        steps.store()?;
        let hash = match &self.source {
            SceneSource::File(path) => {
                let file = fs_err::File::open(path).ok()?;
                let mut hasher = blake3::Hasher::new();
                hasher.update_reader(file).ok()?;
                Some(hasher.finalize())
            }
            SceneSource::Generated { .. } => None,
        };
        let scene_file = hash.map(|hash| SourceFile { path: String::new(), hash: Some(hash) });
        let record = Record::find(steps, &self.record_key(scene_file.as_ref()))?;
        if !record.has_same_files(&self.folder()) || !record.is_archive_at(&self.output) {
            return None;
        }
        steps.count(StepKind::Archive, record.steps as usize, 0, 0);
        Some(Summary {
            report: record.report(),
            archive: record.archive()?,
            files: self.paths(record.files()),
            warnings: record.warnings.clone(),
            import_seconds: 0.0,
            steps: steps.counts(),
            is_up_to_date: true,
        })
    }

    fn record_key(&self, scene: Option<&SourceFile>) -> Digest {
        let hash = scene.and_then(|file| file.hash).map(|hash| Digest(*hash.as_bytes()));
        record_key(&self.source, hash.as_ref(), &self.import, &self.options)
    }

    /// The folder that paths of the scene's files start at.
    fn folder(&self) -> PathBuf {
        match &self.source {
            SceneSource::File(path) => path.parent().unwrap_or(Path::new("")).to_owned(),
            SceneSource::Generated { .. } => PathBuf::new(),
        }
    }

    /// Files of the scene as paths from the current folder.
    fn paths<'p>(&self, files: impl Iterator<Item = &'p str>) -> Vec<PathBuf> {
        let folder = self.folder();
        files.map(|file| folder.join(file)).collect()
    }

    /// Imports the scene and tells of every step whether the store has it, and why not.
    pub fn explain(&self) -> Result<Vec<Step>, RunError> {
        self.in_pool(|| {
            self.options.check().map_err(|e| self.failed(e))?;
            let steps = Steps::new(self.store.clone());
            let (scene, sources) = self.load()?;
            let Placement { runs, cube, .. } =
                Placement::new(&scene, &self.options).map_err(|e| self.failed(e))?;
            let last = Journal::find(&steps, &self.output);
            explain(&scene, &sources, &self.options, &runs, cube, &steps, last.as_ref())
                .map_err(|e| self.failed(e))
        })
    }

    /// Imports the scene and tells what the bake would cost, without baking.
    pub fn estimate(&self) -> Result<(Estimate, Vec<String>), RunError> {
        self.in_pool(|| {
            self.options.check().map_err(|e| self.failed(e))?;
            let (scene, sources) = self.load()?;
            let files = self.paths(sources.iter().map(|file| file.path.as_str()));
            let placement = Placement::new(&scene, &self.options).map_err(|e| self.failed(e))?;
            let Placement { runs, cube, .. } = &placement;
            let has_store = self.store.is_some();
            let plan = Plan::new(&scene, &self.options, runs, *cube, file_bytes(&files), has_store);
            Ok((plan.estimate, scene.warnings))
        })
    }

    /// The scene, and the files that it came from as paths from its folder.
    fn load(&self) -> Result<(Scene, Vec<SourceFile>), RunError> {
        match &self.source {
            SceneSource::File(path) => {
                let imported = import(path, &self.import)?;
                Ok((imported.scene, imported.files))
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

/// The size of some files; those that are missing have none.
fn file_bytes(files: &[PathBuf]) -> u64 {
    files.iter().filter_map(|file| fs_err::metadata(file).ok()).map(|metadata| metadata.len()).sum()
}

/// Whether two paths lead to one file.
pub fn same_file(a: &Path, b: &Path) -> bool {
    match (fs_err::canonicalize(a), fs_err::canonicalize(b)) {
        (Ok(a), Ok(b)) => a == b,
        _ => a == b,
    }
}
