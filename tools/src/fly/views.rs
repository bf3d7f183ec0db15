//! `terrane view` with a file of several views in one or more windows.

use std::io::Write as _;
use std::sync::atomic::Ordering;

use anyhow::{Context as _, Result, anyhow, bail};
use terrane::scene::{SunShadows, Water};
use terrane::viewer::{ArrangedViews, LoadedRoot, Samples, ViewerConfig, ViewsOptions, ViewsSetup, run_views};

use super::defaults::{HEIGHT_SSE_PX, MESH_SSE_PX};
use super::errors::into_viewer_error;
use super::interrupt::Interrupt;
use crate::args::FlyArgs;

/// Opens the windows and runs until they are closed. `root` is the scene of views that do not name one.
pub fn run(
    args: FlyArgs,
    config: ViewerConfig,
    setup: ViewsSetup,
    root: Option<LoadedRoot>,
    interrupt: Interrupt,
) -> Result<()> {
    for (name, is_given) in [
        ("--path", args.path.is_some()),
        ("--view", args.view.is_some()),
        ("--parent", args.parent.is_some()),
        ("--beside", args.beside > 0),
    ] {
        if is_given {
            bail!("{name} is for one view; the file names several");
        }
    }
    writeln!(std::io::stdout(), "H shows the keys of a view, Esc ends").context("stdout")?;
    let (views, windows) = (setup.views.len(), setup.windows.len());
    let stop = interrupt.stop.clone();
    let options = ViewsOptions {
        overlay: args.stats,
        root,
        on_demand: args.on_demand,
        max_frame_rate: args.max_fps.map(|rate| rate.0),
        before_frame: Box::new(move |_| Ok(!stop.load(Ordering::Relaxed))),
        on_open: Box::new(move |arranged| {
            // The roots of all scenes have been read.
            interrupt.stop_in_order();
            open(arranged, &args).map_err(into_viewer_error)
        }),
        ..ViewsOptions::default()
    };
    let viewer = run_views(config, setup, options)?.ok_or_else(|| anyhow!("the windows closed before they opened"))?;
    let frame_ms = Samples::new(viewer.stats().iter().map(|frame| frame.frame_ms));
    let line = format!(
        "showed  {views} views in {windows} windows, {} frames: {:.2} ms median, {:.2} p99, {:.2} max, {}",
        viewer.frame_stamp().frame,
        frame_ms.median(),
        frame_ms.percentile(0.99),
        frame_ms.max(),
        viewer.threading_model()
    );
    writeln!(std::io::stdout(), "{line}").context("stdout")
}

/// Applies the options of the command line to all views.
fn open(arranged: &mut ArrangedViews, args: &FlyArgs) -> Result<()> {
    let ArrangedViews { viewer, views, .. } = arranged;
    for id in views.iter().copied() {
        let scene = viewer.scene_of(id)?;
        let default_sse_px = if viewer.is_height_set(scene)? { HEIGHT_SSE_PX } else { MESH_SSE_PX };
        let bounds = viewer.bounds(scene)?.copied();
        let view = viewer.view_mut(id)?;
        view.camera.settings.max_sse_px = args.scene.sse.map_or(default_sse_px, |limit| limit.0);
        view.camera.settings.skip_sse_factor = args.scene.skip_sse.map_or(1.0, |factor| factor.0);
        view.camera.settings.lod_fade_s = args.scene.lod_fade.0;
        if let (Some(sun), Some(bounds)) = (args.sun, bounds) {
            view.environment.sun_direction = bounds.frame.direction(sun.azimuth, sun.height);
        }
        view.environment.shadows = args.shadows.then(SunShadows::default);
        view.environment.water = args.water.filter(|h| h.is_finite()).map(Water::at);
    }
    Ok(())
}
