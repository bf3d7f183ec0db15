//! Every example runs offscreen and draws something. Needs a GPU; a software adapter suffices.

#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::process::Command;

use kit::tile_sets::generate;
use terrane::math::color::linear_from_srgb8;

/// Returns the path of an example, beside the folder of this test's program, and builds it if missing.
fn example(name: &str) -> PathBuf {
    let me = std::env::current_exe().unwrap();
    let profile = me.parent().and_then(|deps| deps.parent()).unwrap();
    let program = profile.join("examples").join(format!("{name}{}", std::env::consts::EXE_SUFFIX));
    // `cargo test` builds it, but `cargo test --test examples_run` does not.
    if !program.is_file() {
        let release = if profile.ends_with("release") { &["--release"][..] } else { &[] };
        let built = Command::new(env!("CARGO"))
            .args(["build", "--workspace", "--example", name])
            .args(release)
            .status()
            .unwrap();
        assert!(built.success());
    }
    program
}

/// Returns the number of frames to draw. Examples whose frames take long on a software adapter draw fewer.
fn frames(name: &str) -> u32 {
    match name {
        "custom_drawable" | "multi_view" | "occluders" | "picking" if !kit::long_tests() => 8,
        // The object that it shows turns.
        "render_to_texture" => 30,
        _ if !kit::long_tests() => 12,
        _ => 30,
    }
}

/// Runs an example and returns its image; `None`, and the test skipped, without an adapter.
fn run(name: &str, arguments: &[&str], colours_at_least: usize) -> Option<image::RgbImage> {
    run_and_listen(name, arguments, colours_at_least).map(|(picture, _)| picture)
}

/// Runs an example and returns its image and standard output.
fn run_and_listen(name: &str, arguments: &[&str], colours_at_least: usize) -> Option<(image::RgbImage, String)> {
    if kit::skip::no_adapter() {
        return None;
    }
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("picture.png");
    let out = Command::new(example(name))
        .args(arguments)
        .args(["--offscreen", "--frames", &frames(name).to_string(), "--screenshot", picture.to_str().unwrap()])
        .output()
        .unwrap();
    assert!(out.status.success(), "{name}: {}", String::from_utf8_lossy(&out.stderr));
    let picture = image::open(&picture).unwrap().into_rgb8();
    assert_eq!((picture.width(), picture.height()), (1280, 720));
    let colours: BTreeSet<_> = picture.pixels().map(|p| p.0).collect();
    assert!(colours.len() >= colours_at_least, "{name}: {} colours", colours.len());
    Some((picture, String::from_utf8(out.stdout).unwrap()))
}

/// Returns a pixel as linear values, 0 to 1.
fn linear(picture: &image::RgbImage, [x, y]: [u32; 2]) -> [f64; 3] {
    picture.get_pixel(x, y).0.map(linear_from_srgb8)
}

#[test]
fn hello_terrain() {
    let folder = tempfile::tempdir().unwrap();
    let set = generate(&folder.path().join("set"), |args| (args.levels, args.size) = (Some(3), 10_000.0));
    run("hello_terrain", &[set.as_str()], 1000);
}

#[test]
fn paged_lod() {
    run("paged_lod", &[], 300);
}

#[test]
fn image_sequence() {
    run("image_sequence", &[], 300);
}

#[test]
fn render_to_texture() {
    let Some(picture) = run("render_to_texture", &[], 100) else { return };
    let all = |places: &[(u32, u32)], is: fn(i32, i32, i32) -> bool| {
        places.iter().all(|(x, y)| {
            let [r, g, b] = picture.get_pixel(*x, *y).0.map(i32::from);
            is(r, g, b)
        })
    };
    let is_yellow = |r, g, b| r > b + 60 && g > b + 60;
    assert!(all(&[(420, 450)], |r, g, b| r > 200 && g < 130 && b < 130), "the wall of the house in the sun");
    assert!(all(&[(400, 350), (500, 360)], is_yellow), "its roof");
    // At the edges of the screen is the blue behind the house, in its middle the dark side of the walls.
    let rim = [(755, 155), (930, 155), (1120, 155), (750, 330), (1110, 330), (750, 510), (930, 510), (1100, 510)];
    assert!(all(&rim, |r, g, b| b > r + 70 && b > g + 40), "blue around");
    assert!(all(&[(880, 370), (970, 390)], |r, g, b| (60..130).contains(&r) && r > 2 * g && r > 2 * b), "walls");
    assert!(all(&[(970, 280), (920, 275), (860, 284)], is_yellow), "a roof");
    assert!(all(&[(875, 245)], |r, g, b| r < 100 && (b - r).abs() < 40 && (g - r).abs() < 40), "a chimney");
}

#[test]
fn vertex_attributes() {
    let Some(picture) = run("vertex_attributes", &[], 1000) else { return };
    let count = |from: [u32; 2], to: [u32; 2], is: fn(i32, i32, i32) -> bool| {
        let places = (from[1]..to[1]).flat_map(|y| (from[0]..to[0]).map(move |x| (x, y)));
        places
            .filter(|(x, y)| {
                let [r, g, b] = picture.get_pixel(*x, *y).0.map(i32::from);
                is(r, g, b)
            })
            .count()
    };
    let is_green = |r, g, b| g > r + 40 && g > b;
    assert!(count([370, 320], [470, 400], is_green) > 4000, "rain on a hill");
    assert_eq!(count([900, 400], [1250, 640], is_green), 0, "no rain behind it");
    let is_red: fn(i32, i32, i32) -> bool = |r, g, b| r > g + 100 && r > b + 100;
    let is_blue: fn(i32, i32, i32) -> bool = |r, g, b| b > r + 80 && b > g + 60;
    assert!(count([440, 250], [570, 310], is_red) > 150, "wind between hills");
    assert!(count([320, 360], [450, 430], is_blue) > 40, "wind in front of one");
    let [red, blue] = [is_red, is_blue].map(|is| count([600, 560], [1250, 700], is));
    assert_eq!((red, blue), (0, 0), "wind far from them");
}

#[test]
fn transparency_and_bins() {
    let Some(picture) = run("transparency_and_bins", &[], 100) else { return };
    // Beside the panes is the background, then each pane alone, then one over the other, the nearer last. A pane keeps
    // the same share of everything behind it.
    const KEPT: f64 = 0.55;
    for (near, far, both) in [
        ([[240, 560], [360, 560]], [[260, 210], [330, 220]], [360, 340]),
        ([[1010, 560], [900, 580]], [[1040, 210], [930, 220]], [920, 400]),
    ] {
        let tint = |[beside, alone]: [[u32; 2]; 2]| {
            let [beside, alone] = [beside, alone].map(|at| linear(&picture, at));
            [0, 1, 2].map(|i| alone[i] - KEPT * beside[i])
        };
        let behind = linear(&picture, [far[0][0], both[1]]);
        let (near, far, got) = (tint(near), tint(far), linear(&picture, both));
        let off = |first: [f64; 3], last: [f64; 3]| -> f64 {
            (0..3).map(|i| (last[i] + KEPT * (first[i] + KEPT * behind[i]) - got[i]).abs()).sum()
        };
        assert!(off(far, near) < 0.03 && off(near, far) > 0.12, "{} {}", off(far, near), off(near, far));
    }
    // The ball is white above the pane in front of it, and green behind it.
    let [above, behind] = [[640, 290], [640, 420]].map(|[x, y]| picture.get_pixel(x, y).0.map(i32::from));
    assert!(above.iter().all(|c| *c > 220) && behind[1] > behind[0] + 30, "{above:?} {behind:?}");
    // Each side of the mark is checked, over any background.
    for [x, y] in [[648u32, 213], [506, 328], [788, 378], [646, 493]] {
        let mut around = (y - 4..=y + 4).flat_map(|y| (x - 4..=x + 4).map(move |x| (x, y)));
        let is_orange = |[r, g, b]: [u8; 3]| r > 200 && (110..200).contains(&g) && b < 120;
        assert!(around.any(|(x, y)| is_orange(picture.get_pixel(x, y).0)), "no mark at {x}, {y}");
    }
}

#[test]
fn custom_drawable() {
    run("custom_drawable", &[], 1000);
}

#[test]
fn occluders() {
    let Some((picture, said)) = run_and_listen("occluders", &[], 100) else { return };
    let numbers = |said: &str| -> Vec<u32> {
        said.split(|c: char| !c.is_ascii_digit()).filter(|n| !n.is_empty()).map(|n| n.parse().unwrap()).collect()
    };
    let [drawn, 400, 4, hidden] = numbers(&said)[..] else { panic!("{said}") };
    assert!((30..200).contains(&drawn) && hidden > 200, "{said}");
    let (all, said) = run_and_listen("occluders", &["--no-occluders"], 100).unwrap();
    let [all_drawn, 400, 4, 0] = numbers(&said)[..] else { panic!("{said}") };
    // Each group of balls counts once.
    assert!(all_drawn > drawn + 200, "{said}");
    let differing = picture.pixels().zip(all.pixels()).filter(|(a, b)| a != b).count();
    assert_eq!(differing, 0, "hidden balls change nothing");
    // The balls are behind the window, and the wall is around it.
    let is_wall = |x, y| picture.get_pixel(x, y).0.iter().all(|c| (120..165).contains(c));
    assert!(is_wall(640, 200) && is_wall(300, 340) && is_wall(980, 340) && is_wall(640, 500));
    let [r, _, b] = picture.get_pixel(600, 400).0;
    assert!(r > 200 && b < 80, "a ball behind the window: {r} {b}");
}

#[test]
fn proxy_node() {
    // Nine houses with at least three flat faces each stand before a sky.
    run("proxy_node", &[], 40);
}

#[test]
fn custom_callback() {
    run("custom_callback", &[], 100);
}

#[test]
fn custom_manipulator() {
    run("custom_manipulator", &[], 100);
}

#[test]
fn bring_your_own_device() {
    let Some(picture) = run("bring_your_own_device", &[], 1000) else { return };
    let is_grey = |x: u32| {
        (0..picture.height())
            .all(|y| picture.get_pixel(x, y).0.iter().all(|c| c.abs_diff(picture.get_pixel(x, y).0[0]) <= 1))
    };
    assert!(is_grey(641) && is_grey(1000) && !is_grey(300), "the right half is not the grey copy");
}

#[test]
fn embedding() {
    run("embedding", &[], 40);
}

#[test]
fn picking() {
    let Some(picture) = run("picking", &[], 1000) else { return };
    let count = |is: fn(&[u8; 3]) -> bool| picture.pixels().filter(|p| is(&p.0)).count();
    let (pins, balls) = (count(|[r, g, b]| *r > 180 && *g < 140 && *b < 130), count(|[r, _, b]| *b > 150 && *r < 90));
    assert!(pins > 500 && balls > 1000, "{pins} {balls}");
}

#[test]
fn world_grid() {
    run("world_grid", &[], 1000);
}

#[test]
fn slave_cameras() {
    run("slave_cameras", &[], 300);
}

#[test]
fn two_windows() {
    let Some(image) = run("two_windows", &[], 100) else { return };
    let colours_in = |x: std::ops::Range<u32>| {
        let colours: BTreeSet<_> =
            x.flat_map(|x| (0..720).map(move |y| (x, y))).map(|(x, y)| image.get_pixel(x, y).0).collect();
        colours.len()
    };
    assert!(colours_in(0..640) > 50 && colours_in(640..1280) > 50, "both windows show balls");
}

#[test]
fn multi_view() {
    run("multi_view", &[], 100);
}
