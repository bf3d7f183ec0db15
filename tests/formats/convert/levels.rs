//! Levels of detail, placement and bounds of OpenSceneGraph's files.

use glam::DVec3;
use kit::osg_files::{VERSION, geode, group, osgt, triangle};
use terrane::fetch::Limits;
use terrane::formats::{ConvertError, ConvertOptions, convert, inspect};
use terrane::math::{Region, TransverseMercator, WGS84};

use super::*;

/// A file whose triangle is replaced by another file nearer than 100 m, with a triangle that is always there.
fn paged(finer: &str) -> String {
    let lod = format!(
        "osg::PagedLOD {{ UniqueID 2 CenterMode USER_DEFINED_CENTER UserCenter 0 0 0 5
        RangeList 2 {{ 100 1e+30 0 100 }} RangeDataList 2 {{ \"\" \"{finer}\" }} PriorityList 2 {{ 0 1 0 1 }}
        Children 1 {{ {} }} }}",
        geode(3, "", &[triangle(4, "")])
    );
    osgt(VERSION, &group(1, &[lod, geode(20, "", &[triangle(21, "")])]))
}

#[test]
fn ranges_become_errors_that_refine_at_the_same_distance() {
    let folder = tempfile::tempdir().unwrap();
    let fine = osgt(VERSION, &geode(1, "", &[triangle(2, ""), triangle(12, "")]));
    std::fs::write(folder.path().join("top.osgt"), paged("fine.osgt")).unwrap();
    std::fs::write(folder.path().join("fine.osgt"), fine).unwrap();
    let out = folder.path().join("out");
    let converted = converted(&folder.path().join("top.osgt"), &out);
    assert_eq!((converted.source.levels.as_slice(), converted.source.triangles), (&[2, 1][..], 4));
    let root = &tileset(&out)["root"];
    assert!(root.get("content").is_none() && root["children"].as_array().unwrap().len() == 2, "{root}");
    let paged = &root["children"][1];
    let radius_m = paged["boundingVolume"]["sphere"][3].as_f64().unwrap();
    assert!((radius_m - 2f64.sqrt()).abs() < 1e-6, "the corner of the box around the triangles is the farthest point");
    // The error in pixels is 16 where the eye is 100 m from the centre.
    let options = ConvertOptions::default();
    let error_px = paged["geometricError"].as_f64().unwrap() * options.px_per_radian / (100.0 - radius_m);
    assert!((error_px - options.max_sse_px).abs() < 1e-6, "{error_px}");
    assert_eq!((&paged["refine"], &paged["children"][0]["geometricError"]), (&"REPLACE".into(), &0.0.into()));
}

/// Levels without files are levels too, with ranges in pixels as well.
#[test]
fn levels_in_one_file_become_tiles() {
    let folder = tempfile::tempdir().unwrap();
    let children =
        [geode(10, "", &[triangle(11, ""), triangle(15, "")]), geode(20, "", &[triangle(21, "")])].join("\n");
    let lod = format!(
        "osg::LOD {{ UniqueID 2 Children 2 {{ {children} }} CenterMode USER_DEFINED_CENTER UserCenter 0 0 0 2
        RangeMode PIXEL_SIZE_ON_SCREEN RangeList 2 {{ 50 1e+30 0 50 }} }}"
    );
    let file = folder.path().join("lod.osgt");
    std::fs::write(&file, osgt(VERSION, &lod)).unwrap();
    let out = folder.path().join("out");
    let converted = converted(&file, &out);
    assert_eq!((converted.source.levels.as_slice(), converted.source.triangles), (&[1, 1][..], 3));
    let root = &tileset(&out)["root"];
    // A sphere of 2 m covers 50 pixels at this distance.
    let options = ConvertOptions::default();
    let distance_m = 2.0 * 2.0 * options.px_per_radian / 50.0;
    let expected = options.max_sse_px / options.px_per_radian * (distance_m - 2f64.sqrt());
    assert!((root["geometricError"].as_f64().unwrap() / expected - 1.0).abs() < 1e-6);
    assert!(converted.left_out.is_empty(), "{:?}", converted.left_out);
}

fn oblique(folder: &Path) {
    let metadata = "<?xml version=\"1.0\"?><ModelMetadata version=\"1\"><SRS>EPSG:32632</SRS>
        <SRSOrigin>463900,5248700,400</SRSOrigin></ModelMetadata>";
    std::fs::write(folder.join("metadata.xml"), metadata).unwrap();
    for (name, center) in [("Tile_a", [0, 0, 5]), ("Tile_b", [2000, -300, 5])] {
        let of_tile = folder.join("Data").join(name);
        std::fs::create_dir_all(&of_tile).unwrap();
        let [x, y, z] = center;
        let placed = format!(
            "osg::MatrixTransform {{ UniqueID 9 Children 1 {{ {} }}
            Matrix {{ 1 0 0 0 0 1 0 0 0 0 1 0 {x} {y} {z} 1 }} }}",
            geode(2, "", &[triangle(3, "")])
        );
        std::fs::write(of_tile.join(format!("{name}.osgb")), osgt(VERSION, &placed)).unwrap();
    }
}

#[test]
fn folders_keep_their_place_on_the_earth_and_can_be_cropped() {
    let folder = tempfile::tempdir().unwrap();
    oblique(folder.path());
    let out = folder.path().join("out");
    assert_eq!(converted(folder.path(), &out).source.contents(), 2);
    let info = inspect(out.to_str().unwrap(), &Limits::default()).unwrap();
    let grid = TransverseMercator::utm(32, false);
    let place = |x: f64, y: f64| grid.unproject([463_900.0 + x, 5_248_700.0 + y], 405.0);
    let middle = 0.5 * (WGS84.ecef(&place(0.5, 0.5)) + WGS84.ecef(&place(2000.5, -299.5)));
    assert!(DVec3::from_array(info.bounds.center).distance(middle) < 1.0, "{:?}", info.bounds.center);

    let of_b = place(2000.0, -300.0);
    let region = Region {
        west: of_b.longitude - 1e-5,
        south: of_b.latitude - 1e-5,
        east: of_b.longitude + 1e-5,
        north: of_b.latitude + 1e-5,
        min_height_m: 0.0,
        max_height_m: 0.0,
        ellipsoid: WGS84,
    };
    let options = ConvertOptions { region: Some(region), ..ConvertOptions::default() };
    let cropped = folder.path().join("cropped");
    assert_eq!(converted_with(folder.path(), &cropped, &options).source.contents(), 1);
    let info = inspect(cropped.to_str().unwrap(), &Limits::default()).unwrap();
    assert!(DVec3::from_array(info.bounds.center).distance(WGS84.ecef(&of_b)) < 2.0);
}

#[test]
fn broken_files_are_left_out_and_named() {
    let folder = tempfile::tempdir().unwrap();
    oblique(folder.path());
    std::fs::write(folder.path().join("Data/Tile_a/Tile_a.osgb"), "broken").unwrap();
    let out = folder.path().join("out");
    let converted = converted(folder.path(), &out);
    assert_eq!((converted.failed, converted.source.contents()), (1, 1));
    assert!(converted.errors[0].0.ends_with("Tile_a.osgb"), "{:?}", converted.errors);

    std::fs::write(folder.path().join("Data/Tile_b/Tile_b.osgb"), "broken").unwrap();
    let convert = |source: &Path, out: &str| {
        let options = ConvertOptions::default();
        convert(source.to_str().unwrap(), &folder.path().join(out), &options, &mut |_| {}).unwrap_err()
    };
    let nothing = convert(folder.path(), "nothing");
    assert!(matches!(&nothing, ConvertError::Nothing { reason, .. } if reason.contains("Tile_")), "{nothing}");
    let missing = convert(&folder.path().join("missing.osgb"), "missing");
    assert!(matches!(missing, ConvertError::Source(_)), "{missing}");
    std::fs::write(folder.path().join("file"), "").unwrap();
    std::fs::write(folder.path().join("top.osgt"), osgt(VERSION, &geode(1, "", &[triangle(2, "")]))).unwrap();
    let unwritable = convert(&folder.path().join("top.osgt"), "file/set");
    assert!(matches!(unwritable, ConvertError::Write { .. }), "{unwritable}");
}

/// The samples of OSG's own writers.
#[test]
fn samples_of_osg_keep_triangles_texels_and_levels() {
    let samples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/samples/osg");
    if !samples.is_dir() {
        return kit::skip::skipped(format!("no files at {}", samples.display()));
    }
    let folder = tempfile::tempdir().unwrap();
    for (name, levels, triangles, pixels) in [
        // In each of its files, one of four PagedLODs has a coarse geometry; the other three have only a file.
        ("oblique", &[13, 7, 1][..], 2688, 21 * 64 * 64),
        ("lod.osgb", &[1, 1][..], 2080, 0),
        ("external-zlib.osgb", &[1][..], 128, 64 * 64),
        ("modes.osgt", &[1][..], 191, 0),
    ] {
        let counts = converted(&samples.join(name), &folder.path().join(name)).source;
        let found = (counts.levels.as_slice(), counts.triangles, counts.texture_pixels);
        assert_eq!(found, (levels, triangles, pixels), "{name}");
    }
}
