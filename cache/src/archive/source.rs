//! Where the bytes of an archive come from.

use std::io;

/// Bytes that can be read in ranges, from several threads at once: a file, memory, a server.
pub trait ByteSource: Send + Sync {
    /// How many bytes there are.
    fn byte_count(&self) -> io::Result<u64>;

    /// Fills `buffer` with the bytes from `offset` on. Fewer bytes are an error.
    fn read_exact_at(&self, offset: u64, buffer: &mut [u8]) -> io::Result<()>;

    /// All bytes, where they are in memory anyway.
    fn in_memory(&self) -> Option<&[u8]> {
        None
    }
}

impl ByteSource for Vec<u8> {
    fn byte_count(&self) -> io::Result<u64> {
        Ok(self.len() as u64)
    }

    fn read_exact_at(&self, offset: u64, buffer: &mut [u8]) -> io::Result<()> {
        let bytes = usize::try_from(offset)
            .ok()
            .and_then(|start| self.get(start..start.checked_add(buffer.len())?))
            .ok_or(io::ErrorKind::UnexpectedEof)?;
        buffer.copy_from_slice(bytes);
        Ok(())
    }

    fn in_memory(&self) -> Option<&[u8]> {
        Some(self)
    }
}

/// A file, read at positions. Mapping it would be as fast, but a file that shrinks while mapped kills the process.
#[cfg(unix)]
pub(super) struct FileSource(pub(super) fs_err::File);

#[cfg(unix)]
impl ByteSource for FileSource {
    fn byte_count(&self) -> io::Result<u64> {
        Ok(self.0.metadata()?.len())
    }

    fn read_exact_at(&self, offset: u64, buffer: &mut [u8]) -> io::Result<()> {
        std::os::unix::fs::FileExt::read_exact_at(self.0.file(), buffer, offset)
    }
}

/// A file whose position all threads share.
#[cfg(not(unix))]
pub(super) struct FileSource(std::sync::Mutex<fs_err::File>);

#[cfg(not(unix))]
impl ByteSource for FileSource {
    fn byte_count(&self) -> io::Result<u64> {
        let file = self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        Ok(file.metadata()?.len())
    }

    fn read_exact_at(&self, offset: u64, buffer: &mut [u8]) -> io::Result<()> {
        use std::io::{Read, Seek};
        let mut file = self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        file.seek(io::SeekFrom::Start(offset))?;
        file.read_exact(buffer)
    }
}

impl FileSource {
    pub(super) fn new(file: fs_err::File) -> Self {
        #[cfg(unix)]
        return Self(file);
        #[cfg(not(unix))]
        return Self(std::sync::Mutex::new(file));
    }
}
