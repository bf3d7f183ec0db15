//! The loading threads: file readers, the HTTP thread and decoders. Each ends when the list or its channel closes.

use std::sync::Arc;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvError, Sender, bounded, never, select};

use super::budgets::LoadBudgets;
use super::config::LoadConfig;
use super::file_threads::FileThreads;
#[cfg(feature = "http")]
use super::http::{self, HttpAccess};
use super::job::{Answer, LoadJob, LoadedBytes};
use super::request_list::RequestList;
use super::thread_set::{ThreadSet, follow_core};
use crate::fetch;
use crate::pager::config::PagerError;

/// Files that may be read and not yet decoded, per decode thread: waiting bytes are memory, and disks are quick.
const READ_AHEAD: usize = 2;
/// How long the end of the HTTP thread waits for its blocking threads.
#[cfg(feature = "http")]
const MAX_SHUTDOWN_TIME: Duration = Duration::from_secs(1);

/// All loading threads of a pager. Dropping it stops and joins them, except for those that hang on a disk; HTTP requests still
/// in flight are dropped.
pub(in crate::pager) struct LoadThreads<J: LoadJob> {
    list: Arc<RequestList<J>>,
    budgets: LoadBudgets,
    files: Option<Arc<FileThreads<J>>>,
    /// Dropped to end the watch over the file threads.
    watch: Option<Sender<()>>,
    /// `None` once closed.
    answers: Option<Receiver<Answer<J>>>,
    #[cfg(feature = "http")]
    http: Option<HttpAccess>,
    threads: ThreadSet,
}

impl<J: LoadJob> LoadThreads<J> {
    /// Starts the threads.
    ///
    /// # Errors
    /// [`PagerError::Thread`] if a thread cannot be started; those that were started end.
    pub fn start(config: &LoadConfig) -> Result<Self, PagerError> {
        let (capacity, decoders) = (config.capacity(), config.decoders);
        let list = Arc::new(RequestList::new(capacity, config.max_files));
        let budgets = LoadBudgets::new(config.max_bytes, config.waits_for_contents, config.limits.max_content_bytes);
        // Declared before the channels, so that those close first if a thread cannot start, and the others end.
        let mut threads = Self {
            list: list.clone(),
            budgets: budgets.clone(),
            files: None,
            watch: None,
            answers: None,
            #[cfg(feature = "http")]
            http: None,
            threads: ThreadSet::default(),
        };
        let (read_sender, read) = bounded::<LoadedBytes<J>>(READ_AHEAD * decoders);
        #[cfg(feature = "http")]
        let (received_sender, received) = bounded::<LoadedBytes<J>>(capacity);
        #[cfg(not(feature = "http"))]
        let received = never::<LoadedBytes<J>>();
        let (answer_sender, answers) = bounded::<Answer<J>>(capacity);
        threads.answers = Some(answers);
        let files = fetch::FileReader::new(config.limits);
        let bodies = budgets.bodies.clone();
        let timeout = config.limits.file_timeout;
        let files = FileThreads::new(list.clone(), read_sender, files, bodies, config.readers, timeout);
        let files = threads.files.insert(files).clone();
        files.start()?;
        let (watch, closed) = bounded(0);
        threads.watch = Some(watch);
        threads.spawn("watch", move || files.watch(&closed))?;
        #[cfg(feature = "http")]
        {
            let (list, answers) = (list.clone(), answer_sender.clone());
            let reading = http::Reading {
                limits: config.limits,
                bodies: budgets.bodies.clone(),
                files: Arc::new(fetch::FileReader::new(config.limits)),
            };
            let name = format!("{}-http", J::THREAD_PREFIX);
            let runtime = fetch::runtime(&name).map_err(|source| PagerError::Thread { name, source })?;
            let access = HttpAccess::new(&runtime);
            let (clients, range) = (access.clients(), config.per_server);
            threads.http = Some(access);
            threads.spawn("http", move || {
                let channels = http::Channels { loaded: &received_sender, answers: &answers };
                http::run(&runtime, &list, channels, &reading, &clients, range);
                // Threads that hang on the cache are left alone.
                runtime.shutdown_timeout(MAX_SHUTDOWN_TIME);
            })?;
        }
        for i in 0..decoders {
            let open = if cfg!(feature = "http") { 2 } else { 1 };
            let intake = Intake { files: read.clone(), servers: received.clone(), open };
            let (sender, budgets) = (answer_sender.clone(), budgets.clone());
            threads.spawn(&format!("decode-{i}"), move || decode(intake, &sender, &budgets))?;
        }
        Ok(threads)
    }

    fn spawn(&mut self, name: &str, run: impl FnOnce() + Send + 'static) -> Result<(), PagerError> {
        self.threads.spawn(format!("{}-{name}", J::THREAD_PREFIX), run)
    }

    /// Pins the threads to a core, each before its next job.
    pub fn set_core(&self, core: usize) {
        self.threads.set_core(core);
        if let Some(files) = &self.files {
            files.set_core(core);
        }
    }

    /// Returns the request list.
    pub fn list(&self) -> &RequestList<J> {
        &self.list
    }

    /// Returns the bytes that are on their way.
    pub fn budgets(&self) -> &LoadBudgets {
        &self.budgets
    }

    /// Returns the way to the HTTP thread.
    #[cfg(feature = "http")]
    pub fn http(&self) -> Option<&HttpAccess> {
        self.http.as_ref()
    }

    /// Returns the next answer if there is one.
    pub fn try_answer(&self) -> Option<Answer<J>> {
        self.answers.as_ref()?.try_recv().ok()
    }

    /// Waits for the next answer, at most for `timeout`.
    pub fn wait_answer(&self, timeout: Duration) -> Option<Answer<J>> {
        self.answers.as_ref()?.recv_timeout(timeout).ok()
    }
}

impl<J: LoadJob> Drop for LoadThreads<J> {
    fn drop(&mut self) {
        self.list.close();
        self.budgets.close();
        self.answers = None;
        self.watch = None;
        if let Some(files) = &self.files {
            files.close();
        }
        // The decoders end first: file threads wait for them.
        self.threads = ThreadSet::default();
        if let Some(files) = &self.files {
            files.join();
        }
    }
}

/// The two channels that a decode thread takes from.
struct Intake<J> {
    files: Receiver<LoadedBytes<J>>,
    servers: Receiver<LoadedBytes<J>>,
    /// The number of channels that have not closed.
    open: usize,
}

impl<J> Intake<J> {
    /// Waits for the bytes of the next job; returns `None` once both channels have closed.
    fn next(&mut self) -> Option<LoadedBytes<J>> {
        while self.open > 0 {
            let (from, loaded) = select! {
                recv(self.files) -> loaded => (&mut self.files, loaded),
                recv(self.servers) -> loaded => (&mut self.servers, loaded),
            };
            match loaded {
                Ok(loaded) => return Some(loaded),
                Err(RecvError) => {
                    *from = never();
                    self.open -= 1;
                }
            }
        }
        None
    }
}

fn decode<J: LoadJob>(mut intake: Intake<J>, sender: &Sender<Answer<J>>, budgets: &LoadBudgets) {
    let LoadBudgets { contents, large, .. } = budgets;
    while let Some(LoadedBytes { job, loaded, companions, bytes_read, bytes_http, permit }) = intake.next() {
        follow_core();
        // A content is rarely smaller than its bytes. Its decoder needs about as much again, such as for decompressed bytes and
        // for images before they have their final format.
        let expected_bytes = bytes_read.max(contents.expected_bytes()).saturating_mul(2);
        let decoded = loaded.and_then(|loaded| {
            let held = contents.reserve_blocking(expected_bytes, job.is_prefetch());
            let _span = job.decode_span();
            let (content, memory) = large.decode(held, || job.decode(loaded, companions));
            let content = content?;
            let bytes = J::content_bytes(&content);
            contents.learn(bytes);
            memory.set_bytes(bytes);
            Ok((content, memory))
        });
        // The bytes were dropped with their decoder.
        drop(permit);
        let (content, memory) = match decoded {
            Ok((content, memory)) => (Ok(content), Some(memory)),
            Err(error) => (Err(error), None),
        };
        if sender.send(Answer { job, content: Some(content), bytes_read, bytes_http, memory }).is_err() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::page_job::PageJob;
    use super::super::page_job::tests::job;
    use std::cmp::Reverse;

    use super::super::request_list::{Limits, ListState};
    use super::super::ticket::Ticket;
    use super::super::waiting_jobs::{Source, Urgency, WaitingJobs};
    use super::*;
    use crate::scene::{Node, NodeId, Page, Scene};

    fn limits(outstanding: usize) -> Limits {
        Limits { outstanding, prefetch_room: 0, prefetch_beside_others: 0, aged_before: 0 }
    }

    /// The number of files that may be outstanding.
    const MAX_FILES: usize = 18;

    /// Regression: files were read only while few HTTP requests were in flight.
    #[test]
    fn http_requests_take_no_slots_of_files() {
        let list = RequestList::new(100, MAX_FILES);
        let requested: Vec<PageJob> = (0..30).map(|number| job(number, "http://h/a.glb")).collect();
        let mut state = list.lock();
        requested.iter().for_each(|job| state.take_for_test(job));
        state.set_jobs((30..50).map(|number| job(number, "/set/a.glb")));
        let read: Vec<PageJob> = std::iter::from_fn(|| state.take_file_for_test(MAX_FILES)).collect();
        assert_eq!(read.len(), 18);
        assert_eq!(state.outstanding(), 48);
        state.answered(&requested[0], false);
        assert!(state.take_file_for_test(MAX_FILES).is_none(), "an answer from a server frees no slot of files");
        state.answered(&read[0], false);
        assert!(state.take_file_for_test(MAX_FILES).is_some());
    }

    /// Regression: between the answer to a prefetch and the next calculation of the limits another could start.
    #[test]
    fn content_of_a_prefetch_keeps_its_place_until_the_limits_are_set_again() {
        let list = RequestList::new(100, MAX_FILES);
        let mut state = list.lock();
        let prefetches: Vec<PageJob> =
            (0..9).map(|number| PageJob { is_prefetch: true, ..job(number, "/set/a.glb") }).collect();
        state.set_jobs(prefetches);
        state.set_limits(Limits { prefetch_room: 5, prefetch_beside_others: 2, ..limits(100) });
        let take = |state: &mut ListState<PageJob>| -> Vec<PageJob> {
            std::iter::from_fn(|| state.take_file_for_test(MAX_FILES)).collect()
        };
        let read = take(&mut state);
        assert_eq!(read.len(), 2);
        state.answered(&read[0], true);
        assert_eq!(take(&mut state).len(), 0, "a content waits for its merge");
        state.answered(&read[1], false);
        assert_eq!(take(&mut state).len(), 1, "an answer without content frees a place");
    }

    fn now(priority: f32) -> Urgency {
        Urgency::new(priority, false)
    }

    fn taken(waiting: &mut WaitingJobs<PageJob>, aged_before: u32) -> Option<u64> {
        Some(waiting.take(Source::Files, aged_before, |_, _| true)?.ticket.number())
    }

    #[test]
    fn urgencies_are_ordered_as_priorities_and_prefetches_come_last() {
        let priorities = [f32::NEG_INFINITY, -3.0, -1e-9, -0.0, 0.0, 1e-9, 2.0, f32::INFINITY];
        assert!(priorities.windows(2).all(|two| now(two[0]) < now(two[1])));
        assert!(priorities.iter().all(|priority| Urgency::new(f32::INFINITY, true) < now(*priority)));
    }

    /// Jobs come, change and go at random; each take is compared with a search through all jobs.
    #[test]
    fn takes_are_the_most_urgent_whatever_has_changed() {
        let mut random = crate::math::random::SplitMix64::new(7);
        let mut below = |count: u64| random.next_u64() % count;
        let mut waiting: WaitingJobs<PageJob> = WaitingJobs::new();
        let mut model: std::collections::BTreeMap<u64, Urgency> = std::collections::BTreeMap::new();
        for step in 0..20_000u64 {
            let urgency = Urgency::new(below(50) as f32, below(4) == 0);
            let any = model.keys().nth(below(model.len().max(1) as u64) as usize).copied();
            match (below(10), any) {
                (0..4, _) | (_, None) => {
                    waiting.insert(job(step, "/set/a.glb"), urgency, 0);
                    model.insert(step, urgency);
                }
                (4, Some(number)) => {
                    assert!(waiting.remove(Ticket::for_test(number)).is_some());
                    model.remove(&number);
                }
                (5, Some(number)) => {
                    waiting.set_urgencies(&[(Ticket::for_test(number), urgency)]);
                    model.insert(number, urgency);
                }
                (6, Some(_)) if step % 8 == 0 => {
                    // The camera moves.
                    model.values_mut().for_each(|known| *known = Urgency::new(below(50) as f32, below(4) == 0));
                    let changes: Vec<_> = model.iter().map(|(n, known)| (Ticket::for_test(*n), *known)).collect();
                    waiting.set_urgencies(&changes);
                }
                _ => {
                    let expected = model.iter().map(|(number, urgency)| (*urgency, Reverse(*number))).max();
                    let expected = expected.map(|(urgency, Reverse(number))| (number, urgency.is_prefetch()));
                    let job = waiting.take(Source::Files, 0, |_, _| true);
                    assert_eq!(job.map(|job| (job.ticket.number(), job.is_prefetch)), expected, "step {step}");
                    expected.map(|(number, _)| model.remove(&number));
                }
            }
            assert_eq!(waiting.len(), model.len());
        }
    }

    #[test]
    fn old_requests_get_every_eighth_slot() {
        let mut waiting = WaitingJobs::new();
        for number in 0..40u64 {
            // The last ones are the least urgent, and three of them are old, the last the oldest.
            let first_frame = if [25, 30, 35].contains(&number) { 1000 - number as u32 } else { 5000 };
            waiting.insert(job(number, "/set/a.glb"), now(-(number as f32)), first_frame);
        }
        let order: Vec<u64> = std::iter::from_fn(|| taken(&mut waiting, 4880)).collect();
        assert_eq!([7, 15, 23].map(|slot: usize| order[slot]), [35, 30, 25], "the oldest first");
        assert_eq!(order[..7], [0, 1, 2, 3, 4, 5, 6], "the most urgent otherwise");
        let mut sorted = order;
        sorted.sort_unstable();
        assert!(sorted.into_iter().eq(0..40), "each once");
    }

    /// Scenes with requests get slots in turns: no scene waits for the end of another.
    #[test]
    fn passed_over_scenes_get_the_next_slot() {
        let mut waiting = WaitingJobs::new();
        let page = || Scene::new().add_root(Page::from_node(Node::group(Vec::new())).unwrap());
        let pages = [page(), page(), page()];
        let mut number = 0;
        for (scene, (page, count)) in pages.iter().zip([100, 10, 3]).enumerate() {
            for _ in 0..count {
                let slot = NodeId { page: *page, index: number };
                let job = PageJob { slot, ..job(u64::from(number), "/set/a.glb") };
                waiting.insert(job, now(10.0 - scene as f32), 0);
                number += 1;
            }
        }
        let scene_of = |job: PageJob| pages.iter().position(|page| *page == job.slot.page).unwrap();
        let order: Vec<usize> =
            std::iter::from_fn(|| waiting.take(Source::Files, 0, |_, _| true)).map(scene_of).collect();
        assert_eq!((order.len(), &order[..5]), (113, &[0, 0, 0, 0, 1][..]), "the more urgent first");
        for scene in [1, 2] {
            let slots: Vec<usize> = (0..order.len()).filter(|slot| order[*slot] == scene).collect();
            assert!(slots[0] <= 5 && slots.windows(2).all(|two| two[1] - two[0] <= 6), "{slots:?}");
        }
    }

    /// Regression: a server that hangs may have all jobs that the budgets allow.
    #[test]
    fn one_file_may_always_be_read() {
        let list = RequestList::new(6, MAX_FILES);
        let mut state = list.lock();
        state.set_limits(limits(4));
        (0..4).for_each(|number| state.take_for_test(&job(number, "http://h/a.glb")));
        state.set_jobs((4..6).map(|number| job(number, "/set/a.glb")));
        let first = state.take_file_for_test(MAX_FILES).expect("one file");
        assert!(state.take_file_for_test(MAX_FILES).is_none(), "only one");
        state.answered(&first, false);
        state.set_limits(limits(0));
        assert!(state.take_file_for_test(MAX_FILES).is_none(), "no room at all, or paused");
        state.set_limits(limits(4));
        (6..8).for_each(|number| state.take_for_test(&job(number, "http://h/a.glb")));
        assert!(state.take_file_for_test(MAX_FILES).is_none(), "the channels hold no more");
    }
}
