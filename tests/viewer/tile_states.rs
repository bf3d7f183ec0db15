//! The pager's debug view: the states of the tiles of a set while a server stalls and fails, and their colours in the
//! view. Images need a GPU; a software adapter suffices.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};
use terrane::scene::Sky;

use glam::DVec3;
use kit::server::{How, Reply, Server};
use kit::viewer::offscreen;

use terrane::fetch::HttpConfig;
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::gpu::CompileBudget;
use terrane::pager::{PagerConfig, RequestState};
use terrane::viewer::handlers::{PagerDebugHandler, StatsHandler, StatsPage, TileState};
use terrane::viewer::{Key, Viewer, ViewerConfig};

/// The number of tiles in a row and in a column.
const SIDE: usize = 3;

/// Writes nine tiles of 100 m below one that is never fine enough.
fn set() -> String {
    let tile = |name: &str, at: [f64; 2], half: f64, error: f64, children: &str| {
        let [x, y] = at;
        format!(
            r#"{{"boundingVolume":{{"box":[{x},{y},0,{half},0,0,0,{half},0,0,0,1]}},"geometricError":{error},"refine":"ADD","content":{{"uri":"{name}.glb"}},"children":[{children}]}}"#
        )
    };
    let at = |i: usize| [i % SIDE, i / SIDE].map(|k| 100.0 * (k as f64 - 1.0));
    let children: Vec<String> = (0..SIDE * SIDE).map(|i| tile(&i.to_string(), at(i), 50.0, 0.0, "")).collect();
    let root = tile("root", [0.0; 2], 150.0, 1000.0, &children.join(","));
    format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":2000,"root":{root}}}"#)
}

fn viewer(url: &str, pager: PagerConfig) -> Option<Viewer> {
    let config = ViewerConfig {
        size_px: [800, 600],
        adapter: kit::adapter(),
        // Uploads still progress by one slice per frame.
        compile_budget: CompileBudget { time: Duration::ZERO, bytes: 0 },
        pager,
        look_ahead_s: 0.0,
        ..ViewerConfig::default()
    };
    let mut viewer = offscreen(&config)?;
    viewer.load(&format!("{url}/set/")).unwrap();
    viewer.view_mut().environment.sky = Sky::Background([20, 24, 30]);
    viewer.view_mut().environment.fog.enabled = false;
    viewer.view_mut().camera.look_at(DVec3::new(0.0, -1.0, 330.0), DVec3::ZERO, DVec3::Y);
    viewer.view_mut().add_event_handler(PagerDebugHandler::default());
    Some(viewer)
}

fn patient() -> PagerConfig {
    let long = Duration::from_secs(100);
    let http = HttpConfig { first_byte_timeout: long, read_timeout: long, max_retries: 0, ..HttpConfig::default() };
    PagerConfig { http, retry_after: long, max_tries: Some(2), ..PagerConfig::default() }
}

fn glb() -> Vec<u8> {
    write_glb(&GlbMesh {
        positions: vec![[-20.0, 0.0, -20.0], [20.0, 0.0, -20.0], [20.0, 0.0, 20.0]],
        indices: vec![0, 1, 2],
        base_color: [0.1, 0.1, 0.1, 1.0],
        ..GlbMesh::default()
    })
}

fn press(viewer: &mut Viewer, key: Key) {
    let queue = viewer.view_mut().event_queue();
    let time_s = queue.time_s();
    queue.key_press(key, key, time_s);
    queue.key_release(key, key, time_s);
    viewer.frame().unwrap();
}

/// Returns the states of the tiles after a frame.
fn states(viewer: &Viewer) -> Vec<TileState> {
    let frame = viewer.frame_stamp().frame;
    viewer.scene().tiles().filter_map(|tile| TileState::of(&tile, viewer.pager(), frame)).collect()
}

/// Draws frames until tiles have these states, in any order. Returns all states that occurred.
fn until(viewer: &mut Viewer, expected: &[(TileState, usize)]) -> BTreeSet<&'static str> {
    let end = Instant::now() + kit::MAX_WAIT;
    let mut met = BTreeSet::new();
    loop {
        viewer.frame().unwrap();
        let states = states(viewer);
        met.extend(states.iter().map(|state| state.name()));
        let count = |state| states.iter().filter(|s| **s == state).count();
        if expected.iter().all(|(state, n)| count(*state) == *n) {
            return met;
        }
        assert!(Instant::now() < end, "{states:?}: {:?}", viewer.pager().map(|p| p.stats()));
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Returns the pixels with the colour of a state, without those that outlines blend with the background.
fn pixels_of(picture: &image::RgbaImage, state: TileState) -> usize {
    let [r, g, b] = state.color();
    picture.pixels().filter(|p| [p.0[0], p.0[1], p.0[2]].iter().zip([r, g, b]).all(|(a, b)| a.abs_diff(b) <= 3)).count()
}

fn keep(picture: &image::RgbaImage, name: &str) {
    if let Some(folder) = std::env::var_os("KEEP_IMAGES") {
        picture.save(std::path::Path::new(&folder).join(name)).unwrap();
    }
}

#[test]
fn each_state_of_a_tile_is_reported_and_drawn_in_its_colour() {
    use RequestState::{Failed, ReadingHttp, Retrying};
    let server = Server::start(|request| match request.path() {
        "/set/tileset.json" => Reply::ok(set()),
        "/set/0.glb" => Reply::ok("").how(How::Silent),
        "/set/1.glb" => Reply::ok(glb()).how(How::Stall),
        "/set/2.glb" => Reply::new(404, ""),
        "/set/3.glb" => Reply::new(500, ""),
        _ => Reply::ok(glb()),
    });
    let Some(mut viewer) = viewer(&server.url, patient()) else { return };
    viewer.frame().unwrap();
    press(&mut viewer, Key::Char('g'));
    press(&mut viewer, Key::Char('g'));
    assert!(viewer.view().shows_overlay());
    let expected = [
        (TileState::InUse, 6),
        (TileState::Requested(ReadingHttp), 2),
        (TileState::Requested(Failed), 1),
        (TileState::Requested(Retrying), 1),
    ];
    let met = until(&mut viewer, &expected);
    // An upload takes at least a frame.
    assert!(met.contains("uploading"), "{met:?}");
    viewer.frame().unwrap();
    let picture = viewer.read_back().unwrap();
    keep(&picture, "tile-states.png");
    // A tile has four edges of about 100 pixels, some of which are blended. A line of the legend has few.
    for (state, count) in expected {
        let pixels = pixels_of(&picture, state);
        assert!(pixels > 120 * count, "{state:?}: {pixels}");
    }
    for absent in [TileState::Unused, TileState::Unwanted] {
        let pixels = pixels_of(&picture, absent);
        assert!(pixels < 120, "{absent:?}: {pixels}");
    }
    // In the view by level, the colours do not depend on states.
    press(&mut viewer, Key::Char('g'));
    press(&mut viewer, Key::Char('g'));
    viewer.frame().unwrap();
    let picture = viewer.read_back().unwrap();
    keep(&picture, "tile-levels.png");
    assert!(pixels_of(&picture, TileState::Requested(Failed)) < 20);

    // When the camera looks away, requests are cancelled and resident tiles stay.
    viewer.view_mut().camera.look_at(DVec3::new(0.0, 0.0, 330.0), DVec3::new(0.0, 0.0, 1e6), DVec3::Y);
    until(&mut viewer, &[(TileState::Unused, 6), (TileState::Requested(Failed), 1), (TileState::Unwanted, 2)]);
}

#[test]
fn tiles_of_a_stalled_server_stay_waiting() {
    let server = Server::start(|request| match request.path() {
        "/set/tileset.json" => Reply::ok(set()),
        _ => Reply::ok("").how(How::Silent),
    });
    let pager = PagerConfig { http_in_flight: 4, http_in_flight_max: 4, ..patient() };
    let Some(mut viewer) = viewer(&server.url, pager) else { return };
    let (reading, waiting) = (RequestState::ReadingHttp, RequestState::Waiting);
    until(&mut viewer, &[(TileState::Requested(reading), 4), (TileState::Requested(waiting), 6)]);
    press(&mut viewer, Key::Char('g'));
    press(&mut viewer, Key::Char('g'));
    viewer.frame().unwrap();
    let picture = viewer.read_back().unwrap();
    keep(&picture, "tile-waiting.png");
    assert!(pixels_of(&picture, TileState::Requested(waiting)) > 500);
}

#[test]
fn names_and_colours_distinguish_states() {
    for (i, a) in TileState::ALL.iter().enumerate() {
        for b in &TileState::ALL[..i] {
            let far = a.color().iter().zip(b.color()).map(|(a, b)| u32::from(a.abs_diff(b))).sum::<u32>();
            assert!(a.name() != b.name() && far > 60, "{a:?} and {b:?}: {far}");
        }
    }
}

#[test]
fn stats_page_fits_into_a_small_image() {
    let server = Server::start(|request| match request.path() {
        "/set/tileset.json" => Reply::ok(set()),
        _ => Reply::ok(glb()),
    });
    let Some(mut viewer) = viewer(&server.url, patient()) else { return };
    viewer.view_mut().add_event_handler(StatsHandler { page: StatsPage::Pager });
    let sky = [250, 0, 250];
    viewer.view_mut().environment.sky = Sky::Background(sky);
    viewer.view_mut().camera.look_at(DVec3::new(0.0, 0.0, 330.0), DVec3::new(0.0, 0.0, 1e6), DVec3::Y);
    for size_px in [[320, 240], [480, 300], [800, 600], [240, 320]] {
        viewer.resize(size_px).unwrap();
        // The page is laid out in its second frame.
        (0..16).for_each(|_| viewer.frame().unwrap());
        let picture = viewer.read_back().unwrap();
        keep(&picture, &format!("stats-{}x{}.png", size_px[0], size_px[1]));
        let [width, height] = size_px;
        let is_sky = |x: u32, y: u32| picture.get_pixel(x, y).0[..3] == sky;
        let edge = (0..width).all(|x| is_sky(x, height - 1)) && (0..height).all(|y| is_sky(width - 1, y));
        assert!(edge, "{size_px:?}: the page is larger than the image");
        let covered = picture.pixels().filter(|p| p.0[..3] != sky).count();
        assert!(covered > 30_000, "{size_px:?}: {covered} pixels of the page");
    }
}
