//! Folders of oblique photogrammetry.

use std::path::Path;

use glam::DVec3;
use kit::pager::{Run, above};
use terrane::fetch::{Limits, root_uri};
use terrane::formats::{inspect, verify};
use terrane::math::{Geodetic, TransverseMercator, WGS84};
use terrane::pager::PagerConfig;
use terrane::viewer::LoadedRoot;

use kit::osg_files::{VERSION, geode, osgt, triangle};

/// The top file of a tile around a point of its set.
fn tile(center: [f64; 3]) -> String {
    let [x, y, z] = center;
    osgt(
        VERSION,
        &format!(
            "osg::PagedLOD {{ UniqueID 1 CenterMode USER_DEFINED_CENTER UserCenter {x} {y} {z} 20
            RangeMode PIXEL_SIZE_ON_SCREEN RangeList 2 {{ 0 1000 1000 1e+30 }}
            RangeDataList 2 {{ \"\" \"fine.osgt\" }} PriorityList 2 {{ 0 1 0 1 }} Children 1 {{ {} }} }}",
            geode(2, "", &[triangle(3, "")])
        ),
    )
}

fn set(folder: &Path, srs: &str, tiles: &[(&str, [f64; 3])]) {
    let origin = if srs.starts_with("EPSG") { "463900,5248700,400" } else { "0,0,0" };
    let metadata = format!(
        "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<ModelMetadata version=\"1\"><SRS>{srs}</SRS>
        <SRSOrigin>{origin}</SRSOrigin></ModelMetadata>"
    );
    std::fs::write(folder.join("metadata.xml"), metadata).unwrap();
    for (name, center) in tiles {
        let of_tile = folder.join("Data").join(name);
        std::fs::create_dir_all(&of_tile).unwrap();
        std::fs::write(of_tile.join(format!("{name}.osgb")), tile(*center)).unwrap();
        std::fs::write(of_tile.join("fine.osgt"), osgt(VERSION, &geode(1, "", &[triangle(2, "")]))).unwrap();
    }
}

#[test]
fn folders_open_by_their_path_and_lie_on_the_earth() {
    let folder = tempfile::tempdir().unwrap();
    let tiles = [("Tile_+000_+000", [0.0, 0.0, 5.0]), ("Tile_+010_-003", [1000.0, -300.0, 5.0])];
    set(folder.path(), "EPSG:32632", &tiles);
    std::fs::create_dir(folder.path().join("Data/thumbnails")).unwrap();
    let path = folder.path().to_str().unwrap();
    assert!(root_uri(path).unwrap().ends_with("metadata.xml"));
    let root = LoadedRoot::read(path, &PagerConfig::default()).unwrap();
    drop(root);

    let info = inspect(path, &Limits::default()).unwrap();
    assert_eq!(info.format, "oblique photogrammetry (metadata.xml)");
    assert_eq!((info.details["srs"].as_str(), info.details["origin"].as_str()), ("EPSG:32632", "463900, 5248700, 400"));
    let model = info.model.unwrap();
    assert_eq!((model.paged_files, model.drawables, model.triangles), (2, 2, 2), "{model:?}");
    // Both tiles are inside of the bounds, which lie where the grid says.
    let grid = TransverseMercator::utm(32, false);
    let center = DVec3::from_array(info.bounds.center);
    for (_, [x, y, z]) in tiles {
        let at = WGS84.ecef(&grid.unproject([463_900.0 + x, 5_248_700.0 + y], 400.0 + z));
        assert!(center.distance(at) < info.bounds.radius_m, "{x} {y}");
    }
    assert!(info.bounds.radius_m < 700.0, "{}", info.bounds.radius_m);
    let at = WGS84.geodetic(center);
    assert!((at.latitude.to_degrees() - 47.39).abs() < 0.01 && (at.longitude.to_degrees() - 8.53).abs() < 0.01);

    let verified = verify(path, &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!((verified.contents, verified.failed), (5, 0), "{verified:?}");
}

#[test]
fn local_frames_and_unknown_systems() {
    let folder = tempfile::tempdir().unwrap();
    let tiles = [("Tile_+000_+000", [0.0; 3])];
    set(folder.path(), "ENU:47.5,8.25", &tiles);
    let path = folder.path().join("metadata.xml");
    let path = path.to_str().unwrap();
    let info = inspect(path, &Limits::default()).unwrap();
    let expected = Geodetic { longitude: 8.25f64.to_radians(), latitude: 47.5f64.to_radians(), height_m: 0.0 };
    assert!(DVec3::from_array(info.bounds.center).distance(WGS84.ecef(&expected)) < 1.0);

    set(folder.path(), "EPSG:2056", &tiles);
    let error = inspect(path, &Limits::default()).unwrap_err().to_string();
    assert!(error.contains("reference system \"EPSG:2056\" is not supported"), "{error}");
    std::fs::remove_dir_all(folder.path().join("Data")).unwrap();
    set(folder.path(), "", &[]);
    let error = inspect(path, &Limits::default()).unwrap_err();
    assert!(error.uri().contains("Data"), "{error}");
}

/// A tile whose top file is broken fails alone.
#[test]
fn broken_tiles_leave_the_others() {
    let folder = tempfile::tempdir().unwrap();
    set(folder.path(), "ENU:0,0", &[("Tile_a", [0.0; 3]), ("Tile_b", [9.0, 0.0, 0.0])]);
    std::fs::write(folder.path().join("Data/Tile_a/Tile_a.osgb"), "broken").unwrap();
    let verified = verify(folder.path().to_str().unwrap(), &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!((verified.contents, verified.failed), (3, 1), "{verified:?}");
    assert!(verified.errors[0].uri.ends_with("Tile_a.osgb"));
}

/// Regression: the top files were read for their bounds, and once more when they were drawn.
#[test]
fn top_files_are_read_once() {
    let folder = tempfile::tempdir().unwrap();
    set(folder.path(), "", &[("Tile_+000_+000", [0.5, 0.5, 0.0])]);
    let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig::default());
    std::fs::remove_file(folder.path().join("Data/Tile_+000_+000/Tile_+000_+000.osgb")).unwrap();
    run.settle(above(100.0));
    assert_eq!((run.stage.leaf_count(), run.pager.stats().bytes_read), (1, run.root_bytes));
}

/// From far away the triangle in the top file is drawn, and nearby the two of the file that replaces it.
#[test]
fn the_pager_replaces_what_is_in_the_file_by_other_files() {
    let folder = tempfile::tempdir().unwrap();
    set(folder.path(), "", &[("Tile_+000_+000", [0.5, 0.5, 0.0])]);
    let fine = osgt(VERSION, &geode(1, "", &[triangle(2, ""), triangle(12, "")]));
    std::fs::write(folder.path().join("Data/Tile_+000_+000/fine.osgt"), fine).unwrap();
    let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig::default());
    run.settle(above(100.0));
    assert_eq!((run.stage.leaf_count(), run.pager.errors().len()), (1, 0), "{:?}", run.pager.errors());
    run.settle(above(10.0));
    assert_eq!((run.stage.leaf_count(), run.pager.errors().len()), (2, 0), "{:?}", run.pager.errors());
    // Without its file the coarse one stays.
    std::fs::remove_file(folder.path().join("Data/Tile_+000_+000/fine.osgt")).unwrap();
    let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig::default());
    run.settle(above(10.0));
    assert_eq!((run.stage.leaf_count(), run.pager.errors().len()), (1, 1));
}
