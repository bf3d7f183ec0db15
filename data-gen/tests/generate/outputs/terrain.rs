//! Quantized-mesh terrain, read back by the library.

use std::path::Path;

use glam::{DAffine3, Vec3};
use serde_json::Value;
use terrane::fetch::Limits;
use terrane::formats::{Content, ReadOptions, SurveyOptions, decode_node, inspect, survey, verify};
use terrane::math::WGS84;
use terrane::scene::{Geometry, Node, NodeKind};
use terrane_data_gen::{
    Color, ContentKind, ElevationSource as _, GenArgs, OutputArgs, Procedural, TileArgs, Triangles, Voids, predict, run,
};

use crate::files::{files_below, from_dem, heights, tiff_float32};
use crate::runs::updates::hills;

fn terrain(folder: &Path, name: &str) -> GenArgs {
    GenArgs { content: ContentKind::QuantizedMesh, levels: Some(14), size: 5_000.0, ..GenArgs::new(folder.join(name)) }
}

/// Returns the vertices of a tile: longitude and latitude in radians and height in metres, without skirts.
fn vertices(set: &Path, name: &str) -> Vec<[f64; 3]> {
    fn collect(node: &Node, parent: DAffine3, out: &mut Vec<[f64; 3]>) {
        let own = match &node.kind {
            NodeKind::Transform(transform) => parent * *transform,
            NodeKind::Geode(drawables) => {
                let Geometry::Mesh(mesh) = &drawables[0].geometry else { panic!("a mesh") };
                out.extend(mesh.vertices.iter().map(|vertex| {
                    let position = parent.transform_point3(Vec3::from_array(vertex.position).as_dvec3());
                    let g = WGS84.geodetic(position);
                    [g.longitude, g.latitude, g.height_m]
                }));
                parent
            }
            _ => parent,
        };
        node.children.iter().for_each(|child| collect(child, own, out));
    }
    let path = set.join(name);
    let uri = path.to_str().unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let content = Content { uri: uri.into(), bytes, reader_data: None, companions: Vec::new() };
    let node = decode_node(content, &ReadOptions::for_root(uri, Limits::default())).unwrap();
    let mut all = Vec::new();
    collect(&node, DAffine3::IDENTITY, &mut all);
    // The vertices of skirts lie below others.
    let mut found: Vec<[f64; 3]> = Vec::new();
    all.sort_by(|a, b| b[2].total_cmp(&a[2]));
    for vertex in all {
        if !found.iter().any(|of| (of[0] - vertex[0]).abs().max((of[1] - vertex[1]).abs()) < 1e-9) {
            found.push(vertex);
        }
    }
    found
}

fn layer(set: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(set.join("layer.json")).unwrap()).unwrap()
}

/// The tiles of a level by layer.json.
fn tiles(layer: &Value, level: usize) -> Vec<[u64; 2]> {
    let mut tiles = Vec::new();
    for range in layer["available"][level].as_array().unwrap() {
        let number = |name: &str| range[name].as_u64().unwrap();
        for y in number("startY")..=number("endY") {
            tiles.extend((number("startX")..=number("endX")).map(|x| [x, y]));
        }
    }
    tiles
}

#[test]
fn heights_are_those_of_the_source_to_the_quantum() {
    let folder = tempfile::tempdir().unwrap();
    let source = Procedural { seed: 1, cos_latitude: 47f64.to_radians().cos() };
    let grid = TileArgs { triangles: Triangles::Grid, ..TileArgs::default() };
    let args = GenArgs { tiles: grid, ..terrain(folder.path(), "grid") };
    let summary = run(&args).unwrap();
    assert!(summary.max_height_m > summary.min_height_m + 100.0, "{summary}");
    let layer = layer(&args.out);
    let bounds: Vec<f64> = layer["bounds"].as_array().unwrap().iter().map(|b| b.as_f64().unwrap()).collect();
    let [x, y] = *tiles(&layer, 13)
        .iter()
        .find(|[x, y]| {
            // A tile wholly inside of the source.
            let side = 180.0 / 8192.0;
            let [west, south] = [*x as f64 * side - 180.0, *y as f64 * side - 90.0];
            west > bounds[0] && south > bounds[1] && west + side < bounds[2] && south + side < bounds[3]
        })
        .unwrap();
    let read = vertices(&args.out, &format!("13/{x}/{y}.terrain"));
    assert_eq!(read.len(), 65 * 65);
    let range = [f64::MAX, f64::MIN];
    let range = read.iter().fold(range, |r, v| [r[0].min(v[2]), r[1].max(v[2])]);
    let quantum_m = (range[1] - range[0]) / 32767.0;
    let cell = 180f64.to_radians() / 8192.0 / 64.0;
    for [longitude, latitude, height_m] in read {
        // Positions have steps of 1/32,767 of a side; the height is that of the next vertex of the lattice.
        let [longitude, latitude] = [longitude, latitude].map(|c| ((c + 90f64.to_radians()) / cell).round() * cell);
        let [longitude, latitude] = [longitude, latitude].map(|c| c - 90f64.to_radians());
        let expected_m = source.height_m(longitude, latitude).unwrap().unwrap();
        let off_m = (height_m - expected_m).abs();
        assert!(off_m <= 0.5 * quantum_m + 1.0 / 256.0 + 1e-3, "{height_m} instead of {expected_m}");
    }
}

#[test]
fn sets_are_whole_and_do_not_depend_on_the_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let output = OutputArgs { attribution: Some("© the noise".to_owned()), ..OutputArgs::default() };
    let args = |name: &str, jobs| GenArgs {
        jobs: Some(jobs),
        levels: Some(13),
        output: output.clone(),
        ..terrain(folder.path(), name)
    };
    let (one, four) = (args("one", 1), args("four", 4));
    let summary = run(&one).unwrap();
    run(&four).unwrap();
    let files = files_below(&one.out);
    assert!(files == files_below(&four.out));
    assert_eq!(summary.bytes, files.values().map(|bytes| bytes.len() as u64).sum::<u64>());
    let layer = layer(&one.out);
    assert_eq!(layer["attribution"], "© the noise");
    let count: usize = (0..13).map(|level| tiles(&layer, level).len()).sum();
    assert_eq!((count as u64, files.len()), (summary.tiles, count + 1));
    for [x, y] in tiles(&layer, 12) {
        assert!(files.contains_key(&format!("12/{x}/{y}.terrain")));
    }
    let source = one.out.to_string_lossy();
    let info = inspect(&source, &Limits::default()).unwrap();
    assert!(info.errors.is_empty() && info.ignored.is_empty(), "{info:?}");
    let verified = verify(&source, &Limits::default(), &mut |_| ()).unwrap();
    assert!(verified.failed == 0 && verified.ignored.is_empty(), "{verified:?}");
    assert!(verified.contents >= summary.tiles, "{verified:?}");
    // Triangles are few, and a set is replaced by another.
    let grid = TileArgs { triangles: Triangles::Grid, ..TileArgs::default() };
    let replaced = run(&GenArgs { tiles: grid, overwrite: true, ..args("one", 2) }).unwrap();
    assert!(replaced.bytes > 2 * summary.bytes, "{} {}", replaced.bytes, summary.bytes);
}

/// Clients cull a tile that is not loaded yet by the heights of the tile above.
#[test]
fn headers_have_the_heights_of_finer_tiles() {
    let folder = tempfile::tempdir().unwrap();
    let args = GenArgs { levels: Some(13), ..terrain(folder.path(), "set") };
    run(&args).unwrap();
    let layer = layer(&args.out);
    let range = |level: usize, [x, y]: [u64; 2]| {
        let bytes = std::fs::read(args.out.join(format!("{level}/{x}/{y}.terrain"))).unwrap();
        [24, 28].map(|at| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()))
    };
    for level in 1..13 {
        for [x, y] in tiles(&layer, level) {
            let (own, above) = (range(level, [x, y]), range(level - 1, [x / 2, y / 2]));
            assert!(above[0] <= own[0] && own[1] <= above[1], "{level}/{x}/{y}: {own:?} in {above:?}");
        }
    }
}

#[test]
fn samples_of_a_file_have_their_heights_and_voids_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let mut samples = heights();
    for k in [820, 821, 822, 860, 861, 862] {
        samples[k] = -9999.0;
    }
    let dem = tiff_float32(&samples, Some(crate::files::PLACE), Some("-9999"));
    let args =
        GenArgs { content: ContentKind::QuantizedMesh, levels: None, ..from_dem(folder.path(), "dem.tif", &dem) };
    // The cells of few levels are larger than the source.
    let error = run(&GenArgs { levels: Some(2), ..args.clone() }).unwrap_err().to_string();
    assert!(error.contains("--levels"), "{error}");
    let summary = run(&args).unwrap();
    let known = samples.iter().filter(|h| **h > 0.0);
    let highest = known.fold(0.0f32, |a, b| a.max(*b));
    assert!((summary.max_height_m - f64::from(highest)).abs() < 0.01, "{summary}");
    assert!(summary.filled_samples > 0 && summary.notes.iter().any(|note| note.contains("no holes")));
    let sea = run(&GenArgs { voids: Voids::Sea, overwrite: true, ..args }).unwrap();
    assert!(sea.notes.is_empty() && sea.filled_samples == summary.filled_samples, "{sea:?}");
}

#[test]
fn options_without_effect_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let of = |change: &dyn Fn(&mut GenArgs)| {
        let mut args = terrain(folder.path(), "set");
        change(&mut args);
        run(&args).unwrap_err().to_string()
    };
    assert!(of(&|args| args.color = Color::None).contains("--color"));
    assert!(of(&|args| args.tiles.no_meshopt = true).contains("--no-meshopt"));
    assert!(of(&|args| args.float_vertices = true).contains("--float-vertices"));
    let aligned = |args: &mut GenArgs| {
        args.dem.push(folder.path().join("dem.tif"));
        args.run.aligned = true;
    };
    assert!(of(&aligned).contains("--aligned has no effect"));
    assert!(of(&|args| args.run.memory = Some(8 << 20)).contains("--memory is too small"));
    assert!(
        of(&|args| {
            args.content = ContentKind::Mesh;
            args.output.attribution = Some("me".to_owned());
        })
        .contains("--attribution")
    );
}

#[test]
fn prediction_has_the_tiles_and_about_the_bytes_of_the_run_and_memory_changes_no_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let args = GenArgs { levels: Some(14), ..terrain(folder.path(), "set") };
    let predicted = predict(&args).unwrap();
    let made = run(&args).unwrap();
    assert_eq!((predicted.tiles, predicted.levels.len()), (made.tiles, 14), "{predicted:?}");
    let share = predicted.bytes as f64 / made.bytes as f64;
    assert!((0.5..2.0).contains(&share), "{} of {} bytes", predicted.bytes, made.bytes);
    assert!(predicted.sampled_tiles > 0 && predicted.seconds > 0.0, "{predicted:?}");
    let mut small = terrain(folder.path(), "small");
    small.run.memory = Some(96 << 20);
    run(&small).unwrap();
    assert!(files_below(&args.out) == files_below(&small.out));
}

#[test]
fn shards_merge_to_the_bytes_of_one_run() {
    let folder = tempfile::tempdir().unwrap();
    let args = |name: &str| GenArgs { levels: Some(13), ..terrain(folder.path(), name) };
    let whole = run(&args("whole")).unwrap();
    let shard = |text: &str| {
        let mut args = args("parts");
        args.jobs = Some(1);
        args.sharding.shard = Some(text.parse().unwrap());
        run(&args)
    };
    let mut merge = args("parts");
    merge.sharding.merge = true;
    let made: Vec<_> = ["1/3", "3/3"].map(|text| shard(text).unwrap()).into();
    let error = run(&merge).unwrap_err().to_string();
    assert!(error.contains("2/3; make them with --shard"), "{error}");
    shard("2/3").unwrap();
    assert!(made.iter().any(|shard| shard.tiles > 0));
    let merged = run(&merge).unwrap();
    assert_eq!((merged.tiles, merged.bytes), (whole.tiles, whole.bytes));
    assert_eq!((merged.min_height_m, merged.max_height_m), (whole.min_height_m, whole.max_height_m));
    assert!(files_below(&merged.out) == files_below(&whole.out));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "two sets");
}

/// Clients find the finer tiles by the metadata of each tenth level.
#[test]
fn tiles_name_the_finer_tiles() {
    let folder = tempfile::tempdir().unwrap();
    let output = OutputArgs { tile_availability: true, ..OutputArgs::default() };
    let args = GenArgs { levels: Some(13), output, ..terrain(folder.path(), "set") };
    let summary = run(&args).unwrap();
    let plain = GenArgs { levels: Some(13), ..terrain(folder.path(), "plain") };
    run(&plain).unwrap();
    let (own, other) = (layer(&args.out), layer(&plain.out));
    assert_eq!((&own["metadataAvailability"], own["available"].as_array().unwrap().len()), (&10.into(), 1));
    assert!(files_below(&args.out).keys().eq(files_below(&plain.out).keys()));
    // The JSON is at the end of the tile.
    let metadata = |name: &str| -> Option<Value> {
        let bytes = std::fs::read(args.out.join(name)).unwrap();
        let start = bytes.windows(14).position(|part| part == b"{\"available\":[")?;
        Some(serde_json::from_slice(&bytes[start..]).unwrap())
    };
    let below: Vec<Value> =
        (0..2).map(|x| metadata(&format!("0/{x}/0.terrain")).unwrap()["available"].clone()).collect();
    let halves = below.iter().map(|below| tiles(&serde_json::json!({ "available": below }), 0).len());
    assert_eq!(halves.sum::<usize>(), tiles(&other, 1).len());
    let [x, y] = tiles(&other, 10)[0];
    let below = metadata(&format!("10/{x}/{y}.terrain")).unwrap();
    assert_eq!(below["available"].as_array().unwrap().len(), 2);
    assert!(metadata(&format!("1/{}/{}.terrain", x >> 9, y >> 9)).is_none());
    let source = args.out.to_string_lossy();
    let verified = verify(&source, &Limits::default(), &mut |_| ()).unwrap();
    assert!(verified.failed == 0 && verified.ignored.is_empty(), "{verified:?}");
    assert!(verified.contents >= summary.tiles, "{} {verified:?}", summary.tiles);
}

#[test]
fn tiles_meet_at_the_date_line_and_reach_the_pole() {
    let folder = tempfile::tempdir().unwrap();
    let terrain = |name: &str, corner: [f64; 2]| {
        let dem = vec![hills(folder.path(), &format!("{name}.tif"), corner, 40, 1)];
        let args = GenArgs { dem, content: ContentKind::QuantizedMesh, ..GenArgs::new(folder.path().join(name)) };
        run(&args).unwrap();
        let options = SurveyOptions { measures: false, ..SurveyOptions::default() };
        let verified = survey(&args.out.to_string_lossy(), &options, &mut |_| ()).unwrap();
        assert!(verified.failed == 0 && verified.ignored.is_empty(), "{verified:?}");
        args.out
    };
    let set = terrain("line", [179.945, -16.0]);
    let layer_json = layer(&set);
    let level = layer_json["maxzoom"].as_u64().unwrap() as usize;
    let last = (2 << level) - 1;
    let mut edges = 0;
    for [_, y] in tiles(&layer_json, level).into_iter().filter(|[x, _]| *x == 0) {
        let edge = |x: u64| {
            let vertices = vertices(&set, &format!("{level}/{x}/{y}.terrain")).into_iter();
            let mut edge: Vec<[f64; 2]> = vertices
                .filter(|[longitude, ..]| longitude.abs() > std::f64::consts::PI - 1e-9)
                .map(|[_, latitude, height_m]| [latitude, height_m])
                .collect();
            edge.sort_by(|a, b| a[0].total_cmp(&b[0]));
            edge
        };
        let (west, east) = (edge(last), edge(0));
        assert_eq!(west.len(), east.len());
        assert!(east.iter().zip(&west).all(|(a, b)| (a[0] - b[0]).abs() < 1e-8 && (a[1] - b[1]).abs() < 0.05));
        edges += usize::from(east.iter().any(|[_, height_m]| *height_m > 300.0));
    }
    assert!(edges > 0, "the source lies on both sides");
    let set = terrain("pole", [10.0, 90.0]);
    let layer_json = layer(&set);
    let level = layer_json["maxzoom"].as_u64().unwrap() as usize;
    let top = tiles(&layer_json, level).into_iter().filter(|[_, y]| *y + 1 == 1 << level);
    let heights: Vec<f64> = top
        .flat_map(|[x, y]| vertices(&set, &format!("{level}/{x}/{y}.terrain")))
        // The outermost samples lie half a pixel from the pole.
        .filter(|[_, latitude, _]| *latitude > std::f64::consts::FRAC_PI_2 - 2e-4)
        .map(|[.., height_m]| height_m)
        .collect();
    assert!(heights.iter().any(|height_m| (400.0..700.0).contains(height_m)), "{heights:?}");
}
