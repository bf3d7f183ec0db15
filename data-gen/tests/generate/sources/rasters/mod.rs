//! Formats of other programs: netCDF, Erdas Imagine, grids of Surfer and SAGA, JPEG 2000, USGS DEM, cubes of ISIS, PDS4, warped
//! virtual rasters.

pub mod erdas;
pub mod gdal;
pub mod grids;
pub mod netcdf;
mod places;
pub mod planetary;

use std::path::Path;

use terrane_data_gen::{ElevationSource as _, Raster, RasterOptions};

fn usual() -> RasterOptions {
    RasterOptions::default()
}

fn error(path: &Path, options: &RasterOptions) -> String {
    let error = Raster::read_in(path, options).and_then(|raster| raster.range_m()).err().unwrap().to_string();
    assert!(error.contains(&*path.file_stem().unwrap().to_string_lossy()) && error.lines().count() == 1, "{error}");
    error
}

/// Returns the height at a longitude and latitude in degrees, NaN where it is unknown.
fn at(raster: &Raster, longitude: f64, latitude: f64) -> f32 {
    raster.height_m(longitude.to_radians(), latitude.to_radians()).unwrap().map_or(f32::NAN, |height_m| height_m as f32)
}

/// Checks the place of the outermost samples in degrees.
fn check_bounds(raster: &Raster, expected: [f64; 4]) {
    let found = raster.bounds().map(f64::to_degrees);
    assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?}, not {expected:?}");
}
