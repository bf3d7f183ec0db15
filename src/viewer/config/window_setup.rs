//! [`WindowSetup`] and [`CameraSetup`]: a window to open and the cameras that draw into it.

use glam::{DAffine3, DMat4};

use crate::gpu::ContextTraits;
use crate::viewer::camera::ResizePolicy;
use crate::viewer::frame::ViewerConfig;
use crate::viewer::ids::ContextId;
use crate::viewer::view::viewport::ViewArea;
use crate::viewer::view::{Eyes, Slave};

/// The longest side that a window or a viewport may have, pixels.
pub(super) const MAX_SIDE_PX: u32 = 16_384;

/// A camera in a window.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraSetup {
    /// The part of the window that the camera draws into.
    pub viewport: ViewArea,
    /// How the master's angle of view follows the shape of its viewport; with `None` the angle of the longer side stays
    /// fixed. Slaves ignore it, because their images are parts of the master's.
    pub resize: Option<ResizePolicy>,
    /// The slave's projection relative to the master's; see
    /// [`Slave::projection_offset`](crate::viewer::Slave::projection_offset).
    pub projection_offset: DMat4,
    /// The slave's pose relative to the master's; see [`Slave::view_offset`](crate::viewer::Slave::view_offset).
    pub view_offset: DAffine3,
    /// The eyes that the camera draws for while the view is in stereo.
    pub eyes: Eyes,
}

impl Default for CameraSetup {
    /// Creates a camera that shows what the master sees and fills its window.
    fn default() -> Self {
        Self {
            viewport: ViewArea::Whole,
            resize: None,
            projection_offset: DMat4::IDENTITY,
            view_offset: DAffine3::IDENTITY,
            eyes: Eyes::Both,
        }
    }
}

impl CameraSetup {
    /// Returns the slave that draws into the window of a context.
    pub(in crate::viewer) fn slave_in(&self, context: ContextId) -> Slave {
        let Self { viewport, projection_offset, view_offset, eyes, .. } = *self;
        Slave { viewport, projection_offset, view_offset, eyes, ..Slave::new(context) }
    }
}

/// A window and its cameras.
#[derive(Clone, Debug, PartialEq)]
pub struct WindowSetup {
    /// The title; `None` takes the title of [`WindowOptions`](crate::viewer::WindowOptions), with a number appended from
    /// the second window on.
    pub title: Option<String>,
    /// The upper left corner in pixels from the screen's upper left corner; with `None` the window system decides.
    pub position_px: Option<[i32; 2]>,
    /// Width and height in pixels; `None` takes the size of [`ViewerConfig`](crate::viewer::ViewerConfig).
    pub size_px: Option<[u32; 2]>,
    /// The number of the screen, counted from 0; `None` takes the system's first screen.
    pub screen: Option<usize>,
    /// True when the window fills its screen.
    pub full_screen: bool,
    /// True when the window has a frame and a title bar.
    pub decorated: bool,
    /// True when the window uses the first window's device, so that everything is uploaded once; see
    /// `Viewer::open_window_on`.
    pub shares_device: bool,
    /// Samples per pixel, as [`ContextTraits::samples`](crate::gpu::ContextTraits::samples); `None` takes the configuration's.
    pub samples: Option<u32>,
    /// True when frames wait for the screen's refresh; `None` takes the configuration's setting.
    pub vsync: Option<bool>,
    /// The cameras in the order drawn. The first camera of the first window is the master and has no offsets; all others
    /// are its slaves.
    pub cameras: Vec<CameraSetup>,
}

impl Default for WindowSetup {
    /// Creates a window of the configuration's size with one camera.
    fn default() -> Self {
        Self {
            title: None,
            position_px: None,
            size_px: None,
            screen: None,
            full_screen: false,
            decorated: true,
            shares_device: false,
            samples: None,
            vsync: None,
            cameras: vec![CameraSetup::default()],
        }
    }
}

impl WindowSetup {
    /// Returns the traits of the window's context.
    pub(in crate::viewer) fn traits(&self, config: &ViewerConfig, size_px: [u32; 2]) -> ContextTraits {
        ContextTraits {
            size_px,
            samples: self.samples.unwrap_or(config.samples),
            vsync: self.vsync.unwrap_or(config.vsync),
            ..config.traits()
        }
    }
}
