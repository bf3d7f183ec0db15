//! The viewer: runs the frame and owns what it needs. The only folder that knows winit and egui.
//!
//! [`Viewer`] shows one view of one scene; [`CompositeViewer`] shows several and does the work of both. A frame is event,
//! update, cull and draw (`frame/`). Everything here runs on the main thread, except cull and draw: `rendering/` runs them
//! on the threads of a [`ThreadingModel`].
//!
//! | folder | contents |
//! |---|---|
//! | `frame/` | the frame loop and its parts: contexts, images read back, statistics, lost devices |
//! | `view/` | [`View`]: camera, lens, viewport, stereo eyes, slaves, picking, the extent of a set |
//! | `paging/` | joins scenes with their pagers; prefetching; the blocking mode |
//! | `rendering/` | threading models: who culls and who draws, and what they wait for |
//! | `window/` | event loops of winit, parent windows, the pace of frames |
//! | `events/`, `input/`, `handlers/`, `manipulators/` | events, the event phase, actions of keys, camera motion |
//! | `config/` | display settings, and arrangements of windows and views from files and the environment |
//! | `spherical/` | domes and panoramas |
//! | `overlay/`, `report/`, `camera_path/` | egui over a view; the report of a flight; recorded camera paths |
//!
//! # Devices, contexts and windows
//!
//! A [`GraphicsContext`](crate::gpu::GraphicsContext) is a GPU device with its first target; a target is a window or an
//! offscreen texture. A viewer knows each target as a *context*, by [`ContextId`]: OSG's `GraphicsContext`. Further contexts
//! have their own device or share one.
//!
//! # A second window on a view
//!
//! - With the viewer's own event loop: [`run_window`] with [`WindowOptions::slaves`], one [`SlaveWindow`] per window.
//! - In a loop of the application: create the window, then
//!
//! ```ignore
//! let context = viewer.open_window(window, &traits)?; // or composite_mut().open_window_on(...) to share the device
//! viewer.add_slave(Slave { view_offset, ..Slave::new(context) })?;
//! ```
//! [`ViewerConfig::max_contexts`] must allow it. Several views in several windows: [`run_views`] with a [`ViewsSetup`].

mod arranged_views;
mod camera;
mod camera_path;
mod clock;
mod composite;
mod config;
mod contexts;
#[cfg(feature = "window")]
mod display;
mod error;
mod events;
mod frame;
pub mod handlers;
mod ids;
mod input;
mod intersections;
pub mod manipulators;
mod operations;
#[cfg(feature = "window")]
mod overlay;
mod paging;
mod present_view;
mod rendering;
mod report;
mod spherical;
mod view;
#[expect(clippy::module_inception, reason = "the viewer's own file; the others are its parts")]
mod viewer;
#[cfg(feature = "window")]
mod window;

pub use arranged_views::ArrangedViews;
pub use camera::{Camera, FieldOfView, ResizePolicy, world_from_eye};
pub use camera_path::{AnimationPath, ControlPoint, LoopMode, PathError};
pub use clock::FrameStamp;
pub use composite::CompositeViewer;
#[cfg(feature = "window")]
pub use config::Screen;
pub use config::{
    Arrangement, CONFIG_FILE_VARIABLE, CameraSetup, DisplaySettingError, DisplaySettings, DisplayType, SCREEN_VARIABLE,
    SceneSetup, ViewCamera, ViewSetup, ViewsSetup, WINDOW_VARIABLE, WindowSetup,
};
#[cfg(feature = "window")]
pub use display::has_display;
pub use error::{ArrangementError, ViewerError};
pub use events::{
    Bindings, ButtonMask, EventKind, EventMask, EventQueue, EventSource, GuiEventAdapter, InputState, Key, Modifiers,
    MouseButton, TouchPhase, Usage, UserEvent, UserEvents, YOrientation,
};
pub use frame::{EnvironmentChanges, FrameStats, NewStates, Samples, StatsHistory, ViewerConfig};
pub use ids::{ContextId, SceneId, SlaveId, ViewId};
pub use input::{
    GuiActionAdapter, GuiEventHandler, MouseCursor, OnPicture, ViewEvent, ViewUpdate, WindowCommand, WindowMatrix,
    WindowRay, camera_with_focus, event_callback,
};
#[cfg(feature = "window")]
pub use overlay::{Overlay, OverlayPaint};
pub use paging::{LoadedRoot, SceneUpdate};
pub use rendering::{THREADING_VARIABLE, ThreadingModel};
pub use report::{
    Bytes, DrawMedians, FrameTimes, HoleCheck, Images, KEY_COLOR, Phases, Report, ReportError, Settled, Sharing, Tiles,
    Times, coverage,
};
pub use spherical::{SphericalDisplay, SphericalProjection};
pub use view::set_bounds::{LocalFrame, SetBounds, ViewFrom, environment_for};
pub use view::viewport::ViewArea;
pub use view::{Eyes, Slave, View};
pub use viewer::Viewer;
#[cfg(feature = "window")]
pub use window::{
    AfterFrame, BeforeFrame, EachFrame, OnOpen, OnViewsOpen, ParentWindow, SlaveWindow, ViewsOptions, WindowOptions,
    run_views, run_window,
};
