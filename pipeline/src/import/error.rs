//! Why a scene could not be imported.

use std::io;
use std::path::PathBuf;

/// Why a scene could not be imported; every message names the file, the place in it, the rule or limit, and a way out.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// A file is missing, is no file, or may not be read.
    #[error("{file}: {place} cannot be read: {source}; check that the file is there and readable")]
    Unreadable {
        /// The scene file.
        file: String,
        /// The file that could not be read.
        path: PathBuf,
        /// What refers to it, such as `buffers[0].uri`.
        place: String,
        /// The operating system's answer, which names the path.
        source: io::Error,
    },
    /// A URI leaves the scene's folder, by its text or through a symbolic link.
    #[error(
        "{file}: {place} = \"{uri}\" leaves the scene's folder; move the file beside the scene, or allow files outside of it"
    )]
    Outside {
        /// The scene file.
        file: String,
        /// Where the URI stands.
        place: String,
        /// The URI as written.
        uri: String,
    },
    /// The file breaks a rule of glTF 2.0 that the bake relies on.
    #[error(
        "{file}: {place}: {rule}; export the scene again, or see what the Khronos glTF validator says about it"
    )]
    Malformed {
        /// The scene file, or the file beside it that is wrong.
        file: String,
        /// Where in the file.
        place: String,
        /// The rule that is broken.
        rule: String,
    },
    /// The file needs a feature that this importer lacks.
    #[error("{file}: {place}: {feature} is not supported; {way_out}")]
    Unsupported {
        /// The scene file.
        file: String,
        /// Where in the file.
        place: String,
        /// Name of the extension or feature.
        feature: String,
        /// What to do about it.
        way_out: String,
    },
    /// The scene is larger than the caller allows.
    #[error("{file}: {place}: {what} would be {value}, over the limit of {limit}; {fix}")]
    OverLimit {
        /// The scene file.
        file: String,
        /// Where in the file.
        place: String,
        /// What is counted, with its unit.
        what: &'static str,
        /// How much there would be.
        value: u64,
        /// How much is allowed.
        limit: u64,
        /// What to do about it.
        fix: &'static str,
    },
}
