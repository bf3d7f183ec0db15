//! HTTP/1.1 on a connection, open or encrypted: one request after the other, on the connection's thread.

use std::io::{BufRead as _, BufReader, Read, Result, Write};
use std::net::TcpStream;
use std::time::Duration;

use http::StatusCode;
use tokio_rustls::rustls::{ServerConnection, StreamOwned};

use super::answer::{Answer, Content, End, Outcome, Request};
use super::line::Line;
use super::{BEFORE_RESET, IDLE, Server};

/// Longest request head.
const MOST_HEAD_BYTES: u64 = 16 << 10;

/// A connection, open or encrypted.
pub(super) trait Stream: Read + Write {
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

/// Answers until one of both ends goes.
pub(super) fn serve<S: Stream>(server: &Server, stream: S) -> Result<()> {
    stream.socket().set_read_timeout(Some(IDLE))?;
    let mut reader = BufReader::new(stream);
    let mut line = Line::new(server.args.bandwidth);
    let mut buffer = Vec::new();
    while let Some(head) = read_head(&mut reader)? {
        let stream = reader.get_mut();
        let (request, keeps_alive) = match parse(&head) {
            Ok(parsed) => parsed,
            Err(status) => return stream.write_all(&head_of(&Answer::empty(status), false)),
        };
        if !answer(server, stream, &request, &mut line, &mut buffer)? || !keeps_alive {
            break;
        }
    }
    Ok(())
}

/// False when the connection ends with it.
fn answer<S: Stream>(
    server: &Server,
    stream: &mut S,
    request: &Request,
    line: &mut Line,
    buffer: &mut Vec<u8>,
) -> Result<bool> {
    let lot = server.lot(request);
    std::thread::sleep(lot.wait);
    let mut answer = match server.answer(request, lot)? {
        Outcome::Silence => return wait_for_the_end(stream),
        Outcome::Reset(_) => return reset(stream),
        Outcome::Answer(answer) => answer,
    };
    let head = head_of(&answer, true);
    match &mut answer.content {
        Some(content) => send(stream, &head, content, line, buffer)?,
        None => stream.write_all(&head)?,
    }
    match answer.end {
        End::Whole => Ok(true),
        End::Early => Ok(false),
        End::Stall => wait_for_the_end(stream),
        End::Reset(_) => {
            // What was written is to be there before.
            std::thread::sleep(BEFORE_RESET);
            reset(stream)
        }
    }
}

/// A head and its content, in pieces. What need not wait goes together: a client wakes once for it.
fn send<S: Stream>(
    stream: &mut S,
    head: &[u8],
    content: &mut Content,
    line: &mut Line,
    buffer: &mut Vec<u8>,
) -> Result<()> {
    line.begin();
    let piece = line.piece();
    buffer.resize(buffer.len().max(head.len() + piece), 0);
    buffer[..head.len()].copy_from_slice(head);
    // So many bytes of the buffer are to go before what is read behind them.
    let mut unsent = head.len();
    while !content.is_over() {
        let end = unsent + content.read(&mut buffer[unsent..unsent + piece])?;
        let wait = line.carry(end - unsent);
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

/// The connection ends by a reset when it is closed, not in order.
fn reset<S: Stream>(stream: &S) -> Result<bool> {
    socket2::SockRef::from(stream.socket()).set_linger(Some(Duration::ZERO))?;
    Ok(false)
}

fn wait_for_the_end<S: Stream>(stream: &mut S) -> Result<bool> {
    stream.socket().set_read_timeout(None)?;
    while stream.read(&mut [0; 256]).is_ok_and(|n| n > 0) {}
    Ok(false)
}

/// The head of a request; `None` at the end of the connection.
fn read_head<S: Stream>(reader: &mut BufReader<S>) -> Result<Option<Vec<u8>>> {
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

/// The request and whether another one may follow, or the status that it gets.
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

fn head_of(answer: &Answer, keeps_alive: bool) -> Vec<u8> {
    let connection = if keeps_alive { "keep-alive" } else { "close" };
    let mut head = format!("HTTP/1.1 {}\r\nConnection: {connection}\r\n", answer.status);
    for (name, value) in &answer.headers {
        head.extend([*name, ": ", value, "\r\n"]);
    }
    head.push_str("\r\n");
    head.into_bytes()
}
