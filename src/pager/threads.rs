//! The pager's threads: file readers, decode workers, the reaper. Each ends when the list closes or its channel does.

use std::sync::Arc;
use std::thread::JoinHandle;

use crossbeam_channel::{Receiver, RecvError, Sender, bounded, never, select, unbounded};
use thread_priority::{ThreadPriority, ThreadPriorityValue};

use super::config::{PagerConfig, PagerError};
#[cfg(feature = "http")]
use super::flow::Range;
#[cfg(feature = "http")]
use super::http::Door;
use super::job::{Above, Answer, Job, Loaded};
use super::list::{RequestList, SERVERS_AT_ONCE};
use crate::io::{self, Content, ReadOptions};
use crate::scene::{Page, SharedStateManager};
use crate::timeline;

/// After so many dropped pages a part of what is shared is looked through for what nobody uses.
const PAGES_BETWEEN_PRUNES: usize = 16;

/// Of each decode thread, pages that may be decoded and not yet taken up while files are read: what a frame of a 60th of a
/// second has to take up.
const DECODED_AHEAD: usize = 12;

/// Of each decode thread, files that may be read and not yet decoded: bytes that wait are memory, and disks are quick.
const READ_AHEAD: usize = 2;

/// Most requests that a server may have at once: each has a place in channels.
const MOST_IN_FLIGHT: usize = 4096;

/// All threads of a pager; dropping it stops and joins them.
pub(super) struct Threads {
    pub list: Arc<RequestList>,
    /// `None` once closed.
    pub answers: Option<Receiver<Answer>>,
    #[cfg(feature = "http")]
    pub door: Option<Door>,
    reaper: Option<Sender<Box<Page>>>,
    handles: Vec<JoinHandle<()>>,
}

impl Threads {
    pub fn start(config: &PagerConfig, sharing: Option<Arc<SharedStateManager>>) -> Result<Self, PagerError> {
        let (start, most) =
            (config.http_in_flight.clamp(1, MOST_IN_FLIGHT), config.http_in_flight_max.min(MOST_IN_FLIGHT));
        let (readers, decoders) = (config.file_threads.max(1), config.decode_threads.max(1));
        let beside = 4 * readers + 2 * decoders;
        let capacity = SERVERS_AT_ONCE * start + beside + most.saturating_sub(start);
        let for_files = beside + DECODED_AHEAD * decoders;
        let capacity = capacity.max(for_files);
        let list = Arc::new(RequestList::new(capacity, for_files));
        // Before the channels, which end before it is dropped: where a thread cannot start, those that did end.
        let mut threads = Self {
            list: list.clone(),
            answers: None,
            #[cfg(feature = "http")]
            door: None,
            reaper: None,
            handles: Vec::new(),
        };
        let (read_sender, read) = bounded::<Loaded>(READ_AHEAD * decoders);
        #[cfg(feature = "http")]
        let (loaded_sender, loaded) = bounded::<Loaded>(capacity);
        #[cfg(not(feature = "http"))]
        let loaded = never::<Loaded>();
        let (answer_sender, answers) = bounded::<Answer>(capacity);
        // Thousands may go at once. They are out of all budgets, and gone sooner than others come.
        let (reaper, doomed) = unbounded::<Box<Page>>();
        (threads.answers, threads.reaper) = (Some(answers), Some(reaper));
        let files = Arc::new(io::FileReader::new(config.limits));
        for i in 0..readers {
            let (list, sender, files) = (list.clone(), read_sender.clone(), files.clone());
            threads.spawn(format!("pager-file-{i}"), move || read_files(&list, &sender, &files))?;
        }
        #[cfg(feature = "http")]
        {
            let (list, sender, limits) = (list.clone(), loaded_sender, config.limits);
            let (range, answers) = (Range { start, most }, answer_sender.clone());
            let name = "pager-http".to_owned();
            let runtime = io::runtime(&name).map_err(|source| PagerError::Thread { name: name.clone(), source })?;
            threads.door = Some(Door { runtime: runtime.handle().clone() });
            threads.spawn(name, move || {
                super::http::run(&runtime, &list, &sender, &answers, &limits, range);
            })?;
        }
        for i in 0..decoders {
            let open = if cfg!(feature = "http") { 2 } else { 1 };
            let from = Intake { files: read.clone(), servers: loaded.clone(), open };
            let sender = answer_sender.clone();
            threads.spawn(format!("pager-decode-{i}"), move || decode(from, &sender))?;
        }
        threads.spawn("pager-reaper".to_owned(), move || {
            for (count, page) in doomed.into_iter().enumerate() {
                let _span = timeline::span("drop page");
                drop(page);
                if let Some(sharing) = sharing.as_ref().filter(|_| count % PAGES_BETWEEN_PRUNES == 0) {
                    sharing.prune();
                }
            }
        })?;
        Ok(threads)
    }

    fn spawn(&mut self, name: String, run: impl FnOnce() + Send + 'static) -> Result<(), PagerError> {
        let builder = std::thread::Builder::new().name(name.clone());
        let run = || {
            yield_to_frames();
            run();
        };
        let handle = builder.spawn(run).map_err(|source| PagerError::Thread { name, source })?;
        self.handles.push(handle);
        Ok(())
    }

    /// Drops a page off the main thread.
    pub fn reap(&self, page: Box<Page>) {
        if let Some(reaper) = &self.reaper {
            // Without its thread, which ends with this alone, the page is dropped here.
            let _ = reaper.send(page);
        }
    }
}

impl Drop for Threads {
    fn drop(&mut self) {
        self.list.close();
        self.answers = None;
        self.reaper = None;
        for handle in self.handles.drain(..) {
            if handle.join().is_err() {
                log::error!("a pager thread panicked");
            }
        }
    }
}

/// Lets the calling thread have a core only while no frame wants it: there is a decode thread for each core, and a frame
/// that wakes a thread goes on before it.
fn yield_to_frames() {
    // Nice 9 where there is niceness: a tenth of the weight of a thread that draws.
    let below_normal = ThreadPriorityValue::try_from(25u8).map(ThreadPriority::Crossplatform);
    let lowered = below_normal.map(thread_priority::set_current_thread_priority);
    if !matches!(lowered, Ok(Ok(()))) {
        log::debug!("the priority of {:?} could not be lowered: {lowered:?}", std::thread::current().name());
    }
}

fn read_files(list: &RequestList, sender: &Sender<Loaded>, files: &io::FileReader) {
    while let Some(job) = list.take_file() {
        let span = timeline::span_of("fetch", || job.uri.clone());
        let bytes = match io::is_remote(&job.uri) {
            true => Err(io::IoError::unsupported(&job.uri, "a server (built without the feature)")),
            false => files.read(&job.uri),
        };
        let companions: Vec<_> = match &bytes {
            Ok(_) => io::companions(&job.uri, job.reader_data.as_ref())
                .into_iter()
                .map(|uri| {
                    let bytes = files.read(&uri);
                    (uri, bytes)
                })
                .collect(),
            Err(_) => Vec::new(),
        };
        let bytes_read = read_bytes(&bytes, &companions);
        drop(span);
        job.stage.decodes();
        if sender.send(Loaded { job, bytes, companions, bytes_read, bytes_http: 0 }).is_err() {
            return;
        }
    }
}

/// Bytes that came in for a content and its companions.
pub(super) fn read_bytes(bytes: &Result<Vec<u8>, io::IoError>, companions: &[io::Fetched]) -> u64 {
    let of = |r: &Result<Vec<u8>, io::IoError>| r.as_ref().map_or(0, |b| b.len() as u64);
    of(bytes) + companions.iter().map(|(_, r)| of(r)).sum::<u64>()
}

/// What a decode thread takes from.
struct Intake {
    files: Receiver<Loaded>,
    servers: Receiver<Loaded>,
    /// Of the two, those that have not ended.
    open: usize,
}

impl Intake {
    /// What comes next; `None` once all have ended.
    fn next(&mut self) -> Option<Loaded> {
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

fn decode(mut from: Intake, sender: &Sender<Answer>) {
    while let Some(Loaded { job, bytes, companions, bytes_read, bytes_http }) = from.next() {
        let span = timeline::span_of("decode", || job.uri.clone());
        let page = bytes.and_then(|bytes| {
            let page = decode_one(&job, bytes, companions);
            if let Err(error) = &page
                && error.is_no_content()
            {
                job.scope.forget(error.uri());
            }
            page
        });
        drop(span);
        if sender.send(Answer { job, page: Some(page), bytes_read, bytes_http }).is_err() {
            return;
        }
    }
}

fn decode_one(job: &Job, bytes: Vec<u8>, companions: Vec<io::Fetched>) -> Result<Page, io::IoError> {
    let content = Content { uri: job.uri.clone(), bytes, reader_data: job.reader_data.clone(), companions };
    let Above { chain, set_from_page } = job.above.clone();
    let options = ReadOptions { chain, set_from_content: set_from_page, ..job.scope.options.clone() };
    io::decode(content, &options)
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;
    use std::time::Duration;

    use super::super::job::tests::job;
    use super::*;
    use crate::scene::{CullAction, CullCallback, Node};

    /// A codec's panic ended the thread, and its job was never answered.
    #[test]
    fn a_panic_while_reading_is_an_error_of_that_file() {
        let (list, (sender, read)) = (RequestList::new(4, 4), bounded(4));
        list.lock().file = [1, 2].map(|ticket| job(ticket, &format!("/{ticket}/{}", io::PANICS))).to_vec();
        std::thread::scope(|scope| {
            scope.spawn(|| read_files(&list, &sender, &io::FileReader::new(io::Limits::default())));
            for _ in 0..2 {
                let loaded = read.recv_timeout(Duration::from_secs(60)).expect("the thread goes on");
                assert_eq!(loaded.bytes.unwrap_err().reason(), io::DECODER_PANICKED);
            }
            list.close();
        });
    }

    /// Says which thread drops it.
    struct Told(Arc<Mutex<Vec<String>>>);

    impl Drop for Told {
        fn drop(&mut self) {
            let name = std::thread::current().name().unwrap_or_default().to_owned();
            self.0.lock().unwrap().push(name);
        }
    }

    /// Beyond 256 they were dropped by whoever updates.
    #[test]
    fn thousands_of_pages_are_dropped_by_the_reaper() {
        let threads = Threads::start(&PagerConfig::default(), None).unwrap();
        let dropped: Arc<Mutex<Vec<String>>> = Arc::default();
        for _ in 0..5000 {
            let told = Told(dropped.clone());
            let callback = CullCallback(Arc::new(move |_| {
                let _ = &told;
                CullAction::Traverse
            }));
            let node = Node { cull_callback: Some(callback), ..Node::group(Vec::new()) };
            threads.reap(Box::new(Page::from_node(node).unwrap()));
        }
        drop(threads);
        let dropped = dropped.lock().unwrap();
        assert_eq!(dropped.len(), 5000);
        assert!(dropped.iter().all(|name| name == "pager-reaper"), "{:?}", dropped.last());
    }

    /// Files that may be outstanding.
    const FOR_FILES: usize = 18;

    /// Files were read only while few requests of servers were under way.
    #[test]
    fn requests_of_servers_take_no_files_places() {
        let list = RequestList::new(100, FOR_FILES);
        let asked: Vec<Job> = (0..30).map(|ticket| job(ticket, "http://h/a.glb")).collect();
        let mut waiting = list.lock();
        asked.iter().for_each(|job| waiting.took(job));
        waiting.file = (30..50).map(|ticket| job(ticket, "/set/a.glb")).collect();
        let mut read = Vec::new();
        while waiting.has_file_for(FOR_FILES)
            && let Some(job) = waiting.file.pop()
        {
            waiting.took(&job);
            read.push(job);
        }
        assert_eq!(read.len(), 18);
        waiting.answered(&read[0], false);
        waiting.answered(&asked[0], false);
        assert_eq!((waiting.outstanding, waiting.files_outstanding), (46, 17));
    }

    /// All that the budgets allow may be with a server that hangs.
    #[test]
    fn the_disk_has_a_place_in_any_case() {
        let list = RequestList::new(6, FOR_FILES);
        let mut waiting = list.lock();
        waiting.allowed = 4;
        (0..4).for_each(|ticket| waiting.took(&job(ticket, "http://h/a.glb")));
        waiting.file = (4..6).map(|ticket| job(ticket, "/set/a.glb")).collect();
        assert!(waiting.has_file_for(FOR_FILES));
        let first = waiting.file.pop().unwrap();
        waiting.took(&first);
        assert!(!waiting.has_file_for(FOR_FILES), "but one");
        waiting.answered(&first, false);
        waiting.allowed = 0;
        assert!(!waiting.has_file_for(FOR_FILES), "no room at all, or paused");
        waiting.allowed = 4;
        (6..8).for_each(|ticket| waiting.took(&job(ticket, "http://h/a.glb")));
        assert!(!waiting.has_file_for(FOR_FILES), "the channels hold no more");
    }
}
