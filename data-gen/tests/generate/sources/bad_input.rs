//! Sources that are degenerate or disagree.

use std::fs;
use std::path::{Path, PathBuf};

use terrane_data_gen::{ElevationSource as _, GenArgs, Raster, run};

use crate::files::from_dem;
use crate::tiffs::{Image, Values, tiff};

const CORNER: [f64; 2] = [7.0, 46.0];
const PIXEL: f64 = 0.001;

/// Returns elevation of some columns and rows as 32-bit floats, its corner some pixels from the usual one.
fn floats(size: [u16; 2], from: [f64; 2], height: impl Fn(usize, usize) -> f32) -> Vec<u8> {
    let [width, rows] = size.map(usize::from);
    let bytes = (0..width * rows).flat_map(|k| height(k % width, k / width).to_le_bytes()).collect();
    let image = Image::new(size, 32, 1, bytes).with(339, Values::Short(vec![3]));
    tiff(vec![image.at([CORNER[0] + from[0] * PIXEL, CORNER[1] - from[1] * PIXEL], [PIXEL; 2])])
}

fn write(folder: &Path, name: &str, bytes: Vec<u8>) -> PathBuf {
    let path = folder.join(name);
    fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn rasters_without_extent_or_heights_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes, why) in [
        ("one.tif", floats([1, 1], [0.0; 2], |_, _| 5.0), "has no extent"),
        ("row.tif", floats([40, 1], [0.0; 2], |_, _| 5.0), "has no extent"),
        ("column.tif", floats([1, 40], [0.0; 2], |_, _| 5.0), "has no extent"),
        ("empty.tif", Vec::new(), "the file is empty"),
        ("infinite.tif", floats([9, 9], [0.0; 2], |_, _| f32::INFINITY), "no sample has a height"),
        ("below.tif", floats([9, 9], [0.0; 2], |_, _| f32::NEG_INFINITY), "no sample has a height"),
    ] {
        let args = from_dem(folder.path(), name, &bytes);
        let error = run(&args).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains(why) && !args.out.exists(), "{error}");
    }
}

/// Regression: files without a georeference lay at 8 degrees east without a word.
#[test]
fn files_without_a_georeference_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let picture = |name: &str| {
        let mut png = std::io::Cursor::new(Vec::new());
        let image = image::RgbImage::from_fn(40, 40, |x, y| image::Rgb([1, 200 + (x + y) as u8 / 2, y as u8]));
        image.write_to(&mut png, image::ImageFormat::Png).unwrap();
        write(folder.path(), name, png.into_inner())
    };
    let (dem, colors) = (picture("dem.png"), picture("colors.png"));
    let args =
        GenArgs { dem: vec![dem.clone()], imagery: vec![colors.clone()], ..GenArgs::new(folder.path().join("a")) };
    let summary = run(&args).unwrap();
    for name in ["dem.png", "colors.png"] {
        let told =
            |note: &String| note.contains(name) && note.contains("no georeference") && note.contains("8 degrees east");
        assert_eq!(summary.notes.iter().filter(|note| told(note)).count(), 1, "{:?}", summary.notes);
    }
    std::fs::write(dem.with_extension("wld"), "0.001\n0\n0\n-0.001\n20\n30\n").unwrap();
    let error = run(&GenArgs { overwrite: true, ..args.clone() }).unwrap_err().to_string();
    assert!(error.contains("colors.png") && error.contains("has no georeference; a world file places it"), "{error}");
    std::fs::write(colors.with_extension("wld"), "0.001\n0\n0\n-0.001\n20\n30\n").unwrap();
    let notes = run(&GenArgs { overwrite: true, ..args }).unwrap().notes;
    assert!(notes.iter().all(|note| !note.contains("no georeference")), "{notes:?}");
}

#[test]
fn samples_that_are_not_finite_are_voids() {
    let folder = tempfile::tempdir().unwrap();
    let height = |x: usize, y: usize| match (x, y) {
        (10..20, 10..20) => [f32::INFINITY, f32::NEG_INFINITY, f32::NAN, f32::MAX][(x + y) % 4],
        _ => 100.0 + x as f32,
    };
    let args = GenArgs { levels: Some(1), ..from_dem(folder.path(), "a.tif", &floats([65, 65], [0.0; 2], height)) };
    let summary = run(&args).unwrap();
    assert_eq!((summary.cut_samples, summary.min_height_m, summary.max_height_m), (100, 100.0, 164.0));
}

/// A file of voids among others hides nothing.
#[test]
fn files_without_heights_do_not_hide_those_below() {
    let folder = tempfile::tempdir().unwrap();
    let void = write(folder.path(), "void.tif", floats([65, 65], [0.0; 2], |_, _| f32::NAN));
    let args = from_dem(folder.path(), "dem.tif", &floats([65, 65], [0.0; 2], |x, _| x as f32));
    let dem = vec![void, args.dem[0].clone()];
    let summary = run(&GenArgs { dem, levels: Some(1), ..args }).unwrap();
    assert_eq!((summary.cut_samples, summary.max_height_m), (0, 64.0));
}

/// Overlapping files that disagree: the first wins to its edge, and the set's declared error holds for both.
#[test]
fn overlapping_files_that_disagree_make_a_step_or_blend() {
    let folder = tempfile::tempdir().unwrap();
    let upper = write(folder.path(), "upper.tif", floats([65, 129], [0.0; 2], |_, _| 100.0));
    let lower = write(folder.path(), "lower.tif", floats([97, 129], [32.0, 0.0], |_, _| 500.0));
    let args = GenArgs { dem: vec![upper, lower], ..GenArgs::new(folder.path().join("set")) };
    let steepest = |args: &GenArgs| {
        run(&GenArgs { overwrite: true, ..args.clone() }).unwrap();
        let tiles = (0..2).map(|x| crate::files::tile_heights(&args.out, 1, x, 0));
        let rows = tiles.map(|tile| tile[33 * 67 + 1..33 * 67 + 66].to_vec());
        rows.flat_map(|row| row.windows(2).map(|w| (w[1] - w[0]).abs()).collect::<Vec<_>>()).fold(0.0, f32::max)
    };
    assert!(steepest(&args) > 390.0);
    // 20 pixels of about 77 m east and west.
    let blended = GenArgs { blend: 1540.0, ..args };
    let found = steepest(&blended);
    assert!(found < 60.0, "{found} m from sample to sample");
    for bad in [-1.0, f64::NAN, 1e9] {
        let error = run(&GenArgs { blend: bad, overwrite: true, ..blended.clone() }).unwrap_err().to_string();
        assert!(error.contains("--blend"), "{error}");
    }
}

#[test]
fn lists_with_files_that_are_missing_are_errors_that_name_them() {
    let folder = tempfile::tempdir().unwrap();
    let args = from_dem(folder.path(), "dem.tif", &floats([65, 65], [0.0; 2], |_, _| 1.0));
    let list = write(folder.path(), "list.txt", b"dem.tif\nmissing.tif\n".to_vec());
    for args in [GenArgs { dem: vec![list.clone()], ..args.clone() }, GenArgs { imagery: vec![list], ..args }] {
        let error = run(&args).unwrap_err().to_string();
        assert!(error.contains("missing.tif") || error.contains("8 bits per channel"), "{error}");
        assert!(!args.out.exists());
    }
}

/// Imagery of one pixel is drawn.
#[test]
fn imagery_of_one_pixel_is_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let args = from_dem(folder.path(), "dem.tif", &floats([65, 65], [0.0; 2], |_, _| 1.0));
    let path = folder.path().join("one.png");
    image::RgbImage::from_pixel(1, 1, image::Rgb([250, 20, 240])).save(&path).unwrap();
    fs::write(path.with_extension("pgw"), "1\n0\n0\n-1\n7\n46\n").unwrap();
    run(&GenArgs { imagery: vec![path], ..args.clone() }).unwrap();
    let color = image::open(args.out.join("0/0/0.jpg")).unwrap().into_rgb8().get_pixel(128, 128).0;
    assert!(color.iter().zip([250, 20, 240]).all(|(a, b)| a.abs_diff(b) < 10), "{color:?}");
    let raster = Raster::read(&args.dem[0]).unwrap();
    assert_eq!(raster.height_m(0.0, 0.0).unwrap(), None);
}
