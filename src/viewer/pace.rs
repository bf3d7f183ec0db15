//! [`Pace`]: when the next frame of a window's loop comes: at once, at a rate, or when it is needed. Main thread.

use std::time::{Duration, Instant};

use winit::event::StartCause;
use winit::event_loop::{ActiveEventLoop, ControlFlow};

/// While nothing moves, a loop that draws on demand looks so often whether something came from elsewhere.
const IDLE_POLL: Duration = Duration::from_millis(30);
/// And draws a frame so often nevertheless.
const IDLE_FRAME: Duration = Duration::from_secs(1);

/// How a loop draws, and when it did last.
pub(super) struct Pace {
    on_demand: bool,
    /// Frames a second at most.
    max_rate: Option<f64>,
    last_frame: Instant,
    /// The last frame is over since.
    idle_since: Instant,
}

impl Pace {
    pub fn new(on_demand: bool, max_rate: Option<f64>) -> Self {
        let max_rate = max_rate.filter(|rate| *rate > 0.0);
        let now = Instant::now();
        Self { on_demand, max_rate, last_frame: now, idle_since: now }
    }

    /// Draws only what is asked for.
    pub fn is_on_demand(&self) -> bool {
        self.on_demand
    }

    /// A frame begins.
    pub fn begin_frame(&mut self) {
        self.last_frame = Instant::now();
    }

    /// Until when no other frame may begin; `None` where it may at once.
    pub fn next_frame_at(&self) -> Option<Instant> {
        // A rate of less than one a second would keep events waiting.
        self.max_rate.map(|rate| self.last_frame + Duration::from_secs_f64(1.0 / rate.max(1.0)))
    }

    /// Frames follow each other, and none was asked for in a while: window systems ask hidden windows for none.
    pub fn is_overdue(&self) -> bool {
        !self.on_demand && self.idle_since.elapsed() > IDLE_FRAME
    }

    /// After a frame: true where the next one is wanted at once.
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

    /// When the loop wakes: true where it is for a frame.
    pub fn wakes_for_frame(&self, cause: StartCause, needs_frame: impl FnOnce() -> bool) -> bool {
        let is_time = matches!(cause, StartCause::ResumeTimeReached { .. });
        is_time && (self.last_frame.elapsed() > IDLE_FRAME || needs_frame())
    }

    /// When all events are seen: sleeps where nothing is to be drawn.
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
    fn a_rate_is_a_time_between_frames_and_nonsense_is_none() {
        let gap = |rate| {
            let pace = Pace::new(false, rate);
            pace.next_frame_at().map(|at| at - pace.last_frame)
        };
        assert_eq!(gap(Some(50.0)), Some(Duration::from_millis(20)));
        assert_eq!(gap(Some(0.01)), Some(Duration::from_secs(1)), "events wait no longer");
        for none in [None, Some(0.0), Some(-5.0), Some(f64::NAN)] {
            assert_eq!(gap(none), None, "{none:?}");
        }
        assert_eq!(gap(Some(f64::INFINITY)), Some(Duration::ZERO));
    }

    #[test]
    fn where_none_is_asked_for_a_frame_is_overdue_after_a_second() {
        for (on_demand, ago, is_overdue) in [(false, 0, false), (false, 1, true), (true, 1, false)] {
            let mut pace = Pace::new(on_demand, None);
            pace.idle_since -= ago * (IDLE_FRAME + Duration::from_millis(1));
            assert_eq!(pace.is_overdue(), is_overdue, "{on_demand} {ago}");
        }
    }

    #[test]
    fn at_rest_a_frame_comes_when_it_is_needed_and_once_a_second() {
        let mut pace = Pace::new(true, None);
        let now = Instant::now();
        let due = StartCause::ResumeTimeReached { start: now, requested_resume: now };
        assert!(!pace.wakes_for_frame(due, || false) && pace.wakes_for_frame(due, || true));
        assert!(!pace.wakes_for_frame(StartCause::Poll, || true), "not by every event");
        pace.last_frame = now - IDLE_FRAME - Duration::from_millis(1);
        assert!(pace.wakes_for_frame(due, || false));
        pace.begin_frame();
        assert!(!pace.wakes_for_frame(due, || false));
    }
}
