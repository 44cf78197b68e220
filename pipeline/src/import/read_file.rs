//! Reading files that somebody may be writing.

use std::io::{self, Read};
use std::path::Path;

/// All bytes of the file at `path`. An error if its size or its time of change is another one after reading than
/// before: half of an old file and half of a new one are no scene, even where they parse. (A file system's clock ticks
/// in milliseconds; a change within the same tick and of the same size is not seen.)
pub(super) fn read_unchanged(path: &Path) -> io::Result<Vec<u8>> {
    let file = fs_err::File::open(path)?;
    let before = file.metadata()?;
    // No more memory than the size that was checked against the limit, if the file grows meanwhile.
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(usize::try_from(before.len()).unwrap_or(usize::MAX))?;
    (&file).take(before.len().saturating_add(1)).read_to_end(&mut bytes)?;
    let after = file.metadata()?;
    let unchanged = bytes.len() as u64 == before.len()
        && after.len() == before.len()
        && after.modified().ok() == before.modified().ok();
    if !unchanged {
        let reason =
            format!("`{}` was changed while it was read; try again once it is written", path.display());
        return Err(io::Error::other(reason));
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_at_rest_is_read_whole() {
        let folder = tempfile::tempdir().unwrap();
        for bytes in [&b""[..], b"x", &[7; 100_000]] {
            fs_err::write(folder.path().join("a"), bytes).unwrap();
            assert_eq!(read_unchanged(&folder.path().join("a")).unwrap(), bytes);
        }
    }

    #[test]
    fn a_file_that_grows_is_refused() {
        use std::sync::atomic::{AtomicBool, Ordering};
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("growing");
        let done = AtomicBool::new(false);
        let message = std::thread::scope(|scope| {
            scope.spawn(|| {
                let mut file = fs_err::File::create(&path).unwrap();
                while !done.load(Ordering::Relaxed) {
                    io::Write::write_all(&mut file, &[1; 4096]).unwrap();
                    if file.metadata().unwrap().len() > 64 << 20 {
                        file.set_len(0).unwrap();
                        io::Seek::rewind(&mut file).unwrap();
                    }
                }
            });
            let start = std::time::Instant::now();
            let message = loop {
                if let Err(error) = read_unchanged(&path)
                    && error.kind() != io::ErrorKind::NotFound
                {
                    break Some(error.to_string());
                }
                if start.elapsed().as_secs() > 30 {
                    break None;
                }
            };
            done.store(true, Ordering::Relaxed);
            message
        });
        let message = message.expect("no change was seen");
        assert!(message.contains("growing") && message.contains("was changed"), "{message}");
    }
}
