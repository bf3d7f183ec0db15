//! Sources on servers, read by ranges of bytes, and overviews of large files.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use kit::server::{How, Reply, Request, Server};
use terrane_data_gen::{
    Color, Crs, ElevationSource as _, GenArgs, GenError, HeightEncoding, Raster, RasterOptions, run,
};

use super::tile_archives::{pmtiles, terrarium};
use crate::files::{files_below, from_dem};
use crate::tiffs::{Image, Values, tiff};

const CORNER: [f64; 2] = [8.0, 46.0];
/// The side of test images in pixels, of their tiles, and of their pixels in degrees.
const SIDE: usize = 2048;
const TILE: usize = 256;
const PIXEL: f64 = 1.0 / 1024.0;

fn height(x: usize, y: usize) -> u16 {
    (400 + (x * 37 + y * 91) % 300 + 7 * (x % 5)) as u16
}

/// Returns an image in tiles; `pixel` gives the bytes of a pixel.
fn tiled(side: usize, bits: u16, channels: u16, pixel: impl Fn(usize, usize) -> Vec<u8>) -> Image {
    let starts = (0..side).step_by(TILE).flat_map(|y| (0..side).step_by(TILE).map(move |x| (x, y)));
    let block = |(x, y): (usize, usize)| -> Vec<u8> {
        (0..TILE * TILE).flat_map(|k| pixel(x + k % TILE, y + k / TILE)).collect()
    };
    let image =
        Image { blocks: starts.map(block).collect(), ..Image::new([side as u16; 2], bits, channels, Vec::new()) };
    image.with(322, Values::Short(vec![TILE as u16])).with(323, Values::Short(vec![TILE as u16]))
}

fn elevation() -> Vec<u8> {
    let image = tiled(SIDE, 16, 1, |x, y| height(x, y).to_le_bytes().to_vec());
    tiff(vec![image.at(CORNER, [PIXEL; 2])])
}

/// Serves a file by ranges.
fn serve(file: Vec<u8>) -> Server {
    Server::start(move |request| Reply::ok(file.clone()).with("ETag", "\"1\"").ranged(request))
}

/// Returns the number of bytes that requests asked for.
fn bytes(requests: &[Request]) -> u64 {
    let span = |request: &Request| -> Option<u64> {
        let (first, last) = request.header("range")?.strip_prefix("bytes=")?.split_once('-')?;
        Some(last.parse::<u64>().ok()? + 1 - first.parse::<u64>().ok()?)
    };
    requests.iter().map(|request| span(request).expect("each request has a range")).sum()
}

fn address(server: &Server, name: &str) -> PathBuf {
    PathBuf::from(format!("{}/{name}", server.url))
}

#[test]
fn parts_of_tiffs_on_servers_are_read_when_they_are_needed() {
    let file = elevation();
    let size = file.len() as u64;
    let server = serve(file);
    let raster = Raster::read(&address(&server, "dem.tif?token=hidden")).unwrap();
    // The middle of the tile in column 5 and row 3.
    let at = |x: usize, y: usize| {
        let degrees = [CORNER[0] + (x as f64 + 0.5) * PIXEL, CORNER[1] - (y as f64 + 0.5) * PIXEL];
        raster.height_m(degrees[0].to_radians(), degrees[1].to_radians()).unwrap().unwrap()
    };
    for (x, y) in [(1400, 900), (1401, 900), (1500, 1000)] {
        assert!((at(x, y) - f64::from(height(x, y))).abs() < 0.01, "{x} {y}");
    }
    let (seen, count) = (server.seen(), server.count());
    assert!(bytes(&seen) < size / 8 && count < 14, "{} of {size} bytes in {count} requests", bytes(&seen));
    at(1450, 950);
    assert_eq!(server.count(), count, "blocks that were read stay in the cache");
}

#[test]
fn sets_from_a_server_equal_those_from_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let image = tiled(512, 16, 1, |x, y| height(x, y).to_le_bytes().to_vec()).at(CORNER, [PIXEL; 2]);
    let file = tiff(vec![image]);
    let colors = tiled(512, 8, 3, |x, y| vec![x as u8, y as u8, 90]).at(CORNER, [PIXEL; 2]);
    let colors = tiff(vec![colors]);
    let local = from_dem(folder.path(), "dem.tif", &file);
    std::fs::write(folder.path().join("colors.tif"), &colors).unwrap();
    let local = GenArgs { imagery: vec![folder.path().join("colors.tif")], ..local };
    run(&local).unwrap();
    let server = Server::start(move |request| {
        let body = if request.path() == "/dem.tif" { file.clone() } else { colors.clone() };
        Reply::ok(body).with("ETag", "\"1\"").ranged(request)
    });
    // A list may name addresses.
    let list = folder.path().join("list.txt");
    std::fs::write(&list, format!("{}/dem.tif\n", server.url)).unwrap();
    let remote = GenArgs {
        dem: vec![list],
        imagery: vec![address(&server, "colors.tif")],
        jobs: Some(4),
        out: folder.path().join("remote"),
        ..local.clone()
    };
    run(&remote).unwrap();
    assert!(files_below(&remote.out) == files_below(&local.out));
}

fn error(path: &Path) -> String {
    let error = Raster::read(path).err().unwrap().to_string();
    assert!(error.starts_with("http://127.0.0.1") && error.lines().count() == 1, "{error}");
    assert!(!error.contains("hidden"), "{error}");
    error
}

#[test]
fn servers_that_refuse_or_cut_answers_are_errors_that_name_the_address() {
    let missing = Server::start(|_| Reply::new(404, ""));
    assert!(error(&address(&missing, "a.tif?token=hidden")).contains("/a.tif?token=...: not found"));
    let closed = Server::start(|_| Reply::new(403, ""));
    assert!(error(&address(&closed, "a.tif")).ends_with("a.tif: HTTP status 403"));
    let file = elevation();
    let whole = file.clone();
    let plain = Server::start(move |_| Reply::ok(whole.clone()));
    assert!(error(&address(&plain, "a.tif")).contains("without range requests"));
    let whole = file.clone();
    let cut = Server::start(move |request| Reply::ok(whole.clone()).ranged(request).how(How::Cut));
    error(&address(&cut, "a.tif"));
    let elsewhere = serve(file.clone());
    let port = elsewhere.port();
    // Another name of this machine, which the user did not name.
    let moved = Server::start(move |_| Reply::new(302, "").with("Location", format!("http://localhost:{port}/a.tif")));
    let reason = error(&address(&moved, "a.tif"));
    assert!(reason.contains("redirected to localhost") && reason.contains("loopback"), "{reason}");
    assert_eq!(elsewhere.count(), 0);
    let text = serve(b"ncols 2\n".to_vec());
    assert!(error(&address(&text, "a.asc")).contains("neither GeoTIFF nor PMTiles"));
    let short = serve(file[..file.len() / 2].to_vec());
    error(&address(&short, "a.tif"));
}

/// A small file needs no ranges.
#[test]
fn small_files_come_from_servers_without_ranges() {
    let image = tiled(256, 16, 1, |x, y| height(x, y).to_le_bytes().to_vec());
    let file = tiff(vec![image.at(CORNER, [PIXEL; 2])]);
    let server = Server::start(move |_| Reply::ok(file.clone()));
    let raster = Raster::read(&address(&server, "a.tif")).unwrap();
    assert_eq!(raster.range_m().unwrap()[0], 400.0);
    // The others are for files beside it.
    assert_eq!(server.seen().iter().filter(|request| request.path() == "/a.tif").count(), 1);
}

#[test]
fn files_that_change_on_their_server_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let file = elevation();
    for header in ["ETag", "Last-Modified"] {
        let whole = file.clone();
        // The header changes once the tags are read.
        let server = Server::start(move |request| {
            let value = if request.nth < 8 { "\"1\"" } else { "\"2\"" };
            Reply::ok(whole.clone()).with(header, value).ranged(request)
        });
        let dem = vec![address(&server, "a.tif")];
        let args = GenArgs { dem, levels: Some(3), jobs: Some(1), ..GenArgs::new(folder.path().join("set")) };
        let error = run(&args).unwrap_err();
        assert!(error.to_string().contains("a.tif: the file was changed while it was read"), "{error}");
        assert!(!args.out.exists());
    }
    // The last read was before the change: the run finds it at its end.
    let image = tiled(256, 16, 1, |x, y| height(x, y).to_le_bytes().to_vec());
    let file = tiff(vec![image.at(CORNER, [PIXEL; 2])]);
    let server = Server::start(move |request| Reply::ok(file.clone()).with("ETag", request.nth));
    let args = GenArgs { dem: vec![address(&server, "a.tif")], ..GenArgs::new(folder.path().join("set")) };
    assert!(matches!(run(&args), Err(GenError::Changed(_))));
}

#[test]
fn pmtiles_on_servers_are_read_tile_by_tile() {
    let tiles = [(1, terrarium(100.0)), (2, terrarium(200.0)), (4, terrarium(400.0))];
    let server = serve(pmtiles(1, [-180.0, -85.0, 180.0, 85.0], &tiles));
    let options = RasterOptions { encoding: HeightEncoding::Terrarium, ..RasterOptions::default() };
    let raster = Raster::read_in(&address(&server, "a.pmtiles?token=hidden"), &options).unwrap();
    assert_eq!((raster.size(), raster.range_m().unwrap()), ([16, 16], [100.0, 400.0]));
    assert_eq!(raster.height_m(1.5, -0.8).unwrap(), None, "a tile that the archive does not have");
}

/// Returns an image of one value with overviews of other values: `1000 + 1000 * k`.
fn with_overviews(bits: u16, channels: u16, pixel: impl Fn(usize) -> Vec<u8>) -> Vec<u8> {
    let sides = [SIDE, SIDE / 2, SIDE / 4, SIDE / 8];
    let images = sides.into_iter().enumerate().map(|(k, side)| {
        let image = tiled(side, bits, channels, |_, _| pixel(k));
        if k == 0 { image.at(CORNER, [PIXEL; 2]) } else { image.with(254, Values::Long(vec![1])) }
    });
    tiff(images.collect())
}

#[test]
fn coarse_sets_read_the_overview_that_suffices() {
    let folder = tempfile::tempdir().unwrap();
    let file = with_overviews(16, 1, |k| (1000 + 1000 * k as u16).to_le_bytes().to_vec());
    let size = file.len() as u64;
    let server = serve(file);
    let args = |levels: u32| GenArgs {
        dem: vec![address(&server, "a.tif")],
        levels: Some(levels),
        overwrite: true,
        color: Color::None,
        ..GenArgs::new(folder.path().join("set"))
    };
    // Levels, cells along a side, and the overview with samples at most as far apart.
    for (levels, overview) in [(1, 3), (2, 3), (3, 3), (4, 2), (5, 1)] {
        let summary = run(&args(levels)).unwrap();
        let expected = 1000.0 + 1000.0 * f64::from(overview);
        assert_eq!([summary.min_height_m, summary.max_height_m], [expected; 2], "{levels} levels");
        assert!(summary.notes.iter().any(|n| n.contains("1 of 1 elevation files are read by their overviews")));
    }
    let before = server.count();
    run(&args(1)).unwrap();
    let read = bytes(&server.seen()[before..]);
    assert!(read < size / 8, "{read} of {size} bytes");
    // So do virtual rasters of such files.
    let raster = folder.path().join("a.vrt");
    let text = format!(
        r#"<VRTDataset rasterXSize="{SIDE}" rasterYSize="{SIDE}"><SRS>EPSG:4326</SRS>
        <GeoTransform>{}, {PIXEL}, 0, {}, 0, -{PIXEL}</GeoTransform><VRTRasterBand band="1"><SimpleSource>
        <SourceFilename>/vsicurl/{}</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>"#,
        CORNER[0],
        CORNER[1],
        address(&server, "a.tif").display()
    );
    std::fs::write(&raster, text).unwrap();
    let before = server.count();
    let summary = run(&GenArgs { dem: vec![raster], ..args(4) }).unwrap();
    assert_eq!([summary.min_height_m, summary.max_height_m], [3000.0; 2]);
    let read = bytes(&server.seen()[before..]);
    assert!(read < size / 4, "{read} of {size} bytes");
    // All levels: the image itself.
    let summary = run(&args(6)).unwrap();
    assert_eq!((summary.max_height_m, summary.notes.len()), (1000.0, 0));
}

#[test]
fn coarse_tiles_take_the_overviews_of_imagery() {
    let folder = tempfile::tempdir().unwrap();
    let dem = tiled(256, 16, 1, |_, _| vec![0, 1]).at(CORNER, [PIXEL * 8.0; 2]);
    let dem = from_dem(folder.path(), "dem.tif", &tiff(vec![dem]));
    let file = with_overviews(8, 3, |k| vec![50 + 50 * k as u8, 10, 10]);
    let size = file.len() as u64;
    let server = serve(file);
    let args = GenArgs { imagery: vec![address(&server, "a.tif")], ..dem };
    // 512 texels over 2048 pixels, and 256 for the root.
    run(&args).unwrap();
    let read = bytes(&server.seen());
    assert!(read < size / 3, "{read} of {size} bytes");
    let red = |name: &str| image::open(args.out.join(name)).unwrap().into_rgb8().get_pixel(128, 128).0[0];
    assert!(red("0/0/0.jpg").abs_diff(200) < 8 && red("1/0/0.jpg").abs_diff(150) < 8);
}

#[test]
fn redirects_lead_to_allowed_hosts() {
    let folder = tempfile::tempdir().unwrap();
    let image = tiled(256, 16, 1, |x, y| height(x, y).to_le_bytes().to_vec()).at(CORNER, [PIXEL; 2]);
    let file = tiff(vec![image]);
    let local = from_dem(folder.path(), "dem.tif", &file);
    run(&local).unwrap();
    let other = serve(file);
    let target = format!("{}/dem.tif", other.url);
    let server = Server::start(move |_| Reply::new(302, "").with("Location", &target));
    let mut remote = local.clone();
    (remote.dem, remote.out) = (vec![address(&server, "dem.tif")], folder.path().join("remote"));
    let error = run(&remote).unwrap_err().to_string();
    assert!(error.contains(&format!("--allow-host {} allows it", other.host())), "{error}");
    assert_eq!(other.count(), 0);
    remote.run.allow_host = vec![other.host().parse().unwrap()];
    run(&remote).unwrap();
    assert!(files_below(&remote.out) == files_below(&local.out));
}

/// One thread samples; the blocks of the file are asked for together.
#[test]
fn blocks_on_servers_are_read_ahead() {
    let folder = tempfile::tempdir().unwrap();
    let image = tiled(1024, 16, 1, |x, y| height(x, y).to_le_bytes().to_vec()).at(CORNER, [PIXEL; 2]);
    let file = tiff(vec![image]);
    let local = GenArgs { jobs: Some(1), color: Color::None, ..from_dem(folder.path(), "dem.tif", &file) };
    run(&local).unwrap();
    let (now, most) = (AtomicUsize::new(0), Arc::new(AtomicUsize::new(0)));
    let seen = most.clone();
    let server = Server::start(move |request| {
        seen.fetch_max(now.fetch_add(1, Ordering::Relaxed) + 1, Ordering::Relaxed);
        std::thread::sleep(std::time::Duration::from_millis(20));
        now.fetch_sub(1, Ordering::Relaxed);
        Reply::ok(file.clone()).with("ETag", "\"1\"").ranged(request)
    });
    let mut remote = local.clone();
    (remote.dem, remote.out) = (vec![address(&server, "dem.tif")], folder.path().join("remote"));
    run(&remote).unwrap();
    assert!(files_below(&remote.out) == files_below(&local.out));
    assert!(most.load(Ordering::Relaxed) > 4, "{} requests at the same time", most.load(Ordering::Relaxed));
}

/// The world file of a raster on a server is a part of the source: `--update` makes again what it moves.
#[test]
fn changed_file_beside_a_raster_on_a_server_is_a_change() {
    let folder = tempfile::tempdir().unwrap();
    let image = tiled(256, 16, 1, |x, y| height(x, y).to_le_bytes().to_vec());
    let file = tiff(vec![image]);
    let corner = Arc::new(AtomicUsize::new(8));
    let at = corner.clone();
    let server = Server::start(move |request| match request.path() {
        "/dem.tif" => Reply::ok(file.clone()).with("ETag", "\"1\"").ranged(request),
        "/dem.tfw" => {
            let west = at.load(Ordering::Relaxed);
            let text = format!("{PIXEL}\n0\n0\n-{PIXEL}\n{west}\n46\n");
            Reply::ok(text).with("ETag", format!("\"{west}\"")).ranged(request)
        }
        _ => Reply::new(404, ""),
    });
    let args = GenArgs {
        dem: vec![address(&server, "dem.tif")],
        color: Color::None,
        levels: Some(2),
        epsg: Some(Crs::parse("EPSG:4326").unwrap()),
        ..GenArgs::new(folder.path().join("set"))
    };
    run(&args).unwrap();
    let update = || {
        let mut args = args.clone();
        args.run.update = true;
        run(&args).unwrap().notes[0].clone()
    };
    assert!(update().contains("are kept"), "nothing has changed");
    corner.store(9, Ordering::Relaxed);
    let note = update();
    assert!(note.contains("the bounds"), "{note}");
}
