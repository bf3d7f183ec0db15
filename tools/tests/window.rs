//! `terrane view` in a real window under a virtual display: keys, pointer, resize, close, and what the window shows.
//! Needs Xvfb and a GPU (a software one will do); says so where there is none.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "../../tests/display_support/mod.rs"]
mod display_support;

use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use display_support::Display;
use image::{GenericImageView as _, RgbImage};
use x11rb::connection::Connection as _;
use x11rb::protocol::xproto::{
    AtomEnum, ClientMessageEvent, ConfigureWindowAux, ConnectionExt as _, CreateWindowAux, EventMask, ImageFormat,
    InputFocus, Window, WindowClass,
};
use x11rb::protocol::xtest::ConnectionExt as _;
use x11rb::rust_connection::RustConnection;
use x11rb::wrapper::ConnectionExt as _;

const KEY_PRESS: u8 = 2;
const KEY_RELEASE: u8 = 3;
const BUTTON_PRESS: u8 = 4;
const BUTTON_RELEASE: u8 = 5;
const MOTION: u8 = 6;
/// The picture is drawn by a debug build on a software adapter.
const PATIENCE: Duration = Duration::from_secs(60);

/// A program with a window, seen and driven through the X protocol.
struct Driven {
    program: Child,
    x: RustConnection,
    root: Window,
    window: Window,
}

impl Driven {
    fn start(display: &Display, args: &[&str], folder: &Path) -> Self {
        Self::start_where(display, args, folder, &[])
    }

    /// With variables of the environment.
    fn start_where(display: &Display, args: &[&str], folder: &Path, variables: &[(&str, &str)]) -> Self {
        let program = Command::new(env!("CARGO_BIN_EXE_terrane"))
            .args(args)
            .current_dir(folder)
            .env("DISPLAY", &display.name)
            .env_remove("WAYLAND_DISPLAY")
            .env_remove("WAYLAND_SOCKET")
            .envs(variables.iter().copied())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        let (x, screen) = x11rb::connect(Some(&display.name)).unwrap();
        let root = x.setup().roots[screen].root;
        let mut driven = Self { program, x, root, window: 0 };
        driven.window = driven.wait_for("a window", Self::find_window);
        // There is no window manager that would.
        driven.x.set_input_focus(InputFocus::PARENT, driven.window, x11rb::CURRENT_TIME).unwrap();
        driven.x.sync().unwrap();
        driven
    }

    fn find_window(&mut self) -> Option<Window> {
        self.find_named(b"Terrane - ")
    }

    /// A visible window whose title begins so.
    fn find_named(&self, title: &[u8]) -> Option<Window> {
        let tree = self.x.query_tree(self.root).unwrap().reply().unwrap();
        tree.children.into_iter().find(|window| {
            let name = self.x.get_property(false, *window, AtomEnum::WM_NAME, AtomEnum::ANY, 0, 100).unwrap().reply();
            let is_ours = name.is_ok_and(|name| name.value.starts_with(title));
            let seen = self.x.get_window_attributes(*window).unwrap().reply();
            is_ours && seen.is_ok_and(|a| a.map_state == x11rb::protocol::xproto::MapState::VIEWABLE)
        })
    }

    fn wait_for<T>(&mut self, what: &str, mut found: impl FnMut(&mut Self) -> Option<T>) -> T {
        let start = Instant::now();
        loop {
            if let Some(it) = found(self) {
                return it;
            }
            assert!(start.elapsed() < PATIENCE, "no {what} after {PATIENCE:?}");
            assert!(self.program.try_wait().unwrap().is_none(), "the program ended before there was {what}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// What the window shows.
    fn picture(&self) -> RgbImage {
        let size = self.x.get_geometry(self.window).unwrap().reply().unwrap();
        let (width, height) = (size.width, size.height);
        let image = self.x.get_image(ImageFormat::Z_PIXMAP, self.window, 0, 0, width, height, u32::MAX);
        let data = image.unwrap().reply().unwrap().data;
        RgbImage::from_fn(u32::from(width), u32::from(height), |x, y| {
            let at = 4 * (y as usize * usize::from(width) + x as usize);
            image::Rgb([data[at + 2], data[at + 1], data[at]])
        })
    }

    /// Its place on the display: x, y, width and height.
    fn place(&self) -> [i32; 4] {
        let size = self.x.get_geometry(self.window).unwrap().reply().unwrap();
        let at = self.x.translate_coordinates(self.window, self.root, 0, 0).unwrap().reply().unwrap();
        [at.dst_x.into(), at.dst_y.into(), size.width.into(), size.height.into()]
    }

    /// Waits for a picture, and keeps it where KEEP_IMAGES names a folder.
    fn until(&mut self, name: &str, mut good: impl FnMut(&RgbImage) -> bool) -> RgbImage {
        let mut last = None;
        let start = Instant::now();
        while start.elapsed() < PATIENCE {
            let picture = self.picture();
            if good(&picture) {
                keep(name, &picture);
                return picture;
            }
            last = Some(picture);
            assert!(self.program.try_wait().unwrap().is_none(), "the program ended before {name}");
            std::thread::sleep(Duration::from_millis(100));
        }
        last.iter().for_each(|picture| keep(name, picture));
        panic!("{name}: not seen after {PATIENCE:?}");
    }

    /// A picture that stays the same for a while.
    fn at_rest(&mut self, name: &str) -> RgbImage {
        let (mut before, mut same) = (None, 0);
        self.until(name, |picture| {
            let is_same = before.as_ref().is_some_and(|b| differing(b, picture) < 1e-4);
            same = if is_same { same + 1 } else { 0 };
            before = Some(picture.clone());
            same >= 5
        })
    }

    fn send(&self, kind: u8, detail: u8, x: i16, y: i16) {
        self.x.xtest_fake_input(kind, detail, 0, self.root, x, y, 0).unwrap();
        self.x.sync().unwrap();
    }

    /// Types a key by its symbol.
    fn key(&self, symbol: u32) {
        let setup = self.x.setup();
        let (first, last) = (setup.min_keycode, setup.max_keycode);
        let map = self.x.get_keyboard_mapping(first, last - first + 1).unwrap().reply().unwrap();
        let columns = usize::from(map.keysyms_per_keycode);
        let row = map.keysyms.chunks(columns).position(|symbols| symbols.first() == Some(&symbol)).unwrap();
        let code = first + u8::try_from(row).unwrap();
        self.send(KEY_PRESS, code, 0, 0);
        std::thread::sleep(Duration::from_millis(30));
        self.send(KEY_RELEASE, code, 0, 0);
    }

    fn letter(&self, letter: char) {
        self.key(letter as u32);
    }

    /// Drags with a button and holds still before the release, so that nothing is thrown.
    fn drag(&self, button: u8, from: [i16; 2], to: [i16; 2]) {
        self.send(MOTION, 0, from[0], from[1]);
        self.send(BUTTON_PRESS, button, 0, 0);
        for step in 1..=10 {
            let at = [0, 1].map(|i| from[i] + (to[i] - from[i]) * step / 10);
            self.send(MOTION, 0, at[0], at[1]);
            std::thread::sleep(Duration::from_millis(10));
        }
        std::thread::sleep(Duration::from_millis(600));
        self.send(BUTTON_RELEASE, button, 0, 0);
    }

    fn resize(&self, [width, height]: [u32; 2]) {
        self.x.configure_window(self.window, &ConfigureWindowAux::new().width(width).height(height)).unwrap();
        self.x.sync().unwrap();
    }

    /// As a window manager does when the user closes the window.
    fn close(&self) {
        let atom = |name: &[u8]| self.x.intern_atom(false, name).unwrap().reply().unwrap().atom;
        let (protocols, delete) = (atom(b"WM_PROTOCOLS"), atom(b"WM_DELETE_WINDOW"));
        let message = ClientMessageEvent::new(32, self.window, protocols, [delete, 0, 0, 0, 0]);
        self.x.send_event(false, self.window, EventMask::NO_EVENT, message).unwrap();
        self.x.sync().unwrap();
    }

    fn ended(&mut self) -> ExitStatus {
        let start = Instant::now();
        loop {
            if let Some(status) = self.program.try_wait().unwrap() {
                return status;
            }
            assert!(start.elapsed() < PATIENCE, "it hangs on exit");
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

impl Drop for Driven {
    fn drop(&mut self) {
        let _ = self.program.kill();
        let _ = self.program.wait();
    }
}

fn keep(name: &str, picture: &RgbImage) {
    if let Some(folder) = std::env::var_os("KEEP_IMAGES") {
        picture.save(Path::new(&folder).join(format!("window-{name}.png"))).unwrap();
    }
}

/// Share of the pixels that differ visibly.
fn differing(a: &RgbImage, b: &RgbImage) -> f64 {
    if a.dimensions() != b.dimensions() {
        return 1.0;
    }
    let differ = |(p, q): (&image::Rgb<u8>, &image::Rgb<u8>)| p.0.iter().zip(q.0).any(|(p, q)| p.abs_diff(q) > 12);
    a.pixels().zip(b.pixels()).filter(|pair| differ(*pair)).count() as f64 / f64::from(a.width() * a.height())
}

/// How many colours there are, in steps of 8: a sky alone has few.
fn colours(picture: &RgbImage) -> usize {
    let of = |p: &image::Rgb<u8>| p.0.map(|c| c / 8);
    picture.pixels().map(of).collect::<std::collections::BTreeSet<_>>().len()
}

fn part(picture: &RgbImage, [x, y, width, height]: [u32; 4]) -> RgbImage {
    picture.view(x, y, width, height).to_image()
}

/// A small set of height tiles; `None`, said aloud, where nothing can draw.
fn tile_set(folder: &Path) -> Option<PathBuf> {
    if let Err(error) = terrane::gpu::GraphicsContext::new_offscreen(&terrane::gpu::ContextTraits::default()) {
        assert!(std::env::var_os("REQUIRE_GPU").is_none_or(|v| v != "1"), "REQUIRE_GPU=1: {error}");
        eprintln!("SKIPPED: {error}");
        return None;
    }
    let set = folder.join("set");
    let args = ["gen", set.to_str().unwrap(), "--levels", "3", "--seed", "7"];
    assert!(Command::new(env!("CARGO_BIN_EXE_terrane")).args(args).stdout(Stdio::null()).status().unwrap().success());
    Some(set)
}

const ESCAPE: u32 = 0xff1b;
const SPACE: u32 = 0x20;

#[test]
fn a_user_moves_looks_around_and_closes_the_window() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([1280, 1024]), tile_set(folder.path())) else { return };
    let set = set.to_str().unwrap().to_owned();
    let mut w = Driven::start(&display, &["view", &set, "--size", "640x360"], folder.path());
    w.until("terrain", |picture| picture.dimensions() == (640, 360) && colours(picture) > 200);
    // Until the line at the lower edge is gone.
    std::thread::sleep(Duration::from_secs(3));
    let first = w.at_rest("first");

    // Home is another view than the first; the pointer turns it, and home brings it back.
    w.key(SPACE);
    w.until("moved home", |picture| differing(&first, picture) > 0.1);
    let home = w.at_rest("home");
    w.drag(1, [320, 180], [460, 160]);
    let turned = w.at_rest("turned");
    assert!(differing(&home, &turned) > 0.2, "a drag turns");
    w.key(SPACE);
    w.until("home again", |picture| differing(&home, picture) < 0.002);

    // The wheel: nearer, so that less sky is left above.
    for _ in 0..4 {
        w.send(BUTTON_PRESS, 4, 0, 0);
        w.send(BUTTON_RELEASE, 4, 0, 0);
    }
    w.until("zoomed", |picture| differing(&home, picture) > 0.2);
    w.key(SPACE);
    w.until("home after the zoom", |picture| differing(&home, picture) < 0.002);

    // The stats lie dark over the upper left; four more times and they are gone.
    let corner = [10, 6, 120, 14];
    w.letter('s');
    let over = w.until("stats", |picture| differing(&part(picture, corner), &part(&home, corner)) > 0.9);
    let rest = [400, 60, 200, 240];
    assert!(differing(&part(&over, rest), &part(&home, rest)) < 0.01, "the rest stays");
    for _ in 0..4 {
        w.letter('s');
        std::thread::sleep(Duration::from_millis(300));
    }
    w.until("no stats", |picture| differing(&home, picture) < 0.002);
    w.letter('h');
    let middle = [240, 100, 160, 160];
    w.until("help", |picture| differing(&part(picture, middle), &part(&home, middle)) > 0.5);
    w.letter('h');
    w.until("no help", |picture| differing(&home, picture) < 0.002);

    // Wireframe shows the sky through the ground, and is taken back.
    w.letter('w');
    w.until("wireframe", |picture| differing(&home, picture) > 0.1);
    w.letter('w');
    std::thread::sleep(Duration::from_millis(300));
    w.letter('w');
    w.until("filled", |picture| differing(&home, picture) < 0.002);

    // Without textures the ground is white, without light it has no shadows.
    let green = |picture: &RgbImage| {
        let is_green = |p: &&image::Rgb<u8>| p.0[1] > p.0[2].saturating_add(3);
        picture.pixels().filter(is_green).count() as f64 / f64::from(picture.width() * picture.height())
    };
    assert!(green(&home) > 0.05);
    w.letter('t');
    w.until("no textures", |picture| green(picture) < 0.001 && differing(&home, picture) > 0.1);
    w.letter('t');
    w.until("textures", |picture| differing(&home, picture) < 0.002);
    w.letter('l');
    w.until("no light", |picture| differing(&home, picture) > 0.03 && green(picture) > 0.05);
    w.letter('l');
    w.until("light", |picture| differing(&home, picture) < 0.002);

    // Tile bounds are lines over the ground.
    w.letter('g');
    w.until("tiles", |picture| differing(&home, picture) > 0.02);
    w.letter('g');
    std::thread::sleep(Duration::from_millis(300));
    w.letter('g');
    w.until("no tiles", |picture| differing(&home, picture) < 0.002);

    // Another size: all of it is drawn, and what was in the middle still is.
    w.resize([800, 500]);
    w.until("resized", |picture| {
        picture.dimensions() == (800, 500) && colours(&part(picture, [640, 200, 160, 300])) > 20
    });
    w.resize([1, 1]);
    std::thread::sleep(Duration::from_millis(300));
    w.resize([640, 360]);
    w.until("back in size", |picture| picture.dimensions() == (640, 360) && differing(&home, picture) < 0.002);

    w.letter('c');
    let file = folder.path().join("terrane-001.png");
    let written = w.wait_for("a picture", |_| image::open(&file).ok()).into_rgb8();
    assert!(differing(&written, &home) < 0.002, "it shows what the window shows");

    // Other manipulators by their keys, from where the camera is; the arrows fly.
    w.letter('2');
    std::thread::sleep(Duration::from_millis(500));
    w.until("the same from the fly manipulator", |picture| differing(&part(&home, rest), &part(picture, rest)) < 0.01);
    w.key(0xff52);
    w.until("flown", |picture| differing(&home, picture) > 0.02);

    w.close();
    assert_eq!(w.ended().code(), Some(0));
}

#[test]
fn a_window_that_draws_on_demand_rests_and_wakes() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([1280, 1024]), tile_set(folder.path())) else { return };
    let args = ["view", set.to_str().unwrap(), "--size", "320x180", "--on-demand", "--max-fps", "30"];
    let mut w = Driven::start(&display, &args, folder.path());
    w.until("terrain on demand", |picture| colours(picture) > 100);
    std::thread::sleep(Duration::from_secs(3));
    let rest = w.at_rest("rest on demand");
    // Clock ticks of all its threads, of which there are 100 a second.
    let ticks = |w: &Driven| {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", w.program.id())).unwrap();
        let fields: Vec<&str> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
        fields[11].parse::<u64>().unwrap() + fields[12].parse::<u64>().unwrap()
    };
    let before = ticks(&w);
    std::thread::sleep(Duration::from_secs(2));
    assert!(ticks(&w) - before < 60, "it draws all the time");
    w.send(MOTION, 0, 160, 90);
    for _ in 0..4 {
        w.send(BUTTON_PRESS, 4, 0, 0);
        w.send(BUTTON_RELEASE, 4, 0, 0);
    }
    w.until("woken", |picture| differing(&rest, picture) > 0.2);
    w.key(ESCAPE);
    assert_eq!(w.ended().code(), Some(0));
}

#[test]
fn escape_ends_a_flight_in_a_window_and_the_report_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([1280, 1024]), tile_set(folder.path())) else { return };
    let report = folder.path().join("report.json");
    let args = ["fly", set.to_str().unwrap(), "--size", "320x180", "--frames", "100000", "--report"];
    let args: Vec<&str> = args.into_iter().chain([report.to_str().unwrap()]).collect();
    let mut w = Driven::start(&display, &args, folder.path());
    let first = w.until("terrain", |picture| colours(picture) > 100);
    w.until("the flight goes on", |picture| differing(&first, picture) > 0.1);
    w.key(ESCAPE);
    assert_eq!(w.ended().code(), Some(0));
    let report: serde_json::Value = serde_json::from_slice(&std::fs::read(report).unwrap()).unwrap();
    assert!(report["frames"].as_u64().unwrap() > 5, "{report}");
}

#[test]
fn a_second_window_goes_on_where_the_first_ends_and_may_be_closed() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([1280, 1024]), tile_set(folder.path())) else { return };
    let set = set.to_str().unwrap().to_owned();
    let mut w = Driven::start(&display, &["view", &set, "--size", "320x240", "--beside", "1"], folder.path());
    let first = w.window;
    let second = w.wait_for("a second window", |w| w.find_named(b"Terrane 2"));
    // There is no window manager that would; what is covered cannot be read.
    w.x.configure_window(second, &ConfigureWindowAux::new().x(400)).unwrap();
    w.x.sync().unwrap();
    w.until("beside: first", |picture| colours(picture) > 200);
    std::thread::sleep(Duration::from_secs(3));
    let left = w.at_rest("beside: first at rest");
    w.window = second;
    // Sky and haze alone lie there.
    w.until("beside: second", |picture| colours(picture) > 8);
    let right = w.at_rest("beside: second at rest");
    let column = |picture: &RgbImage, x: u32| -> Vec<u8> { (0..240).flat_map(|y| picture.get_pixel(x, y).0).collect() };
    let apart =
        |a: Vec<u8>, b: Vec<u8>| a.iter().zip(&b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / a.len() as f64;
    let [seam, across] = [apart(column(&left, 319), column(&right, 0)), apart(column(&left, 0), column(&right, 319))];
    assert!(seam < 4.0 && seam < 0.5 * across, "{seam} across the seam, {across} from end to end");
    // Keys that it gets are the viewer's.
    w.x.set_input_focus(InputFocus::PARENT, second, x11rb::CURRENT_TIME).unwrap();
    w.key(SPACE);
    w.window = first;
    w.until("beside: first at home", |picture| differing(&left, picture) > 0.05);
    w.window = second;
    w.close();
    w.wait_for("one window", |w| w.find_named(b"Terrane 2").is_none().then_some(()));
    // The first goes on.
    w.window = first;
    let home = w.at_rest("beside: alone");
    assert!(differing(&left, &home) > 0.05);
    w.drag(1, [160, 120], [220, 110]);
    w.until("beside: turned alone", |picture| differing(&home, picture) > 0.1);
    w.x.set_input_focus(InputFocus::PARENT, first, x11rb::CURRENT_TIME).unwrap();
    w.key(ESCAPE);
    assert!(w.ended().success());
}

#[test]
fn windows_open_as_a_file_says() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([1280, 1024]), tile_set(folder.path())) else { return };
    let config = folder.path().join("wall.json");
    // A wall of three: one window with two parts, and one that shares its device.
    let text = r#"{"windows": [
        {"title": "Terrane - wall", "position_px": [10, 20], "size_px": [400, 200],
         "cameras": [{"viewport_px": [200, 0, 200, 200]}, {"viewport_px": [0, 0, 200, 200], "shift": [-1, 0]}]},
        {"title": "right", "position_px": [500, 20], "size_px": [200, 200], "shares_device": true,
         "cameras": [{"shift": [1, 0]}]}]}"#;
    std::fs::write(&config, text).unwrap();
    let variables =
        [("TERRANE_CONFIG_FILE", config.to_str().unwrap()), ("TERRANE_WINDOW", "0 0 50 50"), ("TERRANE_SCREEN", "7")];
    let mut w = Driven::start_where(&display, &["view", set.to_str().unwrap()], folder.path(), &variables);
    assert_eq!(w.place(), [10, 20, 400, 200]);
    let first = w.window;
    w.until("arranged: first", |picture| colours(picture) > 100);
    std::thread::sleep(Duration::from_secs(3));
    let wall = w.at_rest("arranged: first at rest");
    w.window = w.wait_for("the other window", |w| w.find_named(b"right"));
    assert_eq!(w.place(), [500, 20, 200, 200]);
    w.until("arranged: right", |picture| colours(picture) > 8);
    let right = w.at_rest("arranged: right at rest");
    let column = |picture: &RgbImage, x: u32| -> Vec<u8> { (0..200).flat_map(|y| picture.get_pixel(x, y).0).collect() };
    let apart =
        |a: Vec<u8>, b: Vec<u8>| a.iter().zip(&b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / a.len() as f64;
    let inside = apart(column(&wall, 199), column(&wall, 200));
    let seam = apart(column(&wall, 399), column(&right, 0));
    let across = apart(column(&wall, 0), column(&wall, 399));
    assert!(inside < 4.0 && seam < 4.0 && across > 6.0, "{inside} and {seam} at the seams, {across} from end to end");
    // The one that shares is closed, and the other goes on.
    w.close();
    w.wait_for("one window", |w| w.find_named(b"right").is_none().then_some(()));
    w.window = first;
    w.drag(1, [300, 100], [340, 100]);
    w.until("arranged: turned alone", |picture| differing(&wall, picture) > 0.1);
    w.x.set_input_focus(InputFocus::PARENT, first, x11rb::CURRENT_TIME).unwrap();
    w.key(ESCAPE);
    assert!(w.ended().success());
}

#[test]
fn several_views_open_as_a_file_says_and_each_has_its_events() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([1280, 1024]), tile_set(folder.path())) else { return };
    let config = folder.path().join("views.json");
    let name = set.file_name().unwrap().to_str().unwrap();
    // Two views of the program's set beside each other, and one of a set of its own in another window.
    let text = format!(
        r#"{{"windows": [
             {{"title": "Terrane - views", "position_px": [10, 20], "size_px": [400, 200]}},
             {{"title": "other", "position_px": [500, 20], "size_px": [200, 200], "shares_device": true}}],
            "scenes": {{"again": "{name}"}},
            "views": [
             {{"cameras": [{{"viewport_px": [0, 0, 200, 200]}}]}},
             {{"heading_deg": 90, "cameras": [{{"viewport_px": [200, 0, 200, 200]}}]}},
             {{"scene": "again", "cameras": [{{"window": 1}}]}}]}}"#
    );
    std::fs::write(&config, text).unwrap();
    let config = config.to_str().unwrap();
    let view = ["view", set.to_str().unwrap()];
    let by_variable = [("TERRANE_CONFIG_FILE", config)];
    let mut w = Driven::start_where(&display, &view, folder.path(), &by_variable);
    assert_eq!(w.place(), [10, 20, 400, 200]);
    let first = w.window;
    let (left, right) = ([0, 0, 200, 200], [200, 0, 200, 200]);
    w.until("views: first", |picture| [left, right].iter().all(|of| colours(&part(picture, *of)) > 100));
    let both = w.at_rest("views: at rest");
    assert!(differing(&part(&both, left), &part(&both, right)) > 0.2, "from two sides");
    w.window = w.wait_for("the other window", |w| w.find_named(b"other"));
    assert_eq!(w.place(), [500, 20, 200, 200]);
    w.until("views: other", |picture| colours(picture) > 100);
    let other = w.at_rest("views: other at rest");
    assert!(differing(&part(&both, left), &other) < 0.02, "the same set from the same eye");

    // A drag in the right view turns that alone, also where it ends outside of it.
    w.window = first;
    w.drag(1, [310, 120], [150, 110]);
    let turned = w.at_rest("views: right turned");
    assert!(differing(&part(&both, right), &part(&turned, right)) > 0.1);
    assert!(differing(&part(&both, left), &part(&turned, left)) < 0.002);
    // Keys are those of the view under the pointer: the left one goes home.
    w.x.set_input_focus(InputFocus::PARENT, first, x11rb::CURRENT_TIME).unwrap();
    w.send(MOTION, 0, 10 + 100, 20 + 190);
    w.key(SPACE);
    w.until("views: left at home", |picture| {
        differing(&part(&both, left), &part(picture, left)) > 0.05
            && differing(&part(&turned, right), &part(picture, right)) < 0.002
    });
    // The stats of whichever view lie over the first window.
    w.send(MOTION, 0, 10 + 300, 20 + 100);
    w.letter('s');
    let upper_left = [10, 10, 100, 20];
    w.until("views: stats", |picture| differing(&part(&turned, upper_left), &part(picture, upper_left)) > 0.3);

    // The other window closes with its view, and the first goes on.
    w.window = w.wait_for("the other window", |w| w.find_named(b"other"));
    w.close();
    w.wait_for("one window", |w| w.find_named(b"other").is_none().then_some(()));
    w.window = first;
    w.resize([420, 220]);
    w.until("views: resized", |picture| picture.dimensions() == (420, 220) && colours(&part(picture, right)) > 100);
    w.x.set_input_focus(InputFocus::PARENT, first, x11rb::CURRENT_TIME).unwrap();
    w.key(ESCAPE);
    assert_eq!(w.ended().code(), Some(0));

    // Said on the command line, the file comes before the variable; and without a set where none is needed.
    let alone = folder.path().join("alone.json");
    let text = format!(
        r#"{{"windows": [{{"title": "Terrane - alone", "size_px": [160, 120]}}],
            "scenes": {{"a": "{name}"}}, "views": [{{"scene": "a"}}]}}"#
    );
    std::fs::write(&alone, text).unwrap();
    let args = ["view", "--config", alone.to_str().unwrap()];
    let mut w = Driven::start_where(&display, &args, folder.path(), &by_variable);
    w.until("views: alone", |picture| picture.dimensions() == (160, 120) && colours(picture) > 100);
    w.close();
    assert_eq!(w.ended().code(), Some(0));

    // What cannot be is one line.
    std::fs::write(&alone, r#"{"views": [{"cameras": [{"window": 2}]}]}"#).unwrap();
    for (command, says) in [
        (&["view", "--config"][..], "alone.json: views[0].cameras[0].window: there are 1 windows, counted from 0"),
        (&["fly", set.to_str().unwrap(), "--config"], "alone.json: views[0].cameras[0].window"),
    ] {
        let mut program = Command::new(env!("CARGO_BIN_EXE_terrane"));
        program.args(command).arg(&alone).current_dir(folder.path()).env("DISPLAY", &display.name);
        let output = program.env_remove("WAYLAND_DISPLAY").output().unwrap();
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(1) && error.contains(says), "{error}");
        assert_eq!(error.lines().count(), 1, "{error}");
    }
}

#[test]
fn a_display_that_cannot_be_reached_is_one_line_that_names_it() {
    let folder = tempfile::tempdir().unwrap();
    let Some(set) = tile_set(folder.path()) else { return };
    for (variable, value) in [("DISPLAY", ":4711"), ("DISPLAY", "nonsense"), ("WAYLAND_DISPLAY", "wayland-4711")] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_terrane"));
        for other in ["DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"] {
            command.env_remove(other);
        }
        let args = ["view", set.to_str().unwrap(), "--size", "320x240"];
        command.args(args).current_dir(folder.path()).env("XDG_RUNTIME_DIR", folder.path()).env(variable, value);
        let output = command.output().unwrap();
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!((output.status.code(), error.lines().count()), (Some(1), 1), "{error}");
        assert!(
            error.contains(&format!("{variable}=`{value}`")) && error.contains("terrane fly --offscreen"),
            "{error}"
        );
        assert!(!error.contains(".rs") && !error.contains("winit"), "{error}");
        println!("{error}");
    }
}

#[test]
fn windows_open_where_variables_say() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([1280, 1024]), tile_set(folder.path())) else { return };
    let view = ["view", set.to_str().unwrap(), "--size", "320x240"];
    for (variables, place) in [
        (&[("TERRANE_WINDOW", "30 40 300 200"), ("TERRANE_SCREEN", "0")][..], [30, 40, 300, 200]),
        (&[("TERRANE_SCREEN", "0")], [0, 0, 1280, 1024]),
        (&[("TERRANE_SCREEN", "all")], [0, 0, 1280, 1024]),
    ] {
        let mut w = Driven::start_where(&display, &view, folder.path(), variables);
        assert_eq!(w.place(), place, "{variables:?}");
        w.until("where a variable says", |picture| colours(picture) > 100);
        w.key(ESCAPE);
        assert!(w.ended().success());
    }
    // What cannot be is one line, and no window.
    let config = folder.path().join("wrong.json");
    std::fs::write(&config, r#"{"windows": [{"size_px": [640, "x"]}]}"#).unwrap();
    for (name, value, says) in [
        ("TERRANE_CONFIG_FILE", config.to_str().unwrap(), "wrong.json: windows[0].size_px[1]: not a whole number"),
        ("TERRANE_WINDOW", "1 2 3", "TERRANE_WINDOW: `1 2 3` is not `x y width height`"),
        ("TERRANE_SCREEN", "3", "there is no screen 3; the display has 1"),
    ] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_terrane"));
        command.args(view).current_dir(folder.path()).env("DISPLAY", &display.name).env_remove("WAYLAND_DISPLAY");
        let output = command.env(name, value).output().unwrap();
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(1) && error.contains(says), "{error}");
    }
}

#[test]
fn a_window_opens_in_one_of_another_program_fills_it_and_ends_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([1280, 1024]), tile_set(folder.path())) else { return };
    // The host is this test, with a plain window.
    let (x, screen) = x11rb::connect(Some(&display.name)).unwrap();
    let root = x.setup().roots[screen].root;
    let host = x.generate_id().unwrap();
    let class = WindowClass::INPUT_OUTPUT;
    x.create_window(0, host, root, 70, 80, 400, 300, 0, class, 0, &CreateWindowAux::new().background_pixel(0)).unwrap();
    x.map_window(host).unwrap();
    x.sync().unwrap();
    let args = ["view", set.to_str().unwrap(), "--size", "320x240", "--parent", &host.to_string()];
    let program = Command::new(env!("CARGO_BIN_EXE_terrane"))
        .args(args)
        .current_dir(folder.path())
        .env("DISPLAY", &display.name)
        .env("TERRANE_WINDOW", "0 0 100 100")
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let mut w = Driven { program, x, root: host, window: 0 };
    w.window = w.wait_for("a window in the window", Driven::find_window);
    w.root = root;
    assert_eq!(w.place(), [70, 80, 400, 300]);
    w.until("child", |picture| colours(picture) > 100);
    std::thread::sleep(Duration::from_secs(2));
    let rest = w.at_rest("child at rest");
    w.drag(1, [270, 230], [330, 220]);
    let turned = w.at_rest("child turned");
    assert!(differing(&rest, &turned) > 0.1, "a drag turns");
    // Keys come once it was clicked.
    w.key(SPACE);
    w.until("child at home", |picture| differing(&turned, picture) > 0.1);
    // It goes where the host goes, and has its size.
    w.x.configure_window(host, &ConfigureWindowAux::new().x(10).y(20).width(600).height(200)).unwrap();
    w.x.sync().unwrap();
    w.wait_for("the host's size", |w| (w.place() == [10, 20, 600, 200]).then_some(()));
    // The new part is drawn too.
    let is_drawn = |picture: &RgbImage| part(picture, [450, 0, 150, 200]).pixels().all(|p| p.0 != [0, 0, 0]);
    w.until("child resized", |picture| picture.dimensions() == (600, 200) && is_drawn(picture));
    w.x.destroy_window(host).unwrap();
    w.x.sync().unwrap();
    assert_eq!(w.ended().code(), Some(0), "the host's end is its own");
    // What is no window is one error.
    let mut command = Command::new(env!("CARGO_BIN_EXE_terrane"));
    command.args(args).current_dir(folder.path()).env("DISPLAY", &display.name);
    let output = command.output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && error.contains("to open in: there is none"), "{error}");
}
