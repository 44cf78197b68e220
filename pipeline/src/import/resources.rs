//! Bytes that a scene refers to: files beside it, data URIs, the binary chunk, buffer views; and the memory they take.

use super::error::ImportError;
use super::json::Json;
use super::meshopt;
use super::read_file::read_unchanged;
use super::uri::{self, Location};
use super::{ImportOptions, SourceFile};
use std::cell::{Cell, OnceCell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Most warnings that are kept; the rest is counted.
const MAX_WARNINGS: usize = 100;

/// Reads and keeps what a scene refers to, each thing once and only when it is needed.
pub(super) struct Resources<'a> {
    /// The whole document.
    pub(super) root: Json<'a>,
    options: &'a ImportOptions,
    folder: PathBuf,
    bin: Option<&'a [u8]>,
    buffers: Vec<OnceCell<Vec<u8>>>,
    views: Vec<OnceCell<Vec<u8>>>,
    files: RefCell<BTreeMap<String, SourceFile>>,
    warnings: RefCell<Warnings>,
    used_bytes: Cell<u64>,
}

/// Warnings in the order in which they came up.
#[derive(Debug, Default)]
struct Warnings {
    kept: Vec<String>,
    known: BTreeSet<String>,
    dropped: u64,
}

/// Bytes of a buffer view, and the distance between its elements if it tells one.
#[derive(Debug, Clone, Copy)]
pub(super) struct View<'r> {
    pub(super) bytes: &'r [u8],
    pub(super) stride: Option<usize>,
}

impl<'a> Resources<'a> {
    /// Resources of the document `root`, whose relative URIs start at `folder`.
    pub(super) fn new(
        root: Json<'a>,
        folder: &Path,
        bin: Option<&'a [u8]>,
        options: &'a ImportOptions,
    ) -> Result<Self, ImportError> {
        let cells = |key: &str| Ok::<_, ImportError>((0..root.len(key)?).map(|_| OnceCell::new()).collect());
        Ok(Self {
            buffers: cells("buffers")?,
            views: cells("bufferViews")?,
            root,
            options,
            folder: folder.to_owned(),
            bin,
            files: RefCell::default(),
            warnings: RefCell::default(),
            used_bytes: Cell::new(0),
        })
    }

    /// Says what was left out or forgiven; the same sentence only once.
    pub(super) fn warn(&self, sentence: String) {
        let mut warnings = self.warnings.borrow_mut();
        if warnings.kept.len() == MAX_WARNINGS {
            warnings.dropped += 1;
        } else if warnings.known.insert(sentence.clone()) {
            warnings.kept.push(sentence);
        }
    }

    /// Notes a file that was read, or looked for in vain.
    pub(super) fn note_file(&self, path: String, content: Option<&[u8]>) {
        let hash = content.map(blake3::hash);
        self.files.borrow_mut().insert(path.clone(), SourceFile { path, hash });
    }

    /// All files and warnings so far.
    pub(super) fn finish(self) -> (Vec<SourceFile>, Vec<String>) {
        let Warnings { mut kept, dropped, .. } = self.warnings.into_inner();
        if dropped > 0 {
            kept.push(format!("{dropped} more warnings are left out"));
        }
        (self.files.into_inner().into_values().collect(), kept)
    }

    /// Takes `bytes` from the memory that the import may use, before they are allocated.
    pub(super) fn charge(&self, bytes: u64, place: &str) -> Result<(), ImportError> {
        let used = self.used_bytes.get().saturating_add(bytes);
        if used > self.options.max_memory_bytes {
            return Err(ImportError::OverLimit {
                file: self.root.file().to_owned(),
                place: place.to_owned(),
                what: "memory of the import in bytes",
                value: used,
                limit: self.options.max_memory_bytes,
                fix: "raise the memory limit, or make the scene smaller",
            });
        }
        self.used_bytes.set(used);
        Ok(())
    }

    /// Memory that the import may still use.
    pub(super) fn available_bytes(&self) -> u64 {
        self.options.max_memory_bytes - self.used_bytes.get()
    }

    /// The bytes that the URI `text` at `place` stands for.
    pub(super) fn load(&self, place: &str, text: &str) -> Result<Vec<u8>, ImportError> {
        match uri::locate(self.root.file(), place, text, &self.folder, self.options.allow_outside)? {
            Location::Data(bytes) => {
                self.charge(bytes.len() as u64, place)?;
                Ok(bytes)
            }
            Location::File { path, relative } => {
                let unreadable = |source| ImportError::Unreadable {
                    file: self.root.file().to_owned(),
                    path: path.clone(),
                    place: place.to_owned(),
                    source,
                };
                let read = (|| {
                    let metadata = fs_err::metadata(&path)?;
                    if !metadata.is_file() {
                        return Err(std::io::Error::other(format!(
                            "`{}` is no regular file",
                            path.display()
                        )));
                    }
                    Ok(metadata.len())
                })();
                let length =
                    read.inspect_err(|_| self.note_file(relative.clone(), None)).map_err(unreadable)?;
                self.charge(length, place)?;
                let bytes = read_unchanged(&path).map_err(unreadable)?;
                self.note_file(relative, Some(&bytes));
                Ok(bytes)
            }
        }
    }

    /// Bytes of buffer `index`, at least as many as its `byteLength`.
    fn buffer(&self, index: usize) -> Result<&[u8], ImportError> {
        let buffer = self.root.item("buffers", index)?;
        let length = buffer.required_index("byteLength")?;
        let bytes: &[u8] = match (buffer.string("uri")?, self.bin) {
            (None, Some(bin)) if index == 0 => bin,
            (None, _) => {
                return Err(buffer.malformed("has no uri and is not the binary chunk, so it has no data"));
            }
            (Some(uri), _) => match self.buffers[index].get() {
                Some(bytes) => bytes,
                None => {
                    let bytes = self.load(&buffer.place_of("uri"), uri)?;
                    self.buffers[index].get_or_init(|| bytes)
                }
            },
        };
        bytes.get(..length).ok_or_else(|| {
            buffer.malformed(format!("byteLength is {length}, but there are only {} bytes", bytes.len()))
        })
    }

    /// The part of a buffer that `place` (a buffer view or its compression extension) names.
    fn part(&self, place: &Json<'a>) -> Result<&[u8], ImportError> {
        let buffer = place.required_index("buffer")?;
        let offset = place.index("byteOffset")?.unwrap_or(0);
        let length = place.required_index("byteLength")?;
        let bytes = self.buffer(buffer)?;
        offset.checked_add(length).and_then(|end| bytes.get(offset..end)).ok_or_else(|| {
            place.malformed(format!(
                "byteOffset {offset} and byteLength {length} reach beyond the {} bytes of buffers[{buffer}]",
                bytes.len()
            ))
        })
    }

    /// Bytes of buffer view `index`, decompressed if they are compressed.
    pub(super) fn view(&self, index: usize) -> Result<View<'_>, ImportError> {
        let view = self.root.item("bufferViews", index)?;
        let compressed = ["EXT_meshopt_compression", "KHR_meshopt_compression"]
            .iter()
            .find_map(|name| view.extension(name));
        let Some(compressed) = compressed else {
            let stride = view.index("byteStride")?.filter(|stride| *stride > 0);
            return Ok(View { bytes: self.part(&view)?, stride });
        };
        let stride = Some(compressed.required_index("byteStride")?);
        let bytes = match self.views[index].get() {
            Some(bytes) => bytes,
            None => {
                let encoded = self.part(&compressed)?;
                let job = meshopt::Job::parse(&compressed, encoded.len())?;
                self.charge(job.decoded_bytes(), &compressed.place())?;
                let bytes = job.decode(encoded).map_err(|rule| compressed.malformed(rule))?;
                self.views[index].get_or_init(|| bytes)
            }
        };
        Ok(View { bytes, stride })
    }
}
