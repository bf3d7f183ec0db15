//! Elevation on both sides of the date line becomes one set. Regression: it was refused, or it became a set around the
//! earth through longitude 0.

use std::f64::consts::PI;
use std::path::Path;

use crate::files::{SIDE, each_tile, heights, region, tile_heights, tileset};
use terrane::formats::writers::write_height_exr;
use terrane::math::{Region, WGS84};
use terrane_data_gen::{ContentKind, GenArgs, GenError, Voids, run};

/// The distance between samples in degrees.
const PIXEL: f64 = 0.001;
/// The latitude of the northernmost samples in degrees.
const NORTH: f64 = 46.5;

/// Writes a square part of the heights, from column `first` on, with its westernmost samples at the longitude `west`.
fn file(folder: &Path, name: &str, west: f64, first: usize, columns: usize) -> std::path::PathBuf {
    let (path, side) = (folder.join(name), SIDE as usize);
    let of = |k: usize| heights()[k / columns * side + first + k % columns];
    let exr = write_height_exr("test", columns, (0..columns * columns).map(of).collect()).unwrap();
    std::fs::write(&path, exr).unwrap();
    std::fs::write(path.with_extension("wld"), format!("{PIXEL}\n0\n0\n-{PIXEL}\n{west}\n{NORTH}\n")).unwrap();
    path
}

fn args(dem: Vec<std::path::PathBuf>, out: std::path::PathBuf) -> GenArgs {
    GenArgs { dem, levels: Some(3), jobs: Some(1), ..GenArgs::new(out) }
}

/// Checks that each tile's region is within 180 degrees, has the expected width, and lies inside its parent's.
fn check_regions(out: &Path, [west, wide]: [f64; 2]) {
    let set = tileset(out);
    let root = region(&set["root"]);
    assert!((root[0] - west.to_radians()).abs() < 1e-9, "{root:?}");
    let as_region = |r: &[f64]| Region {
        west: r[0],
        south: r[1],
        east: r[2],
        north: r[3],
        min_height_m: r[4],
        max_height_m: r[5],
        ellipsoid: WGS84,
    };
    let mut count = 0;
    each_tile(&set["root"], None, &mut |tile, parent| {
        count += 1;
        let own = as_region(&region(tile));
        assert!(own.west.abs() <= PI + 1e-6 && own.east.abs() <= PI + 1e-6, "{own:?}");
        let expected = parent.map_or(wide.to_radians(), |parent| 0.5 * as_region(&region(parent)).width());
        assert!((own.width() - expected).abs() < 1e-9, "{own:?}, not {expected}");
        if let Some(parent) = parent {
            let parent = as_region(&region(parent));
            let from_west = (own.west - parent.west).rem_euclid(2.0 * PI);
            assert!(from_west < 0.6 * parent.width() || from_west > 2.0 * PI - 1e-9, "{own:?} in {parent:?}");
        }
    });
    assert_eq!(count, 21);
}

#[test]
fn terrain_across_the_date_line_is_one_set() {
    let folder = tempfile::tempdir().unwrap();
    let (side, half) = (SIDE as usize, SIDE as usize / 2);
    let (wide, part) = (PIXEL * (side - 1) as f64, PIXEL * half as f64);
    let elsewhere = args(vec![file(folder.path(), "elsewhere.exr", 7.0, 0, side)], folder.path().join("elsewhere"));
    run(&elsewhere).unwrap();
    // The same file with longitudes counted from either side, half of it west of the date line.
    for (name, west) in [("east.exr", 180.0 - part), ("west.exr", -180.0 - part)] {
        let across =
            args(vec![file(folder.path(), name, west, 0, side)], folder.path().join(name).with_extension("set"));
        assert_eq!(run(&across).unwrap().filled_samples, 0);
        check_regions(&across.out, [180.0 - part, wide]);
        for (x, y) in [(0, 0), (1, 2), (2, 2), (3, 3)] {
            let pairs = tile_heights(&elsewhere.out, 2, x, y).into_iter().zip(tile_heights(&across.out, 2, x, y));
            // Rounding may differ by one quantum.
            let apart = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(apart < 0.01, "{apart} m");
        }
    }
    let meshes = GenArgs {
        content: ContentKind::Mesh,
        ..args(vec![folder.path().join("east.exr")], folder.path().join("meshes"))
    };
    run(&meshes).unwrap();
    check_regions(&meshes.out, [180.0 - part, wide]);
}

#[test]
fn files_on_both_sides_are_one_set() {
    let folder = tempfile::tempdir().unwrap();
    let half = SIDE as usize / 2;
    let part = PIXEL * half as f64;
    let at = |name: &str, west: f64, first: usize| file(folder.path(), name, west, first, half);
    // The files touch, in either order; then there is a gap between them, which is filled.
    let (before, after) = (at("before.exr", 180.0 - part, 0), at("after.exr", -180.0, half));
    for (name, dem) in [("a", vec![before.clone(), after.clone()]), ("b", vec![after.clone(), before.clone()])] {
        let both = args(dem, folder.path().join(name));
        assert_eq!(run(&both).unwrap().filled_samples, 0);
        check_regions(&both.out, [180.0 - part, 2.0 * part - PIXEL]);
    }
    let later = at("later.exr", -180.0 + part, half);
    let apart = GenArgs { voids: Voids::Fill, ..args(vec![before, later], folder.path().join("c")) };
    let filled = run(&apart).unwrap().filled_samples;
    assert!((20_000..25_000).contains(&filled), "expected a third of 257 x 257, found {filled}");
    check_regions(&apart.out, [180.0 - part, 3.0 * part - PIXEL]);
}

#[test]
fn imagery_beyond_the_date_line_is_used() {
    let folder = tempfile::tempdir().unwrap();
    let dem = vec![file(folder.path(), "a.exr", 180.0 - 0.02, 0, SIDE as usize)];
    let image_path = folder.path().join("colour.png");
    image::RgbImage::from_pixel(8, 8, image::Rgb([250, 10, 10])).save(&image_path).unwrap();
    // The image covers only the part beyond the date line.
    std::fs::write(image_path.with_extension("pgw"), "0.002\n0\n0\n-0.006\n-179.999\n46.5\n").unwrap();
    let set = GenArgs { imagery: vec![image_path], ..args(dem, folder.path().join("set")) };
    run(&set).unwrap();
    let red = |x: u32| {
        let tile = image::open(set.out.join(format!("2/{x}/2.jpg"))).unwrap().into_rgb8();
        let [r, g, _] = tile.get_pixel(128, 128).0;
        r > 200 && g < 60
    };
    assert_eq!([0, 1, 2, 3].map(red), [false, false, true, true]);
}

#[test]
fn terrain_around_half_the_earth_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(folder.path(), "world.exr", 0.0, 0, SIDE as usize);
    std::fs::write(path.with_extension("wld"), "6\n0\n0\n-4\n4.5\n80\n").unwrap();
    let error = run(&args(vec![path], folder.path().join("set"))).unwrap_err();
    assert!(matches!(error, GenError::Invalid { .. }), "{error}");
    assert!(error.to_string().contains("world.exr: the elevation reaches across the date line and half"), "{error}");
}
