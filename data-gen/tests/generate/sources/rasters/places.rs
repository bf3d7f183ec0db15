//! Places that programs write in ways of their own: projections that GeoTIFF lacks, sizes of HGT.

use std::fs;

use terrane_data_gen::Raster;

use super::{at, check_bounds, error, usual};
use crate::tiffs::{Image, Values, tiff};

/// Returns a raster of 4 x 3 samples.
fn image([west, north]: [f64; 2], pixel: f64) -> Image {
    Image::new([4, 3], 8, 1, (0..12).collect()).at([west, north], [pixel, pixel])
}

/// Regression: GDAL gives a projection that GeoTIFF lacks the code of its base, and the text of ArcGIS. Its metres were read as degrees.
#[test]
fn projections_that_geotiff_lacks_are_read_from_the_text_of_arcgis() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mollweide.tif");
    let text = "World_Mollweide|WGS 84|ESRI PE String = PROJCS[\"World_Mollweide\",GEOGCS[\"GCS_WGS_1984\",DATUM[\"D_WGS_1984\",\
                SPHEROID[\"WGS_1984\",6378137.0,298.257223563]],PRIMEM[\"Greenwich\",0.0],UNIT[\"Degree\",0.0174532925199433]],\
                PROJECTION[\"Mollweide\"],PARAMETER[\"False_Easting\",0.0],PARAMETER[\"False_Northing\",0.0],\
                PARAMETER[\"Central_Meridian\",0.0],UNIT[\"Meter\",1.0]]|\0";
    let keys = |keys: &[[u16; 4]]| {
        let all = [&[[1, 1, 0, keys.len() as u16]], keys].concat();
        Values::Short(all.concat())
    };
    let user = 32767;
    let length = text.len() as u16 - 23;
    let all = [[1024, 0, 1, user], [1025, 0, 1, 1], [2048, 0, 1, 4326], [3073, 34737, length, 23], [3076, 0, 1, 9001]];
    let place = image([-1_000_000.0, 5_000_000.0], 500_000.0);
    let raster = place.with(34735, keys(&all)).with(34737, Values::Text(text.to_owned()));
    fs::write(&path, tiff(vec![raster])).unwrap();
    // PROJ: `cs2cs ESRI:54009 EPSG:4326` of -750000 4750000.
    let found = Raster::read(&path).unwrap().bounds().map(f64::to_degrees);
    assert!((found[0] + 8.802_777).abs() < 1e-5 && (found[3] - 39.647_855).abs() < 1e-5, "{found:?}");
}

/// North of 50 degrees some files of a second have half of the columns.
#[test]
fn hgt_has_one_of_four_sizes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("N60E010.hgt");
    let file = fs::File::create(&path).unwrap();
    file.set_len(2 * 1801 * 3601).unwrap();
    let raster = Raster::read(&path).unwrap();
    assert_eq!((raster.size(), at(&raster, 10.0, 61.0)), ([1801, 3601], 0.0));
    check_bounds(&raster, [10.0, 60.0, 11.0, 61.0]);
    file.set_len(2 * 1000 * 1000).unwrap();
    assert!(error(&path, &usual()).contains("not 1201 x 1201, 1801 x 3601, 3601 x 3601, 7201 x 7201 samples"));
}
