//! Terrain services and the ellipsoid through the pager: which tiles are loaded from where. No GPU.

#[cfg(feature = "http")]
use std::sync::Arc;

use glam::DVec3;
use kit::pager::Run;
use kit::quantized::{TerrainTile, layer_json, ranges, tile_at, tile_in, write_set};
use terrane::formats::ellipsoid;
use terrane::math::{Geodetic, WGS84};
use terrane::pager::PagerConfig;
use terrane::scene::{Page, ReaderData, SlotState};

#[cfg(feature = "http")]
use kit::server::{How, Reply, Request, Server};
#[cfg(feature = "http")]
use terrane::{
    fetch::Limits,
    formats::{Content, OverlaySet, RasterOverlay, ReadOptions, decode_node},
    math::BoundingVolume,
    scene::NodeKind,
};

/// A place in the Alps, radians.
const PLACE: [f64; 2] = [0.141, 0.802];

fn height(longitude: f64, latitude: f64) -> f64 {
    500.0 + 300.0 * (40.0 * longitude).sin() * (30.0 * latitude).cos()
}

/// Returns a point above the place, ECEF metres.
fn eye([longitude, latitude]: [f64; 2], height_m: f64) -> DVec3 {
    WGS84.ecef(&Geodetic { longitude, latitude, height_m })
}

/// Returns true for the tiles that contain the place.
fn contains([level, x, y]: [u32; 3]) -> bool {
    tile_at(level, PLACE[0], PLACE[1]) == [level, x, y]
}

/// Returns true for all tiles of the first levels, and for the children of those that contain the place.
fn has_quads([level, x, y]: [u32; 3]) -> bool {
    level < 2 || contains([level - 1, x / 2, y / 2])
}

/// Returns the names of the contents that are resident, without their folder.
fn resident(run: &Run) -> Vec<String> {
    let tiles = run.scene.tiles().filter_map(|tile| {
        let slot = run.scene.slot(tile.node).filter(|slot| matches!(slot.state, SlotState::Resident(_)))?;
        let is_page = slot.reader_data.is_some_and(ReaderData::continues_tileset);
        let name: Vec<&str> = slot.uri.rsplitn(4, '/').collect();
        (!is_page).then(|| name.iter().take(3).rev().copied().collect::<Vec<_>>().join("/"))
    });
    let mut names: Vec<String> = tiles.collect();
    names.sort_unstable();
    names
}

fn globe(mut run: Run) -> Run {
    run.is_globe = true;
    run
}

fn folder_run(folder: &std::path::Path) -> Run {
    globe(Run::new(folder.to_str().unwrap(), PagerConfig::default()))
}

fn name([level, x, y]: [u32; 3]) -> String {
    format!("{level}/{x}/{y}.terrain")
}

#[test]
fn finest_tiles_below_the_eye_are_loaded() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path(), 9, has_quads, height);
    let mut run = folder_run(folder.path());
    run.settle(eye(PLACE, 1500.0));
    assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
    let names = resident(&run);
    for level in 0..9 {
        let tile = name(tile_at(level, PLACE[0], PLACE[1]));
        assert!(names.contains(&tile), "{tile} is missing: {names:?}");
    }
    let is_file = |name: &String| !name.contains('#') || name.contains("layer.json#0/");
    assert!(names.iter().all(is_file), "every tile has a file: {names:?}");
    assert!(run.stage.leaf_count() >= 1);
    // From far away the root tiles are enough.
    let mut run = folder_run(folder.path());
    run.settle(eye(PLACE, 4e7));
    let names = resident(&run);
    let files: Vec<&String> = names.iter().filter(|name| !name.contains('#')).collect();
    assert_eq!(files, ["0/0/0.terrain", "0/1/0.terrain"]);
    assert_eq!(run.stage.leaf_count(), 2);
}

/// Tiles are replaced by the children in sight: the others are not even requested.
#[test]
fn children_out_of_sight_are_not_loaded() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path(), 9, has_quads, height);
    let mut run = folder_run(folder.path());
    run.settle(eye(PLACE, 1500.0));
    let files: Vec<String> = resident(&run).into_iter().filter(|name| !name.contains('#')).collect();
    for level in 2..9 {
        let of_level = files.iter().filter(|name| name.starts_with(&format!("{level}/"))).count();
        assert_eq!(of_level, 1, "level {level}: {files:?}");
    }
    assert!((1..8).contains(&run.stage.leaf_count()), "{} leaves", run.stage.leaf_count());
    assert_eq!(run.stage.counters.stand_ins, 0);
}

/// A tile that comes into sight is drawn as a part of the tile above until it is loaded. Its siblings stay.
#[test]
fn tile_that_comes_into_sight_is_drawn_as_a_part_of_the_one_above() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path(), 9, has_quads, height);
    let mut run = folder_run(folder.path());
    let near = eye(PLACE, 1500.0);
    let end = std::time::Instant::now() + std::time::Duration::from_secs(60);
    while run.frame == 0 || !run.pager.is_idle() || !run.stage.requests.is_empty() {
        run.frame(near);
        assert_eq!(run.stage.counters.stand_ins, 0, "what is shown for the first time waits for all that is in sight");
        assert!(std::time::Instant::now() < end, "does not settle");
    }
    // From higher up the siblings of the finest tile are in sight too.
    let far = eye(PLACE, 1e5);
    run.cull(far);
    let missing = run.stage.requests.len() as u32;
    assert!(missing >= 3, "{missing} requests");
    assert!(run.stage.counters.stand_ins >= 3, "{:?}", run.stage.counters);
    // A second cull of this frame finds the same.
    let stand_ins = run.stage.counters.stand_ins;
    run.cull(far);
    assert_eq!((run.stage.requests.len() as u32, run.stage.counters.stand_ins), (missing, stand_ins));
    run.settle(far);
    assert_eq!(run.stage.counters.stand_ins, 0);
    assert!(run.stage.leaf_count() > 3);
    // Nothing was shown of this part before: the tile above is drawn whole until all in sight are loaded.
    let mut fresh = folder_run(folder.path());
    fresh.frame(far);
    assert_eq!(fresh.stage.counters.stand_ins, 0);
}

/// The box around a large tile reaches far above the ground. It does not count as nearer than the ground below the eye.
#[test]
fn large_tiles_are_as_far_as_the_ground() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path(), 4, |_| true, height);
    let mut run = folder_run(folder.path());
    // A tile of level 1 is refined from 17,100 km on.
    run.settle(eye(PLACE, 1.75e7));
    let names = resident(&run);
    assert!(names.contains(&name(tile_at(1, PLACE[0], PLACE[1]))), "{names:?}");
    assert!(!names.iter().any(|name| name.starts_with("2/") && name.ends_with(".terrain")), "{names:?}");
    run.settle(eye(PLACE, 1.6e7));
    assert!(resident(&run).contains(&name(tile_at(2, PLACE[0], PLACE[1]))));
}

/// The ellipsoid that is drawn until the root is read needs the images of the root.
#[cfg(feature = "http")]
#[test]
fn ellipsoid_before_the_root_has_the_images_of_the_root() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path(), 2, |_| true, height);
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbImage::new(256, 256).write_to(&mut png, image::ImageFormat::Png).unwrap();
    let png = png.into_inner();
    let server = Server::start(move |_| Reply::ok(png.clone()));
    let overlay = RasterOverlay::template(&format!("{}/{{z}}/{{x}}/{{y}}.png", server.url));
    let overlays = Some(Arc::new(OverlaySet::new(vec![overlay]).unwrap()));
    let mut run = globe(Run::new(folder.path().to_str().unwrap(), PagerConfig { overlays, ..PagerConfig::default() }));
    run.settle(eye(PLACE, 1e8));
    let mut seen: Vec<String> = server.seen().iter().map(|request| request.path().to_owned()).collect();
    seen.sort_unstable();
    assert_eq!(seen, ["/1/0/0.png", "/1/0/1.png", "/1/1/0.png", "/1/1/1.png"]);
}

/// Children without a file are parts of their parent. They are made without a further read.
#[test]
fn tiles_without_a_file_are_cut_out_of_the_tile_above() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path(), 9, |at| at[0] == 0 || contains(at), height);
    let mut run = folder_run(folder.path());
    // The siblings of the finest tile are in sight.
    run.settle(eye(PLACE, 1e5));
    assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
    let names = resident(&run);
    let [level, x, y] = tile_at(8, PLACE[0], PLACE[1]);
    let above = tile_at(7, PLACE[0], PLACE[1]);
    assert!(names.contains(&name([level, x, y])), "{names:?}");
    let siblings = [[x ^ 1, y], [x, y ^ 1], [x ^ 1, y ^ 1]];
    for [x, y] in siblings {
        let cut = format!("{}.terrain#{level}/{x}/{y}", above[2]);
        let is_cut = |name: &String| name.ends_with(&format!("#{level}/{x}/{y}")) || *name == cut;
        assert!(names.iter().any(is_cut), "{cut} is missing: {names:?}");
    }
    let bytes: u64 = (0..9).map(|level| file_bytes(folder.path(), tile_at(level, PLACE[0], PLACE[1]))).sum();
    // The other half of the earth is out of sight.
    assert_eq!(run.pager.stats().bytes_read - run.root_bytes, bytes, "each file is read once");
}

fn file_bytes(folder: &std::path::Path, at: [u32; 3]) -> u64 {
    std::fs::metadata(folder.join(name(at))).unwrap().len()
}

/// The ellipsoid needs no server, and has tiles down to metres. Tiles behind the horizon are not drawn.
#[test]
fn ellipsoid_is_made_from_orbit_to_the_ground() {
    for place in [PLACE, [std::f64::consts::PI, -0.3], [1.0, -1.2]] {
        let mut run = globe(Run::of_page(Page::from_node(ellipsoid(WGS84)).unwrap(), "/", PagerConfig::default()));
        let mut drawn = Vec::new();
        for height_m in [2e7, 1e6, 1e4, 100.0, 2.0] {
            run.settle(eye(place, height_m));
            assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
            drawn.push(run.stage.leaf_count());
        }
        assert!(drawn[0] <= 8 && drawn.iter().all(|count| (1..200).contains(count)), "{drawn:?}");
        let finest = run.scene.tiles().map(|tile| tile.depth).max().unwrap();
        let names = resident(&run);
        let level = |name: &String| name.rsplit('#').next().unwrap().split('/').next().unwrap().parse::<u32>().unwrap();
        let last = names.iter().filter(|name| name.contains('#')).map(level).max().unwrap();
        assert!(last >= 20 && finest > 20, "level {last}");
        assert_eq!(run.pager.stats().bytes_read, 0);
    }
}

#[test]
fn tiles_behind_the_horizon_are_not_loaded() {
    let counts = [true, false].map(|is_globe| {
        let mut run = globe(Run::of_page(Page::from_node(ellipsoid(WGS84)).unwrap(), "/", PagerConfig::default()));
        run.has_horizon = is_globe;
        // The frustum is wide: the whole earth is in it, and near enough for tiles of 11 degrees.
        run.max_sse_px = 2.0;
        run.settle(eye(PLACE, 2e7));
        (run.stage.leaf_count(), run.pager.stats().loaded)
    });
    let [(drawn, loaded), (all, all_loaded)] = counts;
    assert!(drawn > 20 && 4 * drawn < 3 * all && 10 * loaded < 9 * all_loaded, "{counts:?}");
}

/// All columns of a level meet at a pole. Their number stays within reason.
#[test]
fn pole_has_few_tiles() {
    let mut run = globe(Run::of_page(Page::from_node(ellipsoid(WGS84)).unwrap(), "/", PagerConfig::default()));
    run.settle(eye([0.0, std::f64::consts::FRAC_PI_2], 10_000.0));
    assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
    let count = run.stage.leaf_count();
    assert!((100..3000).contains(&count), "{count} tiles");
}

/// A root tile that cannot be read is replaced by the ellipsoid; the other half of the earth has its terrain.
#[test]
fn failed_root_leaves_the_ellipsoid() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path(), 3, |_| true, height);
    std::fs::write(folder.path().join(name([0, 1, 0])), "rubbish").unwrap();
    let mut run = folder_run(folder.path());
    let eye = eye([0.0, 0.3], 2e7);
    run.until(eye, "does not fail", |run| run.pager.stats().failed > 0 && run.pager.is_idle());
    run.settle(eye);
    assert_eq!(run.pager.errors().len(), 1, "{:?}", run.pager.errors());
    let names = resident(&run);
    assert!(names.iter().any(|name| name.ends_with("layer.json#0/1/0")), "{names:?}");
    assert!(names.contains(&name([0, 0, 0])), "{names:?}");
    assert!(run.stage.leaf_count() >= 2);
}

/// Serves a set of the first levels whose tiles name the tiles below them.
#[cfg(feature = "http")]
fn metadata_reply(request: &Request, levels: u32, interval: u32) -> Reply {
    if request.path() == "/layer.json" {
        return Reply::ok(layer_json(&format!(r#""metadataAvailability":{interval},"extensions":["metadata"]"#)));
    }
    let Some(at) = tile_in(request.path()).filter(|at| at[0] < levels && has_quads(*at)) else {
        return Reply::new(404, "");
    };
    let mut tile = TerrainTile { has_normals: true, ..TerrainTile::new(at, height) };
    if at[0].is_multiple_of(interval) {
        let below = interval.min(levels - 1 - at[0]);
        let is_below = |of: [u32; 3]| [of[1] >> (of[0] - at[0]), of[2] >> (of[0] - at[0])] == [at[1], at[2]];
        let available = ranges(at[0] + 1, below, |of| has_quads(of) && is_below(of));
        tile.metadata = Some(format!(r#"{{"available":{available}}}"#));
    }
    Reply::ok(tile.bytes())
}

#[cfg(feature = "http")]
#[test]
fn tiles_name_the_tiles_below_them() {
    for interval in [1, 3, 10] {
        let server = Server::start(move |request| metadata_reply(request, 9, interval));
        let mut run = globe(Run::new(&format!("{}/layer.json", server.url), PagerConfig::default()));
        run.settle(eye(PLACE, 1500.0));
        assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
        let names = resident(&run);
        let finest = name(tile_at(8, PLACE[0], PLACE[1]));
        assert!(names.iter().any(|name| name.starts_with(&finest)), "{interval}: {names:?}");
        let seen = server.seen();
        assert!(seen.iter().all(|request| request.nth == 0), "{interval}: a file was requested twice");
        let tiles = seen.iter().filter(|request| request.path().ends_with(".terrain"));
        for request in tiles {
            let accept = request.header("accept").unwrap();
            let wanted = "application/vnd.quantized-mesh;extensions=octvertexnormals-watermask-metadata";
            assert!(accept.starts_with(wanted), "{accept}");
            assert!(request.target.ends_with("?v=1.0.0"), "{}", request.target);
        }
    }
}

/// A tile that the upper layer lacks comes from the layer below it.
#[cfg(feature = "http")]
#[test]
fn layers_are_laid_over_their_parents() {
    let server = Server::start(|request| {
        let (levels, folder): (_, fn([u32; 3]) -> bool) = match request.path().starts_with("/base/") {
            true => (5, |_| true),
            false => (9, |at| at[0] == 0 || contains(at)),
        };
        if request.path().ends_with("/layer.json") {
            let parent = if levels == 9 { r#","parentUrl":"../base""# } else { "" };
            let available = ranges(0, levels, folder);
            return Reply::ok(layer_json(&format!(r#""available":{available}{parent}"#)));
        }
        let tile = tile_in(request.path()).filter(|at| at[0] < levels && folder(*at));
        tile.map_or(Reply::new(404, ""), |at| Reply::ok(TerrainTile::new(at, height).bytes()))
    });
    let mut run = globe(Run::new(&format!("{}/top/layer.json", server.url), PagerConfig::default()));
    // Only the first view has tiles in sight that the upper layer lacks.
    run.settle(eye(PLACE, 2e6));
    run.settle(eye(PLACE, 1500.0));
    assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
    let seen: Vec<String> = server.seen().iter().map(|request| request.path().to_owned()).collect();
    for level in 0..9 {
        let own = name(tile_at(level, PLACE[0], PLACE[1]));
        assert!(seen.contains(&format!("/top/{own}")), "{own}: {seen:?}");
        assert!(!seen.contains(&format!("/base/{own}")), "{own}: {seen:?}");
    }
    let [level, x, y] = tile_at(4, PLACE[0], PLACE[1]);
    assert!(seen.contains(&format!("/base/{}", name([level, x ^ 1, y]))), "{seen:?}");
    assert!(server.seen().iter().all(|request| request.nth == 0));
}

/// Each fault is one error that names the tile; the tile above is drawn in its place, and its siblings are.
#[cfg(feature = "http")]
#[test]
fn failed_tiles_keep_the_tile_above() {
    for (reply, reason) in [
        (Reply::new(404, ""), "not found"),
        (Reply::new(204, ""), "0 bytes"),
        (Reply::ok("<html>Log in</html>"), "a web page"),
        (Reply::ok(vec![0; 50]), "50 bytes"),
        (Reply::ok(TerrainTile::new([4, 0, 0], height).bytes()[..500].to_vec()), "follow"),
        (Reply::ok(TerrainTile::new([4, 0, 0], height).bytes()).how(How::Cut), ""),
    ] {
        let bad = tile_at(4, PLACE[0], PLACE[1]);
        let answer = reply.clone();
        let server = Server::start(move |request| {
            if request.path() == "/layer.json" {
                return Reply::ok(layer_json(&format!(r#""available":{}"#, ranges(0, 5, has_quads))));
            }
            match tile_in(request.path()) {
                Some(at) if at == bad => answer.clone(),
                Some(at) => Reply::ok(TerrainTile::new(at, height).bytes()),
                None => Reply::new(404, ""),
            }
        });
        let mut config = PagerConfig::default();
        config.http.max_retries = 0;
        config.max_tries = Some(1);
        let mut run = globe(Run::new(&format!("{}/layer.json", server.url), config));
        // The siblings are in sight.
        let eye = eye(PLACE, 2e6);
        run.until(eye, "does not fail", |run| run.pager.stats().failed > 0 && run.pager.is_idle());
        run.settle(eye);
        let errors = run.pager.errors();
        assert_eq!((errors.len(), errors[0].count), (1, 1), "{errors:?}");
        assert!(errors[0].uri.contains(&name(bad)) && errors[0].reason.contains(reason), "{reason}: {errors:?}");
        let names = resident(&run);
        let above = name(tile_at(3, PLACE[0], PLACE[1]));
        assert!(names.iter().any(|name| name.starts_with(&above)), "{names:?}");
        let sibling = name([4, bad[1] ^ 1, bad[2]]);
        assert!(names.iter().any(|name| name.starts_with(&sibling)), "{names:?}");
        assert!(run.stage.counters.stand_ins > 0, "{reason}");
    }
}

/// The finest level of [`deep_reply`].
#[cfg(feature = "http")]
const DEEP: u32 = 15;

/// Serves the children of all tiles above the place down to level 15. Either layer.json names them all, or tiles of the levels
/// that `interval` divides name those below them.
#[cfg(feature = "http")]
fn deep_reply(request: &Request, interval: Option<u32>) -> Reply {
    let ranges = |first: u32, last: u32| {
        let quad = |level: u32| match tile_at(level - 1, PLACE[0], PLACE[1]) {
            [_, x, y] => json_range([2 * x, 2 * y], [2 * x + 1, 2 * y + 1]),
        };
        let of_level = |level| if level == 0 { json_range([0, 0], [1, 0]) } else { quad(level) };
        format!("[{}]", (first..=last).map(of_level).collect::<Vec<_>>().join(","))
    };
    if request.path() == "/layer.json" {
        return Reply::ok(layer_json(&match interval {
            None => format!(r#""available":{}"#, ranges(0, DEEP)),
            Some(interval) => format!(r#""metadataAvailability":{interval},"extensions":["metadata"]"#),
        }));
    }
    let has = |at: [u32; 3]| at[0] == 0 || at[0] <= DEEP && contains([at[0] - 1, at[1] / 2, at[2] / 2]);
    let Some(at) = tile_in(request.path()).filter(|at| has(*at)) else { return Reply::new(404, "") };
    let mut tile = TerrainTile::new(at, height);
    if let Some(interval) = interval
        && at[0].is_multiple_of(interval)
        && contains(at)
    {
        let last = (at[0] + interval).min(DEEP);
        let available = if last > at[0] { ranges(at[0] + 1, last) } else { "[]".to_owned() };
        tile.metadata = Some(format!(r#"{{"available":{available}}}"#));
    } else if interval.is_some_and(|interval| at[0].is_multiple_of(interval)) {
        tile.metadata = Some(r#"{"available":[]}"#.to_owned());
    }
    Reply::ok(tile.bytes())
}

#[cfg(feature = "http")]
fn json_range(first: [u32; 2], last: [u32; 2]) -> String {
    let ([x, y], [end_x, end_y]) = (first, last);
    format!(r#"[{{"startX":{x},"startY":{y},"endX":{end_x},"endY":{end_y}}}]"#)
}

/// Requests all tiles that are known above the place, then those that the answers name, and so on. Returns the levels of each
/// of these rounds.
#[cfg(feature = "http")]
fn rounds(server: &Server) -> Vec<Vec<u32>> {
    use std::io::{BufRead as _, BufReader, Read as _, Write as _};

    let get = |uri: &str| {
        let address = server.url.strip_prefix("http://").unwrap();
        let mut stream = std::net::TcpStream::connect(address).unwrap();
        let path = uri.strip_prefix(&server.url).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").unwrap();
        let mut answer = BufReader::new(stream);
        let (mut line, mut length) = (String::new(), 0);
        while line != "\r\n" {
            line.clear();
            answer.read_line(&mut line).unwrap();
            let value = line.to_ascii_lowercase().strip_prefix("content-length:").map(|value| value.trim().to_owned());
            length = value.map_or(length, |value| value.parse().unwrap());
        }
        let mut body = vec![0; length];
        answer.read_exact(&mut body).unwrap();
        body
    };
    let root: Arc<str> = format!("{}/layer.json", server.url).into();
    let options = ReadOptions::for_root(&root, Limits::default());
    let mut wanted = vec![(root, None::<ReaderData>)];
    let mut rounds = Vec::new();
    while !wanted.is_empty() {
        let mut next = Vec::new();
        while let Some((uri, reader_data)) = wanted.pop() {
            let is_in_memory = reader_data.as_ref().is_some_and(ReaderData::is_whole_content);
            let bytes = if is_in_memory { Vec::new() } else { get(&uri) };
            let content = Content { uri, bytes, reader_data, companions: Vec::new() };
            let mut nodes = vec![decode_node(content, &options).unwrap()];
            while let Some(node) = nodes.pop() {
                nodes.extend(node.children);
                let NodeKind::PagedLod(tile) = node.kind else { continue };
                let (BoundingVolume::Region(region), Some(uri)) = (&tile.bounds, tile.content) else { continue };
                let is_above = (region.west..region.west + region.width()).contains(&PLACE[0])
                    && (region.south..region.north).contains(&PLACE[1]);
                let data = tile.reader_data.as_ref();
                let continues = data.is_some_and(ReaderData::continues_tileset);
                match is_above {
                    // Pages in memory are made at once.
                    true if continues && data.is_some_and(ReaderData::is_whole_content) => {
                        wanted.push((uri, tile.reader_data));
                    }
                    true if continues || !data.is_some_and(ReaderData::is_whole_content) => {
                        next.push((uri, tile.reader_data, continues));
                    }
                    _ => {}
                }
            }
        }
        let level_of = |uri: &str| {
            let path = uri.strip_prefix(&server.url)?.split('?').next()?;
            Some(tile_in(path)?[0])
        };
        let mut levels: Vec<u32> = next.iter().map(|(uri, ..)| level_of(uri).unwrap()).collect();
        levels.sort_unstable();
        levels.dedup();
        rounds.extend((!levels.is_empty()).then_some(levels));
        wanted = next.into_iter().filter(|(.., continues)| *continues).map(|(uri, data, _)| (uri, data)).collect();
    }
    rounds
}

/// Regression: each five levels waited for the answers of the five above.
#[cfg(feature = "http")]
#[test]
fn levels_whose_tiles_are_known_are_requested_at_once() {
    let levels = |range: std::ops::RangeInclusive<u32>| range.collect::<Vec<u32>>();
    for (interval, expected) in [
        // Heights at level 10 are needed to choose among the tiles below.
        (None, vec![levels(0..=10), levels(11..=15)]),
        (Some(10), vec![levels(0..=0), levels(1..=10), levels(11..=15)]),
    ] {
        let server = Server::start(move |request| deep_reply(request, interval));
        assert_eq!(rounds(&server), expected, "{interval:?}");

        // The pager requests each of these files once, and no others.
        let server = Server::start(move |request| deep_reply(request, interval));
        let mut run = globe(Run::new(&format!("{}/layer.json", server.url), PagerConfig::default()));
        run.settle(eye(PLACE, height(PLACE[0], PLACE[1]) + 500.0));
        assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
        let finest = name(tile_at(DEEP, PLACE[0], PLACE[1]));
        assert!(resident(&run).iter().any(|name| name.starts_with(&finest)), "{interval:?}");
        let seen = server.seen();
        assert!(seen.iter().all(|request| request.nth == 0));
        assert!(seen.len() <= 1 + 2 + 4 * DEEP as usize, "{} requests", seen.len());
    }
}
