//! The length and the time of a file, to notice that it is changed while it is read.

use std::path::Path;
use std::time::SystemTime;

use crate::GenError;

/// The length and the time of the last change of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FileState {
    bytes: u64,
    modified: Option<SystemTime>,
}

impl FileState {
    /// Returns the present state of a file.
    pub fn of(path: &Path) -> Result<Self, GenError> {
        let found = std::fs::metadata(path).map_err(GenError::file(path))?;
        Ok(Self { bytes: found.len(), modified: found.modified().ok() })
    }

    /// Returns the length of the file.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Returns an error if the file is another one now, or was changed.
    pub fn check(&self, path: &Path) -> Result<(), GenError> {
        if Self::of(path)? == *self {
            return Ok(());
        }
        Err(GenError::invalid(path, "the file was changed while it was read; run again when it is complete"))
    }
}
