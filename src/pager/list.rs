//! The request list: what the file and HTTP threads take their work from.
//!
//! One mutex, and a bell for the file threads and for the HTTP thread each. Update rewrites the waiting jobs each frame in
//! order of priority; a thread takes the last one. At most `capacity` jobs are outstanding (taken and not yet answered),
//! and the channels behind the threads hold as many, so no send ever blocks; but file threads wait for decoders. Within
//! that every server, and the disk, may have one, however few the budgets allow: one that hangs takes no other's place.
//!
//! `tests/pager_models.rs` runs this very file under thousands of schedules.

use std::sync::PoisonError;

#[cfg(feature = "http")]
use super::flow::{Flows, Range};
use super::job::Job;
use crate::io::is_remote;
#[cfg(feature = "http")]
use crate::io::{is_at, server};
use crate::sync::primitives::{Condvar, Mutex, MutexGuard};

/// Servers that may each have as many requests as one may.
pub(super) const SERVERS_AT_ONCE: usize = 4;

/// Of a server's places one in so many is kept free of what is wanted only later.
const KEPT_FREE: usize = 4;

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
    pub files_outstanding: usize,
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
    pub fn has_file_for(&self, most: usize) -> bool {
        let files = self.files_outstanding;
        files < most && self.file.last().is_some_and(|job| self.may_take(job, files, 0))
    }
}

/// Requests to all servers together: several as they start, and one as far as it may go.
#[cfg(feature = "http")]
pub(super) fn most_in_flight(range: Range) -> usize {
    SERVERS_AT_ONCE * range.start + range.most.saturating_sub(range.start)
}

/// Requests under way at each server: a few.
#[cfg(feature = "http")]
#[derive(Default)]
struct AtServers(Vec<(String, usize)>);

#[cfg(feature = "http")]
impl AtServers {
    fn count(&self, of: &str) -> usize {
        self.0.iter().find(|(server, _)| server == of).map_or(0, |(_, count)| *count)
    }

    fn add(&mut self, job: &Job) {
        for of in job.servers() {
            match self.0.iter_mut().find(|(server, _)| server == of) {
                Some((_, count)) => *count += 1,
                None => self.0.push((of.clone(), 1)),
            }
        }
    }
}

/// What the HTTP thread is to do.
#[cfg(feature = "http")]
pub(super) struct Taken {
    /// To be asked for.
    pub jobs: Vec<Job>,
    /// Tickets of those under way that nobody wants any more.
    pub aborts: Vec<u64>,
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

#[cfg(feature = "http")]
impl RequestList {
    /// What the HTTP thread is to do next, which has these jobs under way: of each server as many as it may have and `most`
    /// together. `None` once closed. Update waits for the lock meanwhile: what waits for a server that has all it may is
    /// passed over.
    pub fn take_of_servers<'a>(
        &self,
        under_way: impl Iterator<Item = &'a Job>,
        flows: &Flows,
        most: usize,
    ) -> Option<Taken> {
        let (mut at_servers, mut running) = (AtServers::default(), 0);
        for job in under_way {
            running += 1;
            at_servers.add(job);
        }
        let mut waiting = self.lock();
        if waiting.closed {
            return None;
        }
        let mut jobs: Vec<Job> = Vec::new();
        // Servers of which nothing more can be taken.
        let mut full: Vec<String> = Vec::new();
        // The most urgent are last.
        let mut next = waiting.http.len();
        while next > 0 && running + jobs.len() < most {
            next -= 1;
            let job = &waiting.http[next];
            if full.iter().any(|of| is_at(&job.uri, of)) {
                continue;
            }
            let count = |of: &str| at_servers.count(of);
            let left = most - running - jobs.len();
            let has_place = |of: &str| count(of) < flows.limit(of) && flows.leaves_enough(count(of), left);
            let own = server(&job.uri);
            if !waiting.may_take(job, count(own), flows.limit(own)) || !has_place(own) {
                // Places and room only grow fewer; too many that are wanted later say nothing of what is wanted now.
                if !job.is_ahead || !has_place(own) {
                    full.push(own.to_owned());
                }
                continue;
            }
            if job.servers().iter().all(|of| has_place(of)) {
                let job = waiting.http.remove(next);
                waiting.took(&job);
                at_servers.add(&job);
                jobs.push(job);
            }
        }
        Some(Taken { jobs, aborts: std::mem::take(&mut waiting.abort) })
    }
}
