//! Frames that were read back: single pixels, counts, differences, and comparison with reference images.

use std::path::{Path, PathBuf};

use image::{RgbImage, RgbaImage};
use terrane::gpu::AdapterChoice;

/// The background of [`crate::rig::plain`]: a color that no test draws on purpose.
pub const MAGENTA: [u8; 3] = [255, 0, 255];

/// Returns red, green and blue of a pixel.
pub fn pixel(picture: &RgbaImage, x: u32, y: u32) -> [u8; 3] {
    let [r, g, b, _] = picture.get_pixel(x, y).0;
    [r, g, b]
}

/// Returns the number of pixels of a color.
pub fn count(picture: &RgbaImage, rgb: [u8; 3]) -> usize {
    picture.pixels().filter(|p| p.0[..3] == rgb).count()
}

/// Compares a frame with the reference image `tests/images/NAME.png`.
///
/// With `UPDATE_IMAGES=1` the frame becomes the reference. A failure leaves the frame and the difference, times eight,
/// beside it.
pub fn assert_picture(name: &str, picture: &RgbaImage) {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../images");
    let reference_path = folder.join(format!("{name}.png"));
    if std::env::var("UPDATE_IMAGES").is_ok_and(|v| v == "1") {
        std::fs::create_dir_all(&folder).unwrap();
        picture.save(&reference_path).unwrap();
        return;
    }
    let reference = image::open(&reference_path)
        .unwrap_or_else(|e| panic!("{}: {e}; UPDATE_IMAGES=1 writes it", reference_path.display()))
        .to_rgba8();
    assert_eq!(picture.dimensions(), reference.dimensions(), "{name}");
    let mut differences: Vec<u8> = picture
        .pixels()
        .zip(reference.pixels())
        .map(|(a, b)| (0..3).map(|c| a.0[c].abs_diff(b.0[c])).max().unwrap())
        .collect();
    let picture_of_differences = RgbaImage::from_fn(picture.width(), picture.height(), |x, y| {
        let d = differences[(y * picture.width() + x) as usize].saturating_mul(8);
        image::Rgba([d, d, d, 255])
    });
    differences.sort_unstable();
    let mean = differences.iter().map(|d| f64::from(*d)).sum::<f64>() / differences.len() as f64;
    let percentile_99 = differences[differences.len() * 99 / 100];
    let max = *differences.last().unwrap();
    // The references were drawn by the software driver. Graphics cards differ in single pixels at edges, and by rounding
    // elsewhere.
    let (max_mean, max_percentile_99) = if crate::adapter() == AdapterChoice::Software { (0.5, 6) } else { (1.5, 12) };
    if mean > max_mean || percentile_99 > max_percentile_99 || max > 160 {
        picture.save(folder.join(format!("{name}.actual.png"))).unwrap();
        picture_of_differences.save(folder.join(format!("{name}.diff.png"))).unwrap();
        panic!("{name} differs: mean {mean:.2}, 99th percentile {percentile_99}, max {max}; see {name}.diff.png");
    }
}

/// Saves a frame as `DIR/NAME.png` if the variable `KEEP_IMAGES` names a folder, to look at it.
pub fn keep(name: &str, picture: &RgbaImage) {
    if let Some(folder) = std::env::var_os("KEEP_IMAGES") {
        picture.save(Path::new(&folder).join(format!("{name}.png"))).unwrap();
    }
}

/// Returns the number of pixels that differ by more than `by` in red, green or blue.
pub fn differ(a: &RgbaImage, b: &RgbaImage, by: u8) -> usize {
    assert_eq!(a.dimensions(), b.dimensions());
    let far = |a: &[u8], b: &[u8]| a.iter().zip(b).take(3).any(|(a, b)| a.abs_diff(*b) > by);
    a.pixels().zip(b.pixels()).filter(|(a, b)| far(&a.0, &b.0)).count()
}

/// Returns the sRGB component of a linear value, 0 to 1.
pub fn srgb(linear: f64) -> u8 {
    (terrane::math::color::srgb_from_linear(linear) * 255.0).round() as u8
}

/// Returns a picture of the X server's 32-bit pixels: blue, green, red and padding.
pub fn rgb_of_bgra([width, height]: [u32; 2], pixels: &[u8]) -> RgbImage {
    let rgb = pixels.as_chunks::<4>().0.iter().map(|&[b, g, r, _]| [r, g, b]).collect::<Vec<_>>().into_flattened();
    RgbImage::from_raw(width, height, rgb).unwrap()
}

/// Returns the share of the pixels that differ visibly, 0..1; 1 for pictures of different sizes.
pub fn differing(a: &RgbImage, b: &RgbImage) -> f64 {
    if a.dimensions() != b.dimensions() {
        return 1.0;
    }
    let differ = |(p, q): &(&image::Rgb<u8>, &image::Rgb<u8>)| (0..3).any(|c| p.0[c].abs_diff(q.0[c]) > 12);
    a.pixels().zip(b.pixels()).filter(differ).count() as f64 / f64::from(a.width() * a.height())
}

/// Returns the number of colours in steps of 8; a sky alone has few.
pub fn colours(picture: &RgbImage) -> usize {
    let mut is_found = vec![false; 32 * 32 * 32];
    for p in picture.pixels() {
        let [r, g, b] = p.0.map(|c| usize::from(c / 8));
        is_found[(r * 32 + g) * 32 + b] = true;
    }
    is_found.iter().filter(|found| **found).count()
}
