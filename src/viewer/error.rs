//! [`ViewerError`]: the reasons for which a viewer cannot be made or cannot draw a frame.

use super::ids::{ContextId, SceneId, ViewId};

/// A window arrangement that is invalid: names the file or variable, the field and the reason.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{source_name}: {field}{}{reason}", if field.is_empty() { "" } else { ": " })]
pub struct ArrangementError {
    /// The file or the environment variable.
    pub source_name: String,
    /// The path of the field, such as `windows[1].size_px`; empty when the error concerns the whole source.
    pub field: String,
    /// Why the value is invalid.
    pub reason: String,
}

/// The reason for which a viewer could not be made, changed or drawn.
#[derive(Debug, thiserror::Error)]
pub enum ViewerError {
    /// The graphics context or a draw failed.
    #[error(transparent)]
    Gpu(#[from] crate::gpu::GpuError),
    /// The root could not be read.
    #[error(transparent)]
    Io(#[from] crate::fetch::IoError),
    /// The pager could not start.
    #[error(transparent)]
    Pager(#[from] crate::pager::PagerError),
    /// A thread could not be started.
    #[error("cannot start a thread: {0}")]
    Thread(std::io::Error),
    /// A setting or an environment variable has a value that cannot be used.
    #[error("{0}")]
    Setting(String),
    /// The arrangement of windows is invalid.
    #[error(transparent)]
    Arrangement(#[from] ArrangementError),
    /// The number of open contexts has reached the configured limit.
    #[error("{limit} contexts are open, and ViewerConfig::max_contexts allows no more")]
    TooManyContexts {
        /// [`ViewerConfig::max_contexts`](super::ViewerConfig::max_contexts).
        limit: usize,
    },
    /// The viewer has no such context; it may have been closed.
    #[error("the viewer has no context {}", .0.0)]
    NoContext(ContextId),
    /// The viewer has as many scenes as it can hold.
    #[error("a viewer has {limit} scenes at most")]
    TooManyScenes {
        /// The largest number of scenes.
        limit: usize,
    },
    /// The viewer has no such scene; it may have been removed.
    #[error("the viewer has no such scene: {0:?}")]
    NoScene(SceneId),
    /// The scene cannot be removed while views show it.
    #[error("{scene:?} is shown by {views} views; remove them first")]
    SceneInUse {
        /// The scene.
        scene: SceneId,
        /// The number of views that show it.
        views: usize,
    },
    /// The viewer has no such view; it may have been removed.
    #[error("the viewer has no such view: {0:?}")]
    NoView(ViewId),
    /// The view is a [`Viewer`](super::Viewer)'s own, which lives as long as the viewer.
    #[error("{0:?} is the viewer's own view and cannot be removed")]
    OwnView(ViewId),
    /// The scene shows a tile set already, and its pager may read the files of that set only.
    #[error("the scene shows {uri} already; remove its root first, or load into another scene")]
    HasTileset {
        /// The root that was loaded.
        uri: String,
    },
    /// A thread that draws or culls has ended early, for example by a panic.
    #[error("the draw thread has stopped")]
    DrawThreadStopped,
    /// The window system gave no image to draw into, so the window cannot be read back.
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
        /// The display, with the variable that names it.
        display: String,
        /// The window system's reason.
        reason: String,
    },
    /// A window cannot open inside a window of another toolkit.
    #[error("no window opens in a window of {system}: {reason}")]
    ParentWindow {
        /// The window system of the parent.
        system: &'static str,
        /// The reason.
        reason: String,
    },
    /// The window system refused a request.
    #[error("window: {0}")]
    Window(String),
}
