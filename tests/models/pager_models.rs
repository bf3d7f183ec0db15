//! The request list of both pagers under shuttle: the library's own file, between threads that take, read, decode and
//! answer like those of the pagers. A schedule fails if a wake-up is lost, a thread waits forever, or a job is done
//! twice.

#[path = "../../src/pager/loading/request.rs"]
mod request;
#[path = "../../src/pager/loading/request_list.rs"]
mod request_list;
#[path = "../../src/pager/loading/waiting_jobs.rs"]
mod waiting_jobs;

mod ticket {
    pub type Ticket = u64;
}

/// A limit that is the same for each server.
mod server_limits {
    pub struct ServerLimits(pub usize);

    impl ServerLimits {
        pub fn limit(&self, _server: &str) -> usize {
            self.0
        }

        pub fn leaves_enough(&self, _has: usize, _left: usize) -> bool {
            true
        }
    }
}

mod job {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::request::Request;
    use super::ticket::Ticket;

    #[derive(Clone, Debug)]
    pub struct Job {
        pub ticket: Ticket,
        pub uri: Arc<str>,
        servers: Vec<String>,
        /// The number of times that it was taken.
        taken: Arc<AtomicUsize>,
    }

    impl Job {
        pub fn new(ticket: Ticket, uri: &str) -> Self {
            let servers = vec![crate::fetch::server(uri).to_owned()];
            Self { ticket, uri: uri.into(), servers, taken: Arc::default() }
        }
    }

    impl Request for Job {
        type Scene = ();

        fn ticket(&self) -> Ticket {
            self.ticket
        }

        fn uri(&self) -> &str {
            &self.uri
        }

        fn scene(&self) {}

        fn is_prefetch(&self) -> bool {
            false
        }

        fn set_prefetch(&mut self, _: bool) {}

        fn servers(&self) -> &[String] {
            &self.servers
        }

        fn mark_reading(&self) {
            assert_eq!(self.taken.fetch_add(1, Ordering::SeqCst), 0, "taken twice");
        }
    }
}

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;

use crate::schedules::channel::{Receiver, Sender, bounded};
use crate::schedules::check;
use job::Job;
use request_list::{HttpWork, Limits, RequestList};
use server_limits::ServerLimits;
use shuttle::sync::atomic::AtomicUsize;
use shuttle::sync::{Arc, Barrier, Mutex};
use shuttle::thread::{self, JoinHandle};
use waiting_jobs::Urgency;

/// An answer for the update: the job, and whether it has a content.
type Answer = (Job, bool);

fn files(count: u64) -> Vec<Job> {
    (0..count).map(|ticket| Job::new(ticket, "/set/a.glb")).collect()
}

/// Does the update's part of a frame: lists the jobs that no thread has taken, the last the most urgent, and wakes threads.
fn update(list: &RequestList<Job>, jobs: &mut BTreeMap<u64, Job>) {
    let mut state = list.lock();
    for job in state.drain_taken(usize::MAX) {
        jobs.remove(&job.ticket);
    }
    for job in jobs.values() {
        state.insert(job.clone(), Urgency::new(job.ticket as f32, false), 0);
    }
    drop(state);
    list.ring_if_due();
}

/// The number of jobs that are taken and not answered, counted independently of the list.
type Outstanding = Arc<AtomicUsize>;

/// Accepts an answer, possibly before the update knows that the job was taken, and makes room for another job.
fn accept(list: &RequestList<Job>, jobs: &mut BTreeMap<u64, Job>, outstanding: &Outstanding, (job, has_page): &Answer) {
    outstanding.fetch_sub(1, Ordering::SeqCst);
    list.lock().answered(job, *has_page);
    jobs.remove(&job.ticket);
    let mut state = list.lock();
    let outstanding = list.capacity();
    state.set_limits(Limits { outstanding, prefetch_room: 0, prefetch_beside_others: 0, aged_before: 0 });
    list.ring(state);
}

/// Starts a file thread.
fn reads(list: &Arc<RequestList<Job>>, read: &Sender<Job>, outstanding: &Outstanding) -> JoinHandle<()> {
    let (list, read, outstanding) = (list.clone(), read.clone(), outstanding.clone());
    thread::spawn(move || {
        while let Some(job) = list.take_file() {
            assert!(
                outstanding.fetch_add(1, Ordering::SeqCst) < list.capacity(),
                "more answers than the channels hold"
            );
            if read.send(job).is_err() {
                return;
            }
        }
    })
}

/// Starts a decode thread.
fn decodes(read: &Receiver<Job>, answers: &Sender<Answer>) -> JoinHandle<()> {
    let (read, answers) = (read.clone(), answers.clone());
    thread::spawn(move || {
        while let Ok(job) = read.recv() {
            assert!(!answers.is_full(), "no answer waits for the update");
            if answers.send((job, true)).is_err() {
                return;
            }
        }
    })
}

fn join(threads: Vec<JoinHandle<()>>) {
    threads.into_iter().for_each(|thread| thread.join().unwrap());
}

/// Readers wait for the decoder, which holds one more file, and continue; update accepts answers while it lists the
/// rest.
#[test]
fn files_are_read_and_answered_once_through_full_channels() {
    check(|| {
        let list = Arc::new(RequestList::new(3, 3));
        let ((read, intake), (answers, answered)) = (bounded(1), bounded(3));
        let outstanding = Outstanding::default();
        let read_files = || reads(&list, &read, &outstanding);
        let mut threads = vec![read_files(), read_files(), decodes(&intake, &answers)];
        drop((read, intake, answers));
        let mut jobs: BTreeMap<u64, Job> = files(5).into_iter().map(|job| (job.ticket, job)).collect();
        let mut seen = [false; 5];
        for _ in 0..5 {
            update(&list, &mut jobs);
            let answer = answered.recv().unwrap();
            assert!(!std::mem::replace(&mut seen[answer.0.ticket as usize], true), "answered twice");
            accept(&list, &mut jobs, &outstanding, &answer);
        }
        update(&list, &mut jobs);
        assert!(jobs.is_empty() && list.lock().outstanding() == 0 && !list.lock().is_under_way());
        list.close();
        join(std::mem::take(&mut threads));
    });
}

/// Waking a thread costs frame time, so the update wakes one thread, which wakes the next.
#[test]
fn one_wake_up_wakes_as_many_threads_as_there_are_jobs() {
    check(|| {
        let list = Arc::new(RequestList::new(3, 3));
        // A file ends only when all three are being read.
        let all = Arc::new(Barrier::new(3));
        let threads = (0..3).map(|_| {
            let (list, all) = (list.clone(), all.clone());
            thread::spawn(move || {
                if list.take_file().is_some() {
                    all.wait();
                }
            })
        });
        let threads: Vec<_> = threads.collect();
        update(&list, &mut files(3).into_iter().map(|job| (job.ticket, job)).collect());
        join(threads);
        assert_eq!(list.lock().drain_taken(usize::MAX).count(), 3);
    });
}

/// The list may close at any time: while threads wait for work or for the decoder, or while answers are not received.
#[test]
fn threads_end_when_the_list_closes() {
    check(|| {
        let list = Arc::new(RequestList::new(4, 4));
        let ((read, intake), (answers, answered)) = (bounded(1), bounded(4));
        let outstanding = Outstanding::default();
        let read_files = || reads(&list, &read, &outstanding);
        let mut threads = vec![read_files(), read_files(), decodes(&intake, &answers)];
        threads.push(asks(&list, &answers, &outstanding, Arc::default()));
        drop((read, intake, answers));
        let jobs = files(3).into_iter().chain([Job::new(3, "http://h/a.glb")]);
        update(&list, &mut jobs.map(|job| (job.ticket, job)).collect());
        list.close();
        drop(answered);
        join(threads);
    });
}

/// The requests in flight of the HTTP thread. A server answers any of them except those that hang.
type UnderWay = Arc<Mutex<BTreeMap<u64, Job>>>;

/// Starts the HTTP thread. Like `http.rs` it takes work under the list's lock, and waits to be woken.
fn asks(
    list: &Arc<RequestList<Job>>,
    answers: &Sender<Answer>,
    outstanding: &Outstanding,
    under_way: UnderWay,
) -> JoinHandle<()> {
    let (list, answers, outstanding) = (list.clone(), answers.clone(), outstanding.clone());
    thread::spawn(move || {
        shuttle::future::block_on(async {
            loop {
                let running: Vec<Job> = under_way.lock().unwrap().values().cloned().collect();
                let work = list.take_http(running.iter(), &ServerLimits(2), 4);
                let Some(HttpWork { jobs, aborts }) = work else { return };
                for ticket in aborts {
                    let aborted = under_way.lock().unwrap().remove(&ticket);
                    if aborted.is_some_and(|job| answers.send((job, false)).is_err()) {
                        return;
                    }
                }
                for job in jobs {
                    assert!(
                        outstanding.fetch_add(1, Ordering::SeqCst) < list.capacity(),
                        "more answers than the channels hold"
                    );
                    under_way.lock().unwrap().insert(job.ticket, job);
                }
                let done = under_way.lock().unwrap().extract_if(.., |_, job| !job.uri.contains("hangs")).next();
                let Some((_, job)) = done else {
                    list.http_rung().await;
                    continue;
                };
                if answers.send((job, true)).is_err() {
                    return;
                }
            }
        });
    })
}

/// Two requests hang and occupy all slots of their server. They are aborted one after the other: the first while other
/// jobs wait, the second while no job waits.
#[test]
fn aborted_requests_free_their_slots_for_waiting_jobs() {
    check(|| {
        let list = Arc::new(RequestList::new(3, 3));
        let ((answers, answered), under_way) = (bounded(3), UnderWay::default());
        let outstanding = Outstanding::default();
        let thread = asks(&list, &answers, &outstanding, under_way.clone());
        drop(answers);
        // Jobs are taken from the end of the list.
        let uris = ["http://h/0", "http://h/1", "http://h/hangs/2", "http://h/hangs/3"];
        let mut jobs: BTreeMap<u64, Job> =
            uris.iter().zip(0..).map(|(uri, ticket)| (ticket, Job::new(ticket, uri))).collect();
        update(&list, &mut jobs);
        while jobs.len() > 2 {
            thread::yield_now();
            update(&list, &mut jobs);
        }
        let give_up = |ticket| {
            let mut state = list.lock();
            state.abort(ticket);
            list.ring(state);
        };
        let mut came = BTreeMap::new();
        give_up(2);
        for count in [3, 4] {
            while came.len() < count {
                let answer = answered.recv().unwrap();
                accept(&list, &mut jobs, &outstanding, &answer);
                assert_eq!(came.insert(answer.0.ticket, answer.1), None, "answered twice");
                update(&list, &mut jobs);
            }
            // No job waits any more.
            if count == 3 {
                give_up(3);
            }
        }
        assert_eq!(came.into_values().collect::<Vec<_>>(), [true, true, false, false]);
        list.close();
        thread.join().unwrap();
        assert!(under_way.lock().unwrap().is_empty() && list.lock().outstanding() == 0);
    });
}
