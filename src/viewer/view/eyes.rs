//! [`Eyes`]: which eyes a camera draws for in stereo, and [`EyeTargets`], the textures that the eyes are drawn into.

use std::sync::Arc;

use crate::cull::{Stereo, StereoMode};
use crate::scene::{Attachment, CameraTarget};
use crate::state::{TextureFormat, TextureObject};
use crate::viewer::rendering::Sight;

/// The eyes that a camera draws for while its view is drawn in stereo.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Eyes {
    /// Both eyes, composed in the camera's own viewport by the view's stereo mode.
    #[default]
    Both,
    /// The left eye alone, for setups with a window or screen per eye.
    Left,
    /// The right eye alone.
    Right,
    /// A single eye in the middle between both.
    Middle,
}

impl Eyes {
    /// Returns the eyes that are visible in a stereo mode: some modes show only one of both.
    fn visible_in(self, mode: StereoMode) -> Self {
        match (self, mode) {
            (Self::Both, StereoMode::LeftEye) => Self::Left,
            (Self::Both, StereoMode::RightEye) => Self::Right,
            _ => self,
        }
    }
}

/// The size of a camera's image, and the targets of its eyes while both are drawn.
#[derive(Debug)]
pub(super) struct EyeTargets {
    size_px: [u32; 2],
    /// Left and right; created again when the size changes.
    targets: Option<[Arc<CameraTarget>; 2]>,
}

impl EyeTargets {
    pub(super) fn new(size_px: [u32; 2]) -> Self {
        Self { size_px, targets: None }
    }

    pub(super) fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    /// Sets the size of the camera's image; returns true when it changed.
    pub(super) fn set_size(&mut self, size_px: [u32; 2]) -> bool {
        let is_new = self.size_px != size_px;
        if is_new {
            self.size_px = size_px;
            self.targets = None;
        }
        is_new
    }

    /// Drops the targets; the next frame creates what it needs.
    pub(super) fn clear(&mut self) {
        self.targets = None;
    }

    /// Creates the targets that the eyes need in a stereo mode, and drops those that they do not.
    pub(super) fn prepare(&mut self, eyes: Eyes, stereo: &Stereo, samples: u32) {
        match eyes.visible_in(stereo.mode) {
            Eyes::Both => {
                let size_px = self.size_px;
                self.targets.get_or_insert_with(|| new_targets(stereo.eye_size_px(size_px), samples));
            }
            Eyes::Left | Eyes::Right | Eyes::Middle => self.targets = None,
        }
    }

    /// Returns how a camera with these eyes is culled.
    pub(super) fn sight(&self, eyes: Eyes, stereo: Option<Stereo>) -> Sight {
        let Some(stereo) = stereo else { return Sight::Middle };
        match (eyes.visible_in(stereo.mode), &self.targets) {
            (Eyes::Both, Some(targets)) => Sight::Both(stereo, targets.clone()),
            (Eyes::Left, _) => Sight::One(stereo, 0),
            (Eyes::Right, _) => Sight::One(stereo, 1),
            (Eyes::Both, None) | (Eyes::Middle, _) => Sight::Middle,
        }
    }
}

fn new_targets(size_px: [u32; 2], samples: u32) -> [Arc<CameraTarget>; 2] {
    ["left eye", "right eye"].map(|name| {
        let texture = TextureObject::target(name, size_px, TextureFormat::Rgba8Srgb);
        Arc::new(CameraTarget { colors: vec![Attachment::new(texture)], samples, ..CameraTarget::default() })
    })
}
