//! Cameras in the graph: when they are drawn, into which targets, and with which settings. Plain values.

use std::sync::Arc;

use glam::{DAffine3, DMat4};

use super::node_payloads::ReferenceFrame;
use super::readback_image::{PictureSink, ReadBack};
use crate::scene::settings::{CameraEnvironment, CameraShadows, CullSettings, Inherit};
use crate::state::{DrawHook, TextureObject};

/// When a camera in the graph is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RenderOrder {
    /// Before the stage it hangs in; lower numbers first.
    PreRender(i32),
    /// Inside it: another view and projection for the nodes below.
    Nested,
    /// After it; lower numbers first.
    PostRender(i32),
}

/// What a camera in the graph draws into.
#[derive(Clone, Debug, Default)]
pub struct CameraTarget {
    /// Colour attachments by location. Without any, and without depth, it is the target of the stage that the camera was met
    /// in.
    pub colors: Vec<Attachment>,
    /// Depth, to be sampled later; without one a depth buffer of the camera's own is used. Of several samples it gets the
    /// first one's depth and stencil, a depth that something has, where the stage was drawn.
    pub depth: Option<Attachment>,
    /// Samples a pixel, 1 or 4; resolved into the colour attachments. A camera that does not clear its colours goes on
    /// with what these hold, the same in all samples of a pixel where an earlier frame drew it. One that does not clear its
    /// depth goes on with what was drawn in this frame with as many samples; that of an earlier frame is cleared.
    pub samples: u32,
    /// Where the first colour attachment is copied to after each draw, with what cameras below draw over it; without waiting.
    pub read_back: Option<Arc<PictureSink>>,
    /// The same of other colour attachments, with their locations.
    pub read_back_of: Vec<(usize, Arc<PictureSink>)>,
    /// The same of [`Self::depth`], whose pictures have [`Depth32`](crate::state::TextureFormat::Depth32): see
    /// [`Picture::depth`](super::Picture::depth). Depth of `Depth24Stencil8` cannot be copied.
    pub read_back_depth: Option<Arc<PictureSink>>,
    /// The same of the stencil in [`Self::depth`], whose pictures have [`R8`](crate::state::TextureFormat::R8).
    pub read_back_stencil: Option<Arc<PictureSink>>,
}

impl CameraTarget {
    /// Width and height, where something is attached.
    pub fn size_px(&self) -> Option<[u32; 2]> {
        let first = self.colors.first().or(self.depth.as_ref())?;
        let [width, height, _] = first.texture.level_size(first.level);
        Some([width, height])
    }

    /// What is copied, and where to.
    pub(crate) fn read_backs(&self) -> impl Iterator<Item = (ReadBack, &Arc<PictureSink>)> {
        let first = self.read_back.iter().map(|sink| (ReadBack::Color(0), sink));
        let others = self.read_back_of.iter().map(|(location, sink)| (ReadBack::Color(*location), sink));
        let depth = self.read_back_depth.iter().map(|sink| (ReadBack::Depth, sink));
        let stencil = self.read_back_stencil.iter().map(|sink| (ReadBack::Stencil, sink));
        first.chain(others).chain(depth).chain(stencil)
    }
}

/// A part of a texture to draw into.
#[derive(Clone, Debug)]
pub struct Attachment {
    /// Made with [`TextureObject::target`].
    pub texture: Arc<TextureObject>,
    /// Mip level.
    pub level: u32,
    /// Array layer or cube face.
    pub layer: u32,
}

impl Attachment {
    /// Level 0, layer 0 of a texture.
    pub fn new(texture: Arc<TextureObject>) -> Self {
        Self { texture, level: 0, layer: 0 }
    }
}

/// Sets near and far anew: called with what cull found (metres in front of the eye), returns what to use.
pub type ClampProjection = fn(near_m: f64, far_m: f64) -> (f64, f64);

/// A camera in the graph.
#[derive(Clone, Debug)]
pub struct CameraNode {
    /// When it is drawn.
    pub order: RenderOrder,
    /// Eye from the node's frame (relative) or from the world (absolute).
    pub view: DAffine3,
    /// Absolute: `view` replaces everything above. Relative: it comes below it.
    pub frame: ReferenceFrame,
    /// Reversed-Z projection; `None` keeps the one above.
    pub projection: Option<DMat4>,
    /// x, y, width, height in pixels of the target, origin upper left; `None`: all of its own target, or what the view has
    /// of it that the camera was met in.
    pub viewport_px: Option<[u32; 4]>,
    /// Linear colour to clear with; `None` keeps what is there. Nested cameras clear nothing.
    pub clear_color: Option<[f32; 4]>,
    /// Clear depth before drawing (to infinitely far). What is not cleared is what was drawn before in this frame into the
    /// same target, or what a depth texture holds; a depth buffer of the target's own is another's from one frame to the
    /// next.
    pub clear_depth: bool,
    /// Show the whole scene, besides what is below it: mirrors, maps and other views of one world, its paged content with
    /// the tiles that the camera's own eye asks for. Levels of detail do not cross-fade in its picture. Of cameras that
    /// show the scene none is drawn in another's picture. Nested cameras show it among the things of the picture that
    /// they are met in: compared with the depths there, without its occluders, background, sky and water.
    pub shows_scene: bool,
    /// What it draws into; `None`: what the stage draws into that the camera was met in.
    pub target: Option<Arc<CameraTarget>>,
    /// Light, air, sky and water of its picture.
    pub environment: CameraEnvironment,
    /// Shadows of the sun in its picture.
    pub shadows: CameraShadows,
    /// What it culls.
    pub settings: CullSettings,
    /// Which of the settings come from above.
    pub inherit: Inherit,
    /// Changes near and far when they are computed.
    pub clamp_projection: Option<ClampProjection>,
    /// What is called while it is drawn.
    pub callbacks: Option<DrawHook>,
}

impl CameraNode {
    /// A camera of an order, with everything from above but its view: the identity, relative.
    pub fn new(order: RenderOrder) -> Self {
        Self {
            order,
            view: DAffine3::IDENTITY,
            frame: ReferenceFrame::Relative,
            projection: None,
            viewport_px: None,
            clear_color: Some([0.0, 0.0, 0.0, 1.0]),
            clear_depth: true,
            shows_scene: false,
            target: None,
            environment: CameraEnvironment::default(),
            shadows: CameraShadows::default(),
            settings: CullSettings::default(),
            inherit: Inherit::ALL,
            clamp_projection: None,
            callbacks: None,
        }
    }

    /// A camera drawn before the stage it hangs in, into a texture of a size.
    pub fn to_texture(texture: Arc<TextureObject>, view: DAffine3, projection: DMat4) -> Self {
        let colors = vec![Attachment::new(texture)];
        Self {
            view,
            frame: ReferenceFrame::Absolute,
            projection: Some(projection),
            target: Some(Arc::new(CameraTarget { colors, samples: 1, ..CameraTarget::default() })),
            ..Self::new(RenderOrder::PreRender(0))
        }
    }
}
