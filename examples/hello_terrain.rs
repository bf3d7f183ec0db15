//! The smallest program that flies a tile set: a viewer, a root, a frame loop.
//!
//! ```text
//! cargo run --release --example hello_terrain -- [SOURCE] [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! SOURCE is a folder, a tileset.json or a URL; without it a small set is generated in the system's temporary folder.
//! Expected: hills that get sharper as tiles arrive (drags turn and move, H shows the keys, Esc quits). Offscreen it writes
//! the last frame, which looks down on the middle of the set from the south-west.

mod shared;

use anyhow::Result;
use terrane::viewer::{Viewer, ViewerConfig, WindowOptions, run_window};

fn main() -> Result<()> {
    let args = shared::Args::parse()?;
    let source = args.source()?;
    let config = ViewerConfig { max_sse_px: 3.0, ..ViewerConfig::default() };

    if args.opens_window() {
        let on_open = Box::new(move |viewer: &mut Viewer| viewer.load(&source).map(drop));
        run_window(config, WindowOptions { title: "Hello, terrain".into(), on_open, ..WindowOptions::default() })?;
        return Ok(());
    }

    let mut viewer = Viewer::new_offscreen(&config)?;
    viewer.load(&source)?;
    let first = viewer.view().camera.world_from_eye;
    let path = viewer.bounds().map(|bounds| bounds.default_path(&first));
    let frames = args.frames_or(300);
    for frame in 0..frames {
        if let Some(path) = &path {
            let fraction = f64::from(frame) / f64::from(frames.saturating_sub(1).max(1));
            viewer.view_mut().camera.world_from_eye = path.world_from_eye(fraction * path.duration_s());
        }
        viewer.frame()?;
    }
    args.save(&mut viewer)
}
