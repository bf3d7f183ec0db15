//! `terrane serve`: serves a folder over HTTP/1.1 and HTTP/2, encrypted or not, with a chosen latency, bandwidth and rate
//! of faults: errors, truncation, corruption, stalls, missing answers and resets. The faults are the same for the same seed.
//!
//! ```text
//! connection -> http1 (blocking) --\
//!            -> http2 (async) ------+-> answer (the file or a part of it, and its fault) -> bandwidth
//!            -> tls -> either one -/
//! ```
//! Each connection has a thread, which is enough for one client; a real web server suits many. HTTP/1.1 blocks its thread
//! and uses no async runtime, whose timers have a resolution of one millisecond and would distort measurements.

mod answer;
mod bandwidth;
mod faults;
mod http1;
mod http2;
mod tls;

use std::io::Write as _;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context as _, Error, Result, ensure};
use clap::Args as ClapArgs;

use self::faults::{Fault, RequestCounts};
use self::tls::Tls;
use crate::values::{amount, share};

/// The time after which a connection without requests is closed.
const IDLE_TIMEOUT: Duration = Duration::from_secs(60);
/// The time between the first half of an answer and a reset, so that the client receives that half.
const RESET_DELAY: Duration = Duration::from_millis(20);

#[derive(Clone, Debug, ClapArgs)]
pub struct ServeArgs {
    /// Folder to serve
    pub folder: PathBuf,
    /// Port; 0 selects a free one
    #[arg(long, default_value_t = 8080)]
    pub port: u16,
    /// Address to listen on
    #[arg(long, default_value = "127.0.0.1")]
    pub bind: String,
    /// Speak only HTTP/2; without --tls for clients that use it without negotiation
    #[arg(long)]
    pub http2: bool,
    /// Speak only HTTP/1.1; --tls alone offers both versions
    #[arg(long, conflicts_with = "http2")]
    pub http1: bool,
    /// Encrypt with a new certificate, which is written to FILE as PEM for clients to trust (--ca-file)
    #[arg(long, value_name = "FILE")]
    pub tls: Option<PathBuf>,
    /// Latency of every answer in milliseconds
    #[arg(long, default_value_t = 0.0, value_parser = amount)]
    pub latency_ms: f64,
    /// Maximum random addition to the latency in milliseconds
    #[arg(long, default_value_t = 0.0, value_parser = amount)]
    pub jitter_ms: f64,
    /// Bytes per second of each connection; 0 for no limit
    #[arg(long, default_value_t = 0.0, value_parser = amount)]
    pub bandwidth: f64,
    /// Share of answers with status 429, 500 or 503
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub error_rate: f64,
    /// Share of answers whose body ends early
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub truncate_rate: f64,
    /// Share of answers with changed bytes
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub corrupt_rate: f64,
    /// Share of answers that stop half way until the client closes the connection
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub stall_rate: f64,
    /// Share of answers replaced or cut half way by a reset of the connection; with HTTP/2 in half of the cases only the
    /// stream is reset
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub reset_rate: f64,
    /// Share of requests without any answer until the client closes the connection
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub silent_rate: f64,
    /// Share of answers that are a web page with status 200 instead
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    pub page_rate: f64,
    /// Seconds in the header `Retry-After` of failures
    #[arg(long, default_value_t = 0)]
    pub retry_after: u32,
    /// Seconds for which answers are fresh (`Cache-Control: max-age`) [default: no such header]
    #[arg(long, value_name = "SECONDS")]
    pub max_age: Option<u32>,
    /// Seed of the faults, which are a function of seed, path, range and number of the request for them
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

impl ServeArgs {
    /// Checks combinations of arguments.
    pub fn check(&self) -> Result<(), String> {
        let all: f64 = self.rates().iter().map(|(rate, _)| rate).sum();
        if all <= 1.0 { Ok(()) } else { Err(format!("the rates are {all} together, more than 1")) }
    }

    /// Returns the share of answers for each fault.
    fn rates(&self) -> [(f64, Fault); 7] {
        [
            (self.error_rate, Fault::Error),
            (self.truncate_rate, Fault::Truncated),
            (self.corrupt_rate, Fault::Corrupted),
            (self.stall_rate, Fault::Stalled),
            (self.reset_rate, Fault::Reset),
            (self.silent_rate, Fault::Silent),
            (self.page_rate, Fault::Page),
        ]
    }
}

impl ServeArgs {
    /// Returns the defaults for a folder, on a free port of the loopback address.
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

/// The state that all connections share.
struct Server {
    args: ServeArgs,
    folder: PathBuf,
    tls: Option<Tls>,
    counts: RequestCounts,
    /// Faults are on. Set through [`Background::set_faulty`], read by the connections.
    is_faulty: AtomicBool,
    /// Set when the server is dropped, read by the thread that accepts connections.
    is_stopped: AtomicBool,
}

/// A server that listens and does not accept connections yet.
struct Listening {
    server: Arc<Server>,
    listener: TcpListener,
    address: SocketAddr,
}

impl Listening {
    /// Opens the port.
    fn new(args: ServeArgs) -> Result<Self> {
        args.check().map_err(Error::msg)?;
        let folder = args.folder.canonicalize().with_context(|| args.folder.display().to_string())?;
        ensure!(folder.is_dir(), "{}: is not a folder", folder.display());
        let address = format!("{}:{}", args.bind, args.port);
        let listener = TcpListener::bind(&address).with_context(|| format!("cannot listen on {address}"))?;
        let address = listener.local_addr()?;
        let tls = args.tls.as_deref().map(|file| Tls::new(file, &args)).transpose()?;
        let (is_faulty, is_stopped) = (AtomicBool::new(true), AtomicBool::new(false));
        let server = Arc::new(Server { args, folder, tls, counts: RequestCounts::default(), is_faulty, is_stopped });
        Ok(Self { server, listener, address })
    }

    /// Returns the URL, with a slash at the end.
    fn url(&self) -> String {
        let scheme = if self.server.tls.is_some() { "https" } else { "http" };
        format!("{scheme}://{}/", self.address)
    }

    /// Accepts connections until the server is stopped, each on a new thread.
    fn run(self) {
        for stream in self.listener.incoming() {
            if self.server.is_stopped.load(Ordering::Acquire) {
                return;
            }
            let Ok(stream) = stream else {
                // For example, no file descriptor is free. Other connections may end meanwhile.
                std::thread::sleep(Duration::from_millis(20));
                continue;
            };
            let server = self.server.clone();
            let spawned = std::thread::Builder::new().name("connection".to_owned()).spawn(move || {
                // A client that closes its connection is not an error.
                let _ = connection(&server, stream);
            });
            if let Err(error) = spawned {
                eprintln!("terrane serve: a connection was refused: {error}");
            }
        }
    }
}

/// Serves one connection, on its thread.
fn connection(server: &Arc<Server>, stream: TcpStream) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    match &server.tls {
        Some(tls) => tls.serve(server, stream),
        None if server.args.http2 => http2::serve_open(server, stream),
        None => http1::serve(server, stream),
    }
}

/// Runs `terrane serve`, until the process ends.
pub fn run(args: ServeArgs) -> Result<()> {
    let listening = Listening::new(args)?;
    let line = format!("serving {} at {}", listening.server.folder.display(), listening.url());
    // The line is for information only; standard output may be closed.
    let _ = writeln!(std::io::stdout(), "{line}");
    listening.run();
    Ok(())
}

/// A server on a thread of this process. Dropping it ends that thread.
pub struct Background {
    server: Arc<Server>,
    address: SocketAddr,
    url: String,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Background {
    /// Starts the server.
    pub fn start(args: ServeArgs) -> Result<Self> {
        let listening = Listening::new(args)?;
        let (server, address, url) = (listening.server.clone(), listening.address, listening.url());
        let thread = std::thread::Builder::new().name("serve".to_owned()).spawn(move || listening.run())?;
        Ok(Self { server, address, url, thread: Some(thread) })
    }

    /// Returns the URL of the server, with a slash at the end.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// RequestCounts faults on or off. Latency and bandwidth stay.
    pub fn set_faulty(&self, is_faulty: bool) {
        self.server.is_faulty.store(is_faulty, Ordering::Release);
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        self.server.is_stopped.store(true, Ordering::Release);
        // The thread checks the flag when a connection arrives, so one is opened. If that fails, the thread is left behind.
        if let (Ok(_), Some(thread)) = (TcpStream::connect(self.address), self.thread.take()) {
            let _ = thread.join();
        }
    }
}
