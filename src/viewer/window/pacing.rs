//! [`Pacing`]: decides when a window's event loop draws its next frame: at once, at a frame rate, or on demand. Main thread.

use std::time::{Duration, Instant};

use winit::event::StartCause;
use winit::event_loop::{ActiveEventLoop, ControlFlow};

/// The interval at which an idle loop that draws on demand checks whether a frame is needed, for example because a tile has
/// arrived.
const IDLE_POLL: Duration = Duration::from_millis(30);
/// The longest time without a frame.
const IDLE_FRAME: Duration = Duration::from_secs(1);

/// The mode of a loop, and the time of its last frame.
pub(in crate::viewer) struct Pacing {
    on_demand: bool,
    /// The largest frame rate, per second.
    max_rate: Option<f64>,
    last_frame: Instant,
    /// The end of the last frame.
    idle_since: Instant,
}

impl Pacing {
    pub fn new(on_demand: bool, max_rate: Option<f64>) -> Self {
        let max_rate = max_rate.filter(|rate| *rate > 0.0);
        let now = Instant::now();
        Self { on_demand, max_rate, last_frame: now, idle_since: now }
    }

    /// Returns true when frames are drawn on demand only.
    pub fn is_on_demand(&self) -> bool {
        self.on_demand
    }

    /// Notes that a frame begins.
    pub fn begin_frame(&mut self) {
        self.last_frame = Instant::now();
    }

    /// Returns the earliest start of the next frame; `None` without a limit.
    pub fn next_frame_at(&self) -> Option<Instant> {
        // Rates below one per second would delay events.
        self.max_rate.map(|rate| self.last_frame + Duration::from_secs_f64(1.0 / rate.max(1.0)))
    }

    /// Returns true when frames should follow each other but none was requested for a while: window systems request none for
    /// hidden windows.
    pub fn is_overdue(&self) -> bool {
        !self.on_demand && self.idle_since.elapsed() > IDLE_FRAME
    }

    /// Plans the next frame after one has ended; returns true when it should begin at once.
    pub fn plan_next(&mut self, event_loop: &ActiveEventLoop, needs_frame: bool) -> bool {
        self.idle_since = Instant::now();
        let is_wanted = !self.on_demand || needs_frame;
        event_loop.set_control_flow(if is_wanted {
            ControlFlow::Poll
        } else {
            ControlFlow::WaitUntil(Instant::now() + IDLE_POLL)
        });
        is_wanted
    }

    /// Returns true when the loop woke up because a frame is due.
    pub fn wakes_for_frame(&self, cause: StartCause, needs_frame: impl FnOnce() -> bool) -> bool {
        let is_time = matches!(cause, StartCause::ResumeTimeReached { .. });
        is_time && (self.last_frame.elapsed() > IDLE_FRAME || needs_frame())
    }

    /// Sleeps after all events are handled, when no frame is due.
    pub fn rest(&self, event_loop: &ActiveEventLoop) {
        if self.on_demand && event_loop.control_flow() != ControlFlow::Poll {
            event_loop.set_control_flow(ControlFlow::WaitUntil(Instant::now() + IDLE_POLL));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rate_gives_the_time_between_frames_and_invalid_rates_no_limit() {
        let gap = |rate| {
            let pace = Pacing::new(false, rate);
            pace.next_frame_at().map(|at| at - pace.last_frame)
        };
        assert_eq!(gap(Some(50.0)), Some(Duration::from_millis(20)));
        assert_eq!(gap(Some(0.01)), Some(Duration::from_secs(1)), "events are not delayed for longer");
        for none in [None, Some(0.0), Some(-5.0), Some(f64::NAN)] {
            assert_eq!(gap(none), None, "{none:?}");
        }
        assert_eq!(gap(Some(f64::INFINITY)), Some(Duration::ZERO));
    }

    #[test]
    fn frame_is_overdue_after_a_second_without_requests() {
        for (on_demand, ago, is_overdue) in [(false, 0, false), (false, 1, true), (true, 1, false)] {
            let mut pace = Pacing::new(on_demand, None);
            pace.idle_since -= ago * (IDLE_FRAME + Duration::from_millis(1));
            assert_eq!(pace.is_overdue(), is_overdue, "{on_demand} {ago}");
        }
    }

    #[test]
    fn idle_loop_draws_when_needed_and_once_a_second() {
        let mut pace = Pacing::new(true, None);
        let now = Instant::now();
        let due = StartCause::ResumeTimeReached { start: now, requested_resume: now };
        assert!(!pace.wakes_for_frame(due, || false) && pace.wakes_for_frame(due, || true));
        assert!(!pace.wakes_for_frame(StartCause::Poll, || true), "other events do not count");
        pace.last_frame = now - IDLE_FRAME - Duration::from_millis(1);
        assert!(pace.wakes_for_frame(due, || false));
        pace.begin_frame();
        assert!(!pace.wakes_for_frame(due, || false));
    }
}
