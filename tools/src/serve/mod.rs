//! `terrane serve`: a folder over HTTP/1.1, as well or as badly as asked: latency, bandwidth, errors, truncation,
//! corruption, stalls, silence and resets, the same for the same seed.
//!
//! A thread a connection, which is enough for one client; for many use a real web server.

mod chance;

use std::fs::File;
use std::io::{BufRead as _, BufReader, ErrorKind, Read, Seek as _, SeekFrom, Write};
use std::net::SocketAddr;
use std::net::{TcpListener, TcpStream};
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, UNIX_EPOCH};

use anyhow::{Context as _, Error, Result, ensure};
use clap::Args as ClapArgs;

use self::chance::{Chance, Fate, Turns};
use crate::values::{amount, share};

/// Longest request head.
const MOST_HEAD_BYTES: u64 = 16 << 10;
/// A connection without a request ends.
const IDLE: Duration = Duration::from_secs(60);
/// From the half of an answer to the reset.
const BEFORE_RESET: Duration = Duration::from_millis(20);
/// Instead of a tile.
const PAGE: &[u8] = b"<!doctype html><title>Sorry</title><p>The page that you are looking for is not here.</p>\n";
/// Most bytes between two looks at the clock.
const PIECE: usize = 16 << 10;
/// Pieces a second at least, where the bandwidth is bounded.
const PIECES_PER_S: f64 = 50.0;

#[derive(Clone, Debug, ClapArgs)]
pub struct ServeArgs {
    /// Folder to serve
    pub folder: PathBuf,
    /// Port; 0 takes a free one
    #[arg(long, default_value_t = 8080)]
    pub port: u16,
    /// Address to listen on
    #[arg(long, default_value = "127.0.0.1")]
    pub bind: String,
    /// Wait before every answer, milliseconds
    #[arg(long, default_value_t = 0.0, value_parser = amount)]
    pub latency_ms: f64,
    /// Up to so much more, by chance
    #[arg(long, default_value_t = 0.0, value_parser = amount)]
    pub jitter_ms: f64,
    /// Bytes a second of each connection; 0 for as many as go
    #[arg(long, default_value_t = 0.0, value_parser = amount)]
    pub bandwidth: f64,
    /// Share of answers that are status 429, 500 or 503
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub error_rate: f64,
    /// Share of answers whose body ends early
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub truncate_rate: f64,
    /// Share of answers with changed bytes
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub corrupt_rate: f64,
    /// Share of answers that stop half way until the client goes
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub stall_rate: f64,
    /// Share of connections reset instead of an answer, or half way through it
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub reset_rate: f64,
    /// Share of requests that get no answer at all until the client goes
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub silent_rate: f64,
    /// Share of answers that are a web page with status 200 instead
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub page_rate: f64,
    /// Seconds that failures ask the client to wait (`Retry-After`)
    #[arg(long, default_value_t = 0)]
    pub retry_after: u32,
    /// Seconds for which clients may take answers without asking again (`Cache-Control`); without it they have to ask
    #[arg(long, value_name = "SECONDS")]
    pub max_age: Option<u32>,
    /// Chance is the same for the same seed, path, range and number of the request for these
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

impl ServeArgs {
    /// What no single argument says is wrong.
    pub fn check(&self) -> Result<(), String> {
        let all: f64 = self.rates().iter().map(|(rate, _)| rate).sum();
        if all <= 1.0 { Ok(()) } else { Err(format!("the rates are {all} together, more than 1")) }
    }

    /// Shares of answers, and what happens to them.
    fn rates(&self) -> [(f64, Fate); 7] {
        [
            (self.error_rate, Fate::Error),
            (self.truncate_rate, Fate::Truncated),
            (self.corrupt_rate, Fate::Corrupted),
            (self.stall_rate, Fate::Stalled),
            (self.reset_rate, Fate::Reset),
            (self.silent_rate, Fate::Silent),
            (self.page_rate, Fate::Page),
        ]
    }
}

impl ServeArgs {
    /// The defaults for a folder, on any free port of this machine alone.
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self {
            folder: folder.into(),
            port: 0,
            bind: "127.0.0.1".to_owned(),
            latency_ms: 0.0,
            jitter_ms: 0.0,
            bandwidth: 0.0,
            error_rate: 0.0,
            truncate_rate: 0.0,
            corrupt_rate: 0.0,
            stall_rate: 0.0,
            reset_rate: 0.0,
            silent_rate: 0.0,
            page_rate: 0.0,
            retry_after: 0,
            max_age: None,
            seed: 1,
        }
    }
}

struct Server {
    args: ServeArgs,
    folder: PathBuf,
    turns: Turns,
    /// Answers meet what chance has for them; set by whoever runs the server, read by its connections.
    is_faulty: AtomicBool,
    /// Set when the server is dropped, read where connections are taken.
    is_over: AtomicBool,
}

/// A server whose address is known and whose connections are not taken yet.
struct Listening {
    server: Arc<Server>,
    listener: TcpListener,
    address: SocketAddr,
}

impl Listening {
    fn new(args: ServeArgs) -> Result<Self> {
        args.check().map_err(Error::msg)?;
        let folder = args.folder.canonicalize().with_context(|| args.folder.display().to_string())?;
        ensure!(folder.is_dir(), "{}: is not a folder", folder.display());
        let address = format!("{}:{}", args.bind, args.port);
        let listener = TcpListener::bind(&address).with_context(|| format!("cannot listen on {address}"))?;
        let address = listener.local_addr()?;
        let (is_faulty, is_over) = (AtomicBool::new(true), AtomicBool::new(false));
        let server = Arc::new(Server { args, folder, turns: Turns::default(), is_faulty, is_over });
        Ok(Self { server, listener, address })
    }

    fn run(self) {
        for stream in self.listener.incoming() {
            if self.server.is_over.load(Ordering::Acquire) {
                return;
            }
            let Ok(stream) = stream else {
                // Out of descriptors, for example: others may end meanwhile.
                std::thread::sleep(Duration::from_millis(20));
                continue;
            };
            let server = self.server.clone();
            let spawned = std::thread::Builder::new().name("connection".to_owned()).spawn(move || {
                // A client that goes is not an error.
                let _ = server.connection(stream);
            });
            if let Err(error) = spawned {
                eprintln!("terrane serve: a connection was refused: {error}");
            }
        }
    }
}

pub fn run(args: ServeArgs) -> Result<()> {
    let listening = Listening::new(args)?;
    let line = format!("serving {} at http://{}/", listening.server.folder.display(), listening.address);
    // Nobody has to read it.
    let _ = writeln!(std::io::stdout(), "{line}");
    listening.run();
    Ok(())
}

/// A server on a thread of this process; takes no more connections once dropped.
pub struct Background {
    server: Arc<Server>,
    address: SocketAddr,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Background {
    pub fn start(args: ServeArgs) -> Result<Self> {
        let listening = Listening::new(args)?;
        let (server, address) = (listening.server.clone(), listening.address);
        let thread = std::thread::Builder::new().name("serve".to_owned()).spawn(move || listening.run())?;
        Ok(Self { server, address, thread: Some(thread) })
    }

    /// Where it listens, with a slash at the end.
    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }

    /// Whether answers meet what chance has for them; latency and bandwidth stay.
    pub fn set_faulty(&self, is_faulty: bool) {
        self.server.is_faulty.store(is_faulty, Ordering::Release);
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        self.server.is_over.store(true, Ordering::Release);
        // It looks when somebody comes; where nobody can, its thread is left to the end of the process.
        if let (Ok(_), Some(thread)) = (TcpStream::connect(self.address), self.thread.take()) {
            let _ = thread.join();
        }
    }
}

/// The parts of a request that count.
struct Request {
    is_head: bool,
    path: String,
    range: Option<String>,
    if_range: Option<String>,
    if_none_match: Option<String>,
    if_modified_since: Option<String>,
    takes_gzip: bool,
    keeps_alive: bool,
}

impl Request {
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

/// The connection ends by a reset when it is closed, not in order.
fn reset(stream: &TcpStream) -> std::io::Result<()> {
    socket2::SockRef::from(stream).set_linger(Some(Duration::ZERO))
}

fn wait_for_the_end(stream: &mut TcpStream) -> std::io::Result<()> {
    stream.set_read_timeout(None)?;
    while stream.read(&mut [0; 256]).is_ok_and(|n| n > 0) {}
    Ok(())
}

impl Server {
    fn connection(&self, stream: TcpStream) -> std::io::Result<()> {
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(IDLE))?;
        let mut reader = BufReader::new(stream.try_clone()?);
        let mut stream = stream;
        while let Some(head) = read_head(&mut reader)? {
            let request = match parse(&head) {
                Ok(request) => request,
                Err(status) => return stream.write_all(&head_of(status, 0, "", false)),
            };
            let keeps_alive = request.keeps_alive;
            if !self.answer(&mut stream, &request)? || !keeps_alive {
                break;
            }
        }
        Ok(())
    }

    /// False when the connection ends with it.
    fn answer(&self, stream: &mut TcpStream, request: &Request) -> std::io::Result<bool> {
        let is_faulty = self.is_faulty.load(Ordering::Acquire);
        let wanted = request.wanted();
        // What is asked for before the faults begin, or after they end, shifts nothing.
        let number = if is_faulty { self.turns.next(&wanted) } else { 0 };
        let mut chance = Chance::new(self.args.seed, &wanted, number);
        let fate = if is_faulty { chance.fate(&self.args.rates()) } else { Fate::Whole };
        let wait_ms = self.args.latency_ms + self.args.jitter_ms * chance.share();
        std::thread::sleep(Duration::from_secs_f64(wait_ms / 1e3));
        match fate {
            Fate::Reset if chance.share() < 0.5 => {
                reset(stream)?;
                return Ok(false);
            }
            Fate::Error => {
                let code = match chance.share() {
                    share if share < 0.4 => 500,
                    share if share < 0.8 => 503,
                    _ => 429,
                };
                let header = format!("Retry-After: {}\r\n", self.args.retry_after);
                stream.write_all(&head_of(&format!("{code} By Chance"), 0, &header, true))?;
                return Ok(true);
            }
            Fate::Silent => {
                wait_for_the_end(stream)?;
                return Ok(false);
            }
            Fate::Page => {
                let header = "Content-Type: text/html\r\n";
                stream.write_all(&head_of("200 OK", PAGE.len() as u64, header, true))?;
                stream.write_all(if request.is_head { b"" } else { PAGE })?;
                return Ok(true);
            }
            _ => {}
        }
        let Some((mut file, encoding)) = self.open(request) else {
            stream.write_all(&head_of("404 Not Found", 0, "", true))?;
            return Ok(true);
        };
        let metadata = file.metadata()?;
        let length = metadata.len();
        let modified = metadata.modified().ok().filter(|t| *t > UNIX_EPOCH).unwrap_or(UNIX_EPOCH);
        let nanoseconds = modified.duration_since(UNIX_EPOCH).map_or(0, |d| d.as_nanos());
        let tag = format!("\"{length:x}-{nanoseconds:x}\"");
        let date = httpdate::fmt_http_date(modified);
        let mut headers = format!("ETag: {tag}\r\nAccept-Ranges: bytes\r\nContent-Type: {}\r\n", kind(&request.path));
        headers.push_str(&format!("Vary: Accept-Encoding\r\nLast-Modified: {date}\r\n"));
        if let Some(seconds) = self.args.max_age {
            headers.push_str(&format!("Cache-Control: max-age={seconds}\r\n"));
        }
        if encoding {
            headers.push_str("Content-Encoding: gzip\r\n");
        }
        if request.holds(&tag, &date) {
            stream.write_all(&head_of("304 Not Modified", length, &headers, true))?;
            return Ok(true);
        }
        // A part of something else than the client has is of no use to it.
        let wanted =
            request.range.as_deref().filter(|_| request.if_range.as_ref().is_none_or(|i| *i == tag || *i == date));
        let (status, first, count) = match wanted.and_then(|r| range(r, length)) {
            // None, or one that is not understood: the whole.
            None => ("200 OK", 0, length),
            Some(Some((first, last))) => {
                headers.push_str(&format!("Content-Range: bytes {first}-{last}/{length}\r\n"));
                ("206 Partial Content", first, last - first + 1)
            }
            Some(None) => {
                headers.push_str(&format!("Content-Range: bytes */{length}\r\n"));
                stream.write_all(&head_of("416 Range Not Satisfiable", 0, &headers, true))?;
                return Ok(true);
            }
        };
        stream.write_all(&head_of(status, count, &headers, true))?;
        if request.is_head {
            return Ok(true);
        }
        file.seek(SeekFrom::Start(first))?;
        let sent = if matches!(fate, Fate::Truncated | Fate::Stalled | Fate::Reset) { count / 2 } else { count };
        let corrupt_at = (fate == Fate::Corrupted).then(|| (chance.share() * count as f64) as u64);
        self.send(stream, &mut file, sent, corrupt_at)?;
        match fate {
            Fate::Truncated => Ok(false),
            Fate::Reset => {
                // What was written is to be there before.
                std::thread::sleep(BEFORE_RESET);
                reset(stream)?;
                Ok(false)
            }
            Fate::Stalled => {
                wait_for_the_end(stream)?;
                Ok(false)
            }
            _ => Ok(true),
        }
    }

    fn send(
        &self,
        stream: &mut TcpStream,
        file: &mut File,
        mut left: u64,
        corrupt_at: Option<u64>,
    ) -> std::io::Result<()> {
        let bandwidth = self.args.bandwidth;
        let most = if bandwidth > 0.0 { ((bandwidth / PIECES_PER_S) as usize).clamp(1, PIECE) } else { PIECE };
        let mut piece = vec![0; most];
        let start = Instant::now();
        let mut at = 0u64;
        while left > 0 {
            let wanted = left.min(most as u64) as usize;
            let got = file.read(&mut piece[..wanted])?;
            if got == 0 {
                return Err(ErrorKind::UnexpectedEof.into());
            }
            if let Some(place) = corrupt_at.and_then(|c| c.checked_sub(at)).filter(|p| *p < got as u64) {
                piece[place as usize] ^= 0xff;
            }
            at += got as u64;
            if bandwidth > 0.0 {
                // Its last byte is there no sooner.
                let due = Duration::from_secs_f64(at as f64 / bandwidth);
                std::thread::sleep(due.saturating_sub(start.elapsed()));
            }
            stream.write_all(&piece[..got])?;
            left -= got as u64;
        }
        Ok(())
    }

    /// The file, and whether it is gzip of what was asked for. Nothing outside the folder, links included.
    fn open(&self, request: &Request) -> Option<(File, bool)> {
        let relative = Path::new(request.path.trim_start_matches('/'));
        if !relative.components().all(|c| matches!(c, Component::Normal(_))) {
            return None;
        }
        let open = |path: PathBuf| {
            let path = path.canonicalize().ok().filter(|p| p.starts_with(&self.folder) && p.is_file())?;
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

/// The head of a request; `None` at the end of the connection.
fn read_head(reader: &mut BufReader<TcpStream>) -> std::io::Result<Option<Vec<u8>>> {
    let mut head = Vec::new();
    let mut limited = reader.take(MOST_HEAD_BYTES);
    loop {
        let before = head.len();
        if limited.read_until(b'\n', &mut head)? == 0 {
            return Ok(None);
        }
        if matches!(&head[before..], b"\r\n" | b"\n") && before > 0 {
            return Ok(Some(head));
        }
    }
}

/// The request, or the status that it gets.
fn parse(head: &[u8]) -> Result<Request, &'static str> {
    const BAD: &str = "400 Bad Request";
    let mut headers = [httparse::EMPTY_HEADER; 64];
    let mut request = httparse::Request::new(&mut headers);
    request.parse(head).ok().filter(httparse::Status::is_complete).ok_or(BAD)?;
    let is_head = match request.method.ok_or(BAD)? {
        "GET" => false,
        "HEAD" => true,
        _ => return Err("405 Method Not Allowed"),
    };
    let target = request.path.and_then(|p| p.split(['?', '#']).next()).ok_or(BAD)?;
    let path = percent_encoding::percent_decode_str(target).decode_utf8().map_err(|_| BAD)?.into_owned();
    let header = |name: &str| {
        let found = request.headers.iter().find(|h| h.name.eq_ignore_ascii_case(name))?;
        std::str::from_utf8(found.value).ok().map(str::to_owned)
    };
    let has = |name: &str, what: &str| header(name).is_some_and(|v| v.to_ascii_lowercase().contains(what));
    Ok(Request {
        is_head,
        path,
        range: header("range"),
        if_range: header("if-range"),
        if_none_match: header("if-none-match"),
        if_modified_since: header("if-modified-since"),
        takes_gzip: has("accept-encoding", "gzip"),
        keeps_alive: request.version == Some(1) && !has("connection", "close"),
    })
}

fn head_of(status: &str, length: u64, headers: &str, keeps_alive: bool) -> Vec<u8> {
    let connection = if keeps_alive { "keep-alive" } else { "close" };
    // Other pages may fetch from here, as a viewer in a browser does.
    format!(
        "HTTP/1.1 {status}\r\nContent-Length: {length}\r\nConnection: {connection}\r\nAccess-Control-Allow-Origin: *\r\n{headers}\r\n"
    )
    .into_bytes()
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
