//! What can go wrong with an archive.

use std::fmt;
use std::io;

use super::format::SectionId;
use crate::atomic::{AtomicFileError, advice};

/// An archive could not be written or read: which, where in it, and why.
#[derive(Debug)]
pub struct ArchiveError(Box<Inner>);

#[derive(Debug)]
struct Inner {
    archive: String,
    section: Option<SectionId>,
    chunk: Option<u32>,
    kind: ArchiveErrorKind,
}

/// The reasons.
#[derive(Debug)]
#[non_exhaustive]
pub enum ArchiveErrorKind {
    /// The bytes could not be read.
    Read {
        /// Why it failed.
        source: io::Error,
    },
    /// The bytes could not be written.
    Write {
        /// What was tried, as in "cannot … it".
        action: &'static str,
        /// Why it failed.
        source: io::Error,
    },
    /// The file does not begin like an archive.
    NotAnArchive {
        /// How it begins.
        found: String,
    },
    /// The archive is of a format version that this program does not read.
    UnsupportedVersion {
        /// The version in the file.
        found: u32,
        /// The version that this program reads.
        supported: u32,
    },
    /// A chunk is compressed in a way that this program does not know.
    UnsupportedCodec {
        /// The codec in the index.
        found: u8,
    },
    /// The bytes contradict each other.
    Corrupt {
        /// What is wrong, as a noun.
        what: &'static str,
        /// What should be there.
        expected: String,
        /// What is there.
        found: String,
    },
    /// The archive has no such section.
    MissingSection,
    /// A section's content is larger than the reader accepts.
    SectionTooLarge {
        /// Its size.
        raw_bytes: u64,
        /// The most that is accepted; see [`Archive::with_section_limit`](super::Archive::with_section_limit).
        limit_bytes: u64,
    },
    /// There is not enough memory for the content.
    OutOfMemory {
        /// How much was asked for.
        bytes: u64,
    },
    /// The writer was asked for something that the format cannot express.
    NotExpressible {
        /// What, and what to do instead.
        reason: String,
    },
}

impl ArchiveError {
    /// The path or name of the archive.
    pub fn archive(&self) -> &str {
        &self.0.archive
    }

    /// The section, where the error has to do with one.
    pub fn section(&self) -> Option<SectionId> {
        self.0.section
    }

    /// The number of the chunk in the whole archive, where the error has to do with one.
    pub fn chunk(&self) -> Option<u32> {
        self.0.chunk
    }

    /// The reason.
    pub fn kind(&self) -> &ArchiveErrorKind {
        &self.0.kind
    }

    /// Names the archive.
    pub(crate) fn in_archive(mut self, archive: &str) -> Self {
        archive.clone_into(&mut self.0.archive);
        self
    }

    pub(crate) fn in_section(mut self, section: SectionId) -> Self {
        self.0.section = Some(section);
        self
    }

    pub(crate) fn in_chunk(mut self, chunk: usize) -> Self {
        self.0.chunk = u32::try_from(chunk).ok();
        self
    }
}

impl From<ArchiveErrorKind> for ArchiveError {
    fn from(kind: ArchiveErrorKind) -> Self {
        Self(Box::new(Inner { archive: String::new(), section: None, chunk: None, kind }))
    }
}

impl From<AtomicFileError> for ArchiveError {
    fn from(error: AtomicFileError) -> Self {
        let path = error.path.display().to_string();
        Self::from(ArchiveErrorKind::Write { action: error.action, source: error.source }).in_archive(&path)
    }
}

pub(crate) fn read_error(source: io::Error) -> ArchiveError {
    ArchiveErrorKind::Read { source }.into()
}

pub(crate) fn write_error(source: io::Error) -> ArchiveError {
    ArchiveErrorKind::Write { action: "write it", source }.into()
}

/// The archive is corrupt.
pub(crate) fn corrupt(
    what: &'static str,
    expected: impl fmt::Display,
    found: impl fmt::Display,
) -> ArchiveError {
    ArchiveErrorKind::Corrupt { what, expected: expected.to_string(), found: found.to_string() }.into()
}

/// The archive is corrupt unless `expected` is what was `found`.
pub(crate) fn expect_equal<T: PartialEq + fmt::Display>(
    what: &'static str,
    expected: T,
    found: T,
) -> Result<(), ArchiveError> {
    if expected == found { Ok(()) } else { Err(corrupt(what, expected, found)) }
}

impl fmt::Display for ArchiveError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Inner { archive, section, chunk, kind } = &*self.0;
        f.write_str(if archive.is_empty() { "archive" } else { archive })?;
        if let Some(section) = section {
            write!(f, ": section {section}")?;
        }
        if let Some(chunk) = chunk {
            write!(f, ": chunk {chunk}")?;
        }
        write!(f, ": {kind}")
    }
}

impl fmt::Display for ArchiveErrorKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Read { source } => write!(f, "cannot read it: {source}"),
            Self::Write { action, source } => write!(f, "cannot {action}: {source}{}", advice(source.kind())),
            Self::NotAnArchive { found } => write!(f, "not a manyview archive: it begins with {found}"),
            Self::UnsupportedVersion { found, supported } => {
                let way_out = if found > supported { "update manyview" } else { "bake the scene again" };
                write!(
                    f,
                    "archive format version {found}, but this program reads version {supported}; {way_out}"
                )
            }
            Self::UnsupportedCodec { found: found @ (2 | 3) } => {
                write!(f, "codec {found} is of an older manyview, and no longer known: bake again")
            }
            Self::UnsupportedCodec { found } => {
                write!(
                    f,
                    "codec {found} is unknown to this program (it knows 0 raw, 1 zstd, 4 rows, 5 masks); update manyview"
                )
            }
            Self::Corrupt { what, expected, found } => {
                write!(f, "corrupt archive: {what}: expected {expected}, found {found}")
            }
            Self::MissingSection => f.write_str("the archive has no such section"),
            Self::SectionTooLarge { raw_bytes, limit_bytes } => {
                write!(f, "the section holds {raw_bytes} bytes, more than the limit of {limit_bytes}")
            }
            Self::OutOfMemory { bytes } => write!(f, "not enough memory for {bytes} bytes"),
            Self::NotExpressible { reason } => f.write_str(reason),
        }
    }
}

impl std::error::Error for ArchiveError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match &self.0.kind {
            ArchiveErrorKind::Read { source } | ArchiveErrorKind::Write { source, .. } => Some(source),
            _ => None,
        }
    }
}
