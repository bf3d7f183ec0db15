//! The HTTP thread: one tokio runtime on one thread, many requests in flight, aborted when nobody wants them. Each server
//! has its own limit, so that one that hangs takes no other's places.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use crossbeam_channel::Sender;
use tokio::task::{AbortHandle, JoinSet};

use super::flow::{Answered, Flows, Range};
use super::list::{Answer, Job, Loaded, RequestList};
use super::threads::SERVERS_AT_ONCE;
use super::threads::read_bytes;
use crate::io::{self, HttpBody, HttpClient, IoError, Limits, server};
use crate::timeline;

/// At the end, bodies on their way to the cache have so long.
const LAST_STORES: Duration = Duration::from_secs(2);

/// The way to the HTTP thread for what cannot wait for the request list: a root.
pub(super) struct Door {
    pub runtime: tokio::runtime::Handle,
    pub client: HttpClient,
}

impl Door {
    /// Asks on the HTTP thread, whose connections are used again for the tiles, and waits here.
    pub fn get(&self, uri: &str, limits: &Limits) -> Result<HttpBody, IoError> {
        let (sender, receiver) = crossbeam_channel::bounded(1);
        let (client, of, limits) = (self.client.clone(), uri.to_owned(), *limits);
        self.runtime.spawn(async move {
            // Nobody waits any more where the pager is gone.
            let _ = sender.send(client.get(&of, &limits).await);
        });
        let stopped = |_| IoError::Network { uri: uri.to_owned(), reason: "the HTTP thread stopped".to_owned() };
        receiver.recv().map_err(stopped)?
    }
}

/// Runs until the list closes. Requests still under way are dropped then.
pub(super) fn run(
    runtime: &tokio::runtime::Runtime,
    client: &HttpClient,
    list: &RequestList,
    loaded: &Sender<Loaded>,
    answers: &Sender<Answer>,
    limits: &Limits,
    range: Range,
) {
    runtime.block_on(async {
        let mut flows = Flows::new(range);
        let mut tasks: JoinSet<(Loaded, Answered)> = JoinSet::new();
        let mut running: HashMap<u64, (AbortHandle, Job)> = HashMap::new();
        loop {
            let (jobs, aborts, closed) = take(list, &running, &flows, most_in_flight(range));
            if closed {
                // What came is worth keeping, but nobody waits long for it.
                let _ = tokio::time::timeout(LAST_STORES, client.flush()).await;
                return;
            }
            for ticket in aborts {
                if let Some((handle, job)) = running.remove(&ticket) {
                    handle.abort();
                    if answers.send(Answer { job, page: None, bytes_read: 0, bytes_http: 0 }).is_err() {
                        return;
                    }
                }
            }
            for job in jobs {
                let (client, limits, ticket, copy) = (client.clone(), *limits, job.ticket, job.clone());
                let source = list.ticket_source;
                let work = async move {
                    let _span = timeline::request_span("fetch", source | ticket);
                    fetch(&client, job, &limits).await
                };
                running.insert(ticket, (tasks.spawn(work), copy));
            }
            tokio::select! {
                () = list.http_bell.notified() => {}
                Some(done) = tasks.join_next(), if !tasks.is_empty() => match done {
                    // An aborted one was answered above.
                    Ok((done, answered)) => {
                        let of = server(&done.job.uri);
                        let count = running.values().filter(|(_, job)| server(&job.uri) == of).count();
                        flows.learn(of, count, answered);
                        if running.remove(&done.job.ticket).is_some() && loaded.send(done).is_err() {
                            return;
                        }
                    }
                    Err(e) if e.is_cancelled() => {}
                    Err(e) => {
                        let ticket = running.iter().find(|(_, (handle, _))| handle.id() == e.id()).map(|(t, _)| *t);
                        if let Some((_, job)) = ticket.and_then(|t| running.remove(&t)) {
                            let reason = "the request panicked".to_owned();
                            let bytes = Err(IoError::Network { uri: job.uri.to_string(), reason });
                            let failed = Loaded { job, bytes, companions: Vec::new(), bytes_read: 0, bytes_http: 0 };
                            if loaded.send(failed).is_err() {
                                return;
                            }
                        }
                    }
                },
            }
        }
    });
}

/// Requests to all servers together: several as they start, and one as far as it may go.
pub(super) fn most_in_flight(range: Range) -> usize {
    SERVERS_AT_ONCE * range.start + range.most.saturating_sub(range.start)
}

/// Jobs to start, as many as each server may have and `most` together; the tickets to abort, and whether to stop.
fn take(
    list: &RequestList,
    running: &HashMap<u64, (AbortHandle, Job)>,
    flows: &Flows,
    most: usize,
) -> (Vec<Job>, Vec<u64>, bool) {
    let mut at_server: HashMap<&str, usize> = HashMap::new();
    for (_, job) in running.values() {
        *at_server.entry(server(&job.uri)).or_default() += 1;
    }
    let mut waiting = list.lock();
    let mut jobs: Vec<Job> = Vec::new();
    // The most urgent are last.
    let mut next = waiting.http.len();
    while next > 0 && running.len() + jobs.len() < most && waiting.may_take(&waiting.http[next - 1]) {
        next -= 1;
        let of = server(&waiting.http[next].uri);
        let started = jobs.iter().filter(|j| server(&j.uri) == of).count();
        if at_server.get(of).copied().unwrap_or(0) + started < flows.limit(of) {
            let job = waiting.http.remove(next);
            waiting.took(&job);
            jobs.push(job);
        }
    }
    (jobs, std::mem::take(&mut waiting.abort), waiting.closed)
}

/// The content and its companions at the same time: what a tile needs is known before its bytes.
async fn fetch(client: &HttpClient, job: Job, limits: &Limits) -> (Loaded, Answered) {
    let start = Instant::now();
    let companions = async {
        let mut fetched = Vec::new();
        for uri in io::companions(&job.uri, job.reader_data.as_ref()) {
            let body = client.get(&uri, limits).await;
            fetched.push((uri, body));
        }
        fetched
    };
    let (body, companions) = tokio::join!(client.get(&job.uri, limits), companions);
    let mut bytes_http = 0;
    let mut bytes_of = |body: Result<HttpBody, IoError>| {
        body.map(|body| {
            bytes_http += body.network_bytes;
            body.bytes
        })
    };
    let bytes = bytes_of(body);
    let companions: Vec<io::Fetched> = companions.into_iter().map(|(uri, body)| (uri, bytes_of(body))).collect();
    let bytes_read = read_bytes(&bytes, &companions);
    job.stage.decodes();
    let answered = Answered::of(&bytes, bytes_http, start.elapsed().as_secs_f64());
    (Loaded { job, bytes, companions, bytes_read, bytes_http }, answered)
}
