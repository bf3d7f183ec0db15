//! Datum shifts by NTv2 grids that the user names.

use std::fs;
use std::path::{Path, PathBuf};

use terrane_data_gen::{GenArgs, VerticalDatum, run};

use crate::files::{from_dem, region, tileset};
use crate::grid_files::{grid_tiff, ntv2};
use crate::tiffs::{Image, Values, tiff};

/// Returns options for a set from elevation in degrees of a datum, 8 to 8.6 degrees east and 46 degrees north.
fn args(folder: &Path, datum: u16) -> GenArgs {
    let keys = crate::files::geo_keys(&[[1024, 2], [1025, 1], [2048, datum]]);
    let image = Image::new([60, 60], 16, 1, [1, 1].repeat(3600)).at([8.0, 46.0], [0.01; 2]);
    from_dem(folder, "dem.tif", &tiff(vec![image.with(34735, Values::Short(keys))]))
}

fn write(folder: &Path, bytes: &[u8]) -> Option<PathBuf> {
    let path = folder.join("grid.gsb");
    fs::write(&path, bytes).unwrap();
    Some(path)
}

#[test]
fn grids_shift_datums_other_than_wgs84() {
    let folder = tempfile::tempdir().unwrap();
    // DHDN; without the grid EPSG's parameters shift by about 100 m.
    let args = args(folder.path(), 4314);
    let bounds = |args: &GenArgs| {
        run(&GenArgs { overwrite: true, ..args.clone() }).unwrap();
        region(&tileset(&args.out)["root"])
    };
    let plain = bounds(&args);
    for is_little in [true, false] {
        let grid = ntv2([3.6, 7.2], [5.0, 44.0, 12.0, 50.0], is_little);
        let found = bounds(&GenArgs { datum_grid: write(folder.path(), &grid), ..args.clone() });
        let expected = [8.007, 45.406, 8.597, 45.996f64].map(f64::to_radians);
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}, not {expected:?}");
        assert!((plain[0] - found[0]).abs() > 1e-7);
    }
}

#[test]
fn grids_in_geotiff_shift_as_those_in_ntv2() {
    let folder = tempfile::tempdir().unwrap();
    let args = args(folder.path(), 4314);
    let area = [5.0, 44.0, 12.0, 50.0];
    let bounds = |bytes: &[u8]| {
        let args = GenArgs { datum_grid: write(folder.path(), bytes), overwrite: true, ..args.clone() };
        run(&args).map(|_| region(&tileset(&args.out)["root"])).map_err(|e| e.to_string())
    };
    let expected = bounds(&ntv2([3.6, 7.2], area, true)).unwrap();
    let [north, east] = ["latitude_offset", "longitude_offset"];
    let west = "<Item name=\"positive_value\" sample=\"1\">west</Item>";
    let degrees: String =
        (0..2).map(|k| format!("<Item name=\"UNITTYPE\" sample=\"{k}\" role=\"unittype\">degree</Item>")).collect();
    for grid in [
        grid_tiff(&[(3.6, north), (7.2, east)], area, "<Item name=\"TYPE\">HORIZONTAL_OFFSET</Item>"),
        grid_tiff(&[(7.2, east), (3.6, north)], area, ""),
        grid_tiff(&[(3.6, north), (-7.2, east)], area, west),
        grid_tiff(&[(0.001, north), (0.002, east)], area, &degrees),
    ] {
        let found = bounds(&grid).unwrap();
        assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}, not {expected:?}");
    }
    for (grid, why) in [
        (grid_tiff(&[(1.0, "geoid_undulation")], area, ""), "no channel latitude_offset"),
        (grid_tiff(&[(1.0, north), (1.0, east)], area, "<Item name=\"TYPE\">VELOCITY</Item>"), "of the type VELOCITY"),
    ] {
        let error = bounds(&grid).unwrap_err();
        assert!(error.contains("grid.gsb: ") && error.contains(why), "{error}");
    }
    let whole = grid_tiff(&[(3.6, north), (7.2, east)], area, "");
    for cut in (0..whole.len()).step_by(37) {
        let error = bounds(&whole[..cut]).unwrap_err();
        assert!(error.contains("grid.gsb"), "{cut}: {error}");
    }
}

/// The heights of geoids of NOAA and other agencies are GeoTIFFs.
#[test]
fn geoids_in_geotiff_raise_heights() {
    let folder = tempfile::tempdir().unwrap();
    let args = args(folder.path(), 4326);
    let plain = run(&args).unwrap();
    let raised = |bytes: &[u8]| {
        let vertical_datum = VerticalDatum::Geoid(write(folder.path(), bytes).unwrap());
        run(&GenArgs { vertical_datum, overwrite: true, ..args.clone() }).map_err(|e| e.to_string())
    };
    let area = [5.0, 44.0, 12.0, 50.0];
    let grid = grid_tiff(&[(1.0, "other"), (48.5, "geoid_undulation")], area, "");
    assert_eq!(raised(&grid).unwrap().max_height_m, plain.max_height_m + 48.5);
    let shift =
        grid_tiff(&[(0.5, "vertical_offset")], area, "<Item name=\"TYPE\">VERTICAL_OFFSET_VERTICAL_TO_VERTICAL</Item>");
    assert!(raised(&shift).unwrap_err().contains("not VERTICAL_OFFSET_GEOGRAPHIC_TO_VERTICAL"));
}

#[test]
fn grids_without_effect_and_damaged_ones_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let grid = ntv2([3.6, 7.2], [5.0, 44.0, 12.0, 50.0], true);
    let error = |datum: u16, bytes: &[u8]| {
        let args = GenArgs { datum_grid: write(folder.path(), bytes), ..args(folder.path(), datum) };
        run(&args).unwrap_err().to_string()
    };
    assert!(error(4326, &grid).contains("--datum-grid has no effect"));
    let elsewhere = ntv2([3.6, 7.2], [15.0, 44.0, 22.0, 50.0], true);
    assert!(error(4314, &elsewhere).contains("dem.tif: reaches beyond the grid of --datum-grid"));
    for length in [0, 8, 100, 180, 400, grid.len() - 100] {
        let reason = error(4314, &grid[..length]);
        assert!(reason.contains("grid.gsb: NTv2 grid: "), "{length}: {reason}");
    }
    // Each number of the headers, replaced: by one of these values, or by all in long tests.
    let values = [f64::NAN.to_le_bytes(), f64::INFINITY.to_le_bytes(), [255; 8], [0; 8]];
    for at in (0..352).step_by(8) {
        let chosen = if kit::long_tests() { &values[..] } else { &values[at / 8 % 4..][..1] };
        for value in chosen {
            let mut damaged = grid.clone();
            damaged[at..at + 8].copy_from_slice(value);
            let args =
                GenArgs { datum_grid: write(folder.path(), &damaged), overwrite: true, ..args(folder.path(), 4314) };
            // Success is not checked: only a panic would be wrong.
            let _ = run(&args);
        }
    }
    let none = GenArgs { datum_grid: write(folder.path(), &grid), ..GenArgs::new(folder.path().join("none")) };
    assert!(run(&none).unwrap_err().to_string().contains("no effect without --dem or --imagery"));
}

/// Germany's grid, where PROJ's data is installed.
#[test]
fn positions_are_those_of_proj() {
    let grid = Path::new("/usr/share/proj/BETA2007.gsb");
    if !grid.is_file() {
        println!("skipped: {} is not installed", grid.display());
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let header = "ncols 65\nnrows 65\nxllcenter 3500000\nyllcenter 5500000\ncellsize 30\n";
    let heights: String = (0..65 * 65).map(|k| format!("{k} ")).collect();
    let args = from_dem(folder.path(), "dem.asc", (header.to_owned() + &heights).as_bytes());
    let epsg = terrane_data_gen::Crs::from_epsg(31467);
    let args = GenArgs { epsg, datum_grid: Some(grid.to_owned()), ..args };
    run(&args).unwrap();
    // The corners by cs2cs with +proj=tmerc ... +nadgrids=BETA2007.gsb, PROJ 9.1.
    let expected = [8.998_958_772_2, 49.636_705_371_3, 9.025_548_439_6, 49.653_971_034];
    let found = region(&tileset(&args.out)["root"]);
    for (found, expected) in found.iter().zip(expected) {
        let apart_m = (found.to_degrees() - expected).abs() * 111_320.0;
        assert!(apart_m < 0.005, "{found}: {apart_m} m");
    }
}
