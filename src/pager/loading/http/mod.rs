//! The HTTP thread: one async runtime on one thread with many requests in flight, which are aborted when their contents
//! are no longer wanted. Each server has its own limit, so that one that hangs does not hold up the others. What one request
//! fetches is in [`content`].

mod content;

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crossbeam_channel::Sender;
use tokio::task::{AbortHandle, JoinError, JoinSet};

pub(super) use self::content::Reading;
use self::content::{Fetched, fetch};
use super::config::LimitRange;
use super::job::{Answer, LoadJob, LoadedBytes};
use super::request_list::{HttpWork, RequestList};
use super::server_limits::ServerLimits;
use super::thread_set::follow_core;
use super::ticket::Ticket;
use crate::fetch::{HttpBody, HttpClient, IoError, Limits};

/// How long the thread waits at its end for received bodies to be written to the cache.
const FINAL_FLUSH_TIMEOUT: Duration = Duration::from_secs(2);

/// The clients whose caches are flushed when the HTTP thread ends. Written by update, read by the HTTP thread.
#[derive(Clone, Default)]
pub(super) struct Clients(Arc<Mutex<Vec<HttpClient>>>);

impl Clients {
    fn lock(&self) -> MutexGuard<'_, Vec<HttpClient>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The way to the HTTP thread for what does not pass through the request list: root files and clients.
pub(in crate::pager) struct HttpAccess {
    runtime: tokio::runtime::Handle,
    clients: Clients,
}

impl HttpAccess {
    pub(super) fn new(runtime: &tokio::runtime::Runtime) -> Self {
        Self { runtime: runtime.handle().clone(), clients: Clients::default() }
    }

    pub(super) fn clients(&self) -> Clients {
        self.clients.clone()
    }

    /// Requests a URI on the HTTP thread, whose connections are reused for the tiles, and blocks until the answer.
    pub fn get(&self, client: &HttpClient, uri: &str, limits: &Limits) -> Result<HttpBody, IoError> {
        let (sender, receiver) = crossbeam_channel::bounded(1);
        let (client, requested, limits) = (client.clone(), uri.to_owned(), *limits);
        self.runtime.spawn(async move {
            // Fails only if the caller is gone.
            let _ = sender.send(client.get(&requested, &limits).await);
        });
        let stopped = |_| IoError::Network { uri: uri.to_owned(), reason: "the HTTP thread stopped".to_owned() };
        receiver.recv().map_err(stopped)?
    }

    /// Keeps a client until [`Self::remove_client`] or the end of the thread, when its cache is flushed.
    pub fn add_client(&self, client: HttpClient) {
        self.clients.lock().push(client);
    }

    /// Forgets all clients configured like this one and writes their received bodies to the cache; does not wait for it.
    pub fn remove_client(&self, client: &HttpClient) {
        self.clients.lock().retain(|known| known.config() != client.config());
        let client = client.clone();
        self.runtime.spawn(async move { client.flush().await });
    }

    /// Returns the number of clients.
    #[cfg(test)]
    pub fn client_count(&self) -> usize {
        self.clients.lock().len()
    }
}

/// A request in flight.
struct Running<J> {
    handle: AbortHandle,
    job: J,
}

/// The ways that results leave the HTTP thread.
#[derive(Clone, Copy)]
pub(super) struct Channels<'a, J: LoadJob> {
    /// To the decoders.
    pub loaded: &'a Sender<LoadedBytes<J>>,
    /// To update, for requests that were aborted.
    pub answers: &'a Sender<Answer<J>>,
}

/// Runs until the list closes. Requests still in flight are dropped then.
pub(super) fn run<J: LoadJob>(
    runtime: &tokio::runtime::Runtime,
    list: &RequestList<J>,
    channels: Channels<'_, J>,
    reading: &Reading,
    clients: &Clients,
    range: LimitRange,
) {
    let Channels { loaded, answers } = channels;
    runtime.block_on(async {
        let mut server_limits = ServerLimits::new(range);
        let mut tasks: JoinSet<Fetched<J>> = JoinSet::new();
        let mut running: HashMap<Ticket, Running<J>> = HashMap::new();
        loop {
            follow_core();
            let in_flight = running.values().map(|running| &running.job);
            let Some(HttpWork { jobs, aborts }) = list.take_http(in_flight, &server_limits, range.max_in_flight())
            else {
                // The lock is released before the wait.
                let clients = std::mem::take(&mut *clients.lock());
                flush(clients).await;
                return;
            };
            for ticket in aborts {
                if let Some(Running { handle, job }) = running.remove(&ticket) {
                    handle.abort();
                    let aborted = Answer { job, content: None, bytes_read: 0, bytes_http: 0, memory: None };
                    if answers.send(aborted).is_err() {
                        return;
                    }
                }
            }
            for job in jobs {
                let (ticket, copy, reading) = (job.ticket(), job.clone(), reading.clone());
                let work = async move {
                    let _span = job.request_span();
                    fetch(job, &reading).await
                };
                running.insert(ticket, Running { handle: tasks.spawn(work), job: copy });
            }
            tokio::select! {
                () = list.http_rung() => {}
                Some(ended) = tasks.join_next(), if !tasks.is_empty() => {
                    // Handles all that have ended, so that the next work is computed once.
                    let mut ended = Some(ended);
                    while let Some(one) = ended {
                        if !pass_on(one, &mut running, &mut server_limits, loaded) {
                            return;
                        }
                        ended = tasks.try_join_next();
                    }
                }
            }
        }
    });
}

/// Writes received bodies to the caches, within [`FINAL_FLUSH_TIMEOUT`].
async fn flush(clients: Vec<HttpClient>) {
    let flushed = async {
        for client in clients {
            client.flush().await;
        }
    };
    let _ = tokio::time::timeout(FINAL_FLUSH_TIMEOUT, flushed).await;
}

/// Passes the result of a request on to the decoders; returns false if they have ended.
fn pass_on<J: LoadJob>(
    ended: Result<Fetched<J>, JoinError>,
    running: &mut HashMap<Ticket, Running<J>>,
    server_limits: &mut ServerLimits,
    loaded: &Sender<LoadedBytes<J>>,
) -> bool {
    match ended {
        Ok((done, outcomes)) => {
            for (at, outcome) in outcomes {
                let count = running.values().filter(|running| running.job.servers().contains(&at)).count();
                server_limits.learn(&at, count, outcome);
            }
            // An aborted request was answered when it was aborted.
            running.remove(&done.job.ticket()).is_none() || loaded.send(done).is_ok()
        }
        Err(e) if e.is_cancelled() => true,
        Err(e) => {
            let ticket = running.iter().find(|(_, r)| r.handle.id() == e.id()).map(|(ticket, _)| *ticket);
            let Some(Running { job, .. }) = ticket.and_then(|t| running.remove(&t)) else { return true };
            let reason = "the request panicked".to_owned();
            let error = IoError::Network { uri: job.uri().to_owned(), reason };
            loaded.send(LoadedBytes::failed(job, error)).is_ok()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::page_job::PageJob;
    use super::super::page_job::tests::job;
    use super::super::request::Request as _;
    use super::super::request_list;
    use super::super::server_limits::Outcome;
    use super::*;

    /// Returns the jobs that the thread takes while nothing is in flight.
    fn taken(list: &RequestList<PageJob>, limits: &ServerLimits, max: usize) -> Vec<PageJob> {
        list.take_http([].iter(), limits, max).unwrap().jobs
    }

    fn numbers(jobs: &[PageJob]) -> Vec<u64> {
        jobs.iter().map(|job| job.ticket.number()).collect()
    }

    /// Returns a list of these jobs, the most urgent last, of which `outstanding` may be outstanding.
    fn list_of(outstanding: usize, jobs: impl IntoIterator<Item = PageJob>) -> RequestList<PageJob> {
        with_limits(
            request_list::Limits { outstanding, prefetch_room: 0, prefetch_beside_others: 0, aged_before: 0 },
            jobs,
        )
    }

    fn with_limits(limits: request_list::Limits, jobs: impl IntoIterator<Item = PageJob>) -> RequestList<PageJob> {
        let list = RequestList::new(1000, 1000);
        let mut state = list.lock();
        state.set_limits(limits);
        state.set_jobs(jobs);
        drop(state);
        list
    }

    fn jobs_at(numbers: std::ops::Range<u64>, uri: &str) -> impl Iterator<Item = PageJob> {
        numbers.map(move |number| job(number, uri))
    }

    /// Regression: only the content's server was counted, so that the imagery's server got more requests than its limit.
    #[test]
    fn companions_count_at_their_own_server() {
        let with_imagery = |number: u64, imagery: &str| {
            let data = format!(
                r#"{{"region":[0,0,1,1],"side":3,"border":1,"level":0,"errors_m":[],"imagery":"{imagery}/{number}.jpg"}}"#
            );
            PageJob { reader_data: Some(data.into()), ..job(number, &format!("http://heights/{number}.exr")) }
        };
        let own = (0..20).map(|number| with_imagery(number, "http://heights"));
        let elsewhere = (20..40).map(|number| with_imagery(number, "http://pictures"));
        let list = list_of(1000, own.chain(elsewhere));
        let mut limits = ServerLimits::new(LimitRange { start: 4, max: 16 });
        for _ in 0..100 {
            limits.learn("http://heights", 16, Outcome::AnsweredAfter(0.1));
        }
        assert_eq!((limits.limit("http://heights"), limits.limit("http://pictures")), (16, 4));
        let jobs = taken(&list, &limits, 1000);
        let at_pictures = jobs.iter().filter(|job| job.servers().len() == 2).count();
        assert_eq!((jobs.len(), at_pictures), (16, 4), "other jobs have the slots meanwhile");
    }

    /// Regression: each job of a full server was examined again and again.
    #[test]
    fn jobs_of_a_full_server_do_not_hide_others() {
        let prefetch = PageJob { is_prefetch: true, ..job(0, "http://full/a.glb") };
        let jobs = [prefetch, job(1, "http://other/a.glb")].into_iter().chain(jobs_at(2..10_002, "http://full/a.glb"));
        let limits = request_list::Limits {
            outstanding: 1000,
            prefetch_room: 1000,
            prefetch_beside_others: 1000,
            aged_before: 0,
        };
        let list = with_limits(limits, jobs);
        let jobs = taken(&list, &ServerLimits::new(LimitRange { start: 4, max: 4 }), 1000);
        assert_eq!(numbers(&jobs), [10_001, 10_000, 9_999, 9_998, 1]);
        let state = list.lock();
        let examined = state.waiting_for_test().filter(|job| job.progress.has_servers()).count();
        assert_eq!((state.waiting(), examined), (9_997, 0));
    }

    /// Regression: a server that hangs may have all jobs that the budgets allow.
    #[test]
    fn each_server_may_always_have_one_request() {
        let list = list_of(4, jobs_at(0..9, "http://other/a.glb").chain(jobs_at(9..18, "http://hangs/a.glb")));
        let jobs = taken(&list, &ServerLimits::new(LimitRange { start: 16, max: 16 }), 1000);
        assert_eq!(numbers(&jobs), [17, 16, 15, 14, 8]);
    }

    /// Regression: seven servers that hung had all slots until their requests timed out.
    #[test]
    fn servers_that_hang_leave_slots_to_others() {
        let range = LimitRange { start: 32, max: 128 };
        for hung in [7, 9, 11] {
            let hanging = |server: u64| {
                let first = 9 + 99 * server;
                (first..first + 99).map(move |number| job(number, &format!("http://h{server}/a.glb")))
            };
            let list = list_of(1000, jobs_at(0..9, "http://well/a.glb").chain((0..hung).flat_map(hanging)));
            let jobs = taken(&list, &ServerLimits::new(range), range.max_in_flight());
            assert!(jobs.iter().any(|job| job.ticket.number() < 9), "{hung}");
            // A few servers have all that their limit allows.
            let count = |server: &str| jobs.iter().filter(|job| job.servers() == [server]).count();
            assert!((2..=7).all(|server| count(&format!("http://h{}", hung - server + 1)) >= 8), "{hung}");
            assert_eq!((count(&format!("http://h{}", hung - 1)), count(&format!("http://h{}", hung - 2))), (32, 32));
        }
        // A single server reaches its maximum.
        for range in [range, LimitRange { start: 1, max: 128 }, LimitRange { start: 4, max: 4 }] {
            let limits = ServerLimits::new(range);
            let max = range.max_in_flight();
            assert!((0..range.max).all(|has| limits.leaves_enough(has, max - has)), "{range:?}");
        }
    }

    /// Regression: over a slow network prefetches were late, eight at a time.
    #[test]
    fn server_with_free_slots_takes_more_prefetches() {
        let started = |busy: u64, room: usize| {
            let prefetches = jobs_at(0..40, "http://far/a.glb").map(|job| PageJob { is_prefetch: true, ..job });
            let limits = request_list::Limits {
                outstanding: 1000,
                prefetch_room: room,
                prefetch_beside_others: 2,
                aged_before: 0,
            };
            let list = with_limits(limits, prefetches.chain(jobs_at(40..40 + busy, "http://far/a.glb")));
            let server_limits = ServerLimits::new(LimitRange { start: 32, max: 32 });
            taken(&list, &server_limits, 1000).iter().filter(|job| job.is_prefetch).count()
        };
        assert_eq!((started(0, 1000), started(20, 1000)), (24, 4), "all but a quarter of its slots");
        assert_eq!(started(24, 1000), 2, "a few beside others");
        assert_eq!((started(0, 5), started(0, 0)), (5, 0), "as far as there is room");
    }
}
