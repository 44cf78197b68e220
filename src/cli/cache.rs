//! `manyview cache`, and where the cache is.

use std::path::PathBuf;
use std::sync::Arc;

use clap::Subcommand;
use etcetera::BaseStrategy as _;
use manyview_cache::store::Store;
use manyview_pipeline::steps::BUCKETS;
use serde_json::json;

use super::Format;
use super::bake::memory_size;
use super::error::{CliError, CliResult, Exit};
use super::output::{Table, bytes, count, counted, print, print_json};

/// Names the folder of the cache, unless an option does.
const VARIABLE: &str = "MANYVIEW_CACHE";

/// Options of commands that use the cache.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct CacheOptions {
    /// Folder in which results of steps are kept [default: `MANYVIEW_CACHE`, else a folder of the user's]
    #[arg(long, value_name = "DIR", conflicts_with = "no_cache")]
    cache: Option<PathBuf>,
    /// Keep nothing and reuse nothing
    #[arg(long)]
    no_cache: bool,
}

impl CacheOptions {
    /// The folder of the cache; `None` for none: by option, by an empty `MANYVIEW_CACHE`, or on a system without
    /// folders of users.
    pub(crate) fn folder(&self) -> Option<PathBuf> {
        if self.no_cache { None } else { folder(self.cache.clone()) }
    }

    /// Opens the cache if it is there already: a run that writes nothing makes none.
    pub(crate) fn open_if_there(&self) -> Result<Option<Arc<Store>>, CliError> {
        match self.folder() {
            Some(folder) if folder.is_dir() => {
                Ok(Some(Arc::new(Store::open(folder).map_err(CliError::bad_input)?)))
            }
            _ => Ok(None),
        }
    }

    /// Opens the cache. One that was named must open; the user's own is gone without, with a warning.
    pub(crate) fn open(&self, warn: impl FnOnce(String)) -> Result<Option<Arc<Store>>, CliError> {
        let Some(folder) = self.folder() else { return Ok(None) };
        match Store::open(folder) {
            Ok(store) => Ok(Some(Arc::new(store))),
            Err(error) if self.cache.is_some() => Err(CliError::bad_input(error)),
            Err(error) => {
                warn(format!("{error}; this run does without"));
                Ok(None)
            }
        }
    }
}

fn folder(named: Option<PathBuf>) -> Option<PathBuf> {
    let variable = || std::env::var_os(VARIABLE).map(PathBuf::from);
    match named.or_else(variable) {
        Some(folder) if folder.as_os_str().is_empty() => None,
        Some(folder) => Some(folder),
        None => etcetera::choose_base_strategy().ok().map(|base| base.cache_dir().join("manyview")),
    }
}

/// Options of `cache`.
#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    #[command(subcommand)]
    command: Command,
    /// The folder of the cache [default: `MANYVIEW_CACHE`, else a folder of the user's]
    #[arg(long, value_name = "DIR", global = true)]
    cache: Option<PathBuf>,
    /// How to print it
    #[arg(long, value_enum, default_value_t = Format::Text, global = true)]
    format: Format,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Prints the folder of the cache
    Path,
    /// Counts entries and bytes
    Stat,
    /// Removes what was not used for the longest time, but nothing that a running bake uses
    Gc {
        /// Bytes to keep at most, such as 20GiB
        #[arg(long, value_name = "SIZE", default_value = "20GiB", value_parser = memory_size)]
        max_size: u64,
    },
    /// Reads every entry; removes and tells those that are broken (exit code 5)
    Verify,
}

/// Runs `cache`.
pub(crate) fn run(options: &Options) -> CliResult {
    let Some(folder) = folder(options.cache.clone()) else {
        return Err(CliError::usage(format!(
            "there is no cache: {VARIABLE} is empty, or this system has no folder for it; name one with --cache"
        )));
    };
    if matches!(options.command, Command::Path) {
        match options.format {
            Format::Text => print(&format!("{}\n", folder.display()))?,
            Format::Json => print_json(&json!({ "path": folder.display().to_string() }))?,
        }
        return Ok(Exit::Done);
    }
    if options.cache.is_some() && !folder.is_dir() {
        return Err(CliError::bad_input(format!("{}: there is no such folder", folder.display())));
    }
    let store = Store::open(folder).map_err(CliError::bad_input)?;
    match options.command {
        Command::Path => Ok(Exit::Done),
        Command::Stat => stat(&store, options.format),
        Command::Gc { max_size } => gc(&store, max_size, options.format),
        Command::Verify => verify(&store, options.format),
    }
}

fn stat(store: &Store, format: Format) -> CliResult {
    let stat = store.stat(&BUCKETS);
    match format {
        Format::Text => {
            let mut table = Table::new(["bucket", "entries", "bytes", ""]);
            for bucket in &stat.buckets {
                let note = if bucket.is_current { "" } else { "of another version; gc removes it" };
                table.row([
                    bucket.folder.clone(),
                    count(bucket.entries),
                    bytes(bucket.bytes),
                    note.to_owned(),
                ]);
            }
            table.row(["all".to_owned(), count(stat.entries()), bytes(stat.bytes()), String::new()]);
            let users = counted(stat.other_processes as u64, "running process");
            print(&format!("{}\n\n{}\nused by {users}\n", store.root().display(), table.render()))?;
        }
        Format::Json => {
            let buckets: Vec<_> = stat
                .buckets
                .iter()
                .map(|bucket| {
                    json!({
                        "bucket": bucket.folder,
                        "entries": bucket.entries,
                        "bytes": bucket.bytes,
                        "current": bucket.is_current,
                    })
                })
                .collect();
            print_json(&json!({
                "path": store.root().display().to_string(),
                "entries": stat.entries(),
                "bytes": stat.bytes(),
                "buckets": buckets,
                "running_processes": stat.other_processes,
            }))?;
        }
    }
    Ok(Exit::Done)
}

fn gc(store: &Store, max_bytes: u64, format: Format) -> CliResult {
    let report = store.gc(max_bytes, &BUCKETS);
    match format {
        Format::Text => {
            let in_use = match report.in_use_bytes {
                0 => String::new(),
                in_use => format!("; {} more are in use by running bakes", bytes(in_use)),
            };
            print(&format!(
                "removed {} with {}, kept {}{in_use}\n",
                if report.removed == 1 {
                    "1 entry".to_owned()
                } else {
                    format!("{} entries", count(report.removed))
                },
                bytes(report.removed_bytes),
                bytes(report.kept_bytes)
            ))?;
        }
        Format::Json => print_json(&json!({
            "removed_entries": report.removed,
            "removed_bytes": report.removed_bytes,
            "kept_bytes": report.kept_bytes,
            "in_use_bytes": report.in_use_bytes,
        }))?,
    }
    Ok(Exit::Done)
}

fn verify(store: &Store, format: Format) -> CliResult {
    let report = store.verify();
    let broken = report.broken.len() as u64;
    match format {
        Format::Text => {
            for (path, reason) in &report.broken {
                eprintln!("broken and removed: {}: {reason}", path.display());
            }
            print(&format!(
                "{} entries, {}: {}\n",
                count(report.entries),
                bytes(report.bytes),
                if broken == 0 { "sound".to_owned() } else { format!("{} broken", count(broken)) }
            ))?;
        }
        Format::Json => {
            let list: Vec<_> = report
                .broken
                .iter()
                .map(|(path, reason)| json!({ "path": path.display().to_string(), "reason": reason }))
                .collect();
            print_json(&json!({ "entries": report.entries, "bytes": report.bytes, "broken": list }))?;
        }
    }
    if broken == 0 {
        return Ok(Exit::Done);
    }
    let what = if broken == 1 { "entry was".to_owned() } else { "entries were".to_owned() };
    Err(CliError::new(
        Exit::Corrupt,
        anyhow::anyhow!("{} {what} broken; removed, so that the next bake makes them anew", count(broken)),
    ))
}
