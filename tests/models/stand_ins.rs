//! Stand-ins for the scene, cull, renderer and device around the library's own hand-over of stages. Each checks that it
//! has the expected frame.

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
    /// Draw reads it in all stages of a frame.
    InTheFrame,
    /// Draw reads it in callbacks of the stage.
    InCallbacks,
}

/// The thread that panics.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Panics {
    Never,
    /// The thread panics while it culls a camera in a frame.
    InCull {
        camera: u32,
        frame: u32,
    },
    /// The thread panics while it draws a camera in a frame.
    InDraw {
        camera: u32,
        frame: u32,
    },
}

/// The record of what a viewer's threads do.
pub struct Seen {
    pub reads: Reads,
    pub panics: Panics,
    /// The number of cameras of all contexts.
    pub cameras: usize,
    /// The data that update changes: the number of its frame.
    pub changed: AtomicU32,
    /// Cameras and frames in the order of drawing.
    drawn: Mutex<Vec<(u32, u32)>>,
    /// Cameras and frames that are being drawn.
    drawing: Mutex<Vec<(u32, u32)>>,
    /// True if a camera was culled in some schedule while an earlier frame of it was drawn.
    pub overlapped: Arc<AtomicBool>,
    /// True if threads are ending. Then others that do not show their frame together may continue.
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

    /// Returns the frames of a camera in the order of drawing.
    pub fn drawn(&self, camera: u32) -> Vec<u32> {
        let drawn = self.drawn.lock().unwrap_or_else(PoisonError::into_inner);
        drawn.iter().filter(|(of, _)| *of == camera).map(|(_, frame)| *frame).collect()
    }

    /// Returns the cameras that were drawn in a frame.
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

/// Update changes it, while no other thread has access.
pub struct Scene {
    pub frame: u32,
    pub seen: Arc<Seen>,
}
