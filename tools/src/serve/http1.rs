//! HTTP/1.1 on a connection, encrypted or not. Requests are served one after the other on the connection's thread.

use std::io::{BufRead as _, BufReader, Read, Result, Write};
use std::net::TcpStream;
use std::time::Duration;

use http::StatusCode;
use tokio_rustls::rustls::{ServerConnection, StreamOwned};

use super::answer::{Answer, Content, End, Outcome, Request};
use super::bandwidth::BandwidthLimit;
use super::server::{IDLE_TIMEOUT, RESET_DELAY, Server};

/// Maximum size of the head of a request.
const MAX_HEAD_BYTES: u64 = 16 << 10;

/// A connection, encrypted or not.
pub(super) trait Stream: Read + Write {
    /// Returns the socket below the encryption.
    fn socket(&self) -> &TcpStream;
}

impl Stream for TcpStream {
    fn socket(&self) -> &TcpStream {
        self
    }
}

impl Stream for StreamOwned<ServerConnection, TcpStream> {
    fn socket(&self) -> &TcpStream {
        &self.sock
    }
}

/// Answers requests until either side closes the connection.
pub(super) fn serve<S: Stream>(server: &Server, stream: S) -> Result<()> {
    stream.socket().set_read_timeout(Some(IDLE_TIMEOUT))?;
    let mut reader = BufReader::new(stream);
    let mut bandwidth = BandwidthLimit::new(server.args.bandwidth);
    let mut buffer = Vec::new();
    while let Some(head) = read_head(&mut reader)? {
        let stream = reader.get_mut();
        let (request, keeps_alive) = match parse(&head) {
            Ok(parsed) => parsed,
            Err(status) => return stream.write_all(&head_of(&Answer::empty(status), false)),
        };
        if !answer(server, stream, &request, &mut bandwidth, &mut buffer)? || !keeps_alive {
            break;
        }
    }
    Ok(())
}

/// Answers one request. Returns false if the connection must be closed then.
fn answer<S: Stream>(
    server: &Server,
    stream: &mut S,
    request: &Request,
    bandwidth: &mut BandwidthLimit,
    buffer: &mut Vec<u8>,
) -> Result<bool> {
    let decision = server.decide(request);
    std::thread::sleep(decision.wait);
    let mut answer = match server.answer(request, decision)? {
        Outcome::Silence => return wait_for_close(stream),
        Outcome::Reset(_) => return reset(stream),
        Outcome::Answer(answer) => answer,
    };
    let head = head_of(&answer, true);
    match &mut answer.content {
        Some(content) => send(stream, &head, content, bandwidth, buffer)?,
        None => stream.write_all(&head)?,
    }
    match answer.end {
        End::Whole => Ok(true),
        End::Early => Ok(false),
        End::Stall => wait_for_close(stream),
        End::Reset(_) => {
            // The client must receive the first half before the reset.
            std::thread::sleep(RESET_DELAY);
            reset(stream)
        }
    }
}

/// Sends a head and its content in pieces. Pieces that need not be delayed are sent with one write, so that the client
/// wakes up once.
fn send<S: Stream>(
    stream: &mut S,
    head: &[u8],
    content: &mut Content,
    bandwidth: &mut BandwidthLimit,
    buffer: &mut Vec<u8>,
) -> Result<()> {
    bandwidth.start_body();
    let piece = bandwidth.max_piece_bytes();
    buffer.resize(buffer.len().max(head.len() + piece), 0);
    buffer[..head.len()].copy_from_slice(head);
    // The number of bytes in the buffer that are not sent yet. The next piece is read behind them.
    let mut unsent = head.len();
    while !content.is_done() {
        let end = unsent + content.read(&mut buffer[unsent..unsent + piece])?;
        let wait = bandwidth.delay_for(end - unsent);
        let mut first = 0;
        if !wait.is_zero() {
            stream.write_all(&buffer[..unsent])?;
            std::thread::sleep(wait);
            first = unsent;
        }
        stream.write_all(&buffer[first..end])?;
        unsent = 0;
    }
    stream.write_all(&buffer[..unsent])
}

/// Makes closing the connection a reset.
fn reset<S: Stream>(stream: &S) -> Result<bool> {
    socket2::SockRef::from(stream.socket()).set_linger(Some(Duration::ZERO))?;
    Ok(false)
}

/// Waits until the client closes the connection.
fn wait_for_close<S: Stream>(stream: &mut S) -> Result<bool> {
    stream.socket().set_read_timeout(None)?;
    while stream.read(&mut [0; 256]).is_ok_and(|n| n > 0) {}
    Ok(false)
}

/// Reads the head of a request. `None` at the end of the connection, and if the head is too long.
fn read_head<S: Stream>(reader: &mut BufReader<S>) -> Result<Option<Vec<u8>>> {
    let mut head = Vec::new();
    let mut limited = reader.take(MAX_HEAD_BYTES);
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

/// Parses a head. Returns the request and whether the connection stays open; the error is the status of the answer.
fn parse(head: &[u8]) -> std::result::Result<(Request, bool), StatusCode> {
    const BAD: StatusCode = StatusCode::BAD_REQUEST;
    let mut headers = [httparse::EMPTY_HEADER; 64];
    let mut request = httparse::Request::new(&mut headers);
    request.parse(head).ok().filter(httparse::Status::is_complete).ok_or(BAD)?;
    let header = |name: &str| {
        let found = request.headers.iter().find(|h| h.name.eq_ignore_ascii_case(name))?;
        std::str::from_utf8(found.value).ok().map(str::to_owned)
    };
    let closes = header("connection").is_some_and(|v| v.to_ascii_lowercase().contains("close"));
    let keeps_alive = request.version == Some(1) && !closes;
    Ok((Request::new(request.method.ok_or(BAD)?, request.path.ok_or(BAD)?, header)?, keeps_alive))
}

/// Returns the head of an answer.
fn head_of(answer: &Answer, keeps_alive: bool) -> Vec<u8> {
    let connection = if keeps_alive { "keep-alive" } else { "close" };
    let mut head = format!("HTTP/1.1 {}\r\nConnection: {connection}\r\n", answer.status);
    for (name, value) in &answer.headers {
        head.extend([*name, ": ", value, "\r\n"]);
    }
    head.push_str("\r\n");
    head.into_bytes()
}
