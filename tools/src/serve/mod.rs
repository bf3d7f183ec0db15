//! `terrane serve`: serves a folder over HTTP/1.1 and HTTP/2, encrypted or not, with a chosen latency, bandwidth and rate
//! of faults: errors, truncation, corruption, stalls, missing answers and resets. The faults are the same for the same seed.
//!
//! ```text
//! connection -> http1 (blocking) --\
//!            -> http2 (async) ------+-> answer (the file, or a tile of a procedural planet, or a part of it, and its fault) -> bandwidth
//!            -> tls -> either one -/
//! ```
//! Each connection has a thread, which is enough for one client; a real web server suits many. HTTP/1.1 blocks its thread
//! and uses no async runtime, whose timers have a resolution of one millisecond and would distort measurements.

mod answer;
mod args;
mod bandwidth;
mod faults;
mod http1;
mod http2;
mod procedural;
mod server;
mod tls;

use std::io::Write as _;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context as _, Error, Result, ensure};

pub use self::args::ServeArgs;
use self::faults::RequestCounts;
use self::procedural::Procedural;
use self::server::Server;
use self::tls::Tls;

/// A server that listens and does not accept connections yet.
struct Listening {
    server: Arc<Server>,
    /// The acceptor of encrypted connections; `None` if connections are not encrypted.
    tls: Option<Arc<Tls>>,
    listener: TcpListener,
    address: SocketAddr,
}

impl Listening {
    /// Opens the port.
    fn new(args: ServeArgs) -> Result<Self> {
        args.check().map_err(Error::msg)?;
        let procedural = args.procedural.map(|preset| Procedural::new(preset, &args));
        let folder = match &args.folder {
            Some(folder) => folder.canonicalize().with_context(|| folder.display().to_string())?,
            None => PathBuf::new(),
        };
        ensure!(procedural.is_some() || folder.is_dir(), "{}: is not a folder", folder.display());
        let address = format!("{}:{}", args.bind, args.port);
        let listener = TcpListener::bind(&address).with_context(|| format!("cannot listen on {address}"))?;
        let address = listener.local_addr()?;
        let tls = args.tls.as_deref().map(|file| Tls::new(file, &args)).transpose()?.map(Arc::new);
        let (is_faulty, is_stopped) = (AtomicBool::new(true), AtomicBool::new(false));
        let server =
            Arc::new(Server { args, folder, procedural, counts: RequestCounts::default(), is_faulty, is_stopped });
        Ok(Self { server, tls, listener, address })
    }

    /// Returns the URL, with a slash at the end.
    fn url(&self) -> String {
        let scheme = if self.tls.is_some() { "https" } else { "http" };
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
            let (server, tls) = (self.server.clone(), self.tls.clone());
            let spawned = std::thread::Builder::new().name("connection".to_owned()).spawn(move || {
                // A client that closes its connection is not an error.
                let _ = connection(&server, tls.as_deref(), stream);
            });
            if let Err(error) = spawned {
                eprintln!("terrane serve: a connection was refused: {error}");
            }
        }
    }
}

/// Serves one connection, on its thread.
fn connection(server: &Arc<Server>, tls: Option<&Tls>, stream: TcpStream) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    match tls {
        Some(tls) => tls.serve(server, stream),
        None if server.args.http2 => http2::serve_open(server, stream),
        None => http1::serve(server, stream),
    }
}

/// Runs `terrane serve`, until the process ends.
pub fn run(args: ServeArgs) -> Result<()> {
    let listening = Listening::new(args)?;
    let server = &listening.server;
    let what = match server.args.procedural {
        Some(preset) => format!("the world {} with seed {}", preset.name(), server.args.seed),
        None => server.folder.display().to_string(),
    };
    let line = format!("serving {what} at {}", listening.url());
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
