//! [`StageTarget`]: the image that a stage is drawn into.

use std::sync::Arc;

use crate::scene::{CameraEnvironment, CameraShadows, CameraTarget};
use crate::state::{OpaqueDrawData, TextureObject};

/// The image that a stage is drawn into, and how the image is prepared.
#[derive(Clone, Debug, Default)]
pub struct StageTarget {
    /// The target of a camera in the graph; `None` is the target of the context.
    pub camera: Option<Arc<CameraTarget>>,
    /// The target is that of the stage around this one.
    pub is_shared: bool,
    /// The depth buffer of the stage around is kept, and its projection is used.
    pub keeps_projection: bool,
    /// Viewport in the target in pixels: x, y, width, height. `None` is the whole target.
    pub viewport_px: Option<[u32; 4]>,
    /// Linear colour that a camera in the graph clears with; `None` keeps the contents.
    pub clear_color: Option<[f32; 4]>,
    /// Depth is cleared to infinity.
    pub clear_depth: bool,
    /// Render order number among the stages before or after the same one.
    pub order: i32,
    /// Receives a copy of what the viewport shows once the stage and those after it are drawn.
    pub copy_to: Option<Arc<TextureObject>>,
    /// Called while the stage is drawn.
    pub callbacks: Option<OpaqueDrawData>,
    /// Light and air of a camera in the graph.
    pub environment: CameraEnvironment,
    /// Shadows of a camera in the graph.
    pub shadows: CameraShadows,
}

impl StageTarget {
    /// Inherits from the stage around: a camera without attachments draws into that stage's target, and into its viewport
    /// unless it has its own.
    pub(in crate::cull) fn within(self, around: &Self) -> Self {
        match self.camera {
            Some(_) => self,
            None => Self {
                camera: around.camera.clone(),
                is_shared: true,
                viewport_px: self.viewport_px.or(around.viewport_px),
                ..self
            },
        }
    }
}
