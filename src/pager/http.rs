//! The HTTP thread: one tokio runtime on one thread, many requests in flight, aborted when nobody wants them. Each server
//! has its own limit, so that one that hangs takes no other's places.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use crossbeam_channel::Sender;
use tokio::task::{AbortHandle, JoinError, JoinSet};

use super::flow::{Answered, Flows, Range};
use super::job::{Answer, Job, Loaded};
use super::list::{RequestList, Taken, most_in_flight};
use super::threads::read_bytes;
use crate::io::{self, HttpBody, HttpClient, IoError, Limits, server};
use crate::timeline;

/// At the end, bodies on their way to the cache have so long.
const LAST_STORES: Duration = Duration::from_secs(2);

/// A request under way.
struct Running {
    handle: AbortHandle,
    job: Job,
}

impl Running {
    fn asks(&self, of: &str) -> bool {
        self.job.servers().iter().any(|server| server == of)
    }
}

/// The way to the HTTP thread for what cannot wait for the request list: a root.
pub(super) struct Door {
    pub runtime: tokio::runtime::Handle,
}

impl Door {
    /// Asks on the HTTP thread, whose connections are used again for the tiles, and waits here.
    pub fn get(&self, client: &HttpClient, uri: &str, limits: &Limits) -> Result<HttpBody, IoError> {
        let (sender, receiver) = crossbeam_channel::bounded(1);
        let (client, of, limits) = (client.clone(), uri.to_owned(), *limits);
        self.runtime.spawn(async move {
            // Nobody waits any more where the pager is gone.
            let _ = sender.send(client.get(&of, &limits).await);
        });
        let stopped = |_| IoError::Network { uri: uri.to_owned(), reason: "the HTTP thread stopped".to_owned() };
        receiver.recv().map_err(stopped)?
    }

    /// Writes to its cache what a client has that nobody asks with any more; does not wait for it.
    pub fn keep_what_came(&self, client: &HttpClient) {
        let client = client.clone();
        self.runtime.spawn(async move { client.flush().await });
    }
}

/// Runs until the list closes. Requests still under way are dropped then.
pub(super) fn run(
    runtime: &tokio::runtime::Runtime,
    list: &RequestList,
    loaded: &Sender<Loaded>,
    answers: &Sender<Answer>,
    limits: &Limits,
    range: Range,
) {
    runtime.block_on(async {
        let mut flows = Flows::new(range);
        let mut tasks: JoinSet<Fetched> = JoinSet::new();
        let mut running: HashMap<u64, Running> = HashMap::new();
        loop {
            let under_way = running.values().map(|running| &running.job);
            let Some(Taken { jobs, aborts }) = list.take_of_servers(under_way, &flows, most_in_flight(range)) else {
                // What came is worth keeping, but nobody waits long for it.
                let clients = std::mem::take(&mut list.lock().clients);
                let flushed = async {
                    for client in clients {
                        client.flush().await;
                    }
                };
                let _ = tokio::time::timeout(LAST_STORES, flushed).await;
                return;
            };
            for ticket in aborts {
                if let Some(Running { handle, job }) = running.remove(&ticket) {
                    handle.abort();
                    if answers.send(Answer { job, page: None, bytes_read: 0, bytes_http: 0 }).is_err() {
                        return;
                    }
                }
            }
            for job in jobs {
                let (client, limits, ticket, copy) = (job.scope.client.clone(), *limits, job.ticket, job.clone());
                let source = list.ticket_source;
                let work = async move {
                    let _span = timeline::request_span("fetch", source | ticket);
                    fetch(&client, job, &limits).await
                };
                running.insert(ticket, Running { handle: tasks.spawn(work), job: copy });
            }
            tokio::select! {
                () = list.http_bell.notified() => {}
                Some(ended) = tasks.join_next(), if !tasks.is_empty() => {
                    // With all that ended meanwhile: what is taken next is reckoned once.
                    let mut ended = Some(ended);
                    while let Some(one) = ended {
                        if !pass_on(one, &mut running, &mut flows, loaded) {
                            return;
                        }
                        ended = tasks.try_join_next();
                    }
                }
            }
        }
    });
}

/// What came of a request, and what that says of its servers.
type Fetched = (Loaded, Vec<(String, Answered)>);

/// Passes on what a request ended with; false when nobody takes it any more.
fn pass_on(
    ended: Result<Fetched, JoinError>,
    running: &mut HashMap<u64, Running>,
    flows: &mut Flows,
    loaded: &Sender<Loaded>,
) -> bool {
    match ended {
        // An aborted one was answered when it was aborted.
        Ok((done, answered)) => {
            for (of, answered) in answered {
                let count = running.values().filter(|running| running.asks(&of)).count();
                flows.learn(&of, count, answered);
            }
            running.remove(&done.job.ticket).is_none() || loaded.send(done).is_ok()
        }
        Err(e) if e.is_cancelled() => true,
        Err(e) => {
            let ticket = running.iter().find(|(_, r)| r.handle.id() == e.id()).map(|(t, _)| *t);
            let Some(Running { job, .. }) = ticket.and_then(|t| running.remove(&t)) else { return true };
            let reason = "the request panicked".to_owned();
            let bytes = Err(IoError::Network { uri: job.uri.to_string(), reason });
            let failed = Loaded { job, bytes, companions: Vec::new(), bytes_read: 0, bytes_http: 0 };
            loaded.send(failed).is_ok()
        }
    }
}

/// The content and its companions at the same time: what a tile needs is known before its bytes. What each server's
/// answers say of it.
async fn fetch(client: &HttpClient, job: Job, limits: &Limits) -> Fetched {
    let own = server(&job.uri).to_owned();
    let timed = async |uri: &str| {
        let start = Instant::now();
        let body = client.get(uri, limits).await;
        (body, start.elapsed().as_secs_f64())
    };
    // Those of the content's own server answer together, others each for theirs.
    let (mut of_others, mut beside_s, mut asked) = (Vec::new(), 0f64, false);
    let companions = async {
        let mut fetched = Vec::new();
        for uri in io::companions(&job.uri, job.reader_data.as_ref()) {
            let (body, seconds) = timed(&uri).await;
            let of = server(&uri);
            let is_asked = body.as_ref().is_ok_and(|body| body.asked);
            if of == own {
                (beside_s, asked) = (beside_s.max(seconds), asked || is_asked);
            } else {
                of_others.push((of.to_owned(), Answered::of(&body, is_asked, seconds)));
            }
            fetched.push((uri, body));
        }
        fetched
    };
    let ((body, own_s), companions) = tokio::join!(timed(&job.uri), companions);
    asked |= body.as_ref().is_ok_and(|body| body.asked);
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
    let answered = (own, Answered::of(&bytes, asked, own_s.max(beside_s)));
    let answered = [answered].into_iter().chain(of_others).collect();
    (Loaded { job, bytes, companions, bytes_read, bytes_http }, answered)
}

#[cfg(test)]
mod tests {
    use super::super::job::tests::job;
    use super::*;

    /// What the thread takes that has nothing under way.
    fn taken(list: &RequestList, flows: &Flows, most: usize) -> Vec<Job> {
        list.take_of_servers([].iter(), flows, most).unwrap().jobs
    }

    /// Only the content's server was counted: the pictures' one got as many requests as that one may have.
    #[test]
    fn what_comes_with_a_content_counts_at_its_own_server() {
        let list = RequestList::new(1000, 1000);
        let with_imagery = |ticket: u64, imagery: &str| {
            let data = format!(
                r#"{{"region":[0,0,1,1],"side":3,"border":1,"level":0,"errors_m":[],"imagery":"{imagery}/{ticket}.jpg"}}"#
            );
            Job { reader_data: Some(data.into()), ..job(ticket, &format!("http://heights/{ticket}.exr")) }
        };
        let mut waiting = list.lock();
        waiting.allowed = 1000;
        waiting.http.extend((0..20).map(|ticket| with_imagery(ticket, "http://heights")));
        waiting.http.extend((20..40).map(|ticket| with_imagery(ticket, "http://pictures")));
        drop(waiting);
        let mut flows = Flows::new(Range { start: 4, most: 16 });
        for _ in 0..100 {
            flows.learn("http://heights", 16, Answered::After(0.1));
        }
        assert_eq!((flows.limit("http://heights"), flows.limit("http://pictures")), (16, 4));
        let jobs = taken(&list, &flows, 1000);
        let at_pictures = jobs.iter().filter(|job| job.servers().len() == 2).count();
        assert_eq!((jobs.len(), at_pictures), (16, 4), "others have the places meanwhile");
    }

    /// Each of them was looked up again and again.
    #[test]
    fn what_waits_for_a_full_server_hides_nothing_of_others() {
        let list = RequestList::new(1000, 1000);
        let mut waiting = list.lock();
        waiting.allowed = 1000;
        waiting.http.push(Job { is_ahead: true, ..job(0, "http://full/a.glb") });
        waiting.http.push(job(1, "http://other/a.glb"));
        waiting.http.extend((2..10_002).map(|ticket| job(ticket, "http://full/a.glb")));
        (waiting.ahead_room, waiting.ahead_allowed) = (1000, 1000);
        drop(waiting);
        let flows = Flows::new(Range { start: 4, most: 4 });
        let jobs = taken(&list, &flows, 1000);
        let taken: Vec<u64> = jobs.iter().map(|job| job.ticket).collect();
        assert_eq!(taken, [10_001, 10_000, 9_999, 9_998, 1]);
        let waiting = list.lock();
        let looked_at = waiting.http.iter().filter(|job| job.stage.servers.get().is_some()).count();
        assert_eq!((waiting.http.len(), looked_at), (9_997, 0));
    }

    /// All that the budgets allow may be with a server that hangs.
    #[test]
    fn each_server_has_a_place_in_any_case() {
        let list = RequestList::new(1000, 1000);
        let mut waiting = list.lock();
        waiting.allowed = 4;
        // Taken from the end.
        waiting.http.extend((0..9).map(|ticket| job(ticket, "http://other/a.glb")));
        waiting.http.extend((9..18).map(|ticket| job(ticket, "http://hangs/a.glb")));
        drop(waiting);
        let flows = Flows::new(Range { start: 16, most: 16 });
        let jobs = taken(&list, &flows, 1000);
        assert_eq!(jobs.iter().map(|job| job.ticket).collect::<Vec<_>>(), [17, 16, 15, 14, 8]);
    }

    /// Seven that hung had all places of all servers until their time was over.
    #[test]
    fn servers_that_hang_leave_places_to_others() {
        let range = Range { start: 32, most: 128 };
        for hung in [7, 9, 11] {
            let list = RequestList::new(1000, 1000);
            let mut waiting = list.lock();
            waiting.allowed = 1000;
            waiting.http.extend((0..9).map(|ticket| job(ticket, "http://well/a.glb")));
            let of_hung =
                |server: u64| (0..99).map(move |k| job(9 + 99 * server + k, &format!("http://h{server}/a.glb")));
            waiting.http.extend((0..hung).flat_map(of_hung));
            drop(waiting);
            let jobs = taken(&list, &Flows::new(range), most_in_flight(range));
            assert!(jobs.iter().any(|job| job.ticket < 9), "{hung}");
            // Few servers have all that they may.
            let of = |server: &str| jobs.iter().filter(|job| job.servers() == [server]).count();
            assert!((2..=7).all(|server| of(&format!("http://h{}", hung - server + 1)) >= 8), "{hung}");
            assert_eq!((of(&format!("http://h{}", hung - 1)), of(&format!("http://h{}", hung - 2))), (32, 32));
        }
        // One alone goes as far as it may.
        for range in [range, Range { start: 1, most: 128 }, Range { start: 4, most: 4 }] {
            let flows = Flows::new(range);
            let most = most_in_flight(range);
            assert!((0..range.most).all(|has| flows.leaves_enough(has, most - has)), "{range:?}");
        }
    }

    /// Over a slow network they came too late, eight at a time.
    #[test]
    fn a_server_with_free_places_takes_more_of_what_is_wanted_later() {
        let started = |busy: u64, room: usize| {
            let list = RequestList::new(1000, 1000);
            let mut waiting = list.lock();
            (waiting.allowed, waiting.ahead_room, waiting.ahead_allowed) = (1000, room, 2);
            waiting.http.extend((0..40).map(|ticket| Job { is_ahead: true, ..job(ticket, "http://far/a.glb") }));
            waiting.http.extend((40..40 + busy).map(|ticket| job(ticket, "http://far/a.glb")));
            drop(waiting);
            let flows = Flows::new(Range { start: 32, most: 32 });
            taken(&list, &flows, 1000).iter().filter(|job| job.is_ahead).count()
        };
        assert_eq!((started(0, 1000), started(20, 1000)), (24, 4), "all but a quarter of its places");
        assert_eq!(started(24, 1000), 2, "a few beside others");
        assert_eq!((started(0, 5), started(0, 0)), (5, 0), "as far as there is room");
    }
}
