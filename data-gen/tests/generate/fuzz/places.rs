//! Fuzzes what places rasters: the files beside them, reference systems, and the grids of datums and geoids.

use super::rasters::{exr, names_the_file, read};
use crate::files::{PLACE, from_dem, heights, tiff_int16};
use crate::grid_files::{grid_tiff, ntv2};
use crate::tiffs::{Image, Values, tiff};
use kit::fuzz::Parser;
use terrane::fetch::DECODER_PANICKED;
use terrane_data_gen::{Crs, GenArgs, RasterOptions, VerticalDatum, predict};

/// WKT of ESRI, of GDAL and of ISO.
const SYSTEMS: [&str; 4] = [
    r#"PROJCS["a",GEOGCS["b",DATUM["D_OSGB_1936",SPHEROID["Airy_1830",6377563.396,299.3249646]],PRIMEM["Greenwich",0.0],UNIT["Degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],PARAMETER["False_Easting",400000.0],PARAMETER["False_Northing",-100000.0],PARAMETER["Central_Meridian",-2.0],PARAMETER["Scale_Factor",0.9996],PARAMETER["Latitude_Of_Origin",49.0],UNIT["Meter",1.0]],VERTCS["c",VDATUM["d"]]"#,
    r#"PROJCS["WGS 84 / x",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],TOWGS84[1,2,3,0,0,0,0]],PRIMEM["Paris",2.3],UNIT["degree",0.0174532925199433]],PROJECTION["Lambert_Conformal_Conic_2SP"],PARAMETER["standard_parallel_1",42],PARAMETER["standard_parallel_2",41],UNIT["metre",1],EXTENSION["PROJ4","+proj=merc +a=6378137 +k=1"],AUTHORITY["EPSG","3857"]]"#,
    r#"PROJCRS["a",BASEGEOGCRS["b",DATUM["European Datum 1950",ELLIPSOID["International 1924",6378388,297,LENGTHUNIT["metre",1]]],PRIMEM["Greenwich",0,ANGLEUNIT["degree",0.0174532925199433]]],CONVERSION["c",METHOD["Lambert Azimuthal Equal Area",ID["EPSG",9820]],PARAMETER["Latitude of natural origin",52,ANGLEUNIT["degree",0.0174532925199433],ID["EPSG",8801]]],CS[Cartesian,2],AXIS["x",east],AXIS["y",north],LENGTHUNIT["metre",1],ID["EPSG",3035]]"#,
    "+proj=omerc +lat_0=4 +lonc=102.25 +alpha=323 +gamma=323.13 +k=0.99984 +ellps=evrstSS +towgs84=-679,669,-48 +units=m",
];

/// Any text that names a system. Positions in it are numbers, or NaN.
fn reference_system() -> Parser {
    let codes =
        ["EPSG:2056", "27700", "+init=epsg:31467 +no_defs", "+proj=longlat +pm=paris +ellps=clrk80 +nadgrids=@null"];
    Parser::new("reference-system", SYSTEMS.into_iter().chain(codes), |bytes| {
        match Crs::parse(&String::from_utf8_lossy(bytes)) {
            Ok(crs) => {
                for [x, y] in [[0.1, 0.8], [-3.1, -1.57], [f64::NAN, 0.0], [1e300, -1e300]] {
                    crs.project(x, y);
                    crs.unproject(x * 1e6, y * 1e6);
                }
            }
            Err(reason) => assert!(!reason.is_empty() && !reason.ends_with(DECODER_PANICKED), "{reason}"),
        }
    })
}

/// Files beside a raster without a place.
fn beside(name: &'static str, raster: &[u8], extension: &'static str, seeds: &[String]) -> Parser {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    std::fs::write(&path, raster).unwrap();
    if extension == "prj" {
        std::fs::write(path.with_extension("wld"), "0.001\n0\n0\n-0.001\n7.5\n46.5\n").unwrap();
    }
    Parser::new(name, seeds, move |bytes| {
        let _ = &folder;
        std::fs::write(path.with_extension(extension), bytes).unwrap();
        read(&path, &RasterOptions::default());
    })
}

fn world_file() -> Parser {
    beside("world-file", &exr(), "wld", &["0.001\n0\n0\n-0.001\n7.5\n46.5\n".to_owned()])
}

fn system_file() -> Parser {
    beside("system-file", &exr(), "prj", &SYSTEMS.map(str::to_owned))
}

/// GDAL's and ArcGIS's metadata beside a TIFF with no place of its own.
fn metadata_file() -> Parser {
    let escaped = |system: &str| system.replace('"', "&quot;");
    let samples = (1..=400u16).flat_map(u16::to_le_bytes).collect();
    let raster = tiff(vec![Image::new([20; 2], 16, 1, samples)]);
    let seeds = SYSTEMS.map(|system| {
        format!(
            "<PAMDataset><SRS dataAxisToSRSAxisMapping=\"1,2\">{}</SRS><GeoTransform> 4e5, 30, 0, 2e5, 0, -30\
             </GeoTransform><PAMRasterBand band=\"1\"><NoDataValue le_hex_equiv=\"00\">-9999</NoDataValue>\
             <UnitType>ft</UnitType><Offset>2</Offset><Scale>0.5</Scale></PAMRasterBand></PAMDataset>",
            escaped(system)
        )
    });
    beside("metadata-file", &raster, "exr.aux.xml", &seeds)
}

/// Grids that shift a datum or raise heights, with which a set is predicted.
fn grid(name: &'static str, file: &str, seeds: &[Vec<u8>], with: fn(&mut GenArgs, std::path::PathBuf)) -> Parser {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(file);
    // DHDN, which the grid shifts.
    let keys = crate::files::geo_keys(&[[1024, 2], [1025, 1], [2048, 4314]]);
    let image = Image::new([60, 60], 16, 1, [1, 1].repeat(3600)).at([8.0, 46.0], [0.01; 2]);
    let mut args = from_dem(folder.path(), "dem.tif", &tiff(vec![image.with(34735, Values::Short(keys))]));
    args.levels = Some(1);
    with(&mut args, path.clone());
    Parser::new(name, seeds, move |bytes| {
        let _ = &folder;
        std::fs::write(&path, bytes).unwrap();
        if let Err(error) = predict(&args) {
            let text = error.to_string();
            let is_told =
                ["grid.", "dem.tif", "--datum-grid", "--vertical-datum"].iter().any(|name| text.contains(name));
            assert!(is_told && !text.ends_with(DECODER_PANICKED), "{text}");
        }
    })
}

fn datum_grid() -> Parser {
    let area = [7.0, 44.0, 10.0, 47.0];
    let tiff = grid_tiff(&[(3.6, "latitude_offset"), (7.2, "longitude_offset")], area, "");
    let seeds = [ntv2([3.6, 7.2], area, true), ntv2([3.6, 7.2], area, false), tiff];
    grid("datum-grid", "grid.gsb", &seeds, |args, path| args.datum_grid = Some(path))
}

fn geoid() -> Parser {
    let area = [7.0, 44.0, 10.0, 47.0];
    let mut gtx: Vec<u8> = [44.0, 7.0, 1.0, 1.0f64].into_iter().flat_map(f64::to_be_bytes).collect();
    gtx.extend([4i32, 4].into_iter().flat_map(i32::to_be_bytes));
    gtx.extend((0..16u16).flat_map(|k| f32::from(k).to_be_bytes()));
    let seeds = [gtx, grid_tiff(&[(1.0, "other"), (48.5, "geoid_undulation")], area, "")];
    grid("geoid", "grid.gtx", &seeds, |args, path| args.vertical_datum = VerticalDatum::Geoid(path))
}

kit::parsers! {
    reference_system,
    world_file,
    system_file,
    metadata_file,
    datum_grid,
    geoid,
}

/// Otherwise little of the readers is reached.
#[test]
fn seeds_are_valid() {
    for system in SYSTEMS {
        Crs::parse(system).unwrap();
    }
    let folder = tempfile::tempdir().unwrap();
    let dem = tiff_int16(&heights(), Some(PLACE), None);
    predict(&from_dem(folder.path(), "dem.tif", &dem)).unwrap();
}

/// Regression: the crate `proj4rs` cuts angles at bytes and panicked at characters of several bytes, such as the sign of degrees.
#[test]
fn angles_have_signs_of_degrees() {
    let at = |angle: &str| Crs::parse(&format!("+proj=tmerc +lat_0={angle} +lon_0=9 +ellps=GRS80"));
    let [found, expected] = ["38°30'9\"", "38.5025"].map(|angle| at(angle).unwrap().project(0.15, 0.7));
    assert!((found[1] - expected[1]).abs() < 1e-6, "{found:?}, not {expected:?}");
    for angle in ["38\u{fffd}30'9\"", "\u{fffd}o\"\"\"\"", "38º30'"] {
        assert!(at(angle).unwrap_err().contains("a definition with the character"), "{angle}");
    }
}

/// Regression: brackets in brackets overflowed the stack of the reader of WKT, and the process ended.
#[test]
fn wkt_of_many_brackets_is_refused() {
    let deep = "A[".repeat(200_000) + "1" + &"]".repeat(200_000);
    for text in [deep.clone(), format!("PROJCS[\"a\",{deep}]"), "A(".repeat(200_000) + "[", "GEOGCS[".repeat(200_000)] {
        let reason = Crs::parse(&text).unwrap_err();
        assert!(reason.starts_with("WKT: ") && reason.len() < 200, "{reason}");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    std::fs::write(&path, exr()).unwrap();
    std::fs::write(path.with_extension("wld"), "30\n0\n0\n-30\n5e5\n5e6\n").unwrap();
    std::fs::write(path.with_extension("prj"), &deep).unwrap();
    let error = terrane_data_gen::Raster::read(&path).err().unwrap();
    names_the_file(&path, &error);
}
