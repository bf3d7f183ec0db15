//! Measures whole frames of 64 x 64 pixels on the software driver, on the scene of the `osg_frame` peer. Prints one JSON
//! object per line with the peer's field names.

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Result;
use serde_json::json;

use terrane::gpu::AdapterChoice;
use terrane::scene::{CullingMode, DistanceFog, Page, Sky};
use terrane::state::StateSet;
use terrane::viewer::{FieldOfView, ThreadingModel, Viewer, ViewerConfig};

use super::cull::{Grid, View};
use super::measurement::{percentile, print_line};

/// Measures each case for about `seconds` and prints a line for it. Without `every_leaf`, leaves between pixel centres are
/// culled.
pub fn run(seconds: f64, every_leaf: bool) -> Result<()> {
    let time = Duration::from_secs_f64(if seconds.is_finite() { seconds.clamp(0.0, 3600.0) } else { 1.0 });
    for cells in [1_000, 10_000, 100_000] {
        for state_sets in [1, 64] {
            for view in [View::All, View::Tenth] {
                for threading in [ThreadingModel::SingleThreaded, ThreadingModel::DrawThreadPerContext] {
                    print_line(measure((cells, state_sets, view), every_leaf, threading, time)?);
                }
            }
        }
    }
    Ok(())
}

fn measure(
    (cells, state_sets, view): (u32, u32, View),
    every_leaf: bool,
    threading: ThreadingModel,
    time: Duration,
) -> Result<serde_json::Value> {
    let config = ViewerConfig {
        size_px: [64, 64],
        threading,
        adapter: AdapterChoice::Software,
        validation: false,
        ..ViewerConfig::default()
    };
    let mut viewer = Viewer::new_offscreen(&config)?;
    let grid = Grid::new(cells);
    // The materials differ in colour, as in the peer.
    let sets: Vec<_> = (0..state_sets)
        .map(|i| {
            let color = [f64::from(i % 8) as f32 / 8.0, f64::from(i / 8) as f32 / 8.0, 0.5, 1.0];
            Arc::new(StateSet { color: Some(color), ..StateSet::default() })
        })
        .collect();
    viewer.add_root(Page::from_node(grid.build(&sets))?)?;
    viewer.view_mut().environment.sky = Sky::Background([51, 51, 102]);
    viewer.view_mut().environment.fog = DistanceFog { enabled: false, density_per_m: 0.0 };
    let camera = grid.camera(view);
    viewer.view_mut().camera.world_from_eye = camera.eye_from_world.inverse();
    if every_leaf {
        let CullingMode(culling) = viewer.view().camera.settings.culling;
        viewer.view_mut().camera.settings.culling = CullingMode(culling & !CullingMode::SAMPLES.0);
    }
    viewer.view_mut().camera.field_of_view = FieldOfView::Vertical(std::f64::consts::FRAC_PI_3);
    // The first frames upload everything and compile the shaders; they are not measured.
    let expected = if matches!(view, View::All) { cells } else { 1 };
    let patience = Instant::now() + Duration::from_secs(120);
    let mut settled = 0;
    while settled < 20 && Instant::now() < patience {
        viewer.frame()?;
        viewer.finish()?;
        settled += u32::from(viewer.stats().last().is_some_and(|f| f.leaves + f.unsampled_leaves >= expected));
    }
    let first = viewer.frame_stamp().frame + 1;
    let mut times = Vec::new();
    let end = Instant::now() + time;
    while Instant::now() < end || times.len() < 20 {
        let start = Instant::now();
        viewer.frame()?;
        times.push(start.elapsed().as_secs_f64());
    }
    viewer.finish()?;
    let of = |value: fn(&terrane::viewer::FrameStats) -> f64| {
        let frames = viewer.stats().iter().filter(|f| f.frame >= first && f.drawn);
        percentile(&mut frames.map(value).collect::<Vec<_>>(), 0.5)
    };
    let [leaves, unsampled] = [of(|f| f64::from(f.leaves)), of(|f| f64::from(f.unsampled_leaves))];
    let round = |ms: f64| (ms * 1e3).round() / 1e3;
    let mean = times.iter().sum::<f64>() / times.len() as f64;
    Ok(json!({
        "bench": "terrane_frame", "n": cells, "statesets": state_sets,
        "view": match view { View::Tenth => "tenth", View::All => "all", View::Tilted => "tilted" },
        "geometry": "pooled", "threading": threading.to_string(), "frames": times.len(), "leaves": leaves, "unsampled_leaves": unsampled,
        "adapter": viewer.composite().adapter_name(),
        "frame_mean_ms": round(mean * 1e3), "frame_p50_ms": round(percentile(&mut times, 0.5) * 1e3),
        "frame_p95_ms": round(percentile(&mut times, 0.95) * 1e3),
        "frame_max_ms": round(percentile(&mut times, 1.0) * 1e3),
        "cull_p50_ms": round(of(|f| f.cull_ms)), "draw_p50_ms": round(of(|f| f.draw_ms)),
    }))
}
