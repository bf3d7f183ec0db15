//! An HTTP/1.1 server on this machine. The test decides its replies and their faults. It keeps connections alive and
//! starts a thread for each.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// A request as it arrived.
#[derive(Clone, Debug)]
pub struct Request {
    /// The method, such as `GET`.
    pub method: String,
    /// The target of the request line, with the query; an absolute URL if the client uses the server as its proxy.
    pub target: String,
    /// Header names, in lower case, and values.
    pub headers: Vec<(String, String)>,
    /// The content, if the request says how long it is.
    pub body: Vec<u8>,
    /// The number of the connection, from 0.
    pub connection: usize,
    /// The number of earlier requests for the same target.
    pub nth: usize,
}

impl Request {
    /// Returns the target without the query.
    pub fn path(&self) -> &str {
        self.target.split('?').next().unwrap()
    }

    /// Returns the first header of that name, given in lower case.
    pub fn header(&self, name: &str) -> Option<&str> {
        self.headers.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_str())
    }
}

/// How a reply is sent: whole, or with a fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum How {
    /// The whole body, with `Content-Length`.
    Whole,
    /// The whole body in chunks of 1,000 bytes.
    Chunked,
    /// The whole body, one byte every 20 ms.
    Slowly,
    /// Half of the announced bytes; then the server closes the connection.
    Cut,
    /// Half of the announced bytes; then nothing until the client closes the connection.
    Stall,
    /// Nothing at all until the client closes the connection.
    Silent,
    /// No reply: the server closes the connection.
    Reset,
}

/// A reply. By default it is sent whole and without delay.
#[derive(Clone, Debug)]
pub struct Reply {
    /// The status code.
    pub status: u16,
    /// Header names and values, without those that describe how the body is sent.
    pub headers: Vec<(String, String)>,
    /// The body.
    pub body: Vec<u8>,
    /// The number of zeros that follow the body. The server does not hold them in memory.
    pub zeros: usize,
    /// How the reply is sent.
    pub how: How,
    /// The delay before the reply is sent.
    pub delay: Duration,
}

impl Reply {
    /// Creates a reply.
    pub fn new(status: u16, body: impl Into<Vec<u8>>) -> Self {
        Self { status, headers: Vec::new(), body: body.into(), zeros: 0, how: How::Whole, delay: Duration::ZERO }
    }

    /// Creates a reply with status 200.
    pub fn ok(body: impl Into<Vec<u8>>) -> Self {
        Self::new(200, body)
    }

    /// Adds a header.
    pub fn with(mut self, name: &str, value: impl ToString) -> Self {
        self.headers.push((name.to_owned(), value.to_string()));
        self
    }

    /// Sends zeros after the body, if the reply is whole or chunked.
    pub fn then_zeros(mut self, zeros: usize) -> Self {
        self.zeros = zeros;
        self
    }

    /// Sets how the reply is sent.
    pub fn how(mut self, how: How) -> Self {
        self.how = how;
        self
    }

    /// Returns the part of the body that the request's `Range` header asks for (status 206, or 416 out of range), or the
    /// whole without the header.
    pub fn ranged(self, request: &Request) -> Self {
        let Some(range) = request.header("range").and_then(|r| r.strip_prefix("bytes=")) else { return self };
        let length = self.body.len();
        let (first, last) = range.split_once('-').unwrap();
        let (first, last) = match (first, last) {
            ("", suffix) => (length.saturating_sub(suffix.parse().unwrap()), length - 1),
            (first, "") => (first.parse().unwrap(), length - 1),
            (first, last) => (first.parse().unwrap(), last.parse::<usize>().unwrap().min(length - 1)),
        };
        if first > last {
            return Self::new(416, "").with("Content-Range", format!("bytes */{length}"));
        }
        let body = self.body[first..=last].to_vec();
        Self { status: 206, body, ..self }.with("Content-Range", format!("bytes {first}-{last}/{length}"))
    }
}

/// A running server. Its threads end with the process.
pub struct Server {
    /// `http://ADDRESS:PORT`, without a slash at the end.
    pub url: String,
    seen: Arc<Mutex<Vec<Request>>>,
}

impl Server {
    /// Starts a server on a free port; `answer` is called on the thread of the connection.
    pub fn start(answer: impl Fn(&Request) -> Reply + Send + Sync + 'static) -> Self {
        Self::start_at("127.0.0.1", answer)
    }

    /// Starts a server on a free port of an address of this machine.
    pub fn start_at(address: &str, answer: impl Fn(&Request) -> Reply + Send + Sync + 'static) -> Self {
        let listener = TcpListener::bind((address, 0)).unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let seen = Arc::new(Mutex::new(Vec::new()));
        let (answer, log, count) = (Arc::new(answer), seen.clone(), AtomicUsize::new(0));
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let (answer, log) = (answer.clone(), log.clone());
                let connection = count.fetch_add(1, Ordering::Relaxed);
                std::thread::spawn(move || serve(stream, connection, &*answer, &log));
            }
        });
        Self { url, seen }
    }

    /// Returns `ADDRESS:PORT`.
    pub fn host(&self) -> &str {
        self.url.trim_start_matches("http://")
    }

    /// Returns the port.
    pub fn port(&self) -> u16 {
        self.host().rsplit(':').next().unwrap().parse().unwrap()
    }

    /// Returns all requests so far, in order of arrival.
    pub fn seen(&self) -> Vec<Request> {
        self.seen.lock().unwrap().clone()
    }

    /// Returns the number of requests so far.
    pub fn count(&self) -> usize {
        self.seen.lock().unwrap().len()
    }
}

/// Serves the requests of one connection until the client or a fault closes it.
fn serve(
    stream: TcpStream,
    connection: usize,
    answer: &dyn Fn(&Request) -> Reply,
    log: &Mutex<Vec<Request>>,
) -> std::io::Result<()> {
    let mut reader = BufReader::new(stream.try_clone()?);
    let mut stream = stream;
    stream.set_nodelay(true)?;
    loop {
        let mut first = String::new();
        if reader.read_line(&mut first)? == 0 {
            return Ok(());
        }
        let mut headers = Vec::new();
        loop {
            let mut line = String::new();
            reader.read_line(&mut line)?;
            let Some((name, value)) = line.trim_end().split_once(':') else { break };
            headers.push((name.to_ascii_lowercase(), value.trim().to_owned()));
        }
        let mut words = first.split(' ').map(str::to_owned);
        let (method, target) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
        let length = headers.iter().find(|(name, _)| name == "content-length").map(|(_, length)| length.parse::<u64>());
        let mut body = Vec::new();
        (&mut reader).take(length.and_then(Result::ok).unwrap_or(0)).read_to_end(&mut body)?;
        let request = {
            let mut log = log.lock().unwrap();
            let nth = log.iter().filter(|r| r.target == target).count();
            log.push(Request { method, target, headers, body, connection, nth });
            log.last().unwrap().clone()
        };
        let reply = answer(&request);
        std::thread::sleep(reply.delay);
        if reply.how == How::Reset {
            return stream.shutdown(Shutdown::Both);
        }
        let wait_until_closed = |stream: &mut TcpStream| while stream.read(&mut [0; 64]).is_ok_and(|n| n > 0) {};
        if reply.how == How::Silent {
            wait_until_closed(&mut stream);
            return Ok(());
        }
        let mut head = format!("HTTP/1.1 {} Test\r\n", reply.status);
        for (name, value) in &reply.headers {
            head.push_str(&format!("{name}: {value}\r\n"));
        }
        let bodiless = matches!(reply.status, 204 | 304);
        match reply.how {
            How::Chunked => head.push_str("Transfer-Encoding: chunked\r\n"),
            _ if bodiless => {}
            _ => head.push_str(&format!("Content-Length: {}\r\n", reply.body.len() + reply.zeros)),
        }
        head.push_str("\r\n");
        stream.write_all(head.as_bytes())?;
        match reply.how {
            How::Chunked => {
                for piece in reply.body.chunks(1000).chain(zeros(reply.zeros)) {
                    stream.write_all(format!("{:x}\r\n", piece.len()).as_bytes())?;
                    stream.write_all(piece)?;
                    stream.write_all(b"\r\n")?;
                }
                stream.write_all(b"0\r\n\r\n")?;
            }
            How::Cut | How::Stall => {
                stream.write_all(&reply.body[..reply.body.len() / 2])?;
                if reply.how == How::Stall {
                    wait_until_closed(&mut stream);
                }
                return stream.shutdown(Shutdown::Both);
            }
            How::Slowly => {
                for byte in reply.body.chunks(1) {
                    std::thread::sleep(Duration::from_millis(20));
                    stream.write_all(byte)?;
                }
            }
            _ if bodiless => {}
            _ => {
                stream.write_all(&reply.body)?;
                zeros(reply.zeros).try_for_each(|piece| stream.write_all(piece))?;
            }
        }
    }
}

/// Returns zeros in pieces of one buffer.
fn zeros<'a>(count: usize) -> impl Iterator<Item = &'a [u8]> {
    const PIECE: usize = 64 << 10;
    static ZEROS: [u8; PIECE] = [0; PIECE];
    (0..count).step_by(PIECE).map(move |begin| &ZEROS[..PIECE.min(count - begin)])
}
