//! Chunks that are made long before their place in the archive comes.

use std::borrow::Cow;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use super::chunk::{Codec, CompressedChunk};
use super::error::{ArchiveError, read_error, write_error};
use crate::digest::Digest;
use crate::scratch::ScratchFile;

/// Keeps chunks until they are written: in memory up to a limit, the others in a file beside the archive
/// ([`ScratchFile`]). Many threads may add to it.
pub struct ChunkSpool {
    /// The archive, if it is a file.
    output: Option<PathBuf>,
    limit_bytes: u64,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    held_bytes: u64,
    file: Option<ScratchFile>,
}

/// A chunk in a [`ChunkSpool`].
#[derive(Debug)]
pub struct SpooledChunk(Place);

#[derive(Debug)]
enum Place {
    Memory(CompressedChunk),
    File { start: u64, stored_bytes: u32, raw_bytes: u32, codec: Codec, digests: Box<[Digest; 2]> },
}

impl ChunkSpool {
    /// Keeps about `limit_bytes` in memory; without an `output` everything.
    pub(super) fn new(output: Option<PathBuf>, limit_bytes: u64) -> Self {
        Self { output, limit_bytes, state: Mutex::default() }
    }

    /// Takes a chunk. Of a chunk in tiles, what a [`TileEditor`](super::TileEditor) needs is lost.
    pub fn push(&self, chunk: CompressedChunk) -> Result<SpooledChunk, ArchiveError> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let bytes = chunk.stored().len() as u64 + size_of::<CompressedChunk>() as u64;
        let fits = state.held_bytes + bytes <= self.limit_bytes;
        let Some(output) = self.output.as_ref().filter(|_| !fits) else {
            state.held_bytes += bytes;
            return Ok(SpooledChunk(Place::Memory(chunk)));
        };
        let file = match state.file.take() {
            Some(file) => file,
            None => ScratchFile::beside(output)?,
        };
        let named = |error: ArchiveError| error.in_archive(&output.display().to_string());
        let start = state.file.insert(file).append(chunk.stored()).map_err(|e| named(write_error(e)))?;
        let record = chunk.record_at(start);
        Ok(SpooledChunk(Place::File {
            start,
            stored_bytes: record.stored_bytes,
            raw_bytes: record.raw_bytes,
            codec: record.codec,
            digests: Box::new([chunk.raw_digest(), record.stored_digest]),
        }))
    }

    /// A chunk that was taken.
    pub fn get<'c>(&self, chunk: &'c SpooledChunk) -> Result<Cow<'c, CompressedChunk>, ArchiveError> {
        let (start, stored_bytes, raw_bytes, codec, digests) = match &chunk.0 {
            Place::Memory(chunk) => return Ok(Cow::Borrowed(chunk)),
            Place::File { start, stored_bytes, raw_bytes, codec, digests } => {
                (*start, *stored_bytes, *raw_bytes, *codec, digests)
            }
        };
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let read = match state.file.as_mut() {
            Some(file) => file.read(start, stored_bytes as usize),
            None => Err(std::io::Error::other("the chunk is of another spool")),
        };
        let name = self.output.as_ref().map_or(String::new(), |output| output.display().to_string());
        let stored = read.map_err(|error| read_error(error).in_archive(&name))?;
        let [raw_digest, stored_digest] = **digests;
        Ok(Cow::Owned(CompressedChunk::of_stored(stored, raw_bytes, codec, raw_digest, stored_digest)))
    }

    /// Whether chunks had to go to disk.
    pub fn is_on_disk(&self) -> bool {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).file.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_come_back_as_they_were_from_memory_and_disk() {
        let folder = tempfile::tempdir().unwrap();
        let chunks: Vec<_> = (0..20u8)
            .map(|i| CompressedChunk::compress(&vec![i; 1000 + usize::from(i)], 3))
            .chain([CompressedChunk::compress(&[1, 2, 3], 3)])
            .collect();
        for (limit, is_on_disk) in [(0, true), (500, true), (1 << 20, false)] {
            let spool = ChunkSpool::new(Some(folder.path().join("out.mvb")), limit);
            let spooled: Vec<_> = chunks.iter().map(|chunk| spool.push(chunk.clone()).unwrap()).collect();
            assert_eq!(spool.is_on_disk(), is_on_disk);
            for (chunk, spooled) in chunks.iter().zip(&spooled).rev() {
                assert_eq!(&*spool.get(spooled).unwrap(), chunk);
            }
        }
        assert_eq!(fs_err::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn archives_in_memory_keep_everything_there() {
        let spool = ChunkSpool::new(None, 0);
        let chunk = CompressedChunk::compress(&[5; 100], 3);
        let spooled = spool.push(chunk.clone()).unwrap();
        assert_eq!(&*spool.get(&spooled).unwrap(), &chunk);
    }
}
