//! Memory of processes, as the system tells it.

/// A figure of this process in KiB, such as `VmRSS:`; 0 where the system does not tell.
pub(crate) fn status_kib(name: &str) -> u64 {
    field_kib("/proc/self/status", name).unwrap_or(0)
}

/// Greatest resident memory so far of a process that runs, bytes; nothing where the system does not tell.
pub(crate) fn peak_bytes_of(process: u32) -> Option<u64> {
    field_kib(&format!("/proc/{process}/status"), "VmHWM:").map(|kib| 1024 * kib)
}

fn field_kib(path: &str, name: &str) -> Option<u64> {
    let status = std::fs::read_to_string(path).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix(name))?;
    line.split_whitespace().next()?.parse().ok()
}
