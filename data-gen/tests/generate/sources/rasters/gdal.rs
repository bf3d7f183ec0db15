//! Files that GDAL 3.6 wrote: JPEG 2000 and USGS DEM.

use std::fs;

use super::{at, check_bounds, error, usual};
use terrane_data_gen::{Raster, RasterOptions};

/// 12 x 10 signed samples of `-300 + 37 x - 11 y²`: placed by GeoJP2 in UTM, by GMLJP2 in degrees, and without boxes.
pub const JPEG_2000: [&[u8]; 3] = [include_bytes!("geo.jp2"), include_bytes!("gml.jp2"), include_bytes!("raw.j2k")];
/// 5 x 6 heights in UTM.
pub const USGS_DEM: &[u8] = include_bytes!("small.dem");

#[test]
fn jpeg_2000_is_placed_by_its_boxes() {
    let folder = tempfile::tempdir().unwrap();
    let [geo, gml, raw] = JPEG_2000;
    let path = folder.path().join("a.jp2");
    fs::write(&path, gml).unwrap();
    let raster = Raster::read(&path).unwrap();
    assert_eq!((raster.size(), raster.range_m().unwrap()), ([12, 10], [-1191.0, 107.0]));
    check_bounds(&raster, [7.005, 46.405, 7.115, 46.495]);
    for (column, row) in [(0, 0), (11, 0), (5, 4), (0, 9), (11, 9)] {
        let found = at(&raster, 7.005 + 0.01 * f64::from(column), 46.495 - 0.01 * f64::from(row));
        assert!((found - (-300 + 37 * column - 11 * row * row) as f32).abs() < 0.01, "{found} at {column}, {row}");
    }
    fs::write(&path, geo).unwrap();
    let raster = Raster::read(&path).unwrap();
    assert_eq!(raster.range_m().unwrap(), [-1191.0, 107.0]);
    // The middle of the first pixel, 500015 5199985, as PROJ converts it.
    assert!((raster.bounds()[3].to_degrees() - 46.953_394).abs() < 1e-5, "{:?}", raster.bounds().map(f64::to_degrees));
    assert!((at(&raster, 9.000_197_1, 46.953_393_9) + 300.0).abs() < 1.0);
    // Without boxes, a world file says where it is; without that, an error says what is missing.
    fs::write(&path, raw).unwrap();
    assert!(error(&path, &usual()).contains("no georeference: neither GeoJP2, GMLJP2, nor a world file"));
    fs::write(path.with_extension("wld"), "0.01\n0\n0\n-0.01\n7.005\n46.495\n").unwrap();
    check_bounds(&Raster::read(&path).unwrap(), [7.005, 46.405, 7.115, 46.495]);
    let voids = RasterOptions { nodata: Some(107.0), ..usual() };
    assert_eq!(Raster::read_in(&path, &voids).unwrap().range_m().unwrap(), [-1191.0, 96.0]);
    // A huge size in the header is refused before anything is allocated.
    let mut huge = raw.to_vec();
    huge[8..16].fill(0x7f);
    fs::write(&path, huge).unwrap();
    assert!(error(&path, &usual()).contains("samples are decoded at once"));
    let two = RasterOptions { channel: Some("2".to_owned()), ..usual() };
    fs::write(&path, raw).unwrap();
    assert!(error(&path, &two).contains("--channel 2: the file has components 1 to 1"));
}

#[test]
fn usgs_dem_has_profiles_from_the_south() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.dem");
    let lines: Vec<u8> = USGS_DEM.chunks(1024).flat_map(|record| [record, b"\r\n"].concat()).collect();
    for bytes in [USGS_DEM, &lines] {
        fs::write(&path, bytes).unwrap();
        let raster = Raster::read(&path).unwrap();
        assert_eq!((raster.size(), raster.range_m().unwrap()), ([5, 6], [425.0, 848.0]));
        // 500000 5200000, as PROJ converts it: the north-western height. GDAL moves profiles to whole steps, 10 m to the south.
        assert!((at(&raster, 9.0, 46.953_529) - 700.0).abs() < 1.0, "{}", at(&raster, 9.0, 46.953_529));
    }
    for (bytes, why) in [
        (USGS_DEM[..3000].to_vec(), "profile 3 of 5 has no"),
        (
            [&USGS_DEM[..1024 + 12], b"  -146", &USGS_DEM[1024 + 18..]].concat(),
            "profile 1 of 5 has no number of heights",
        ),
        ([&USGS_DEM[..156], b"     2", &USGS_DEM[162..]].concat(), "a reference system that is not supported"),
        ([&USGS_DEM[..1024 + 150], b"  high", &USGS_DEM[1024 + 156..]].concat(), "height 2 of profile 1 is no number"),
    ] {
        fs::write(&path, bytes).unwrap();
        let error = error(&path, &usual());
        assert!(error.contains(why), "{error}, not {why}");
    }
}
