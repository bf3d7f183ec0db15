//! Requests and their answers, independent of the version of HTTP: a file or a part of it, with its fault. All functions
//! are called on the threads of connections.

use std::fs::File;
use std::io::{Cursor, ErrorKind, Read, Result, Seek, SeekFrom};
use std::path::{Component, Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, UNIX_EPOCH};

use http::{Method, StatusCode};
use terrane::math::random::fnv1a;
use terrane_data_gen::GenError;

use super::faults::{Fault, FaultRandom};
use super::server::Server;

/// The web page that is sent instead of a file by [`Fault::Page`].
const PAGE: &[u8] = b"<!doctype html><title>Sorry</title><p>The page that you are looking for is not here.</p>\n";

/// The parts of a request that affect its answer.
pub(super) struct Request {
    is_head: bool,
    path: String,
    range: Option<String>,
    if_range: Option<String>,
    if_none_match: Option<String>,
    if_modified_since: Option<String>,
    takes_gzip: bool,
}

impl Request {
    /// Creates a request from a method, a target without scheme and server, and headers by their names in lower case. The
    /// error is the status of the answer.
    pub(super) fn new(
        method: &str,
        target: &str,
        header: impl Fn(&str) -> Option<String>,
    ) -> std::result::Result<Self, StatusCode> {
        let is_head = match method {
            _ if method == Method::GET => false,
            _ if method == Method::HEAD => true,
            _ => return Err(StatusCode::METHOD_NOT_ALLOWED),
        };
        let path = target.split(['?', '#']).next().unwrap_or_default();
        let path = percent_encoding::percent_decode_str(path).decode_utf8().map_err(|_| StatusCode::BAD_REQUEST)?;
        Ok(Self {
            is_head,
            path: path.into_owned(),
            range: header("range"),
            if_range: header("if-range"),
            if_none_match: header("if-none-match"),
            if_modified_since: header("if-modified-since"),
            takes_gzip: header("accept-encoding").is_some_and(|v| v.to_ascii_lowercase().contains("gzip")),
        })
    }

    /// Returns the key for faults: everything that selects the requested bytes.
    pub(super) fn key(&self) -> String {
        let method = if self.is_head { "HEAD " } else { "" };
        format!("{method}{} {}", self.path, self.range.as_deref().unwrap_or_default())
    }

    /// Returns true if the client's copy is current (RFC 9110, 13.2.2). A tag takes precedence over a date.
    fn is_current(&self, tag: &str, date: &str) -> bool {
        match &self.if_none_match {
            Some(tags) => tags.split(',').map(str::trim).any(|t| t == "*" || t.trim_start_matches("W/") == tag),
            None => self.if_modified_since.as_deref() == Some(date),
        }
    }
}

/// The delay and the fault of an answer.
pub(super) struct Decision {
    /// The delay before the answer.
    pub(super) wait: Duration,
    fault: Fault,
    random: FaultRandom,
}

/// The scope of a reset. With HTTP/1.1 it is always the connection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Loss {
    Stream,
    Connection,
}

/// The reaction to a request.
pub(super) enum Outcome {
    /// No answer until the client closes the connection.
    Silence,
    Reset(Loss),
    Answer(Answer),
}

/// An answer: its head and its content.
pub(super) struct Answer {
    pub(super) status: StatusCode,
    pub(super) headers: Vec<(&'static str, String)>,
    pub(super) content: Option<Content>,
    pub(super) end: End,
}

/// The end of an answer, after its content or the first half of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum End {
    Whole,
    /// The answer ends before its announced length.
    Early,
    /// Nothing is sent until the client closes the connection.
    Stall,
    Reset(Loss),
}

impl Answer {
    fn new(status: StatusCode, length: u64) -> Self {
        // Scripts of other web pages may fetch files, for example a viewer in a browser.
        let headers = vec![("Content-Length", length.to_string()), ("Access-Control-Allow-Origin", "*".to_owned())];
        Self { status, headers, content: None, end: End::Whole }
    }

    /// Creates an answer without content.
    pub(super) fn empty(status: StatusCode) -> Self {
        Self::new(status, 0)
    }

    fn with(mut self, name: &'static str, value: impl Into<String>) -> Self {
        self.headers.push((name, value.into()));
        self
    }
}

/// The bytes to send, read from a file piece by piece.
pub(super) struct Content {
    bytes: Box<dyn Read + Send>,
    at: u64,
    length: u64,
    /// The offset of the byte to corrupt.
    corrupt_at: Option<u64>,
}

impl Content {
    /// Returns true if all bytes have been read.
    pub(super) fn is_done(&self) -> bool {
        self.at == self.length
    }
}

impl Read for Content {
    fn read(&mut self, piece: &mut [u8]) -> Result<usize> {
        let wanted = (self.length - self.at).min(piece.len() as u64) as usize;
        let got = self.bytes.read(&mut piece[..wanted])?;
        if got == 0 && wanted > 0 {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        if let Some(offset) = self.corrupt_at.and_then(|c| c.checked_sub(self.at)).filter(|p| *p < got as u64) {
            piece[offset as usize] ^= 0xff;
        }
        self.at += got as u64;
        Ok(got)
    }
}

impl Server {
    /// Draws the delay and the fault of an answer.
    pub(super) fn decide(&self, request: &Request) -> Decision {
        let is_faulty = self.is_faulty.load(Ordering::Acquire);
        let key = request.key();
        // Requests are counted only while faults are on, so that others do not shift the numbers. Without random faults or
        // jitter the counts have no effect and are not stored.
        let rates = self.args.rates();
        let is_drawn = self.args.jitter_ms > 0.0 || rates.iter().any(|(rate, _)| *rate > 0.0);
        let number = if is_faulty && is_drawn { self.counts.next(&key) } else { 0 };
        let mut random = FaultRandom::new(self.args.seed, &key, number);
        let fault = if is_faulty { random.fault(&rates) } else { Fault::None };
        let wait_ms = self.args.latency_ms + self.args.jitter_ms * random.share();
        Decision { wait: Duration::from_secs_f64(wait_ms / 1e3), fault, random }
    }

    /// Returns the answer to a request. The caller has waited for the delay.
    pub(super) fn answer(&self, request: &Request, decision: Decision) -> Result<Outcome> {
        let Decision { fault, mut random, .. } = decision;
        let answer = match fault {
            Fault::Silent => return Ok(Outcome::Silence),
            Fault::Reset if random.share() < 0.5 => return Ok(Outcome::Reset(loss(&mut random))),
            Fault::Error => {
                let status = match random.share() {
                    share if share < 0.4 => StatusCode::INTERNAL_SERVER_ERROR,
                    share if share < 0.8 => StatusCode::SERVICE_UNAVAILABLE,
                    _ => StatusCode::TOO_MANY_REQUESTS,
                };
                Answer::empty(status).with("Retry-After", self.args.retry_after.to_string())
            }
            Fault::Page => {
                let length = PAGE.len() as u64;
                let page = Content { bytes: Box::new(PAGE), at: 0, length, corrupt_at: None };
                let content = (!request.is_head).then_some(page);
                Answer { content, ..Answer::new(StatusCode::OK, length).with("Content-Type", "text/html") }
            }
            fault => self.file_answer(request, fault, &mut random)?,
        };
        Ok(Outcome::Answer(answer))
    }

    /// Returns the requested file or a part of it.
    fn file_answer(&self, request: &Request, fault: Fault, random: &mut FaultRandom) -> Result<Answer> {
        let found = match &self.procedural {
            Some(procedural) => procedural.file(request.path.trim_start_matches('/')).map(Found::made).transpose()?,
            None => self.open(request).map(|(file, is_gzip)| Found::file(file, is_gzip)).transpose()?,
        };
        let Some(Found { mut bytes, length, tag, date, is_gzip }) = found else {
            return Ok(Answer::empty(StatusCode::NOT_FOUND));
        };
        // With If-Range, a part is sent only if the client's copy is current.
        let wanted =
            request.range.as_deref().filter(|_| request.if_range.as_ref().is_none_or(|i| *i == tag || *i == date));
        let part = wanted.and_then(|r| range(r, length));
        let (status, first, count) = match part {
            _ if request.is_current(&tag, &date) => (StatusCode::NOT_MODIFIED, 0, length),
            // Without a valid range the whole file is sent.
            None => (StatusCode::OK, 0, length),
            Some(Some((first, last))) => (StatusCode::PARTIAL_CONTENT, first, last - first + 1),
            Some(None) => (StatusCode::RANGE_NOT_SATISFIABLE, 0, 0),
        };
        let mut answer = Answer::new(status, count)
            .with("ETag", tag)
            .with("Accept-Ranges", "bytes")
            .with("Content-Type", media_type(&request.path))
            .with("Vary", "Accept-Encoding")
            .with("Last-Modified", date);
        if let Some(seconds) = self.args.max_age {
            answer = answer.with("Cache-Control", format!("max-age={seconds}"));
        }
        if is_gzip {
            answer = answer.with("Content-Encoding", "gzip");
        }
        answer = match status {
            StatusCode::OK => answer,
            StatusCode::PARTIAL_CONTENT => {
                answer.with("Content-Range", format!("bytes {first}-{}/{length}", first + count - 1))
            }
            StatusCode::RANGE_NOT_SATISFIABLE => {
                return Ok(answer.with("Content-Range", format!("bytes */{length}")));
            }
            _ => return Ok(answer),
        };
        if request.is_head {
            return Ok(answer);
        }
        if first > 0 {
            bytes.seek(SeekFrom::Start(first))?;
        }
        let corrupt_at = (fault == Fault::Corrupted).then(|| (random.share() * count as f64) as u64);
        answer.end = match fault {
            Fault::Truncated => End::Early,
            Fault::Stalled => End::Stall,
            Fault::Reset => End::Reset(loss(random)),
            _ => End::Whole,
        };
        let sent = if answer.end == End::Whole { count } else { count / 2 };
        answer.content = Some(Content { bytes: Box::new(bytes), at: 0, length: sent, corrupt_at });
        Ok(answer)
    }

    /// Opens the requested file, or its `.gz` if the client accepts that. True for files that gzip has compressed, also under
    /// their own names. Files outside of the folder are refused, also through links.
    fn open(&self, request: &Request) -> Option<(File, bool)> {
        let relative = Path::new(request.path.trim_start_matches('/'));
        if !relative.components().all(|c| matches!(c, Component::Normal(_))) {
            return None;
        }
        // Most files have no `.gz`, so that is checked first: `canonicalize` takes longer than opening a file.
        let open = |path: PathBuf| {
            path.is_file().then_some(())?;
            let path = path.canonicalize().ok().filter(|path| path.starts_with(&self.folder))?;
            File::open(path).ok()
        };
        let path = self.folder.join(relative);
        let mut packed = path.clone().into_os_string();
        packed.push(".gz");
        let gzip = if request.takes_gzip { open(packed.into()) } else { None };
        match gzip {
            Some(file) => Some((file, true)),
            None => {
                let mut file = open(path)?;
                let mut magic = [0; 2];
                let is_gzip = file.read_exact(&mut magic).is_ok() && magic == [0x1f, 0x8b];
                file.rewind().ok()?;
                // Without the header the client has to look at the content.
                Some((file, is_gzip && request.takes_gzip && !request.path.ends_with("gz")))
            }
        }
    }
}

/// Bytes to send, of a file or made for the request.
trait Bytes: Read + Seek + Send {}

impl<T: Read + Seek + Send> Bytes for T {}

/// The content that is served at a path.
struct Found {
    bytes: Box<dyn Bytes>,
    length: u64,
    tag: String,
    /// The time of the last change.
    date: String,
    is_gzip: bool,
}

impl Found {
    fn file(file: File, is_gzip: bool) -> Result<Self> {
        let metadata = file.metadata()?;
        let length = metadata.len();
        let modified = metadata.modified().ok().filter(|t| *t > UNIX_EPOCH).unwrap_or(UNIX_EPOCH);
        let nanoseconds = modified.duration_since(UNIX_EPOCH).map_or(0, |d| d.as_nanos());
        let (tag, date) = (format!("\"{length:x}-{nanoseconds:x}\""), httpdate::fmt_http_date(modified));
        Ok(Self { bytes: Box::new(file), length, tag, date, is_gzip })
    }

    /// Takes bytes that were made for the request. Their tag is a hash, because they are the same after a restart.
    fn made(bytes: std::result::Result<Vec<u8>, GenError>) -> Result<Self> {
        let bytes = bytes.map_err(std::io::Error::other)?;
        let (length, tag) = (bytes.len() as u64, format!("\"{:x}\"", fnv1a(&bytes)));
        let date = httpdate::fmt_http_date(UNIX_EPOCH);
        Ok(Self { bytes: Box::new(Cursor::new(bytes)), length, tag, date, is_gzip: false })
    }
}

/// Draws the scope of a reset, each with the same probability.
fn loss(random: &mut FaultRandom) -> Loss {
    if random.share() < 0.5 { Loss::Stream } else { Loss::Connection }
}

/// Parses a single range to its first and last byte. `None` if it is invalid, `Some(None)` if it lies outside of the file.
fn range(text: &str, length: u64) -> Option<Option<(u64, u64)>> {
    let (first, last) = text.strip_prefix("bytes=")?.split_once('-')?;
    let number = |text: &str| text.trim().parse::<u64>().ok();
    let end = length.checked_sub(1);
    let (first, last) = match (first.trim(), last.trim()) {
        ("", suffix) => (length.saturating_sub(number(suffix)?), end),
        (first, "") => (number(first)?, end),
        (first, last) => {
            let (first, last) = (number(first)?, number(last)?);
            (first <= last).then_some(())?;
            (first, end.map(|e| last.min(e)))
        }
    };
    Some(last.filter(|last| first <= *last).map(|last| (first, last)))
}

/// Returns the media type of a path by its extension.
fn media_type(path: &str) -> &'static str {
    match path.rsplit('.').next().unwrap_or("") {
        "json" => "application/json",
        "glb" => "model/gltf-binary",
        "gltf" => "model/gltf+json",
        "png" => "image/png",
        "jpg" | "jpeg" => "image/jpeg",
        "exr" => "image/aces",
        "terrain" => "application/vnd.quantized-mesh",
        "3tz" => "application/vnd.maxar.archive.3tz+zip",
        "zip" => "application/zip",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_within_the_file() {
        assert_eq!(range("bytes=0-9", 100), Some(Some((0, 9))));
        assert_eq!(range("bytes=90-", 100), Some(Some((90, 99))));
        assert_eq!(range("bytes=-10", 100), Some(Some((90, 99))));
        assert_eq!(range("bytes=50-500", 100), Some(Some((50, 99))));
        assert_eq!(range("bytes=100-", 100), Some(None));
        assert_eq!(range("bytes=0-", 0), Some(None));
        for unknown in ["bytes=5-4", "bytes=", "rows=1-2", "bytes=a-b", "bytes=0-0,5-6"] {
            assert_eq!(range(unknown, 100), None, "{unknown}");
        }
    }
}
