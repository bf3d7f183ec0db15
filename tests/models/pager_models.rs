//! The request lists of both pagers under shuttle: the library's own files, between threads that take, read, decode and
//! answer as the pagers' do. Schedules in which a wake-up is lost, a thread waits for ever or a job is done twice fail.

#[path = "../../src/pager/images/list.rs"]
mod images;
#[path = "../../src/pager/list.rs"]
mod list;

/// The number of requests that a server may have at once.
mod flow {
    pub struct Flows(pub usize);

    impl Flows {
        pub fn limit(&self, _server: &str) -> usize {
            self.0
        }

        pub fn leaves_enough(&self, _has: usize, _left: usize) -> bool {
            true
        }
    }

    pub struct Range {
        pub start: usize,
        pub most: usize,
    }
}

mod job {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Counts how often it was taken.
    #[derive(Debug, Default)]
    pub struct Stage(AtomicUsize);

    impl Stage {
        pub fn reads(&self) {
            assert_eq!(self.0.fetch_add(1, Ordering::SeqCst), 0, "taken twice");
        }
    }

    #[derive(Clone, Debug)]
    pub struct Job {
        pub ticket: u64,
        pub uri: Arc<str>,
        pub is_ahead: bool,
        pub stage: Arc<Stage>,
        servers: Vec<String>,
    }

    impl Job {
        pub fn new(ticket: u64, uri: &str) -> Self {
            let servers = vec![crate::io::server(uri).to_owned()];
            Self { ticket, uri: uri.into(), is_ahead: false, stage: Arc::default(), servers }
        }

        pub fn servers(&self) -> &[String] {
            &self.servers
        }
    }
}

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;

use crate::schedules::channel::{Receiver, Sender, bounded};
use crate::schedules::check;
use flow::Flows;
use job::Job;
use list::{RequestList, Taken};
use shuttle::sync::atomic::AtomicUsize;
use shuttle::sync::{Arc, Barrier, Mutex};
use shuttle::thread::{self, JoinHandle};

/// An answer as update gets it: the job, and whether there is a page.
type Answer = (Job, bool);

fn files(count: u64) -> Vec<Job> {
    (0..count).map(|ticket| Job::new(ticket, "/set/a.glb")).collect()
}

/// Update's part of a frame: the jobs not yet taken, the most urgent last; a thread that can take one is notified.
fn update(list: &RequestList, jobs: &mut BTreeMap<u64, Job>) {
    let mut waiting = list.lock();
    for ticket in std::mem::take(&mut waiting.taken) {
        jobs.remove(&ticket);
    }
    let (http, file) = jobs.values().cloned().partition(|job| crate::io::is_remote(&job.uri));
    (waiting.http, waiting.file) = (http, file);
    drop(waiting);
    list.ring_if_due();
}

/// Jobs taken and not answered, counted apart from the list.
type Outstanding = Arc<AtomicUsize>;

/// Takes an answer up, maybe before update knew that the job was taken; room for another one is signalled.
fn take_up(list: &RequestList, jobs: &mut BTreeMap<u64, Job>, outstanding: &Outstanding, (job, has_page): &Answer) {
    outstanding.fetch_sub(1, Ordering::SeqCst);
    list.lock().answered(job, *has_page);
    jobs.remove(&job.ticket);
    let mut waiting = list.lock();
    waiting.allowed = list.capacity;
    list.ring(waiting);
}

/// A file thread.
fn reads(list: &Arc<RequestList>, read: &Sender<Job>, outstanding: &Outstanding) -> JoinHandle<()> {
    let (list, read, outstanding) = (list.clone(), read.clone(), outstanding.clone());
    thread::spawn(move || {
        while let Some(job) = list.take_file() {
            assert!(outstanding.fetch_add(1, Ordering::SeqCst) < list.capacity, "more than the channels hold");
            if read.send(job).is_err() {
                return;
            }
        }
    })
}

/// A decode thread.
fn decodes(read: &Receiver<Job>, answers: &Sender<Answer>) -> JoinHandle<()> {
    let (read, answers) = (read.clone(), answers.clone());
    thread::spawn(move || {
        while let Ok(job) = read.recv() {
            assert!(!answers.is_full(), "no answer waits for update");
            if answers.send((job, true)).is_err() {
                return;
            }
        }
    })
}

fn join(threads: Vec<JoinHandle<()>>) {
    threads.into_iter().for_each(|thread| thread.join().unwrap());
}

/// Readers wait for the decoder, which holds one file more, and continue; update takes answers up while it lists what is left.
#[test]
fn files_are_each_read_and_answered_once_through_full_channels() {
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
            take_up(&list, &mut jobs, &outstanding, &answer);
        }
        update(&list, &mut jobs);
        assert!(jobs.is_empty() && list.lock().outstanding == 0 && !list.lock().is_under_way());
        list.close();
        join(std::mem::take(&mut threads));
    });
}

/// A wake-up takes the frame time: update wakes one thread, which wakes the next.
#[test]
fn one_ring_wakes_as_many_threads_as_there_is_work_for() {
    check(|| {
        let list = Arc::new(RequestList::new(3, 3));
        // A file ends once all three are being read.
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
        assert_eq!(list.lock().taken.len(), 3);
    });
}

/// At any time: while threads wait for work, for the decoder, or for cancelled jobs.
#[test]
fn all_threads_end_with_the_list() {
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

/// The requests in flight on the HTTP thread. The server answers them in any order, except those that hang.
type UnderWay = Arc<Mutex<BTreeMap<u64, Job>>>;

/// The HTTP thread: as in `http.rs` it looks, under the list's lock, for what it may begin or is to give up, and waits for
/// its bell.
fn asks(
    list: &Arc<RequestList>,
    answers: &Sender<Answer>,
    outstanding: &Outstanding,
    under_way: UnderWay,
) -> JoinHandle<()> {
    let (list, answers, outstanding) = (list.clone(), answers.clone(), outstanding.clone());
    thread::spawn(move || {
        shuttle::future::block_on(async {
            loop {
                let running: Vec<Job> = under_way.lock().unwrap().values().cloned().collect();
                let Some(Taken { jobs, aborts }) = list.take_of_servers(running.iter(), &Flows(2), 4) else { return };
                for ticket in aborts {
                    let aborted = under_way.lock().unwrap().remove(&ticket);
                    if aborted.is_some_and(|job| answers.send((job, false)).is_err()) {
                        return;
                    }
                }
                for job in jobs {
                    assert!(outstanding.fetch_add(1, Ordering::SeqCst) < list.capacity, "more than the channels hold");
                    under_way.lock().unwrap().insert(job.ticket, job);
                }
                let done = under_way.lock().unwrap().extract_if(.., |_, job| !job.uri.contains("hangs")).next();
                let Some((_, job)) = done else {
                    list.http_bell.notified().await;
                    continue;
                };
                if answers.send((job, true)).is_err() {
                    return;
                }
            }
        });
    })
}

/// Two requests hang and take all slots of their server. They are cancelled in turn, the first while others wait, the
/// second while none does.
#[test]
fn cancelled_requests_make_room_for_waiting_ones() {
    check(|| {
        let list = Arc::new(RequestList::new(3, 3));
        let ((answers, answered), under_way) = (bounded(3), UnderWay::default());
        let outstanding = Outstanding::default();
        let thread = asks(&list, &answers, &outstanding, under_way.clone());
        drop(answers);
        // Taken from the end.
        let uris = ["http://h/0", "http://h/1", "http://h/hangs/2", "http://h/hangs/3"];
        let mut jobs: BTreeMap<u64, Job> =
            uris.iter().zip(0..).map(|(uri, ticket)| (ticket, Job::new(ticket, uri))).collect();
        update(&list, &mut jobs);
        while jobs.len() > 2 {
            thread::yield_now();
            update(&list, &mut jobs);
        }
        let give_up = |ticket| {
            let mut waiting = list.lock();
            waiting.abort.push(ticket);
            list.ring(waiting);
        };
        let mut came = BTreeMap::new();
        give_up(2);
        for count in [3, 4] {
            while came.len() < count {
                let answer = answered.recv().unwrap();
                take_up(&list, &mut jobs, &outstanding, &answer);
                assert_eq!(came.insert(answer.0.ticket, answer.1), None, "answered twice");
                update(&list, &mut jobs);
            }
            // Nothing waits any more.
            if count == 3 {
                give_up(3);
            }
        }
        assert_eq!(came.into_values().collect::<Vec<_>>(), [true, true, false, false]);
        list.close();
        thread.join().unwrap();
        assert!(under_way.lock().unwrap().is_empty() && list.lock().outstanding == 0);
    });
}

/// The image pager's threads: two decode, of which each reads files too; one asks a server, where `hangs` never comes.
fn image_threads(list: &Arc<images::List>, loaded: &Sender<(Arc<str>, bool)>) -> Vec<JoinHandle<()>> {
    let asked = list.clone();
    let asks = thread::spawn(move || {
        shuttle::future::block_on(async {
            while let Some(begun) = asked.take_of_servers() {
                for uri in begun {
                    let list = asked.clone();
                    shuttle::future::spawn(async move {
                        let bytes = if uri.contains("hangs") {
                            list.is_given_up(&uri).await;
                            None
                        } else {
                            Some(Ok(Vec::new()))
                        };
                        list.has_come(uri, bytes);
                    });
                }
                asked.http_bell.notified().await;
            }
        });
    });
    let decode = |_| {
        let (list, loaded) = (list.clone(), loaded.clone());
        thread::spawn(move || {
            while let Some(work) = list.take() {
                let image = match work {
                    images::Work::Read(uri) => (uri, true),
                    images::Work::Came(uri, bytes) => (uri, bytes.is_some()),
                };
                if loaded.send(image).is_err() {
                    return;
                }
            }
        })
    };
    (0..2).map(decode).chain([asks]).collect()
}

/// A decoded image waits with its thread until update takes it. A hung request takes its server's only slot until it is
/// cancelled and the next starts.
#[test]
fn images_of_files_and_servers_come_once_and_what_hangs_is_given_up() {
    check(|| {
        let list = Arc::new(images::List::new(1));
        let (loaded, came) = bounded(1);
        let threads = image_threads(&list, &loaded);
        drop(loaded);
        let uris = ["/files/a.png", "http://h/b.png", "http://h/hangs.png", "/files/c.png"];
        list.lock().uris = uris.map(Arc::from).to_vec();
        list.ring();
        let mut left: BTreeMap<Arc<str>, bool> =
            uris.iter().map(|uri| (Arc::from(*uri), !uri.contains("hangs"))).collect();
        // Once in flight it is not wanted any more.
        while !list.lock().taken.iter().any(|uri| uri.contains("hangs")) {
            thread::yield_now();
        }
        list.give_up(|uri| uri.contains("hangs"));
        for _ in 0..uris.len() {
            let (uri, is_there) = came.recv().unwrap();
            assert_eq!(left.remove(&uri), Some(is_there), "{uri}");
        }
        list.close();
        join(threads);
    });
}

/// At any time: while results are not taken, a server hangs, or nothing was asked for.
#[test]
fn all_image_threads_end_with_their_list() {
    check(|| {
        let list = Arc::new(images::List::new(1));
        let (loaded, came) = bounded(1);
        let threads = image_threads(&list, &loaded);
        drop(loaded);
        list.lock().uris = ["/a.png", "/b.png", "/c.png", "http://h/hangs.png"].map(Arc::from).to_vec();
        list.ring();
        list.close();
        drop(came);
        join(threads);
    });
}
