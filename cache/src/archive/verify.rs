//! Checking every byte of an archive.

use rayon::prelude::*;

use super::error::{ArchiveError, corrupt, expect_equal, read_error};
use super::format::{HEADER_BYTES, section_digest};
use super::reader::Archive;
use crate::digest::Digest;

/// What [`Archive::verify`] found.
#[derive(Debug)]
pub struct VerifyReport {
    /// How many sections were checked.
    pub sections: usize,
    /// How many chunks were checked.
    pub chunks: usize,
    /// The size of the content.
    pub raw_bytes: u64,
    /// The size of the file.
    pub file_bytes: u64,
    /// Everything that is wrong, in the order of the file. Empty for a sound archive.
    pub failures: Vec<ArchiveError>,
}

impl VerifyReport {
    /// Whether nothing is wrong.
    pub fn is_sound(&self) -> bool {
        self.failures.is_empty()
    }
}

impl Archive {
    /// Checks every chunk, every section's digest and the padding between chunks. Header and index were checked when
    /// the archive was opened. Takes the memory of one chunk per thread.
    pub fn verify(&self) -> VerifyReport {
        let chunks: Vec<Result<Digest, ArchiveError>> = (0..self.chunks().len())
            .into_par_iter()
            .map_init(Vec::new, |raw, number| {
                self.verify_chunk(number, raw).map_err(|error| self.name_chunk_error(error, number))
            })
            .collect();
        let mut chunks = chunks.into_iter();
        let mut failures = Vec::new();
        for section in self.sections() {
            let range = section.chunk_range();
            match all_or_errors(chunks.by_ref().take(range.len())) {
                Ok(digests) => {
                    let sizes = self.chunks()[range].iter().map(|record| record.raw_bytes);
                    let found = section_digest(sizes.zip(digests));
                    if let Err(error) = expect_equal("digest of the content", section.digest, found) {
                        failures.push(self.name_error(error, section.id));
                    }
                }
                // The digest of a section with a broken chunk tells nothing new.
                Err(errors) => failures.extend(errors),
            }
        }
        VerifyReport {
            sections: self.sections().len(),
            chunks: self.chunks().len(),
            raw_bytes: self.sections().iter().map(|section| section.raw_bytes).sum(),
            file_bytes: self.header().file_bytes,
            failures,
        }
    }

    /// Checks a chunk and the padding behind it; returns the digest of its content.
    fn verify_chunk(&self, number: usize, raw: &mut Vec<u8>) -> Result<Digest, ArchiveError> {
        let record = &self.chunks()[number];
        raw.clear();
        raw.resize(record.raw_bytes as usize, 0);
        self.decode(record, raw)?;
        if self.is_shared(number as u32) {
            return Ok(Digest::of(raw));
        }
        let next = (number + 1..self.chunks().len()).find(|next| !self.is_shared(*next as u32));
        let padding_end = next.map_or(self.header().index_offset, |next| self.chunks()[next].offset);
        // Less than the alignment, as the index was checked.
        let mut padding = [0; HEADER_BYTES];
        let padding = &mut padding[..(padding_end - record.end()) as usize];
        self.source().read_exact_at(record.end(), padding).map_err(read_error)?;
        if padding.iter().any(|&byte| byte != 0) {
            return Err(corrupt(
                "padding behind the chunk",
                "zeros",
                format!("{:?}", padding.escape_ascii().to_string()),
            ));
        }
        Ok(Digest::of(raw))
    }
}

/// All values, or all errors.
fn all_or_errors<T, E>(results: impl Iterator<Item = Result<T, E>>) -> Result<Vec<T>, Vec<E>> {
    let (mut values, mut errors) = (Vec::new(), Vec::new());
    for result in results {
        match result {
            Ok(value) => values.push(value),
            Err(error) => errors.push(error),
        }
    }
    if errors.is_empty() { Ok(values) } else { Err(errors) }
}
