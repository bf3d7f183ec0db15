//! Occlusion queries of nodes, and the state that cull and the draw thread exchange about them.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

/// Queries how many samples of the node's box are visible, and skips its children while there are none.
///
/// One eye makes the queries: the first that met the node, as long as it does. Another eye may see what this one does not,
/// so others always draw the children. Cameras in the graph that show the scene neither query nor use the results. A node
/// with something below that no bound culls (a light, a camera, geometry in the eye's frame) is not queried.
#[derive(Clone, Debug)]
pub struct OcclusionQueryNode {
    /// The children are hidden if fewer samples pass. Only software drivers of Vulkan count samples. Others tell whether any is
    /// visible: there a threshold above 1 acts as 1, and is reported.
    pub visibility_threshold: u32,
    /// The number of frames between two queries of the same node.
    pub query_frames: u32,
    /// The number of consecutive failed queries before the children are hidden; one that passes shows them again.
    pub failures_to_hide: u32,
    /// The results of the queries.
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
    /// The number of consecutive failed queries; written by the draw thread, read by cull.
    failures: AtomicU32,
    /// The samples of the last query; written by the draw thread.
    samples: AtomicU32,
    /// The frame of the last query; written by cull.
    queried: AtomicU32,
    /// The frame of the last query with a result; written after `failures` by the same thread.
    answered: AtomicU32,
    /// True if the last query has no result yet; written by cull, and by the draw thread after its other fields.
    is_awaited: AtomicBool,
    /// The last decision of cull.
    is_hidden: AtomicBool,
    /// The eye that makes the queries; written by cull.
    eye: AtomicU32,
}

/// Another eye takes over the queries if the last one is this number of frames old.
const IDLE_FRAMES: u32 = 120;

impl OcclusionResults {
    /// Returns the samples that passed in the last query with a result.
    pub fn samples(&self) -> u32 {
        self.samples.load(Ordering::Relaxed)
    }

    /// Returns the number of consecutive failed queries.
    pub fn failures(&self) -> u32 {
        self.failures.load(Ordering::Relaxed)
    }

    /// Returns true for the eye that makes the queries: the first that met the node, as long as it does.
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

    /// Returns true if a query is due: every `every` frames, or, while the frame number does not change, when the last query
    /// has a result. Stores the frame of the query.
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

    /// Notes that a due query could not be made: it is due again. If `shows`, hidden children are shown.
    pub(crate) fn was_not_asked(&self, shows: bool, frame: u32) {
        self.queried.store(0, Ordering::Relaxed);
        if shows {
            self.failures.store(0, Ordering::Relaxed);
            self.answered.store(frame, Ordering::Release);
        }
    }

    /// Stores the result of the query of a frame. Draw thread.
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

    /// Decides whether a frame hides the children. Also returns the age of the result in frames: the frame number while
    /// further results may hide the children, and `u32::MAX` if the decision differs from the last one. Called by cull.
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
