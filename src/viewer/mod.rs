//! The viewer: runs the frame and owns what it needs. The only room that knows winit and egui.
//!
//! [`Viewer::frame`] is advance, event, update and rendering; see `base.rs` for who may touch the scene when and
//! `rendering` for who culls and draws. Everything here runs on the main thread, except what `rendering` sends away.

mod base;
mod camera;
mod camera_path;
mod composite;
mod config;
mod contexts;
#[cfg(feature = "window")]
mod display;
mod events;
pub mod handlers;
mod home;
mod input;
mod look_ahead;
pub mod manipulators;
#[cfg(feature = "window")]
mod overlay;
#[cfg(feature = "window")]
mod pace;
mod paged_scene;
#[cfg(feature = "window")]
mod parent;
mod pick;
mod rendering;
mod report;
mod scene_pager;
mod settled;
mod stats;
mod view;
#[expect(clippy::module_inception, reason = "the viewer's own file; the others are its parts")]
mod viewer;
mod viewport;
mod views_setup;
#[cfg(feature = "window")]
mod views_window;
#[cfg(feature = "window")]
mod window;
#[cfg(feature = "window")]
mod window_events;
#[cfg(feature = "window")]
mod window_open;

pub use camera::{Camera, FieldOfView, ResizePolicy, world_from_eye};
pub use camera_path::{AnimationPath, ControlPoint, LoopMode, PathError};
pub use composite::{CompositeViewer, SceneId, ViewId};
pub use config::{
    Arrangement, ArrangementError, CONFIG_FILE_VARIABLE, CameraSetup, DisplaySettingError, DisplaySettings,
    DisplayType, SCREEN_VARIABLE, SceneSetup, ViewCamera, ViewSetup, ViewsSetup, WINDOW_VARIABLE, WindowSetup,
};
#[cfg(feature = "window")]
pub use display::has_display;
pub use events::{
    Bindings, ButtonMask, EventKind, EventMask, EventQueue, GuiEventAdapter, GuiEventHandler, InputState, Key,
    Modifiers, MouseButton, TouchPhase, Usage, UserEvent, UserEvents, YOrientation,
};
pub use home::{LoadedRoot, LocalFrame, SetBounds, ViewFrom, environment_for};
pub use input::{
    GuiActionAdapter, OnPicture, WindowCommand, WindowMatrix, WindowRay, camera_with_focus, event_callback,
};
pub use manipulators::{CameraManipulator, GroundHeight, ManipulatorView};
#[cfg(feature = "window")]
pub use overlay::{Overlay, OverlayPaint};
#[cfg(feature = "window")]
pub use parent::ParentWindow;
pub use rendering::{THREADING_VARIABLE, ThreadingModel};
pub use report::{
    Bytes, DrawMedians, FrameTimes, HoleCheck, Images, KEY_COLOR, Phases, Report, ReportError, Settled, Sharing, Tiles,
    Times, coverage,
};
pub use stats::{FrameStats, Samples, StatsHistory};
pub use view::{ContextId, Eyes, Slave, SlaveId, View};
pub use viewer::{FrameStamp, UpdateCallback, Viewer, ViewerConfig};
pub use viewport::Viewport;
pub use views_setup::ArrangedViews;
#[cfg(feature = "window")]
pub use views_window::{EachFrame, OnViewsOpen, ViewsOptions, run_views};
#[cfg(feature = "window")]
pub use window::{AfterFrame, BeforeFrame, OnOpen, SlaveWindow, WindowOptions, run_window};

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
    /// A variable of the environment says what it cannot.
    #[error("{0}")]
    Setting(String),
    /// The windows are not arranged so.
    #[error(transparent)]
    Arrangement(#[from] ArrangementError),
    /// The viewer has as many contexts as it may have.
    #[error("{limit} contexts are open, and ViewerConfig::max_contexts allows no more")]
    TooManyContexts {
        /// [`ViewerConfig::max_contexts`].
        limit: usize,
    },
    /// The viewer has no such context, or not any more.
    #[error("the viewer has no context {}", .0.0)]
    NoContext(ContextId),
    /// A viewer has as many scenes as there can be.
    #[error("a viewer has {limit} scenes at most")]
    TooManyScenes {
        /// How many.
        limit: usize,
    },
    /// The viewer has no such scene, or not any more.
    #[error("the viewer has no such scene: {0:?}")]
    NoScene(SceneId),
    /// A scene that is to go is shown.
    #[error("{scene:?} is shown by {views} views; remove them first")]
    SceneInUse {
        /// Which.
        scene: SceneId,
        /// How many show it.
        views: usize,
    },
    /// The viewer has no such view, or not any more.
    #[error("the viewer has no such view: {0:?}")]
    NoView(ViewId),
    /// The scene shows a tile set, whose pager would not know another's files.
    #[error("the scene shows {uri} already; remove its root first, or load into another scene")]
    HasTileset {
        /// The root that was loaded.
        uri: String,
    },
    /// A thread that draws or culls ended before it was told to.
    #[error("the draw thread has stopped")]
    DrawThreadStopped,
    /// The window system gave no image to draw a picture of a window into.
    #[error("there is no picture of the window: it is hidden, or its window system is late")]
    HiddenWindow,
    /// A callback of the application failed.
    #[error(transparent)]
    Application(Box<dyn std::error::Error + Send + Sync>),
    /// There is no display, or it cannot be reached.
    #[error(
        "{display} cannot be opened: {reason}; start it, name another, or draw offscreen (`terrane fly --offscreen`)"
    )]
    Display {
        /// Which, with the variable that names it.
        display: String,
        /// The window system's reason.
        reason: String,
    },
    /// A window cannot open in another one.
    #[error("no window opens in a window of {system}: {reason}")]
    ParentWindow {
        /// The window system of the other one.
        system: &'static str,
        /// Why not.
        reason: String,
    },
    /// The window system refused.
    #[error("window: {0}")]
    Window(String),
}
