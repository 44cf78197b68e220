//! Output files that are either complete or absent.
//!
//! An output is written to a hidden file beside it, `.NAME.PID-N.mvpart`, and renamed over it once it is complete and
//! on disk. Whoever fails, or is killed, leaves the old output as it was. A killed process leaves its hidden file; the
//! next process to write the same output removes it. The owner of a hidden file holds a lock on it, so that a live
//! process never loses its own.

use std::ffi::{OsStr, OsString};
use std::fmt;
use std::fs::TryLockError;
use std::io::{self, BufWriter, ErrorKind, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;

/// The ending of unfinished files.
const PART_SUFFIX: &str = ".mvpart";

/// Large enough that a write is worth its system call.
const BUFFER_BYTES: usize = 1 << 20;

/// An output file could not be written. The output is as it was before.
#[derive(Debug)]
pub struct AtomicFileError {
    /// The output, not the hidden file beside it.
    pub path: PathBuf,
    /// What was tried, as in "cannot … the file".
    pub action: &'static str,
    /// Why it failed.
    pub source: io::Error,
}

impl fmt::Display for AtomicFileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: cannot {}: {}", self.path.display(), self.action, self.source)?;
        f.write_str(advice(self.source.kind()))
    }
}

impl std::error::Error for AtomicFileError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        Some(&self.source)
    }
}

/// What to do about an error while writing, as the end of a sentence.
pub(crate) fn advice(kind: ErrorKind) -> &'static str {
    match kind {
        ErrorKind::NotFound | ErrorKind::NotADirectory => "; make the folder first, or name another output",
        ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => {
            "; the folder must be writable, since the output is made beside its old version and then replaces it"
        }
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge => {
            "; free some space (the old and the new output exist side by side for a moment)"
        }
        _ => "",
    }
}

/// A file that appears under its name only when [committed](AtomicFile::commit); dropped without, it leaves no trace.
pub struct AtomicFile {
    /// `None` once committed or abandoned.
    file: Option<BufWriter<fs_err::File>>,
    part: PathBuf,
    /// The path as given, for messages.
    output: PathBuf,
    /// The path to replace: `output`, or what it links to.
    target: PathBuf,
    /// Bytes written since the disk was last asked to take them.
    unsynced: usize,
    early: Option<EarlySync>,
}

/// A file that grows is put on disk piece by piece while the next piece is being made: a large one would else keep its
/// maker waiting at the end.
struct EarlySync {
    requests: SyncSender<()>,
    thread: JoinHandle<()>,
}

/// Pieces of this size are worth waking the disk for.
const EARLY_SYNC_BYTES: usize = 24 << 20;

impl EarlySync {
    fn start(file: &fs_err::File) -> Option<Self> {
        let file = file.file().try_clone().ok()?;
        let (requests, inbox) = sync_channel::<()>(1);
        let thread = std::thread::spawn(move || {
            for () in inbox {
                // Only a head start: the sync that counts comes at the end.
                _ = file.sync_data();
            }
        });
        Some(Self { requests, thread })
    }

    fn finish(self) {
        drop(self.requests);
        _ = self.thread.join();
    }
}

impl AtomicFile {
    /// Starts a new version of the file at `output`, whose folder must exist. Removes what killed processes left of
    /// earlier versions.
    pub fn create(output: impl AsRef<Path>) -> Result<Self, AtomicFileError> {
        let output = output.as_ref();
        let fail = |action| move |source| AtomicFileError { path: output.to_owned(), action, source };
        let target = replaceable_target(output).map_err(fail("replace it"))?;
        let name = target
            .file_name()
            .ok_or_else(|| io::Error::new(ErrorKind::InvalidInput, "the path names no file"))
            .map_err(fail("create it"))?;
        let folder = folder_of(&target);
        remove_stale_parts(folder, name);
        let (part, file) = create_part(folder, name).map_err(fail("create it"))?;
        let file = BufWriter::with_capacity(BUFFER_BYTES, file);
        Ok(Self { file: Some(file), part, output: output.to_owned(), target, unsynced: 0, early: None })
    }

    /// The path of the output.
    pub fn path(&self) -> &Path {
        &self.output
    }

    /// Puts the file on disk and in place of the old version.
    pub fn commit(mut self) -> Result<(), AtomicFileError> {
        let result = self.try_commit();
        if result.is_err() {
            self.abandon();
        }
        result.map_err(|(action, source)| AtomicFileError { path: self.output.clone(), action, source })
    }

    fn try_commit(&mut self) -> Result<(), (&'static str, io::Error)> {
        let file = self.writer().map_err(|e| ("write it", e))?;
        file.flush().map_err(|e| ("write it", e))?;
        if let Some(early) = self.early.take() {
            early.finish();
        }
        let file = self.writer().map_err(|e| ("write it", e))?;
        file.get_ref().sync_all().map_err(|e| ("write it to disk", e))?;
        fs_err::rename(&self.part, &self.target).map_err(|e| ("replace it", e))?;
        // From here on the output is the new one; the lock goes with the file handle.
        self.file = None;
        sync_folder(folder_of(&self.target)).map_err(|e| ("write its folder to disk", e))
    }

    fn writer(&mut self) -> io::Result<&mut BufWriter<fs_err::File>> {
        self.file.as_mut().ok_or_else(|| io::Error::other("the file was already finished"))
    }

    /// Asks the disk to begin with what is written, where there is much.
    fn sync_early(&mut self, written: usize) {
        self.unsynced += written;
        if self.unsynced < EARLY_SYNC_BYTES {
            return;
        }
        self.unsynced = 0;
        if self.early.is_none() {
            self.early = self.file.as_ref().and_then(|file| EarlySync::start(file.get_ref()));
        }
        if let Some(early) = &self.early {
            // While it is at work on one piece, the next may grow.
            _ = early.requests.try_send(());
        }
    }

    fn abandon(&mut self) {
        if let Some(early) = self.early.take() {
            early.finish();
        }
        if let Some(file) = self.file.take() {
            // Without its buffer: nobody will read it.
            let (file, _) = file.into_parts();
            // First the name, then the lock. Failing here is harmless: the next writer of this output removes the file.
            _ = fs_err::remove_file(&self.part);
            drop(file);
        }
    }
}

impl Drop for AtomicFile {
    fn drop(&mut self) {
        self.abandon();
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.writer()?.write(bytes)?;
        self.sync_early(written);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer()?.flush()
    }
}

impl Seek for AtomicFile {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        self.writer()?.seek(position)
    }
}

/// Follows links, so that the file they lead to is replaced and not the link; refuses what a rename would destroy.
fn replaceable_target(output: &Path) -> io::Result<PathBuf> {
    match fs_err::symlink_metadata(output) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(output.to_owned()),
        Err(error) => Err(error),
        Ok(found) if found.is_file() => Ok(output.to_owned()),
        Ok(found) if found.is_symlink() => {
            let target = fs_err::canonicalize(output)?;
            if fs_err::metadata(&target)?.is_file() { Ok(target) } else { Err(not_a_file(&target)) }
        }
        Ok(_) => Err(not_a_file(output)),
    }
}

fn not_a_file(path: &Path) -> io::Error {
    let what = if path.is_dir() { "a folder" } else { "a device, pipe or socket" };
    io::Error::new(ErrorKind::InvalidInput, format!("{} is {what}, not a file", path.display()))
}

fn folder_of(target: &Path) -> &Path {
    target.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// `.NAME.`, with which the hidden files of an output begin.
fn part_prefix(name: &OsStr) -> OsString {
    let mut prefix = OsString::from(".");
    prefix.push(name);
    prefix.push(".");
    prefix
}

/// Makes a hidden file beside `output`, empty and locked; where it is.
pub(crate) fn create_hidden(output: &Path) -> Result<(PathBuf, fs_err::File), AtomicFileError> {
    let fail = |source| AtomicFileError { path: output.to_owned(), action: "make room beside it", source };
    let target = replaceable_target(output).map_err(fail)?;
    let name = target.file_name().ok_or_else(|| fail(io::Error::other("the path names no file")))?;
    create_part(folder_of(&target), name).map_err(fail)
}

fn create_part(folder: &Path, name: &OsStr) -> io::Result<(PathBuf, fs_err::File)> {
    static NEXT: AtomicU64 = AtomicU64::new(0);
    loop {
        let mut part_name = part_prefix(name);
        part_name.push(format!(
            "{}-{}{PART_SUFFIX}",
            std::process::id(),
            NEXT.fetch_add(1, Ordering::Relaxed)
        ));
        let part = folder.join(part_name);
        let file = match fs_err::OpenOptions::new().read(true).write(true).create_new(true).open(&part) {
            // A killed process with our number left it, and it could not be removed.
            Err(error) if error.kind() == ErrorKind::AlreadyExists => continue,
            other => other?,
        };
        // Where there are no locks nobody can tell a live file from a stale one, so nobody will remove it either.
        while file.file().lock().is_err_and(|error| error.kind() == ErrorKind::Interrupted) {}
        // Another process may have taken the file for stale between its creation and our lock.
        if fs_err::symlink_metadata(&part).is_ok() {
            return Ok((part, file));
        }
    }
}

/// Removes the hidden files of an output that nobody holds. This is housekeeping: what fails is left for next time.
fn remove_stale_parts(folder: &Path, name: &OsStr) {
    let prefix = part_prefix(name);
    let Ok(entries) = fs_err::read_dir(folder) else { return };
    for entry in entries.flatten() {
        if is_part_of(&prefix, &entry.file_name()) {
            // Opened for writing, since some systems lock only writable files.
            let Ok(file) = fs_err::OpenOptions::new().write(true).open(entry.path()) else { continue };
            match file.file().try_lock() {
                Ok(()) => _ = fs_err::remove_file(entry.path()),
                Err(TryLockError::WouldBlock | TryLockError::Error(_)) => {}
            }
        }
    }
}

/// Whether `file_name` is `prefix`, digits, a dash, digits, and the suffix.
fn is_part_of(prefix: &OsStr, file_name: &OsStr) -> bool {
    let numbers = file_name
        .as_encoded_bytes()
        .strip_prefix(prefix.as_encoded_bytes())
        .and_then(|rest| rest.strip_suffix(PART_SUFFIX.as_bytes()));
    let is_number = |digits: &[u8]| !digits.is_empty() && digits.iter().all(u8::is_ascii_digit);
    numbers.is_some_and(|numbers| {
        let mut parts = numbers.split(|&byte| byte == b'-');
        matches!((parts.next(), parts.next(), parts.next()), (Some(a), Some(b), None) if is_number(a) && is_number(b))
    })
}

/// A rename is on disk only once the folder is.
#[cfg(unix)]
fn sync_folder(folder: &Path) -> io::Result<()> {
    match fs_err::File::open(folder)?.sync_all() {
        // Some network and FUSE file systems have no such operation.
        Err(error) if matches!(error.kind(), ErrorKind::InvalidInput | ErrorKind::Unsupported) => Ok(()),
        other => other,
    }
}

#[cfg(not(unix))]
fn sync_folder(_: &Path) -> io::Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The names in a folder, sorted.
    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> = fs_err::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    fn write(path: &Path, content: &str) -> AtomicFile {
        let mut file = AtomicFile::create(path).unwrap();
        file.write_all(content.as_bytes()).unwrap();
        file
    }

    #[test]
    fn the_output_appears_on_commit_and_only_then() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.bin");
        for content in ["first", "second"] {
            let mut file = write(&path, "?????");
            file.seek(SeekFrom::Start(0)).unwrap();
            file.write_all(&content.as_bytes()[..2]).unwrap();
            file.seek(SeekFrom::Start(2)).unwrap();
            file.write_all(&content.as_bytes()[2..]).unwrap();
            let before = fs_err::read_to_string(&path).unwrap_or_default();
            assert_ne!(before, content);
            file.commit().unwrap();
            assert_eq!(fs_err::read_to_string(&path).unwrap(), content);
            assert_eq!(names(folder.path()), ["out.bin"]);
        }
    }

    #[test]
    fn large_files_are_whole_too() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.bin");
        let piece: Vec<u8> = (0..EARLY_SYNC_BYTES / 2 + 1).map(|i| (i * 7) as u8).collect();
        let mut file = AtomicFile::create(&path).unwrap();
        (0..5).for_each(|_| file.write_all(&piece).unwrap());
        assert!(file.early.is_some());
        file.commit().unwrap();
        assert!(fs_err::read(&path).unwrap() == piece.repeat(5));
        let mut file = AtomicFile::create(&path).unwrap();
        (0..3).for_each(|_| file.write_all(&piece).unwrap());
        drop(file);
        assert_eq!(names(folder.path()), ["out.bin"]);
    }

    #[test]
    fn dropping_leaves_the_old_output_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.bin");
        fs_err::write(&path, "old").unwrap();
        drop(write(&path, "new"));
        assert_eq!(fs_err::read_to_string(&path).unwrap(), "old");
        assert_eq!(names(folder.path()), ["out.bin"]);
    }

    #[test]
    fn two_writers_of_one_output_do_not_meet() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.bin");
        let (first, second) = (write(&path, "first"), write(&path, "second"));
        first.commit().unwrap();
        assert_eq!(fs_err::read_to_string(&path).unwrap(), "first");
        second.commit().unwrap();
        assert_eq!(fs_err::read_to_string(&path).unwrap(), "second");
        assert_eq!(names(folder.path()), ["out.bin"]);
    }

    const OUTPUT_OF_CHILD: &str = "MANYVIEW_TEST_OUTPUT_OF_CHILD";

    /// Not a test: the process that `a_killed_process_leaves_nothing_for_long` kills.
    #[test]
    #[ignore = "runs as the child of another test"]
    fn child_that_never_finishes() {
        let Some(path) = std::env::var_os(OUTPUT_OF_CHILD) else { return };
        let mut file = write(Path::new(&path), "never");
        file.flush().unwrap();
        std::thread::sleep(std::time::Duration::from_secs(60));
    }

    #[test]
    fn a_killed_process_leaves_nothing_for_long() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.bin");
        let mut child = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "atomic::tests::child_that_never_finishes", "--ignored"])
            .env(OUTPUT_OF_CHILD, &path)
            .stdout(std::process::Stdio::null())
            .spawn()
            .unwrap();
        let is_written = || {
            let part = fs_err::read_dir(folder.path()).unwrap().next();
            part.is_some_and(|part| part.unwrap().metadata().unwrap().len() == 5)
        };
        let start = std::time::Instant::now();
        while !is_written() {
            assert!(start.elapsed().as_secs() < 30, "the child wrote nothing");
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        let part_of_child = names(folder.path()).remove(0);
        assert!(part_of_child.starts_with(&format!(".out.bin.{}-", child.id())), "{part_of_child}");

        drop(write(&path, "while the child lives"));
        assert_eq!(names(folder.path()), [part_of_child], "a live process keeps its file");
        child.kill().unwrap();
        child.wait().unwrap();
        write(&path, "new").commit().unwrap();
        assert_eq!(names(folder.path()), ["out.bin"]);
    }

    #[test]
    fn only_own_leftovers_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.bin");
        let others = [".out.bin.1-.mvpart", ".out.bin.1-2", ".out.bin.a-2.mvpart", ".out.bin2.1-2.mvpart"];
        for name in others.iter().chain(&[".out.bin.4000000000-7.mvpart"]) {
            fs_err::write(folder.path().join(name), "left").unwrap();
        }
        write(&path, "new").commit().unwrap();
        assert_eq!(names(folder.path()), [&others[..], &["out.bin"]].concat());
    }

    #[test]
    fn errors_name_the_output_and_the_way_out() {
        let folder = tempfile::tempdir().unwrap();
        fs_err::write(folder.path().join("file"), "").unwrap();
        fs_err::create_dir(folder.path().join("folder")).unwrap();
        let fail = |name: &str| AtomicFile::create(folder.path().join(name)).err().unwrap();
        for (name, part) in [
            ("missing/out.bin", "make the folder first"),
            ("file/out.bin", "make the folder first"),
            ("folder", "is a folder, not a file"),
            ("folder/..", "is a folder, not a file"),
        ] {
            let message = fail(name).to_string();
            assert!(message.starts_with(&folder.path().join(name).display().to_string()), "{message}");
            assert!(message.contains(part), "{message}");
        }
        assert_eq!(names(folder.path()), ["file", "folder"]);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn devices_are_not_replaced_and_unwritable_folders_are_named() {
        let error = AtomicFile::create("/dev/null").err().unwrap().to_string();
        assert!(error.contains("a device, pipe or socket, not a file"), "{error}");
        // Nobody, root included, makes files there.
        let error = AtomicFile::create("/proc/self/out.bin").err().unwrap().to_string();
        assert!(error.starts_with("/proc/self/out.bin: cannot create it: "), "{error}");
    }

    #[test]
    #[cfg(unix)]
    fn links_stay_and_what_they_lead_to_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("target");
        let link = folder.path().join("link");
        fs_err::write(&target, "old").unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();
        write(&link, "new").commit().unwrap();
        assert!(fs_err::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs_err::read_to_string(&target).unwrap(), "new");
    }
}
