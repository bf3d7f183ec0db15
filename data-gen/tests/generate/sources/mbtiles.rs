//! Elevation and imagery in MBTiles archives.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use rusqlite::Connection;
use terrane_data_gen::{ElevationSource as _, GenArgs, HeightEncoding, Raster, RasterOptions, run};

use super::tile_archives::terrarium;
use crate::files::from_dem;
use crate::tiffs::{Image, tiff};

/// Writes an archive of tiles: zoom level, column, and row from the north.
fn write(folder: &Path, name: &str, format: &str, tiles: &[([u32; 3], Vec<u8>)]) -> PathBuf {
    let path = folder.join(name);
    let _ = fs::remove_file(&path);
    let database = Connection::open(&path).unwrap();
    // As many programs write it: the tiles are a view.
    let tables = "CREATE TABLE metadata (name text, value text);
        CREATE TABLE map (zoom_level integer, tile_column integer, tile_row integer, tile_id text);
        CREATE TABLE images (tile_data blob, tile_id text);
        CREATE VIEW tiles AS SELECT zoom_level, tile_column, tile_row, tile_data FROM map
            JOIN images ON images.tile_id = map.tile_id;";
    database.execute_batch(tables).unwrap();
    database.execute("INSERT INTO metadata VALUES ('format', ?1)", [format]).unwrap();
    for (k, ([zoom, x, y], bytes)) in tiles.iter().enumerate() {
        database.execute("INSERT INTO images VALUES (?1, ?2)", (bytes, k.to_string())).unwrap();
        let row = i64::from((1u32 << zoom) - 1) - i64::from(*y);
        database.execute("INSERT INTO map VALUES (?1, ?2, ?3, ?4)", (zoom, x, row, k.to_string())).unwrap();
    }
    path
}

fn terrarium_options() -> RasterOptions {
    RasterOptions { encoding: HeightEncoding::Terrarium, ..RasterOptions::default() }
}

#[test]
fn heights_are_those_of_the_finest_level() {
    let folder = tempfile::tempdir().unwrap();
    let tiles =
        [([0, 0, 0], 5.0), ([1, 0, 0], 100.0), ([1, 0, 1], 200.0), ([1, 1, 0], 400.0)].map(|(t, h)| (t, terrarium(h)));
    let path = write(folder.path(), "a.mbtiles", "png", &tiles);
    let raster = Raster::read_in(&path, &terrarium_options()).unwrap();
    assert_eq!((raster.size(), raster.range_m().unwrap()), ([16, 16], [100.0, 400.0]));
    let at = |longitude: f64, latitude: f64| raster.height_m(longitude.to_radians(), latitude.to_radians()).unwrap();
    let found = [at(-90.0, 50.0), at(-90.0, -50.0), at(90.0, 50.0), at(90.0, -50.0)];
    assert_eq!(found, [Some(100.0), Some(200.0), Some(400.0), None]);
}

#[test]
fn imagery_takes_the_zoom_level_of_the_resolution() {
    let folder = tempfile::tempdir().unwrap();
    let jpeg = |color: [u8; 3]| {
        let mut bytes = Cursor::new(Vec::new());
        let image = image::RgbImage::from_pixel(256, 256, image::Rgb(color));
        image.write_to(&mut bytes, image::ImageFormat::Jpeg).unwrap();
        bytes.into_inner()
    };
    let finest = (0..4).map(|k| ([4, 8 + k % 2, 4 + k / 2], jpeg([240, 20, 20])));
    let tiles: Vec<_> = finest.chain([([3, 4, 2], jpeg([20, 20, 240]))]).collect();
    let imagery = write(folder.path(), "a.mbtiles", "jpg", &tiles);
    // Elevation over the tile 3/4/2, from 0 to 45 degrees east.
    let dem = Image::new([65; 2], 16, 1, [1, 1].repeat(65 * 65)).at([0.0, 66.5], [45.0 / 65.0, 25.5 / 65.0]);
    let args = GenArgs { imagery: vec![imagery], ..from_dem(folder.path(), "dem.tif", &tiff(vec![dem])) };
    run(&args).unwrap();
    for (name, expected) in [("1/0/0.jpg", [240, 20, 20]), ("0/0/0.jpg", [20, 20, 240])] {
        let found = image::open(args.out.join(name)).unwrap().into_rgb8().get_pixel(128, 128).0;
        assert!(found.iter().zip(expected).all(|(a, b)| a.abs_diff(b) < 10), "{name}: {found:?}");
    }
}

#[test]
fn archives_that_are_not_valid_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let error = |path: &Path| {
        let error = Raster::read_in(path, &terrarium_options()).err().unwrap().to_string();
        assert!(error.contains(".mbtiles") && error.lines().count() == 1, "{error}");
        error
    };
    let one = [([1, 0, 0], terrarium(1.0))];
    let vector = write(folder.path(), "vector.mbtiles", "pbf", &one);
    assert!(error(&vector).contains("MBTiles: tiles of format pbf; png are read"));
    assert!(error(&write(folder.path(), "empty.mbtiles", "png", &[])).contains("no tiles in it"));
    let damaged = write(folder.path(), "damaged.mbtiles", "png", &[([1, 0, 0], b"no image".to_vec())]);
    assert!(error(&damaged).contains("1/0/0.png: PNG"));
    let outside = write(folder.path(), "outside.mbtiles", "png", &one);
    Connection::open(&outside).unwrap().execute("UPDATE map SET tile_column = 9", []).unwrap();
    assert!(error(&outside).contains("zoom level 1 outside of its 2 columns"));
    let deep = write(folder.path(), "deep.mbtiles", "png", &one);
    Connection::open(&deep).unwrap().execute("UPDATE map SET zoom_level = 99", []).unwrap();
    assert!(error(&deep).contains("zoom level 99"));
    // A database of another kind, and one that was cut.
    let other = folder.path().join("other.mbtiles");
    Connection::open(&other).unwrap().execute_batch("CREATE TABLE a (b)").unwrap();
    assert!(error(&other).contains("a database without a table of tiles"));
    let whole = fs::read(write(folder.path(), "cut.mbtiles", "png", &one)).unwrap();
    fs::write(folder.path().join("cut.mbtiles"), &whole[..5000]).unwrap();
    error(&folder.path().join("cut.mbtiles"));
}

/// Regression: a view of a stranger is SQL, and some never end or take all memory.
#[test]
fn views_that_do_not_end_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let of_view = |name: &str, view: &str| {
        let path = folder.path().join(name);
        let database = Connection::open(&path).unwrap();
        database.execute_batch(&format!("CREATE TABLE one (b blob); CREATE VIEW tiles AS {view};")).unwrap();
        Raster::read_in(&path, &terrarium_options()).err().unwrap().to_string()
    };
    let endless = "WITH RECURSIVE n(k) AS (SELECT 0 UNION ALL SELECT k + 1 FROM n)";
    let columns = "1 AS zoom_level, 0 AS tile_column, 0 AS tile_row";
    for (name, view) in [
        ("count.mbtiles", format!("{endless} SELECT {columns}, zeroblob(9) AS tile_data FROM n")),
        ("none.mbtiles", format!("{endless} SELECT {columns}, zeroblob(9) AS tile_data FROM n WHERE k < 0")),
    ] {
        let error = of_view(name, &view);
        assert!(error.contains(&format!("{name}: MBTiles: a query takes more time")), "{error}");
    }
    // All numbers and a megabyte with each are kept, to find equal ones.
    let large = "WITH RECURSIVE n(k, b) AS (SELECT 0, NULL UNION SELECT k + 1, zeroblob(1000000) FROM n)";
    let error = of_view("memory.mbtiles", &format!("{large} SELECT {columns}, b AS tile_data FROM n WHERE k < 0"));
    assert!(error.contains("memory.mbtiles: MBTiles: a query needs more than 268435456 bytes"), "{error}");
}

/// Tiles in one table without an index, larger than a page.
#[test]
fn plain_tables_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("plain.mbtiles");
    let database = Connection::open(&path).unwrap();
    let table = "CREATE TABLE tiles (zoom_level integer, tile_column integer, tile_row integer, tile_data blob)";
    database.execute_batch(table).unwrap();
    for (x, row) in [(0, 1), (1, 0), (1, 1)] {
        let mut tile = terrarium(f64::from(100 * x + 10 * row));
        tile.resize(3 << 20, 0);
        database.execute("INSERT INTO tiles VALUES (1, ?1, ?2, ?3)", (x, row, tile)).unwrap();
    }
    let raster = Raster::read_in(&path, &terrarium_options()).unwrap();
    assert_eq!((raster.size(), raster.range_m().unwrap()), ([16, 16], [10.0, 110.0]));
}
