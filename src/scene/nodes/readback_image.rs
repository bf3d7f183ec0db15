//! Images of cameras that are read back from the GPU: colours, depth, stencil. The draw thread delivers them, any thread
//! takes them.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};

use glam::DMat4;

use crate::math::distance_of_depth;
use crate::state::TextureFormat;

/// Receives images from the draw thread, some frames after they were drawn.
#[derive(Debug, Default)]
pub struct PictureSink {
    /// The newest image, which replaces older ones; written by the draw thread, taken by any thread.
    latest: Mutex<Option<Picture>>,
    /// The frame of the last image received, for drawing on demand.
    received: AtomicU32,
}

/// An image that was read back: rows top to bottom, without gaps.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Width and height in pixels.
    pub size_px: [u32; 2],
    /// The frame that it shows.
    pub frame: u32,
    /// The projection with which the camera drew, near and far as fitted; reversed depth.
    pub clip_from_eye: DMat4,
    /// The format of the pixels.
    pub format: TextureFormat,
    /// The bytes of the pixels, [`TextureFormat::texel_bytes`] each; numbers are little-endian.
    pub texels: Vec<u8>,
}

impl Picture {
    /// Returns the depth of a pixel, counted from the upper left: 1 at the near plane, decreasing to 0 at the far plane or
    /// infinitely far, also where nothing was drawn. `None` outside the image or if it holds no depth.
    pub fn depth(&self, x: u32, y: u32) -> Option<f32> {
        let [width, height] = self.size_px;
        if self.format != TextureFormat::Depth32 || x >= width || y >= height {
            return None;
        }
        let first = 4 * (y as usize * width as usize + x as usize);
        Some(f32::from_le_bytes(*self.texels.get(first..)?.first_chunk()?))
    }

    /// Returns the distance of a pixel along the view axis in metres, computed from [`Self::depth`] with the camera's
    /// projection: infinite if nothing was drawn and the far plane is infinitely far. The result is wrong for geometry below a
    /// separate projection, or drawn in a part of the depth range (`state::Depth::range`).
    pub fn distance_m(&self, x: u32, y: u32) -> Option<f64> {
        self.depth(x, y).map(|depth| distance_of_depth(&self.clip_from_eye, depth))
    }
}

/// The part of a camera's target that is read back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ReadBack {
    /// The colour attachment at a location.
    Color(usize),
    Depth,
    Stencil,
}

impl PictureSink {
    /// Takes the newest image, if none has taken it yet.
    pub fn take(&self) -> Option<Picture> {
        self.latest.lock().map_or(None, |mut latest| latest.take())
    }

    /// Delivers an image.
    pub fn put(&self, picture: Picture) {
        self.received.store(picture.frame, Ordering::Release);
        if let Ok(mut latest) = self.latest.lock() {
            *latest = Some(picture);
        }
    }

    /// Returns the number of frames since the last image received.
    pub(crate) fn age(&self, frame: u32) -> u32 {
        frame.saturating_sub(self.received.load(Ordering::Acquire))
    }
}
