//! Cameras in the graph: when they are drawn, into which targets, and with which settings. Plain values.

use std::sync::Arc;

use glam::{DAffine3, DMat4};

use super::node_payloads::ReferenceFrame;
use super::readback_image::{PictureSink, ReadBack};
use crate::scene::settings::{CameraEnvironment, CameraShadows, CullSettings, Inherit};
use crate::state::{OpaqueDrawData, TextureObject};

/// When a camera in the graph is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RenderOrder {
    /// Before the surrounding stage; lower numbers first.
    PreRender(i32),
    /// Inside the surrounding stage: another view and projection for the nodes below.
    Nested,
    /// After the surrounding stage; lower numbers first.
    PostRender(i32),
}

/// The attachments that a camera in the graph draws into.
#[derive(Clone, Debug, Default)]
pub struct CameraTarget {
    /// Colour attachments by location, at most 8. Without any, and without depth, the camera draws into the target of the
    /// surrounding stage.
    pub colors: Vec<Attachment>,
    /// A depth attachment, to be sampled later; without one a private depth buffer is used. With several samples per pixel it
    /// receives depth and stencil of the first sample that has a depth of a drawn object.
    pub depth: Option<Attachment>,
    /// Samples per pixel: 1, 2, 4, 8 or 16; resolved into the colour attachments. An adapter that lacks the number for the
    /// formats takes the next larger one that it has, or its largest; all have 1 and 4.
    ///
    /// A camera that does not clear its colours continues with the attachments' contents, the same in all samples of a
    /// pixel that an earlier frame drew. A camera that does not clear its depth continues with the depth drawn in this
    /// frame with as many samples; the depth of an earlier frame is cleared.
    pub samples: u32,
    /// Receives a copy of the first colour attachment after each draw, including what cameras below draw over it. Nothing
    /// waits for the copy.
    pub read_back: Option<Arc<PictureSink>>,
    /// Receive copies of other colour attachments, given by their locations.
    pub read_back_of: Vec<(usize, Arc<PictureSink>)>,
    /// Receives copies of [`Self::depth`] in the format [`Depth32`](crate::state::TextureFormat::Depth32); see
    /// [`Picture::depth`](super::Picture::depth). The depth of `Depth24Stencil8` cannot be copied.
    pub read_back_depth: Option<Arc<PictureSink>>,
    /// Receives copies of the stencil in [`Self::depth`] in the format [`R8`](crate::state::TextureFormat::R8).
    pub read_back_stencil: Option<Arc<PictureSink>>,
}

impl CameraTarget {
    /// Returns width and height; `None` without attachments.
    pub fn size_px(&self) -> Option<[u32; 2]> {
        let first = self.colors.first().or(self.depth.as_ref())?;
        let [width, height, _] = first.texture.level_size(first.level);
        Some([width, height])
    }

    /// Returns the copies to make and their receivers.
    pub(crate) fn read_backs(&self) -> impl Iterator<Item = (ReadBack, &Arc<PictureSink>)> {
        let first = self.read_back.iter().map(|sink| (ReadBack::Color(0), sink));
        let others = self.read_back_of.iter().map(|(location, sink)| (ReadBack::Color(*location), sink));
        let depth = self.read_back_depth.iter().map(|sink| (ReadBack::Depth, sink));
        let stencil = self.read_back_stencil.iter().map(|sink| (ReadBack::Stencil, sink));
        first.chain(others).chain(depth).chain(stencil)
    }
}

/// A level and layer of a texture to draw into.
#[derive(Clone, Debug)]
pub struct Attachment {
    /// The texture, created with [`TextureObject::target`].
    pub texture: Arc<TextureObject>,
    /// The mip level.
    pub level: u32,
    /// The array layer, cube face or slice of a volume. Slices are drawn into with one sample per pixel.
    pub layer: u32,
    /// The coarser levels after [`Self::level`] are computed from it each time the camera has drawn, each texel as the mean of
    /// four. For colours in planes, arrays and cubes.
    pub generates_mipmaps: bool,
}

impl Attachment {
    /// Creates an attachment of level 0, layer 0.
    pub fn new(texture: Arc<TextureObject>) -> Self {
        Self { texture, level: 0, layer: 0, generates_mipmaps: false }
    }

    /// Has the levels after this one computed from it.
    pub fn with_mipmaps(self) -> Self {
        Self { generates_mipmaps: true, ..self }
    }
}

/// A function that changes near and far: it is called with the distances that cull found, in metres in front of the eye, and
/// returns those to use.
pub type ClampProjection = fn(near_m: f64, far_m: f64) -> (f64, f64);

/// A camera in the graph. Public fields, because the application sets any of them; the constructors inherit the rest.
#[derive(Clone, Debug)]
pub struct CameraNode {
    /// When the camera is drawn.
    pub order: RenderOrder,
    /// Maps the node's frame (relative) or the world (absolute) to eye space.
    pub view: DAffine3,
    /// With `Absolute`, `view` replaces everything above; with `Relative`, it is applied below.
    pub frame: ReferenceFrame,
    /// The reversed-Z projection; `None` keeps the one above.
    pub projection: Option<DMat4>,
    /// x, y, width and height in pixels of the target, origin upper left. `None` is the whole target of the camera itself, or
    /// the viewport of the surrounding view.
    pub viewport_px: Option<[u32; 4]>,
    /// The linear clear colour; `None` keeps the target's contents. Nested cameras clear nothing.
    pub clear_color: Option<[f32; 4]>,
    /// If true, depth is cleared (to infinitely far) before drawing. Otherwise the depth remains that was drawn before in this
    /// frame into the same target, or that a depth texture holds. A target's private depth buffer keeps nothing from one
    /// frame to the next.
    pub clear_depth: bool,
    /// If true, the camera shows the whole scene besides its children: mirrors, maps and other views of one world. Tiles are
    /// requested for the camera's own eye, and levels of detail do not cross-fade.
    ///
    /// A camera that shows the scene is not drawn in the image of another one. A nested camera draws the scene into the
    /// surrounding image, with its depths and without its occluders, background, sky and water.
    pub shows_scene: bool,
    /// The target; `None` is the target of the surrounding stage.
    pub target: Option<Arc<CameraTarget>>,
    /// Light, air, sky and water of the camera's image.
    pub environment: CameraEnvironment,
    /// Shadows of the sun in the camera's image.
    pub shadows: CameraShadows,
    /// The culling settings.
    pub settings: CullSettings,
    /// The settings that are taken from the camera above.
    pub inherit: Inherit,
    /// Changes near and far after they are computed; `None` takes the function of the camera above, if [`Self::inherit`]
    /// has [`Inherit::CLAMP_PROJECTION`].
    pub clamp_projection: Option<ClampProjection>,
    /// Receives a copy of what the camera's viewport in its target shows, once the camera and the cameras after it are drawn.
    /// For a camera without a target, that is a part of the window's frame buffer. Nested cameras copy nothing.
    ///
    /// The texture, which [`TextureObject::target`] creates, takes size and format of the copied part, and is not drawn into
    /// otherwise. Draws that follow sample the copy; those before sample that of the frame before.
    pub copy_to: Option<Arc<TextureObject>>,
    /// Callbacks that are called while the camera is drawn.
    pub callbacks: Option<OpaqueDrawData>,
}

impl CameraNode {
    /// Creates a camera that inherits everything from above, with the identity as a relative view.
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
            copy_to: None,
            callbacks: None,
        }
    }

    /// Creates a camera that is drawn into a texture before the surrounding stage.
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
