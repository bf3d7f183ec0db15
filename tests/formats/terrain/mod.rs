//! Terrain services: the tree, the meshes of tiles, and what is told about files.

mod fuzz_parsers;

use std::path::Path;

use glam::{DAffine3, DVec3, Vec3};
use kit::quantized::{TerrainTile, layer_json, ranges, tile_at, write_set};
use terrane::fetch::{Limits, read_file};
use terrane::formats::{Content, ReadOptions, decode_node, ellipsoid, inspect, verify};
use terrane::math::{BoundingVolume, Region, WGS84};
use terrane::scene::{Geometry, Mesh, Node, NodeKind, PagedLod, ReaderData};

/// A place near the antimeridian, radians.
const PLACE: [f64; 2] = [3.13, -0.7];

fn height(longitude: f64, latitude: f64) -> f64 {
    2000.0 + 1500.0 * (20.0 * longitude).sin() * (25.0 * latitude).cos()
}

fn contains([level, x, y]: [u32; 3]) -> bool {
    tile_at(level, PLACE[0], PLACE[1]) == [level, x, y]
}

/// A tile of the tree with its mesh.
struct ReadTile {
    uri: String,
    region: Region,
    mesh: Mesh,
    origin: DVec3,
}

/// Reads the tiles of a set in which a view of the place ends: those that are not divided.
fn finest_tiles(folder: &Path) -> Vec<ReadTile> {
    let root = folder.join("layer.json").to_str().unwrap().to_owned();
    let options = ReadOptions::for_root(&root, Limits::default());
    let bytes = std::fs::read(&root).unwrap();
    let mut tiles = Vec::new();
    collect(&decode(&root, bytes, None, &options), &options, &mut tiles);
    tiles
}

fn decode(uri: &str, bytes: Vec<u8>, reader_data: Option<ReaderData>, options: &ReadOptions) -> Node {
    decode_node(Content { uri: uri.into(), bytes, reader_data, companions: Vec::new() }, options).unwrap()
}

fn collect(node: &Node, options: &ReadOptions, tiles: &mut Vec<ReadTile>) {
    let NodeKind::PagedLod(tile) = &node.kind else {
        return node.children.iter().for_each(|child| collect(child, options, tiles));
    };
    let data = tile.reader_data.as_ref().unwrap();
    let is_page = data.continues_tileset();
    if !is_page && !node.children.is_empty() {
        return node.children.iter().for_each(|child| collect(child, options, tiles));
    }
    // The other half of the earth has only the ellipsoid.
    let BoundingVolume::Region(region) = tile.bounds else { panic!("a region") };
    if is_page && region.max_height_m == 0.0 {
        return;
    }
    let content = read(tile, options);
    if is_page {
        collect(&content, options, tiles);
    } else {
        let (origin, mesh) = mesh_of(&content);
        tiles.push(ReadTile { uri: tile.content.as_deref().unwrap().to_owned(), region, mesh, origin });
    }
}

fn read(tile: &PagedLod, options: &ReadOptions) -> Node {
    let (uri, data) = (tile.content.as_ref().unwrap(), tile.reader_data.clone().unwrap());
    let bytes = if data.is_whole_content() { Vec::new() } else { read_file(uri, &options.limits).unwrap() };
    decode(uri, bytes, Some(data), options)
}

fn mesh_of(content: &Node) -> (DVec3, Mesh) {
    let NodeKind::Transform(DAffine3 { translation, .. }) = content.kind else { panic!("a transform") };
    let NodeKind::Geode(drawables) = &content.children[0].kind else { panic!("a geode") };
    let Geometry::Mesh(mesh) = &drawables[0].geometry else { panic!("a mesh") };
    (translation, (**mesh).clone())
}

/// Returns the corners of each triangle relative to the earth's centre, without skirts.
fn surface(tile: &ReadTile) -> Vec<[DVec3; 3]> {
    let at = |i: u32| tile.origin + Vec3::from_array(tile.mesh.vertices[i as usize].position).as_dvec3();
    let triangles = tile.mesh.indices.chunks_exact(3).map(|t| [at(t[0]), at(t[1]), at(t[2])]);
    let faces_up = |[a, b, c]: &[DVec3; 3]| {
        let normal = (*b - *a).cross(*c - *a).normalize_or_zero();
        normal.dot(WGS84.up(&WGS84.geodetic(*a))) > 0.05
    };
    triangles.filter(faces_up).collect()
}

/// Along a line from space to the middle of the earth there is exactly one surface, at the height of the ground.
#[test]
fn tiles_and_parts_of_tiles_cover_the_ground_once() {
    for (levels, has) in [
        (7, (|at: [u32; 3]| at[0] == 0 || contains(at)) as fn([u32; 3]) -> bool),
        (7, |[level, x, y]| level < 2 || contains([level - 1, x / 2, y / 2])),
        (8, |[level, x, y]| (level < 2 || contains([level - 1, x / 2, y / 2])) && (x + y) % 3 != 0 || level == 0),
    ] {
        let folder = tempfile::tempdir().unwrap();
        write_set(folder.path(), levels, has, height);
        let tiles = finest_tiles(folder.path());
        assert!(tiles.len() >= 16, "{} tiles", tiles.len());
        let surfaces: Vec<_> = tiles.iter().map(surface).collect();
        let side = 0.04;
        let mut checked = 0;
        for (i, j) in (0..30).flat_map(|i| (0..30).map(move |j| (f64::from(i), f64::from(j)))) {
            let longitude = PLACE[0] - 0.5 * side + side * (i + 0.31) / 30.0;
            let latitude = PLACE[1] - 0.5 * side + side * (j + 0.37) / 30.0;
            let place = terrane::math::Geodetic { longitude, latitude, height_m: 0.0 };
            let (from, direction) = (WGS84.ecef(&place), WGS84.up(&place));
            let wrapped = (longitude + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI;
            let hits: Vec<f64> =
                surfaces.iter().flatten().filter_map(|triangle| height_above(from, direction, triangle)).collect();
            assert!(!hits.is_empty(), "a hole at {longitude} {latitude}");
            let (low, high) = hits.iter().fold((f64::MAX, f64::MIN), |(low, high), h| (low.min(*h), high.max(*h)));
            // Tiles beside each other may overlap by rounding.
            assert!(high - low < 1.0, "two surfaces at {longitude} {latitude}: {hits:?}");
            let ground = height(wrapped, latitude);
            let near = tiles.iter().filter(|tile| is_in(&tile.region, wrapped, latitude));
            let is_own =
                near.clone().any(|tile| !tile.uri.contains('#') && tile.uri.contains(&format!("/{}/", levels - 1)));
            assert_eq!(near.count(), 1, "one tile at {longitude} {latitude}");
            if is_own {
                assert!((hits[0] - ground).abs() < 60.0, "{} instead of {ground}", hits[0]);
                checked += 1;
            }
        }
        assert!(checked > 0);
    }
}

fn is_in(region: &Region, longitude: f64, latitude: f64) -> bool {
    (region.west..region.east).contains(&longitude) && (region.south..region.north).contains(&latitude)
}

/// Returns the height above `from` at which a line up meets a triangle.
fn height_above(from: DVec3, direction: DVec3, [a, b, c]: &[DVec3; 3]) -> Option<f64> {
    if (*a - from).cross(direction).length_squared() > 4e12 {
        return None;
    }
    let (ab, ac) = (*b - *a, *c - *a);
    let p = direction.cross(ac);
    let determinant = ab.dot(p);
    let s = (from - *a) / determinant;
    let q = s.cross(ab);
    let (u, v) = (s.dot(p), direction.dot(q));
    let is_inside = u >= 0.0 && v >= 0.0 && u + v <= 1.0;
    let t = ac.dot(q);
    (is_inside && t > -1e6).then_some(t)
}

#[test]
fn vertices_have_places_texture_coordinates_and_normals() {
    let height =
        |longitude: f64, latitude: f64| 2000.0 + 1500.0 * (2000.0 * longitude).sin() * (1500.0 * latitude).cos();
    for has_normals in [false, true] {
        let [level, x, y] = tile_at(9, PLACE[0], PLACE[1]);
        let tile = TerrainTile { has_normals, ..TerrainTile::new([level, x, y], height) };
        let uri = format!("/set/{level}/{x}/{y}.terrain");
        let options = ReadOptions::for_root(&uri, Limits::default());
        let (origin, mesh) = mesh_of(&decode(&uri, tile.bytes(), None, &options));
        let [west, south, east, north] = tile.rectangle();
        let mut lowest = f64::MAX;
        for vertex in &mesh.vertices {
            let place = WGS84.geodetic(origin + Vec3::from_array(vertex.position).as_dvec3());
            let [u, v] = vertex.uv.map(f64::from);
            assert!((west + (east - west) * u - place.longitude).abs() < 1e-7, "{place:?}");
            assert!((north + (south - north) * v - place.latitude).abs() < 1e-7, "{place:?}");
            let below = height(place.longitude, place.latitude) - place.height_m;
            lowest = lowest.min(-below);
            // A vertex of the surface, or of a skirt five errors below it.
            assert!(below.abs() < 0.5 || (below - 5.0 * 77067.34 / 512.0).abs() < 1.0, "{below} m below the ground");
            let normal =
                Vec3::from_array(vertex.normal[..3].try_into().map(|n: [i8; 3]| n.map(f32::from)).unwrap()) / 127.0;
            let up = WGS84.up(&place).as_vec3();
            let limit = if has_normals { 0.999 } else { 0.5 };
            assert!(normal.dot(up) > limit && (normal.length() - 1.0).abs() < 0.02, "{normal} {up}");
        }
        assert!(lowest < -700.0, "there are skirts");
        let is_flat = mesh.vertices.iter().all(|vertex| {
            let place = WGS84.geodetic(origin + Vec3::from_array(vertex.position).as_dvec3());
            let normal = vertex.normal.map(f32::from);
            Vec3::new(normal[0], normal[1], normal[2]).normalize().dot(WGS84.up(&place).as_vec3()) > 0.9995
        });
        assert_eq!(is_flat, has_normals, "computed normals follow the slopes");
    }
}

#[test]
fn root_tiles_of_the_ellipsoid_touch_and_reach_the_poles() {
    let options = ReadOptions::for_root("globe", Limits::default());
    let root = ellipsoid(WGS84);
    assert_eq!(root.children.len(), 2);
    let mut regions = Vec::new();
    for child in &root.children {
        let NodeKind::PagedLod(tile) = &child.kind else { panic!("a tile") };
        let BoundingVolume::Region(region) = tile.bounds else { panic!("a region") };
        regions.push([region.west, region.south, region.east, region.north]);
        assert_reaches_pole(tile, &options);
    }
    let pi = std::f64::consts::PI;
    assert_eq!(regions, [[-pi, -0.5 * pi, 0.0, 0.5 * pi], [0.0, -0.5 * pi, pi, 0.5 * pi]]);
}

/// In Web Mercator rows are not equally high, and the ellipsoid closes the poles.
#[test]
fn web_mercator_reaches_the_poles_by_the_ellipsoid() {
    let options = ReadOptions::for_root("/set/layer.json", Limits::default());
    let json = layer_json(&format!(r#""available":{}"#, r#"[[{"startX":0,"startY":0,"endX":0,"endY":0}]]"#));
    let root = decode("/set/layer.json", json.replace("EPSG:4326", "EPSG:3857").into_bytes(), None, &options);
    let tiles = root.children.iter().map(|child| match &child.kind {
        NodeKind::PagedLod(tile) => tile,
        other => panic!("{other:?}"),
    });
    let tiles: Vec<_> = tiles.collect();
    assert_eq!(tiles.len(), 17);
    let regions: Vec<Region> = tiles
        .iter()
        .map(|tile| match tile.bounds {
            BoundingVolume::Region(region) => region,
            other => panic!("{other:?}"),
        })
        .collect();
    let area = |region: &Region| region.width() * (region.north.sin() - region.south.sin());
    assert!((regions.iter().map(area).sum::<f64>() - 4.0 * std::f64::consts::PI).abs() < 1e-9, "{regions:?}");
    assert_eq!(tiles[0].content.as_deref(), Some("/set/layer.json#0/0/0"));
    for tile in &tiles[1..] {
        assert!(tile.reader_data.as_ref().unwrap().is_whole_content());
        assert_reaches_pole(tile, &options);
    }
}

/// Checks that the first mesh of a page reaches a pole.
fn assert_reaches_pole(page: &PagedLod, options: &ReadOptions) {
    let page = read(page, options);
    let NodeKind::PagedLod(first) = &page.children[0].kind else { panic!("a tile") };
    let (origin, mesh) = mesh_of(&read(first, options));
    let highest = mesh.vertices.iter().map(|v| (origin.z + f64::from(v.position[2])).abs()).fold(0.0, f64::max);
    assert!((highest - WGS84.semi_minor_m).abs() < 1.0, "{highest}");
}

/// Regression: one tile in 256 was refused as a web page.
#[test]
fn tile_whose_first_byte_is_that_of_markup_is_read() {
    let mut bytes = TerrainTile::new([3, 5, 4], height).bytes();
    let options = ReadOptions::for_root("/set/layer.json", Limits::default());
    for first in [b'<', b'{'] {
        bytes[0] = first;
        decode("/set/3/5/4.terrain", bytes.clone(), None, &options);
    }
    let page = b"<html><head><title>503 Service Unavailable</title></head></html>".to_vec();
    let content = Content { uri: "/set/3/5/4.terrain".into(), bytes: page, reader_data: None, companions: Vec::new() };
    assert!(decode_node(content, &options).unwrap_err().to_string().contains("a web page"));
}

#[test]
fn files_are_described_and_verified() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path(), 5, |at| at[0] == 0 || contains(at), height);
    let source = folder.path().to_str().unwrap();
    let info = inspect(source, &Limits::default()).unwrap();
    assert_eq!((&*info.format, &*info.version, info.tiles, info.failed), ("quantized-mesh terrain", "1.0.0", 6, 0));
    assert_eq!(info.levels.iter().map(|level| level.tiles).collect::<Vec<_>>(), [2, 1, 1, 1, 1]);
    assert_eq!(info.details["tiling"], "EPSG:4326 (geographic)");
    assert!(info.details["layers"].contains("/0/0/0.terrain"), "{:?}", info.details);
    let verified = verify(source, &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!((verified.failed, verified.ignored.len()), (0, 0), "{verified:?}");
    // 6 files, 3 parts of the tile above on each of 4 levels, and the ellipsoid above the roots.
    assert_eq!(verified.contents, 6 + 12 + 2);
    let [level, x, y] = tile_at(4, PLACE[0], PLACE[1]);
    let file = folder.path().join(format!("{level}/{x}/{y}.terrain"));
    let info = inspect(file.to_str().unwrap(), &Limits::default()).unwrap();
    assert_eq!(info.format, "quantized-mesh tile");
    assert_eq!(info.model.unwrap().triangles, 512 + 4 * 32, "the surface and its skirts");
    std::fs::write(&file, b"rubbish").unwrap();
    let verified = verify(source, &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!(verified.failed, 1, "{verified:?}");
    assert!(verified.errors[0].uri.ends_with(".terrain") && verified.errors[0].reason.contains("7 bytes"));
}

#[test]
fn unusual_parts_are_noted() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| {
        std::fs::create_dir_all(folder.path().join(name).parent().unwrap()).unwrap();
        std::fs::write(folder.path().join(name), bytes).unwrap();
    };
    let members = r#""metadataAvailability":2,"attribution":"Survey of A","parentUrl":"../elsewhere""#;
    write("layer.json", layer_json(members).as_bytes());
    let below = ranges(1, 1, |[_, x, _]| x == 0);
    for x in 0..2 {
        let metadata = (x == 0).then(|| format!(r#"{{"available":{below}}}"#));
        let tile = TerrainTile { water: Some(vec![255]), metadata, ..TerrainTile::new([0, x, 0], height) };
        write(&format!("0/{x}/0.terrain"), &tile.bytes());
    }
    for y in 0..2 {
        write(&format!("1/0/{y}.terrain"), &TerrainTile::new([1, 0, y], height).bytes());
    }
    let source = folder.path().to_str().unwrap();
    let info = inspect(source, &Limits::default()).unwrap();
    assert_eq!(info.attribution.as_deref(), Some("Survey of A"));
    assert!(info.details["named"].contains("that 2 divides"), "{:?}", info.details);
    let verified = verify(source, &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!((verified.failed, verified.contents), (0, 2 + 4 + 2), "{verified:?}");
    for kind in ["parent layer", "metadata that layer.json announces"] {
        assert!(verified.ignored.keys().any(|noted| noted.contains(kind)), "{kind}: {:?}", verified.ignored);
    }
}

/// Water was left out, and noted.
#[test]
fn water_is_smooth_in_tiles_and_in_parts_of_tiles() {
    // The northern half is water.
    let mask = (0..256 * 256).map(|cell| if cell < 128 * 256 { 255 } else { 0 }).collect();
    let tile = TerrainTile { water: Some(mask), ..TerrainTile::new([0, 1, 0], height) };
    let options = ReadOptions::for_root("/set/layer.json", Limits::default());
    let node = decode("/set/0/1/0.terrain", tile.bytes(), None, &options);
    let NodeKind::Geode(drawables) = &node.children[0].kind else { panic!("a geode") };
    let reflection = drawables[0].material.metallic_roughness.as_ref().expect("a reflection");
    let map = reflection.occlusion_roughness_metallic.as_ref().expect("a map");
    let roughness = |row: usize| f32::from(map.mips[0][4 * (row * 256 + 100) + 1]) / 255.0 * reflection.roughness;
    assert!(roughness(10) < 0.3 && roughness(245) == 1.0, "{} {}", roughness(10), roughness(245));
    let Geometry::Mesh(mesh) = &drawables[0].geometry else { panic!("a mesh") };
    let northmost = mesh.vertices.iter().max_by(|a, b| a.position[2].total_cmp(&b.position[2])).unwrap();
    assert!(northmost.uv[1] < 0.1, "the first row of the mask is in the north: {:?}", northmost.uv);
}
