//! Counts hole pixels of a flight. Images are read back some frames late, so the cameras of their frames are kept.

use std::collections::VecDeque;

use image::RgbaImage;
use terrane::viewer::{Camera, HoleCheck, KEY_COLOR};

/// Counts the background pixels where terrain must be, from the first image with terrain on.
pub struct HoleCounter {
    check: HoleCheck,
    /// The cameras of frames whose images are not read back yet, in order of the frames.
    cameras: VecDeque<(u32, Camera)>,
    /// True from the first image with terrain on. Before it, the coarsest tile is still on its way.
    has_terrain: bool,
    pixels: u64,
}

impl HoleCounter {
    /// Creates a counter without holes.
    pub fn new(check: HoleCheck) -> Self {
        Self { check, cameras: VecDeque::new(), has_terrain: false, pixels: 0 }
    }

    /// Keeps the camera of a frame whose image will be read back.
    pub fn expect_image(&mut self, frame: u32, camera: Camera) {
        self.cameras.push_back((frame, camera));
    }

    /// Counts the holes in the image of a frame. Earlier frames without an image are skipped.
    pub fn count(&mut self, frame: u32, image: &RgbaImage) {
        while let Some((camera_frame, camera)) = self.cameras.pop_front() {
            if camera_frame == frame {
                self.has_terrain |= image.pixels().any(|pixel| pixel.0[..3] != KEY_COLOR);
                if !self.has_terrain {
                    return;
                }
                self.pixels += self.check.count(image, &camera, KEY_COLOR);
                return;
            }
        }
    }

    /// Returns the number of hole pixels in all images so far.
    pub fn pixels(&self) -> u64 {
        self.pixels
    }
}
