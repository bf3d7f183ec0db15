//! [`IoError`]: everything that can fail between a URI and a page. Plain values.

use std::net::IpAddr;
use std::path::PathBuf;
use std::time::Duration;

use super::memory::ContentTooLarge;
#[cfg(feature = "http")]
use super::memory::NoRoom;
use super::uri::{is_remote, printable, shown};

/// The reason why a URI could not be read or decoded. Every variant names the URI. The error text omits the user name, the
/// password and the query values of a URL, since they may be secrets ([`shown`]).
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum IoError {
    /// The file does not exist or the server answered 404 or 410.
    #[error("{}: not found", shown(.uri))]
    NotFound {
        /// The URI that was requested.
        uri: String,
    },
    /// The operating system reported an error for a file.
    #[error("{}: {reason}", shown(.uri))]
    File {
        /// The URI that was requested.
        uri: String,
        /// The message of the operating system.
        reason: String,
        /// True if a retry may succeed: too many files were open, or a disk or a mount was missing.
        may_pass: bool,
    },
    /// The server answered with a failure status.
    #[error("{}: HTTP status {status}", shown(.uri))]
    Status {
        /// The URI that was requested.
        uri: String,
        /// HTTP status code.
        status: u16,
        /// The pause that the server asks for (`Retry-After`).
        retry_after: Option<Duration>,
    },
    /// The connection failed: it was refused or reset, or the name was not found.
    #[error("{}: {reason}", shown(.uri))]
    Network {
        /// The URI that was requested.
        uri: String,
        /// The message of the HTTP client.
        reason: String,
    },
    /// TLS failed: the certificate has an unknown issuer, is for another name, or has expired.
    #[error("{}: {reason}", shown(.uri))]
    Tls {
        /// The URI that was requested.
        uri: String,
        /// The message of the HTTP client.
        reason: String,
    },
    /// The answer did not arrive completely, or a file was not read, within a time limit.
    #[error("{}: timed out after {seconds} s ({phase})", shown(.uri))]
    Timeout {
        /// The URI that was requested.
        uri: String,
        /// The phase that timed out, such as `connecting`.
        phase: &'static str,
        /// The time limit in seconds.
        seconds: f64,
    },
    /// The URI is not in the cache, and the cache is offline, so no server was asked.
    #[error("{}: not in the cache, and offline", shown(.uri))]
    Offline {
        /// The URI that was requested.
        uri: String,
    },
    /// The URI leads, perhaps after redirects, to a host that its tile set may not reach. Nothing was sent to it.
    /// `HttpConfig::allowed_hosts` allows it.
    #[error("{}: {host} has the {kind} address {address}, which this tile set may not reach; --allow-host {host} allows it", shown(.uri))]
    HostRefused {
        /// The URI that was requested.
        uri: String,
        /// The host, with its port if the URL names one.
        host: String,
        /// An address of the host.
        address: IpAddr,
        /// The kind of the address, such as `loopback`. It is `public` if the root's host had only local addresses before.
        kind: &'static str,
    },
    /// An object store refused a request, such as to write into a bucket.
    #[error("{}: {reason}", shown(.uri))]
    Refused {
        /// The object or the folder.
        uri: String,
        /// The answer of the store.
        reason: String,
    },
    /// A symbolic link leads out of the folder of a set on disk. `Limits::follow_links` allows it.
    #[error("{uri}: a symbolic link leads to {}, out of the set's folder {}; --follow-links allows it", .target.display(), .folder.display())]
    LinkRefused {
        /// The path of the file.
        uri: String,
        /// The file that the link leads to.
        target: PathBuf,
        /// The folder of the set's root, links resolved.
        folder: PathBuf,
    },
    /// A reference of a set on disk leads out of the folder of its root, or to a server. `Limits::allow_outside` allows it.
    #[error("{}: leaves the tile set's folder {}; --allow-outside allows it", shown(.uri), .folder.display())]
    OutsideRefused {
        /// The reference as written.
        uri: String,
        /// The folder of the set's root.
        folder: PathBuf,
    },
    /// The URI is malformed or not allowed.
    #[error("{}: {reason}", shown(.uri))]
    Uri {
        /// The URI as written.
        uri: String,
        /// The rule that it violates.
        reason: String,
    },
    /// The bytes violate their format.
    #[error("{}: {reason}", shown(.uri))]
    Invalid {
        /// The URI of the bytes.
        uri: String,
        /// The violated rule.
        reason: String,
    },
    /// An HTML or XML page arrived with status 200 instead of the content. Servers and login portals send such error pages.
    #[error("{}: a web page instead of content (an error page, or the URL of a folder without its final slash?)", shown(.uri))]
    Markup {
        /// The URI that was requested.
        uri: String,
    },
    /// The data is well formed, but uses a feature that this version does not read.
    #[error("{}: {what} is not supported", shown(.uri))]
    Unsupported {
        /// The URI of the bytes.
        uri: String,
        /// The format, extension or feature.
        what: String,
    },
    /// The data is larger than [`Limits`](super::Limits) allow.
    #[error("{}: {what} is {got}, the limit is {limit}", shown(.uri))]
    TooLarge {
        /// The URI of the bytes.
        uri: String,
        /// The thing that is too large, such as `file`.
        what: &'static str,
        /// Its size, or a lower bound of it.
        got: u64,
        /// The limit.
        limit: u64,
    },
    /// The content has no room among the bytes that are loaded at once. The pager waits for room and requests it again; its
    /// callers never get this error.
    #[error("{}: {needed} bytes have no room now", shown(.uri))]
    NoRoom {
        /// The URI of the bytes.
        uri: String,
        /// The bytes that the content needs, or a lower bound of them.
        needed: u64,
    },
}

impl IoError {
    /// A file that was not read or found within a time limit.
    pub(crate) fn file_timeout(uri: &str, limit: Duration) -> Self {
        Self::Timeout { uri: uri.to_owned(), phase: "reading the file", seconds: limit.as_secs_f64() }
    }

    /// Returns the URI that failed, secrets included. Use [`shown`] before printing it.
    pub fn uri(&self) -> &str {
        match self {
            Self::NotFound { uri }
            | Self::File { uri, .. }
            | Self::Status { uri, .. }
            | Self::Network { uri, .. }
            | Self::Tls { uri, .. }
            | Self::Refused { uri, .. }
            | Self::Timeout { uri, .. }
            | Self::Offline { uri }
            | Self::HostRefused { uri, .. }
            | Self::LinkRefused { uri, .. }
            | Self::OutsideRefused { uri, .. }
            | Self::Uri { uri, .. }
            | Self::Invalid { uri, .. }
            | Self::Markup { uri }
            | Self::Unsupported { uri, .. }
            | Self::TooLarge { uri, .. }
            | Self::NoRoom { uri, .. } => uri,
        }
    }

    /// Returns the message without the URI.
    pub fn reason(&self) -> String {
        let text = self.to_string();
        text.strip_prefix(&*shown(self.uri())).and_then(|t| t.strip_prefix(": ")).map_or(text.clone(), str::to_owned)
    }

    /// Returns true if a later retry may succeed.
    pub fn is_transient(&self) -> bool {
        match self {
            Self::Network { .. } | Self::Timeout { .. } => true,
            Self::Status { status, .. } => *status >= 500 || *status == 429 || *status == 408,
            Self::Markup { uri } | Self::Invalid { uri, .. } => is_remote(uri),
            Self::File { may_pass, .. } => *may_pass,
            _ => false,
        }
    }

    /// Returns true for transient errors that mostly persist: damaged bytes and failing disks. They deserve only a few
    /// retries.
    pub fn is_doubtful(&self) -> bool {
        let is_disk = matches!(self, Self::Timeout { uri, .. } if !is_remote(uri));
        self.is_transient() && (is_disk || matches!(self, Self::Invalid { .. } | Self::File { .. }))
    }

    /// Returns true if the bytes themselves are wrong. No cache may keep them.
    #[cfg(feature = "http")]
    pub(crate) fn is_no_content(&self) -> bool {
        matches!(self, Self::Invalid { .. } | Self::Markup { .. })
    }

    /// Returns true if the file may lie elsewhere: the server does not have it or does not give it away.
    pub(crate) fn may_be_elsewhere(&self) -> bool {
        matches!(self, Self::NotFound { .. } | Self::Status { status: 400..=403, .. })
    }

    /// Returns the shortest pause before a retry, if the server named one.
    pub fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::Status { retry_after, .. } => *retry_after,
            _ => None,
        }
    }

    /// Converts an error of the operating system for a file.
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
        Self::Invalid { uri: uri.to_owned(), reason: printable(&reason.into()).into_owned() }
    }

    #[cfg(feature = "http")]
    pub(crate) fn no_room(uri: &str, no_room: NoRoom) -> Self {
        Self::NoRoom { uri: uri.to_owned(), needed: no_room.needed }
    }

    pub(crate) fn unsupported(uri: &str, what: impl Into<String>) -> Self {
        Self::Unsupported { uri: uri.to_owned(), what: printable(&what.into()).into_owned() }
    }
}

impl ContentTooLarge {
    /// Returns the error of a content.
    pub(crate) fn at(self, uri: &str) -> IoError {
        IoError::TooLarge { uri: uri.to_owned(), what: Self::WHAT, got: self.asked, limit: self.limit }
    }
}
