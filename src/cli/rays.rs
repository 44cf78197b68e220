//! `manyview rays`.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::ValueEnum;
use manyview::Archive;
use manyview::bench::{BenchScene, SceneSource};
use manyview::exact::ExactRays;
use manyview::npy::{self, ArrayReader, ReadError};
use manyview::rays::{RowTester, TestSettings};
use manyview::reference::Reference;
use manyview::rivals::brickmap::{self, BrickmapVisibility};
use manyview::rivals::bvh::BvhVisibility;
use manyview::visibility::{Segment, Visibility, VisibilityError};
use manyview_cache::archive::ArchiveWriter;
use manyview_cache::atomic::{AtomicFile, AtomicFileError};
use manyview_pipeline::bake::{BakeOptions, bake};
use manyview_shaders::testable::testable;
use serde_json::json;

use super::Format;
use super::cancel;
use super::error::{CliError, CliResult, Exit, open_input};
use super::output::{counted, print_json};
use super::overwrite::check_outputs;
use super::progress::Progress;

/// Segments that are read, tested and written at a time: 20 MB of them, and enough for every thread.
const BATCH: usize = 1 << 18;
/// What archives begin with.
const ARCHIVE_MAGIC: &[u8] = b"\x89MVB\r\n\x1a\n";

/// Options of `rays`.
#[derive(Debug, clap::Args)]
#[command(after_help = RAYS_HELP)]
pub(crate) struct Options {
    /// An archive, or a scene: a .glb or .gltf file, or KIND:TRIANGLES for a generated one
    #[arg(value_name = "A.mvb|SCENE")]
    input: PathBuf,
    /// The segments: a NumPy file of float32 (n, 6), origin and target, or (n, 9), with the normal of the surface
    /// that the origin lies on, on the target's side, or zeros
    #[arg(long, value_name = "R.npy")]
    rays: PathBuf,
    /// The answers: a NumPy file of uint8 (n), 1 where something is between the ends, or with --distance float32 (n)
    #[arg(short, long, value_name = "H.npy")]
    output: PathBuf,
    /// How segments are tested
    #[arg(long, value_enum, default_value_t = MethodName::Rows)]
    method: MethodName,
    /// Write the distance from the origin to the first hit, metres, +infinity where there is none
    #[arg(long)]
    distance: bool,
    /// Text on stderr, or JSON on stdout
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

const RAYS_HELP: &str = "Coordinates are world space, metres. A segment that has no length, or an end that is not \
finite, hits nothing; a normal that is not finite counts as zeros. Ends may lie outside the scene.";

/// Ways to test segments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum MethodName {
    /// The bake's rows: a look-up or two a segment, approximate
    Rows,
    /// The same with one look-up: faster, less exact
    RowsFast,
    /// Marching through the cells of the bake's octree, approximate
    Brickmap,
    /// Ray tracing of the scene's triangles, in 32-bit floats
    Bvh,
    /// Ray tracing of the scene's triangles, in 64-bit floats
    Exact,
}

/// What segments are tested against.
pub(crate) enum Input {
    /// A bake.
    Archive(Box<Archive>),
    /// Triangles.
    Scene {
        /// The scene.
        scene: Box<BenchScene>,
        /// What it was called.
        name: String,
    },
}

impl Input {
    /// Opens an archive, or imports or makes a scene.
    pub(crate) fn open(path: &Path) -> Result<Self, CliError> {
        let ends_like_one = path.extension().is_some_and(|extension| extension == "mvb");
        if ends_like_one || begins_with(path, ARCHIVE_MAGIC) {
            return Ok(Self::Archive(Box::new(Archive::open(path)?)));
        }
        let name = path.display().to_string();
        let source: SceneSource = name.parse().map_err(CliError::usage)?;
        Ok(Self::Scene { scene: Box::new(BenchScene::load(&source)?), name })
    }

    /// The archive, or a new one of the scene with the default settings, in memory; without rows if they are not
    /// needed.
    pub(crate) fn into_archive(self, with_rows: bool) -> Result<Archive, CliError> {
        match self {
            Self::Archive(archive) => Ok(*archive),
            Self::Scene { scene, name } => archive_of(&scene, &name, with_rows),
        }
    }
}

/// A bake of a scene with the default settings, in memory; without rows if they are not needed.
pub(crate) fn archive_of(scene: &BenchScene, name: &str, with_rows: bool) -> Result<Archive, CliError> {
    eprintln!("{name}: baking it in memory with the default settings (see `manyview bake`)");
    let failed = |error| CliError::bad_input(format!("{name}: {error}"));
    let mut options = BakeOptions::default();
    options.rows = options.rows.filter(|_| with_rows);
    let progress = Progress::new(Format::Text, cancel::watch());
    let mut writer = ArchiveWriter::in_memory().map_err(|error| failed(error.to_string()))?;
    let result = bake(&scene.scene, &options, None, &mut writer, &progress);
    progress.finish();
    cancel::check()?;
    result.map_err(|error| failed(error.to_string()))?;
    let (bytes, _) = writer.finish().map_err(|error| failed(error.to_string()))?;
    Ok(Archive::from_bytes(bytes)?)
}

fn begins_with(path: &Path, magic: &[u8]) -> bool {
    let mut start = vec![0; magic.len()];
    let mut file = match fs_err::File::open(path) {
        Ok(file) => file,
        Err(_) => return false,
    };
    io::Read::read_exact(&mut file, &mut start).is_ok() && start == magic
}

/// Makes a method for an input and hands it to `work`.
pub(crate) fn with_method<R>(
    name: MethodName,
    input: Input,
    work: impl FnOnce(&dyn Visibility) -> Result<R, CliError>,
) -> Result<R, CliError> {
    match name {
        MethodName::Rows => work(&RowTester::load(&input.into_archive(true)?)?),
        MethodName::RowsFast => {
            work(&RowTester::load(&input.into_archive(true)?)?.with_settings(TestSettings::FAST))
        }
        MethodName::Brickmap => {
            let svo = input.into_archive(false)?.svo()?;
            work(&BrickmapVisibility::new(brickmap::from_svo(&svo, u32::MAX, brickmap::DEFAULT_BIAS)))
        }
        MethodName::Bvh | MethodName::Exact => match &input {
            Input::Archive(archive) => Err(CliError::usage(format!(
                "{}: an archive has no triangles, which --method bvh and exact need: name the scene that it was baked \
                 from (.glb or .gltf)",
                archive.name()
            ))),
            Input::Scene { scene, .. } => {
                let reference = Reference::new(&scene.scene, &scene.row_triangles, &scene.cutouts);
                match name {
                    MethodName::Exact => work(&ExactRays::new(reference)),
                    _ => work(&BvhVisibility::new(&reference)),
                }
            }
        },
    }
}

/// Runs `rays`.
pub(crate) fn run(options: &Options) -> CliResult {
    _ = cancel::watch();
    let inputs = [("A.mvb|SCENE", &*options.input), ("--rays", &*options.rays)];
    check_outputs(&inputs, &[("--output", &*options.output)])?;
    let name = options.rays.display().to_string();
    let file = open_input(&options.rays)?;
    let shapes: &[&[Option<u64>]] = &[&[None, Some(6)], &[None, Some(9)]];
    let mut rays = ArrayReader::<f32, _>::new(name, io::BufReader::new(file.into_parts().0), shapes)?;
    // What cannot be written is not worth the work.
    let output = AtomicFile::create(&options.output)?;
    let input = Input::open(&options.input)?;
    cancel::check()?;
    let summary = with_method(options.method, input, |method| {
        if options.distance {
            let test = |segments: &[Segment], distances: &mut [f32]| {
                method.distances(segments, distances)?;
                Ok(distances.iter().filter(|distance| distance.is_finite()).count())
            };
            answer(&mut rays, output, &options.output, test)
        } else {
            let test = |segments: &[Segment], occluded: &mut [u8]| {
                method.occluded(segments, occluded)?;
                Ok(occluded.iter().filter(|&&occluded| occluded != 0).count())
            };
            answer(&mut rays, output, &options.output, test)
        }
    })?;
    let method = options.method.to_possible_value().map_or(String::new(), |name| name.get_name().to_owned());
    match options.format {
        Format::Json => print_json(&json!({
            "output": options.output.display().to_string(),
            "method": method,
            "rays": summary.segments,
            "hits": summary.hits,
            "without_answer": summary.senseless,
            "seconds": summary.seconds,
        }))?,
        Format::Text => {
            eprintln!(
                "{}: {} by {method}, {} hit something, {:.2} s ({:.1} million a second)",
                options.output.display(),
                counted(summary.segments, "ray"),
                summary.hits,
                summary.seconds,
                summary.segments as f64 / summary.seconds.max(1e-9) * 1e-6,
            );
            if summary.senseless > 0 {
                let rays = counted(summary.senseless, "ray");
                eprintln!(
                    "{rays} without length, or with an end that is not finite: counted as hitting nothing"
                );
            }
        }
    }
    Ok(Exit::Done)
}

#[derive(Debug, Default)]
struct Summary {
    segments: u64,
    hits: u64,
    /// Segments that hit nothing by definition.
    senseless: u64,
    /// Time for the tests alone.
    seconds: f64,
}

/// Reads segments, tests them and writes the answers, batch by batch.
fn answer<T: npy::Element>(
    rays: &mut ArrayReader<f32, impl io::Read>,
    mut output: AtomicFile,
    path: &Path,
    mut test: impl FnMut(&[Segment], &mut [T]) -> Result<usize, VisibilityError>,
) -> Result<Summary, CliError> {
    let unwritten = |source| AtomicFileError { path: path.to_owned(), action: "write it", source };
    let (count, numbers) = (rays.shape()[0], rays.shape()[1] as usize);
    let mut summary = Summary { segments: count, ..Summary::default() };
    npy::write_header::<T>(&mut output, &[count as usize]).map_err(unwritten)?;
    let batch = BATCH.min(usize::try_from(count).unwrap_or(BATCH));
    let mut coordinates = vec![0.0f32; batch * numbers];
    let mut segments = Vec::with_capacity(batch);
    let mut answers = vec![T::zeroed(); batch];
    loop {
        cancel::check()?;
        let found = rays.read(&mut coordinates)? / numbers;
        if found == 0 {
            break;
        }
        segments.clear();
        segments.extend(coordinates.chunks_exact(numbers).take(found).map(segment));
        summary.senseless += segments.iter().filter(|segment| testable(segment).is_none()).count() as u64;
        let begun = Instant::now();
        summary.hits += test(&segments, &mut answers[..found])? as u64;
        summary.seconds += begun.elapsed().as_secs_f64();
        npy::write_elements(&mut output, &answers[..found]).map_err(unwritten)?;
    }
    output.commit()?;
    Ok(summary)
}

fn segment(numbers: &[f32]) -> Segment {
    let at = |from: usize| numbers.get(from..from + 3).map_or([0.0; 3], |v| [v[0], v[1], v[2]]);
    Segment { origin: at(0), target: at(3), normal: at(6) }
}

impl From<ReadError> for CliError {
    fn from(error: ReadError) -> Self {
        Self::new(Exit::BadInput, error)
    }
}

impl From<VisibilityError> for CliError {
    fn from(error: VisibilityError) -> Self {
        let exit = match error {
            VisibilityError::Unsupported { .. } => Exit::Usage,
            VisibilityError::Device(_) | VisibilityError::Views(_) => Exit::Internal,
        };
        Self::new(exit, error)
    }
}
