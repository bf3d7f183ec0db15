//! Elevation that is read by blocks: samples in rectangles, rows, blocks of any size, archives of tiles, and files that change.

use std::fs;
use std::path::Path;

use terrane_data_gen::{ElevationSource as _, Extent, HeightEncoding, Raster, RasterOptions};

use super::tile_archives::{pmtiles, terrarium};
use crate::files::{PLACE, SIDE, heights, tiff_int16};
use crate::tiffs::{Image, Values, tiff};

/// A pixel of test images in degrees, exact in binary.
const PIXEL: [f64; 2] = [1.0 / 1024.0, 1.0 / 512.0];
const CORNER: [f64; 2] = [8.0, 46.0];

fn height(x: usize, y: usize) -> u16 {
    ((x * 37 + y * 91) % 1000 + 7 * (x % 5)) as u16
}

fn samples(columns: std::ops::Range<usize>, rows: std::ops::Range<usize>) -> Vec<u8> {
    rows.flat_map(|y| columns.clone().flat_map(move |x| height(x, y).to_le_bytes())).collect()
}

fn open(folder: &Path, image: Image) -> Raster {
    let path = folder.join("a.tif");
    fs::write(&path, tiff(vec![image.at(CORNER, PIXEL)])).unwrap();
    Raster::read(&path).unwrap()
}

/// Returns the samples of a raster in a rectangle: longitude, latitude, height and whether it is an extremum.
fn samples_in(raster: &Raster, extent: &Extent) -> Vec<(f64, f64, f64, bool)> {
    let mut found = Vec::new();
    raster.samples_in(extent, &mut |s| found.push((s.longitude, s.latitude, s.height_m, s.is_extremum))).unwrap();
    found
}

#[test]
fn samples_in_rectangles_are_those_inside_and_on_the_edges() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.tif");
    fs::write(&path, tiff_int16(&heights(), Some(PLACE), None)).unwrap();
    let raster = Raster::read(&path).unwrap();
    let n = SIDE as usize;
    let [west, south, east, north] = raster.bounds();
    let all =
        samples_in(&raster, &Extent { west: west - 1.0, south: south - 1.0, east: east + 1.0, north: north + 1.0 });
    assert_eq!(all.len(), n * n);
    let data = heights();
    for (k, (_, _, height_m, is_extremum)) in all.iter().enumerate() {
        let (x, y) = ((k % n) as i32, (k / n) as i32);
        assert_eq!(*height_m, f64::from(data[k]));
        let near = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (x + dx, y + dy)));
        let near = near.filter(|at| *at != (x, y) && (0..n as i32).contains(&at.0) && (0..n as i32).contains(&at.1));
        let others: Vec<f32> = near.map(|(x, y)| data[y as usize * n + x as usize]).collect();
        let expected = others.iter().all(|h| *h < data[k]) || others.iter().all(|h| *h > data[k]);
        assert_eq!(*is_extremum, expected, "{x} {y}");
    }
    assert!(all.iter().any(|s| s.3));
    // Rectangles whose edges are those of samples: those on the edges belong to both sides.
    let columns: Vec<f64> = [0, 7, 20, n - 1].map(|x| all[x].0).to_vec();
    let rows: Vec<f64> = [n - 1, 21, 8, 0].map(|y| all[y * n].1).to_vec();
    for (w, s) in (0..3).flat_map(|w| (0..3).map(move |s| (w, s))) {
        let extent = Extent { west: columns[w], east: columns[w + 1], south: rows[s], north: rows[s + 1] };
        let inside = |s: &&(f64, f64, f64, bool)| {
            (extent.west..=extent.east).contains(&s.0) && (extent.south..=extent.north).contains(&s.1)
        };
        let expected: Vec<_> = all.iter().filter(inside).copied().collect();
        assert_eq!(samples_in(&raster, &extent), expected);
        assert!(expected.len() > 40 && raster.may_have_data_in(&extent));
    }
    assert!(!raster.may_have_data_in(&Extent { west: east + 0.1, south, east: east + 0.2, north }));
}

#[test]
fn rasters_around_the_earth_give_samples_at_both_ends() {
    let folder = tempfile::tempdir().unwrap();
    // 36 columns from longitude 5 to 355: the samples of the eastern hemisphere come first.
    let bytes: Vec<u8> = (0..36 * 18).flat_map(|k: u16| k.to_le_bytes()).collect();
    let path = folder.path().join("a.tif");
    fs::write(&path, tiff(vec![Image::new([36, 18], 16, 1, bytes).at([0.0, 90.0], [10.0, 10.0])])).unwrap();
    let raster = Raster::read(&path).unwrap();
    for (west, east) in [(-30.0f64, 30.0), (-180.0, 180.0), (150.0, 210.0), (-200.0, -160.0), (100.0, 101.0)] {
        let degrees = Extent { west, south: -20.0, east, north: 40.0 };
        let extent = [degrees.west, degrees.south, degrees.east, degrees.north].map(f64::to_radians);
        let [west, south, east, north] = extent;
        let found = samples_in(&raster, &Extent { west, south, east, north });
        let centers =
            |from: f64, to: f64| (0..72).map(|k| -355.0 + 10.0 * f64::from(k)).filter(move |c| (from..=to).contains(c));
        let expected = centers(degrees.west, degrees.east).count() * 6;
        assert_eq!(found.len(), expected, "{degrees:?}");
        for (longitude, latitude, height_m, _) in found {
            let column = (longitude.to_degrees().rem_euclid(360.0) / 10.0).floor();
            let row = ((90.0 - latitude.to_degrees()) / 10.0).floor();
            assert_eq!(height_m, row * 36.0 + column);
        }
    }
}

#[test]
fn rows_are_equal_to_single_heights() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.tif");
    let place = |code: u16, west: f64, north: f64, pixel: f64| {
        let image = Image::new([60, 50], 16, 1, samples(0..60, 0..50)).at([west, north], [pixel; 2]);
        let keys = if code == 4326 { vec![[1024, 2], [2048, code]] } else { vec![[1024, 1], [3072, code]] };
        fs::write(&path, tiff(vec![image.with(34735, Values::Short(crate::files::geo_keys(&keys)))])).unwrap();
        Raster::read(&path).unwrap()
    };
    for raster in [
        place(4326, 8.0, 46.0, 0.01),
        place(3857, 900_000.0, 5_800_000.0, 1000.0),
        place(32632, 400_000.0, 5_100_000.0, 900.0),
    ] {
        let [west, south, east, north] = raster.bounds();
        let mut row = vec![0.0; 181];
        let mut known = 0;
        for j in 0..40 {
            let latitude = south + (north - south) * (f64::from(j) / 36.0 - 0.05);
            let (start, step) = (west - 0.05 * (east - west), (east - west) / 160.0);
            raster.heights_of_row(start, step, latitude, &mut row).unwrap();
            for (k, found) in row.iter().enumerate() {
                let single = raster.height_m(start + step * k as f64, latitude).unwrap();
                assert_eq!(single.map_or(f32::NAN, |h| h as f32).to_bits(), found.to_bits(), "{j} {k}");
                known += usize::from(found.is_finite());
            }
        }
        assert!((3000..7200).contains(&known), "{known}");
    }
}

#[test]
fn strips_and_tiles_of_any_size_give_the_same_heights() {
    let folder = tempfile::tempdir().unwrap();
    let (width, rows) = (300usize, 220usize);
    let size = [width as u16, rows as u16];
    let expected = |x: usize, y: usize| f64::from(height(x, y));
    let strips = |per_strip: usize| {
        let starts = (0..rows).step_by(per_strip);
        let blocks = starts.map(|first| samples(0..width, first..(first + per_strip).min(rows))).collect();
        Image { blocks, ..Image::new(size, 16, 1, Vec::new()) }.with(278, Values::Short(vec![per_strip as u16]))
    };
    let tiles = |side: usize| {
        let starts = (0..rows).step_by(side).flat_map(|y| (0..width).step_by(side).map(move |x| (x, y)));
        let blocks = starts.map(|(x, y)| samples(x..x + side, y..y + side)).collect();
        let image = Image { blocks, ..Image::new(size, 16, 1, Vec::new()) };
        image.with(322, Values::Short(vec![side as u16])).with(323, Values::Short(vec![side as u16]))
    };
    // The last tile is larger than what is decoded as a block.
    for image in [strips(rows), strips(1), strips(7), tiles(16), tiles(128), tiles(2112)] {
        let raster = open(folder.path(), image);
        let everything = Extent { west: -4.0, south: -2.0, east: 4.0, north: 2.0 };
        let found = samples_in(&raster, &everything);
        assert_eq!(found.len(), width * rows);
        assert!(found.iter().enumerate().all(|(k, sample)| sample.2 == expected(k % width, k / width)));
    }
}

#[test]
fn sparse_tiles_are_known_to_have_no_data() {
    let folder = tempfile::tempdir().unwrap();
    let mut blocks = vec![Vec::new(); 8 * 8];
    blocks[9] = samples(0..256, 0..256);
    let image = Image { blocks, ..Image::new([2048, 2048], 16, 1, Vec::new()) }.nodata("9999");
    let image = image.with(322, Values::Short(vec![256])).with(323, Values::Short(vec![256]));
    let raster = open(folder.path(), image);
    let extent = |x: f64, y: f64| {
        let (west, north) = (CORNER[0] + x * 256.0 * PIXEL[0], CORNER[1] - y * 256.0 * PIXEL[1]);
        let [west, south, east, north] = [west, north - 0.1, west + 0.1, north].map(f64::to_radians);
        Extent { west, south, east, north }
    };
    assert!(raster.may_have_data_in(&extent(1.2, 1.2)) && !raster.may_have_data_in(&extent(5.2, 5.2)));
    assert_eq!(samples_in(&raster, &Extent { west: -4.0, south: -2.0, east: 4.0, north: 2.0 }).len(), 256 * 256);
}

#[test]
fn files_that_are_short_or_change_while_they_are_read_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.tif");
    let blocks = (0..2000).map(|y| samples(0..400, y..y + 1)).collect();
    let image = Image { blocks, ..Image::new([400, 2000], 16, 1, Vec::new()) }.with(278, Values::Short(vec![1]));
    let whole = tiff(vec![image.at(CORNER, PIXEL)]);
    fs::write(&path, &whole).unwrap();
    let raster = Raster::read(&path).unwrap();
    fs::write(&path, [whole.as_slice(), b"more"].concat()).unwrap();
    let reason = raster.range_m().unwrap_err().to_string();
    assert!(reason.contains("a.tif: the file was changed while it was read"), "{reason}");
    // The directory is at the end of such files: a tag that names more bytes than there are.
    let mut short = tiff(vec![Image::new([4, 4], 16, 1, samples(0..4, 0..4)).at(CORNER, PIXEL)]);
    crate::files::set_tag(&mut short, 279, 100_000);
    fs::write(&path, short).unwrap();
    let reason = Raster::read(&path).err().unwrap().to_string();
    assert!(reason.contains("a.tif: TIFF: samples up to byte 100008, but the file has"), "{reason}");
    let blocks = vec![samples(0..10, 0..10)];
    let image = Image { blocks, ..Image::new([10, 40], 16, 1, Vec::new()) }.with(278, Values::Short(vec![10]));
    fs::write(&path, tiff(vec![image.at(CORNER, PIXEL)])).unwrap();
    let reason = Raster::read(&path).err().unwrap().to_string();
    assert!(reason.contains("1 strips, but 10 x 40 pixels need 4"), "{reason}");
}

#[test]
fn pmtiles_of_heights_are_one_raster() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.pmtiles");
    // Zoom level 1: ids 1 to 4 are (0, 0), (0, 1), (1, 1) and (1, 0). The tile in the south-east is missing.
    let tiles = [(1, terrarium(100.0)), (2, terrarium(200.0)), (4, terrarium(400.0))];
    let write = |bounds| fs::write(&path, pmtiles(1, bounds, &tiles)).unwrap();
    write([-180.0, -85.0, 180.0, 85.0]);
    let options = RasterOptions { encoding: HeightEncoding::Terrarium, ..RasterOptions::default() };
    let raster = Raster::read_in(&path, &options).unwrap();
    assert_eq!((raster.size(), raster.range_m().unwrap()), ([16, 16], [100.0, 400.0]));
    let at = |longitude: f64, latitude: f64| raster.height_m(longitude.to_radians(), latitude.to_radians()).unwrap();
    let found = [at(-90.0, 50.0), at(-90.0, -50.0), at(90.0, 50.0), at(90.0, -50.0)];
    assert_eq!(found, [Some(100.0), Some(200.0), Some(400.0), None]);
    // Bounds choose tiles.
    write([-180.0, -85.0511287, 0.0, 0.0]);
    let raster = Raster::read_in(&path, &options).unwrap();
    assert_eq!((raster.size(), raster.range_m().unwrap()), ([8, 8], [200.0, 200.0]));
    assert!((raster.bounds()[2].to_degrees() + 180.0 / 16.0).abs() < 1e-9);
    let mut jpeg = pmtiles(1, [0.0; 4], &tiles);
    jpeg[99] = 3;
    fs::write(&path, jpeg).unwrap();
    let reason = Raster::read_in(&path, &options).err().unwrap().to_string();
    assert!(reason.contains("a.pmtiles: PMTiles: tiles of type 3; elevation is read from PNGs"), "{reason}");
}
