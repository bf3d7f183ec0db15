//! [`HungReads`]: reads that hang, for tests: no test can make a disk hang. Any thread.

use std::path::Path;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

static PATHS: Mutex<Vec<(Part, String)>> = Mutex::new(Vec::new());
static RELEASED: Condvar = Condvar::new();

/// The part of a file that hangs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    Bytes,
    Metadata,
}

/// Makes all reads hang of files whose path contains a text, until it is dropped.
#[derive(Debug)]
pub struct HungReads((Part, String));

impl HungReads {
    /// Makes the reads of bytes hang that begin from now on.
    pub fn of(part_of_path: &str) -> Self {
        Self::new(Part::Bytes, part_of_path)
    }

    /// Makes hang what asks from now on whether there is a file, and how large it is.
    pub fn of_metadata(part_of_path: &str) -> Self {
        Self::new(Part::Metadata, part_of_path)
    }

    fn new(part: Part, part_of_path: &str) -> Self {
        let hung = (part, part_of_path.to_owned());
        paths().push(hung.clone());
        Self(hung)
    }

    pub(super) fn wait_for_bytes(path: &str) {
        wait(Part::Bytes, path);
    }

    pub(super) fn wait_for_metadata(path: &Path) {
        wait(Part::Metadata, &path.to_string_lossy());
    }
}

impl Drop for HungReads {
    fn drop(&mut self) {
        let mut paths = paths();
        if let Some(index) = paths.iter().position(|hung| *hung == self.0) {
            paths.swap_remove(index);
        }
        RELEASED.notify_all();
    }
}

fn paths() -> MutexGuard<'static, Vec<(Part, String)>> {
    PATHS.lock().unwrap_or_else(PoisonError::into_inner)
}

fn wait(part: Part, path: &str) {
    let mut paths = paths();
    while paths.iter().any(|(hung, text)| *hung == part && path.contains(text)) {
        paths = RELEASED.wait(paths).unwrap_or_else(PoisonError::into_inner);
    }
}
