//! One process at a time has a data folder: an advisory lock that ends with the process, however it ends.

use crate::{StoreError, layout::Layout};
use std::{
    fs::{self, File, TryLockError},
    io::{Seek, Write},
};

/// The lock; dropping it gives the folder free.
#[derive(Debug)]
pub(crate) struct FolderLock {
    _file: File,
}

impl FolderLock {
    /// Takes the lock, or says who has it.
    pub(crate) fn acquire(layout: &Layout) -> Result<Self, StoreError> {
        let file = open(layout)?;
        match file.try_lock() {
            Ok(()) => Ok(Self { _file: note_holder(file) }),
            Err(TryLockError::WouldBlock) => Err(held(layout)),
            Err(TryLockError::Error(error)) => Err(StoreError::io("lock", layout.lock())(error)),
        }
    }

    /// Takes the lock; where another process has it, says so once and waits.
    pub(crate) fn wait(layout: &Layout, on_wait: impl FnOnce(&StoreError)) -> Result<Self, StoreError> {
        match Self::acquire(layout) {
            Err(error @ StoreError::Locked { .. }) => on_wait(&error),
            other => return other,
        }
        let file = open(layout)?;
        file.lock().map_err(StoreError::io("lock", layout.lock()))?;
        Ok(Self { _file: note_holder(file) })
    }
}

fn open(layout: &Layout) -> Result<File, StoreError> {
    let path = layout.lock();
    File::options()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .open(&path)
        .map_err(StoreError::io("open", path))
}

fn held(layout: &Layout) -> StoreError {
    let holder_pid = fs::read_to_string(layout.lock()).ok().and_then(|text| text.trim().parse().ok());
    StoreError::Locked { folder: layout.root().to_owned(), holder_pid }
}

/// Writes this process's number for messages of others; a failure (a full disk) costs only that.
fn note_holder(mut file: File) -> File {
    let note = |file: &mut File| {
        file.set_len(0)?;
        file.rewind()?;
        writeln!(file, "{}", std::process::id())
    };
    if let Err(error) = note(&mut file) {
        tracing::debug!(%error, "the holder could not be noted in the lock file");
    }
    file
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{sync::mpsc, thread, time::Duration};

    #[test]
    fn one_holder_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let layout = Layout::new(folder.path());
        let first = FolderLock::acquire(&layout).unwrap();
        let error = FolderLock::acquire(&layout).unwrap_err();
        let StoreError::Locked { holder_pid, .. } = &error else { panic!("{error}") };
        assert_eq!(*holder_pid, Some(std::process::id()));

        let (send, receive) = mpsc::channel();
        let waiter = thread::spawn(move || {
            FolderLock::wait(&layout, |_| send.send(()).unwrap()).unwrap();
        });
        receive.recv_timeout(Duration::from_secs(10)).expect("the wait is announced");
        drop(first);
        waiter.join().unwrap();
    }
}
