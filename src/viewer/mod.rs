//! The viewer: runs the frame and owns what it needs. The only room that knows winit and egui.
//!
//! [`Viewer::frame`] is advance, event, update and rendering; see `viewer.rs` for who may touch the scene when and
//! `threading.rs` for who draws. Everything here runs on the main thread, except what `threading.rs` sends away.

mod camera;
mod camera_path;
mod holes;
mod home;
mod manipulator;
#[cfg(feature = "window")]
mod overlay;
mod pick;
mod report;
mod settled;
mod stats;
mod threading;
#[expect(clippy::module_inception, reason = "the viewer's own file; the others are its parts")]
mod viewer;
#[cfg(feature = "window")]
mod window;

pub use camera::{Camera, FieldOfView, world_from_eye};
pub use camera_path::{AnimationPath, ControlPoint, LoopMode, PathError};
pub use holes::{HoleCheck, KEY_COLOR, coverage};
pub use home::{LoadedRoot, LocalFrame, SetBounds, ViewFrom, environment_for};
pub use manipulator::{CameraManipulator, Event, FlyManipulator, MoveKey};
#[cfg(feature = "window")]
pub use overlay::{Overlay, OverlayPaint};
pub use report::{Bytes, DrawMedians, FrameTimes, Phases, Report, ReportError, Settled, Tiles, Times};
pub use stats::{FrameStats, Samples, StatsHistory};
pub use threading::{ContextHandle, DrawCommand, FrameDone, FrameJob, STAGES_IN_FLIGHT, ThreadingModel};
pub use viewer::{FrameStamp, UpdateCallback, Viewer, ViewerConfig};
#[cfg(feature = "window")]
pub use window::{AfterFrame, BeforeFrame, KEYS, OnOpen, WindowOptions, has_display, run_window};

/// Why a viewer cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum ViewerError {
    /// The graphics context or a draw failed.
    #[error(transparent)]
    Gpu(#[from] crate::gpu::GpuError),
    /// The root could not be read.
    #[error(transparent)]
    Io(#[from] crate::io::IoError),
    /// The pager could not start.
    #[error(transparent)]
    Pager(#[from] crate::pager::PagerError),
    /// A thread could not be started.
    #[error("cannot start a thread: {0}")]
    Thread(std::io::Error),
    /// The draw thread ended before it was told to.
    #[error("the draw thread has stopped")]
    DrawThreadStopped,
    /// A callback of the application failed.
    #[error(transparent)]
    Application(Box<dyn std::error::Error + Send + Sync>),
    /// The window system refused.
    #[error("window: {0}")]
    Window(String),
}
