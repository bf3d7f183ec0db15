//! The measures of a survey: errors, edges, skirts, bounds and textures of sets whose true measures are known. No GPU.

use std::fs;
use std::path::Path;

use kit::contents::pnts_bytes;
use terrane::fetch::Limits;
use terrane::formats::writers::{GlbMesh, write_glb, write_height_exr};
use terrane::formats::{MapFrame, SurveyEvent, SurveyOptions, SurveyedTile, Verified, survey, verify};

/// The side of the set, metres.
const SIDE_M: f64 = 1600.0;

/// A tile of two levels: its name and its rectangle.
fn tiles() -> Vec<(String, [f64; 4])> {
    let half = 0.5 * SIDE_M;
    let quarter = |i: u32| {
        let (x, y) = (f64::from(i % 2) * half, f64::from(i / 2) * half);
        (format!("child{i}"), [x, y, x + half, y + half])
    };
    std::iter::once(("root".to_owned(), [0.0, 0.0, SIDE_M, SIDE_M])).chain((0..4).map(quarter)).collect()
}

/// Writes a tileset of the tiles with contents of an ending. `height_m` is half the height of the volumes.
fn write_tileset(folder: &Path, asset: &str, ending: &str, errors_m: [f64; 2], height_m: f64) {
    let json = |(name, [w, s, e, n]): &(String, [f64; 4]), error_m: f64, children: &str| {
        let (x, y, half) = (0.5 * (w + e), 0.5 * (s + n), 0.5 * (e - w));
        format!(
            r#"{{"boundingVolume":{{"box":[{x},{y},0,{half},0,0,0,{half},0,0,0,{height_m}]}},"geometricError":{error_m},
            "refine":"REPLACE","extras":{{"terrane":{{"plane":[{w},{s},{e},{n}]}}}},
            "content":{{"uri":"{name}.{ending}"}},"children":[{children}]}}"#
        )
    };
    let all = tiles();
    let children: Vec<String> = all[1..].iter().map(|tile| json(tile, errors_m[1], "")).collect();
    let root = json(&all[0], errors_m[0], &children.join(","));
    let text = format!(r#"{{"asset":{{"version":"1.1"{asset}}},"geometricError":{},"root":{root}}}"#, errors_m[0]);
    fs::write(folder.join("tileset.json"), text).unwrap();
}

/// Writes a set of height tiles with 5 x 5 samples each.
fn write_heights(folder: &Path, errors_m: [f64; 2], height: impl Fn(&str, [f64; 2]) -> f64) {
    let asset = format!(
        r#","extras":{{"terrane":{{"content":"height","side":5,"border":1,"level_errors_m":[{},{}]}}}}"#,
        errors_m[0], errors_m[1]
    );
    write_tileset(folder, &asset, "exr", errors_m, 100.0);
    for (name, [west, south, east, _]) in tiles() {
        let cell = (east - west) / 4.0;
        let sample = |i: i32, j: i32| height(&name, [west + cell * f64::from(i), south + cell * f64::from(j)]) as f32;
        let rows = (-1..=5).rev();
        let heights = rows.flat_map(|j| (-1..=5).map(move |i| (i, j))).map(|(i, j)| sample(i, j)).collect();
        let exr = write_height_exr(&name, 7, heights).unwrap();
        fs::write(folder.join(format!("{name}.exr")), exr).unwrap();
    }
}

/// Returns the height of a peak of 30 m that only the finer level has.
fn peak(_: &str, [x, y]: [f64; 2]) -> f64 {
    if [x, y] == [200.0, 200.0] { 30.0 } else { 0.0 }
}

fn verified(folder: &Path) -> Verified {
    verify(folder.to_str().unwrap(), &Limits::default(), &mut |_| {}).unwrap()
}

fn problems(verified: &Verified) -> Vec<(&str, u64, &str)> {
    let name = |uri: &'_ str| uri.rfind('/').map_or(0, |at| at + 1);
    verified.problems.iter().map(|p| (p.kind.as_str(), p.count, &p.uri[name(&p.uri)..])).collect()
}

#[test]
fn errors_of_height_tiles_are_measured_against_the_finer_level() {
    let folder = tempfile::tempdir().unwrap();
    write_heights(folder.path(), [30.0, 0.5], peak);
    let found = verified(folder.path());
    assert_eq!((problems(&found), found.failed), (Vec::new(), 0));
    let [root, children] = &found.levels[..] else { panic!("{:?}", found.levels) };
    for error_m in [root.error_to_next_m, root.error_to_finest_m] {
        assert!((error_m.unwrap() - 30.0).abs() < 1e-9, "{error_m:?}");
    }
    assert_eq!((root.geometric_error_m, root.heights_m), (Some([30.0; 2]), Some([0.0; 2])));
    assert_eq!((children.error_to_finest_m, children.heights_m), (None, Some([0.0, 30.0])));
    assert_eq!((children.tiles, children.edges, children.edge_m), (4, 4, Some(0.0)));
    assert_eq!(children.triangles.unwrap().median, 32);
    assert_eq!(children.skirt_m, Some([31.5; 2]));
    assert!(children.bytes.min > 0 && children.bytes.min <= children.bytes.max);

    write_heights(folder.path(), [29.0, 0.0], peak);
    let expected = vec![("geometricError smaller than the measured error", 1, "root.exr")];
    assert_eq!(problems(&verified(folder.path())), expected);
}

#[test]
fn edges_that_differ_are_found_beyond_skirts() {
    let folder = tempfile::tempdir().unwrap();
    let step = |height_m: f64| {
        move |name: &str, [x, y]: [f64; 2]| if name == "child1" && [x, y] == [800.0, 400.0] { height_m } else { 0.0 }
    };
    // Skirts are as deep as the errors of both levels and a metre.
    write_heights(folder.path(), [60.0, 1.0], step(20.0));
    let found = verified(folder.path());
    assert_eq!((problems(&found), found.levels[1].edge_m), (Vec::new(), Some(20.0)));
    write_heights(folder.path(), [60.0, 1.0], step(70.0));
    let found = problems(&verified(folder.path())).into_iter().filter(|(kind, ..)| kind.starts_with("edge")).count();
    assert_eq!(found, 1);
}

#[test]
fn content_outside_of_its_volume_is_named() {
    let folder = tempfile::tempdir().unwrap();
    write_heights(folder.path(), [30.0, 0.0], peak);
    let file = folder.path().join("tileset.json");
    let flat = fs::read_to_string(&file).unwrap().replace("0,0,0,100]", "0,0,0,20]");
    fs::write(&file, flat).unwrap();
    let found = verified(folder.path());
    assert_eq!(problems(&found), [("content outside of the bounding volume of its tile", 1, "child0.exr")]);
    assert!(found.problems[0].detail.starts_with("10.000 m"), "{:?}", found.problems);

    // The error of a tile is at most that of the tile above.
    write_heights(folder.path(), [30.0, 31.0], peak);
    let found = verified(folder.path());
    assert_eq!(problems(&found), [("geometricError larger than that of the tile above", 4, "child0.exr")]);
}

/// Regression: only triangles were looked at. py3dtiles 12 writes glTF of points that is z-up.
#[test]
fn points_outside_of_their_volume_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let box_of = |z: f64| format!(r#"{{"box":[0,0,{z},10,0,0,0,10,0,0,0,1]}}"#);
    for (z, expected) in
        [(0.0, vec![]), (5.0, vec![("content outside of the bounding volume of its tile", 1, "a.pnts")])]
    {
        let text = format!(
            r#"{{"asset":{{"version":"1.1"}},"geometricError":1,
            "root":{{"boundingVolume":{},"geometricError":0,"content":{{"uri":"a.pnts"}}}}}}"#,
            box_of(z)
        );
        fs::write(folder.path().join("tileset.json"), text).unwrap();
        let points = pnts_bytes(r#"{"POINTS_LENGTH":2,"POSITION":[0,0,0,9,9,0.5]}"#, &[]);
        fs::write(folder.path().join("a.pnts"), points).unwrap();
        let found = verified(folder.path());
        assert_eq!(problems(&found), expected);
        assert!(found.problems.iter().all(|problem| problem.detail.starts_with("4.000 m")), "{:?}", found.problems);
    }
}

/// Returns a mesh of 4 x 4 cells with skirts of 50 m, y-up.
fn mesh([west, south, east, _]: [f64; 4], height: impl Fn([f64; 2]) -> f64, image: Option<Vec<u8>>) -> Vec<u8> {
    let cell = (east - west) / 4.0;
    let mut mesh = GlbMesh { base_color: [1.0; 4], image, ..GlbMesh::default() };
    let place = |i: u16, j: u16| [west + cell * f64::from(i), south + cell * f64::from(j)];
    for (i, j) in (0..5).flat_map(|j| (0..5).map(move |i| (i, j))) {
        let [x, y] = place(i, j);
        mesh.positions.push([x as f32, height([x, y]) as f32, -y as f32]);
        mesh.uvs.push([f32::from(i) / 4.0, f32::from(j) / 4.0]);
    }
    let at = |i: u16, j: u16| j * 5 + i;
    for (i, j) in (0..4).flat_map(|j| (0..4).map(move |i| (i, j))) {
        mesh.indices.extend([at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
    }
    let rim: Vec<u16> = (0..4).map(|i| at(i, 0)).chain((0..4).map(|j| at(4, j))).collect();
    let rim: Vec<u16> =
        rim.into_iter().chain((1..=4).rev().map(|i| at(i, 4))).chain((1..=4).rev().map(|j| at(0, j))).collect();
    let first = mesh.positions.len() as u16;
    for top in &rim {
        let [x, up, z] = mesh.positions[usize::from(*top)];
        mesh.positions.push([x, up - 50.0, z]);
        mesh.uvs.push([0.0, 0.0]);
    }
    for k in 0..rim.len() {
        let next = (k + 1) % rim.len();
        let (a, b, c, d) = (rim[k], rim[next], first + k as u16, first + next as u16);
        mesh.indices.extend([a, c, d, a, d, b]);
    }
    write_glb(&mesh)
}

#[test]
fn skirts_of_meshes_are_no_part_of_the_ground() {
    let folder = tempfile::tempdir().unwrap();
    write_tileset(folder.path(), "", "glb", [30.0, 0.0], 60.0);
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbImage::new(8, 4).write_to(&mut png, image::ImageFormat::Png).unwrap();
    let png = png.into_inner();
    for (name, rectangle) in tiles() {
        let glb = mesh(rectangle, |at| peak("", at), Some(png.clone()));
        fs::write(folder.path().join(format!("{name}.glb")), glb).unwrap();
    }
    let found = verified(folder.path());
    assert_eq!((problems(&found), found.failed), (Vec::new(), 0));
    let [root, children] = &found.levels[..] else { panic!("{:?}", found.levels) };
    let error_m = root.error_to_finest_m.unwrap();
    assert!((error_m - 30.0).abs() < 1e-4, "{error_m}");
    assert_eq!((children.skirt_m, children.heights_m), (Some([50.0; 2]), Some([0.0, 30.0])));
    assert_eq!((children.triangles.unwrap().max, children.edges, children.edge_m), (32, 4, Some(0.0)));
    assert_eq!(children.edge_to_coarser_m, Some(0.0));
    assert_eq!(children.textures.get("PNG 8 x 4"), Some(&4), "{:?}", children.textures);
}

#[test]
fn tiles_follow_those_below_them_with_their_rectangles() {
    let folder = tempfile::tempdir().unwrap();
    write_heights(folder.path(), [30.0, 0.0], peak);
    let walk = |reads_contents: bool| {
        let mut found: Vec<SurveyedTile> = Vec::new();
        let options = SurveyOptions { reads_contents, ..SurveyOptions::default() };
        let done = survey(folder.path().to_str().unwrap(), &options, &mut |event| {
            if let SurveyEvent::Tile(tile) = event {
                found.push(tile.clone());
            }
        });
        assert_eq!(done.unwrap().failed, 0);
        found
    };
    let (read, listed) = (walk(true), walk(false));
    for tiles in [&read, &listed] {
        assert_eq!(tiles.iter().map(|tile| tile.level).collect::<Vec<_>>(), [1, 1, 1, 1, 0]);
        let root = &tiles[4];
        assert_eq!((root.frame, root.error_m, root.has_content), (MapFrame::Local, Some(30.0), true));
        let rectangle = root.rectangle.unwrap();
        assert!(rectangle.iter().zip([0.0, 0.0, SIDE_M, SIDE_M]).all(|(a, b)| (a - b).abs() < 1e-3), "{rectangle:?}");
        assert!(root.bytes > 0);
    }
    assert!((read[4].measured_m.unwrap() - 30.0).abs() < 1e-9 && listed[4].measured_m.is_none());
}

/// Tiles of half the earth with skirts of hundreds of kilometres, and poles.
#[test]
fn terrain_of_the_whole_earth_has_no_problems() {
    let folder = tempfile::tempdir().unwrap();
    kit::quantized::write_set(
        folder.path(),
        3,
        |_| true,
        |longitude, latitude| 1000.0 * (2.0 * longitude).sin() * latitude.cos(),
    );
    let found = verify(folder.path().join("layer.json").to_str().unwrap(), &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!((problems(&found), found.failed), (Vec::new(), 0));
    let finest = found.levels.last().unwrap();
    assert!(finest.edges > 32 && finest.edge_m.unwrap() < 1.0, "{finest:?}");
    assert!(finest.skirt_m.unwrap()[0] > 1000.0, "{finest:?}");
    let [low, high] = finest.heights_m.unwrap();
    assert!(low > -1001.0 && high < 1001.0, "{finest:?}");
}
