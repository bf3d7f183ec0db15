//! Stand-ins for the scene, cull, renderer and device around the library's own hand-over of stages. Each checks that it
//! has the frame that it should have at that moment.

pub mod cull;
pub mod draw;
pub mod gpu;
pub mod pager;

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// The stage in which draw reads data that update changes between frames.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Reads {
    Nothing,
    /// In all stages of a frame.
    InTheFrame,
    /// In callbacks of the stage.
    InCallbacks,
}

/// A thread that panics.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Panics {
    Never,
    /// While it culls a camera in a frame.
    InCull {
        camera: u32,
        frame: u32,
    },
    /// While it draws a camera in a frame.
    InDraw {
        camera: u32,
        frame: u32,
    },
}

/// The record of what a viewer's threads do.
pub struct Seen {
    pub reads: Reads,
    pub panics: Panics,
    /// Cameras of all contexts.
    pub cameras: usize,
    /// The data that update changes: its frame number.
    pub changed: AtomicU32,
    /// Cameras and frames, in the order drawn.
    drawn: Mutex<Vec<(u32, u32)>>,
    /// Cameras and frames that are being drawn.
    drawing: Mutex<Vec<(u32, u32)>>,
    /// In some schedule a camera was culled while an earlier frame of it was drawn.
    pub overlapped: Arc<AtomicBool>,
    /// Threads end, and let others continue, which do not show their frame together.
    pub is_ending: AtomicBool,
}

impl Seen {
    pub fn new(reads: Reads, panics: Panics, cameras: usize, overlapped: &Arc<AtomicBool>) -> Self {
        Self {
            reads,
            panics,
            cameras,
            changed: AtomicU32::new(0),
            drawn: Mutex::default(),
            drawing: Mutex::default(),
            overlapped: overlapped.clone(),
            is_ending: AtomicBool::new(panics != Panics::Never),
        }
    }

    /// Frames of a camera in the order drawn.
    pub fn drawn(&self, camera: u32) -> Vec<u32> {
        let drawn = self.drawn.lock().unwrap_or_else(PoisonError::into_inner);
        drawn.iter().filter(|(of, _)| *of == camera).map(|(_, frame)| *frame).collect()
    }

    /// Cameras that were drawn in a frame.
    fn drawn_in(&self, frame: u32) -> usize {
        self.drawn.lock().unwrap_or_else(PoisonError::into_inner).iter().filter(|(_, f)| *f == frame).count()
    }

    fn draws(&self, camera: u32, frame: u32) {
        self.drawing.lock().unwrap_or_else(PoisonError::into_inner).push((camera, frame));
    }

    fn has_drawn(&self, camera: u32, frame: u32) {
        self.drawing.lock().unwrap_or_else(PoisonError::into_inner).retain(|drawn| *drawn != (camera, frame));
        self.drawn.lock().unwrap_or_else(PoisonError::into_inner).push((camera, frame));
    }

    fn culls(&self, camera: u32, frame: u32) {
        let drawing = self.drawing.lock().unwrap_or_else(PoisonError::into_inner);
        if drawing.iter().any(|(of, earlier)| *of == camera && *earlier < frame) {
            self.overlapped.store(true, Ordering::Relaxed);
        }
    }
}

/// Changed by update, which is alone with it then.
pub struct Scene {
    pub frame: u32,
    pub seen: Arc<Seen>,
}
