//! Ctrl-C: commands that look for it stop between two pieces of work and clean up; others end at once.

use std::sync::atomic::{AtomicBool, Ordering};

use manyview::preview::Cancelled;

use super::error::Exit;

static CANCELLED: AtomicBool = AtomicBool::new(false);
static IS_WATCHED: AtomicBool = AtomicBool::new(false);
static TELLS_EVENTS: AtomicBool = AtomicBool::new(false);

/// From now on an interrupt ends the program with the exit code for that; at once, unless the command watches for it.
pub(crate) fn catch_interrupt() {
    let handler = || {
        let again = CANCELLED.swap(true, Ordering::Relaxed);
        if again || !IS_WATCHED.load(Ordering::Relaxed) {
            // No output is ever half written: an unfinished one has another name until it is complete.
            std::process::exit(Exit::Cancelled as i32);
        }
        if TELLS_EVENTS.load(Ordering::Relaxed) {
            eprintln!("{{\"event\":\"cancelling\"}}");
        } else {
            eprintln!("cancelling … (once more to end at once)");
        }
    };
    // Where there are no signals, the system's own way to end a program remains.
    _ = ctrlc::set_handler(handler);
}

/// From now on a file that grows beyond the limit on file sizes (`ulimit -f`) is an error of the write, which tells what
/// to do and cleans up, and no longer the end of the program.
pub(crate) fn survive_file_size_limits() {
    #[cfg(unix)]
    {
        // The flag does not matter: where a signal has a handler, the write that caused it fails.
        let flag = std::sync::Arc::new(AtomicBool::new(false));
        _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, flag);
    }
}

/// The flag that an interrupt sets. Whoever takes it must look at it often.
pub(crate) fn watch() -> &'static AtomicBool {
    IS_WATCHED.store(true, Ordering::Relaxed);
    &CANCELLED
}

/// From now on an interrupt is told as a JSON event.
pub(crate) fn tell_events() {
    TELLS_EVENTS.store(true, Ordering::Relaxed);
}

/// An error once the user has interrupted the program.
pub(crate) fn check() -> Result<(), Cancelled> {
    if CANCELLED.load(Ordering::Relaxed) { Err(Cancelled) } else { Ok(()) }
}
