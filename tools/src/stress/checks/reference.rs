//! The reference image of a flight: a new viewer draws the same camera from files without faults.

use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use image::RgbaImage;
use terrane::pager::PagerConfig;
use terrane::scene::Environment;
use terrane::viewer::{Camera, ThreadingModel, Viewer, ViewerConfig};

/// The duration of a frame while the flight settles. Requests wait for times, not for a number of frames.
pub const SETTLING_FRAME: Duration = Duration::from_millis(5);
/// Maximum number of frames until a set on disk is loaded.
const MAX_FRAMES: u32 = 2000;
/// Frames after loading, until all levels of detail have faded.
pub const FADE_FRAMES: u32 = 40;
/// Maximum number of different pixels per thousand: the tile that is drawn first covers the edge that two tiles share.
const MAX_DIFFERENT_PER_MILLE: usize = 2;

/// Draws the settled image of a set on disk with a new viewer.
pub fn image(
    config: &ViewerConfig,
    source: &str,
    size_px: [u32; 2],
    camera: &Camera,
    environment: &Environment,
) -> Result<RgbaImage> {
    let config = ViewerConfig {
        size_px,
        threading: ThreadingModel::SingleThreaded,
        pager: PagerConfig::default(),
        ..config.clone()
    };
    let mut viewer = Viewer::new_offscreen(&config)?;
    viewer.load(source)?;
    let mut frames_left = FADE_FRAMES;
    for frame in 0..MAX_FRAMES {
        (viewer.view_mut().camera, viewer.view_mut().environment) = (*camera, *environment);
        viewer.frame_at(f64::from(frame) / 60.0)?;
        viewer.work_until(Instant::now() + SETTLING_FRAME);
        frames_left = if viewer.is_settled() { frames_left - 1 } else { FADE_FRAMES };
        if frames_left == 0 {
            viewer.finish()?;
            return Ok(viewer.read_back()?);
        }
    }
    bail!("a new viewer does not settle: {:?}", viewer.stats().last())
}

/// Describes the difference of two images, `None` if they are equal up to rounding and a few pixels.
pub fn difference(flown: &RgbaImage, fresh: &RgbaImage) -> Option<String> {
    if flown.dimensions() != fresh.dimensions() {
        return Some(format!("{:?} and {:?}", flown.dimensions(), fresh.dimensions()));
    }
    let is_different =
        |(a, b): &(&image::Rgba<u8>, &image::Rgba<u8>)| a.0.iter().zip(&b.0).any(|(a, b)| a.abs_diff(*b) > 4);
    let different = flown.pixels().zip(fresh.pixels()).filter(is_different).count();
    let all = flown.pixels().len();
    (different * 1000 > MAX_DIFFERENT_PER_MILLE * all).then(|| format!("{different} of {all} pixels differ"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_pixels_may_differ() {
        let fresh = RgbaImage::from_pixel(100, 20, image::Rgba([9, 90, 190, 255]));
        let with = |count: u32, red: u8| {
            let mut other = fresh.clone();
            (0..count).for_each(|x| other.put_pixel(x, 3, image::Rgba([red, 90, 190, 255])));
            other
        };
        assert_eq!(difference(&fresh, &fresh), None);
        assert_eq!(difference(&with(100, 13), &fresh), None, "rounding may differ");
        assert_eq!(difference(&with(4, 200), &fresh), None);
        assert_eq!(difference(&with(5, 200), &fresh).as_deref(), Some("5 of 2000 pixels differ"));
        assert!(difference(&RgbaImage::new(20, 100), &fresh).is_some());
    }
}
