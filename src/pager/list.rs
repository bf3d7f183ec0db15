//! The request list: what the file and HTTP threads take their work from.
//!
//! One mutex, two condition variables' worth of waiting. Update rewrites the waiting jobs each frame in order of
//! priority; a thread takes the last one. At most `capacity` jobs are outstanding (taken and not yet answered),
//! and the channels behind the threads hold as many, so no send ever blocks; but file threads wait for decoders. Within
//! that every server, and the disk, may have one, however few the budgets allow: one that hangs takes no other's place.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use glam::DAffine3;

use super::scenes::Scope;
use super::shares::Held;
use super::states::Stage;
use super::tries::Tries;
use crate::io::{Fetched, IoError, is_remote};
use crate::scene::{DrawKind, Drawable, NodeId, Page, PagingOptions};

/// Of a server's places one in so many is kept free of what is wanted only later.
const KEPT_FREE: usize = 4;

/// What is wanted in so many frames takes the place of what no picture shows any more, as what is missing in one does: it
/// would make room for it by then.
const SOON_FRAMES: u32 = 3;

/// One content to load.
#[derive(Clone, Debug)]
pub(super) struct Job {
    /// Names this load; an answer with another number is late.
    pub ticket: u64,
    pub slot: NodeId,
    pub uri: Arc<str>,
    pub reader_data: Option<Arc<str>>,
    /// Tilesets above.
    pub above: Above,
    /// Its scene's.
    pub scope: Arc<Scope>,
    /// Wanted later, when it was listed.
    pub is_ahead: bool,
    /// Where the threads are with it; clones of the job have the same.
    pub stage: Arc<Stage>,
}

/// The tilesets above what is in a page.
#[derive(Clone, Debug)]
pub(super) struct Above {
    /// Their URIs, for cycles; empty where the page is no tileset's.
    pub chain: Arc<[Arc<str>]>,
    /// The product of their tiles' transforms.
    pub set_from_page: DAffine3,
}

/// Bytes on their way to a decode worker.
pub(super) struct Loaded {
    pub job: Job,
    pub bytes: Result<Vec<u8>, IoError>,
    pub companions: Vec<Fetched>,
    pub bytes_read: u64,
    pub bytes_http: u64,
}

/// The answer to a job.
pub(super) struct Answer {
    pub job: Job,
    /// `None` when the job was aborted.
    pub page: Option<Result<Page, IoError>>,
    pub bytes_read: u64,
    pub bytes_http: u64,
}

/// What the mutex guards.
#[derive(Default)]
pub(super) struct Waiting {
    /// Written by update, taken from the end by file threads.
    pub file: Vec<Job>,
    /// Written by update, taken from the end by the HTTP thread.
    pub http: Vec<Job>,
    /// Tickets taken since update last looked, and not yet answered; written by the takers, drained by update.
    pub taken: Vec<u64>,
    /// Tickets of running HTTP requests to abort; written by update, drained by the HTTP thread.
    pub abort: Vec<u64>,
    /// Taken and not yet answered; raised by takers, lowered by update.
    pub outstanding: usize,
    /// Of those outstanding, files.
    files_outstanding: usize,
    /// Most that may be outstanding in any case.
    capacity: usize,
    /// Most that may be outstanding; written by update from the budgets.
    pub allowed: usize,
    /// Of those outstanding, wanted only later.
    pub ahead_outstanding: usize,
    /// Most of them that the budgets have room for.
    pub ahead_room: usize,
    /// Most of them beside others.
    pub ahead_allowed: usize,
    /// Of all scopes; written by update, read by the HTTP thread at the end: what came for them is still to be kept.
    #[cfg(feature = "http")]
    pub clients: Vec<crate::io::HttpClient>,
    /// Set once, by drop.
    pub closed: bool,
}

impl Waiting {
    /// A thread may take a job from a server, or from the disk, that has so many of its `places` taken. What is wanted only
    /// later leaves some of a server's places to what is missing; over a network that answers late few at once come too
    /// late.
    pub fn may_take(&self, job: &Job, beside: usize, places: usize) -> bool {
        if job.is_ahead {
            let most = if beside < places - places.div_ceil(KEPT_FREE) {
                self.ahead_room
            } else {
                self.ahead_allowed.min(self.ahead_room)
            };
            return self.outstanding < self.allowed && self.ahead_outstanding < most;
        }
        let is_first = beside == 0 && self.allowed > 0;
        self.outstanding < if is_first { self.capacity } else { self.allowed }
    }

    /// A thread could take something, or will be answered.
    pub fn is_under_way(&self) -> bool {
        let may_take = |jobs: &[Job]| jobs.last().is_some_and(|job| self.may_take(job, 0, 0));
        self.outstanding > 0 || may_take(&self.file) || may_take(&self.http)
    }

    pub fn took(&mut self, job: &Job) {
        self.outstanding += 1;
        self.files_outstanding += usize::from(!is_remote(&job.uri));
        self.ahead_outstanding += usize::from(job.is_ahead);
        self.taken.push(job.ticket);
        job.stage.reads();
    }

    /// `arrived`: its page takes room in the budgets from now on, which is reckoned anew soon.
    pub fn answered(&mut self, job: &Job, arrived: bool) {
        self.allowed = self.allowed.saturating_sub(usize::from(arrived));
        self.outstanding = self.outstanding.saturating_sub(1);
        self.files_outstanding = self.files_outstanding.saturating_sub(usize::from(!is_remote(&job.uri)));
        self.ahead_outstanding = self.ahead_outstanding.saturating_sub(usize::from(job.is_ahead));
        self.taken.retain(|ticket| *ticket != job.ticket);
    }

    /// A file may be taken.
    fn has_file_for(&self, most: usize) -> bool {
        let files = self.files_outstanding;
        files < most && self.file.last().is_some_and(|job| self.may_take(job, files, 0))
    }
}

/// The list and its bell.
pub(super) struct RequestList {
    waiting: Mutex<Waiting>,
    file_bell: Condvar,
    /// Rings the HTTP thread.
    #[cfg(feature = "http")]
    pub http_bell: tokio::sync::Notify,
    pub capacity: usize,
    /// Tells this pager's tickets from others' on a timeline.
    pub ticket_source: u64,
    /// Most files that may be outstanding: they need no more to keep the threads busy.
    for_files: usize,
}

impl RequestList {
    pub fn new(capacity: usize, for_files: usize) -> Self {
        Self {
            waiting: Mutex::new(Waiting { allowed: capacity, capacity, ..Waiting::default() }),
            file_bell: Condvar::new(),
            #[cfg(feature = "http")]
            http_bell: tokio::sync::Notify::new(),
            capacity,
            ticket_source: crate::timeline::ticket_source(),
            for_files,
        }
    }

    /// A panic while the lock is held cannot leave the plain data half written in a way that matters.
    pub fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Wakes whoever has something to take or to abort. Of the file threads one, which wakes the next: a wake-up takes
    /// the frame up to 100 microseconds on a virtual machine.
    pub fn ring(&self, waiting: MutexGuard<'_, Waiting>) {
        let is_closed = waiting.closed;
        let has_file = waiting.has_file_for(self.for_files);
        #[cfg(feature = "http")]
        let has_http = is_closed || !waiting.http.is_empty() || !waiting.abort.is_empty();
        drop(waiting);
        if is_closed {
            self.file_bell.notify_all();
        } else if has_file {
            self.file_bell.notify_one();
        }
        #[cfg(feature = "http")]
        if has_http {
            self.http_bell.notify_one();
        }
    }

    /// The same, for what was written before.
    pub fn ring_if_due(&self) {
        self.ring(self.lock());
    }

    pub fn close(&self) {
        let mut waiting = self.lock();
        waiting.closed = true;
        self.ring(waiting);
    }

    /// The next file to read; blocks; `None` when the pager ends.
    pub fn take_file(&self) -> Option<Job> {
        let mut waiting = self.lock();
        loop {
            if waiting.closed {
                return None;
            }
            if waiting.has_file_for(self.for_files)
                && let Some(job) = waiting.file.pop()
            {
                waiting.took(&job);
                if waiting.has_file_for(self.for_files) {
                    self.file_bell.notify_one();
                }
                return Some(job);
            }
            waiting = self.file_bell.wait(waiting).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

/// A page that waits for its contexts, or for its turn to merge.
pub(super) struct Arrived {
    pub page: Box<Page>,
    /// By context.
    pub gpu_bytes: Vec<(u32, u64)>,
    /// Contexts that still compile.
    pub contexts_left: usize,
    /// In memory, shared contents left out.
    pub counts: Held,
    /// What uploads that have begun may take besides.
    pub reserved_gpu: u64,
    /// Until its uploads begin.
    pub payload: Option<Payload>,
}

/// What is to be uploaded of a page.
pub(super) struct Payload {
    pub drawables: Vec<Drawable>,
    pub kinds: Arc<[DrawKind]>,
    pub bytes: u64,
}

impl Arrived {
    /// Contexts have it and have not told how large it is.
    pub fn is_uploading(&self) -> bool {
        self.contexts_left > 0 && self.payload.is_none()
    }
}

/// How far a request is.
pub(super) enum Progress {
    Waiting,
    Loading,
    Arrived(Arrived),
    /// Not before this moment.
    Failed {
        retry_at: Option<Instant>,
    },
}

/// A request and what became of it.
pub(super) struct Entry {
    pub job: Job,
    pub priority: f32,
    /// Frame in which it was first asked for.
    pub asked_frame: u32,
    /// Frame in which cull last asked.
    pub wanted_frame: u32,
    /// Frames until a picture will lack it, as it was last asked for; 0 where one does.
    pub ahead_frames: u32,
    pub since: Instant,
    pub tries: Tries,
    /// Bytes that it takes, where it was loaded and found no room: it is not loaded again before it has.
    pub needs: Option<Held>,
    pub progress: Progress,
    pub paging: PagingOptions,
}

impl Entry {
    /// Wanted later, by no picture yet.
    pub fn is_ahead(&self) -> bool {
        self.ahead_frames > 0
    }

    /// Wanted later, but in one of the next frames.
    pub fn is_soon(&self) -> bool {
        (1..=SOON_FRAMES).contains(&self.ahead_frames)
    }

    /// It waits for a thread, or one has it.
    pub fn is_under_way(&self) -> bool {
        matches!(self.progress, Progress::Waiting | Progress::Loading)
    }

    /// It failed, in passing.
    pub fn will_be_tried(&self) -> bool {
        matches!(self.progress, Progress::Failed { retry_at: Some(_) })
    }

    /// Nobody wants it any longer. False where it can be forgotten: tries that failed are not, so that whoever comes back
    /// does not make them again.
    pub fn rests(&mut self) -> bool {
        self.progress = Progress::Failed { retry_at: Some(Instant::now()) };
        !self.tries.is_none()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::sync::LazyLock;

    use crate::io::{Limits, ReadOptions};
    use crate::scene::{Node, PageId, Scene};

    static PAGE: LazyLock<PageId> =
        LazyLock::new(|| Scene::new().add_root(Page::from_node(Node::group(Vec::new())).unwrap()));
    static SCOPE: LazyLock<Arc<Scope>> = LazyLock::new(|| {
        Arc::new(Scope {
            options: ReadOptions::for_root("/set/tileset.json", Limits::default()),
            #[cfg(feature = "http")]
            client: crate::io::HttpClient::new(&crate::io::HttpConfig::default()).unwrap(),
        })
    });

    pub(in crate::pager) fn job(ticket: u64, uri: &str) -> Job {
        Job {
            ticket,
            slot: NodeId { page: *PAGE, index: ticket as u32 },
            scope: SCOPE.clone(),
            uri: uri.into(),
            reader_data: None,
            above: Above { chain: Arc::new([]), set_from_page: DAffine3::IDENTITY },
            is_ahead: false,
            stage: Arc::default(),
        }
    }

    /// Files were read only while few requests of servers were under way.
    #[test]
    fn requests_of_servers_take_no_files_places() {
        let list = RequestList::new(100, 18);
        let asked: Vec<Job> = (0..30).map(|ticket| job(ticket, "http://h/a.glb")).collect();
        let mut waiting = list.lock();
        asked.iter().for_each(|job| waiting.took(job));
        waiting.file = (30..50).map(|ticket| job(ticket, "/set/a.glb")).collect();
        let mut read = Vec::new();
        while waiting.has_file_for(list.for_files)
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
        let list = RequestList::new(6, 18);
        let mut waiting = list.lock();
        waiting.allowed = 4;
        (0..4).for_each(|ticket| waiting.took(&job(ticket, "http://h/a.glb")));
        waiting.file = (4..6).map(|ticket| job(ticket, "/set/a.glb")).collect();
        assert!(waiting.has_file_for(list.for_files));
        let first = waiting.file.pop().unwrap();
        waiting.took(&first);
        assert!(!waiting.has_file_for(list.for_files), "but one");
        waiting.answered(&first, false);
        waiting.allowed = 0;
        assert!(!waiting.has_file_for(list.for_files), "no room at all, or paused");
        waiting.allowed = 4;
        (6..8).for_each(|ticket| waiting.took(&job(ticket, "http://h/a.glb")));
        assert!(!waiting.has_file_for(list.for_files), "the channels hold no more");
    }
}
