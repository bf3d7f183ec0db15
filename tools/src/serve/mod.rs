//! `terrane serve`: a folder over HTTP/1.1 and HTTP/2, open or encrypted, as well or as badly as asked: latency,
//! bandwidth, errors, truncation, corruption, stalls, silence and resets, the same for the same seed.
//!
//! ```text
//! connection -> http1 (blocking) --\
//!            -> http2 (async) ------+-> answer (what there is, and its fate by chance) -> line (bandwidth)
//!            -> tls -> either one -/
//! ```
//! A thread a connection, which is enough for one client; for many use a real web server. HTTP/1.1 blocks its thread and
//! needs no runtime, whose timers count whole milliseconds: what is measured against it is not to pay for either.

mod answer;
mod chance;
mod http1;
mod http2;
mod line;
mod tls;

use std::io::Write as _;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context as _, Error, Result, ensure};
use clap::Args as ClapArgs;

use self::chance::{Fate, Turns};
use self::tls::Tls;
use crate::values::{amount, share};

/// A connection without a request ends.
const IDLE: Duration = Duration::from_secs(60);
/// From the half of an answer to the reset.
const BEFORE_RESET: Duration = Duration::from_millis(20);

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
    /// Speak HTTP/2 alone; without --tls to clients that know it beforehand
    #[arg(long)]
    pub http2: bool,
    /// Speak HTTP/1.1 alone, with --tls too, which else has both
    #[arg(long, conflicts_with = "http2")]
    pub http1: bool,
    /// Encrypt; FILE becomes the PEM of a certificate made at each start, for clients to trust (--ca-file)
    #[arg(long, value_name = "FILE")]
    pub tls: Option<PathBuf>,
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
    /// Share of connections reset instead of an answer, or half way through it; of HTTP/2 as often the stream alone
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
            http2: false,
            http1: false,
            tls: None,
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
    tls: Option<Tls>,
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
        let tls = args.tls.as_deref().map(|file| Tls::new(file, &args)).transpose()?;
        let (is_faulty, is_over) = (AtomicBool::new(true), AtomicBool::new(false));
        let server = Arc::new(Server { args, folder, tls, turns: Turns::default(), is_faulty, is_over });
        Ok(Self { server, listener, address })
    }

    /// With a slash at the end.
    fn url(&self) -> String {
        let scheme = if self.server.tls.is_some() { "https" } else { "http" };
        format!("{scheme}://{}/", self.address)
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
                let _ = connection(&server, stream);
            });
            if let Err(error) = spawned {
                eprintln!("terrane serve: a connection was refused: {error}");
            }
        }
    }
}

/// A connection's thread.
fn connection(server: &Arc<Server>, stream: TcpStream) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    match &server.tls {
        Some(tls) => tls.serve(server, stream),
        None if server.args.http2 => http2::serve_open(server, stream),
        None => http1::serve(server, stream),
    }
}

pub fn run(args: ServeArgs) -> Result<()> {
    let listening = Listening::new(args)?;
    let line = format!("serving {} at {}", listening.server.folder.display(), listening.url());
    // Nobody has to read it.
    let _ = writeln!(std::io::stdout(), "{line}");
    listening.run();
    Ok(())
}

/// A server on a thread of this process; takes no more connections once dropped.
pub struct Background {
    server: Arc<Server>,
    address: SocketAddr,
    url: String,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Background {
    pub fn start(args: ServeArgs) -> Result<Self> {
        let listening = Listening::new(args)?;
        let (server, address, url) = (listening.server.clone(), listening.address, listening.url());
        let thread = std::thread::Builder::new().name("serve".to_owned()).spawn(move || listening.run())?;
        Ok(Self { server, address, url, thread: Some(thread) })
    }

    /// Where it listens, with a slash at the end.
    pub fn url(&self) -> &str {
        &self.url
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
