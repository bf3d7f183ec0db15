//! What is answered, whatever the version of HTTP: a request, the file or part of it that is there, and what chance has
//! for the answer. Called on the connections' threads.

use std::fs::File;
use std::io::{ErrorKind, Read, Result, Seek as _, SeekFrom};
use std::path::{Component, Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, UNIX_EPOCH};

use http::{Method, StatusCode};

use super::Server;
use super::chance::{Chance, Fate};

/// Instead of a tile.
const PAGE: &[u8] = b"<!doctype html><title>Sorry</title><p>The page that you are looking for is not here.</p>\n";

/// The parts of a request that count.
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
    /// From a method, a target without scheme and server, and headers by their names in lower case; or the status that
    /// is the answer.
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

    /// What chance knows it by: all that says which bytes are wanted.
    fn wanted(&self) -> String {
        let method = if self.is_head { "HEAD " } else { "" };
        format!("{method}{} {}", self.path, self.range.as_deref().unwrap_or_default())
    }

    /// What the client has is what there is (RFC 9110, 13.2.2): the tag counts, and the date where no tag is given.
    fn holds(&self, tag: &str, date: &str) -> bool {
        match &self.if_none_match {
            Some(tags) => tags.split(',').map(str::trim).any(|t| t == "*" || t.trim_start_matches("W/") == tag),
            None => self.if_modified_since.as_deref() == Some(date),
        }
    }
}

/// What chance has for an answer.
pub(super) struct Lot {
    /// Before anything is answered.
    pub(super) wait: Duration,
    fate: Fate,
    chance: Chance,
}

/// What is lost by a reset. Before HTTP/2 it is the connection in any case.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Loss {
    Stream,
    Connection,
}

pub(super) enum Outcome {
    /// Nothing, until the client goes.
    Silence,
    Reset(Loss),
    Answer(Answer),
}

pub(super) struct Answer {
    pub(super) status: StatusCode,
    pub(super) headers: Vec<(&'static str, String)>,
    pub(super) content: Option<Content>,
    pub(super) end: End,
}

/// What comes after the content, or after the half of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum End {
    Whole,
    /// Nothing, though more was announced.
    Early,
    /// Nothing, until the client goes.
    Stall,
    Reset(Loss),
}

impl Answer {
    fn new(status: StatusCode, length: u64) -> Self {
        // Other pages may fetch from here, as a viewer in a browser does.
        let headers = vec![("Content-Length", length.to_string()), ("Access-Control-Allow-Origin", "*".to_owned())];
        Self { status, headers, content: None, end: End::Whole }
    }

    /// Without a content.
    pub(super) fn empty(status: StatusCode) -> Self {
        Self::new(status, 0)
    }

    fn with(mut self, name: &'static str, value: impl Into<String>) -> Self {
        self.headers.push((name, value.into()));
        self
    }
}

/// The bytes of a content that are sent.
pub(super) struct Content {
    bytes: Box<dyn Read + Send>,
    at: u64,
    length: u64,
    /// The byte that is changed on its way.
    corrupt_at: Option<u64>,
}

impl Content {
    /// All of it was read.
    pub(super) fn is_over(&self) -> bool {
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
        if let Some(place) = self.corrupt_at.and_then(|c| c.checked_sub(self.at)).filter(|p| *p < got as u64) {
            piece[place as usize] ^= 0xff;
        }
        self.at += got as u64;
        Ok(got)
    }
}

impl Server {
    /// Draws what happens to the answer of a request.
    pub(super) fn lot(&self, request: &Request) -> Lot {
        let is_faulty = self.is_faulty.load(Ordering::Acquire);
        let wanted = request.wanted();
        // What is asked for before the faults begin, or after they end, shifts nothing.
        // Nor is it remembered where nothing depends on it.
        let rates = self.args.rates();
        let is_drawn = self.args.jitter_ms > 0.0 || rates.iter().any(|(rate, _)| *rate > 0.0);
        let number = if is_faulty && is_drawn { self.turns.next(&wanted) } else { 0 };
        let mut chance = Chance::new(self.args.seed, &wanted, number);
        let fate = if is_faulty { chance.fate(&rates) } else { Fate::Whole };
        let wait_ms = self.args.latency_ms + self.args.jitter_ms * chance.share();
        Lot { wait: Duration::from_secs_f64(wait_ms / 1e3), fate, chance }
    }

    /// The answer, after its wait.
    pub(super) fn answer(&self, request: &Request, lot: Lot) -> Result<Outcome> {
        let Lot { fate, mut chance, .. } = lot;
        let answer = match fate {
            Fate::Silent => return Ok(Outcome::Silence),
            Fate::Reset if chance.share() < 0.5 => return Ok(Outcome::Reset(loss(&mut chance))),
            Fate::Error => {
                let status = match chance.share() {
                    share if share < 0.4 => StatusCode::INTERNAL_SERVER_ERROR,
                    share if share < 0.8 => StatusCode::SERVICE_UNAVAILABLE,
                    _ => StatusCode::TOO_MANY_REQUESTS,
                };
                Answer::empty(status).with("Retry-After", self.args.retry_after.to_string())
            }
            Fate::Page => {
                let length = PAGE.len() as u64;
                let page = Content { bytes: Box::new(PAGE), at: 0, length, corrupt_at: None };
                let content = (!request.is_head).then_some(page);
                Answer { content, ..Answer::new(StatusCode::OK, length).with("Content-Type", "text/html") }
            }
            fate => self.of_file(request, fate, &mut chance)?,
        };
        Ok(Outcome::Answer(answer))
    }

    /// The file that is asked for, or a part of it.
    fn of_file(&self, request: &Request, fate: Fate, chance: &mut Chance) -> Result<Answer> {
        let Some((mut file, is_gzip)) = self.open(request) else { return Ok(Answer::empty(StatusCode::NOT_FOUND)) };
        let metadata = file.metadata()?;
        let length = metadata.len();
        let modified = metadata.modified().ok().filter(|t| *t > UNIX_EPOCH).unwrap_or(UNIX_EPOCH);
        let nanoseconds = modified.duration_since(UNIX_EPOCH).map_or(0, |d| d.as_nanos());
        let (tag, date) = (format!("\"{length:x}-{nanoseconds:x}\""), httpdate::fmt_http_date(modified));
        // A part of something else than the client has is of no use to it.
        let wanted =
            request.range.as_deref().filter(|_| request.if_range.as_ref().is_none_or(|i| *i == tag || *i == date));
        let part = wanted.and_then(|r| range(r, length));
        let (status, first, count) = match part {
            _ if request.holds(&tag, &date) => (StatusCode::NOT_MODIFIED, 0, length),
            // None, or one that is not understood: the whole.
            None => (StatusCode::OK, 0, length),
            Some(Some((first, last))) => (StatusCode::PARTIAL_CONTENT, first, last - first + 1),
            Some(None) => (StatusCode::RANGE_NOT_SATISFIABLE, 0, 0),
        };
        let mut answer = Answer::new(status, count)
            .with("ETag", tag)
            .with("Accept-Ranges", "bytes")
            .with("Content-Type", kind(&request.path))
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
            file.seek(SeekFrom::Start(first))?;
        }
        let corrupt_at = (fate == Fate::Corrupted).then(|| (chance.share() * count as f64) as u64);
        answer.end = match fate {
            Fate::Truncated => End::Early,
            Fate::Stalled => End::Stall,
            Fate::Reset => End::Reset(loss(chance)),
            _ => End::Whole,
        };
        let sent = if answer.end == End::Whole { count } else { count / 2 };
        answer.content = Some(Content { bytes: Box::new(file), at: 0, length: sent, corrupt_at });
        Ok(answer)
    }

    /// The file, and whether it is gzip of what was asked for. Nothing outside the folder, links included.
    fn open(&self, request: &Request) -> Option<(File, bool)> {
        let relative = Path::new(request.path.trim_start_matches('/'));
        if !relative.components().all(|c| matches!(c, Component::Normal(_))) {
            return None;
        }
        // Most have no packed one: asking where a path leads takes longer than opening it.
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
            None => open(path).map(|file| (file, false)),
        }
    }
}

/// As often the one as the other.
fn loss(chance: &mut Chance) -> Loss {
    if chance.share() < 0.5 { Loss::Stream } else { Loss::Connection }
}

/// First and last byte of a single range: `None` when it is not one, `Some(None)` when it lies outside.
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

fn kind(path: &str) -> &'static str {
    match path.rsplit('.').next().unwrap_or("") {
        "json" => "application/json",
        "glb" => "model/gltf-binary",
        "gltf" => "model/gltf+json",
        "png" => "image/png",
        "jpg" | "jpeg" => "image/jpeg",
        "exr" => "image/aces",
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
