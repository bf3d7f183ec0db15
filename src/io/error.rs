//! What can go wrong between a URI and a page, and how much is accepted.

use std::time::Duration;

use super::{is_remote, shown};

/// Why something could not be read. Every variant names the URI; as text, the values of a URL's query are left out
/// ([`shown`]), since tokens travel there.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum IoError {
    /// The file does not exist or the server answered 404 or 410.
    #[error("{}: not found", shown(.uri))]
    NotFound {
        /// What was asked for.
        uri: String,
    },
    /// The operating system refused.
    #[error("{}: {reason}", shown(.uri))]
    File {
        /// What was asked for.
        uri: String,
        /// The system's words.
        reason: String,
        /// It may do so no longer: too many files were open, or a disk or a mount was away.
        may_pass: bool,
    },
    /// The server answered with a failure.
    #[error("{}: HTTP status {status}", shown(.uri))]
    Status {
        /// What was asked for.
        uri: String,
        /// Status code.
        status: u16,
        /// How long the server asks to be left alone (`Retry-After`).
        retry_after: Option<Duration>,
    },
    /// No answer: refused, reset, name not found.
    #[error("{}: {reason}", shown(.uri))]
    Network {
        /// What was asked for.
        uri: String,
        /// What the client said.
        reason: String,
    },
    /// No encrypted connection that can be trusted: its certificate is of nobody known, for another name, or past.
    #[error("{}: {reason}", shown(.uri))]
    Tls {
        /// What was asked for.
        uri: String,
        /// What the client said.
        reason: String,
    },
    /// No answer, or not all of it, in time.
    #[error("{}: timed out after {seconds} s ({phase})", shown(.uri))]
    Timeout {
        /// What was asked for.
        uri: String,
        /// What was waited for.
        phase: &'static str,
        /// The limit.
        seconds: f64,
    },
    /// Not in the cache, and no server is to be asked.
    #[error("{}: not in the cache, and offline", shown(.uri))]
    Offline {
        /// What was asked for.
        uri: String,
    },
    /// A URI that is not allowed or cannot be understood.
    #[error("{}: {reason}", shown(.uri))]
    Uri {
        /// The URI as written.
        uri: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The bytes are not what they should be.
    #[error("{}: {reason}", shown(.uri))]
    Invalid {
        /// Where the bytes came from.
        uri: String,
        /// What is wrong with them.
        reason: String,
    },
    /// A page for people in place of a content: servers and the networks before them send one with status 200, until
    /// somebody has logged in.
    #[error("{}: markup instead of content (an error page?)", shown(.uri))]
    Markup {
        /// Where it came from.
        uri: String,
    },
    /// Well formed, but not read by this version.
    #[error("{}: {what} is not supported", shown(.uri))]
    Unsupported {
        /// Where the bytes came from.
        uri: String,
        /// Format or extension.
        what: String,
    },
    /// Larger than [`Limits`] allow.
    #[error("{}: {what} is {got}, the limit is {limit}", shown(.uri))]
    TooLarge {
        /// Where the bytes came from.
        uri: String,
        /// What is too large.
        what: &'static str,
        /// How large it is (at least).
        got: u64,
        /// How large it may be.
        limit: u64,
    },
}

impl IoError {
    /// The URI that failed, in full: for people there is [`shown`].
    pub fn uri(&self) -> &str {
        match self {
            Self::NotFound { uri }
            | Self::File { uri, .. }
            | Self::Status { uri, .. }
            | Self::Network { uri, .. }
            | Self::Tls { uri, .. }
            | Self::Timeout { uri, .. }
            | Self::Offline { uri }
            | Self::Uri { uri, .. }
            | Self::Invalid { uri, .. }
            | Self::Markup { uri }
            | Self::Unsupported { uri, .. }
            | Self::TooLarge { uri, .. } => uri,
        }
    }

    /// The message without the URI.
    pub fn reason(&self) -> String {
        let text = self.to_string();
        text.strip_prefix(&*shown(self.uri())).and_then(|t| t.strip_prefix(": ")).map_or(text.clone(), str::to_owned)
    }

    /// True when asking again later may help.
    pub fn is_transient(&self) -> bool {
        match self {
            Self::Network { .. } | Self::Timeout { .. } => true,
            Self::Status { status, .. } => *status >= 500 || *status == 429 || *status == 408,
            Self::Markup { uri } | Self::Invalid { uri, .. } => is_remote(uri),
            Self::File { may_pass, .. } => *may_pass,
            _ => false,
        }
    }

    /// True for what may pass and mostly does not, as bytes that were changed on their way, or a disk that does not answer:
    /// worth a few tries.
    pub fn is_doubtful(&self) -> bool {
        self.is_transient() && matches!(self, Self::Invalid { .. } | Self::File { .. })
    }

    /// True for bytes that are not what they should be: no cache is to keep them.
    pub(crate) fn is_no_content(&self) -> bool {
        matches!(self, Self::Invalid { .. } | Self::Markup { .. })
    }

    /// How long to wait at least before asking again, where the server said so.
    pub fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::Status { retry_after, .. } => *retry_after,
            _ => None,
        }
    }

    /// What the operating system said of a file.
    pub(crate) fn of_file(uri: &str, error: &std::io::Error) -> Self {
        use std::io::ErrorKind;
        let uri = uri.to_owned();
        let may_pass = match error.kind() {
            ErrorKind::NotFound => return Self::NotFound { uri },
            ErrorKind::PermissionDenied
            | ErrorKind::NotADirectory
            | ErrorKind::IsADirectory
            | ErrorKind::InvalidInput
            | ErrorKind::InvalidFilename => false,
            _ => true,
        };
        Self::File { uri, reason: error.to_string(), may_pass }
    }

    pub(crate) fn invalid(uri: &str, reason: impl Into<String>) -> Self {
        Self::Invalid { uri: uri.to_owned(), reason: reason.into() }
    }

    pub(crate) fn unsupported(uri: &str, what: impl Into<String>) -> Self {
        Self::Unsupported { uri: uri.to_owned(), what: what.into() }
    }
}

/// How much is accepted from outside. The defaults are far above what real tile sets hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Bytes of one file, after decompression.
    pub max_file_bytes: u64,
    /// Width and height of an image in pixels.
    pub max_image_side_px: u32,
    /// Bytes of one decoded image; of those of one glTF four times as many.
    pub max_image_bytes: u64,
    /// Tiles of one tileset.json, nodes or vertices of one glTF; of its indices, as lists, eight times as many.
    pub max_elements: usize,
    /// Depth of nested tiles and glTF nodes.
    pub max_depth: u32,
    /// Tilesets inside tilesets.
    pub max_external_depth: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_file_bytes: 512 << 20,
            max_image_side_px: 8192,
            max_image_bytes: 256 << 20,
            max_elements: 16 << 20,
            max_depth: 100,
            max_external_depth: 32,
        }
    }
}
