//! `terrane view` in a real window under a virtual display: keys, pointer, resize, close, and what the window shows.
//! Needs Xvfb and a GPU; a software adapter suffices. Skipped with a message without them.

use std::time::Duration;

use crate::driven::{
    BUTTON_PRESS, BUTTON_RELEASE, Driven, ESCAPE, KEY_PRESS, KEY_RELEASE, MOTION, SPACE, UP, part, tile_set,
};
use image::RgbImage;
use kit::display::Display;
use kit::frames::{colours, differing};

#[test]
fn user_moves_looks_around_and_closes_the_window() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([1280, 1024]), tile_set(folder.path())) else { return };
    let set = set.to_str().unwrap().to_owned();
    let mut w = Driven::start(&display, &["view", &set, "--size", "640x360"], folder.path());
    w.until("terrain", |picture| picture.dimensions() == (640, 360) && colours(picture) > 200);
    // Until the message at the lower edge has disappeared.
    std::thread::sleep(Duration::from_secs(3));
    let first = w.at_rest("first");

    // Home is another view than the first. The pointer rotates the view, and home resets it.
    w.key(SPACE);
    w.until("moved home", |picture| differing(&first, picture) > 0.1);
    let home = w.at_rest("home");
    w.drag(1, [320, 180], [460, 160]);
    let turned = w.at_rest("turned");
    assert!(differing(&home, &turned) > 0.2, "a drag rotates the view");
    w.key(SPACE);
    w.until("home again", |picture| differing(&home, picture) < 0.002);

    // The wheel moves the eye nearer, so that less sky is left above.
    for _ in 0..4 {
        w.send(BUTTON_PRESS, 4, 0, 0);
        w.send(BUTTON_RELEASE, 4, 0, 0);
    }
    w.until("zoomed", |picture| differing(&home, picture) > 0.2);
    w.key(SPACE);
    w.until("home after the zoom", |picture| differing(&home, picture) < 0.002);

    // The stats are dark at the upper left. After four more key presses they are hidden.
    let corner = [10, 6, 120, 14];
    w.letter('s');
    let over = w.until("stats", |picture| differing(&part(picture, corner), &part(&home, corner)) > 0.9);
    let rest = [400, 60, 200, 240];
    assert!(differing(&part(&over, rest), &part(&home, rest)) < 0.01, "the rest does not change");
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

    // Wireframe shows the sky through the ground. The key switches it off again.
    w.letter('w');
    w.until("wireframe", |picture| differing(&home, picture) > 0.1);
    w.letter('w');
    std::thread::sleep(Duration::from_millis(300));
    w.letter('w');
    w.until("filled", |picture| differing(&home, picture) < 0.002);

    // Without textures the ground is white, and without light it has no shadows.
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

    // The bounds of tiles are lines over the ground.
    w.letter('g');
    w.until("tiles", |picture| differing(&home, picture) > 0.02);
    w.letter('g');
    std::thread::sleep(Duration::from_millis(300));
    w.letter('g');
    w.until("no tiles", |picture| differing(&home, picture) < 0.002);

    // After a resize everything is drawn, and the middle still shows the same.
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
    assert!(differing(&written, &home) < 0.002, "it equals the window");

    // Keys select other manipulators, which continue from the camera. The arrow keys fly.
    w.letter('2');
    std::thread::sleep(Duration::from_millis(500));
    w.until("the same from the fly manipulator", |picture| differing(&part(&home, rest), &part(picture, rest)) < 0.01);
    let up = w.key_code(UP);
    w.send(KEY_PRESS, up, 0, 0);
    w.until("flown", |picture| differing(&home, picture) > 0.02);
    w.send(KEY_RELEASE, up, 0, 0);

    w.close();
    assert_eq!(w.ended().code(), Some(0));
}

#[test]
fn window_that_draws_on_demand_rests_and_wakes() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([1280, 1024]), tile_set(folder.path())) else { return };
    let args = ["view", set.to_str().unwrap(), "--size", "320x180", "--on-demand", "--max-fps", "30"];
    let mut w = Driven::start(&display, &args, folder.path());
    w.until("terrain on demand", |picture| colours(picture) > 100);
    std::thread::sleep(Duration::from_secs(3));
    let rest = w.at_rest("rest on demand");
    let before = w.ticks();
    std::thread::sleep(Duration::from_secs(2));
    assert!(w.ticks() - before < 60, "it draws continuously");
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
    w.until("the flight continues", |picture| differing(&first, picture) > 0.1);
    w.key(ESCAPE);
    assert_eq!(w.ended().code(), Some(0));
    let report: serde_json::Value = serde_json::from_slice(&std::fs::read(report).unwrap()).unwrap();
    assert!(report["frames"].as_u64().unwrap() > 5, "{report}");
}
