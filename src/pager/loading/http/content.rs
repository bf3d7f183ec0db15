//! [`ContentRequest`]: what one request fetches: a content, its companions, and the dependencies that its bytes name. HTTP
//! thread.

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::task::JoinSet;

use super::super::job::{LoadJob, LoadedBytes, total_bytes};
use super::super::server_limits::Outcome;
use crate::fetch::{
    ByteBudget, FileReader, HttpBody, IoError, Limits, Loaded, NoRoom, Permit, guarded, is_remote, server,
};
use crate::formats::{self, MAX_DEPENDENCY_ROUNDS};

/// The maximum number of a content's dependencies that are requested at the same time. They do not count in the limits of
/// their servers.
const MAX_DEPENDENCIES_IN_FLIGHT: usize = 8;
/// How long a content waits for all dependencies that it is whole without.
const MAX_OPTIONAL_TIME: Duration = Duration::from_secs(10);

/// The limits of requests, and the reader for contents on a disk whose images are on servers.
#[derive(Clone)]
pub(in super::super) struct Reading {
    pub limits: Limits,
    /// Holds what was received.
    pub bodies: ByteBudget,
    pub files: Arc<FileReader>,
}

/// The result of a request, and its outcome at each server.
pub(super) type Fetched<J> = (LoadedBytes<J>, Vec<(String, Outcome)>);

/// Requests a content and what belongs to it once there is room for it. What turns out to have no room is dropped, and
/// requested again when as many bytes are free. Returns the outcome at each server too; waiting for room is no part of it.
pub(super) async fn fetch<J: LoadJob>(job: J, reading: &Reading) -> Fetched<J> {
    let mut bytes = reading.bodies.expected_bytes();
    loop {
        let permit = reading.bodies.reserve(bytes, job.is_prefetch()).await;
        let request = ContentRequest { job: job.clone(), reading: reading.clone(), permit };
        match request.fetch().await {
            Ok(fetched) => return fetched,
            Err(NoRoom { needed }) => match reading.limits.check_files_of_content(job.address(), needed) {
                Ok(()) => {
                    job.forget_ahead();
                    bytes = needed;
                }
                Err(error) => {
                    job.mark_decoding();
                    return (LoadedBytes::failed(job, error), Vec::new());
                }
            },
        }
    }
}

/// A request that holds a permit for the bytes it receives.
#[derive(Clone)]
struct ContentRequest<J> {
    job: J,
    reading: Reading,
    permit: Permit,
}

/// The bytes of one URI or the error, and after how many seconds they arrived.
type Received = (Result<HttpBody, IoError>, f64);

/// The answers to requests that are made together with that for a content.
#[derive(Default)]
struct Companions {
    bodies: Vec<(Arc<str>, Result<HttpBody, IoError>)>,
    /// The slowest answer of the content's own server, in seconds.
    seconds: f64,
    /// True if the content's own server was asked, not the cache alone.
    asked: bool,
    /// The outcomes at other servers.
    elsewhere: Vec<(String, Outcome)>,
}

/// A content with what belongs to it.
struct Whole {
    content: Result<Loaded, IoError>,
    companions: Vec<formats::Fetched>,
    bytes_http: u64,
}

/// The answer to the request for a dependency.
struct Dependency {
    uri: Arc<str>,
    bytes: Result<Vec<u8>, IoError>,
    network_bytes: u64,
}

impl<J: LoadJob> ContentRequest<J> {
    /// Requests the content and its companions at the same time, since the companions of a tile are known before its bytes, and
    /// then its dependencies.
    ///
    /// # Errors
    /// [`NoRoom`] if the bytes have no room.
    async fn fetch(self) -> Result<Fetched<J>, NoRoom> {
        // A content on a disk counts at the server of its images.
        let own = self.job.servers().first().cloned().unwrap_or_default();
        let ((body, own_s), companions) = tokio::join!(self.content(), self.companions(&own));
        let Companions { bodies, seconds, mut asked, elsewhere } = companions;
        let received = bodies.iter().map(|(_, body)| body).chain([&body]);
        if let Some(no_room) = received.filter_map(no_room).max_by_key(|no_room| no_room.needed) {
            return Err(no_room);
        }
        asked |= body.as_ref().is_ok_and(|body| body.asked);
        let whole = self.add_dependencies(Whole::new(body, bodies)).await?;
        let Whole { content: loaded, companions, bytes_http } = whole;
        let bytes_read = total_bytes(&loaded, &companions);
        self.permit.set_bytes(bytes_read.saturating_add(self.job.bytes_ahead()));
        if loaded.is_ok() {
            self.permit.budget().learn(bytes_read);
        }
        self.job.mark_decoding();
        let outcome = (own, Outcome::new(&loaded, asked, own_s.max(seconds)));
        let outcomes = [outcome].into_iter().chain(elsewhere).collect();
        let Self { job, permit, .. } = self;
        Ok((LoadedBytes { job, loaded, companions, bytes_read, bytes_http, permit: Some(permit) }, outcomes))
    }

    async fn content(&self) -> Received {
        match self.job.is_in_memory() {
            true => (Ok(HttpBody::default()), 0.0),
            false => self.receive(self.job.address(), self.job.fallback()).await,
        }
    }

    /// Requests the companions one after the other. Those from the content's own server count as one request with it; others
    /// count at their own server.
    async fn companions(&self, own: &str) -> Companions {
        let mut companions = Companions::default();
        for uri in self.job.companions() {
            let (body, seconds) = self.receive(&uri, self.job.companion_fallback(&uri)).await;
            let at = server(&uri);
            let is_asked = body.as_ref().is_ok_and(|body| body.asked);
            if at == own {
                companions.seconds = companions.seconds.max(seconds);
                companions.asked |= is_asked;
            } else {
                companions.elsewhere.push((at.to_owned(), Outcome::new(&body, is_asked, seconds)));
            }
            companions.bodies.push((uri, body));
        }
        companions
    }

    /// Requests a URI, and the fallback where the content may be instead. The time is that of the last request.
    async fn receive(&self, uri: &Arc<str>, fallback: Option<Arc<str>>) -> Received {
        let mut start = Instant::now();
        if !is_remote(uri) {
            let bytes = self.file(uri).await;
            let body = bytes.map(|bytes| HttpBody { bytes, ..HttpBody::default() });
            return (body, start.elapsed().as_secs_f64());
        }
        let (client, limits) = (self.job.client(), &self.reading.limits);
        let mut body = client.get_holding(uri, limits, &self.permit).await;
        if let Err(error) = &body
            && error.may_be_elsewhere()
            && let Some(fallback) = fallback
        {
            start = Instant::now();
            let other = client.get_holding(&fallback, limits, &self.permit).await;
            body = other.map(|body| HttpBody { location: body.location.or(Some(fallback)), ..body });
        }
        (body, start.elapsed().as_secs_f64())
    }

    /// Requests the dependencies of a content, and what these name in turn.
    async fn add_dependencies(&self, mut whole: Whole) -> Result<Whole, NoRoom> {
        let mut bytes_ahead = 0;
        let optional_until = tokio::time::Instant::now() + MAX_OPTIONAL_TIME;
        for _ in 0..MAX_DEPENDENCY_ROUNDS {
            let dependencies;
            (dependencies, whole) = self.dependencies_of(whole).await;
            if dependencies.is_empty() {
                break;
            }
            // The job keeps objects of the content in memory while its dependencies are requested.
            let more = self.job.bytes_ahead().saturating_sub(bytes_ahead);
            bytes_ahead += more;
            self.permit.claim(more)?.keep(more);
            self.add_all(dependencies, optional_until, &mut whole).await?;
        }
        Ok(whole)
    }

    /// Requests dependencies, several at the same time.
    async fn add_all(
        &self,
        dependencies: Vec<Arc<str>>,
        optional_until: tokio::time::Instant,
        whole: &mut Whole,
    ) -> Result<(), NoRoom> {
        let mut waiting = dependencies.into_iter();
        let mut requests = JoinSet::new();
        loop {
            for uri in waiting.by_ref().take(MAX_DEPENDENCIES_IN_FLIGHT - requests.len()) {
                requests.spawn(self.clone().dependency(uri, optional_until));
            }
            match requests.join_next().await {
                Some(Ok(Dependency { uri, bytes, network_bytes })) => {
                    if let Some(no_room) = no_room(&bytes) {
                        return Err(no_room);
                    }
                    whole.bytes_http += network_bytes;
                    whole.companions.push((uri, bytes));
                }
                // A request that panicked is missing from the companions.
                Some(Err(_)) => {}
                None => return Ok(()),
            }
        }
    }

    /// Requests a dependency. One that the content is whole without is given up at `optional_until`.
    async fn dependency(self, uri: Arc<str>, optional_until: tokio::time::Instant) -> Dependency {
        let Self { job, reading, permit } = &self;
        if !is_remote(&uri) {
            let bytes = self.file(&uri).await;
            return Dependency { uri, bytes, network_bytes: 0 };
        }
        let request = async || job.shared_files().get(job.client_of(&uri), &uri, &reading.limits, permit).await;
        let (bytes, network_bytes) = match job.may_be_missing(&uri) {
            false => request().await,
            true => tokio::time::timeout_at(optional_until, request()).await.unwrap_or_else(|_| {
                let (phase, seconds) = ("an image beside the content", MAX_OPTIONAL_TIME.as_secs_f64());
                (Err(IoError::Timeout { uri: uri.to_string(), phase, seconds }), 0)
            }),
        };
        Dependency { uri, bytes, network_bytes }
    }

    /// Asks the job for the dependencies of a content. Large texts and XML are parsed on a blocking thread of the runtime, so
    /// that requests go on meanwhile.
    async fn dependencies_of(&self, whole: Whole) -> (Vec<Arc<str>>, Whole) {
        let Whole { content: Ok(content), companions, bytes_http } = whole else { return (Vec::new(), whole) };
        let whole = |content, companions| Whole { content, companions, bytes_http };
        if !formats::has_slow_dependencies(&content.bytes, &companions) {
            return (self.job.dependencies(&content, &companions), whole(Ok(content), companions));
        }
        let (uri, job) = (self.job.address().to_string(), self.job.clone());
        let parse = move || {
            // A content that makes a parser panic has none; the decoder reports it.
            let found = guarded(job.uri(), || Ok(job.dependencies(&content, &companions)));
            (found.unwrap_or_default(), content, companions)
        };
        match tokio::task::spawn_blocking(parse).await {
            Ok((found, content, companions)) => (found, whole(Ok(content), companions)),
            Err(error) => {
                let stopped = IoError::Network { uri, reason: format!("the parsing stopped: {error}") };
                (Vec::new(), whole(Err(stopped), Vec::new()))
            }
        }
    }

    /// Reads a file on a blocking thread of the runtime. A thread that hangs on a disk is left alone.
    async fn file(&self, uri: &Arc<str>) -> Result<Vec<u8>, IoError> {
        let (files, job, path) = (self.reading.files.clone(), self.job.clone(), uri.clone());
        let read = tokio::task::spawn_blocking(move || match job.root_scope() {
            Some(scope) => files.read_within(&path, scope),
            None => files.read(&path),
        });
        let limit = self.reading.limits.file_timeout;
        let Ok(read) = tokio::time::timeout(limit, read).await else {
            return Err(IoError::file_timeout(uri, limit));
        };
        let stopped = |error| IoError::Network { uri: uri.to_string(), reason: format!("the read stopped: {error}") };
        let bytes = read.map_err(stopped)??;
        let size = bytes.len() as u64;
        self.permit.claim(size).map_err(|no_room| IoError::no_room(uri, no_room))?.keep(size);
        Ok(bytes)
    }
}

impl Whole {
    /// Returns a content with its companions. The content knows where redirects of its companions led.
    fn new(body: Result<HttpBody, IoError>, bodies: Vec<(Arc<str>, Result<HttpBody, IoError>)>) -> Self {
        let mut bytes_http = 0;
        let mut loaded_of = |body: Result<HttpBody, IoError>| {
            body.map(|body| {
                bytes_http += body.network_bytes;
                Loaded::from(body)
            })
        };
        let mut content = loaded_of(body);
        let mut locations = Vec::new();
        let companions = bodies.into_iter().map(|(uri, body)| {
            let bytes = loaded_of(body).map(|companion| {
                locations.extend(companion.location.map(|location| (uri.clone(), location)));
                companion.bytes
            });
            (uri, bytes)
        });
        let companions = companions.collect();
        if let Ok(content) = &mut content {
            content.companion_locations = locations;
        }
        Self { content, companions, bytes_http }
    }
}

/// Returns the room that was lacking if that is why nothing was received.
fn no_room<T>(received: &Result<T, IoError>) -> Option<NoRoom> {
    match received {
        Err(IoError::NoRoom { needed, .. }) => Some(NoRoom { needed: *needed }),
        _ => None,
    }
}
