//! Every example runs offscreen and draws something. Needs a GPU (a software one will do).

#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::process::Command;

/// Where cargo puts examples: beside the folder of this test's own program.
fn example(name: &str) -> PathBuf {
    let me = std::env::current_exe().unwrap();
    let profile = me.parent().and_then(|deps| deps.parent()).unwrap();
    let program = profile.join("examples").join(format!("{name}{}", std::env::consts::EXE_SUFFIX));
    // `cargo test` has built it; `cargo test --test examples_run` has not.
    if !program.is_file() {
        let release = if profile.ends_with("release") { &["--release"][..] } else { &[] };
        let built = Command::new(env!("CARGO"))
            .args(["build", "-p", "terrane", "--example", name])
            .args(release)
            .status()
            .unwrap();
        assert!(built.success());
    }
    program
}

/// The picture; `None` where nothing can draw.
fn run(name: &str, arguments: &[&str], colours_at_least: usize) -> Option<image::RgbImage> {
    let traits = terrane::gpu::ContextTraits::default();
    if let Err(error) = terrane::gpu::GraphicsContext::new_offscreen(&traits) {
        assert!(std::env::var_os("REQUIRE_GPU").is_none_or(|v| v != "1"), "REQUIRE_GPU=1: {error}");
        eprintln!("SKIPPED {name}: {error}");
        return None;
    }
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("picture.png");
    let out = Command::new(example(name))
        .args(arguments)
        .args(["--offscreen", "--frames", "30", "--screenshot", picture.to_str().unwrap()])
        .output()
        .unwrap();
    assert!(out.status.success(), "{name}: {}", String::from_utf8_lossy(&out.stderr));
    let picture = image::open(&picture).unwrap().into_rgb8();
    assert_eq!((picture.width(), picture.height()), (1280, 720));
    let colours: BTreeSet<_> = picture.pixels().map(|p| p.0).collect();
    assert!(colours.len() >= colours_at_least, "{name}: {} colours", colours.len());
    Some(picture)
}

#[test]
fn hello_terrain() {
    let folder = tempfile::tempdir().unwrap();
    let set = folder.path().join("set");
    let args = terrane_data_gen::GenArgs { levels: Some(3), size: 10_000.0, ..terrane_data_gen::GenArgs::new(&set) };
    terrane_data_gen::run(&args).unwrap();
    run("hello_terrain", &[set.to_str().unwrap()], 1000);
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
    run("render_to_texture", &[], 100);
}

#[test]
fn transparency_and_bins() {
    run("transparency_and_bins", &[], 100);
}

#[test]
fn custom_drawable() {
    run("custom_drawable", &[], 1000);
}

#[test]
fn occluders() {
    run("occluders", &[], 100);
}

#[test]
fn proxy_node() {
    // Nine houses of at least three flat faces each, before a sky.
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
fn slave_cameras() {
    run("slave_cameras", &[], 300);
}

#[test]
fn multi_view() {
    run("multi_view", &[], 100);
}
