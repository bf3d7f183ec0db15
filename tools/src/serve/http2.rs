//! HTTP/2 on a connection, open or encrypted: many requests at once, each a task on the connection's thread.
//!
//! Files are read there too, as they are in memory by the second time. What stalls or is silent holds none of the
//! connection's flow control window: a body reserves of it what it is about to send, and no more.

use std::future::{pending, poll_fn};
use std::io::{Error, Read as _, Result};
use std::net::TcpStream;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use h2::server::{Builder, SendResponse};
use h2::{Reason, RecvStream, SendStream};
use http::Response;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::Notify;
use tokio::task::JoinSet;

use super::answer::{Answer, Content, End, Loss, Outcome, Request};
use super::line::Line;
use super::{BEFORE_RESET, IDLE, Server};

/// Requests of a connection at once, as common servers have it.
const MOST_STREAMS: u32 = 128;

/// Bytes of a body.
type Piece = std::io::Cursor<Vec<u8>>;

/// What the requests of a connection share.
struct Shared {
    /// Taken for each piece of a body.
    line: Mutex<Line>,
    /// Told by a request that takes the connection with it.
    is_lost: Notify,
}

impl Shared {
    /// The connection is lost. The request stays until then: its end is a reset of its stream, which would come before.
    async fn lose(&self) -> Result<()> {
        self.is_lost.notify_one();
        pending().await
    }
}

/// The runtime of a connection.
pub(super) fn runtime() -> Result<tokio::runtime::Runtime> {
    tokio::runtime::Builder::new_current_thread().enable_all().build()
}

/// Serves a connection that is not encrypted, and whose client knows the version beforehand.
pub(super) fn serve_open(server: &Arc<Server>, stream: TcpStream) -> Result<()> {
    let socket = stream.try_clone()?;
    stream.set_nonblocking(true)?;
    runtime()?.block_on(async { serve(server, &socket, tokio::net::TcpStream::from_std(stream)?).await })
}

/// Answers until one of both ends goes. The socket is the one below the stream.
pub(super) async fn serve<S>(server: &Arc<Server>, socket: &TcpStream, stream: S) -> Result<()>
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    let handshake = Builder::new().max_concurrent_streams(MOST_STREAMS).handshake(stream);
    let mut connection = tokio::time::timeout(IDLE, handshake).await?.map_err(Error::other)?;
    let shared = Arc::new(Shared { line: Mutex::new(Line::new(server.args.bandwidth)), is_lost: Notify::new() });
    // Those that are under way end with the connection.
    let mut streams = JoinSet::new();
    loop {
        tokio::select! {
            // Drives all that is under way besides.
            accepted = connection.accept() => match accepted {
                Some(Ok((request, respond))) => {
                    let (server, shared) = (server.clone(), shared.clone());
                    streams.spawn(async move { answer(&server, &request, respond, &shared).await });
                }
                Some(Err(error)) => return Err(Error::other(error)),
                None => return Ok(()),
            },
            // A client that goes is not an error.
            Some(_) = streams.join_next() => {}
            () = shared.is_lost.notified() => {
                return socket2::SockRef::from(socket).set_linger(Some(Duration::ZERO));
            }
            () = tokio::time::sleep(IDLE), if streams.is_empty() => return Ok(()),
        }
    }
}

/// Answers a request, as far as chance lets it.
async fn answer(
    server: &Server,
    request: &http::Request<RecvStream>,
    mut respond: SendResponse<Piece>,
    shared: &Shared,
) -> Result<()> {
    let header = |name: &str| request.headers().get(name).and_then(|v| v.to_str().ok()).map(str::to_owned);
    let request = Request::new(request.method().as_str(), request.uri().path(), header);
    let outcome = match request {
        Ok(request) => {
            let lot = server.lot(&request);
            if !lot.wait.is_zero() {
                tokio::time::sleep(lot.wait).await;
            }
            server.answer(&request, lot)?
        }
        Err(status) => Outcome::Answer(Answer::empty(status)),
    };
    let mut answer = match outcome {
        Outcome::Silence => {
            return poll_fn(|cx| respond.poll_reset(cx)).await.map(drop).map_err(Error::other);
        }
        Outcome::Reset(Loss::Stream) => {
            respond.send_reset(Reason::INTERNAL_ERROR);
            return Ok(());
        }
        Outcome::Reset(Loss::Connection) => return shared.lose().await,
        Outcome::Answer(answer) => answer,
    };
    let content = answer.content.take();
    let mut stream = respond.send_response(head_of(&answer)?, content.is_none()).map_err(Error::other)?;
    let Some(content) = content else { return Ok(()) };
    send(&mut stream, content, &shared.line).await?;
    match answer.end {
        // Short of what was announced, where it is early.
        End::Whole | End::Early => stream.send_data(Piece::default(), true).map_err(Error::other),
        End::Stall => poll_fn(|cx| stream.poll_reset(cx)).await.map(drop).map_err(Error::other),
        End::Reset(loss) => {
            // What was written is to be there before.
            tokio::time::sleep(BEFORE_RESET).await;
            if loss == Loss::Connection {
                return shared.lose().await;
            }
            stream.send_reset(Reason::INTERNAL_ERROR);
            Ok(())
        }
    }
}

fn head_of(answer: &Answer) -> Result<Response<()>> {
    let named = answer.headers.iter();
    let head = named.fold(Response::builder().status(answer.status), |head, (name, value)| head.header(*name, value));
    head.body(()).map_err(Error::other)
}

async fn send(stream: &mut SendStream<Piece>, mut content: Content, line: &Mutex<Line>) -> Result<()> {
    let line = || line.lock().unwrap_or_else(PoisonError::into_inner);
    let mut piece = vec![0; line().piece()];
    line().begin();
    loop {
        let got = content.read(&mut piece)?;
        if got == 0 {
            return Ok(());
        }
        let wait = line().carry(got);
        if !wait.is_zero() {
            tokio::time::sleep(wait).await;
        }
        let mut rest = &piece[..got];
        while !rest.is_empty() {
            let (now, later) = rest.split_at(room(stream, rest.len()).await?);
            stream.send_data(Piece::new(now.to_vec()), false).map_err(Error::other)?;
            rest = later;
        }
    }
}

/// So many bytes of these the client takes now; waits until it takes any.
async fn room(stream: &mut SendStream<Piece>, wanted: usize) -> Result<usize> {
    stream.reserve_capacity(wanted);
    while stream.capacity() == 0 {
        let more = poll_fn(|cx| stream.poll_capacity(cx)).await;
        more.ok_or(std::io::ErrorKind::ConnectionReset)?.map_err(Error::other)?;
    }
    Ok(stream.capacity().min(wanted))
}
