//! [`OsgError`]: why a file of OpenSceneGraph cannot be read, before its address is added.

use crate::fetch::{ContentTooLarge, IoError};

/// The reason why a file or a part of it cannot be read.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum OsgError {
    /// The bytes violate the format.
    Invalid(String),
    /// The file uses something that is not read.
    Unsupported(String),
    /// A part is larger than the limits allow.
    TooLarge { what: &'static str, got: u64, limit: u64 },
}

impl From<ContentTooLarge> for OsgError {
    fn from(ContentTooLarge { asked, limit }: ContentTooLarge) -> Self {
        Self::TooLarge { what: ContentTooLarge::WHAT, got: asked, limit }
    }
}

/// The result of reading a part of a file.
pub(super) type Result<T> = std::result::Result<T, OsgError>;

impl OsgError {
    /// Returns an error for bytes that violate the format.
    pub fn invalid(reason: impl Into<String>) -> Self {
        Self::Invalid(reason.into())
    }

    /// Adds the address of the file.
    pub fn at(self, uri: &str) -> IoError {
        match self {
            Self::Invalid(reason) => IoError::invalid(uri, format!("OpenSceneGraph file: {reason}")),
            Self::Unsupported(what) => IoError::unsupported(uri, format!("OpenSceneGraph file: {what}")),
            Self::TooLarge { what, got, limit } => IoError::TooLarge { uri: uri.to_owned(), what, got, limit },
        }
    }
}
