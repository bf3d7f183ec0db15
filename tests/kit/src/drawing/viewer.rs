//! Offscreen viewers that draw until everything is loaded.

use std::time::{Duration, Instant};

use terrane::viewer::{CompositeViewer, Viewer, ViewerConfig};

use crate::skip::or_skip;

/// Creates an offscreen viewer; returns `None`, and skips the test, if there is no adapter.
pub fn offscreen(config: &ViewerConfig) -> Option<Viewer> {
    or_skip(Viewer::new_offscreen(config))
}

/// The time after which a viewer that has not settled fails its test.
const SETTLE_TIMEOUT: Duration = Duration::from_secs(120);
/// The longest time between two frames of a viewer that loads. Each frame takes time that loading needs.
const LOAD_TIME: Duration = Duration::from_millis(10);

/// Viewers that draw until everything is loaded. The number of frames depends on the machine.
pub trait Settle {
    /// Draws a frame; returns true if nothing is missing after it.
    fn draw(&mut self) -> bool;

    /// Loads until a time, or until all that was requested has arrived.
    fn load_until(&mut self, end: Instant);

    /// Draws until nothing is missing, and at least `min_frames` frames; panics after two minutes.
    fn settle(&mut self, min_frames: usize) {
        let start = Instant::now();
        let mut frames = 1;
        while !self.draw() || frames < min_frames {
            frames += 1;
            self.load_until(Instant::now() + LOAD_TIME);
            assert!(start.elapsed() < SETTLE_TIMEOUT, "the viewer does not settle within two minutes");
        }
    }
}

impl Settle for Viewer {
    fn draw(&mut self) -> bool {
        self.frame().unwrap();
        self.is_settled()
    }

    fn load_until(&mut self, end: Instant) {
        self.work_until(end);
    }
}

impl Settle for CompositeViewer {
    fn draw(&mut self) -> bool {
        self.frame().unwrap();
        self.is_settled()
    }

    fn load_until(&mut self, end: Instant) {
        self.work_until(end);
    }
}
