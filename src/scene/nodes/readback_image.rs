//! Pictures of cameras that come back from the adapter: colours, depth, stencil. Put there by the draw thread, taken by
//! anybody.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};

use glam::DMat4;

use crate::math::distance_of_depth;
use crate::state::TextureFormat;

/// Receives pictures from the draw thread, some frames after they were drawn.
#[derive(Debug, Default)]
pub struct PictureSink {
    /// Written by the draw thread, taken by anybody; the newest replaces an older one.
    latest: Mutex<Option<Picture>>,
    /// The frame of the last one that came, for drawing on demand.
    came: AtomicU32,
}

/// A picture read back: rows top to bottom, without gaps.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Width and height.
    pub size_px: [u32; 2],
    /// Frame it shows.
    pub frame: u32,
    /// The projection that its camera drew with, near and far as they were fitted; reversed depth.
    pub clip_from_eye: DMat4,
    /// What a pixel holds.
    pub format: TextureFormat,
    /// Bytes of the pixels, [`TextureFormat::texel_bytes`] each; numbers are little-endian.
    pub texels: Vec<u8>,
}

impl Picture {
    /// The depth of a pixel, counted from the upper left, as the adapter has it: 1 at the near plane, less the farther, 0 at
    /// the far plane or infinitely far, which is also where nothing was drawn. `None` outside, and of pictures that hold
    /// something else.
    pub fn depth(&self, x: u32, y: u32) -> Option<f32> {
        let [width, height] = self.size_px;
        if self.format != TextureFormat::Depth32 || x >= width || y >= height {
            return None;
        }
        let first = 4 * (y as usize * width as usize + x as usize);
        Some(f32::from_le_bytes(*self.texels.get(first..)?.first_chunk()?))
    }

    /// Metres to what a pixel shows, along the view axis, from its [`Self::depth`] under the camera's own projection:
    /// infinite where nothing was drawn and the far plane is infinitely far. What was drawn with a projection of its own
    /// below the camera, or in a part of the depths (`state::Depth::range`), lies elsewhere.
    pub fn distance_m(&self, x: u32, y: u32) -> Option<f64> {
        self.depth(x, y).map(|depth| distance_of_depth(&self.clip_from_eye, depth))
    }
}

/// What of a camera's target is read back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ReadBack {
    /// The colour at a location.
    Color(usize),
    Depth,
    Stencil,
}

impl PictureSink {
    /// The newest picture that has not been taken.
    pub fn take(&self) -> Option<Picture> {
        self.latest.lock().map_or(None, |mut latest| latest.take())
    }

    /// Puts a picture there for whoever takes it.
    pub fn put(&self, picture: Picture) {
        self.came.store(picture.frame, Ordering::Release);
        if let Ok(mut latest) = self.latest.lock() {
            *latest = Some(picture);
        }
    }

    /// The frames since the one of the last picture that came.
    pub(crate) fn age(&self, frame: u32) -> u32 {
        frame.saturating_sub(self.came.load(Ordering::Acquire))
    }
}
