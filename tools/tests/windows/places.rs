//! The windows that `terrane view` opens: by files, variables, inside windows of other programs, and on displays. Runs
//! on a virtual display. Needs Xvfb and a GPU; a software adapter suffices. Skipped with a message without them.

use std::process::{Command, Stdio};
use std::time::Duration;

use crate::driven::{BUTTON_PRESS, BUTTON_RELEASE, Driven, ESCAPE, MOTION, SPACE, part, tile_set};
use image::RgbImage;
use kit::display::Display;
use kit::frames::{colours, differing};
use x11rb::connection::Connection as _;
use x11rb::protocol::xproto::{ConfigureWindowAux, ConnectionExt as _, CreateWindowAux, InputFocus, WindowClass};
use x11rb::wrapper::ConnectionExt as _;

#[test]
fn second_window_continues_beside_the_first_and_may_be_closed() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([1280, 1024]), tile_set(folder.path())) else { return };
    let set = set.to_str().unwrap().to_owned();
    let mut w = Driven::start(&display, &["view", &set, "--size", "320x240", "--beside", "1"], folder.path());
    let first = w.window;
    let second = w.wait_for("a second window", |w| w.find_named(b"Terrane 2"));
    // The display has no window manager, so the windows are moved here; covered parts cannot be read.
    w.x.configure_window(second, &ConfigureWindowAux::new().x(400)).unwrap();
    w.x.sync().unwrap();
    w.until("beside: first", |picture| colours(picture) > 200);
    std::thread::sleep(Duration::from_secs(3));
    let left = w.at_rest("beside: first at rest");
    w.window = second;
    // Only sky and haze are visible there.
    w.until("beside: second", |picture| colours(picture) > 8);
    let right = w.at_rest("beside: second at rest");
    let column = |picture: &RgbImage, x: u32| -> Vec<u8> { (0..240).flat_map(|y| picture.get_pixel(x, y).0).collect() };
    let apart =
        |a: Vec<u8>, b: Vec<u8>| a.iter().zip(&b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / a.len() as f64;
    let [seam, across] = [apart(column(&left, 319), column(&right, 0)), apart(column(&left, 0), column(&right, 319))];
    assert!(seam < 4.0 && seam < 0.5 * across, "{seam} across the seam, {across} from end to end");
    // Keys in the second window are handled by the viewer.
    w.x.set_input_focus(InputFocus::PARENT, second, x11rb::CURRENT_TIME).unwrap();
    w.key(SPACE);
    w.window = first;
    w.until("beside: first at home", |picture| differing(&left, picture) > 0.05);
    // The pointer turns the view from the second window too.
    let before = w.at_rest("beside: before the second window's pointer");
    w.drag(1, [560, 120], [620, 110]);
    w.until("beside: turned from the second window", |picture| differing(&before, picture) > 0.1);
    w.window = second;
    w.close();
    w.wait_for("one window", |w| w.find_named(b"Terrane 2").is_none().then_some(()));
    // The first window continues.
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
fn program_ends_with_its_last_window() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([1280, 1024]), tile_set(folder.path())) else { return };
    let set = set.to_str().unwrap().to_owned();
    let mut w = Driven::start(&display, &["view", &set, "--size", "320x240", "--beside", "1"], folder.path());
    let second = w.wait_for("a second window", |w| w.find_named(b"Terrane 2"));
    w.x.configure_window(second, &ConfigureWindowAux::new().x(400)).unwrap();
    w.x.sync().unwrap();
    w.until("last window: first", |picture| colours(picture) > 200);
    w.close();
    w.wait_for("the first window to close", |w| w.find_window().is_none().then_some(()));
    // The second window still shows the view, and turns it.
    w.window = second;
    let alone = w.at_rest("last window: second alone");
    w.drag(1, [560, 120], [560, 200]);
    w.until("last window: second turned", |picture| differing(&alone, picture) > 0.1);
    w.close();
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
    // The window that shares the device is closed, and the other continues.
    w.close();
    w.wait_for("one window", |w| w.find_named(b"right").is_none().then_some(()));
    w.window = first;
    w.drag(1, [300, 100], [340, 100]);
    w.until("arranged: turned alone", |picture| differing(&wall, picture) > 0.1);
    w.x.set_input_focus(InputFocus::PARENT, first, x11rb::CURRENT_TIME).unwrap();
    w.key(ESCAPE);
    assert!(w.ended().success());
}

/// In a part of a window, the pointer is relative to that part: a double click works as in a window of that size.
#[test]
fn pointer_is_relative_to_the_part_under_it() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([1280, 1024]), tile_set(folder.path())) else { return };
    let config = folder.path().join("part.json");
    let clicked = |text: &str, [x, y]: [u32; 2]| {
        std::fs::write(&config, text).unwrap();
        let args = ["view", set.to_str().unwrap(), "--config", config.to_str().unwrap()];
        let mut w = Driven::start(&display, &args, folder.path());
        let picture_px = [x, y, 200, 200];
        w.until("pointer: first", |picture| colours(&part(picture, picture_px)) > 100);
        std::thread::sleep(Duration::from_secs(3));
        let before = part(&w.at_rest("pointer: at rest"), picture_px);
        // A double click moves towards the point under the pointer.
        let [left, upper] = [10 + x + 60, 20 + y + 150].map(|px| px as i16);
        w.send(MOTION, 0, left, upper);
        for _ in 0..2 {
            w.send(BUTTON_PRESS, 1, 0, 0);
            w.send(BUTTON_RELEASE, 1, 0, 0);
        }
        w.until("pointer: moved", |picture| differing(&before, &part(picture, picture_px)) > 0.1);
        let after = part(&w.at_rest("pointer: after"), picture_px);
        w.key(ESCAPE);
        assert!(w.ended().success());
        after
    };
    let window = |size: &str, camera: &str| {
        format!(
            r#"{{"windows": [{{"title": "Terrane - part", "position_px": [10, 20], "size_px": {size}, "cameras": [{camera}]}}]}}"#
        )
    };
    let whole = clicked(&window("[200, 200]", "{}"), [0, 0]);
    let part = clicked(&window("[400, 300]", r#"{"viewport_px": [150, 60, 200, 200]}"#), [150, 60]);
    let apart = differing(&whole, &part);
    assert!(apart < 0.01, "{apart}");
}

#[test]
fn unreachable_display_is_one_line_that_names_it() {
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
fn missing_keyboard_library_is_one_line_that_names_it() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([640, 480]), tile_set(folder.path())) else { return };
    for library in ["libxkbcommon-x11", "libxkbcommon"] {
        // An invalid library is found before that of the system.
        let broken = folder.path().join(library);
        std::fs::create_dir(&broken).unwrap();
        for name in [format!("{library}.so.0"), format!("{library}.so")] {
            std::fs::write(broken.join(name), "no library").unwrap();
        }
        let mut command = Command::new(env!("CARGO_BIN_EXE_terrane"));
        command.args(["view", set.to_str().unwrap(), "--size", "320x240"]).current_dir(folder.path());
        command.env("LD_LIBRARY_PATH", &broken).env("DISPLAY", &display.name);
        let output = command.env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET").output().unwrap();
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!((output.status.code(), error.lines().count()), (Some(1), 1), "{error}");
        assert!(
            error.contains(&format!("keyboard library {library} (Debian: ")) && error.contains(&display.name),
            "{error}"
        );
    }
}

#[test]
fn windows_open_as_variables_say() {
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
    // An invalid arrangement is one line, and no window opens.
    let config = folder.path().join("wrong.json");
    std::fs::write(&config, r#"{"windows": [{"size_px": [640, "x"]}]}"#).unwrap();
    for (name, value, says) in [
        ("TERRANE_CONFIG_FILE", config.to_str().unwrap(), "wrong.json: windows[0].size_px[1]: invalid type"),
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
fn window_inside_another_programs_window_fills_it_and_ends_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([1280, 1024]), tile_set(folder.path())) else { return };
    // This test is the host, with a plain window.
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
    assert!(differing(&rest, &turned) > 0.1, "a drag rotates the view");
    // Keys are received after a click.
    w.key(SPACE);
    w.until("child at home", |picture| differing(&turned, picture) > 0.1);
    // It moves with the host and has its size.
    w.x.configure_window(host, &ConfigureWindowAux::new().x(10).y(20).width(600).height(200)).unwrap();
    w.x.sync().unwrap();
    w.wait_for("the host's size", |w| (w.place() == [10, 20, 600, 200]).then_some(()));
    // The new part is drawn as well.
    let is_drawn = |picture: &RgbImage| part(picture, [450, 0, 150, 200]).pixels().all(|p| p.0 != [0, 0, 0]);
    w.until("child resized", |picture| picture.dimensions() == (600, 200) && is_drawn(picture));
    w.x.destroy_window(host).unwrap();
    w.x.sync().unwrap();
    assert_eq!(w.ended().code(), Some(0), "the end of the host is no error");
    // An id that is not a window is one error.
    let mut command = Command::new(env!("CARGO_BIN_EXE_terrane"));
    command.args(args).current_dir(folder.path()).env("DISPLAY", &display.name);
    let output = command.output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && error.contains("there is no such window"), "{error}");
}
