//! Imagery of several files, in web tiles and in archives of them, and half-float elevation.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use image::{ImageFormat, Rgba, RgbaImage};
use terrane_data_gen::{GenArgs, Raster, run};

use super::tile_archives::pmtiles;
use crate::files::from_dem;
use crate::tiffs::{Image, Values, tiff};

/// The corner of elevation that is one tile of zoom level 3, 4/2 in the north-east of the origin.
const ZOOM: u32 = 3;
const X: u32 = 4;
const Y: u32 = 2;

/// Returns options for a set of flat elevation around the middle of a web tile.
fn over_tile(folder: &Path, levels: u32) -> GenArgs {
    let [west, north, pixel] = [0.0, 66.5, 45.0 / 65.0];
    let image = Image::new([65; 2], 16, 1, [1, 1].repeat(65 * 65)).at([west, north], [pixel, 25.5 / 65.0]);
    GenArgs { levels: Some(levels), ..from_dem(folder, "dem.tif", &tiff(vec![image])) }
}

fn encoded(pixel: [u8; 4], format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let image = RgbaImage::from_pixel(16, 16, Rgba(pixel));
    match format {
        ImageFormat::Jpeg => image::DynamicImage::from(image).into_rgb8().write_to(&mut bytes, format).unwrap(),
        _ => image.write_to(&mut bytes, format).unwrap(),
    }
    bytes.into_inner()
}

fn write(path: PathBuf, bytes: Vec<u8>) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, bytes).unwrap();
}

/// Returns the colour of a tile of the finest level at a texel.
fn color(args: &GenArgs, name: &str, [x, y]: [u32; 2]) -> [u8; 3] {
    image::open(args.out.join(name)).unwrap().into_rgb8().get_pixel(x, y).0
}

fn is_near(found: [u8; 3], expected: [u8; 3]) -> bool {
    found.iter().zip(expected).all(|(a, b)| a.abs_diff(b) < 10)
}

#[test]
fn the_first_of_several_files_is_above_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let picture = |name: &str, color: [u8; 4], west: f64, format: ImageFormat| {
        let path = folder.path().join("pictures").join(name);
        write(path.clone(), encoded(color, format));
        fs::write(path.with_extension("wld"), format!("1.5\n0\n0\n-2\n{}\n{}\n", west + 0.75, 67.0)).unwrap();
        path
    };
    let red = picture("red.png", [240, 20, 20, 255], 0.0, ImageFormat::Png);
    let green = picture("green.jpg", [20, 240, 20, 255], 12.0, ImageFormat::Jpeg);
    let blue = picture("blue.webp", [20, 20, 240, 255], 24.0, ImageFormat::WebP);
    let clear = picture("clear.png", [0, 0, 0, 0], 0.0, ImageFormat::Png);
    let args = over_tile(folder.path(), 1);
    let colors = |imagery: Vec<PathBuf>| {
        let args = GenArgs { imagery, overwrite: true, ..args.clone() };
        run(&args).unwrap();
        // Longitudes of about 5, 18, 30 and 43 degrees.
        [28, 102, 170, 244].map(|x| color(&args, "0/0/0.jpg", [x, 128]))
    };
    let [r, g, b] = [[240, 20, 20], [20, 240, 20], [20, 20, 240]];
    let check = |imagery: Vec<PathBuf>, expected: [Option<[u8; 3]>; 4]| {
        let found = colors(imagery);
        for (found, expected) in found.into_iter().zip(expected) {
            let is_ground = ![r, g, b].iter().any(|color| is_near(found, *color));
            assert!(expected.map_or(is_ground, |expected| is_near(found, expected)), "{found:?}, not {expected:?}");
        }
    };
    check(vec![red.clone(), green.clone(), blue.clone()], [Some(r), Some(r), Some(g), Some(b)]);
    check(vec![clear, blue.clone(), green.clone(), red.clone()], [Some(r), Some(g), Some(b), Some(b)]);
    check(vec![green.clone()], [None, Some(g), Some(g), None]);
    // A pattern, a folder and a list. Files of a pattern or a folder are in the order of their names.
    check(vec![folder.path().join("pictures/*.png")], [Some(r), Some(r), None, None]);
    check(vec![folder.path().join("pictures")], [Some(r), Some(g), Some(b), Some(b)]);
    let list = folder.path().join("list.txt");
    fs::write(&list, "pictures/red.png\npictures/blue.webp\n").unwrap();
    check(vec![list, green], [Some(r), Some(r), Some(b), Some(b)]);
}

#[test]
fn web_tiles_have_a_resolution_of_their_own_and_are_transparent_where_they_are_missing() {
    let folder = tempfile::tempdir().unwrap();
    let set = folder.path().join("set");
    for (format, extension) in [(ImageFormat::Png, "png"), (ImageFormat::Jpeg, "jpg"), (ImageFormat::WebP, "webp")] {
        let _ = fs::remove_dir_all(&set);
        // Two levels: four tiles of zoom 5 within one of zoom 4, of which one is missing; zoom 4 has a colour of its own.
        let tile = |zoom: u32, x: u32, y: u32| set.join(format!("{zoom}/{x}/{y}.{extension}"));
        let [x, y] = [2 * X, 2 * Y];
        for (dx, dy) in [(0, 0), (1, 0), (2, 0), (3, 0), (0, 1), (1, 1), (2, 1), (3, 1)] {
            write(tile(5, 2 * x + dx, 2 * y + dy), encoded([240, 40 * dx as u8, 20, 255], format));
        }
        for dx in 0..2 {
            write(tile(4, x + dx, y), encoded([20, 20, 240, 255], format));
        }
        let args = GenArgs { imagery: vec![set.clone()], overwrite: true, ..over_tile(folder.path(), 3) };
        run(&args).unwrap();
        // The finest level takes zoom 5 (128 pixels over four times 256 texels and more).
        assert!(is_near(color(&args, "2/0/3.jpg", [100, 100]), [240, 0, 20]), "{extension}");
        assert!(is_near(color(&args, "2/1/3.jpg", [100, 100]), [240, 40, 20]), "{extension}");
        // South of the tiles lies the ground.
        let ground = color(&args, "2/1/0.jpg", [100, 100]);
        assert!(!is_near(ground, [240, 40, 20]) && !is_near(ground, [20, 20, 240]), "{ground:?}");
    }
    // An image that is far finer than the tiles: a tile takes the zoom level of its own resolution.
    let _ = fs::remove_dir_all(&set);
    for (zoom, color) in [(6, [240, 20, 20, 255]), (5, [20, 240, 20, 255]), (4, [20, 20, 240, 255])] {
        let side = 1 << (zoom - ZOOM);
        for (dx, dy) in (0..side).flat_map(|dx| (0..side).map(move |dy| (dx, dy))) {
            let path = set.join(format!("{zoom}/{}/{}.png", X * side + dx, Y * side + dy));
            let mut bytes = Cursor::new(Vec::new());
            RgbaImage::from_pixel(256, 256, Rgba(color)).write_to(&mut bytes, ImageFormat::Png).unwrap();
            write(path, bytes.into_inner());
        }
    }
    let args = GenArgs { imagery: vec![set], overwrite: true, ..over_tile(folder.path(), 4) };
    run(&args).unwrap();
    let found = ["3/1/4.jpg", "2/1/2.jpg", "1/0/1.jpg"].map(|name| color(&args, name, [128, 128]));
    for (found, expected) in found.into_iter().zip([[240, 20, 20], [20, 240, 20], [20, 20, 240]]) {
        assert!(is_near(found, expected), "{found:?}, not {expected:?}");
    }
}

/// Regression: the rows of TMS counted from the north.
#[test]
fn rows_of_tms_count_from_the_south() {
    let folder = tempfile::tempdir().unwrap();
    let set = folder.path().join("set");
    // The northern hemisphere of zoom level 1 is row 1, and that of its eastern half is red.
    for (x, y, color) in [(0, 1, [20, 240, 20, 255]), (1, 1, [240, 20, 20, 255]), (1, 0, [20, 20, 240, 255])] {
        write(set.join(format!("1/{x}/{y}.png")), encoded(color, ImageFormat::Png));
    }
    let describe = |srs: &str| {
        let text = format!("<TileMap><SRS>{srs}</SRS><TileSets></TileSets></TileMap>");
        fs::write(set.join("tilemapresource.xml"), text).unwrap();
    };
    let args = GenArgs { imagery: vec![set.clone()], overwrite: true, ..over_tile(folder.path(), 1) };
    for (srs, expected) in [(None, [20, 20, 240]), (Some("EPSG:3857"), [240, 20, 20])] {
        srs.into_iter().for_each(describe);
        run(&args).unwrap();
        assert!(is_near(color(&args, "0/0/0.jpg", [128, 128]), expected), "{srs:?}");
    }
    describe("EPSG:4326");
    let error = run(&args).unwrap_err().to_string();
    assert!(error.contains("tilemapresource.xml: tiles of another system than Web Mercator"), "{error}");
}

#[test]
fn imagery_is_read_from_pmtiles() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.pmtiles");
    // Zoom level 1: ids 1 to 4 are (0, 0), (0, 1), (1, 1) and (1, 0).
    let archive = |kind: u8, format: ImageFormat| {
        let tiles = [(1, encoded([20, 20, 240, 255], format)), (4, encoded([240, 20, 20, 255], format))];
        let mut bytes = pmtiles(1, [-180.0, 0.0, 180.0, 85.0511287], &tiles);
        bytes[99] = kind;
        bytes
    };
    let args = GenArgs { imagery: vec![path.clone()], overwrite: true, ..over_tile(folder.path(), 1) };
    for (kind, format) in [(2, ImageFormat::Png), (3, ImageFormat::Jpeg), (4, ImageFormat::WebP)] {
        fs::write(&path, archive(kind, format)).unwrap();
        run(&args).unwrap();
        assert!(is_near(color(&args, "0/0/0.jpg", [128, 128]), [240, 20, 20]));
    }
    fs::write(&path, archive(1, ImageFormat::Png)).unwrap();
    let reason = run(&args).unwrap_err().to_string();
    assert!(
        reason.contains("a.pmtiles: PMTiles: tiles of type 1; imagery is read from PNG, JPEG and WebP"),
        "{reason}"
    );
    fs::write(&path, &archive(2, ImageFormat::Png)[..100]).unwrap();
    let reason = run(&args).unwrap_err().to_string();
    assert!(reason.contains("shorter than its header"), "{reason}");
}

#[test]
fn half_floats_and_packed_samples_are_heights() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("half.tif");
    let read = |image: Image| {
        fs::write(&path, tiff(vec![image.at([7.0, 46.0], [0.001; 2])])).unwrap();
        Raster::read(&path)
    };
    let half = |value: f32| exr::prelude::f16::from_f32(value).to_le_bytes();
    let bytes: Vec<u8> = (0..256).flat_map(|k| half(if k == 7 { f32::NAN } else { k as f32 - 100.5 })).collect();
    let image = |bytes| Image::new([16; 2], 16, 1, bytes).with(339, Values::Short(vec![3]));
    assert_eq!(read(image(bytes)).unwrap().range_m().unwrap(), [-100.5, 154.5]);
    // In tiles, with a nodata value.
    let tiles = (0..4).map(|k| (0..256).flat_map(|j| half((1000 * k + j) as f32 / 4.0)).collect()).collect();
    let tiled = Image { blocks: tiles, ..Image::new([32; 2], 16, 1, Vec::new()) }.with(339, Values::Short(vec![3]));
    let tiled = tiled.with(322, Values::Short(vec![16])).with(323, Values::Short(vec![16])).nodata("0");
    assert_eq!(read(tiled).unwrap().range_m().unwrap(), [0.25, 814.0]);
    // 1, 2 and 4 bits a sample: rows end with a byte.
    for (bits, per_byte) in [(1u16, 8usize), (2, 4), (4, 2)] {
        let top = (1u16 << bits) - 1;
        let value = |x: usize, y: usize| ((x + y) % (usize::from(top) + 1)) as u8;
        let row = |y: usize| -> Vec<u8> {
            let byte = |first: usize| {
                (0..per_byte).fold(0, |byte, k| byte << bits | if first + k < 13 { value(first + k, y) } else { 0 })
            };
            (0..13).step_by(per_byte).map(byte).collect()
        };
        let image = Image::new([13, 16], bits, 1, (0..16).flat_map(row).collect());
        let raster = read(image).unwrap();
        assert_eq!(raster.range_m().unwrap(), [0.0, f32::from(top)], "{bits}");
        use terrane_data_gen::ElevationSource as _;
        for (x, y) in [(0usize, 0usize), (5, 3), (12, 15), (7, 8)] {
            let [longitude, latitude] = [7.0 + 0.001 * (x as f64 + 0.5), 46.0 - 0.001 * (y as f64 + 0.5)];
            let found = raster.height_m(longitude.to_radians(), latitude.to_radians()).unwrap().unwrap();
            assert!((found - f64::from(value(x, y))).abs() < 1e-6, "{bits} bits at {x} {y}: {found}");
        }
    }
    // Colours have no floats.
    let colors = Image::new([16; 2], 16, 3, half(0.5).repeat(3 * 256)).with(339, Values::Short(vec![3; 3]));
    fs::write(&path, tiff(vec![colors.at([7.0, 46.0], [0.01; 2])])).unwrap();
    let args = GenArgs { imagery: vec![path.clone()], ..over_tile(folder.path(), 1) };
    assert!(run(&args).unwrap_err().to_string().contains("8 bits per channel or 16"));
}

/// Regression: GDAL writes opaque tiles of images with opacity as RGB, which was an error.
#[test]
fn webp_tiles_with_and_without_opacity_are_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let opaque = {
        let mut bytes = Cursor::new(Vec::new());
        let image = image::RgbImage::from_pixel(16, 16, image::Rgb([240, 20, 20]));
        image.write_to(&mut bytes, ImageFormat::WebP).unwrap();
        bytes.into_inner()
    };
    let tile = [Values::Short(vec![16]), Values::Short(vec![16])];
    let [width, height] = tile;
    let image = Image {
        blocks: vec![opaque, encoded([20, 20, 240, 0], ImageFormat::WebP)],
        ..Image::new([32, 16], 8, 4, vec![])
    };
    let image = image.with(322, width).with(323, height).with(338, Values::Short(vec![2]));
    let image =
        image.with(crate::tiffs::COMPRESSION, Values::Short(vec![50001])).at([0.0, 66.5], [45.0 / 32.0, 25.5 / 16.0]);
    let path = folder.path().join("webp.tif");
    write(path.clone(), tiff(vec![image]));
    let below = folder.path().join("below.png");
    write(below.clone(), encoded([20, 240, 20, 255], ImageFormat::Png));
    fs::write(below.with_extension("wld"), "3\n0\n0\n-2\n1.5\n66\n").unwrap();
    let args = GenArgs { imagery: vec![path.clone(), below], ..over_tile(folder.path(), 1) };
    run(&args).unwrap();
    assert!(is_near(color(&args, "0/0/0.jpg", [60, 128]), [240, 20, 20]));
    assert!(is_near(color(&args, "0/0/0.jpg", [200, 128]), [20, 240, 20]), "transparent pixels show what lies below");
    let whole = fs::read(&path).unwrap();
    for at in (0..whole.len()).step_by(41) {
        let mut damaged = whole.clone();
        damaged[at] ^= 0x5a;
        write(path.clone(), damaged);
        if let Err(error) = run(&GenArgs { overwrite: true, ..args.clone() }) {
            assert!(error.to_string().contains("webp.tif"), "{at}: {error}");
        }
    }
}

#[test]
fn compressions_that_are_not_supported_are_named() {
    let folder = tempfile::tempdir().unwrap();
    for (code, name) in [(34925, "LZMA"), (50002, "JPEG XL"), (34712, "JPEG 2000"), (4, "CCITT fax 4")] {
        let image = Image::new([8; 2], 8, 1, vec![7; 64]).at([8.0, 46.0], [0.1; 2]);
        let image = image.with(crate::tiffs::COMPRESSION, Values::Short(vec![code]));
        let error = run(&from_dem(folder.path(), "a.tif", &tiff(vec![image]))).unwrap_err().to_string();
        assert!(error.contains("a.tif: TIFF: samples compressed as ") && error.contains(name), "{error}");
    }
    // Regression: GDAL 3.6 wrote heights of 1000 to 1063 m, which had other values here.
    let swapped = include_bytes!("rasters/big_endian_lerc.tif");
    let error = run(&from_dem(folder.path(), "a.tif", swapped)).unwrap_err().to_string();
    assert!(error.contains("LERC in a big-endian file"), "{error}");
}

/// `gdalwarp -dstalpha` marks the samples without data so.
#[test]
fn opacity_of_elevation_marks_samples_without_data() {
    let folder = tempfile::tempdir().unwrap();
    let samples =
        (1..=64u16).flat_map(|h| [h.to_le_bytes(), (if h == 64 { 0u16 } else { 65535 }).to_le_bytes()].concat());
    let image = Image::new([8; 2], 16, 2, samples.collect()).at([8.0, 46.0], [0.1; 2]);
    let args = from_dem(folder.path(), "a.tif", &tiff(vec![image.with(338, Values::Short(vec![2]))]));
    assert_eq!(Raster::read(&args.dem[0]).unwrap().range_m().unwrap(), [1.0, 63.0]);
}
