//! What can go wrong; each names the file.

use std::path::{Path, PathBuf};

/// Why a tile set could not be made.
#[derive(Debug, thiserror::Error)]
pub enum GenError {
    /// A file could not be read or written.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        reason: std::io::Error,
    },
    /// A file is not what it should be.
    #[error("{}: {reason}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The output folder is not empty.
    #[error("{}: already exists; --overwrite replaces it", .0.display())]
    Exists(PathBuf),
    /// An option that cannot be met.
    #[error("{0}")]
    Argument(String),
    /// A tile could not be encoded.
    #[error("{0}")]
    Encode(String),
}

impl GenError {
    pub(crate) fn file(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |reason| Self::File { path, reason }
    }

    /// A pipe or a device may never end, or never begin.
    pub(crate) fn if_not_regular(path: &Path) -> Result<(), Self> {
        match std::fs::metadata(path).map_err(Self::file(path))?.is_file() {
            true => Ok(()),
            false => Err(Self::invalid(path, "is not a regular file")),
        }
    }

    pub(crate) fn invalid(path: impl Into<PathBuf>, reason: impl Into<String>) -> Self {
        // Decoders' messages may have several lines; an error here is one.
        let reason = reason.into().split_whitespace().collect::<Vec<_>>().join(" ");
        Self::Invalid { path: path.into(), reason }
    }
}
