//! HTTP/2 on a connection, encrypted or not. Each request is a task on the connection's thread.
//!
//! Files are read on that thread as well, because the system caches them after the first read. Stalled and silent
//! requests hold none of the connection's flow control window: a body reserves only the piece that it sends next.

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
use super::bandwidth::BandwidthLimit;
use super::server::{IDLE_TIMEOUT, RESET_DELAY, Server};

/// Maximum number of concurrent requests of a connection, as in common servers.
const MAX_STREAMS: u32 = 128;

/// A piece of a body.
type Piece = std::io::Cursor<Vec<u8>>;

/// The state that the requests of a connection share.
struct Shared {
    /// Locked for each piece of a body.
    bandwidth: Mutex<BandwidthLimit>,
    /// Notified by a request whose fault resets the connection.
    reset_requested: Notify,
}

impl Shared {
    /// Requests a reset of the connection, and waits for it. Ending the request would reset its stream before that.
    async fn lose(&self) -> Result<()> {
        self.reset_requested.notify_one();
        pending().await
    }
}

/// Creates the runtime of a connection, on its thread.
pub(super) fn runtime() -> Result<tokio::runtime::Runtime> {
    tokio::runtime::Builder::new_current_thread().enable_all().build()
}

/// Serves an unencrypted connection whose client uses HTTP/2 without negotiation.
pub(super) fn serve_open(server: &Arc<Server>, stream: TcpStream) -> Result<()> {
    let socket = stream.try_clone()?;
    stream.set_nonblocking(true)?;
    runtime()?.block_on(async { serve(server, &socket, tokio::net::TcpStream::from_std(stream)?).await })
}

/// Answers requests until either side closes the connection. `socket` is the one below the stream.
pub(super) async fn serve<S>(server: &Arc<Server>, socket: &TcpStream, stream: S) -> Result<()>
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    let handshake = Builder::new().max_concurrent_streams(MAX_STREAMS).handshake(stream);
    let mut connection = tokio::time::timeout(IDLE_TIMEOUT, handshake).await?.map_err(Error::other)?;
    let shared = Arc::new(Shared {
        bandwidth: Mutex::new(BandwidthLimit::new(server.args.bandwidth)),
        reset_requested: Notify::new(),
    });
    // Dropping the set cancels requests in flight when the connection ends.
    let mut streams = JoinSet::new();
    loop {
        tokio::select! {
            // Accepting also drives the requests in flight.
            accepted = connection.accept() => match accepted {
                Some(Ok((request, respond))) => {
                    let (server, shared) = (server.clone(), shared.clone());
                    streams.spawn(async move { answer(&server, &request, respond, &shared).await });
                }
                Some(Err(error)) => return Err(Error::other(error)),
                None => return Ok(()),
            },
            // A client that closes its connection is not an error.
            Some(_) = streams.join_next() => {}
            () = shared.reset_requested.notified() => {
                return socket2::SockRef::from(socket).set_linger(Some(Duration::ZERO));
            }
            () = tokio::time::sleep(IDLE_TIMEOUT), if streams.is_empty() => return Ok(()),
        }
    }
}

/// Answers a request with its fault.
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
            let decision = server.decide(&request);
            if !decision.wait.is_zero() {
                tokio::time::sleep(decision.wait).await;
            }
            server.answer(&request, decision)?
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
    send(&mut stream, content, &shared.bandwidth).await?;
    match answer.end {
        // A truncated body ends before its announced length.
        End::Whole | End::Early => stream.send_data(Piece::default(), true).map_err(Error::other),
        End::Stall => poll_fn(|cx| stream.poll_reset(cx)).await.map(drop).map_err(Error::other),
        End::Reset(loss) => {
            // The client must receive the first half before the reset.
            tokio::time::sleep(RESET_DELAY).await;
            if loss == Loss::Connection {
                return shared.lose().await;
            }
            stream.send_reset(Reason::INTERNAL_ERROR);
            Ok(())
        }
    }
}

/// Returns the head of an answer.
fn head_of(answer: &Answer) -> Result<Response<()>> {
    let named = answer.headers.iter();
    let head = named.fold(Response::builder().status(answer.status), |head, (name, value)| head.header(*name, value));
    head.body(()).map_err(Error::other)
}

/// Sends a body in pieces, within the limits of bandwidth and flow control.
async fn send(stream: &mut SendStream<Piece>, mut content: Content, bandwidth: &Mutex<BandwidthLimit>) -> Result<()> {
    let bandwidth = || bandwidth.lock().unwrap_or_else(PoisonError::into_inner);
    let mut piece = vec![0; bandwidth().max_piece_bytes()];
    bandwidth().start_body();
    loop {
        let got = content.read(&mut piece)?;
        if got == 0 {
            return Ok(());
        }
        let wait = bandwidth().delay_for(got);
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

/// Waits until the flow control window has room, and returns how many of the wanted bytes fit.
async fn room(stream: &mut SendStream<Piece>, wanted: usize) -> Result<usize> {
    stream.reserve_capacity(wanted);
    while stream.capacity() == 0 {
        let more = poll_fn(|cx| stream.poll_capacity(cx)).await;
        more.ok_or(std::io::ErrorKind::ConnectionReset)?.map_err(Error::other)?;
    }
    Ok(stream.capacity().min(wanted))
}
