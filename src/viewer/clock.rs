//! [`FrameTimer`]: numbers the frames and measures the time between them; and [`ReferenceClock`], which events share with
//! it. Main thread.

use std::sync::{Arc, OnceLock};
use std::time::Instant;

use crate::draw::FrameClock;

/// Number and times of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameStamp {
    /// The number of the frame; the first frame is 1.
    pub frame: u32,
    /// Seconds of the wall clock since the first frame.
    pub reference_time_s: f64,
    /// Seconds in the application's time.
    pub simulation_time_s: f64,
}

/// The clock of [`FrameStamp::reference_time_s`]. Clones show the same time.
#[derive(Clone, Debug, Default)]
pub(in crate::viewer) struct ReferenceClock {
    /// The start of the first frame.
    start: Arc<OnceLock<Instant>>,
}

impl ReferenceClock {
    /// Creates a clock that runs already.
    pub(in crate::viewer) fn started() -> Self {
        let clock = Self::default();
        clock.start_at(Instant::now());
        clock
    }

    /// Starts the clock unless it runs, and returns its start.
    fn start_at(&self, now: Instant) -> Instant {
        *self.start.get_or_init(|| now)
    }

    /// Seconds since the start; 0 before it.
    pub(in crate::viewer) fn seconds(&self) -> f64 {
        self.start.get().map_or(0.0, |start| start.elapsed().as_secs_f64())
    }

    /// Seconds from the start to a time; `None` before the start.
    fn seconds_at(&self, time: Instant) -> Option<f64> {
        self.start.get().map(|start| time.saturating_duration_since(*start).as_secs_f64())
    }
}

/// The clock of the frame loop.
#[derive(Debug, Default)]
pub(in crate::viewer) struct FrameTimer {
    clock: ReferenceClock,
    last_frame: Option<Instant>,
    stamp: FrameStamp,
    /// Seconds between the last two frames.
    delta_s: f64,
}

impl FrameTimer {
    pub(in crate::viewer) fn stamp(&self) -> FrameStamp {
        self.stamp
    }

    /// Seconds since the first frame began; 0 before it.
    pub(in crate::viewer) fn seconds(&self) -> f64 {
        self.clock.seconds()
    }

    /// Seconds from the first frame to a time; `None` before the first frame.
    pub(in crate::viewer) fn seconds_at(&self, time: Instant) -> Option<f64> {
        self.clock.seconds_at(time)
    }

    /// Returns the clock of the reference time, for events.
    pub(in crate::viewer) fn clock(&self) -> &ReferenceClock {
        &self.clock
    }

    /// Begins the next frame and returns the seconds since the one before, 0 for the first.
    pub(super) fn advance(&mut self, now: Instant, simulation_time_s: f64) -> f64 {
        let first = self.clock.start_at(now);
        self.delta_s = self.last_frame.map_or(0.0, |last| (now - last).as_secs_f64());
        self.last_frame = Some(now);
        self.stamp = FrameStamp {
            frame: self.stamp.frame + 1,
            reference_time_s: (now - first).as_secs_f64(),
            simulation_time_s,
        };
        self.delta_s
    }

    /// Returns the times that shader programs see.
    pub(super) fn shader_clock(&self) -> FrameClock {
        FrameClock {
            reference_time_s: self.stamp.reference_time_s,
            delta_s: self.delta_s,
            simulation_time_s: self.stamp.simulation_time_s,
        }
    }
}
