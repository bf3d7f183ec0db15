//! [`SlaveWindow`]: a window beside the first one, with a slave camera that follows the view. Main thread.

use glam::{DAffine3, DMat4};

use crate::viewer::config::{CameraSetup, WindowSetup};

/// A further window, filled by a slave camera. Closing it removes the camera; the other windows stay open.
#[derive(Clone, Debug, PartialEq)]
pub struct SlaveWindow {
    /// The title of the window.
    pub title: String,
    /// Width and height in pixels.
    pub size_px: [u32; 2],
    /// The upper left corner on the screen; `None` leaves it to the window system.
    pub position_px: Option<[i32; 2]>,
    /// Draws with the first window's device; see
    /// [`CompositeViewer::open_window_on`](crate::viewer::CompositeViewer::open_window_on).
    pub shares_device: bool,
    /// The projection offset of its camera; see [`Slave::projection_offset`](crate::viewer::Slave::projection_offset).
    pub projection_offset: DMat4,
    /// The view offset of its camera; see [`Slave::view_offset`](crate::viewer::Slave::view_offset).
    pub view_offset: DAffine3,
}

impl From<SlaveWindow> for WindowSetup {
    fn from(slave: SlaveWindow) -> Self {
        let SlaveWindow { title, size_px, position_px, shares_device, projection_offset, view_offset } = slave;
        Self {
            title: Some(title),
            position_px,
            size_px: Some(size_px),
            shares_device,
            cameras: vec![CameraSetup { projection_offset, view_offset, ..CameraSetup::default() }],
            ..Self::default()
        }
    }
}
