//! How commands end: exit codes, and the errors that carry them.

use std::fmt;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use manyview::LoadError;
use manyview::preview::{CameraError, Cancelled};
use manyview_cache::archive::ArchiveErrorKind;
use manyview_cache::atomic::AtomicFileError;
use manyview_pipeline::import::ImportError;
use manyview_pipeline::run::RunError;
use serde_json::json;

use super::Format;

/// The exit codes that all commands share.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Exit {
    /// What was asked for is done.
    Done = 0,
    /// A bug or an unforeseen failure.
    Internal = 1,
    /// The arguments are wrong.
    Usage = 2,
    /// The input cannot be used, or the output cannot be written.
    BadInput = 3,
    /// It would take more than is allowed.
    OverBudget = 4,
    /// The archive or the cache is corrupt.
    Corrupt = 5,
    /// The user gave up.
    Cancelled = 130,
}

impl Exit {
    /// What `diff` says of archives that differ, as other tools that compare do.
    pub(crate) const DIFFERENT: Self = Self::Internal;
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        ExitCode::from(exit as u8)
    }
}

/// Opens a file that an option names.
pub(crate) fn open_input(path: &Path) -> Result<fs_err::File, CliError> {
    let failed = |error| CliError::bad_input(format!("{error}; check that the file is there and readable"));
    fs_err::File::open(path).map_err(failed)
}

/// How a command ended, if not with an error.
pub(crate) type CliResult = Result<Exit, CliError>;

/// Why a command failed, and the exit code for that.
#[derive(Debug)]
pub(crate) struct CliError {
    exit: Exit,
    error: anyhow::Error,
}

impl CliError {
    /// An error with its exit code.
    pub(crate) fn new(exit: Exit, error: impl Into<anyhow::Error>) -> Self {
        Self { exit, error: error.into() }
    }

    /// The arguments parse, but make no sense together or for this archive.
    pub(crate) fn usage(message: impl fmt::Display) -> Self {
        Self::new(Exit::Usage, anyhow::anyhow!("{message}"))
    }

    /// An input is wrong.
    pub(crate) fn bad_input(message: impl fmt::Display) -> Self {
        Self::new(Exit::BadInput, anyhow::anyhow!("{message}"))
    }

    /// The file that a bake looked for in vain, if that was the trouble.
    pub(crate) fn missing_file(&self) -> Option<PathBuf> {
        match self.error.downcast_ref::<RunError>() {
            Some(RunError::Import(ImportError::Unreadable { path, .. })) => Some(path.clone()),
            _ => None,
        }
    }

    /// Says on stderr what is wrong, in words or as a JSON event.
    pub(crate) fn tell(&self, format: Format) {
        let message = self.to_string();
        match format {
            Format::Json => {
                let exit_code = self.exit as i32;
                eprintln!("{}", json!({ "event": "error", "exit_code": exit_code, "message": message }));
            }
            Format::Text => eprintln!("error: {message}"),
        }
    }

    /// The exit code.
    pub(crate) fn exit(&self) -> Exit {
        self.exit
    }
}

impl fmt::Display for CliError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Messages of the library already tell their causes.
        write!(f, "{}", self.error)
    }
}

impl From<LoadError> for CliError {
    fn from(error: LoadError) -> Self {
        let exit = if error.is_corruption() {
            Exit::Corrupt
        } else if error.is_over_budget() {
            Exit::OverBudget
        } else {
            match &error {
                LoadError::NoSuchItem { .. } => Exit::Usage,
                _ => Exit::BadInput,
            }
        };
        if let LoadError::Container(container) = &error
            && let ArchiveErrorKind::Read { source } = container.kind()
            && source.kind() == std::io::ErrorKind::NotFound
        {
            let message = format!(
                "{}: there is no such file; name an archive that `manyview bake` made",
                container.archive()
            );
            return Self::bad_input(message);
        }
        Self::new(exit, error)
    }
}

impl From<AtomicFileError> for CliError {
    fn from(error: AtomicFileError) -> Self {
        Self::new(Exit::BadInput, error)
    }
}

impl From<CameraError> for CliError {
    fn from(error: CameraError) -> Self {
        Self::new(Exit::BadInput, error)
    }
}

impl From<Cancelled> for CliError {
    fn from(error: Cancelled) -> Self {
        Self::new(Exit::Cancelled, error)
    }
}
