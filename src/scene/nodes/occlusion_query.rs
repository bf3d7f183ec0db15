//! Occlusion queries of nodes, and the state that cull and the draw thread exchange about them.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

/// Asks the adapter how many samples of its box are seen, and skips its children while none are. One eye asks, the first
/// that met the node and still does: what it does not see another may, so that others draw what is below. Cameras in the
/// graph that show the scene neither ask nor heed what is answered. A node below which something is culled by no bound (a
/// light, a camera, what is in the eye's frame) asks nothing and hides nothing.
#[derive(Clone, Debug)]
pub struct OcclusionQueryNode {
    /// Hidden when fewer samples pass.
    pub visibility_threshold: u32,
    /// Frames between two queries of the same node.
    pub query_frames: u32,
    /// Queries in a row that must fail before it is hidden; one that passes shows it again.
    pub failures_to_hide: u32,
    /// What the queries found.
    pub results: Arc<OcclusionResults>,
}

impl Default for OcclusionQueryNode {
    fn default() -> Self {
        Self { visibility_threshold: 1, query_frames: 2, failures_to_hide: 2, results: Arc::default() }
    }
}

/// Results of an [`OcclusionQueryNode`].
#[derive(Debug, Default)]
pub struct OcclusionResults {
    /// Failed queries in a row; written by the draw thread, read by cull.
    failures: AtomicU32,
    /// Samples of the last query; written by the draw thread.
    samples: AtomicU32,
    /// Frame of the last query; written by cull.
    queried: AtomicU32,
    /// Frame of the last query that was answered; written after `failures` by whoever writes that.
    answered: AtomicU32,
    /// The last query was not answered yet; written by cull, and by the draw thread after all that it writes.
    is_awaited: AtomicBool,
    /// What cull last decided.
    is_hidden: AtomicBool,
    /// The eye that asks; written by cull.
    eye: AtomicU32,
}

/// An eye that has not asked for so many frames asks no more.
const IDLE_FRAMES: u32 = 120;

impl OcclusionResults {
    /// Samples that passed in the last query that has arrived.
    pub fn samples(&self) -> u32 {
        self.samples.load(Ordering::Relaxed)
    }

    /// Failed queries in a row.
    pub fn failures(&self) -> u32 {
        self.failures.load(Ordering::Relaxed)
    }

    /// True for the eye that asks: the first that met the node, as long as it does. Others draw what is below.
    pub(crate) fn are_of(&self, eye: u32, frame: u32) -> bool {
        let asking = self.eye.load(Ordering::Relaxed);
        if asking == eye {
            return true;
        }
        let is_idle = frame.abs_diff(self.queried.load(Ordering::Relaxed)) > IDLE_FRAMES;
        if asking == 0 || is_idle {
            self.eye.store(eye, Ordering::Relaxed);
            self.failures.store(0, Ordering::Relaxed);
        }
        asking == 0 || is_idle
    }

    /// True once every so many frames, and where frames stand still once the last query was answered; notes the frame.
    pub(crate) fn is_due(&self, frame: u32, every: u32) -> bool {
        let last = self.queried.load(Ordering::Relaxed);
        let is_answered_still = last == frame && !self.is_awaited.load(Ordering::Acquire);
        let due = last == 0 || frame.wrapping_sub(last) >= every.max(1) || is_answered_still;
        if due {
            self.is_awaited.store(true, Ordering::Relaxed);
            self.queried.store(frame.max(1), Ordering::Relaxed);
        }
        due
    }

    /// A query that was due could not be made: it is due again, and what was hidden shows, if need be.
    pub(crate) fn was_not_asked(&self, shows: bool, frame: u32) {
        self.queried.store(0, Ordering::Relaxed);
        if shows {
            self.failures.store(0, Ordering::Relaxed);
            self.answered.store(frame, Ordering::Release);
        }
    }

    /// The answer to a query of a frame, from the draw thread.
    pub(crate) fn answered(&self, samples: u64, threshold: u32, frame: u32) {
        self.samples.store(u32::try_from(samples).unwrap_or(u32::MAX), Ordering::Relaxed);
        if samples >= u64::from(threshold) {
            self.failures.store(0, Ordering::Relaxed);
        } else {
            self.failures.fetch_add(1, Ordering::Relaxed);
        }
        self.answered.store(frame, Ordering::Release);
        self.is_awaited.store(false, Ordering::Release);
    }

    /// Whether a frame leaves out what is below, and how many frames ago that was asked; all of them while more answers
    /// may hide it, and `u32::MAX` where the frame before had it otherwise. Cull.
    pub(crate) fn decide(&self, frame: u32, failures_to_hide: u32) -> (bool, u32) {
        let answered = self.answered.load(Ordering::Acquire);
        let failures = self.failures();
        let is_hidden = failures >= failures_to_hide;
        let age = match self.is_hidden.swap(is_hidden, Ordering::Relaxed) {
            was_hidden if was_hidden != is_hidden => u32::MAX,
            _ if !is_hidden && failures > 0 => frame,
            _ => frame.saturating_sub(answered),
        };
        (is_hidden, age)
    }
}
