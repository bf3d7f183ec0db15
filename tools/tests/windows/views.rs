//! `terrane view` with a file of several views, in real windows on a virtual display. Needs Xvfb and a GPU; a software
//! adapter suffices. Skipped with a message without them.

use std::process::Command;
use std::time::{Duration, Instant};

use crate::driven::{
    BUTTON_PRESS, BUTTON_RELEASE, Driven, ESCAPE, KEY_PRESS, KEY_RELEASE, MOTION, SPACE, UP, part, tile_set,
};
use image::RgbImage;
use kit::display::Display;
use kit::frames::{colours, differing};
use x11rb::protocol::xproto::{ConnectionExt as _, InputFocus};
use x11rb::wrapper::ConnectionExt as _;

#[test]
fn several_views_open_as_a_file_says_with_separate_events() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([1280, 1024]), tile_set(folder.path())) else { return };
    let config = folder.path().join("views.json");
    let name = set.file_name().unwrap().to_str().unwrap();
    // Two views of the default set are side by side, and one of another set is in another window.
    let text = format!(
        r#"{{"windows": [
             {{"title": "Terrane - views", "position_px": [10, 20], "size_px": [400, 200]}},
             {{"title": "other", "position_px": [500, 20], "size_px": [200, 200], "shares_device": true}}],
            "scenes": {{"again": "{name}"}},
            "views": [
             {{"cameras": [{{"viewport": [0, 0, 0.5, 1]}}]}},
             {{"heading_deg": 90, "cameras": [{{"viewport": [0.5, 0, 0.5, 1]}}]}},
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
    let both = w.settled("views: at rest");
    assert!(differing(&part(&both, left), &part(&both, right)) > 0.2, "from two sides");
    w.window = w.wait_for("the other window", |w| w.find_named(b"other"));
    assert_eq!(w.place(), [500, 20, 200, 200]);
    w.until("views: other", |picture| colours(picture) > 100);
    let other = w.at_rest("views: other at rest");
    assert!(differing(&part(&both, left), &other) < 0.02, "the same set from the same eye");

    // A drag in the right view rotates only that one, also if it ends outside of it.
    w.window = first;
    w.drag(1, [310, 120], [150, 110]);
    let turned = w.at_rest("views: right turned");
    assert!(differing(&part(&both, right), &part(&turned, right)) > 0.1);
    assert!(differing(&part(&both, left), &part(&turned, left)) < 0.002);
    // Keys go to the view under the pointer, so the left view returns home.
    w.x.set_input_focus(InputFocus::PARENT, first, x11rb::CURRENT_TIME).unwrap();
    w.send(MOTION, 0, 10 + 100, 20 + 190);
    w.key(SPACE);
    let home = w.until("views: left at home", |picture| {
        differing(&part(&both, left), &part(picture, left)) > 0.05
            && differing(&part(&turned, right), &part(picture, right)) < 0.002
    });
    // The stats of a view are drawn over that view, also for several views at the same time.
    w.send(MOTION, 0, 10 + 300, 20 + 100);
    w.letter('s');
    let upper_left = |[x, y, ..]: [u32; 4]| [x + 10, y + 10, 100, 20];
    let is_over = |before: &RgbImage, picture: &RgbImage, of: [u32; 4]| {
        differing(&part(before, upper_left(of)), &part(picture, upper_left(of))) > 0.3
    };
    let before = w.until("views: stats on the right", |picture| is_over(&turned, picture, right));
    w.send(MOTION, 0, 10 + 50, 20 + 150);
    w.letter('s');
    assert!(!is_over(&home, &before, left), "nothing over the other view");
    w.until("views: stats over both", |picture| is_over(&home, picture, left) && is_over(&turned, picture, right));
    // The same in the other window.
    w.window = w.wait_for("the other window", |w| w.find_named(b"other"));
    w.x.set_input_focus(InputFocus::PARENT, w.window, x11rb::CURRENT_TIME).unwrap();
    w.send(MOTION, 0, 500 + 100, 20 + 150);
    assert!(differing(&other, &w.picture()) < 0.02, "nothing there yet");
    w.letter('s');
    w.until("views: stats in the other window", |picture| is_over(&other, picture, left));
    // The pointer scrolls the stats, and not the view below them.
    let below = [0, 150, 200, 50];
    let rest = part(&w.picture(), below);
    w.send(MOTION, 0, 540, 40);
    std::thread::sleep(Duration::from_secs(1));
    w.send(BUTTON_PRESS, 1, 0, 0);
    std::thread::sleep(Duration::from_secs(1));
    w.send(MOTION, 0, 540, 100);
    let moved = w.until("views: stats moved", |picture| !is_over(&other, picture, left));
    w.send(BUTTON_RELEASE, 1, 0, 0);
    assert!(differing(&rest, &part(&moved, below)) < 0.02, "the view does not change");

    // Closing the other window removes its view, and the first window continues.
    w.window = w.wait_for("the other window", |w| w.find_named(b"other"));
    w.close();
    w.wait_for("one window", |w| w.find_named(b"other").is_none().then_some(()));
    w.window = first;
    // Its views follow it.
    w.resize([640, 240]);
    w.until("views: resized", |picture| {
        picture.dimensions() == (640, 240)
            && [[40, 80, 240, 120], [360, 80, 240, 120]].iter().all(|of| colours(&part(picture, *of)) > 100)
    });
    w.x.set_input_focus(InputFocus::PARENT, first, x11rb::CURRENT_TIME).unwrap();
    w.key(ESCAPE);
    assert_eq!(w.ended().code(), Some(0));

    // The file on the command line takes precedence over the variable. No default set is generated if none is needed.
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

    // An invalid file is one line.
    std::fs::write(&alone, r#"{"views": [{"cameras": [{"window": 2}]}]}"#).unwrap();
    for (command, says) in [
        (
            &["view", "--config"][..],
            "alone.json: views[0].cameras[0].window: there is no window 2: there are 1 windows, counted from 0",
        ),
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

/// Regression: the view under the pressed button kept it, so that all later events went there.
#[test]
fn button_lost_with_the_focus_leaves_its_view() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([1280, 1024]), tile_set(folder.path())) else { return };
    let config = folder.path().join("halves.json");
    let text = r#"{"windows": [{"title": "Terrane - halves", "position_px": [10, 20], "size_px": [400, 200]}],
        "views": [{"cameras": [{"viewport": [0, 0, 0.5, 1]}]}, {"cameras": [{"viewport": [0.5, 0, 0.5, 1]}]}]}"#;
    std::fs::write(&config, text).unwrap();
    let args = ["view", set.to_str().unwrap(), "--config", config.to_str().unwrap()];
    let mut w = Driven::start(&display, &args, folder.path());
    let (left, right) = ([0, 0, 200, 200], [200, 0, 200, 200]);
    w.until("halves: first", |picture| [left, right].iter().all(|of| colours(&part(picture, *of)) > 100));
    let before = w.settled("halves: at rest");
    // The window loses the focus while the button is pressed over the left half, and gets it back after the release.
    w.send(MOTION, 0, 110, 140);
    w.send(BUTTON_PRESS, 1, 0, 0);
    std::thread::sleep(Duration::from_millis(500));
    w.x.unmap_window(w.window).unwrap();
    w.x.sync().unwrap();
    std::thread::sleep(Duration::from_millis(500));
    w.send(BUTTON_RELEASE, 1, 0, 0);
    w.x.map_window(w.window).unwrap();
    w.x.set_input_focus(InputFocus::PARENT, w.window, x11rb::CURRENT_TIME).unwrap();
    w.x.sync().unwrap();
    w.until("halves: again", |picture| differing(&before, picture) < 0.002);
    w.drag(1, [310, 120], [150, 110]);
    let turned = w.at_rest("halves: right turned");
    assert!(differing(&part(&before, right), &part(&turned, right)) > 0.1, "the view that was dragged");
    assert!(differing(&part(&before, left), &part(&turned, left)) < 0.002, "the view that had the button");
    w.key(ESCAPE);
    assert_eq!(w.ended().code(), Some(0));
}

/// Otherwise one view would fly forever, and another would end a motion that it did not start.
#[test]
fn key_release_goes_to_the_view_that_got_the_press() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([1280, 1024]), tile_set(folder.path())) else { return };
    let config = folder.path().join("keys.json");
    let text = r#"{"windows": [{"title": "Terrane - keys", "position_px": [10, 20], "size_px": [400, 200]}],
        "views": [{"cameras": [{"viewport": [0, 0, 0.5, 1]}]}, {"cameras": [{"viewport": [0.5, 0, 0.5, 1]}]}]}"#;
    std::fs::write(&config, text).unwrap();
    let args = ["view", set.to_str().unwrap(), "--config", config.to_str().unwrap()];
    let mut w = Driven::start(&display, &args, folder.path());
    let (left, right) = ([0, 0, 200, 200], [200, 0, 200, 200]);
    w.until("keys: first", |picture| [left, right].iter().all(|of| colours(&part(picture, *of)) > 100));
    // Both views fly with the arrow keys.
    for x in [310, 110] {
        w.send(MOTION, 0, x, 140);
        w.letter('2');
    }
    let before = w.settled("keys: at rest");
    let up = w.key_code(UP);
    w.send(KEY_PRESS, up, 0, 0);
    w.until("keys: flies", |picture| differing(&part(&before, left), &part(picture, left)) > 0.02);
    w.send(MOTION, 0, 310, 140);
    w.send(KEY_RELEASE, up, 0, 0);
    let after = w.at_rest("keys: at rest again");
    assert!(differing(&part(&before, right), &part(&after, right)) < 0.002, "the view in which it was released");
    w.key(ESCAPE);
    assert_eq!(w.ended().code(), Some(0));
}

#[test]
fn views_rest_without_changes_and_keep_the_maximum_frame_rate() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(display), Some(set)) = (Display::start([1280, 1024]), tile_set(folder.path())) else { return };
    let config = folder.path().join("two.json");
    let text = r#"{"windows": [
         {"title": "Terrane - one", "position_px": [10, 20], "size_px": [200, 160]},
         {"title": "two", "position_px": [300, 20], "size_px": [200, 160], "shares_device": true}],
        "views": [{}, {"cameras": [{"window": 1}]}]}"#;
    std::fs::write(&config, text).unwrap();
    let args = ["view", set.to_str().unwrap(), "--config", config.to_str().unwrap()];
    let on_demand: Vec<&str> = args.into_iter().chain(["--on-demand", "--max-fps", "30"]).collect();
    let mut w = Driven::start(&display, &on_demand, folder.path());
    let first = w.window;
    w.until("two views: one", |picture| colours(picture) > 100);
    w.window = w.wait_for("the other window", |w| w.find_named(b"two"));
    w.until("two views: two", |picture| colours(picture) > 100);
    let two = w.at_rest("two views: two at rest");
    w.window = first;
    let one = w.at_rest("two views: one at rest");
    std::thread::sleep(Duration::from_secs(1));
    let before = w.ticks();
    std::thread::sleep(Duration::from_secs(2));
    assert!(w.ticks() - before < 60, "they are drawn continuously");
    // An event in one view wakes all; the other shows the same as before.
    w.window = w.wait_for("the other window", |w| w.find_named(b"two"));
    w.send(MOTION, 0, 400, 100);
    for _ in 0..4 {
        w.send(BUTTON_PRESS, 4, 0, 0);
        w.send(BUTTON_RELEASE, 4, 0, 0);
    }
    w.until("two views: woken", |picture| differing(&two, picture) > 0.2);
    w.window = first;
    assert!(differing(&one, &w.picture()) < 0.002, "the other view does not change");
    w.x.set_input_focus(InputFocus::PARENT, first, x11rb::CURRENT_TIME).unwrap();
    w.key(ESCAPE);
    assert_eq!(w.ended().code(), Some(0));

    let capped: Vec<&str> = args.into_iter().chain(["--max-fps", "8"]).collect();
    let start = Instant::now();
    let mut w = Driven::start(&display, &capped, folder.path());
    w.until("two views: capped", |picture| colours(picture) > 100);
    std::thread::sleep(Duration::from_secs(3));
    w.key(ESCAPE);
    assert_eq!(w.ended().code(), Some(0));
    let most = 8.0 * start.elapsed().as_secs_f64() + 2.0;
    let said = w.said();
    let frames = said.split(" frames:").next().and_then(|text| text.split_whitespace().next_back());
    let frames: f64 = frames.unwrap().parse().unwrap();
    assert!(frames > 5.0 && frames <= most, "{frames} frames, the maximum is {most}: {said}");
}
