//! What a flight came to, beside what a viewer shows that has just begun.

use std::time::Instant;

use anyhow::{Result, bail};
use image::RgbaImage;
use terrane::draw::Environment;
use terrane::pager::PagerConfig;
use terrane::viewer::{Camera, ThreadingModel, Viewer, ViewerConfig};

use super::flight::SETTLING_FRAME;

/// Frames within which a set that comes from the disk is there.
const MOST_FRAMES: u32 = 2000;
/// Frames at rest, until levels of detail have given way to one another.
pub const LAST_FRAMES: u32 = 40;
/// Pixels of a thousand that may be others: edges that two tiles share are drawn by whichever comes first.
const FEW: usize = 2;

/// The settled picture of a set from its own files.
pub fn picture(
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
    let mut frames_left = LAST_FRAMES;
    for frame in 0..MOST_FRAMES {
        (viewer.view_mut().camera, viewer.view_mut().environment) = (*camera, *environment);
        viewer.frame_at(f64::from(frame) / 60.0)?;
        viewer.work_until(Instant::now() + SETTLING_FRAME);
        frames_left = if viewer.is_settled() { frames_left - 1 } else { LAST_FRAMES };
        if frames_left == 0 {
            viewer.finish()?;
            return Ok(viewer.read_back()?);
        }
    }
    bail!("a new viewer does not come to rest: {:?}", viewer.stats().last())
}

/// What is said where two pictures are not the same.
pub fn difference(flown: &RgbaImage, fresh: &RgbaImage) -> Option<String> {
    if flown.dimensions() != fresh.dimensions() {
        return Some(format!("{:?} and {:?}", flown.dimensions(), fresh.dimensions()));
    }
    let is_other =
        |(a, b): &(&image::Rgba<u8>, &image::Rgba<u8>)| a.0.iter().zip(&b.0).any(|(a, b)| a.abs_diff(*b) > 4);
    let others = flown.pixels().zip(fresh.pixels()).filter(is_other).count();
    let all = flown.pixels().len();
    (others * 1000 > FEW * all).then(|| format!("{others} of {all} pixels are others"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_pixels_may_differ() {
        let fresh = RgbaImage::from_pixel(100, 20, image::Rgba([9, 90, 190, 255]));
        let with = |count: u32, red: u8| {
            let mut other = fresh.clone();
            (0..count).for_each(|x| other.put_pixel(x, 3, image::Rgba([red, 90, 190, 255])));
            other
        };
        assert_eq!(difference(&fresh, &fresh), None);
        assert_eq!(difference(&with(100, 13), &fresh), None, "by rounding");
        assert_eq!(difference(&with(4, 200), &fresh), None);
        assert_eq!(difference(&with(5, 200), &fresh).as_deref(), Some("5 of 2000 pixels are others"));
        assert!(difference(&RgbaImage::new(20, 100), &fresh).is_some());
    }
}
