//! The reference system is that of the file, or that of `--epsg`, or degrees if the coordinates can be degrees.

use std::fs;
use std::path::Path;

use crate::files::{PLACE, SIDE, from_dem, heights, region, tiff_int16, tiff_int16_keyed, tileset};
use terrane::fetch::Limits;
use terrane::formats::verify;
use terrane::formats::writers::write_height_exr;
use terrane::math::{Ellipsoid, MARS, MOON};
use terrane_data_gen::{ContentKind, Crs, GenArgs, GenError, Raster, VerticalDatum, run, utm_to_geodetic};

/// Easting and northing of the north-western sample, and the pixel size, in metres; a point of the Alps in zone 32.
const PLANE: ([f64; 2], f64) = ([499_000.0, 5_150_000.0], 30.0);
const UTM_32: Crs = Crs::Utm { zone: 32, north: true };

fn world(path: &Path, ([west, north], pixel): ([f64; 2], f64)) {
    fs::write(path.with_extension("wld"), format!("{pixel}\n0\n0\n-{pixel}\n{west}\n{north}\n")).unwrap();
}

/// Returns the bounds of `PLANE` in a zone.
fn bounds(zone: u32) -> [f64; 4] {
    let ([west, north], pixel) = PLANE;
    let last = pixel * f64::from(SIDE - 1);
    let corners = [(west, north), (west + last, north), (west, north - last), (west + last, north - last)];
    corners.map(|(x, y)| utm_to_geodetic(zone, true, x, y)).into_iter().fold([9.0, 9.0, -9.0, -9.0], |b, [x, y]| {
        [f64::min(b[0], x), f64::min(b[1], y), f64::max(b[2], x), f64::max(b[3], y)]
    })
}

fn lies(args: &GenArgs, expected: [f64; 4]) {
    let found = Raster::read_in(&args.dem[0], &args.raster_options()).unwrap().bounds();
    assert!((0..4).all(|k| (found[k] - expected[k]).abs() < 1e-9), "{found:?}, not {expected:?}");
    run(args).unwrap();
}

fn refused(args: &GenArgs, why: &str) {
    let error = run(args).unwrap_err();
    let text = error.to_string();
    assert!(matches!(error, GenError::Invalid { .. }) && text.contains(why), "{text}");
    assert!(!args.out.exists());
}

/// Regression: such files were taken for Web Mercator.
#[test]
fn projected_file_without_a_named_system_needs_an_argument() {
    let folder = tempfile::tempdir().unwrap();
    let mut png = std::io::Cursor::new(Vec::new());
    let picture = image::RgbImage::from_pixel(SIDE, SIDE, image::Rgb([1, 140, 160]));
    picture.write_to(&mut png, image::ImageFormat::Png).unwrap();
    let exr = write_height_exr("test", SIDE as usize, heights()).unwrap();
    let tiff = tiff_int16(&heights(), None, None);
    for (name, bytes) in [("a.png", png.into_inner()), ("b.exr", exr), ("c.tif", tiff)] {
        let args = from_dem(folder.path(), name, &bytes);
        world(&args.dem[0], PLANE);
        refused(&args, "--epsg CODE names it");
        lies(&GenArgs { epsg: Some(UTM_32), ..args.clone() }, bounds(32));
        // Coordinates in degrees need no named system.
        world(&args.dem[0], ([7.0, 46.0], 0.001));
        let last = 0.001 * f64::from(SIDE - 1);
        lies(&GenArgs { overwrite: true, ..args }, [7.0, 46.0 - last, 7.0 + last, 46.0].map(f64::to_radians));
    }
}

/// GeoKeys are read although the georeference is a world file's.
#[test]
fn geo_keys_name_the_system_of_a_world_file() {
    let folder = tempfile::tempdir().unwrap();
    let keyed = |name: &str, keys: &[[u16; 2]]| {
        let args = from_dem(folder.path(), name, &tiff_int16_keyed(&heights(), None, keys));
        world(&args.dem[0], PLANE);
        args
    };
    let utm_33 = keyed("33.tif", &[[1024, 1], [3072, 32633]]);
    lies(&utm_33, bounds(33));
    // An argument does not override the file.
    lies(&GenArgs { epsg: Some(UTM_32), overwrite: true, ..utm_33 }, bounds(33));
    for (name, keys) in [
        ("own.tif", &[[1024, 1], [3072, 32767]][..]),
        // The geodetic system of a projection without a code does not name the projection.
        ("of-4326.tif", &[[1024, 1], [2048, 4326]][..]),
    ] {
        let own = keyed(name, keys);
        refused(&own, "a projection without a code; --epsg CODE");
        lies(&GenArgs { epsg: Some(UTM_32), ..own }, bounds(32));
    }
    refused(&keyed("geocentric.tif", &[[1024, 3], [2048, 4978]]), "EPSG:4978 is not supported");
}

/// Regression: ETRS89's zones were refused, and the unit of the coordinates was ignored.
#[test]
fn utm_zones_of_each_datum_are_supported_in_metres_only() {
    let folder = tempfile::tempdir().unwrap();
    let keyed = |keys: &[[u16; 2]]| {
        let args = from_dem(folder.path(), "zone.tif", &tiff_int16_keyed(&heights(), None, keys));
        world(&args.dem[0], PLANE);
        GenArgs { overwrite: true, ..args }
    };
    let north = [(32601..=32660, 32600), (26901..=26923, 26900), (25828..=25838, 25800)];
    for (codes, first) in north {
        for code in codes.clone() {
            assert_eq!(Crs::from_epsg(code), Some(Crs::Utm { zone: code - first, north: true }), "{code}");
        }
        let others = [codes.start() - 1, codes.end() + 1].map(Crs::from_epsg);
        assert!(others.iter().all(|crs| !matches!(crs, Some(Crs::Utm { .. }))), "{first}");
    }
    for code in 32701..=32760 {
        assert_eq!(Crs::from_epsg(code), Some(Crs::Utm { zone: code - 32700, north: false }));
    }
    for (code, zone) in [(32632, 32), (25832, 32), (25828, 28), (25838, 38), (26901, 1), (26923, 23)] {
        lies(&keyed(&[[1024, 1], [3072, code]]), bounds(zone));
        lies(&keyed(&[[1024, 1], [3072, code], [3076, 9001]]), bounds(zone));
    }
    fs::remove_dir_all(folder.path().join("zone.tif.set")).unwrap();
    for unit in [9002, 9003, 9036, 32767] {
        let why = format!("coordinates in units of EPSG:{unit}, which");
        refused(&keyed(&[[1024, 1], [3072, 25832], [3076, unit]]), &why);
        refused(&keyed(&[[3072, 3857], [3076, unit]]), &why);
        let own = keyed(&[[1024, 1], [3072, 32767], [3076, unit]]);
        refused(&GenArgs { epsg: Some(UTM_32), ..own }, &why);
    }
}

/// Regression: other units and meridians were read as degrees from Greenwich.
#[test]
fn geographic_systems_are_supported_in_degrees_from_greenwich_only() {
    let folder = tempfile::tempdir().unwrap();
    let keyed = |keys: &[[u16; 2]]| {
        let args = from_dem(folder.path(), "degrees.tif", &tiff_int16_keyed(&heights(), None, keys));
        world(&args.dem[0], ([7.0, 46.0], 0.001));
        GenArgs { overwrite: true, ..args }
    };
    for (keys, why) in [
        (&[[1024, 2], [2048, 4807]][..], "EPSG:4807 is not supported"),
        (&[[1024, 2], [2048, 4326], [2054, 9101]], "angles in units of EPSG:9101"),
        (&[[1024, 2], [2048, 32767], [2054, 9105]], "angles in units of EPSG:9105"),
        (&[[1024, 2], [2048, 32767], [2051, 8903]], "longitudes from the meridian EPSG:8903"),
        (&[[1024, 2], [2048, 32767], [2061, 2]], "longitudes from a meridian at 2.337,"),
    ] {
        refused(&keyed(keys), why);
    }
    let last = 0.001 * f64::from(SIDE - 1);
    let expected = [7.0, 46.0 - last, 7.0 + last, 46.0].map(f64::to_radians);
    for keys in [
        &[[1024, 2], [2048, 4258]][..],
        &[[1024, 2], [2048, 4269], [2054, 9102], [2051, 8901], [3076, 9002]],
        &[[1024, 2], [2048, 32767], [2054, 9122], [2061, 3]],
    ] {
        lies(&keyed(keys), expected);
    }
}

#[test]
fn projected_images_need_a_named_system_as_well() {
    let folder = tempfile::tempdir().unwrap();
    let args = from_dem(folder.path(), "a.tif", &tiff_int16(&heights(), Some(PLACE), None));
    let path = folder.path().join("colour.png");
    image::RgbImage::from_pixel(8, 8, image::Rgb([250, 10, 10])).save(&path).unwrap();
    let [x, y] = terrane_data_gen::utm_from_geodetic(32, true, 7.51f64.to_radians(), 46.49f64.to_radians());
    world(&path, ([x, y], 100.0));
    let args = GenArgs { imagery: vec![path], ..args };
    refused(&args, "--epsg CODE names it");
    run(&GenArgs { epsg: Some(UTM_32), ..args }).unwrap();
}

/// The origins of projections, in the plane and in degrees, are part of their definitions.
#[test]
fn projections_of_epsg_agree_with_proj() {
    for (code, [x, y], [longitude, latitude]) in [
        // Lambert conformal conic with two parallels: the origin of Lambert-93.
        (2154, [700_000.0, 6_600_000.0], [3.0, 46.5]),
        // Lambert azimuthal equal area of Europe: its origin.
        (3035, [4_321_000.0, 3_210_000.0], [10.0, 52.0]),
        // Polar stereographic: the pole.
        (3413, [0.0, 0.0], [-45.0, 90.0]),
        // Albers of the United States.
        (5070, [0.0, 0.0], [-96.0, 23.0]),
    ] {
        let crs = Crs::from_epsg(code).unwrap();
        let [lon, lat] = crs.unproject(x, y);
        assert!((lat.to_degrees() - latitude).abs() < 1e-7, "EPSG:{code}: {}", lat.to_degrees());
        if latitude < 90.0 {
            assert!((lon.to_degrees() - longitude).abs() < 1e-7, "EPSG:{code}: {}", lon.to_degrees());
            let back = crs.project(lon, lat);
            assert!((back[0] - x).abs() < 1e-3 && (back[1] - y).abs() < 1e-3, "EPSG:{code}: {back:?}");
        }
    }
    // Swiss coordinates: the old observatory of Bern is the origin. The datum moves it by 130 m.
    let [lon, lat] = Crs::from_epsg(2056).unwrap().unproject(2_600_000.0, 1_200_000.0);
    assert!(
        (lon.to_degrees() - 7.438_632_4).abs() < 1e-6 && (lat.to_degrees() - 46.951_082_8).abs() < 1e-6,
        "{lon} {lat}"
    );
    assert_eq!(Crs::parse("EPSG:2056"), Ok(Crs::from_epsg(2056).unwrap()));
    let given = Crs::parse("+proj=laea +lat_0=52 +lon_0=10 +x_0=4321000 +y_0=3210000 +ellps=GRS80").unwrap();
    let [lon, lat] = given.unproject(4_321_000.0, 3_210_000.0);
    assert!((lon.to_degrees() - 10.0).abs() < 1e-9 && (lat.to_degrees() - 52.0).abs() < 1e-9);
    for (text, why) in [
        ("4978", "EPSG:4978 is not supported; give it in PROJ's notation"),
        ("99999", "EPSG:99999 is not supported"),
        ("utm", "neither an EPSG code nor"),
        ("+proj=nonsense", "+proj=nonsense"),
        ("+proj=geocent +datum=WGS84", "only geographic and projected"),
        ("+proj=longlat +R=12", "radii [12.0, 12.0, 12.0]"),
        (
            r#"GEOGCS["Mars (2015) / Ocentric",DATUM["Mars (2015)",SPHEROID["Mars (2015)",3396190,169.894447223612]],
            PRIMEM["Reference Meridian",0],UNIT["degree",0.0174532925199433]]"#,
            "planetocentric latitudes",
        ),
    ] {
        let error = Crs::parse(text).unwrap_err();
        assert!(error.contains(why), "{error}");
    }
}

#[test]
fn files_in_a_projection_of_epsg_are_placed_and_unknown_ones_can_be_overridden() {
    let folder = tempfile::tempdir().unwrap();
    let keyed = |name: &str, keys: &[[u16; 2]]| {
        let args = from_dem(folder.path(), name, &tiff_int16_keyed(&heights(), None, keys));
        world(&args.dem[0], ([2_600_000.0, 1_200_000.0], 30.0));
        args
    };
    let swiss = keyed("swiss.tif", &[[1024, 1], [3072, 2056]]);
    let bounds = Raster::read(&swiss.dem[0]).unwrap().bounds().map(f64::to_degrees);
    assert!((bounds[0] - 7.4386).abs() < 1e-3 && (bounds[3] - 46.9511).abs() < 1e-3, "{bounds:?}");
    refused(&keyed("feet.tif", &[[1024, 1], [3072, 2056], [3076, 9003]]), "coordinates in units of EPSG:9003");
    let unknown = keyed("unknown.tif", &[[1024, 1], [3072, 4979 + 60_000]]);
    refused(&unknown, "EPSG:64979 is not supported; --epsg names another system");
    let given = GenArgs { epsg: Crs::from_epsg(2056), ..unknown };
    assert_eq!(Raster::read_in(&given.dem[0], &given.raster_options()).unwrap().bounds().map(f64::to_degrees), bounds);
}

/// Regression: projections without a code were refused although the keys define them.
#[test]
fn geo_keys_define_projections_without_a_code() {
    let folder = tempfile::tempdir().unwrap();
    // Values of the keys' doubles: parallels of 29.5 and 45.5, the origin at 23 north and 96 west, easting and northing 0.
    let doubles = [29.5, 45.5, 23.0, -96.0, 1_000_000.0];
    let place = |method: u16, more: &[[u16; 2]]| {
        let mut keys: Vec<[u16; 4]> = [[1024, 1], [3072, 32767], [2048, 4269], [3075, method]]
            .iter()
            .chain(more.iter().filter(|[key, _]| *key == 3076))
            .map(|[key, value]| [*key, 0, 1, *value])
            .collect();
        keys.extend(more.iter().filter(|[key, _]| *key != 3076).map(|[key, index]| [*key, 34736, 1, *index]));
        let directory = [vec![1, 1, 0, keys.len() as u16], keys.concat()].concat();
        let image = crate::tiffs::Image::new([8; 2], 16, 1, [7, 0].repeat(64));
        let image = image.with(34735, crate::tiffs::Values::Short(directory));
        let image = image.with(34736, crate::tiffs::Values::Double(doubles.to_vec()));
        let path = folder.path().join("own.tif");
        fs::write(&path, crate::tiffs::tiff(vec![image])).unwrap();
        world(&path, ([0.0, 0.0], 30.0));
        Raster::read(&path).map(|raster| raster.bounds().map(f64::to_degrees))
    };
    let albers = place(11, &[[3078, 0], [3079, 1], [3081, 2], [3080, 3]]).unwrap();
    assert!((albers[0] + 96.0).abs() < 1e-9 && (albers[3] - 23.0).abs() < 1e-6, "{albers:?}");
    // An easting of a million survey feet.
    let conic = place(8, &[[3076, 9003], [3078, 0], [3079, 1], [3085, 2], [3084, 3], [3086, 4]]).unwrap();
    let west = -96.0 - 1e6 * 1200.0 / 3937.0 / (111_320.0 * 23f64.to_radians().cos());
    assert!((conic[0] - west).abs() < 0.3, "{conic:?}, not {west}");
    let unknown = place(3, &[]).unwrap_err().to_string();
    assert!(unknown.contains("a projection without a code; --epsg CODE"), "{unknown}");
}

/// Regression: systems of ArcGIS and UTM's zones without a code were refused.
#[test]
fn texts_and_zones_define_systems_without_a_code() {
    let folder = tempfile::tempdir().unwrap();
    let place = |keys: &[[u16; 4]], text: &str| {
        let directory = [vec![1, 1, 0, keys.len() as u16], keys.concat()].concat();
        let image = crate::tiffs::Image::new([8; 2], 16, 1, [7, 0].repeat(64));
        let image = image.with(34735, crate::tiffs::Values::Short(directory));
        let image = image.with(34737, crate::tiffs::Values::Text(format!("{text}\0")));
        let path = folder.path().join("own.tif");
        fs::write(&path, crate::tiffs::tiff(vec![image])).unwrap();
        world(&path, ([500_000.0, 4_000_000.0], 30.0));
        Raster::read(&path).map(|raster| (raster.bounds().map(f64::to_degrees), raster.range_m().unwrap()))
    };
    let keys = [[1024, 0, 1, 1], [2048, 0, 1, 32767], [2056, 0, 1, 7030], [3072, 0, 1, 32767], [3074, 0, 1, 16018]];
    let (zone, _) = place(&keys, "").unwrap();
    let [longitude, latitude] = utm_to_geodetic(18, true, 500_000.0, 4_000_000.0).map(f64::to_degrees);
    assert!((zone[0] - longitude).abs() < 1e-7 && (zone[3] - latitude).abs() < 1e-5, "{zone:?}");
    let wkt = "PROJCS[\"a\",GEOGCS[\"b\",DATUM[\"D_North_American_1983\",SPHEROID[\"GRS_1980\",6378137.0,298.257222101]],\
        PRIMEM[\"Greenwich\",0.0],UNIT[\"Degree\",0.0174532925199433]],PROJECTION[\"Transverse_Mercator\"],PARAMETER[\
        \"False_Easting\",500000.0],PARAMETER[\"False_Northing\",0.0],PARAMETER[\"Central_Meridian\",-75.0],PARAMETER[\
        \"Scale_Factor\",0.9996],PARAMETER[\"Latitude_Of_Origin\",0.0],UNIT[\"Meter\",1.0],VERTCS[\"NAVD_1988\",VDATUM[\
        \"NAVD_1988\"],PARAMETER[\"Vertical_Shift\",0.0],PARAMETER[\"Direction\",1.0],UNIT[\"Centimeter\",0.01]]]";
    let text = format!("own|ESRI PE String = {wkt}|");
    let keys = [[1024, 0, 1, 32767], [2048, 0, 1, 32767], [3073, 34737, text.len() as u16, 0]];
    let (esri, heights_m) = place(&keys, &text).unwrap();
    assert!(esri.iter().zip(zone).all(|(a, b)| (a - b).abs() < 1e-7), "{esri:?}, not {zone:?}");
    assert!((heights_m[0] - 0.07).abs() < 1e-6, "{heights_m:?}");
    let depths = place(&keys, &text.replace("\"Direction\",1.0", "\"Direction\",-1.0")).unwrap_err().to_string();
    assert!(depths.contains("depths; only heights"), "{depths}");
}

#[test]
fn heights_above_a_geoid_become_heights_above_the_ellipsoid() {
    let folder = tempfile::tempdir().unwrap();
    let args = from_dem(folder.path(), "a.tif", &tiff_int16(&heights(), Some(PLACE), None));
    let plain = run(&args).unwrap();
    let grid = |west: f64| {
        // 3 x 3 points, 1 degree apart, all 48.5 m high.
        let mut bytes: Vec<u8> = [46.0, west, 1.0, 1.0f64].iter().flat_map(|n| n.to_be_bytes()).collect();
        bytes.extend([3i32, 3].iter().flat_map(|n| n.to_be_bytes()));
        bytes.extend([48.5f32; 9].iter().flat_map(|n| n.to_be_bytes()));
        let path = folder.path().join(format!("{west}.gtx"));
        fs::write(&path, bytes).unwrap();
        VerticalDatum::Geoid(path)
    };
    let raised = GenArgs { vertical_datum: grid(7.0), overwrite: true, ..args.clone() };
    let summary = run(&raised).unwrap();
    assert_eq!([summary.min_height_m, summary.max_height_m], [plain.min_height_m + 48.5, plain.max_height_m + 48.5]);
    let properties = &crate::files::tileset(&raised.out)["metadata"]["properties"];
    assert!(properties["sourceVerticalDatum"].as_str().unwrap().ends_with("7.gtx"), "{properties}");
    assert_eq!(properties["maximumHeight"].as_f64(), Some(summary.max_height_m));
    assert_eq!(properties["samplesLeftOut"].as_u64(), Some(0));
    let error = run(&GenArgs { vertical_datum: grid(8.0), ..raised }).unwrap_err().to_string();
    assert!(error.contains("a.tif: reaches beyond the geoid grid"), "{error}");
}

#[test]
fn a_file_beside_a_raster_names_its_system() {
    let folder = tempfile::tempdir().unwrap();
    let args = from_dem(folder.path(), "a.tif", &tiff_int16(&heights(), None, None));
    world(&args.dem[0], PLANE);
    let beside = args.dem[0].with_extension("prj");
    fs::write(&beside, "EPSG:32633").unwrap();
    lies(&args, bounds(33));
    // An argument does not override it, unless it is not understood.
    lies(&GenArgs { epsg: Some(UTM_32), overwrite: true, ..args.clone() }, bounds(33));
    fs::write(&beside, "Projection UTM\nZone 32\n").unwrap();
    fs::remove_dir_all(&args.out).unwrap();
    refused(&args, "a.prj: `Projection UTM Zone 32` is neither an EPSG code nor");
    lies(&GenArgs { epsg: Some(UTM_32), ..args }, bounds(32));
}

const MOON_2000: &str = r#"GEOGCS["GCS_Moon_2000",DATUM["D_Moon_2000",SPHEROID["Moon_2000_IAU_IAG",1737400.0,0.0]],
    PRIMEM["Reference_Meridian",0.0],UNIT["Degree",0.0174532925199433]]"#;
const MARS_2000: &str = r#"GEOGCS["Mars 2000",DATUM["D_Mars_2000",SPHEROID["Mars_2000_IAU_IAG",3396190.0,169.89444722361179]],
    PRIMEM["Reference_Meridian",0.0],UNIT["Degree",0.0174532925199433]]"#;

/// Regression: systems of other bodies were refused.
#[test]
fn reference_systems_of_other_bodies_are_read() {
    let on = |text: &str| match Crs::parse(text).unwrap() {
        Crs::OnBody(ellipsoid) => ellipsoid,
        other => panic!("{text}: {other:?}"),
    };
    assert_eq!(on(MOON_2000), MOON);
    assert_eq!(on("+proj=longlat +a=1737400 +b=1737400 +no_defs"), MOON);
    assert_eq!(on("+proj=longlat +R=1737400"), MOON);
    let Ellipsoid { semi_major_m, semi_minor_m } = on(MARS_2000);
    assert!(semi_major_m == MARS.semi_major_m && (semi_minor_m - MARS.semi_minor_m).abs() < 1e-3, "{semi_minor_m}");
    // Values of PROJ 9.
    let near = |text: &str, [x, y]: [f64; 2], [longitude, latitude]: [f64; 2]| {
        let crs = Crs::parse(text).unwrap();
        let found = crs.unproject(x, y).map(f64::to_degrees);
        assert!((found[0] - longitude).abs() < 1e-9 && (found[1] - latitude).abs() < 1e-9, "{text}: {found:?}");
        let back = crs.project(longitude.to_radians(), latitude.to_radians());
        assert!((back[0] - x).abs() < 1e-4 && (back[1] - y).abs() < 1e-4, "{text}: {back:?}");
    };
    near("+proj=eqc +R=1737400", [303_233.504_241_494_8, 606_467.008_482_989_6], [10.0, 20.0]);
    near("+proj=stere +lat_0=-90 +R=1737400", [0.0, 151_713.044_418_498], [0.0, -85.0]);
}

/// The body of a set is that of its elevation.
#[test]
fn elevation_of_other_bodies_lies_on_them() {
    let folder = tempfile::tempdir().unwrap();
    let grid = |name: &str, prj: &str| {
        let rows: String = (0..30)
            .map(|j| (0..30).map(|i| format!("{} ", 100 * ((i * j) % 7) - 300)).collect::<String>() + "\n")
            .collect();
        let header = "ncols 30\nnrows 30\nxllcorner 23.4\nyllcorner 0.6\ncellsize 0.01\n";
        let args = from_dem(folder.path(), &format!("{name}.asc"), format!("{header}{rows}").as_bytes());
        if !prj.is_empty() {
            fs::write(folder.path().join(format!("{name}.prj")), prj).unwrap();
        }
        GenArgs { levels: Some(1), ..args }
    };
    let radii = |args: &GenArgs| {
        let set = tileset(&args.out);
        let found = verify(&args.out.to_string_lossy(), &Limits::default(), &mut |_| ()).unwrap();
        assert_eq!((found.contents, found.failed, found.problems.len()), (1, 0, 0), "{:?}", found.problems);
        let region = region(&set["root"]);
        assert!((region[0].to_degrees() - 23.405).abs() < 1e-9 && region[4] < -290.0, "{region:?}");
        set["extensions"]["3DTILES_ellipsoid"]["radii"].clone()
    };
    for content in [ContentKind::Height, ContentKind::Mesh] {
        let args = GenArgs { content, ..grid(&format!("{content:?}"), MOON_2000) };
        run(&args).unwrap();
        assert_eq!(radii(&args), serde_json::json!([1_737_400.0, 1_737_400.0, 1_737_400.0]));
    }
    // A sphere of GeoKeys.
    let keys = [[1024, 2], [2048, 32767], [2057, 1]];
    let keyed = from_dem(folder.path(), "keys.tif", &tiff_int16_keyed(&heights(), None, &keys));
    world(&keyed.dem[0], ([23.405, 0.9], 0.01));
    run(&GenArgs { levels: Some(1), ..keyed.clone() }).unwrap();
    assert_eq!(tileset(&keyed.out)["extensions"]["3DTILES_ellipsoid"]["body"], "Moon");
    // Degrees without a body are those of the one that is given.
    let mut plain = grid("plain", "");
    plain.output.body = Some("mars".parse().unwrap());
    run(&plain).unwrap();
    assert_eq!(radii(&plain)[2], 3_376_200.0);
    let moon = grid("moon", MOON_2000);
    let mut other = moon.clone();
    other.output.body = Some("mars".parse().unwrap());
    refused(&other, "radii of 1737400 and 1737400 m, and that of --body 3396190");
    let two = GenArgs { dem: vec![moon.dem[0].clone(), grid("mars", MARS_2000).dem[0].clone()], ..moon.clone() };
    refused(&two, "and that of");
    let globe = GenArgs { content: ContentKind::QuantizedMesh, ..moon.clone() };
    assert!(run(&globe).unwrap_err().to_string().contains("layer.json names no body"));
    let geoid = GenArgs { vertical_datum: VerticalDatum::parse("egm96").unwrap(), ..moon };
    assert!(!run(&geoid).unwrap_err().to_string().is_empty());
}
