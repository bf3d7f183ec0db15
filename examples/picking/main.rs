//! Picking: rays through the window's pixels, and ground heights queried by another thread.
//!
//! ```text
//! cargo run --release --example picking -- [SOURCE] [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Without SOURCE a small set is generated in the system's temporary folder. Expected after loading: hills with a grid of red
//! pins, perpendicular to the slope, and none in the sky. A ring of blue balls keeps a constant height above the ground.

mod marks;
#[path = "../shared/mod.rs"]
mod shared;

use anyhow::Result;
use terrane::pager::PagerConfig;
use terrane::viewer::{ViewFrom, Viewer, ViewerConfig, WindowOptions, run_window};

fn main() -> Result<()> {
    let args = shared::Args::parse()?;
    let source = args.source()?;
    let open = move |viewer: &mut Viewer| {
        viewer.load(&source)?;
        let bounds = *viewer.bounds().expect("a tile set is loaded");
        let view = ViewFrom { heading: 0.4, pitch: -0.25, range_m: Some(0.5 * bounds.sphere.radius_m) };
        viewer.view_mut().camera.world_from_eye = bounds.first_camera(&view);
        Ok(())
    };
    // The decode threads build the k-d trees that intersections need.
    let pager = PagerConfig { build_kd_trees: true, ..PagerConfig::default() };
    let config = ViewerConfig { pager, max_sse_px: 8.0, ..ViewerConfig::default() };
    if args.opens_window() {
        let mut is_marked = false;
        let before_frame = Box::new(move |viewer: &mut Viewer| {
            if !is_marked && viewer.is_settled() {
                marks::add(viewer)?;
                is_marked = true;
            }
            Ok(true)
        });
        run_window(config, WindowOptions { on_open: Box::new(open), before_frame, ..WindowOptions::default() })?;
        return Ok(());
    }
    let mut viewer = Viewer::new_offscreen(&config)?;
    open(&mut viewer)?;
    shared::draw(&args, &mut viewer)?;
    marks::add(&mut viewer)?;
    (0..10).try_for_each(|_| viewer.frame())?;
    args.save(&mut viewer)
}
