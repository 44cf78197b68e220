//! Measures rebakes: how long an edit takes against a clean bake, and that the bytes are the same.
//!
//! ```console
//! $ cargo build --release && cargo run --release --example rebakes -- [--runs N] SCENE.glb …
//! ```
//!
//! Each scene is baked with the default settings by the release build of `manyview`: clean without a cache, clean with
//! one, without a change, with one object moved by half a metre, with another colour of one material. Times are of
//! whole processes, the least of N (3); each run of an edit starts from the cache as the clean bake left it. One scene
//! may be `town:TRIANGLES`. Prints a table in Markdown.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use serde_json::Value;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

fn main() -> Result<()> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut runs = 3;
    if arguments.first().is_some_and(|word| word == "--runs") {
        runs = arguments.get(1).ok_or("--runs needs a number")?.parse()?;
        arguments.drain(..2);
    }
    let program = std::env::current_exe()?.with_file_name("../manyview").canonicalize()?;
    println!(
        "| scene | objects | clean | clean with cache | no change | one object moved | blocks patched / made \
         | one colour | rows made for it | cache / archive |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for scene in &arguments {
        let folder = std::env::temp_dir().join(format!("manyview-rebakes-{}", std::process::id()));
        fs_err::create_dir_all(&folder)?;
        let result = measure(&program, scene, &folder, runs);
        fs_err::remove_dir_all(&folder)?;
        println!("{}", result.map_err(|error| format!("{scene}: {error}"))?);
    }
    Ok(())
}

/// A folder with a scene and a cache.
struct Bench<'a> {
    program: &'a Path,
    folder: &'a Path,
}

impl Bench<'_> {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Bakes `scene.glb`; the summary and the seconds of the process.
    fn bake(&self, output: &str, has_cache: bool) -> Result<(Value, f64)> {
        let mut command = Command::new(self.program);
        command.current_dir(self.folder).args(["bake", "scene.glb", "-o", output, "--backend", "cpu"]);
        command.args(if has_cache { &["--cache", "cache"][..] } else { &["--no-cache"] });
        let start = Instant::now();
        let done = command.args(["--format", "json"]).output()?;
        let seconds = start.elapsed().as_secs_f64();
        if !done.status.success() {
            return Err(String::from_utf8_lossy(&done.stderr).into());
        }
        Ok((serde_json::from_slice(&done.stdout)?, seconds))
    }

    /// Bakes an edited scene some times, each time from the cache of the clean bake.
    fn edited(&self, scene: &[u8], runs: usize) -> Result<(Value, f64)> {
        let mut best: Option<(Value, f64)> = None;
        fs_err::write(self.path("scene.glb"), scene)?;
        for _ in 0..runs {
            _ = fs_err::remove_dir_all(self.path("cache"));
            let mut copy = Command::new("cp");
            if !copy.arg("-a").args([self.path("clean cache"), self.path("cache")]).status()?.success() {
                return Err("the cache could not be copied".into());
            }
            Command::new("sync").status()?;
            let (summary, seconds) = self.bake("out.mvb", true)?;
            if best.as_ref().is_none_or(|(_, least)| seconds < *least) {
                best = Some((summary, seconds));
            }
        }
        self.bake("expected.mvb", false)?;
        if fs_err::read(self.path("out.mvb"))? != fs_err::read(self.path("expected.mvb"))? {
            return Err("the rebake differs from a clean bake".into());
        }
        best.ok_or_else(|| "no runs".into())
    }
}

fn measure(program: &Path, scene: &str, folder: &Path, runs: usize) -> Result<String> {
    let bench = Bench { program, folder };
    match scene.strip_prefix("town:") {
        Some(triangles) => {
            let arguments = ["scene", "town", "--triangles", triangles, "-o", "scene.glb"];
            Command::new(program).current_dir(folder).args(arguments).output()?;
        }
        None => _ = fs_err::copy(scene, bench.path("scene.glb"))?,
    }
    let original = fs_err::read(bench.path("scene.glb"))?;
    let mut clean = f64::INFINITY;
    let mut with_cache = f64::INFINITY;
    for _ in 0..runs {
        clean = clean.min(bench.bake("out.mvb", false)?.1);
        _ = fs_err::remove_dir_all(bench.path("cache"));
        with_cache = with_cache.min(bench.bake("out.mvb", true)?.1);
    }
    let mut same = f64::INFINITY;
    for _ in 0..runs.max(5) {
        let (summary, seconds) = bench.bake("out.mvb", true)?;
        if summary["up_to_date"] != true {
            return Err("a bake of the same scene did something".into());
        }
        same = same.min(seconds);
    }
    fs_err::rename(bench.path("cache"), bench.path("clean cache"))?;
    let bytes_of_cache = folder_bytes(&bench.path("clean cache"))?;
    let bytes_of_archive = fs_err::metadata(bench.path("out.mvb"))?.len();

    let (mut json, rest) = split(&original)?;
    let nodes: Vec<usize> = (0..json["nodes"].as_array().map_or(0, Vec::len))
        .filter(|&node| json["nodes"][node]["mesh"].is_number())
        .collect();
    // An object in the middle of the list; at the scene's rim it would change the bounds.
    let moved = (0..nodes.len().min(8)).find_map(|step| {
        let mut json = json.clone();
        move_node(&mut json["nodes"][nodes[(nodes.len() / 2 + step * 7) % nodes.len()]]);
        let result = bench.edited(&join(&json, &rest), runs);
        let is_inside = |summary: &Value| summary["steps"]["kinds"]["rows"]["patched"].as_u64() > Some(0);
        result.map(|(summary, seconds)| is_inside(&summary).then_some((summary, seconds))).transpose()
    });
    let moved = moved.transpose()?;
    if let Some(material) = json["materials"].get_mut(0) {
        material["pbrMetallicRoughness"]["baseColorFactor"] = serde_json::json!([0.3, 0.6, 0.1, 1.0]);
    }
    let (painted, painted_seconds) = bench.edited(&join(&json, &rest), runs)?;
    let made = painted["steps"]["kinds"]["rows"]["rebuilt"].as_u64().unwrap_or(0);
    let share = |seconds: f64| format!("{seconds:.3} s ({:.2} %)", seconds / clean * 100.0);
    Ok(format!(
        "| {} | {} | {clean:.2} s | {with_cache:.2} s ({:+.1} %) | {} | {} | {} | {} | {made} | {:.2} |",
        Path::new(scene).file_name().unwrap_or_default().to_string_lossy(),
        nodes.len(),
        (with_cache / clean - 1.0) * 100.0,
        share(same),
        moved.as_ref().map_or("all at the rim".to_owned(), |(_, seconds)| share(*seconds)),
        moved.as_ref().map_or(String::new(), |(summary, _)| {
            let rows = &summary["steps"]["kinds"]["rows"];
            format!("{} / {}", rows["patched"], rows["rebuilt"])
        }),
        share(painted_seconds),
        bytes_of_cache as f64 / bytes_of_archive as f64
    ))
}

/// Moves a node by half a metre.
fn move_node(node: &mut Value) {
    if let Some(matrix) = node.get_mut("matrix") {
        matrix[12] = (matrix[12].as_f64().unwrap_or(0.0) + 0.5).into();
    } else {
        let old = node["translation"].as_array().cloned().unwrap_or_default();
        let at = |i: usize| old.get(i).and_then(Value::as_f64).unwrap_or(0.0);
        node["translation"] = serde_json::json!([at(0) + 0.5, at(1), at(2)]);
    }
}

fn folder_bytes(folder: &Path) -> Result<u64> {
    let mut bytes = 0;
    for entry in fs_err::read_dir(folder)? {
        let entry = entry?;
        bytes +=
            if entry.file_type()?.is_dir() { folder_bytes(&entry.path())? } else { entry.metadata()?.len() };
    }
    Ok(bytes)
}

/// The JSON of a GLB, and its other chunks.
fn split(glb: &[u8]) -> Result<(Value, Vec<u8>)> {
    let length = u32::from_le_bytes(glb.get(12..16).ok_or("no GLB")?.try_into()?) as usize;
    let json = glb.get(20..20 + length).ok_or("no GLB")?;
    Ok((serde_json::from_slice(json)?, glb[20 + length..].to_vec()))
}

fn join(json: &Value, rest: &[u8]) -> Vec<u8> {
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut glb = b"glTF\x02\0\0\0".to_vec();
    glb.extend(((20 + text.len() + rest.len()) as u32).to_le_bytes());
    glb.extend((text.len() as u32).to_le_bytes());
    glb.extend(b"JSON");
    glb.extend(text);
    glb.extend(rest);
    glb
}
