//! A request as the main thread knows it: how urgent it is, and what became of it.

use std::sync::Arc;
use std::time::Instant;

use super::job::Job;
use super::shares::Held;
use super::tries::Tries;
use crate::scene::{DrawKind, Drawable, Page, PagingOptions};

/// What is wanted in so many frames takes the place of what no picture shows any more, as what is missing in one does: it
/// would make room for it by then.
const SOON_FRAMES: u32 = 3;

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
    /// Not to be asked for before this moment.
    Failed {
        retry_at: Option<Instant>,
    },
    /// It failed and may be asked for again, by whoever wants it.
    Resting,
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

    /// Nothing is asked for: it failed before.
    pub fn has_failed(&self) -> bool {
        matches!(self.progress, Progress::Failed { .. } | Progress::Resting)
    }

    /// It failed, in passing.
    pub fn will_be_tried(&self) -> bool {
        matches!(self.progress, Progress::Failed { retry_at: Some(_) })
    }

    /// It failed, and has waited long enough.
    pub fn is_due(&self, now: Instant) -> bool {
        matches!(self.progress, Progress::Failed { retry_at: Some(at) } if at <= now)
    }

    /// Nobody wants it any longer. False where it can be forgotten: tries that failed are not, so that whoever comes back
    /// does not make them again.
    pub fn rests(&mut self) -> bool {
        self.progress = Progress::Resting;
        !self.tries.is_none()
    }
}
