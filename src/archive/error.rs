//! What can go wrong when a bake is loaded.

use std::fmt;

use manyview_cache::archive::{ArchiveError, ArchiveErrorKind};
use manyview_shaders::svo::SvoError;
use thiserror::Error;

/// A bake could not be loaded: which archive, where in it, and which rule it breaks.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum LoadError {
    /// The container could not be read, or is corrupt.
    #[error(transparent)]
    Container(#[from] ArchiveError),
    /// A section is sound as bytes, but not what its place in a bake demands.
    #[error("{archive}: section {section}: {rule}: expected {expected}, found {found}; bake the scene again")]
    Rule {
        /// The archive's path or name.
        archive: String,
        /// The section, as `name[item]`.
        section: String,
        /// What the rule is about, as a noun.
        rule: &'static str,
        /// The value by the rule.
        expected: String,
        /// The value there.
        found: String,
    },
    /// The octree's levels do not fit together.
    #[error("{archive}: sections svo.*[{}]: {source}; bake the scene again", source.level)]
    Octree {
        /// The archive's path or name.
        archive: String,
        /// The level and the rule.
        source: SvoError,
    },
    /// The bake has no rows, which are optional.
    #[error("{archive}: the bake has no rows; bake the scene with rows first")]
    NoRows {
        /// The archive's path or name.
        archive: String,
    },
    /// The caller asked for a level, direction or block that the bake does not have.
    #[error("{archive}: there is no {what} {index}: the bake has {what}s 0 to {last}")]
    NoSuchItem {
        /// The archive's path or name.
        archive: String,
        /// What was asked for, as a noun.
        what: &'static str,
        /// The number asked for.
        index: u64,
        /// The largest number there is.
        last: u64,
    },
    /// What was asked for takes more memory than the caller allows.
    #[error(
        "{archive}: {what} takes {needed_bytes} bytes of memory, more than the limit of {limit_bytes}; load fewer levels, or raise the limit"
    )]
    OverBudget {
        /// The archive's path or name.
        archive: String,
        /// What was to be loaded.
        what: String,
        /// What it takes.
        needed_bytes: u64,
        /// What is allowed ([`Archive::with_memory_limit`](super::Archive::with_memory_limit)).
        limit_bytes: u64,
    },
    /// The system has not the memory for what was asked for.
    #[error("{archive}: there is no memory for {what}, {needed_bytes} bytes; load fewer directions")]
    OutOfMemory {
        /// The archive's path or name.
        archive: String,
        /// What was to be loaded.
        what: String,
        /// What it takes.
        needed_bytes: u64,
    },
}

impl LoadError {
    /// Whether the archive itself is at fault: its bytes contradict each other or the contract of a bake.
    pub fn is_corruption(&self) -> bool {
        match self {
            Self::Container(error) => matches!(
                error.kind(),
                ArchiveErrorKind::Corrupt { .. }
                    | ArchiveErrorKind::MissingSection
                    | ArchiveErrorKind::UnsupportedCodec { .. }
            ),
            Self::Rule { .. } | Self::Octree { .. } => true,
            Self::NoRows { .. }
            | Self::NoSuchItem { .. }
            | Self::OverBudget { .. }
            | Self::OutOfMemory { .. } => false,
        }
    }

    /// Whether the archive is too large for the memory that was allowed or is there.
    pub fn is_over_budget(&self) -> bool {
        match self {
            Self::Container(error) => matches!(
                error.kind(),
                ArchiveErrorKind::SectionTooLarge { .. } | ArchiveErrorKind::OutOfMemory { .. }
            ),
            _ => matches!(self, Self::OverBudget { .. } | Self::OutOfMemory { .. }),
        }
    }

    /// The section at fault, where there is one, as `name[item]`.
    pub fn section(&self) -> Option<String> {
        match self {
            Self::Container(error) => error.section().map(|id| id.to_string()),
            Self::Rule { section, .. } => Some(section.clone()),
            Self::Octree { source, .. } => Some(format!("svo.*[{}]", source.level)),
            _ => None,
        }
    }
}

/// A rule that a section breaks, before the archive's name is known.
pub(super) struct Broken {
    pub(super) section: String,
    pub(super) rule: &'static str,
    pub(super) expected: String,
    pub(super) found: String,
}

impl Broken {
    /// A section breaks a rule.
    pub(super) fn new(
        section: impl fmt::Display,
        rule: &'static str,
        expected: impl fmt::Display,
        found: impl fmt::Display,
    ) -> Self {
        Self { section: section.to_string(), rule, expected: expected.to_string(), found: found.to_string() }
    }

    /// Broken unless `found` is `expected`.
    pub(super) fn unless_equal<T: PartialEq + fmt::Display>(
        section: impl fmt::Display,
        rule: &'static str,
        expected: T,
        found: T,
    ) -> Result<(), Self> {
        if expected == found { Ok(()) } else { Err(Self::new(section, rule, expected, found)) }
    }

    /// As an error of an archive.
    pub(super) fn in_archive(self, archive: &str) -> LoadError {
        let Self { section, rule, expected, found } = self;
        LoadError::Rule { archive: archive.to_owned(), section, rule, expected, found }
    }
}
