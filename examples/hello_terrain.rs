//! The smallest program that flies a tile set: a viewer, a root, a frame loop.
//!
//! ```text
//! cargo run --release --example hello_terrain -- [SOURCE] [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! SOURCE is a folder, a tileset.json or a URL; without it a small set is made in the system's temporary folder.
//! Expected: a window over hills that grow sharper as tiles arrive (drags turn and move, H shows the keys, Esc quits);
//! offscreen, a picture of the last frame, looking down on the middle of the set from the south-west.

use anyhow::Result;
use terrane::viewer::{Viewer, ViewerConfig, WindowOptions, has_display, run_window};

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let frames: u32 = value("--frames").map_or(Ok(300), |n| n.parse())?;
    let source = match args.first().filter(|a| !a.starts_with("--")) {
        Some(source) => source.clone(),
        None => terrane_data_gen::default_set(&std::env::temp_dir().join("terrane-hello"))?.display().to_string(),
    };
    let config = ViewerConfig { max_sse_px: 3.0, ..ViewerConfig::default() };

    if has_display() && !args.iter().any(|a| a == "--offscreen") {
        let on_open = Box::new(move |viewer: &mut Viewer| viewer.load(&source).map(drop));
        run_window(config, WindowOptions { title: "Hello, terrain".into(), on_open, ..WindowOptions::default() })?;
        return Ok(());
    }

    let mut viewer = Viewer::new_offscreen(&config)?;
    viewer.load(&source)?;
    let first = viewer.view().camera.world_from_eye;
    let path = viewer.bounds().map(|bounds| bounds.default_path(&first));
    for frame in 0..frames {
        if let Some(path) = &path {
            let share = f64::from(frame) / f64::from(frames.saturating_sub(1).max(1));
            viewer.view_mut().camera.world_from_eye = path.world_from_eye(share * path.duration_s());
        }
        viewer.frame()?;
    }
    if let Some(file) = value("--screenshot") {
        viewer.read_back()?.save(file)?;
    }
    Ok(())
}
