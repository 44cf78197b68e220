//! Room on disk for what does not fit in memory.
//!
//! A scratch file lies beside the output that it helps to make, hidden under the same kind of name as the output's
//! unfinished file ([`crate::atomic`]), so that what a killed process leaves is removed the same way. Where the system
//! allows it, its name is gone as soon as it is open: then nothing is ever left.

use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::atomic::{self, AtomicFileError};

/// A file that lives as long as this value.
pub struct ScratchFile {
    file: fs_err::File,
    /// Its name, where it still has one.
    path: Option<PathBuf>,
    end: u64,
}

impl ScratchFile {
    /// Makes an empty file in the folder of `output`.
    pub fn beside(output: &Path) -> Result<Self, AtomicFileError> {
        let (path, file) = atomic::create_hidden(output)?;
        // Elsewhere an open file keeps its name, or loses it only when it is closed.
        let is_nameless = cfg!(unix) && fs_err::remove_file(&path).is_ok();
        Ok(Self { file, path: (!is_nameless).then_some(path), end: 0 })
    }

    /// Appends bytes; where they begin.
    pub fn append(&mut self, bytes: &[u8]) -> io::Result<u64> {
        let start = self.end;
        self.file.seek(SeekFrom::Start(start))?;
        self.file.write_all(bytes)?;
        self.end += bytes.len() as u64;
        Ok(start)
    }

    /// Reads bytes that were appended.
    pub fn read(&mut self, start: u64, count: usize) -> io::Result<Vec<u8>> {
        let mut bytes = vec![0; count];
        self.file.seek(SeekFrom::Start(start))?;
        self.file.read_exact(&mut bytes)?;
        Ok(bytes)
    }
}

impl Drop for ScratchFile {
    fn drop(&mut self) {
        if let Some(path) = &self.path {
            // Failing is harmless: the next writer of the output removes the file.
            _ = fs_err::remove_file(path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_appended_can_be_read_and_nothing_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let mut scratch = ScratchFile::beside(&folder.path().join("out.mvb")).unwrap();
        assert_eq!(scratch.append(b"one").unwrap(), 0);
        assert_eq!(scratch.append(b"three").unwrap(), 3);
        assert_eq!(scratch.read(0, 3).unwrap(), b"one");
        assert_eq!(scratch.append(b"!").unwrap(), 8, "reading moves nothing");
        assert_eq!(scratch.read(3, 6).unwrap(), b"three!");
        assert!(scratch.read(8, 2).is_err(), "beyond the end");
        drop(scratch);
        assert_eq!(fs_err::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_folder_that_is_not_there_is_told_of() {
        let folder = tempfile::tempdir().unwrap();
        let Err(error) = ScratchFile::beside(&folder.path().join("gone/out.mvb")) else {
            panic!("there is no such folder");
        };
        assert!(error.to_string().contains("make the folder first"), "{error}");
    }
}
