//! [`ViewsSetup`]: several views in several windows, as a configuration file describes them.

use super::window_setup::{CameraSetup, WindowSetup};
use crate::viewer::view::set_bounds::ViewFrom;

/// A tile set that views show.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SceneSetup {
    /// The name by which views refer to the scene.
    pub name: String,
    /// Folder, file or URL of the root.
    pub source: String,
}

/// A camera of a view.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ViewCamera {
    /// Index of the window in [`ViewsSetup::windows`].
    pub window: usize,
    /// The camera's part of the window and its offsets from the master.
    pub camera: CameraSetup,
}

/// A view: a scene, a starting pose and cameras.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ViewSetup {
    /// Index of the scene in [`ViewsSetup::scenes`]. Views with `None` share one scene of the application.
    pub scene: Option<usize>,
    /// The starting pose; `None` takes the default view of the tile set.
    pub from: Option<ViewFrom>,
    /// An sRGB background colour that replaces sky and haze.
    pub background: Option<[u8; 3]>,
    /// The master, which has no offsets, and its slaves. Never empty.
    pub cameras: Vec<ViewCamera>,
}

/// Several views, their scenes and their windows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ViewsSetup {
    /// The windows; their own `cameras` are ignored, because the cameras of the views draw into them. Never empty.
    pub windows: Vec<WindowSetup>,
    /// The scenes that views may show. Each has its own pager and budgets, even when two have the same source, unless
    /// [`Self::share_pager`] is set.
    pub scenes: Vec<SceneSetup>,
    /// True when all scenes, including the application's, share one pager with one budget.
    pub share_pager: bool,
    /// The views in the order drawn. Never empty.
    pub views: Vec<ViewSetup>,
}

impl ViewsSetup {
    /// Returns true when a view shows the application's scene, which needs a root from the application.
    pub fn needs_root(&self) -> bool {
        self.views.iter().any(|view| view.scene.is_none())
    }
}
