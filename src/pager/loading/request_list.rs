//! The request list: the jobs that the file threads and the HTTP thread take their work from.
//!
//! One mutex guards the list; the file threads and the HTTP thread have a bell each. Update adds jobs, changes their urgency
//! and removes them; a thread takes the most urgent one (`waiting_jobs.rs`). At most [`RequestList::capacity`] jobs are
//! outstanding (taken and not yet answered), and the channels behind the threads hold as many. So no send of an answer blocks;
//! only file threads wait, for decoders. The budgets allow fewer jobs than that; but each server, and the disk, may always have
//! one: a server that hangs does not hold up the others.
//!
//! `tests/models/pager_models.rs` runs this very file under thousands of schedules.

use std::collections::BTreeMap;
use std::sync::PoisonError;

use super::request::Request;
#[cfg(feature = "http")]
use super::server_limits::ServerLimits;
use super::ticket::Ticket;
use super::waiting_jobs::{Source, Urgency, WaitingJobs};
use crate::sync::primitives::{Condvar, Mutex, MutexGuard};

/// One in this many slots of a server is kept free of prefetches.
const PREFETCH_FREE_SHARE: usize = 4;

/// How many jobs may be outstanding; written by update from the budgets.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Jobs in all.
    pub outstanding: usize,
    /// Prefetches that the budgets have room for.
    pub prefetch_room: usize,
    /// Prefetches that may be outstanding beside other jobs.
    pub prefetch_beside_others: usize,
    /// Requests that were first made before this frame are old: some slots go to them.
    pub aged_before: u32,
}

/// The jobs that are taken and not yet answered, and how many there may be.
#[derive(Clone, Copy)]
struct Usage {
    /// Jobs taken and not yet answered. Raised by the takers, lowered by update.
    outstanding: usize,
    /// Outstanding jobs that read files.
    files: usize,
    /// Outstanding jobs that are prefetches.
    prefetches: usize,
    /// The number of outstanding jobs that is never exceeded.
    capacity: usize,
    /// Written by update.
    limits: Limits,
}

impl Usage {
    /// Returns true if a thread may take a job from a server, or from the disk, that has `busy` of its `slots` taken.
    /// Prefetches leave a quarter of a server's slots free; over a slow network, fewer at once would be late.
    fn may_take(&self, is_prefetch: bool, busy: usize, slots: usize) -> bool {
        let limits = &self.limits;
        if is_prefetch {
            let max = if busy < slots - slots.div_ceil(PREFETCH_FREE_SHARE) {
                limits.prefetch_room
            } else {
                limits.prefetch_beside_others.min(limits.prefetch_room)
            };
            return self.outstanding < limits.outstanding && self.prefetches < max;
        }
        let is_first = busy == 0 && limits.outstanding > 0;
        self.outstanding < if is_first { self.capacity } else { limits.outstanding }
    }

    /// Returns true if a thread may read another file.
    fn may_take_file(&self, is_prefetch: bool) -> bool {
        self.may_take(is_prefetch, self.files, 0)
    }

    fn took(&mut self, job: &impl Request) {
        self.outstanding += 1;
        self.files += usize::from(!job.is_remote());
        self.prefetches += usize::from(job.is_prefetch());
    }

    /// Counts a job as answered. A content takes room in the budgets from now on: one job fewer may be outstanding until
    /// update calculates the limits again, and one prefetch fewer after a prefetch.
    fn answered(&mut self, job: &impl Request, has_content: bool) {
        let prefetches = usize::from(job.is_prefetch());
        if has_content {
            let limits = &mut self.limits;
            limits.outstanding = limits.outstanding.saturating_sub(1);
            limits.prefetch_room = limits.prefetch_room.saturating_sub(prefetches);
            limits.prefetch_beside_others = limits.prefetch_beside_others.saturating_sub(prefetches);
        }
        self.outstanding = self.outstanding.saturating_sub(1);
        self.files = self.files.saturating_sub(usize::from(!job.is_remote()));
        self.prefetches = self.prefetches.saturating_sub(prefetches);
    }
}

/// The state that the mutex guards.
pub(crate) struct ListState<J: Request> {
    /// Written by update, taken by the threads.
    waiting: WaitingJobs<J>,
    /// Jobs taken since update last looked and not yet answered. Written by the takers, drained by update.
    taken: BTreeMap<Ticket, J>,
    /// Tickets of running HTTP requests to abort. Written by update, drained by the HTTP thread.
    abort: Vec<Ticket>,
    usage: Usage,
    /// Set once, when the pager is dropped.
    is_closed: bool,
}

impl<J: Request> ListState<J> {
    fn new(capacity: usize) -> Self {
        let limits = Limits { outstanding: capacity, prefetch_room: 0, prefetch_beside_others: 0, aged_before: 0 };
        Self {
            waiting: WaitingJobs::new(),
            taken: BTreeMap::new(),
            abort: Vec::new(),
            usage: Usage { outstanding: 0, files: 0, prefetches: 0, capacity, limits },
            is_closed: false,
        }
    }

    /// Replaces all waiting jobs; the most urgent come last. For short lists.
    pub fn set_jobs(&mut self, jobs: impl IntoIterator<Item = J>) {
        self.waiting.clear();
        self.waiting.insert_ranked(jobs);
    }

    /// Adds a waiting job that was first requested in a frame.
    pub fn insert(&mut self, job: J, urgency: Urgency, first_frame: u32) {
        self.waiting.insert(job, urgency, first_frame);
    }

    /// Removes a job if it waits.
    pub fn remove(&mut self, ticket: Ticket) {
        self.waiting.remove(ticket);
    }

    /// Returns the most urgent jobs that wait and are no prefetches, at most `max` of each scene in each lane.
    pub fn most_urgent(&self, max: usize) -> impl Iterator<Item = &J> {
        self.waiting.most_urgent(max)
    }

    /// Changes the urgencies of the jobs that wait.
    pub fn set_urgencies(&mut self, changes: &[(Ticket, Urgency)]) {
        self.waiting.set_urgencies(changes);
    }

    /// Replaces the limits.
    pub fn set_limits(&mut self, limits: Limits) {
        self.usage.limits = limits;
    }

    /// Returns at most `max` of the jobs that were taken, not yet answered, and not returned before, the oldest first.
    pub fn drain_taken(&mut self, max: usize) -> impl Iterator<Item = J> + '_ {
        std::iter::from_fn(|| self.taken.pop_first()).take(max).map(|(_, job)| job)
    }

    /// Aborts a running HTTP request; its answer has no content. Has no effect on other jobs.
    pub fn abort(&mut self, ticket: Ticket) {
        self.abort.push(ticket);
    }

    /// Returns the number of jobs taken and not yet answered.
    pub fn outstanding(&self) -> usize {
        self.usage.outstanding
    }

    /// Returns the number of outstanding jobs that are not prefetches.
    pub fn outstanding_now(&self) -> usize {
        self.usage.outstanding.saturating_sub(self.usage.prefetches)
    }

    /// Returns the number of jobs taken since update last looked that are not prefetches.
    pub fn taken_now(&self) -> usize {
        self.taken.values().filter(|job| !job.is_prefetch()).count()
    }

    /// Returns the number of outstanding jobs that are prefetches.
    pub fn outstanding_prefetches(&self) -> usize {
        self.usage.prefetches
    }

    /// Returns the number of waiting jobs.
    pub fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// Returns true if a thread could take a job now, or has one that it will answer.
    pub fn is_under_way(&self) -> bool {
        let usage = self.usage;
        let has_next = |source| self.waiting.has_next(source, |_, is_prefetch| usage.may_take(is_prefetch, 0, 0));
        let has_file = usage.outstanding > 0 || has_next(Source::Files);
        #[cfg(feature = "http")]
        return has_file || has_next(Source::Servers);
        #[cfg(not(feature = "http"))]
        has_file
    }

    /// Counts a job as answered. With `has_content` the content takes room in the budgets from now on.
    pub fn answered(&mut self, job: &J, has_content: bool) {
        self.usage.answered(job, has_content);
        self.taken.remove(&job.ticket());
    }

    /// Counts a job as taken.
    fn took(&mut self, job: &J) {
        self.usage.took(job);
        self.taken.insert(job.ticket(), job.clone());
        job.mark_reading();
    }

    /// Takes the file that is next if fewer than `max_files` are outstanding and the limits allow it.
    fn take_file(&mut self, max_files: usize) -> Option<J> {
        let usage = self.usage;
        if usage.files >= max_files {
            return None;
        }
        let may_take = |_: &[String], is_prefetch: bool| usage.may_take_file(is_prefetch);
        let job = self.waiting.take(Source::Files, usage.limits.aged_before, may_take)?;
        self.took(&job);
        Some(job)
    }

    /// Returns true if [`Self::take_file`] would take one.
    fn has_file(&self, max_files: usize) -> bool {
        let usage = self.usage;
        usage.files < max_files
            && self.waiting.has_next(Source::Files, |_, is_prefetch| usage.may_take_file(is_prefetch))
    }
}

/// The number of requests in flight at each server; a few servers.
#[cfg(feature = "http")]
#[derive(Default)]
struct InFlight(Vec<(String, usize)>);

#[cfg(feature = "http")]
impl InFlight {
    fn count(&self, at: &str) -> usize {
        self.0.iter().find(|(server, _)| server == at).map_or(0, |(_, count)| *count)
    }

    fn add(&mut self, job: &impl Request) {
        for at in job.servers() {
            match self.0.iter_mut().find(|(server, _)| server == at) {
                Some((_, count)) => *count += 1,
                None => self.0.push((at.clone(), 1)),
            }
        }
    }
}

/// Work for the HTTP thread.
#[cfg(feature = "http")]
pub(crate) struct HttpWork<J> {
    /// Jobs to request.
    pub jobs: Vec<J>,
    /// Tickets of running requests to abort.
    pub aborts: Vec<Ticket>,
}

/// The list and its bells.
pub(crate) struct RequestList<J: Request> {
    state: Mutex<ListState<J>>,
    file_bell: Condvar,
    #[cfg(feature = "http")]
    http_bell: tokio::sync::Notify,
    capacity: usize,
    /// The number of files that may be outstanding; more would not keep the threads busier.
    max_files: usize,
}

impl<J: Request> RequestList<J> {
    /// Creates an empty list for at most `capacity` outstanding jobs, of which at most `max_files` read files.
    pub fn new(capacity: usize, max_files: usize) -> Self {
        Self {
            state: Mutex::new(ListState::new(capacity)),
            file_bell: Condvar::new(),
            #[cfg(feature = "http")]
            http_bell: tokio::sync::Notify::new(),
            capacity,
            max_files,
        }
    }

    /// Returns the number of outstanding jobs that is never exceeded.
    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// Locks the list. After a panic of another thread the list is still usable: it is plain data.
    pub fn lock(&self) -> MutexGuard<'_, ListState<J>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Unlocks the list and wakes the threads that have something to take or to abort. Wakes one file thread, which wakes
    /// the next: each wake-up costs the calling thread up to 100 microseconds on a virtual machine.
    pub fn ring(&self, state: MutexGuard<'_, ListState<J>>) {
        let is_closed = state.is_closed;
        let has_file = state.has_file(self.max_files);
        #[cfg(feature = "http")]
        let has_http = is_closed || state.waiting.has_remote() || !state.abort.is_empty();
        drop(state);
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

    /// Wakes the threads as [`Self::ring`] does, for what was written before.
    pub fn ring_if_due(&self) {
        self.ring(self.lock());
    }

    /// Ends all threads that take from the list.
    pub fn close(&self) {
        let mut state = self.lock();
        state.is_closed = true;
        self.ring(state);
    }

    /// Takes the next file to read; blocks until there is one. Returns `None` once the list is closed.
    pub fn take_file(&self) -> Option<J> {
        let mut state = self.lock();
        loop {
            if state.is_closed {
                return None;
            }
            if let Some(job) = state.take_file(self.max_files) {
                if state.has_file(self.max_files) {
                    self.file_bell.notify_one();
                }
                return Some(job);
            }
            state = self.file_bell.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

impl<J: Request> RequestList<J> {
    /// Takes the next file to read if there is one, the limits allow it, and the list is open.
    pub fn try_take_file(&self) -> Option<J> {
        let mut state = self.lock();
        if state.is_closed { None } else { state.take_file(self.max_files) }
    }
}

#[cfg(feature = "http")]
impl<J: Request> RequestList<J> {
    /// Waits until there may be work for the HTTP thread.
    pub async fn http_rung(&self) {
        self.http_bell.notified().await;
    }

    /// Takes what the HTTP thread should do next while `in_flight` are running: of each server up to its limit, and at
    /// most `max_in_flight` in all. Returns `None` once the list is closed.
    pub fn take_http<'a>(
        &self,
        in_flight: impl Iterator<Item = &'a J>,
        limits: &ServerLimits,
        max_in_flight: usize,
    ) -> Option<HttpWork<J>>
    where
        J: 'a,
    {
        let (mut at_servers, mut running) = (InFlight::default(), 0);
        for job in in_flight {
            running += 1;
            at_servers.add(job);
        }
        let mut state = self.lock();
        if state.is_closed {
            return None;
        }
        let mut jobs: Vec<J> = Vec::new();
        while running + jobs.len() < max_in_flight {
            let (usage, left) = (state.usage, max_in_flight - running - jobs.len());
            let may_take = |servers: &[String], is_prefetch: bool| {
                let has_slot = |at: &String| {
                    let count = at_servers.count(at);
                    count < limits.limit(at) && limits.leaves_enough(count, left)
                };
                // The class of the job and the limits of the budgets count at the content's own server.
                let fits = |own: &String| usage.may_take(is_prefetch, at_servers.count(own), limits.limit(own));
                servers.first().is_some_and(fits) && servers.iter().all(has_slot)
            };
            let Some(job) = state.waiting.take(Source::Servers, usage.limits.aged_before, may_take) else { break };
            state.took(&job);
            at_servers.add(&job);
            jobs.push(job);
        }
        Some(HttpWork { jobs, aborts: std::mem::take(&mut state.abort) })
    }
}

#[cfg(test)]
impl<J: Request> ListState<J> {
    /// Takes a job as the HTTP thread does, for tests.
    pub fn take_for_test(&mut self, job: &J) {
        self.took(job);
    }

    /// Returns the jobs that wait, in no order, for tests.
    pub fn waiting_for_test(&self) -> impl Iterator<Item = &J> {
        self.waiting.iter()
    }

    /// Takes a file, for tests.
    pub fn take_file_for_test(&mut self, max_files: usize) -> Option<J> {
        self.take_file(max_files)
    }

    /// Takes files as if the budgets allowed any number of them, for tests.
    pub fn take_files_for_test(&mut self, count: usize) -> Vec<J> {
        let outstanding = std::mem::replace(&mut self.usage.limits.outstanding, usize::MAX);
        let taken = (0..count).filter_map(|_| self.take_file(usize::MAX)).collect();
        self.usage.limits.outstanding = outstanding;
        taken
    }
}
