//! A request as the update thread knows it: how urgent it is, and how far it is.

use std::time::Instant;

use super::retry_policy::RetryState;
use crate::cull::PageRequest;
use crate::pager::loading::page_job::PageJob;
use crate::pager::loading::waiting_jobs::Urgency;
use crate::pager::residency::budget::MemoryUse;
use crate::scene::PagingOptions;

/// A prefetch wanted within this many frames may replace pages that no frame shows, as a missing page may: making room
/// takes that long.
const SOON_FRAMES: u32 = 3;

/// How far a request is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::pager) enum Progress {
    /// In the request list.
    Waiting,
    /// A thread has it.
    Loading,
    /// Decoded: it waits for its upload or its merge; see [`Arrivals`](crate::pager::upload::Arrivals).
    Arrived,
    /// The load failed. Not requested again before this moment; `None` for never.
    Failed { retry_at: Option<Instant> },
    /// The load failed earlier, or was given up after failures. It is requested again as soon as it is wanted.
    Retryable,
}

/// A request and how far it is.
#[derive(Debug)]
pub(in crate::pager) struct Entry {
    pub job: PageJob,
    pub priority: f32,
    /// Frame in which it was first requested.
    pub first_frame: u32,
    /// Frame in which cull last requested it.
    pub wanted_frame: u32,
    /// Frames until the content is needed, as last requested; 0 where a frame lacks it now.
    pub ahead_frames: u32,
    /// When it was first requested, for the latency.
    pub since: Instant,
    pub retries: RetryState,
    /// The size of the page if it was loaded and declined: it is not loaded again before this much room is free.
    pub known_size: Option<MemoryUse>,
    pub progress: Progress,
    pub paging: PagingOptions,
    /// The urgency with which the request list has its job; `None` if it has not.
    pub listed: Option<Urgency>,
    /// The round of the table in which its difference to the list was last noted.
    pub noted_in: u64,
}

impl Entry {
    /// Returns true if the content is needed in a later frame only.
    pub fn is_prefetch(&self) -> bool {
        self.ahead_frames > 0
    }

    /// Returns true for a prefetch that is needed in one of the next frames.
    pub fn is_soon(&self) -> bool {
        (1..=SOON_FRAMES).contains(&self.ahead_frames)
    }

    /// Returns true if the last load failed and nothing is under way.
    pub fn has_failed(&self) -> bool {
        matches!(self.progress, Progress::Failed { .. } | Progress::Retryable)
    }

    /// Returns the end of the back-off if the last load failed and there will be a retry.
    pub fn retry_at(&self) -> Option<Instant> {
        if let Progress::Failed { retry_at } = self.progress { retry_at } else { None }
    }

    /// Returns true if the last load failed and there will be a retry.
    pub fn will_retry(&self) -> bool {
        self.retry_at().is_some()
    }

    /// Returns true if the last load failed and its back-off is over.
    pub fn is_due(&self, now: Instant) -> bool {
        self.retry_at().is_some_and(|at| at <= now)
    }

    /// Ends a request that is no longer wanted. Returns true if the entry must be kept: its count of failures is
    /// remembered, so that a later request does not repeat them all.
    pub fn end_unwanted(&mut self) -> bool {
        self.progress = Progress::Retryable;
        !self.retries.is_fresh()
    }

    /// Returns how urgent it is.
    pub fn urgency(&self) -> Urgency {
        Urgency::new(self.priority, self.is_prefetch())
    }

    /// Renews it with a request of this frame. Of several requests in a frame the most urgent counts.
    pub fn renew(&mut self, request: &PageRequest, frame: u32) {
        let priority = self.paging.priority(request.priority);
        if self.wanted_frame == frame {
            self.priority = self.priority.max(priority);
            self.ahead_frames = self.ahead_frames.min(request.ahead_frames);
        } else {
            self.priority = priority;
            self.ahead_frames = request.ahead_frames;
            self.wanted_frame = frame;
        }
    }
}
