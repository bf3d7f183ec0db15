//! Elevation and colour files, fed with what is nearly well: a raster or an error that names the file, never a panic.
//! `FUZZ_SECS=600 cargo test -p terrane-data-gen --test fuzz_rasters` for longer.

#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod files;
#[path = "../../tests/fuzz_support/mod.rs"]
mod fuzz_support;

use std::path::Path;

use files::{PLACE, heights, tiff_float32, tiff_int16};
use terrane::io::write::write_height_exr;
use terrane_data_gen::Raster;

fn read(path: &Path) {
    match Raster::read(path) {
        Ok(raster) => {
            let [width, height] = raster.size();
            assert!(width * height > 0 && raster.range_m().iter().all(|h| h.is_finite()));
            assert!(raster.bounds().iter().all(|b| !b.is_nan()), "{:?}", raster.bounds());
        }
        Err(error) => {
            let text = error.to_string();
            assert!(text.contains(path.file_name().unwrap().to_str().unwrap()), "{text}");
            assert!(!text.contains("panicked"), "{text}");
        }
    }
}

fn rasters(name: &str, file: &str, world: bool, seeds: &[Vec<u8>]) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(file);
    if world {
        std::fs::write(path.with_extension("wld"), "0.001\n0\n0\n-0.001\n7.5\n46.5\n").unwrap();
    }
    fuzz_support::run(name, seeds, |bytes| {
        std::fs::write(&path, bytes).unwrap();
        read(&path);
    });
}

#[test]
fn fuzz_geotiff() {
    let seeds = [tiff_float32(&heights(), Some(PLACE), Some("-9999")), tiff_int16(&heights(), Some(PLACE), None)];
    rasters("geotiff", "a.tif", false, &seeds);
}

#[test]
fn fuzz_elevation_png_and_exr() {
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_fn(16, 16, |x, y| image::Rgb([1, 200 + x as u8, y as u8]))
        .write_to(&mut png, image::ImageFormat::Png)
        .unwrap();
    rasters("elevation-png", "a.png", true, &[png.into_inner()]);
    let exr = write_height_exr("t", 16, (0..256).map(|h| h as f32).collect()).unwrap();
    rasters("elevation-exr", "a.exr", true, &[exr]);
}

#[test]
fn fuzz_world_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    std::fs::write(&path, write_height_exr("t", 16, (0..256).map(|h| h as f32).collect()).unwrap()).unwrap();
    let seed = b"0.001\n0\n0\n-0.001\n7.5\n46.5\n".to_vec();
    fuzz_support::run("world-file", &[seed], |bytes| {
        std::fs::write(path.with_extension("wld"), bytes).unwrap();
        read(&path);
    });
}

/// Took 48 GB of memory and ended the process.
#[test]
fn an_exr_that_says_it_is_huge_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let mut exr = write_height_exr("t", 16, vec![1.0; 256]).unwrap();
    for name in [&b"dataWindow\0box2i\0"[..], b"displayWindow\0box2i\0"] {
        let at = exr.windows(name.len()).position(|w| w == name).unwrap() + name.len() + 4;
        exr[at + 8..at + 16].copy_from_slice(&[0xff, 0xff, 1, 0, 0xff, 0xff, 1, 0]);
    }
    std::fs::write(&path, exr).unwrap();
    let error = Raster::read(&path).err().unwrap().to_string();
    assert!(error.contains("131072 x 131072"), "{error}");
}
