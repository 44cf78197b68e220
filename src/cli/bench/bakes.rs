//! `manyview bench estimates` and `growth`: bakes in processes of their own.

use manyview::bench::tables::{BakeCase, BakeCost, Growth, MeasuredBake};
use manyview::bench::{BenchError, SceneSource};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::cli::error::Exit;

/// Bakes in new processes of this program, into a folder that goes with it.
pub(super) struct Bakes {
    program: PathBuf,
    folder: PathBuf,
    max_memory: u64,
}

impl Bakes {
    /// Makes a folder for the archives.
    pub(super) fn new(max_memory: u64) -> Result<Self, BenchError> {
        let failed = |path: &Path, source| BenchError::Output { path: path.to_owned(), source };
        let program = std::env::current_exe().map_err(|source| failed(Path::new("manyview"), source))?;
        let folder = std::env::temp_dir().join(format!("manyview-bench-{}", std::process::id()));
        fs_err::create_dir_all(&folder).map_err(|source| failed(&folder, source))?;
        Ok(Self { program, folder, max_memory })
    }

    /// Bakes once, without a cache.
    pub(super) fn measure(&self, case: &BakeCase) -> Result<Option<MeasuredBake>, BenchError> {
        let failed = |path: &Path, source| BenchError::Output { path: path.to_owned(), source };
        let archive = self.folder.join("bake.mvb");
        let mut command = Command::new(&self.program);
        command.arg("bake");
        match &case.scene {
            SceneSource::File(path) => _ = command.arg(path),
            SceneSource::Generated { kind, triangles } => {
                let recipe = self.folder.join("recipe.toml");
                let text = format!("generate = {{ kind = \"{kind}\", triangles = {triangles} }}\n");
                fs_err::write(&recipe, text).map_err(|source| failed(&recipe, source))?;
                command.arg("--recipe").arg(recipe);
            }
        }
        command.arg("-o").arg(&archive).args(["--format", "json", "--backend", "cpu", "--no-cache"]);
        command.args(["--levels", &case.levels.to_string(), "--rows", &case.rows.to_string()]);
        command.args(["--directions", &format!("latlong:{0}x{0}", case.directions)]);
        command.args(["--max-memory", &self.max_memory.to_string()]);
        if let Some(threads) = case.threads {
            command.args(["--jobs", &threads.to_string()]);
        }
        let output = command.stdin(Stdio::null()).output().map_err(|source| failed(&self.program, source))?;
        _ = fs_err::remove_file(&archive);
        let errors = String::from_utf8_lossy(&output.stderr);
        if output.status.code() == Some(Exit::OverBudget as i32) {
            return Ok(None);
        }
        if output.status.code() == Some(Exit::Cancelled as i32) {
            return Err(BenchError::Cancelled);
        }
        let told = |source| failed(&archive, source);
        let events = errors.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
        let estimate = events.into_iter().find(|event| event["event"] == "estimate");
        let summary = serde_json::from_slice::<Value>(&output.stdout).ok();
        let (Some(estimate), Some(summary), true) = (estimate, summary, output.status.success()) else {
            let last = errors.lines().last().unwrap_or("the bake said nothing").to_owned();
            return Err(told(std::io::Error::other(last)));
        };
        let estimated = BakeCost {
            triangles: whole(&estimate["triangles"]),
            leaves: whole(&estimate["leaves"]),
            points: whole(&estimate["points"]),
            peak_bytes: whole(&estimate["peak_bytes"]),
            archive_bytes: whole(&estimate["archive_bytes"]),
            seconds: estimate["seconds"].as_f64().unwrap_or(0.0),
        };
        let seconds = |part: &str| summary["seconds"][part].as_f64().unwrap_or(0.0);
        let measured = BakeCost {
            triangles: whole(&summary["triangles"]),
            leaves: whole(&summary["leaves"]),
            points: whole(&summary["points"]),
            peak_bytes: whole(&summary["peak_memory_bytes"]),
            archive_bytes: whole(&summary["file_bytes"]),
            seconds: seconds("all") - seconds("import"),
        };
        Ok(Some(MeasuredBake { estimated, measured, limit_bytes: self.max_memory }))
    }
}

impl Drop for Bakes {
    fn drop(&mut self) {
        _ = fs_err::remove_dir_all(&self.folder);
    }
}

fn whole(value: &Value) -> u64 {
    value.as_u64().unwrap_or(0)
}

/// Numbers of triangles to grow over.
const TRIANGLES: [u64; 5] = [10_000, 100_000, 1_000_000, 10_000_000, 50_000_000];
/// Triangles of the scene where they do not grow.
const USUAL: u64 = 100_000;

/// What bakes grow with, up to a number of triangles.
pub(super) fn growths(most_triangles: u64) -> Vec<Growth> {
    let scene = |triangles: u64| -> SceneSource {
        let kind = manyview_pipeline::generate::SceneKind::Town;
        SceneSource::Generated { kind, triangles }
    };
    let usual = || BakeCase {
        scene: scene(USUAL.min(most_triangles)),
        levels: 11,
        directions: 90,
        rows: 128,
        threads: None,
    };
    let of = |values: &[u32], with: &dyn Fn(u32) -> BakeCase| {
        values.iter().map(|&value| (f64::from(value), with(value))).collect::<Vec<_>>()
    };
    let triangles = TRIANGLES.iter().filter(|&&triangles| triangles <= most_triangles);
    let triangles =
        triangles.map(|&triangles| (triangles as f64, BakeCase { scene: scene(triangles), ..usual() }));
    let processors = std::thread::available_parallelism().map_or(1, |n| n.get() as u32);
    let threads: Vec<u32> = (0..).map(|n| 1 << n).take_while(|&n| n <= processors).collect();
    vec![
        Growth { name: "triangles", cases: triangles.collect() },
        Growth {
            name: "levels",
            cases: of(&[8, 9, 10, 11, 12, 13], &|levels| BakeCase { levels, ..usual() }),
        },
        Growth {
            name: "directions",
            cases: [30, 60, 90].map(|n| (f64::from(n * n), BakeCase { directions: n, ..usual() })).to_vec(),
        },
        Growth { name: "rows", cases: of(&[32, 64, 128, 256], &|rows| BakeCase { rows, ..usual() }) },
        Growth { name: "threads", cases: of(&threads, &|n| BakeCase { threads: Some(n), ..usual() }) },
    ]
}

/// Scenes whose estimates are compared where none is named.
pub(super) const SCENES: [&str; 3] = ["town:300000", "city:300000", "hairball:300000"];
