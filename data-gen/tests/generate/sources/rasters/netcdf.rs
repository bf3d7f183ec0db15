//! netCDF, written by the crate `netcdf-writer`.

use std::fs;
use std::path::Path;

use netcdf_writer::{NcAttrValue, NcFileBuilder, NcWriteFormat, NcWriteOptions};
use terrane_data_gen::{Raster, RasterOptions};

use super::{at, check_bounds, error, usual};

/// A grid of 4 x 3 samples, whose first axis goes down.
struct Grid<'a> {
    /// The axes: their names, coordinates and units.
    down: (&'a str, Vec<f64>, &'a str),
    across: (&'a str, Vec<f64>, &'a str),
    name: &'a str,
    values: Vec<i16>,
    texts: Vec<(&'a str, &'a str)>,
    numbers: Vec<(&'a str, f64)>,
    fill: Option<i16>,
    /// The text of a reference system.
    wkt: Option<&'a str>,
}

impl Grid<'_> {
    /// Latitudes from the south, as GEBCO has them.
    fn usual() -> Self {
        Self {
            down: ("lat", vec![45.0, 45.5, 46.0], "degrees_north"),
            across: ("lon", vec![7.0, 7.5, 8.0, 8.5], "degrees_east"),
            name: "elevation",
            values: (0..12).map(|k| 100 * (k / 4) + k % 4).collect(),
            texts: vec![("units", "m")],
            numbers: Vec::new(),
            fill: None,
            wkt: None,
        }
    }

    fn write(&self, path: &Path, format: NcWriteFormat) {
        fs::write(path, self.bytes(format)).unwrap();
    }

    fn bytes(&self, format: NcWriteFormat) -> Vec<u8> {
        let mut file = NcFileBuilder::new();
        let mut axes = Vec::new();
        for (name, coordinates, unit) in [&self.down, &self.across] {
            let axis = file.add_dimension(*name, coordinates.len() as u64).unwrap();
            let variable = file.add_variable::<f64>(*name, &[axis]).unwrap();
            file.add_variable_attribute(variable, "units", NcAttrValue::Chars((*unit).to_owned())).unwrap();
            file.write_variable(variable, coordinates).unwrap();
            axes.push(axis);
        }
        let variable = file.add_variable::<i16>(self.name, &axes).unwrap();
        for (name, text) in &self.texts {
            file.add_variable_attribute(variable, *name, NcAttrValue::Chars((*text).to_owned())).unwrap();
        }
        for (name, number) in &self.numbers {
            file.add_variable_attribute(variable, *name, NcAttrValue::Doubles(vec![*number])).unwrap();
        }
        if let Some(fill) = self.fill {
            file.set_variable_fill_value(variable, fill).unwrap();
        }
        if let Some(wkt) = self.wkt {
            let none = file.add_char_variable("crs", &[]).unwrap();
            file.add_variable_attribute(none, "crs_wkt", NcAttrValue::Chars(wkt.to_owned())).unwrap();
            file.write_char_variable(none, b"x").unwrap();
            file.add_variable_attribute(variable, "grid_mapping", NcAttrValue::Chars("crs: lat lon".into())).unwrap();
        }
        if matches!(format, NcWriteFormat::Nc4) {
            file.set_variable_chunking(variable, [2, 3]).unwrap();
            file.set_variable_shuffle(variable, true).unwrap();
            file.set_variable_deflate(variable, Some(4), true).unwrap();
        }
        file.write_variable(variable, &self.values).unwrap();
        file.to_vec(NcWriteOptions { format }).unwrap().1
    }
}

/// Returns a file of each kind, for fuzzing.
pub fn files() -> Vec<Vec<u8>> {
    let all = [NcWriteFormat::Classic, NcWriteFormat::Offset64, NcWriteFormat::Nc4];
    all.map(|format| Grid::usual().bytes(format)).into()
}

#[test]
fn grids_are_placed_by_their_coordinates() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("gebco.nc");
    let mut north_first = Grid::usual();
    north_first.down.1.reverse();
    north_first.values = (0..12).map(|k| 100 * (2 - k / 4) + k % 4).collect();
    let mut columns_first = Grid::usual();
    std::mem::swap(&mut columns_first.down, &mut columns_first.across);
    columns_first.values = (0..12).map(|k| 100 * (k % 3) + k / 3).collect();
    for grid in [Grid::usual(), north_first, columns_first] {
        for format in [NcWriteFormat::Classic, NcWriteFormat::Offset64, NcWriteFormat::Nc4] {
            grid.write(&path, format);
            let raster = Raster::read(&path).unwrap();
            check_bounds(&raster, [7.0, 45.0, 8.5, 46.0]);
            assert_eq!(raster.range_m().unwrap(), [0.0, 203.0]);
            assert_eq!([at(&raster, 7.0, 45.0), at(&raster, 8.5, 45.5), at(&raster, 7.5, 46.0)], [0.0, 103.0, 201.0]);
        }
    }
}

#[test]
fn values_are_heights_in_metres() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("depth.nc");
    let mut grid = Grid::usual();
    grid.values[0] = -32767;
    grid.values[1] = 7;
    // Depths are below, and what no program wrote is unknown.
    grid.texts = vec![("units", "meters"), ("positive", "down")];
    grid.numbers = vec![("scale_factor", 0.5), ("add_offset", 10.0)];
    grid.write(&path, NcWriteFormat::Classic);
    let raster = Raster::read(&path).unwrap();
    assert_eq!((at(&raster, 8.5, 45.0), at(&raster, 7.5, 46.0)), (-11.5, -110.5));
    assert!(at(&raster, 7.0, 45.0).is_nan());
    let unknown = RasterOptions { nodata: Some(7.0), ..usual() };
    assert!(at(&Raster::read_in(&path, &unknown).unwrap(), 7.5, 45.0).is_nan());
    grid.fill = Some(7);
    grid.texts = vec![("units", "km")];
    grid.write(&path, NcWriteFormat::Nc4);
    let raster = Raster::read(&path).unwrap();
    assert!(at(&raster, 7.5, 45.0).is_nan());
    assert_eq!(at(&raster, 8.5, 45.0), 11_500.0);
    grid.texts = vec![("units", "K")];
    grid.write(&path, NcWriteFormat::Classic);
    assert!(error(&path, &usual()).contains("`elevation` is in units of `K`"));
}

#[test]
fn projected_grids_need_a_reference_system() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bed.nc");
    let mut grid = Grid::usual();
    grid.down = ("y", vec![20.0, 10.0, 0.0], "km");
    grid.across = ("x", vec![500.0, 510.0, 520.0, 530.0], "km");
    grid.write(&path, NcWriteFormat::Classic);
    assert!(error(&path, &usual()).contains("coordinates in metres, and no reference system; --epsg"));
    let wkt = r#"PROJCS["a",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],
        UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],
        PARAMETER["central_meridian",9],PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",500000],
        PARAMETER["false_northing",0],UNIT["metre",1],AUTHORITY["EPSG","32632"]]"#;
    grid.wkt = Some(wkt);
    grid.write(&path, NcWriteFormat::Classic);
    let raster = Raster::read(&path).unwrap();
    let [west, south, ..] = raster.bounds().map(f64::to_degrees);
    assert!((west - 9.0).abs() < 1e-9 && south.abs() < 1e-4, "{west} {south}");
    assert_eq!(at(&raster, 9.0, south), 200.0);
}

#[test]
fn files_without_one_grid_say_why() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("odd.nc");
    let check = |change: &dyn Fn(&mut Grid<'_>), why: &str| {
        let mut grid = Grid::usual();
        change(&mut grid);
        grid.write(&path, NcWriteFormat::Classic);
        let error = error(&path, &usual());
        assert!(error.contains(why), "{error}, not {why}");
    };
    check(&|grid| grid.down.1[1] = 45.1, "the coordinates of `lat` are not evenly spaced");
    check(&|grid| grid.down.1 = vec![45.0; 3], "not evenly spaced");
    check(&|grid| grid.down.1 = vec![f64::NAN; 3], "not evenly spaced");
    Grid::usual().write(&path, NcWriteFormat::Nc4);
    let named = RasterOptions { channel: Some("depth".to_owned()), ..usual() };
    assert!(error(&path, &named).contains("no variable `depth`; it has"));
    let named = RasterOptions { channel: Some("lat".to_owned()), ..usual() };
    assert!(error(&path, &named).contains("`lat` has 1 axes; a grid has two"));
    let whole = fs::read(&path).unwrap();
    // A file that is cut off, or damaged anywhere, is an error or has other heights.
    for cut in (0..whole.len()).step_by(97) {
        fs::write(&path, &whole[..cut]).unwrap();
        error(&path, &usual());
        let mut damaged = whole.clone();
        damaged[cut] ^= 0x5a;
        fs::write(&path, damaged).unwrap();
        let _ = Raster::read(&path).and_then(|raster| raster.range_m());
    }
}
