//! Fuzzes the readers of elevation and colour files: each input gives a raster or an error that names the file, never a
//! panic. `tools/fuzz` runs these parsers as well.

use std::path::Path;

use crate::files::{PLACE, heights, tiff_float32, tiff_int16};
use crate::sources::tile_archives::{pmtiles, terrarium};
use kit::fuzz::Parser;
use terrane::formats::writers::write_height_exr;
use terrane_data_gen::{ElevationSource as _, Extent, GenError, Raster};

fn read(path: &Path) {
    match Raster::read(path) {
        Ok(raster) => {
            let [width, height] = raster.size();
            assert!(width * height > 0);
            assert!(raster.bounds().iter().all(|b| !b.is_nan()), "{:?}", raster.bounds());
            // Blocks behind the first one may be broken.
            match raster.range_m() {
                Ok(range) => assert!(range.iter().all(|h| h.is_finite())),
                Err(error) => names_the_file(path, &error),
            }
            let everything = Extent { west: -10.0, south: -2.0, east: 10.0, north: 2.0 };
            if let Err(error) = raster.samples_in(&everything, &mut |_| ()) {
                names_the_file(path, &error);
            }
        }
        Err(error) => names_the_file(path, &error),
    }
}

fn names_the_file(path: &Path, error: &GenError) {
    let text = error.to_string();
    assert!(text.contains(path.file_name().unwrap().to_str().unwrap()), "{text}");
    assert!(!text.contains("panicked"), "{text}");
}

fn raster(name: &'static str, file: &str, world: bool, seeds: &[Vec<u8>]) -> Parser {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(file);
    if world {
        std::fs::write(path.with_extension("wld"), "0.001\n0\n0\n-0.001\n7.5\n46.5\n").unwrap();
    }
    Parser::new(name, seeds, move |bytes| {
        let _ = &folder;
        std::fs::write(&path, bytes).unwrap();
        read(&path);
    })
}

fn geotiff() -> Parser {
    let seeds = [tiff_float32(&heights(), Some(PLACE), Some("-9999")), tiff_int16(&heights(), Some(PLACE), None)];
    raster("geotiff", "a.tif", false, &seeds)
}

fn elevation_png() -> Parser {
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_fn(16, 16, |x, y| image::Rgb([1, 200 + x as u8, y as u8]))
        .write_to(&mut png, image::ImageFormat::Png)
        .unwrap();
    raster("elevation-png", "a.png", true, &[png.into_inner()])
}

fn exr() -> Vec<u8> {
    write_height_exr("t", 16, (0..256).map(|h| h as f32).collect()).unwrap()
}

fn elevation_exr() -> Parser {
    raster("elevation-exr", "a.exr", true, &[exr()])
}

fn ascii_grid() -> Parser {
    let header = "ncols 3\nnrows 2\nxllcorner 7\nyllcorner 45\ncellsize 0.5\nNODATA_value -1\n";
    raster("ascii-grid", "a.asc", false, &[format!("{header}1 2 3\n4 -1 6.5\n").into_bytes()])
}

fn elevation_pmtiles() -> Parser {
    let tile = terrarium(300.0);
    let tiles = [(1, tile.clone()), (4, tile)];
    let archive = pmtiles(1, [-180.0, -85.0, 180.0, 85.0], &tiles);
    raster("elevation-pmtiles", "a.pmtiles", false, &[archive])
}

fn world_file() -> Parser {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    std::fs::write(&path, exr()).unwrap();
    Parser::new("world-file", ["0.001\n0\n0\n-0.001\n7.5\n46.5\n"], move |bytes| {
        let _ = &folder;
        std::fs::write(path.with_extension("wld"), bytes).unwrap();
        read(&path);
    })
}

kit::parsers! {
    geotiff,
    elevation_png,
    elevation_exr,
    ascii_grid,
    elevation_pmtiles,
    world_file,
}

/// Regression: the reader allocated 48 GB and the process was killed.
#[test]
fn exr_with_a_huge_size_in_its_header_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    // This writer declares the number of blocks.
    let mut exr = std::io::Cursor::new(Vec::new());
    let channels = exr::prelude::SpecificChannels::build().with_channel("Y").with_pixel_fn(|_| (1.0f32,));
    let encoding = exr::prelude::Encoding {
        compression: exr::prelude::Compression::ZIP16,
        ..exr::prelude::Encoding::UNCOMPRESSED
    };
    let image = exr::prelude::Image::from_encoded_channels((16, 16), encoding, channels);
    exr::prelude::WritableImage::write(&image).to_buffered(&mut exr).unwrap();
    let mut exr = exr.into_inner();
    let after = |exr: &[u8], name: &[u8]| exr.windows(name.len()).position(|w| w == name).unwrap() + name.len() + 4;
    for name in [&b"dataWindow\0box2i\0"[..], b"displayWindow\0box2i\0"] {
        let at = after(&exr, name);
        exr[at + 8..at + 16].copy_from_slice(&[0xff, 0xff, 1, 0, 0xff, 0xff, 1, 0]);
    }
    std::fs::write(&path, &exr).unwrap();
    let error = Raster::read(&path).err().unwrap().to_string();
    assert!(error.contains("a.exr: EXR: "), "{error}");
    // The same with as many blocks of 16 rows as the size needs.
    let at = after(&exr, b"chunkCount\0int\0");
    exr[at..at + 4].copy_from_slice(&8192u32.to_le_bytes());
    std::fs::write(&path, exr).unwrap();
    let error = Raster::read(&path).err().unwrap().to_string();
    assert!(error.contains("131072 x 131072"), "{error}");
}
