//! A program with a window on a virtual display, driven and read back through the X protocol.

use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use image::{GenericImageView as _, RgbImage};
use kit::display::Display;
use kit::frames::{differing, rgb_of_bgra};
use kit::skip::no_adapter;
use x11rb::connection::Connection as _;
use x11rb::protocol::xproto::{
    AtomEnum, ClientMessageEvent, ConfigureWindowAux, ConnectionExt as _, EventMask, ImageFormat, InputFocus, Window,
};
use x11rb::protocol::xtest::ConnectionExt as _;
use x11rb::rust_connection::RustConnection;
use x11rb::wrapper::ConnectionExt as _;

pub const KEY_PRESS: u8 = 2;
pub const KEY_RELEASE: u8 = 3;
pub const BUTTON_PRESS: u8 = 4;
pub const BUTTON_RELEASE: u8 = 5;
pub const MOTION: u8 = 6;
/// The maximum time for a frame of a debug build on a software adapter.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// A program with a window, driven through the X protocol.
pub struct Driven {
    pub program: Child,
    pub x: RustConnection,
    pub root: Window,
    pub window: Window,
}

impl Driven {
    pub fn start(display: &Display, args: &[&str], folder: &Path) -> Self {
        Self::start_where(display, args, folder, &[])
    }

    /// Starts the program with environment variables.
    pub fn start_where(display: &Display, args: &[&str], folder: &Path, variables: &[(&str, &str)]) -> Self {
        let program = Command::new(env!("CARGO_BIN_EXE_terrane"))
            .args(args)
            .current_dir(folder)
            .env("DISPLAY", &display.name)
            .env_remove("WAYLAND_DISPLAY")
            .env_remove("WAYLAND_SOCKET")
            .envs(variables.iter().copied())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let (x, screen) = x11rb::connect(Some(&display.name)).unwrap();
        let root = x.setup().roots[screen].root;
        let mut driven = Self { program, x, root, window: 0 };
        driven.window = driven.wait_for("a window", Self::find_window);
        // The display has no window manager, so the focus is set here.
        driven.x.set_input_focus(InputFocus::PARENT, driven.window, x11rb::CURRENT_TIME).unwrap();
        driven.x.sync().unwrap();
        driven
    }

    pub fn find_window(&mut self) -> Option<Window> {
        self.find_named(b"Terrane - ")
    }

    /// Returns the visible window whose title starts with a text.
    pub fn find_named(&self, title: &[u8]) -> Option<Window> {
        let tree = self.x.query_tree(self.root).unwrap().reply().unwrap();
        tree.children.into_iter().find(|window| {
            let name = self.x.get_property(false, *window, AtomEnum::WM_NAME, AtomEnum::ANY, 0, 100).unwrap().reply();
            let is_ours = name.is_ok_and(|name| name.value.starts_with(title));
            let seen = self.x.get_window_attributes(*window).unwrap().reply();
            is_ours && seen.is_ok_and(|a| a.map_state == x11rb::protocol::xproto::MapState::VIEWABLE)
        })
    }

    pub fn wait_for<T>(&mut self, what: &str, mut found: impl FnMut(&mut Self) -> Option<T>) -> T {
        let start = Instant::now();
        loop {
            if let Some(it) = found(self) {
                return it;
            }
            assert!(start.elapsed() < PATIENCE, "no {what} after {PATIENCE:?}");
            assert!(self.program.try_wait().unwrap().is_none(), "the program ended before {what}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Returns the window's content.
    pub fn picture(&self) -> RgbImage {
        let size = self.x.get_geometry(self.window).unwrap().reply().unwrap();
        let (width, height) = (size.width, size.height);
        let image = self.x.get_image(ImageFormat::Z_PIXMAP, self.window, 0, 0, width, height, u32::MAX);
        let data = image.unwrap().reply().unwrap().data;
        rgb_of_bgra([width, height].map(u32::from), &data)
    }

    /// Returns the window's position and size on the display: x, y, width and height.
    pub fn place(&self) -> [i32; 4] {
        let size = self.x.get_geometry(self.window).unwrap().reply().unwrap();
        let at = self.x.translate_coordinates(self.window, self.root, 0, 0).unwrap().reply().unwrap();
        [at.dst_x.into(), at.dst_y.into(), size.width.into(), size.height.into()]
    }

    /// Waits for a frame that `good` accepts, and saves it if KEEP_IMAGES names a folder.
    pub fn until(&mut self, name: &str, mut good: impl FnMut(&RgbImage) -> bool) -> RgbImage {
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
        panic!("{name}: not visible after {PATIENCE:?}");
    }

    /// Waits for a frame that stays the same for half a second.
    pub fn at_rest(&mut self, name: &str) -> RgbImage {
        self.same_for(5, name)
    }

    /// Waits for a frame that stays the same for three seconds: on a busy machine tiles arrive with longer pauses than half
    /// a second.
    pub fn settled(&mut self, name: &str) -> RgbImage {
        self.same_for(30, name)
    }

    fn same_for(&mut self, polls: u32, name: &str) -> RgbImage {
        let (mut before, mut same) = (None, 0);
        self.until(name, |picture| {
            let is_same = before.as_ref().is_some_and(|b| differing(b, picture) < 1e-4);
            same = if is_same { same + 1 } else { 0 };
            before = Some(picture.clone());
            same >= polls
        })
    }

    pub fn send(&self, kind: u8, detail: u8, x: i16, y: i16) {
        self.x.xtest_fake_input(kind, detail, 0, self.root, x, y, 0).unwrap();
        self.x.sync().unwrap();
    }

    /// Types a key by its symbol.
    pub fn key(&self, symbol: u32) {
        let code = self.key_code(symbol);
        self.send(KEY_PRESS, code, 0, 0);
        std::thread::sleep(Duration::from_millis(30));
        self.send(KEY_RELEASE, code, 0, 0);
    }

    pub fn key_code(&self, symbol: u32) -> u8 {
        let setup = self.x.setup();
        let (first, last) = (setup.min_keycode, setup.max_keycode);
        let map = self.x.get_keyboard_mapping(first, last - first + 1).unwrap().reply().unwrap();
        let columns = usize::from(map.keysyms_per_keycode);
        let row = map.keysyms.chunks(columns).position(|symbols| symbols.first() == Some(&symbol)).unwrap();
        first + u8::try_from(row).unwrap()
    }

    pub fn letter(&self, letter: char) {
        self.key(letter as u32);
    }

    /// Drags with a button, and holds still before the release, so that nothing is thrown.
    pub fn drag(&self, button: u8, from: [i16; 2], to: [i16; 2]) {
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

    pub fn resize(&self, [width, height]: [u32; 2]) {
        self.x.configure_window(self.window, &ConfigureWindowAux::new().width(width).height(height)).unwrap();
        self.x.sync().unwrap();
    }

    /// Closes the window like a window manager does for the user.
    pub fn close(&self) {
        let atom = |name: &[u8]| self.x.intern_atom(false, name).unwrap().reply().unwrap().atom;
        let (protocols, delete) = (atom(b"WM_PROTOCOLS"), atom(b"WM_DELETE_WINDOW"));
        let message = ClientMessageEvent::new(32, self.window, protocols, [delete, 0, 0, 0, 0]);
        self.x.send_event(false, self.window, EventMask::NO_EVENT, message).unwrap();
        self.x.sync().unwrap();
    }

    /// Returns the clock ticks of all threads; there are 100 per second.
    pub fn ticks(&self) -> u64 {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.program.id())).unwrap();
        let fields: Vec<&str> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
        fields[11].parse::<u64>().unwrap() + fields[12].parse::<u64>().unwrap()
    }

    /// Returns the program's standard output, once it has ended.
    pub fn said(&mut self) -> String {
        let mut text = String::new();
        self.program.stdout.take().unwrap().read_to_string(&mut text).unwrap();
        text
    }

    pub fn ended(&mut self) -> ExitStatus {
        let start = Instant::now();
        loop {
            if let Some(status) = self.program.try_wait().unwrap() {
                return status;
            }
            assert!(start.elapsed() < PATIENCE, "the program hangs on exit");
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

pub fn keep(name: &str, picture: &RgbImage) {
    if let Some(folder) = std::env::var_os("KEEP_IMAGES") {
        picture.save(Path::new(&folder).join(format!("window-{name}.png"))).unwrap();
    }
}

pub fn part(picture: &RgbImage, [x, y, width, height]: [u32; 4]) -> RgbImage {
    picture.view(x, y, width, height).to_image()
}

/// Generates a small set of height tiles; `None`, and the test skipped, without an adapter.
pub fn tile_set(folder: &Path) -> Option<PathBuf> {
    if no_adapter() {
        return None;
    }
    let set = folder.join("set");
    let args = ["gen", set.to_str().unwrap(), "--levels", "3", "--seed", "7"];
    assert!(Command::new(env!("CARGO_BIN_EXE_terrane")).args(args).stdout(Stdio::null()).status().unwrap().success());
    Some(set)
}

pub const ESCAPE: u32 = 0xff1b;
pub const SPACE: u32 = 0x20;
pub const UP: u32 = 0xff52;
