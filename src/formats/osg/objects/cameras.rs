//! Cameras of a file, as OSG's class has them. Decode threads.

use glam::DMat4;

/// A Camera. Its matrices are those of OpenGL, with depths of -1 to 1.
#[derive(Clone, Debug)]
pub(in crate::formats::osg) struct CameraObject {
    /// True if the matrices replace those above.
    pub is_absolute: bool,
    pub projection: DMat4,
    pub view: DMat4,
    pub order: CameraOrder,
    /// Cameras of the same order are drawn by this number.
    pub number: i32,
    /// The bits of OpenGL's glClear.
    pub clear_mask: u32,
    /// The displayed colour, sRGB.
    pub clear_color: [f32; 4],
    /// True if it draws to a part of the window, in pixels.
    pub has_viewport: bool,
    /// True if it draws to a texture or to a separate window.
    pub has_target: bool,
}

impl CameraObject {
    /// The bits of [`Self::clear_mask`] for colour and depth.
    pub const CLEAR_COLOR: u32 = 0x4000;
    pub const CLEAR_DEPTH: u32 = 0x100;
    /// OSG's number of a target that is the window.
    pub const FRAME_BUFFER: u32 = 3;
}

/// When a Camera is drawn, with OSG's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::formats::osg) enum CameraOrder {
    /// Drawn before the view.
    Before,
    /// Drawn as a part of the view.
    Nested,
    /// Drawn over the view.
    After,
}

impl CameraOrder {
    pub fn of_number(number: u32) -> Self {
        match number {
            0 => Self::Before,
            1 => Self::Nested,
            _ => Self::After,
        }
    }
}
