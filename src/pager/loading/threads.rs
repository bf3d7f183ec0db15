//! The loading threads: file readers, the HTTP thread and decoders. Each ends when the list or its channel closes.

use std::sync::Arc;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvError, Sender, bounded, never, select};

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
        // Declared before the channels, so that those close first if a thread cannot start, and the others end.
        let mut threads = Self {
            list: list.clone(),
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
        let files = FileThreads::new(list.clone(), read_sender, files, config.readers, config.file_timeout);
        let files = threads.files.insert(files).clone();
        files.start()?;
        let (watch, closed) = bounded(0);
        threads.watch = Some(watch);
        threads.spawn("watch", move || files.watch(&closed))?;
        #[cfg(feature = "http")]
        {
            let (list, answers, limits) = (list.clone(), answer_sender.clone(), config.limits);
            let name = format!("{}-http", J::THREAD_PREFIX);
            let runtime = fetch::runtime(&name).map_err(|source| PagerError::Thread { name, source })?;
            let access = HttpAccess::new(&runtime);
            let (clients, range) = (access.clients(), config.per_server);
            threads.http = Some(access);
            threads.spawn("http", move || {
                http::run(&runtime, &list, &received_sender, &answers, &clients, &limits, range);
                // Threads that hang on the cache are left alone.
                runtime.shutdown_timeout(MAX_SHUTDOWN_TIME);
            })?;
        }
        for i in 0..decoders {
            let open = if cfg!(feature = "http") { 2 } else { 1 };
            let intake = Intake { files: read.clone(), servers: received.clone(), open };
            let sender = answer_sender.clone();
            threads.spawn(&format!("decode-{i}"), move || decode(intake, &sender))?;
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

fn decode<J: LoadJob>(mut intake: Intake<J>, sender: &Sender<Answer<J>>) {
    while let Some(LoadedBytes { job, loaded, companions, bytes_read, bytes_http }) = intake.next() {
        follow_core();
        let span = job.decode_span();
        let content = loaded.and_then(|loaded| job.decode(loaded, companions));
        drop(span);
        if sender.send(Answer { job, content: Some(content), bytes_read, bytes_http }).is_err() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::page_job::PageJob;
    use super::super::page_job::tests::job;
    use super::super::request_list::Limits;
    use super::*;

    fn limits(outstanding: usize) -> Limits {
        Limits { outstanding, prefetch_room: 0, prefetch_beside_others: 0 }
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
