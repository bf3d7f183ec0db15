//! [`QueryAnswers`]: decides whether a viewer that draws on demand waits for results of occlusion queries. Main thread.

/// Results that have not arrived this many frames after a change are not awaited: hidden windows draw nothing and so
/// never answer.
const MAX_AWAITED_FRAMES: u32 = 60;

/// The age of the results that the last frame used.
#[derive(Debug, Default)]
pub(in crate::viewer) struct QueryAnswers {
    /// The last frame that was drawn for another reason than to get results, or whose results changed what is hidden.
    changed_frame: u32,
    /// Age of the oldest result that the last frame used, in frames. [`u32::MAX`] means that a result changed what is
    /// hidden; see [`CullCounters::answers_age`](crate::cull::CullCounters::answers_age).
    age: u32,
}

impl QueryAnswers {
    /// Begins a frame. `has_changes` is true when something besides missing results asked for it. A frame that nothing
    /// asked for counts as a change too: the application must have had a reason.
    pub(super) fn begin_frame(&mut self, frame: u32, has_changes: bool) {
        if has_changes || !self.is_waiting(frame.saturating_sub(1)) {
            self.changed_frame = frame;
        }
    }

    /// Takes the ages that the cameras' culls of a frame reported.
    pub(super) fn end_cull(&mut self, frame: u32, ages: impl Iterator<Item = u32>) {
        self.age = ages.max().unwrap_or(0);
        if self.age == u32::MAX {
            self.changed_frame = frame;
        }
    }

    /// Returns true when a result that the last frame used is older than the last change.
    pub(super) fn is_waiting(&self, frame: u32) -> bool {
        let frames = frame.saturating_sub(self.changed_frame);
        self.age > frames && frames < MAX_AWAITED_FRAMES
    }
}
