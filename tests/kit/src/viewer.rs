//! Offscreen viewers, and frames until everything is loaded.

use std::time::{Duration, Instant};

use terrane::viewer::{CompositeViewer, Viewer, ViewerConfig};

use crate::skip::or_skip;

pub fn offscreen(config: &ViewerConfig) -> Option<Viewer> {
    or_skip(Viewer::new_offscreen(config))
}

/// Longer than anything takes.
const PATIENCE: Duration = Duration::from_secs(120);

/// Viewers that draw until nothing is missing: uploads take as many frames as the machine makes of them.
pub trait Settle {
    /// Draws a frame; true where nothing is missing after it.
    fn draw(&mut self) -> bool;

    /// Draws so many frames at least.
    fn settle(&mut self, least: usize) {
        let start = Instant::now();
        let mut frames = 1;
        while !self.draw() || frames < least {
            frames += 1;
            assert!(start.elapsed() < PATIENCE, "does not settle");
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
