//! Cubes of ISIS and images of PDS4, with labels as GDAL 3.6 writes them.

use std::fs;

use super::{at, check_bounds, error, usual};
use terrane_data_gen::Raster;

/// Returns the 12 x 10 samples of a file, row by row: `1000 + 37 x - 11 y²`, and one without data.
fn sample(column: usize, row: usize) -> i16 {
    if (column, row) == (7, 4) { -32768 } else { 1000 + 37 * column as i16 - 11 * (row * row) as i16 }
}

pub const LATITUDES: &str = "ProjectionName = SimpleCylindrical
    CenterLongitude = 0.0\n    CenterLatitude = 0.0
    UpperLeftCornerX = 303233.504241494811\n    UpperLeftCornerY = 606467.008482989622
    PixelResolution = 303.233504241494813 <meters/pixel>";

/// Returns a cube of ISIS, in tiles of 8 x 4 samples or in rows.
pub fn cube(is_tiled: bool, mapping: &str) -> Vec<u8> {
    let format = if is_tiled { "Tile\n    TileSamples = 8\n    TileLines = 4" } else { "BandSequential" };
    let label = format!(
        "Object = IsisCube
  Object = Core
    StartByte = 2049
    Format = {format}
    Group = Dimensions
      Samples = 12
      Lines = 10
      Bands = 1
    End_Group
    Group = Pixels
      Type = SignedWord
      ByteOrder = Lsb
      Base = 0.0
      Multiplier = 1.0
    End_Group
  End_Object
  Group = Mapping
    TargetName = Moon
    EquatorialRadius = 1737400.0 <meters>
    PolarRadius = 1737400.0 <meters>
    LatitudeType = Planetocentric
    LongitudeDirection = PositiveEast
    {mapping}
  End_Group
End_Object
End
"
    );
    let mut bytes = label.into_bytes();
    bytes.resize(2048, 0);
    let mut add = |column: usize, row: usize| {
        let own = if column < 12 && row < 10 { sample(column, row) } else { 0 };
        bytes.extend(own.to_le_bytes());
    };
    match is_tiled {
        false => (0..120).for_each(|k| add(k % 12, k / 12)),
        true => (0..6 * 32).for_each(|k| add(k / 32 % 2 * 8 + k % 8, k / 64 * 4 + k / 8 % 4)),
    }
    bytes
}

#[test]
fn cubes_of_isis_are_placed_by_their_mapping() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.cub");
    for is_tiled in [false, true] {
        fs::write(&path, cube(is_tiled, LATITUDES)).unwrap();
        let raster = Raster::read(&path).unwrap();
        assert_eq!((raster.size(), raster.range_m().unwrap()), ([12, 10], [109.0, 1407.0]));
        check_bounds(&raster, [10.005, 19.905, 10.115, 19.995]);
        for (column, row) in [(0, 0), (11, 0), (8, 3), (7, 5), (0, 9), (11, 9)] {
            let found = at(&raster, 10.005 + 0.01 * column as f64, 19.995 - 0.01 * row as f64);
            assert!((found - f32::from(sample(column, row))).abs() < 0.01, "{found} at {column}, {row}");
        }
        assert!(at(&raster, 10.075, 19.955).is_nan());
    }
    // The middle of the sample in the column 11 and the row 9, as PROJ converts it: 2150, 4050.
    let polar = "ProjectionName = PolarStereographic\n    CenterLongitude = 0.0\n    CenterLatitude = 90.0
        UpperLeftCornerX = 1.0 <km>\n    UpperLeftCornerY = 5000\n    PixelResolution = 100.0";
    fs::write(&path, cube(true, polar)).unwrap();
    let raster = Raster::read(&path).unwrap();
    assert!((at(&raster, 152.037_767_8, 89.848_786_5) - f32::from(sample(11, 9))).abs() < 1.0);
    let usual_cube = cube(true, LATITUDES);
    let changed = |from: &str, to: &str| {
        let text = String::from_utf8_lossy(&usual_cube[..1500]).replacen(from, to, 1);
        let mut bytes = text.into_bytes();
        bytes.resize(2048, 0);
        [&bytes, &usual_cube[2048..]].concat()
    };
    for (bytes, why) in [
        (usual_cube[..2300].to_vec(), "2300 bytes for 12 x 10 samples"),
        (changed("TileLines = 4", "TileLines = 0"), "tiles of a size that is not supported"),
        (changed("SignedWord", "Complex"), "samples of the type `Complex`"),
        (changed("SimpleCylindrical", "Mollweide"), "the projection `Mollweide`"),
        (changed("PolarRadius = 1737400.0", "PolarRadius = 1736000.0"), "planetocentric latitudes on an ellipsoid"),
        (changed("PositiveEast", "PositiveWest"), "longitudes to the west"),
        (changed("Group = Mapping", "Group = Nothing"), "no georeference"),
        (changed("StartByte = 2049", "^Core = a.dat"), "samples in another file"),
    ] {
        fs::write(&path, bytes).unwrap();
        let error = error(&path, &usual());
        assert!(error.contains(why), "{error}, not {why}");
    }
}

/// Returns a label of PDS4.
pub fn label() -> String {
    let axis = |name: &str, count: u32| {
        format!("<Axis_Array><axis_name>{name}</axis_name><elements>{count}</elements></Axis_Array>")
    };
    let axes: String = [("Band", 1), ("Line", 10), ("Sample", 12)].map(|(name, count)| axis(name, count)).concat();
    format!(
        r#"<?xml version="1.0" encoding="UTF-8"?>
        <Product_Observational xmlns="http://pds.nasa.gov/pds4/pds/v1" xmlns:cart="http://pds.nasa.gov/pds4/cart/v1">
        <Observation_Area><Discipline_Area><cart:Cartography><cart:Map_Projection>
        <cart:map_projection_name>Equirectangular</cart:map_projection_name><cart:Equirectangular>
        <cart:latitude_of_projection_origin unit="deg">0</cart:latitude_of_projection_origin>
        <cart:standard_parallel_1 unit="deg">0</cart:standard_parallel_1>
        <cart:longitude_of_central_meridian unit="deg">30</cart:longitude_of_central_meridian></cart:Equirectangular>
        </cart:Map_Projection><cart:pixel_resolution_x unit="km/pixel">0.1</cart:pixel_resolution_x>
        <cart:pixel_resolution_y unit="m/pixel">100</cart:pixel_resolution_y>
        <cart:upperleft_corner_x unit="m">1000</cart:upperleft_corner_x>
        <cart:upperleft_corner_y unit="m">5000</cart:upperleft_corner_y>
        <cart:latitude_type>Planetocentric</cart:latitude_type><cart:a_axis_radius unit="km">1737.4</cart:a_axis_radius>
        <cart:c_axis_radius unit="m">1737400</cart:c_axis_radius>
        <cart:longitude_direction>Positive East</cart:longitude_direction></cart:Cartography></Discipline_Area>
        </Observation_Area><File_Area_Observational><File><file_name>a.img</file_name></File><Array_3D_Image>
        <offset unit="byte">6</offset><axes>3</axes><axis_index_order>Last Index Fastest</axis_index_order>
        <Element_Array><data_type>SignedMSB2</data_type><unit>m</unit><scaling_factor>0.5</scaling_factor>
        <value_offset>100</value_offset></Element_Array>{axes}
        <Special_Constants><missing_constant>-32768</missing_constant></Special_Constants></Array_3D_Image>
        </File_Area_Observational></Product_Observational>"#
    )
}

#[test]
fn images_of_pds4_are_placed_by_their_label() {
    let folder = tempfile::tempdir().unwrap();
    let (path, beside) = (folder.path().join("a.img"), folder.path().join("a.xml"));
    let mut bytes = vec![0; 6];
    bytes.extend((0..120).flat_map(|k| sample(k % 12, k / 12).to_be_bytes()));
    fs::write(&path, bytes).unwrap();
    fs::write(&beside, label()).unwrap();
    let raster = Raster::read(&path).unwrap();
    assert_eq!((raster.size(), raster.range_m().unwrap()), ([12, 10], [154.5, 803.5]));
    // Middles of samples, as PROJ converts them: 1050 4950 and 2150 4050.
    let degrees = |metres: f64| (metres / 1_737_400.0).to_degrees();
    for ((x, y), (column, row)) in [((1050.0, 4950.0), (0, 0)), ((2150.0, 4050.0), (11, 9))] {
        let found = at(&raster, 30.0 + degrees(x), degrees(y));
        assert!((found - 100.0 - 0.5 * f32::from(sample(column, row))).abs() < 0.01, "{found}");
    }
    assert!(error(&beside, &usual()).contains("name the file of its samples"));
    for (from, to, why) in [
        ("a.img", "b.img", "no file `a.img` in the label"),
        ("SignedMSB2", "ComplexMSB8", "samples of the type `ComplexMSB8`"),
        ("<elements>1<", "<elements>3<", "3 bands"),
        ("<elements>10<", "<elements>1000<", "246 bytes for 12 x 1000 samples"),
        ("Equirectangular</", "Sinusoidal</", "the projection `Sinusoidal`"),
        ("Positive East", "Positive West", "longitudes to the west"),
        ("unit=\"m\">1000", "unit=\"furlong\">1000", "upperleft_corner_x in `furlong`"),
        ("cart:Cartography", "cart:Other", "PDS4"),
    ] {
        fs::write(&beside, label().replacen(from, to, 1)).unwrap();
        let error = error(&path, &usual());
        assert!(error.contains(why), "{error}, not {why}");
    }
    // Grids of Esri are folders of files.
    let grid = folder.path().join("hdr.adf");
    fs::write(&grid, b"GRID1.2\0 and more").unwrap();
    assert!(error(&grid, &usual()).contains("a binary grid of Esri; gdal_translate writes it as GeoTIFF"));
}
