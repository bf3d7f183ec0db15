//! The errors of generation. Errors about files name the file.

use std::path::{Path, PathBuf};

use terrane::fetch::{IoError, printable};

/// The reason why a tile set could not be made.
#[derive(Debug, thiserror::Error)]
pub enum GenError {
    /// A file could not be read or written.
    #[error("{}: {reason}", shown(path))]
    File {
        /// The file.
        path: PathBuf,
        /// The reason given by the operating system.
        reason: std::io::Error,
    },
    /// The content of a file is invalid or not supported.
    #[error("{}: {reason}", shown(path))]
    Invalid {
        /// The file.
        path: PathBuf,
        /// The reason.
        reason: String,
    },
    /// The output folder is not empty.
    #[error("{}: already exists; --overwrite replaces it", .0.display())]
    Exists(PathBuf),
    /// Another run writes to the output folder.
    #[error("{}: another run writes it", .0.display())]
    Busy(PathBuf),
    /// The set does not fit on the disk.
    #[error(
        "{}: the set needs about {:.1} MB, and {:.1} MB are free; nothing was written",
        out.display(), *needed as f64 / 1e6, *free as f64 / 1e6
    )]
    Space {
        /// The output folder.
        out: PathBuf,
        /// The bytes that the set needs.
        needed: u64,
        /// The bytes that are free.
        free: u64,
    },
    /// A source changed while the set was made.
    #[error("a source changed while it was read; nothing was written to {}", .0.display())]
    Changed(PathBuf),
    /// The run failed after parts were complete.
    #[error("{reason}; the same command continues (parts are in {})", folder.display())]
    Unfinished {
        /// The reason.
        reason: Box<GenError>,
        /// The folder with the parts.
        folder: PathBuf,
    },
    /// Shards are missing, or not complete.
    #[error("{}: {reason}", out.display())]
    Shards {
        /// The output folder.
        out: PathBuf,
        /// The shards by name, and what to do.
        reason: String,
    },
    /// An option is invalid.
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

    /// Returns the error of a file on a server. What may pass is an error of reading, after which a run can be continued.
    pub(crate) fn remote(path: &Path, error: &IoError) -> Self {
        let reason = match error {
            IoError::HostRefused { host, address, kind, .. } => {
                format!("redirected to {host}, whose address {address} is {kind}; --allow-host {host} allows it")
            }
            error => error.reason(),
        };
        match error {
            IoError::Invalid { .. } | IoError::Markup { .. } => Self::invalid(path, reason),
            error if error.is_transient() => {
                Self::File { path: path.to_owned(), reason: std::io::Error::other(reason) }
            }
            _ => Self::invalid(path, reason),
        }
    }

    /// Refuses pipes and devices: opening or reading one may block forever.
    pub(crate) fn if_not_regular(path: &Path) -> Result<(), Self> {
        match std::fs::metadata(path).map_err(Self::file(path))?.is_file() {
            true => Ok(()),
            false => Err(Self::invalid(path, "is not a regular file")),
        }
    }

    pub(crate) fn invalid(path: impl Into<PathBuf>, reason: impl Into<String>) -> Self {
        // Messages of decoders may have several lines; errors are printed on one line.
        let reason = reason.into().split_whitespace().collect::<Vec<_>>().join(" ");
        Self::Invalid { path: path.into(), reason: printable(&reason).into_owned() }
    }
}

/// Returns a path, or the address of a file on a server without its secrets.
fn shown(path: &Path) -> String {
    terrane::fetch::shown(&path.to_string_lossy()).into_owned()
}
