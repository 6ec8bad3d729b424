//! Failures on purpose, for tests that must see what a crash or a full disk at one exact step leaves behind.
//!
//! Every step of a write passes a point with a name; nothing happens there unless a test asks for it, by
//! [`crate::OpenOptions::fault`] or by the variable `KILN_FAILPOINT=NAME[:COUNT][=enospc]`. With the variable the
//! process aborts at the COUNT-th pass (the first, if not given), as SIGKILL would end it; with `=enospc` the
//! step fails as on a full disk, from that pass on. The points are listed in [`FaultPoint::NAMES`].

use std::{
    io,
    sync::atomic::{AtomicU64, Ordering},
};

/// What happens at the point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaultAction {
    /// The process ends at once.
    Abort,
    /// The step, and every later pass of it, fails as on a full disk.
    DiskFull,
}

/// A step at which to fail. A testing aid: not for use in a running farm.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FaultPoint {
    /// One of [`Self::NAMES`].
    pub name: String,
    /// Which pass fails, from 1.
    pub pass: u64,
    /// How.
    pub action: FaultAction,
}

impl FaultPoint {
    /// The points, in the order in which a store passes them.
    pub const NAMES: [&str; 18] = [
        "pack.create",
        "pack.write",
        "pack.sync",
        "pack.rename",
        "pack.folder_sync",
        "index.update",
        "index.updated",
        "upload.create",
        "upload.append",
        "upload.finish",
        "journal.write",
        "journal.sync",
        "journal.synced",
        "journal.rotate",
        "snapshot.write",
        "snapshot.rename",
        "snapshot.remove",
        "garbage.remove",
    ];

    /// What `KILN_FAILPOINT` says, if it is set and names a point.
    pub fn from_environment() -> Option<Self> {
        let text = std::env::var("KILN_FAILPOINT").ok()?;
        let fault = Self::parse(&text);
        if fault.is_none() {
            tracing::warn!(value = %text, "KILN_FAILPOINT names no point of failure; it is NAME[:COUNT][=enospc]");
        }
        fault
    }

    /// Reads `NAME[:COUNT][=enospc]`.
    pub fn parse(text: &str) -> Option<Self> {
        let (point, action) = match text.split_once('=') {
            Some((point, "enospc")) => (point, FaultAction::DiskFull),
            Some(_) => return None,
            None => (text, FaultAction::Abort),
        };
        let (name, pass) = match point.split_once(':') {
            Some((name, pass)) => (name, pass.parse().ok().filter(|&pass| pass > 0)?),
            None => (point, 1),
        };
        Self::NAMES.contains(&name).then(|| Self { name: name.to_owned(), pass, action })
    }
}

/// Counts the passes of the one point that is to fail.
#[derive(Debug, Default)]
pub(crate) struct Faults {
    point: Option<FaultPoint>,
    passes: AtomicU64,
}

impl Faults {
    pub(crate) fn new(point: Option<FaultPoint>) -> Self {
        Self { point, passes: AtomicU64::new(0) }
    }

    /// Passes a point: `Err` where a full disk is to be played.
    pub(crate) fn pass(&self, name: &'static str) -> io::Result<()> {
        debug_assert!(FaultPoint::NAMES.contains(&name), "{name} is not in the list of points");
        let Some(point) = self.point.as_ref().filter(|point| point.name == name) else { return Ok(()) };
        let pass = self.passes.fetch_add(1, Ordering::Relaxed) + 1;
        match point.action {
            FaultAction::Abort if pass == point.pass => std::process::abort(),
            FaultAction::DiskFull if pass >= point.pass => Err(io::ErrorKind::StorageFull.into()),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_read_from_text() {
        let point = |name: &str, pass, action| Some(FaultPoint { name: name.to_owned(), pass, action });
        assert_eq!(FaultPoint::parse("pack.sync"), point("pack.sync", 1, FaultAction::Abort));
        assert_eq!(FaultPoint::parse("pack.sync:3=enospc"), point("pack.sync", 3, FaultAction::DiskFull));
        for bad in ["", "pack", "pack.sync:0", "pack.sync:x", "pack.sync=eio"] {
            assert_eq!(FaultPoint::parse(bad), None, "{bad}");
        }
    }

    #[test]
    fn fails_from_the_pass_asked_for() {
        let faults = Faults::new(FaultPoint::parse("pack.write:2=enospc"));
        assert!(faults.pass("pack.write").is_ok());
        assert!(faults.pass("pack.sync").is_ok());
        assert!(faults.pass("pack.write").is_err());
        assert!(faults.pass("pack.write").is_err());
    }
}
