//! How much memory some work takes.

/// The process's memory from some moment on.
#[derive(Debug, Clone, Copy)]
pub struct PeakMemory {
    before_bytes: Option<u64>,
}

impl PeakMemory {
    /// Begins to watch. Systems without `/proc` do not tell.
    pub fn watch() -> Self {
        // Sets the peak to what is resident now.
        let reset = fs_err::write("/proc/self/clear_refs", "5").is_ok();
        Self { before_bytes: status_bytes("VmRSS:").filter(|_| reset) }
    }

    /// By how much the peak since then is above what was resident then, bytes. What the allocator had kept from earlier
    /// work is not counted.
    pub fn grown_bytes(&self) -> Option<u64> {
        Some(status_bytes("VmHWM:")?.saturating_sub(self.before_bytes?))
    }
}

fn status_bytes(key: &str) -> Option<u64> {
    let status = fs_err::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with(key))?;
    Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? << 10)
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn what_is_touched_is_counted() {
        let peak = PeakMemory::watch();
        let touched = vec![1u8; 64 << 20];
        assert_eq!(touched[std::hint::black_box(9)], 1);
        drop(touched);
        let grown = peak.grown_bytes().unwrap();
        assert!(grown > 48 << 20, "{grown}");
    }
}
