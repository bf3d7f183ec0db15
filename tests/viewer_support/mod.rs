//! What the viewer's tests share: an offscreen viewer, or word that there is none; a small tile set, and balls.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
#![allow(dead_code, reason = "each test program uses a part of it")]

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::{DAffine3, DVec3};
use terrane::gpu::GpuError;
use terrane::scene::{Drawable, Geometry, Material, Mesh, Node};
use terrane::viewer::{CompositeViewer, Viewer, ViewerConfig, ViewerError};

/// `None`, said aloud, where there is no adapter (a failure with REQUIRE_GPU=1, as in CI); any other error is a failure.
pub fn or_skip<T>(made: Result<T, impl Into<ViewerError>>) -> Option<T> {
    match made.map_err(Into::into) {
        Ok(made) => Some(made),
        Err(ViewerError::Gpu(error @ GpuError::NoAdapter { .. })) => {
            assert!(std::env::var_os("REQUIRE_GPU").is_none_or(|v| v != "1"), "REQUIRE_GPU=1: {error}");
            eprintln!("SKIPPED: {error}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

pub fn offscreen(config: &ViewerConfig) -> Option<Viewer> {
    or_skip(Viewer::new_offscreen(config))
}

/// Longer than anything takes.
const PATIENCE: Duration = Duration::from_secs(120);

/// Viewers that draw until nothing is missing: uploads take as many frames as the machine makes of them.
pub trait Settle {
    /// Draws a frame; true where nothing is missing after it.
    fn draw(&mut self) -> bool;

    /// Draws so many frames at least.
    fn settle(&mut self, least: usize) {
        let start = Instant::now();
        let mut frames = 1;
        while !self.draw() || frames < least {
            frames += 1;
            assert!(start.elapsed() < PATIENCE, "does not settle");
        }
    }
}

impl Settle for Viewer {
    fn draw(&mut self) -> bool {
        self.frame().unwrap();
        self.is_settled()
    }
}

impl Settle for CompositeViewer {
    fn draw(&mut self) -> bool {
        self.frame().unwrap();
        self.is_settled()
    }
}

pub fn small_set(folder: &Path) -> String {
    let set = folder.join("set");
    let args =
        terrane_data_gen::GenArgs { levels: Some(3), seed: 5, size: 20_000.0, ..terrane_data_gen::GenArgs::new(&set) };
    terrane_data_gen::run(&args).unwrap();
    set.display().to_string()
}

pub fn ball(at: DVec3, radius: f64, color: [f32; 4]) -> Node {
    let mesh = Mesh::sphere(DVec3::ZERO, radius, 24);
    let material = Material { base_color: color, unlit: true, ..Material::default() };
    let geode = Node::geode(vec![Drawable::new(Geometry::Mesh(Arc::new(mesh)), material)]);
    Node::transform(DAffine3::from_translation(at), vec![geode])
}
