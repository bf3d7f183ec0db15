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

/// Viewers that draw until everything is loaded. The number of frames depends on the machine.
pub trait Settle {
    /// Draws a frame; returns true if nothing is missing after it.
    fn draw(&mut self) -> bool;

    /// Draws until nothing is missing, and at least `min_frames` frames; panics after two minutes.
    fn settle(&mut self, min_frames: usize) {
        let start = Instant::now();
        let mut frames = 1;
        while !self.draw() || frames < min_frames {
            frames += 1;
            assert!(start.elapsed() < SETTLE_TIMEOUT, "the viewer does not settle within two minutes");
        }
    }
}

impl Settle for Viewer {
    fn draw(&mut self) -> bool {
        self.frame().unwrap();
        self.is_settled()
    }
}

impl Settle for CompositeViewer {
    fn draw(&mut self) -> bool {
        self.frame().unwrap();
        self.is_settled()
    }
}
