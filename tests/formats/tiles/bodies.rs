//! Sets of other bodies than the earth: the extension 3DTILES_ellipsoid.

use std::path::Path;
use std::sync::Arc;

use glam::DVec3;
use kit::bodies::{self, Square, write_set};
use terrane::fetch::Limits;
use terrane::formats::SurveyOptions;
use terrane::formats::{
    Content, ConvertOptions, Info, MapFrame, ReadOptions, SurveyEvent, convert, crop, decode, inspect, survey,
};
use terrane::math::{BoundingVolume, Ellipsoid, Geodetic, MOON, Region, WGS84};
use terrane::scene::Page;

fn decoded(file: &Path, options: &ReadOptions) -> Page {
    let uri: Arc<str> = file.to_str().unwrap().into();
    let content = Content { uri, bytes: std::fs::read(file).unwrap(), reader_data: None, companions: Vec::new() };
    decode(content, options).unwrap()
}

fn read(file: &Path) -> (Page, Vec<String>) {
    let options = ReadOptions::for_root(file.to_str().unwrap(), Limits::default());
    let page = decoded(file, &options);
    (page, options.ignored.snapshot().iter().map(|(kind, _)| kind.to_owned()).collect())
}

fn inspected(set: &Path) -> Info {
    inspect(set.to_str().unwrap(), &Limits::default()).unwrap()
}

fn at(longitude: f64, latitude: f64, height_m: f64) -> Geodetic {
    Geodetic { longitude, latitude, height_m }
}

/// A region of 0.01 by 0.01 radians from 100 m below the Moon's sphere to 500 m above, computed by hand.
#[test]
fn region_of_the_moon_has_the_size_of_the_moon() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tileset.json");
    write_set(&file, bodies::MOON, [0.3, 0.5, 0.31, 0.51, -100.0, 500.0], &[]);
    let (page, ignored) = read(&file);
    assert_eq!((page.ellipsoid(), ignored), (MOON, Vec::new()));
    let sphere = page.bounding_sphere();
    // On a sphere a place is its angles times its radius. The southern edge is the longest.
    let radius_m = 1_737_400.0;
    let east_m = (radius_m + 500.0) * 0.5f64.cos() * 0.005f64.sin();
    let north_m = (radius_m + 500.0) * 0.005f64.sin();
    let expected_m = DVec3::new(east_m, north_m, 320.0).length();
    assert!((sphere.radius_m - expected_m).abs() < 20.0, "{} {expected_m}", sphere.radius_m);
    let middle =
        radius_m * DVec3::new(0.505f64.cos() * 0.305f64.cos(), 0.505f64.cos() * 0.305f64.sin(), 0.505f64.sin());
    assert!(sphere.center.distance(middle) < 250.0, "{} {middle}", sphere.center);

    // The same file on the earth is nearly four times as large.
    write_set(&file, "", [0.3, 0.5, 0.31, 0.51, -100.0, 500.0], &[]);
    let (page, _) = read(&file);
    assert_eq!(page.ellipsoid(), WGS84);
    assert!((page.bounding_sphere().radius_m / sphere.radius_m - 3.67).abs() < 0.02);
    // An application says what body a set without the extension is on.
    let mut options = ReadOptions::for_root(file.to_str().unwrap(), Limits::default());
    options.ellipsoid = MOON;
    let page = decoded(&file, &options);
    assert_eq!((page.ellipsoid(), page.bounding_sphere()), (MOON, sphere));
}

#[test]
fn radii_decide_and_invalid_ones_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tileset.json");
    let read = |radii: &str| {
        write_set(&file, &format!(r#"{{"body":"X","radii":{radii}}}"#), [0.3, 0.5, 0.31, 0.51, 0.0, 1.0], &[]);
        read(&file)
    };
    let ellipsoid = |semi_major_m, semi_minor_m| Ellipsoid { semi_major_m, semi_minor_m };
    for (radii, expected) in [
        // To the millimetre, as several writers round it.
        ("[6378137,6378137,6356752.3142]", WGS84),
        ("[3396190,3396190,3376200]", ellipsoid(3_396_190.0, 3_376_200.0)),
        ("[6371000,6371000,6371000]", ellipsoid(6_371_000.0, 6_371_000.0)),
        ("[1000.0005,1000,1000]", ellipsoid(1000.00025, 1000.0)),
    ] {
        let (page, ignored) = read(radii);
        assert_eq!((page.ellipsoid(), ignored), (expected, Vec::new()), "{radii}");
    }
    let (page, ignored) = read("[286300,278600,223200]");
    assert_eq!(page.ellipsoid(), ellipsoid(282_450.0, 223_200.0));
    assert!(ignored.len() == 1 && ignored[0].contains("the mean of the equatorial ones"), "{ignored:?}");
    for bad in ["[6378137,6378137]", "[0,0,0]", "[1e6,1e6,-1e6]", "[1e99,1e99,1e99]", "[1e6,1e6,1e3]", "null", "7"] {
        let (page, ignored) = read(bad);
        assert_eq!(page.ellipsoid(), WGS84, "{bad}");
        assert_eq!(ignored, ["tileset extension 3DTILES_ellipsoid"], "{bad}");
        let json = std::fs::read_to_string(&file).unwrap();
        let required = json.replace("extensionsUsed", "extensionsRequired");
        std::fs::write(&file, required).unwrap();
        let error = inspect(file.to_str().unwrap(), &Limits::default()).unwrap_err().to_string();
        assert!(error.contains("tileset.json") && error.contains("3DTILES_ellipsoid: "), "{error}");
    }
}

/// An external tileset and the subtrees below it lie on the body of the root.
#[test]
fn external_tilesets_and_implicit_tiles_have_the_body_of_their_root() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tileset.json");
    let region = [0.3, 0.5, 0.31, 0.51, -100.0, 500.0];
    write_set(&file, "", region, &[]);
    let moon = ReadOptions {
        ellipsoid: MOON,
        ..ReadOptions::for_root(file.to_str().unwrap(), Limits::default()).below(&"root.json".into())
    };
    let expected = decoded(&file, &moon).bounding_sphere();
    assert!(expected.center.length() < 1.8e6);
    // Its own declaration does not count, and is named.
    for (body, names) in [(r#"{"radii":[3396190,3396190,3376200]}"#, 1), (bodies::MOON, 0)] {
        write_set(&file, body, region, &[]);
        let moon = ReadOptions { ignored: Default::default(), ..moon.clone() };
        assert_eq!(decoded(&file, &moon).bounding_sphere(), expected);
        let ignored = moon.ignored.snapshot();
        let named = ignored.count("3DTILES_ellipsoid of an external tileset, which differs from that of its root");
        assert_eq!(named, names, "{ignored:?}");
    }
    let implicit = format!(
        r#"{{"asset":{{"version":"1.1"}},"extensions":{{"3DTILES_ellipsoid":{}}},"geometricError":100,
        "root":{{"boundingVolume":{{"region":{region:?}}},"geometricError":100,"refine":"REPLACE",
        "implicitTiling":{{"subdivisionScheme":"QUADTREE","subtreeLevels":1,"availableLevels":1,
        "subtrees":{{"uri":"{{level}}.json"}}}}}}}}"#,
        bodies::MOON
    );
    std::fs::write(&file, implicit).unwrap();
    let subtree = r#"{"buffers":[],"tileAvailability":{"constant":1},"contentAvailability":[],"childSubtreeAvailability":{"constant":0}}"#;
    std::fs::write(folder.path().join("0.json"), subtree).unwrap();
    let mut volumes = Vec::new();
    let options = SurveyOptions { reads_contents: true, measures: true, ..SurveyOptions::default() };
    let verified = survey(file.to_str().unwrap(), &options, &mut |event| {
        if let SurveyEvent::Tile(tile) = event {
            volumes.push((tile.frame, tile.rectangle));
        }
    });
    assert_eq!(verified.unwrap().failed, 0);
    assert_eq!(volumes, [(MapFrame::Globe(MOON), Some([0.3, 0.5, 0.31, 0.51]))]);
}

/// The body stays with what the jobs about whole sets write, and what they print.
#[test]
fn sets_are_described_converted_and_cropped_on_their_body() {
    let folder = tempfile::tempdir().unwrap();
    let set = folder.path().join("set");
    std::fs::create_dir(&set).unwrap();
    let square = |longitude| Square { ellipsoid: MOON, middle: at(longitude, 0.5, 250.0), half_m: 500.0 };
    let tiles = [("a", 0.3), ("b", 0.35)].map(|(name, longitude)| square(longitude).tile(&set, name));
    write_set(&set.join("tileset.json"), bodies::MOON, [0.29, 0.49, 0.36, 0.51, -1000.0, 1000.0], &tiles);
    let info = inspected(&set);
    assert_eq!(info.body.as_ref().unwrap().ellipsoid(), MOON);
    assert!(info.to_string().contains("body: Moon, radii 1737400 1737400 1737400 m"), "{info}");
    assert!(info.ignored.is_empty() && info.failed == 0, "{info:?}");

    // All vertices lie in the declared volumes, at the declared heights.
    let options = SurveyOptions { reads_contents: true, measures: true, ..SurveyOptions::default() };
    let verified = survey(set.to_str().unwrap(), &options, &mut |_| {}).unwrap();
    assert!(verified.failed == 0 && verified.problems.is_empty(), "{verified:?}");
    let heights_m = verified.levels.iter().find_map(|level| level.heights_m).unwrap();
    // The corners of a square of 500 m are higher by d^2 / 2r = 0.144 m.
    assert!((heights_m[0] - 250.144).abs() < 0.002 && (heights_m[1] - 250.144).abs() < 0.002, "{heights_m:?}");

    let source = set.to_str().unwrap();
    let out = folder.path().join("converted");
    convert(source, &out, &ConvertOptions::default(), &mut |_| {}).unwrap();
    assert_eq!(inspected(&out).body, info.body);
    assert!(DVec3::from_array(inspected(&out).bounds.center).distance(DVec3::from_array(info.bounds.center)) < 1.0);
    for (longitude, names) in [(0.3, ["a", "b"]), (0.35, ["b", "a"])] {
        let (west, east) = (longitude - 1e-4, longitude + 1e-4);
        // Whatever ellipsoid the wanted region has, it is one of angles.
        let region =
            Region { west, south: 0.4999, east, north: 0.5001, min_height_m: 0.0, max_height_m: 0.0, ellipsoid: WGS84 };
        let options = ConvertOptions { region: Some(region), ..ConvertOptions::default() };
        let out = folder.path().join(format!("cropped-{}", names[0]));
        crop(source, &out, &options, &mut |_| {}).unwrap();
        assert_eq!(inspected(&out).body, info.body);
        let [kept, left_out] = names.map(|name| out.join(format!("{name}.glb")).exists());
        assert!(kept && !left_out, "{longitude}");
    }
}

#[test]
fn bare_ellipsoid_and_volumes_follow_the_body() {
    let [moon, earth] = [MOON, WGS84].map(|body| Page::from_node(terrane::formats::ellipsoid(body)).unwrap());
    let ratio = moon.bounding_sphere().radius_m / earth.bounding_sphere().radius_m;
    assert!((ratio / (1_737_400.0 / 6_378_137.0) - 1.0).abs() < 0.01, "{ratio}");
    let [west, south, east, north, min_height_m, max_height_m] = [0.3, 0.5, 0.31, 0.51, -100.0, 500.0];
    let volume =
        BoundingVolume::Region(Region { west, south, east, north, min_height_m, max_height_m, ellipsoid: MOON });
    assert!(
        volume.contains(MOON.ecef(&at(0.305, 0.505, 499.0))) && !volume.contains(MOON.ecef(&at(0.305, 0.505, 501.0)))
    );
    assert!(!volume.contains(WGS84.ecef(&at(0.305, 0.505, 0.0))));
}
